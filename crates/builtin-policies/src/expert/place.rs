//! Destination of an object: resolves the target of a goal predicate to poses for the hand
//! that carries the object. `motion` plans the path.

use crate::expert::ExpertError;
use crate::expert::geometry::{Vec3, footprint};
use crate::expert::grasp::GraspRequirement;
use crate::expert::motion::FINGERTIP_M;
use crate::expert::world::{Entity, World};

/// Height above the destination's brim at which an object is carried, m.
const CARRY_M: f64 = 0.02;
/// Depth below an open container's brim at which an object is released, m.
const DROP_DEPTH_M: f64 = 0.04;
/// Distance from a drawer's centre towards its front at which an object is released, clear of the
/// cabinet's top and of the handles above, m.
const DRAWER_SHIFT_M: f64 = 0.022;
/// Placing into a covered region, where the hand has to stay outside: depth of the object behind
/// the opening, its gap above the floor, and length of the straight path in, m.
const COVERED_DEPTH_M: f64 = 0.013;
const COVERED_FLOOR_GAP_M: f64 = 0.02;
const COVERED_RUN_M: f64 = 0.13;
/// Gap between two objects that share a target, m.
const NEIGHBOUR_GAP_M: f64 = 0.004;
/// Distance of a held object from the straight path to its place within which the object continues
/// on the path, m.
const ON_PATH_M: f64 = 0.02;
/// Tolerance of the object's position at its place, m.
const AT_PLACE_M: f64 = 0.005;
/// LIBERO's own tolerance for one object on another, m.
const ON_OBJECT_M: f64 = 0.03;
/// Height above a region up to which an object counts as on it, m (LIBERO's tolerance).
const ON_REGION_M: f64 = 0.1;

#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Place {
    pub(crate) relation: Relation,
    pub(crate) target: String,
    /// Side of the target's centre, if two objects share the target: -1 or 1; 0 is the centre
    /// itself.
    pub(crate) slot: f64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Relation {
    On,
    In,
}

/// A place, resolved to current poses. Points give the horizontal position of the object's
/// origin and the height of its lowest point.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Spot {
    pub(crate) approach_start: Vec3,
    pub(crate) rest: Vec3,
    entry: Entry,
    /// Height of the bottom of the target, m; above it by [`COVERED_FLOOR_GAP_M`] in a covered
    /// region.
    floor: f64,
    /// Height of the top of the target, m.
    brim: f64,
}

#[derive(Clone, Copy, Debug)]
enum Entry {
    Onto,
    /// Released above the inside of a container.
    Into,
    /// Moved through an open front; the vector points outwards.
    Through(Vec3),
}

impl Place {
    /// Resolves the place to current poses.
    pub(crate) fn spot(&self, world: &World, object: &Entity) -> Result<Spot, ExpertError> {
        let target = world.entity(&self.target)?;
        let half_height = target.upright_half_height();
        let shape = footprint(object.quat, object.half);
        let aside = Vec3::heading(shape.narrow_angle) * (shape.narrow + NEIGHBOUR_GAP_M);
        let mut centre = target.pos + aside * self.slot;
        let (mut floor, brim) = (target.centre.z - half_height, target.centre.z + half_height);
        let entry = match self.relation {
            Relation::On => Entry::Onto,
            Relation::In => match world.front_of_cover(target) {
                Some(out) => Entry::Through(out),
                None => Entry::Into,
            },
        };
        let (approach_start, rest) = match entry {
            // The object descends towards the bottom of the target until contact stops it.
            Entry::Onto => (centre.at_height(brim + CARRY_M), centre.at_height(floor)),
            Entry::Into => {
                if let Some(out) = world.front_of_drawer(target) {
                    centre = centre + out * DRAWER_SHIFT_M;
                }
                (centre.at_height(brim + CARRY_M), centre.at_height(brim - DROP_DEPTH_M))
            }
            Entry::Through(out) => {
                floor += COVERED_FLOOR_GAP_M;
                let depth = target.extent_along(out);
                let rest = centre + out * (depth - COVERED_DEPTH_M);
                ((rest + out * COVERED_RUN_M).at_height(floor), rest.at_height(floor))
            }
        };
        Ok(Spot { approach_start, rest, entry, floor, brim })
    }

    /// Returns true if the object is in its place, judging by bounding boxes.
    pub(crate) fn holds(&self, world: &World, object: &Entity) -> Result<bool, ExpertError> {
        let target = world.entity(&self.target)?;
        let inside = target.local(object.pos).abs() - target.half;
        Ok(match self.relation {
            Relation::In => inside.max_coordinate() < 0.0,
            Relation::On if target.is_region() => {
                let above = object.pos.z - target.pos.z;
                let over = target.local(object.pos.at_height(target.pos.z)).abs() - target.half;
                over.max_coordinate() < 0.0 && above < ON_REGION_M
            }
            Relation::On => {
                let aside = (object.pos - target.pos).horizontal_norm();
                aside < ON_OBJECT_M && object.bottom() < target.top()
            }
        })
    }

    /// Returns the name of the target; for a region, the name of the object or fixture that carries
    /// the region.
    pub(crate) fn owner<'a>(&self, world: &'a World) -> Result<&'a str, ExpertError> {
        let target = world.entity(&self.target)?;
        Ok(if target.is_region() { &target.category } else { &target.name })
    }

    pub(crate) fn grasp_requirement(&self, world: &World) -> Result<GraspRequirement, ExpertError> {
        let target = world.entity(&self.target)?;
        if self.relation == Relation::On {
            return Ok(GraspRequirement::Any);
        }
        Ok(if world.front_of_cover(target).is_some() {
            GraspRequirement::Handle
        } else if let Some(out) = world.front_of_drawer(target) {
            // The palm is long in the closing direction and must be parallel to the
            // cabinet's front.
            GraspRequirement::Across(out)
        } else {
            GraspRequirement::Any
        })
    }
}

impl Spot {
    pub(crate) fn hand_for(world: &World, object: &Entity, point: Vec3) -> Vec3 {
        let up = point.z - object.bottom();
        (world.grip + point - object.pos).at_height(world.grip.z + up)
    }

    /// Returns true if the approach can begin, given the remaining displacement to its start.
    pub(crate) fn can_approach(&self, remaining: Vec3) -> bool {
        let is_level = match self.entry {
            Entry::Onto | Entry::Into => true,
            Entry::Through(_) => remaining.z.abs() < 2.0 * AT_PLACE_M,
        };
        is_level && remaining.horizontal_norm() < 2.0 * AT_PLACE_M
    }

    /// Returns true if the held object is on the straight path from the start of the approach to
    /// the place, given the remaining displacement to the place.
    pub(crate) fn is_entering(&self, to_rest: Vec3) -> bool {
        let run = self.approach_start - self.rest;
        let (length, out) = (run.norm(), run * run.norm().recip());
        let remaining = -to_rest.dot(out);
        let aside = (to_rest + out * remaining).norm();
        remaining < length && aside < ON_PATH_M
    }

    /// Returns true if an object that cannot be moved further is near enough to its place to be
    /// released, given the remaining displacement to the place. The front of a covered region may
    /// stop the hand a little before the place.
    pub(crate) fn can_release_blocked(&self, to_rest: Vec3) -> bool {
        matches!(self.entry, Entry::Through(_)) && to_rest.horizontal_norm() < ON_PATH_M
    }

    /// Returns true if a released object may stay where it is, although its box is not entirely in
    /// a covered region: the door pushes it further.
    pub(crate) fn can_stay(&self, object: &Entity) -> bool {
        let to_rest = self.rest - object.pos;
        self.can_release_blocked(to_rest) && object.bottom() < self.floor + COVERED_FLOOR_GAP_M
    }

    /// Returns true if the object is so low that the target may carry it. The surface of a fixture
    /// may be a little higher than its region.
    pub(crate) fn is_at_brim(&self, object: &Entity) -> bool {
        object.bottom() < self.brim + CARRY_M + 2.0 * AT_PLACE_M
    }

    pub(crate) fn can_release(&self, world: &World, object: &Entity) -> bool {
        match self.entry {
            Entry::Onto => object.bottom() < self.floor + AT_PLACE_M,
            Entry::Into => {
                let are_fingers_at_brim = world.grip.z - FINGERTIP_M < self.brim + AT_PLACE_M;
                object.bottom() < self.rest.z + AT_PLACE_M || are_fingers_at_brim
            }
            Entry::Through(out) => (object.pos - self.rest).dot(out) < AT_PLACE_M,
        }
    }

    pub(crate) fn way_out(&self) -> Vec3 {
        match self.entry {
            Entry::Onto | Entry::Into => Vec3::UP,
            Entry::Through(out) => out,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::expert::kinematic_scene::{KinematicScene, MUG_M};

    fn scene() -> KinematicScene {
        KinematicScene::mug_before_oven().object("plate_1", [0.3, 0.0, 0.01], [0.07, 0.07, 0.01])
    }

    fn place(relation: Relation, target: &str, slot: f64) -> Place {
        Place { relation, target: target.to_owned(), slot }
    }

    fn spot(place: &Place) -> Spot {
        let world = scene().world();
        place.spot(&world, world.entity("mug_1").unwrap()).unwrap()
    }

    #[test]
    fn an_object_descends_straight_onto_the_middle_of_its_plate() {
        let spot = spot(&place(Relation::On, "plate_1", 0.0));
        assert_eq!((spot.approach_start.x, spot.approach_start.y), (0.3, 0.0));
        assert!(spot.approach_start.z > 0.02 && spot.rest.z <= 0.0, "{spot:?}");
        assert_eq!(spot.way_out(), Vec3::UP);
    }

    #[test]
    fn neighbours_on_one_target_do_not_touch() {
        let [left, right] = [-1.0, 1.0].map(|slot| spot(&place(Relation::On, "plate_1", slot)));
        assert!((left.rest - right.rest).horizontal_norm() > 2.0 * MUG_M[0]);
    }

    #[test]
    fn a_covered_region_is_reached_through_its_open_front() {
        let inside = place(Relation::In, "oven_1_inside", 0.0);
        let spot = spot(&inside);
        assert!(spot.approach_start.y < 0.3 && spot.rest.y > 0.32, "{spot:?}");
        assert_eq!(spot.approach_start.z, spot.rest.z);
        assert_eq!(spot.way_out(), Vec3::new(0.0, -1.0, 0.0));
        assert_eq!(inside.grasp_requirement(&scene().world()), Ok(GraspRequirement::Handle));
    }
}
