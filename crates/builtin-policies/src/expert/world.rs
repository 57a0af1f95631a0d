//! The simulator's state as observed by the expert: validated once, with lookup by name.

use benchmark::{EntityKind, Predicate, Privileged};

use crate::expert::ExpertError;
use crate::expert::geometry::{Quat, Vec3};

#[derive(Clone, Debug)]
pub(crate) struct Entity {
    pub(crate) name: String,
    pub(crate) kind: EntityKind,
    /// Category of an object or fixture; for a region, the name of the object or fixture that
    /// carries the region.
    pub(crate) category: String,
    /// Origin of the body, which goal predicates measure.
    pub(crate) pos: Vec3,
    pub(crate) quat: Quat,
    /// World-aligned box of the collision geometry; for a region, its box along its own axes.
    pub(crate) centre: Vec3,
    pub(crate) half: Vec3,
}

impl Entity {
    pub(crate) fn top(&self) -> f64 {
        self.centre.z + self.half.z
    }

    pub(crate) fn bottom(&self) -> f64 {
        self.centre.z - self.half.z
    }

    pub(crate) fn is_region(&self) -> bool {
        self.kind == EntityKind::Site
    }

    /// Half extent along the world direction `way`.
    pub(crate) fn extent_along(&self, way: Vec3) -> f64 {
        if self.is_region() {
            self.quat.inverse().rotate(way).abs().dot(self.half)
        } else {
            way.abs().dot(self.half)
        }
    }

    /// Half extent along the vertical in the current orientation.
    pub(crate) fn upright_half_height(&self) -> f64 {
        self.extent_along(Vec3::UP)
    }

    /// Transforms `p` into a region's own frame.
    pub(crate) fn local(&self, p: Vec3) -> Vec3 {
        self.quat.inverse().rotate(p - self.pos)
    }
}

#[derive(Clone, Debug)]
pub(crate) struct World {
    entities: Vec<Entity>,
    joints: Vec<(String, f64)>,
    solids: Vec<Solid>,
    pub(crate) goal: Vec<Predicate>,
    /// Point between the fingertips.
    pub(crate) grip: Vec3,
    /// Orientation of the hand; x: closing direction, z: pointing direction of the fingers.
    pub(crate) grip_quat: Quat,
    /// Distance between the fingers, m.
    pub(crate) opening: f64,
    /// Position of the arm's shoulder, computed for a hand at rest. The robot's base is not
    /// observed, so the expert keeps the first value of an episode.
    pub(crate) shoulder: Vec3,
}

/// Position of the shoulder relative to the grip point at rest, m. LIBERO's robots face the
/// world's x.
const SHOULDER_FROM_REST: Vec3 = Vec3::new(-0.45, 0.0, 0.071);
/// Position of the wrist relative to the grip point of a hand that points down: up, and back
/// towards the shoulder, m (the Panda's flange and seventh link).
const WRIST_UP_M: f64 = 0.204;
const WRIST_BACK_M: f64 = 0.088;
/// Distance of the wrist from the shoulder beyond which the arm is nearly stretched, a
/// configuration that the controller leaves only with difficulty, m; at 0.70 the elbow is
/// straight.
const COMFORTABLE_REACH_M: f64 = 0.65;

/// Largest coordinate or extent, m: LIBERO's rooms are a few metres wide.
const LARGEST_M: f64 = 100.0;
/// Largest position of a joint, rad or m: a knob may make some turns.
const LARGEST_JOINT: f64 = 100.0;
/// Largest component of a unit quaternion, with a margin for rounding.
const LARGEST_OF_UNIT: f64 = 1.001;
/// Largest number of objects, fixtures and regions of a scene.
const MAX_ENTITIES: usize = 1_000;

impl World {
    pub(crate) fn read(state: &Privileged) -> Result<Self, ExpertError> {
        if state.entities.len() > MAX_ENTITIES {
            return Err(ExpertError::Entities { given: state.entities.len(), most: MAX_ENTITIES });
        }
        let mut entities = Vec::with_capacity(state.entities.len());
        for e in &state.entities {
            entities.push(Entity {
                name: e.name.clone(),
                kind: e.kind,
                category: e.category.clone(),
                pos: vec3(&e.pos, &e.name, "pos")?,
                quat: quat(&e.quat_wxyz, &e.name)?,
                centre: vec3(&e.centre, &e.name, "centre")?,
                half: vec3(&e.half_extents, &e.name, "half_extents")?,
            });
        }
        for (name, position) in &state.joints {
            check_range(&[*position], LARGEST_JOINT, name, "position")?;
        }
        let opening = state.gripper_opening;
        check_range(&[opening], LARGEST_M, "gripper", "gripper_opening")?;
        let grip = vec3(&state.grip_pos, "gripper", "grip_pos")?;
        let mut world = Self {
            entities,
            solids: Vec::new(),
            joints: state.joints.clone(),
            goal: state.goal.clone(),
            grip,
            shoulder: grip + SHOULDER_FROM_REST,
            grip_quat: quat(&state.grip_quat_wxyz, "gripper")?,
            opening,
        };
        world.solids = solids(&world);
        Ok(world)
    }

    pub(crate) fn entity(&self, name: &str) -> Result<&Entity, ExpertError> {
        let found = self.entities.iter().find(|e| e.name == name);
        found.ok_or_else(|| ExpertError::NoEntity { name: name.to_owned() })
    }

    /// Returns the position of a joint, rad or m.
    pub(crate) fn joint(&self, name: &str) -> Result<f64, ExpertError> {
        let found = self.joints.iter().find(|(n, _)| n == name);
        found.map(|j| j.1).ok_or_else(|| ExpertError::NoJointNamed { name: name.to_owned() })
    }

    pub(crate) fn joints_of(&self, owner: &str) -> impl Iterator<Item = &str> {
        let prefix = format!("{owner}_");
        self.joints.iter().map(|j| j.0.as_str()).filter(move |n| n.starts_with(&prefix))
    }

    /// Position of the grip point when the arm is at rest.
    pub(crate) fn rest(&self) -> Vec3 {
        self.shoulder - SHOULDER_FROM_REST
    }

    /// Distance by which the arm exceeds its comfortable reach with the hand pointing
    /// down at `grip`, m; 0 within the reach.
    pub(crate) fn overstretch(&self, grip: Vec3) -> f64 {
        let from_shoulder = grip - self.shoulder;
        let across = from_shoulder.horizontal_norm() - WRIST_BACK_M;
        let reach = across.hypot(from_shoulder.z + WRIST_UP_M);
        (reach - COMFORTABLE_REACH_M).max(0.0)
    }

    /// Distance of the grip point from the object's box, m; negative inside the box.
    pub(crate) fn gap_to(&self, object: &Entity) -> f64 {
        ((self.grip - object.centre).abs() - object.half).max_coordinate()
    }

    /// Returns the objects whose boxes, enlarged by `margin` m, contain the grip point.
    pub(crate) fn objects_at_grip(&self, margin: f64) -> impl Iterator<Item = &Entity> {
        let objects = self.entities.iter().filter(|e| e.kind == EntityKind::Object);
        objects.filter(move |e| self.gap_to(e) < margin)
    }

    /// Returns the horizontal direction out of the cabinet's front if the hand is at a drawer's
    /// handle with its fingers towards the cabinet, at most `away` m in front of or behind the
    /// handle.
    pub(crate) fn handle_at_grip(&self, away: f64) -> Option<Vec3> {
        let pointing = self.grip_quat.rotate(Vec3::UP);
        self.regions().find_map(|region| {
            let out = self.front_of_drawer(region)?;
            let handle = region.pos + out * HANDLE_OUT_M + Vec3::UP * HANDLE_UP_M;
            let from = self.grip - handle;
            let along = from.dot(out);
            let beside = (from - out * along - Vec3::UP * from.z).norm();
            let (across, reach) = HANDLE_HALF_M;
            let is_at_handle = along.abs() < away && from.z.abs() < 2.0 * across && beside < reach;
            // The fingers point within about 45° of the direction into the cabinet.
            (is_at_handle && pointing.dot(out) < -0.7).then_some(out)
        })
    }

    pub(crate) fn solids(&self) -> &[Solid] {
        &self.solids
    }

    pub(crate) fn regions(&self) -> impl Iterator<Item = &Entity> {
        self.entities.iter().filter(|e| e.is_region())
    }

    /// Returns the horizontal direction out of the cabinet's front if `region` is in a drawer.
    pub(crate) fn front_of_drawer(&self, region: &Entity) -> Option<Vec3> {
        let joint = drawer_joint(&region.name)?;
        self.joint(&joint).ok()?;
        Some(front(self.entity(&region.category).ok()?))
    }

    /// Returns the horizontal direction out of the fixture's open front if the fixture covers
    /// `region`, so that only the front gives access.
    pub(crate) fn front_of_cover(&self, region: &Entity) -> Option<Vec3> {
        let cover = self.entity(&top_side(&region.category)).ok()?;
        let beneath = cover.local(region.pos.at_height(cover.pos.z)).abs() - cover.half;
        let is_covered = beneath.max_coordinate() < 0.0 && region.pos.z < cover.pos.z;
        let is_in_drawer = self.front_of_drawer(region).is_some();
        (is_covered && !is_in_drawer).then(|| self.entity(&region.category).ok().map(front))?
    }
}

/// Returns the name of the joint of the drawer that contains `region`, by LIBERO's naming.
pub(crate) fn drawer_joint(region: &str) -> Option<String> {
    region.strip_suffix("_region").map(|drawer| format!("{drawer}_level"))
}

/// Returns the name of the region on top of `fixture`, by LIBERO's naming.
fn top_side(fixture: &str) -> String {
    format!("{fixture}_top_side")
}

/// Returns the direction out of a fixture's front: LIBERO's cabinets and microwave open along
/// their own -y.
fn front(fixture: &Entity) -> Vec3 {
    fixture.quat.rotate(Vec3::new(0.0, -1.0, 0.0))
}

/// Thickness of a drawer's walls around its region, m.
const DRAWER_WALL_M: f64 = 0.01;
/// Position of a drawer's handle bar relative to the centre of its region, out of the
/// cabinet's front and up, and half extents across and along the bar, m (the same for
/// LIBERO's two cabinets).
pub(crate) const HANDLE_OUT_M: f64 = 0.113;
pub(crate) const HANDLE_UP_M: f64 = -0.0045;
const HANDLE_HALF_M: (f64, f64) = (0.012, 0.048);

#[derive(Clone, Debug)]
pub(crate) struct Solid {
    pub(crate) owner: String,
    pub(crate) centre: Vec3,
    pub(crate) quat: Quat,
    /// Half extents along the box's own axes.
    pub(crate) half: Vec3,
}

impl Solid {
    pub(crate) fn top(&self) -> f64 {
        self.centre.z + self.half_height()
    }

    pub(crate) fn bottom(&self) -> f64 {
        self.centre.z - self.half_height()
    }

    fn half_height(&self) -> f64 {
        self.quat.inverse().rotate(Vec3::UP).abs().dot(self.half)
    }

    /// Distance of `p` from the box along the axis of greatest separation, m; negative inside the
    /// box.
    pub(crate) fn gap(&self, p: Vec3) -> f64 {
        let offset = self.quat.inverse().rotate(p - self.centre);
        (offset.abs() - self.half).max_coordinate()
    }

    /// Horizontal distance of `p` from the box, measured as in [`Self::gap`].
    pub(crate) fn gap_from_above(&self, p: Vec3) -> f64 {
        self.gap(p.at_height(self.centre.z))
    }

    /// Returns true if, seen from above, the box overlaps the rectangle around `p` with the
    /// two perpendicular horizontal half axes `reach`, by the separating axis theorem.
    pub(crate) fn overlaps_from_above(&self, p: Vec3, reach: [Vec3; 2]) -> bool {
        let inward = self.quat.inverse();
        let offset = inward.rotate((p - self.centre).at_height(0.0));
        let [a, b] = reach.map(|r| inward.rotate(r));
        let separation = offset.abs() - self.half - a.abs() - b.abs();
        let is_separating = |r: Vec3| offset.dot(r).abs() > r.dot(r) + r.abs().dot(self.half);
        separation.max_coordinate() < 0.0 && !is_separating(a) && !is_separating(b)
    }
}

/// Returns the obstacles of a scene. The bounding box of a cabinet with an open drawer covers
/// free space beside the drawer, so cabinets are split into the body under the top, each
/// drawer, and each handle.
fn solids(world: &World) -> Vec<Solid> {
    let mut solids = Vec::new();
    for e in world.entities.iter().filter(|e| !e.is_region()) {
        let parts = world.regions().filter(|r| r.category == e.name);
        let drawers = parts.filter_map(|r| Some((r, world.front_of_drawer(r)?)));
        let drawers: Vec<Solid> = drawers.flat_map(|(r, out)| drawer(e, r, out)).collect();
        let whole =
            Solid { owner: e.name.clone(), centre: e.centre, quat: Quat::IDENTITY, half: e.half };
        match world.entity(&top_side(&e.name)) {
            Ok(top) if !drawers.is_empty() => {
                let centre = top.pos.at_height(e.centre.z);
                let half = top.half.at_height(e.half.z);
                solids.push(Solid { centre, quat: top.quat, half, ..whole });
                solids.extend(drawers);
            }
            _ => solids.push(whole),
        }
    }
    solids
}

fn drawer(cabinet: &Entity, region: &Entity, out: Vec3) -> [Solid; 2] {
    let wall = Vec3::new(DRAWER_WALL_M, DRAWER_WALL_M, DRAWER_WALL_M);
    let (across, along) = HANDLE_HALF_M;
    let handle = Solid {
        owner: cabinet.name.clone(),
        centre: region.pos + out * HANDLE_OUT_M + Vec3::UP * HANDLE_UP_M,
        quat: cabinet.quat,
        half: Vec3::new(along, across, across),
    };
    let (centre, half) = (region.pos, region.half + wall);
    [Solid { centre, quat: region.quat, half, ..handle.clone() }, handle]
}

/// Checks that the magnitudes of values are at most `largest`. Paths are sampled every few
/// centimetres, so that planning to an absurdly distant point would take minutes.
fn check_range(
    values: &[f64],
    largest: f64,
    owner: &str,
    field: &'static str,
) -> Result<(), ExpertError> {
    // NaN fails the comparison.
    let is_within = |value: &f64| value.abs() <= largest;
    match values.iter().find(|value| !is_within(value)) {
        Some(value) => {
            Err(ExpertError::OutOfRange { field, owner: owner.to_owned(), value: *value })
        }
        None => Ok(()),
    }
}

fn vec3(values: &[f64; 3], owner: &str, field: &'static str) -> Result<Vec3, ExpertError> {
    check_range(values, LARGEST_M, owner, field)?;
    let [x, y, z] = *values;
    Ok(Vec3::new(x, y, z))
}

fn quat(values: &[f64; 4], owner: &str) -> Result<Quat, ExpertError> {
    check_range(values, LARGEST_OF_UNIT, owner, "quat")?;
    let [w, x, y, z] = *values;
    let v = Vec3::new(x, y, z);
    Ok(Quat { w, v })
}
