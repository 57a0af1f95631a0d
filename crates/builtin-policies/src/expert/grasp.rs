//! Grasp selection: across the object's narrow side if the hand spans it, otherwise at its
//! rim. Uses the geometry of bounding boxes only; exceptions for categories with misleading
//! boxes are in [`KNOBS`] and [`HANDLES`].

use std::f64::consts::{FRAC_PI_2, PI};

use crate::expert::geometry::{Footprint, Vec3, footprint, half_turn, lean};
use crate::expert::motion::FINGERTIP_M;
use crate::expert::world::{Entity, Solid, World};

/// Largest width of a body that is pinched across, m: the hand opens to 0.08 m, minus a
/// margin on both sides.
const PINCH_WIDTH_M: f64 = 0.072;
/// Depth of the grip point below an object's top when pinching, m: less than the height of the
/// palm above the grip point, see [`HAND`].
const PINCH_DEPTH_M: f64 = 0.025;
/// Depth of the grip point below an object's top when gripping a rim, m.
const RIM_DEPTH_M: f64 = 0.014;
/// Distances of the grip point inside the side of the box when gripping a rim, m. A larger distance
/// keeps the outer finger away from the wall of a container around the object; the closing fingers
/// then pull the rim to their centre.
const RIM_INSETS_M: [f64; 3] = [0.006, 0.016, 0.026];
/// Clearance of the fingertips above the object's support, m.
const FLOOR_GAP_M: f64 = 0.004;
/// Number of rim points tried around a round body.
const RIM_POINTS: u32 = 24;
/// Ratio of length to width above which a body is assumed to have a handle along its length,
/// so that it is held only at its two long sides.
const ROUND_RATIO: f64 = 1.12;
/// Pinch positions relative to an object's centre, as shares of half its wide side; positions off
/// the centre avoid neighbours.
const PINCH_POSITIONS: [f64; 5] = [0.0, 0.25, -0.25, 0.5, -0.5];
/// Reach of an open finger from the grip point, m.
const FINGER_REACH_M: f64 = 0.058;
// Penalties of a grasp, each converted to an equivalent rotation of the hand.

/// Penalty on a closing direction a quarter turn from the required direction, rad.
const ASKEW_WEIGHT: f64 = 3.0;
/// Penalty on each part of the hand in collision, rad.
const COLLISION_WEIGHT: f64 = 4.0;
/// Penalty on the depth of a finger in a wall, rad per m.
const WALL_WEIGHT: f64 = 140.0;
/// Penalty on the distance of the grip point beyond the arm's reach, rad per m.
const STRETCH_WEIGHT: f64 = 60.0;
/// Penalty on a grip point on the low side of a tilted body, rad per m and sine of the tilt.
const TILT_WEIGHT: f64 = 150.0;
/// Penalty on the hand's distance from a grasp, rad per m.
const AWAY_WEIGHT: f64 = 6.0;
/// Distance of the hand from a grasp beyond which the penalty does not increase, m.
const AWAY_M: f64 = 0.15;
/// Penalty on the inset of a rim grasp beyond the smallest inset, rad per m.
const INSET_WEIGHT: f64 = 10.0;
/// Penalty on a change of grasp, rad.
const CHANGE_COST: f64 = 0.5;
/// Penalty on a grasp that the hand could not reach, rad: as for three parts in collision.
const BLOCKED_COST: f64 = 12.0;
/// Largest distances, m and rad, of two grasps that count as the same grasp.
const ALIKE_M: f64 = 0.02;
const ALIKE_RAD: f64 = 0.3;

/// A part of the open hand as a box, relative to the grip point, m (Panda hand of robosuite
/// 1.4.0).
struct Part {
    /// Position of the centre along the closing direction.
    at: f64,
    /// Half sizes along and across the closing direction.
    half: (f64, f64),
    /// Height of the lower end.
    bottom: f64,
}

const HAND: [Part; 4] = [
    Part { at: -0.052, half: (0.0135, 0.0105), bottom: -FINGERTIP_M },
    Part { at: 0.052, half: (0.0135, 0.0105), bottom: -FINGERTIP_M },
    Part { at: 0.0, half: (0.102, 0.019), bottom: 0.031 },
    Part { at: 0.0, half: (0.05, 0.05), bottom: 0.123 },
];

/// Categories held by a knob on top, above the body's origin, with the depth of the grip
/// point below the top of the knob, m.
const KNOBS: [(&str, f64); 1] = [("moka_pot", 0.006)];

/// Categories with an upright handle, with the direction of the handle in body axes.
const HANDLES: [(&str, Vec3); 1] = [("white_yellow_mug", Vec3::new(1.0, 0.0, 0.0))];
/// Horizontal distance of the grip point from the outer end of the handle, m.
const HANDLE_INSET_M: f64 = 0.01;
/// Depth of the grip point below the top of an object that is held by its handle, m.
const HANDLE_DEPTH_M: f64 = 0.042;

/// Pose of the hand at an object, relative to the object.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Grasp {
    /// Grip point from the centre of the object's box, world axes, m.
    pub(crate) offset: Vec3,
    /// Closing direction, rad from the world's x axis.
    pub(crate) closing: f64,
    /// Part of the cost that does not depend on the object's position, rad.
    strain: f64,
}

impl Grasp {
    /// Returns true if the two grasps differ so little that they count as one grasp, chosen twice
    /// for an object that may have moved a little in between.
    fn is_like(&self, other: &Self) -> bool {
        let turned = half_turn(self.closing - other.closing).abs();
        (self.offset - other.offset).norm() <= ALIKE_M && turned <= ALIKE_RAD
    }
}

/// Requirement of the object's destination on the grasp.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum GraspRequirement {
    Any,
    /// The closing direction is perpendicular to this horizontal direction.
    Across(Vec3),
    /// The hand holds the object by its handle and stays beside it.
    Handle,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Purpose<'a> {
    pub(crate) requirement: GraspRequirement,
    /// Destination of the object: horizontal position of its origin, height of its lowest point.
    pub(crate) destination: Vec3,
    /// Object or fixture at the destination, which the hand may touch.
    pub(crate) owner: &'a str,
}

/// Returns all grasps of `object` in ascending order of cost. Good grasps rotate the hand
/// little, collide with no neighbour, have room beside the rim, and are within the arm's reach
/// at the object and at the destination.
pub(crate) fn choices(world: &World, object: &Entity, purpose: Purpose<'_>) -> Vec<Grasp> {
    let shape = footprint(object.quat, object.half);
    let handle = HANDLES.iter().find(|h| h.0 == object.category);
    let mut all = if let (GraspRequirement::Handle, Some((_, way))) = (purpose.requirement, handle)
    {
        vec![by_handle(object, shape, object.quat.rotate(*way))]
    } else if let Some((_, depth)) = KNOBS.iter().find(|k| k.0 == object.category) {
        vec![knob(object, shape, *depth)]
    } else if 2.0 * shape.narrow <= PINCH_WIDTH_M {
        pinches(object, shape)
    } else {
        rims(object, shape)
    };
    let rank = |grasp: &Grasp| cost(world, object, purpose, grasp);
    all.sort_by(|a, b| rank(a).total_cmp(&rank(b)));
    all
}

/// Returns the best grasp of `object` for the current position of the hand: ranked like
/// [`choices`], with penalties on the distance from the hand and on a change from `earlier`, so
/// that the choice does not oscillate. A grasp like `blocked`, which the hand could not reach, has
/// a high penalty.
///
/// `None` if there is no grasp.
pub(crate) fn nearest(
    world: &World,
    object: &Entity,
    purpose: Purpose<'_>,
    earlier: Option<&Grasp>,
    blocked: Option<&Grasp>,
) -> Option<Grasp> {
    let rank = |grasp: &Grasp| {
        let away = (object.centre + grasp.offset - world.grip).horizontal_norm();
        let is_changed = earlier.is_none_or(|earlier| !earlier.is_like(grasp));
        let change_cost = if is_changed { CHANGE_COST } else { 0.0 };
        let is_blocked = blocked.is_some_and(|blocked| blocked.is_like(grasp));
        let blocked_cost = if is_blocked { BLOCKED_COST } else { 0.0 };
        let away_cost = AWAY_WEIGHT * away.min(AWAY_M);
        cost(world, object, purpose, grasp) + away_cost + change_cost + blocked_cost
    };
    let ranked = choices(world, object, purpose).into_iter();
    let ranked = ranked.map(|grasp| (rank(&grasp), grasp));
    ranked.min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, grasp)| grasp)
}

fn knob(object: &Entity, shape: Footprint, depth: f64) -> Grasp {
    let above_origin = object.pos - object.centre;
    let offset = above_origin.at_height(object.half.z - depth);
    Grasp { offset, closing: shape.narrow_angle, strain: 0.0 }
}

fn by_handle(object: &Entity, shape: Footprint, direction: Vec3) -> Grasp {
    Grasp {
        offset: (direction * (shape.wide - HANDLE_INSET_M))
            .at_height(object.half.z - HANDLE_DEPTH_M),
        closing: direction.y.atan2(direction.x) + FRAC_PI_2,
        strain: 0.0,
    }
}

fn pinches(object: &Entity, shape: Footprint) -> Vec<Grasp> {
    let height = grip_height(object, PINCH_DEPTH_M);
    let along = Vec3::heading(shape.narrow_angle + FRAC_PI_2) * shape.wide;
    let across = PINCH_POSITIONS.map(|share| Grasp {
        offset: (along * share).at_height(height),
        closing: shape.narrow_angle,
        // Up to 0.5 rad, at the outermost positions.
        strain: share.abs(),
    });
    let mut all = across.to_vec();
    if 2.0 * shape.wide <= PINCH_WIDTH_M {
        all.push(Grasp { closing: shape.narrow_angle + FRAC_PI_2, ..across[0] });
    }
    all
}

fn rims(object: &Entity, shape: Footprint) -> Vec<Grasp> {
    let height = grip_height(object, RIM_DEPTH_M);
    let angles: Vec<f64> = if shape.wide > ROUND_RATIO * shape.narrow {
        vec![shape.narrow_angle, shape.narrow_angle + PI]
    } else {
        (0..RIM_POINTS).map(|i| 2.0 * PI * f64::from(i) / f64::from(RIM_POINTS)).collect()
    };
    let at = |angle: f64| {
        RIM_INSETS_M.map(|inset| Grasp {
            offset: (Vec3::heading(angle) * (shape.narrow - inset)).at_height(height),
            closing: angle,
            strain: INSET_WEIGHT * (inset - RIM_INSETS_M[0]),
        })
    };
    angles.into_iter().flat_map(at).collect()
}

fn grip_height(object: &Entity, depth: f64) -> f64 {
    let lowest = FINGERTIP_M + FLOOR_GAP_M - object.half.z;
    (object.half.z - depth).max(lowest)
}

/// Cost of a grasp, in equivalent radians of hand rotation.
fn cost(world: &World, object: &Entity, purpose: Purpose<'_>, grasp: &Grasp) -> f64 {
    // The hand at rest closes along the world's y.
    let turning = half_turn(grasp.closing - FRAC_PI_2).abs();
    let askew = match purpose.requirement {
        GraspRequirement::Across(way) => ASKEW_WEIGHT * Vec3::heading(grasp.closing).dot(way).abs(),
        GraspRequirement::Any | GraspRequirement::Handle => 0.0,
    };
    // Grip points at the object and at the destination.
    let at_object = object.centre + grasp.offset;
    let at_destination = (purpose.destination + at_object - object.pos)
        .at_height(purpose.destination.z + at_object.z - object.bottom());
    // A solid around the object's centre is its container, whose walls `into_wall` checks.
    let is_neighbour = |solid: &Solid| solid.owner != object.name && solid.gap(object.centre) > 0.0;
    let is_in_the_way = |solid: &Solid| solid.owner != object.name && solid.owner != purpose.owner;
    let collisions = COLLISION_WEIGHT
        * (collisions(world, at_object, grasp.closing, is_neighbour)
            + collisions(world, at_destination, grasp.closing, is_in_the_way)) as f64;
    let into_wall = WALL_WEIGHT * into_wall(world, object, grasp);
    let stretch =
        STRETCH_WEIGHT * (world.overstretch(at_object) + world.overstretch(at_destination));
    let downhill = TILT_WEIGHT * lean(object.quat).dot(grasp.offset);
    turning + askew + grasp.strain + collisions + into_wall + stretch + downhill
}

/// Returns the number of collisions between parts of the open hand and the solids selected by
/// `among`, with the grip point at `grip`.
fn collisions(world: &World, grip: Vec3, closing: f64, among: impl Fn(&Solid) -> bool) -> usize {
    let (along, across) = (Vec3::heading(closing), Vec3::heading(closing + FRAC_PI_2));
    let hits = |part: &Part, solid: &Solid| {
        let reach = [along * part.half.0, across * part.half.1];
        let is_above = grip.z + part.bottom > solid.top();
        !is_above && solid.overlaps_from_above(grip + along * part.at, reach)
    };
    let solids = world.solids().iter().filter(|solid| among(solid));
    solids.map(|solid| HAND.iter().filter(|part| hits(part, solid)).count()).sum()
}

/// Returns the depth, m, by which the outer finger would penetrate the wall of the container
/// that holds the object. The inside of a fixture is given by its regions, not by its box.
fn into_wall(world: &World, object: &Entity, grasp: &Grasp) -> f64 {
    let outward = grasp.offset.at_height(0.0);
    if outward.norm() < RIM_INSETS_M[0] {
        return 0.0;
    }
    let finger = object.centre + outward * (1.0 + FINGER_REACH_M / outward.norm());
    let outside = |region: &Entity, p: Vec3| (region.local(p).abs() - region.half).max_coordinate();
    let containers = world.regions().filter(|r| outside(r, object.centre) < 0.0);
    containers.map(|r| outside(r, finger)).fold(0.0, f64::max)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::expert::geometry::Quat;
    use crate::expert::kinematic_scene::KinematicScene;

    const BOX: [f64; 3] = [0.04, 0.02, 0.03];
    const BOWL: [f64; 3] = [0.054, 0.054, 0.025];

    fn scene() -> KinematicScene {
        KinematicScene::new("on", &["thing", "plate"])
    }

    fn best(scene: &KinematicScene, requirement: GraspRequirement) -> Grasp {
        let purpose =
            Purpose { requirement, destination: Vec3::new(-0.2, 0.0, 0.0), owner: "plate" };
        let world = scene.world();
        choices(&world, world.entity("thing").unwrap(), purpose)[0]
    }

    fn parallel(a: f64, b: f64) -> bool {
        half_turn(a - b).abs() < 1e-6
    }

    #[test]
    fn a_box_is_pinched_in_the_middle_across_its_narrow_side() {
        let grasp = best(&scene().object("thing", [0.0, 0.0, 0.03], BOX), GraspRequirement::Any);
        assert!(parallel(grasp.closing, FRAC_PI_2), "{grasp:?}");
        assert!(grasp.offset.horizontal_norm() < 1e-9, "{grasp:?}");
    }

    #[test]
    fn fingers_that_reach_for_a_flat_box_stay_above_its_support() {
        let flat = [0.04, 0.02, 0.009];
        let grasp = best(&scene().object("thing", [0.0, 0.0, 0.009], flat), GraspRequirement::Any);
        let lowest = 0.009 + grasp.offset.z - FINGERTIP_M;
        assert!((lowest - FLOOR_GAP_M).abs() < 1e-9, "{grasp:?}");
    }

    #[test]
    fn a_bowl_is_held_at_its_rim_with_the_fingers_on_both_sides_of_it() {
        let grasp = best(&scene().object("thing", [0.0, 0.0, 0.025], BOWL), GraspRequirement::Any);
        let radius = grasp.offset.horizontal_norm();
        assert!((radius - (BOWL[0] - RIM_INSETS_M[0])).abs() < 1e-9, "{grasp:?}");
        assert!(parallel(grasp.closing, grasp.offset.y.atan2(grasp.offset.x)));
    }

    #[test]
    fn a_mug_is_held_at_its_sides_and_not_where_its_handle_is() {
        let mug = [0.05, 0.07, 0.05];
        let grasp = best(&scene().object("thing", [0.0, 0.0, 0.05], mug), GraspRequirement::Any);
        assert!(grasp.offset.y.abs() < 1e-9 && grasp.offset.x.abs() > 0.04, "{grasp:?}");
    }

    #[test]
    fn a_neighbour_drives_the_grasp_to_the_other_side_of_the_rim() {
        for side in [-1.0, 1.0] {
            let scene = scene().object("thing", [0.0, 0.0, 0.025], BOWL).object(
                "bottle",
                [0.0, side * 0.1, 0.07],
                [0.03, 0.03, 0.07],
            );
            let grasp = best(&scene, GraspRequirement::Any);
            assert!(grasp.offset.y * side < 0.0, "{side}: {grasp:?}");
        }
    }

    #[test]
    fn a_neighbour_of_a_box_moves_the_pinch_off_its_centre() {
        // At the centre, the palm would hit the bottle.
        let scene = scene().object("thing", [0.0, 0.0, 0.009], [0.04, 0.02, 0.009]).object(
            "bottle",
            [0.035, 0.1, 0.07],
            [0.022, 0.03, 0.07],
        );
        let grasp = best(&scene, GraspRequirement::Any);
        assert!(grasp.offset.x < -0.005, "{grasp:?}");
    }

    #[test]
    fn a_bowl_in_a_drawer_is_held_where_the_outer_finger_clears_the_drawer_wall() {
        let scene = scene().object("thing", [0.0, 0.0, 0.925], BOWL).region(
            "in_drawer",
            "cabinet_1",
            [0.0, 0.0, 0.925],
            [0.15, 0.075, 0.03],
        );
        let grasp = best(&scene, GraspRequirement::Any);
        let reach = grasp.offset * (1.0 + FINGER_REACH_M / grasp.offset.horizontal_norm());
        assert!(reach.x.abs() < 0.155 && reach.y.abs() < 0.08, "{grasp:?}");
    }

    #[test]
    fn an_across_requirement_keeps_the_closing_direction_parallel_to_the_front() {
        let scene = scene().object("thing", [0.0, 0.0, 0.025], BOWL);
        let grasp = best(&scene, GraspRequirement::Across(Vec3::new(0.0, 1.0, 0.0)));
        assert!(parallel(grasp.closing, 0.0), "{grasp:?}");
    }

    #[test]
    fn a_tilted_bowl_is_held_at_the_high_side_of_its_rim() {
        let mut scene = scene().object("thing", [0.0, 0.0, 0.03], BOWL);
        let tilt = Quat::turn(Vec3::new(1.0, 0.0, 0.0), 0.3);
        scene.state.entities[0].quat_wxyz = [tilt.w, tilt.v.x, tilt.v.y, tilt.v.z];
        // The rotation about x has raised the side at +y.
        let grasp = best(&scene, GraspRequirement::Any);
        assert!(grasp.offset.y > 0.03, "{grasp:?}");
    }

    #[test]
    fn a_distant_bowl_is_held_at_the_side_of_its_rim_nearest_the_robot() {
        // The hand rests 0.45 m in front of the robot.
        let scene = scene().object("thing", [0.33, 0.0, 0.025], BOWL);
        let grasp = best(&scene, GraspRequirement::Any);
        assert!(grasp.offset.x < -0.03, "{grasp:?}");
    }
}
