//! The simulator's state as the expert reads it: checked once, then
//! looked up by name. Not responsible for deciding anything.

use libero_ctrl::{EntityKind, Predicate, Privileged};

use crate::geometry::{Quat, Vec3};

/// An object, a fixture or a region.
#[derive(Clone, Debug)]
pub(crate) struct Entity {
    pub(crate) name: String,
    pub(crate) kind: EntityKind,
    /// Category of an object or fixture; of a region, the instance it is on.
    pub(crate) category: String,
    /// Origin of the body, which is what goal predicates measure.
    pub(crate) pos: Vec3,
    pub(crate) quat: Quat,
    /// World-aligned box of the collision geometry; of a region, its size
    /// along its own axes.
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

    /// Half height, whichever of its axes points up.
    pub(crate) fn upright_half_height(&self) -> f64 {
        self.extent_along(Vec3::UP)
    }

    /// `p` in a region's own axes, from its centre.
    pub(crate) fn local(&self, p: Vec3) -> Vec3 {
        self.quat.inverse().rotate(p - self.pos)
    }
}

/// One instant of the simulation.
#[derive(Clone, Debug)]
pub(crate) struct World {
    entities: Vec<Entity>,
    joints: Vec<(String, f64)>,
    solids: Vec<Solid>,
    pub(crate) goal: Vec<Predicate>,
    /// Point between the fingertips.
    pub(crate) grip: Vec3,
    /// x: closing direction, z: where the fingers point.
    pub(crate) grip_quat: Quat,
    /// Distance between the fingers, m.
    pub(crate) opening: f64,
    /// The arm's shoulder, if the hand is at rest. The robot's base is not
    /// observed: the expert keeps the first one of an episode.
    pub(crate) shoulder: Vec3,
}

/// The shoulder from the grip point at rest: LIBERO's robots face the world's
/// x and rest with the hand that far in front, m.
const SHOULDER_FROM_REST: Vec3 = Vec3::new(-0.45, 0.0, 0.071);
/// With the hand pointing down, the wrist from the grip point: up, and back
/// towards the shoulder, m (the Panda's flange and seventh link).
const WRIST_UP_M: f64 = 0.204;
const WRIST_BACK_M: f64 = 0.088;
/// A wrist further from the shoulder than this comes near the stretched arm,
/// which the controller does not get out of well, m; at 0.70 the elbow is
/// straight.
const COMFORTABLE_REACH_M: f64 = 0.65;

/// Largest coordinate or extent, m: LIBERO's rooms are a few metres wide.
const LARGEST_M: f64 = 100.0;
/// Largest component of a unit quaternion, with room for its rounding.
const LARGEST_OF_UNIT: f64 = 1.001;
/// Most objects, fixtures and regions: LIBERO's scenes have some dozens.
const MAX_ENTITIES: usize = 1_000;

impl World {
    /// Reads the state.
    ///
    /// # Errors
    /// Names the field that holds a number that no scene has.
    pub(crate) fn read(state: &Privileged) -> Result<Self, String> {
        if state.entities.len() > MAX_ENTITIES {
            return Err(format!(
                "the scene has {} objects, fixtures and regions; at most {MAX_ENTITIES} are looked at",
                state.entities.len()
            ));
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
        let grip = vec3(&state.grip_pos, "gripper", "grip_pos")?;
        let mut world = Self {
            entities,
            solids: Vec::new(),
            joints: state.joints.clone(),
            goal: state.goal.clone(),
            grip,
            shoulder: grip + SHOULDER_FROM_REST,
            grip_quat: quat(&state.grip_quat_wxyz, "gripper")?,
            opening: state.gripper_opening,
        };
        world.solids = solids(&world);
        Ok(world)
    }

    /// The entity called `name`.
    ///
    /// # Errors
    /// Names what is not in the scene.
    pub(crate) fn entity(&self, name: &str) -> Result<&Entity, String> {
        let found = self.entities.iter().find(|e| e.name == name);
        found.ok_or_else(|| format!("the scene has no object, fixture or region named '{name}'"))
    }

    /// Position of a joint, rad or m.
    ///
    /// # Errors
    /// Names what is not in the scene.
    pub(crate) fn joint(&self, name: &str) -> Result<f64, String> {
        let found = self.joints.iter().find(|(n, _)| n == name);
        found
            .map(|j| j.1)
            .ok_or_else(|| format!("the scene has no joint named '{name}'"))
    }

    /// Names of the joints of the instance `owner`.
    pub(crate) fn joints_of(&self, owner: &str) -> impl Iterator<Item = &str> {
        let prefix = format!("{owner}_");
        self.joints
            .iter()
            .map(|j| j.0.as_str())
            .filter(move |n| n.starts_with(&prefix))
    }

    /// Position of the grip point when the arm is at rest.
    pub(crate) fn rest(&self) -> Vec3 {
        self.shoulder - SHOULDER_FROM_REST
    }

    /// Distance by which the arm exceeds its comfortable reach with the hand pointing
    /// down at `grip`, m; 0 within.
    pub(crate) fn overstretch(&self, grip: Vec3) -> f64 {
        let from_shoulder = grip - self.shoulder;
        let across = from_shoulder.horizontal_norm() - WRIST_BACK_M;
        let reach = across.hypot(from_shoulder.z + WRIST_UP_M);
        (reach - COMFORTABLE_REACH_M).max(0.0)
    }

    /// Distance of the grip point from the object's box, m; negative within.
    pub(crate) fn gap_to(&self, object: &Entity) -> f64 {
        ((self.grip - object.centre).abs() - object.half).max_coordinate()
    }

    /// The objects whose boxes the grip point is in, up to `margin` m.
    pub(crate) fn objects_at_grip(&self, margin: f64) -> impl Iterator<Item = &Entity> {
        let objects = self
            .entities
            .iter()
            .filter(|e| e.kind == EntityKind::Object);
        objects.filter(move |e| self.gap_to(e) < margin)
    }

    /// If the hand is at a drawer's handle, its fingers towards the cabinet, at most `away` m in
    /// front of it: out of that cabinet's front, horizontal.
    pub(crate) fn handle_at_grip(&self, away: f64) -> Option<Vec3> {
        let pointing = self.grip_quat.rotate(Vec3::UP);
        self.regions().find_map(|region| {
            let out = self.front_of_drawer(region)?;
            let handle = region.pos + out * HANDLE_OUT_M + Vec3::UP * HANDLE_UP_M;
            let from = self.grip - handle;
            let along = from.dot(out);
            let beside = (from - out * along - Vec3::UP * from.z).norm();
            let (across, reach) = HANDLE_HALF_M;
            let there = along.abs() < away && from.z.abs() < 2.0 * across && beside < reach;
            (there && pointing.dot(out) < -0.7).then_some(out)
        })
    }

    /// Everything that can be run into.
    pub(crate) fn solids(&self) -> &[Solid] {
        &self.solids
    }

    /// All regions.
    pub(crate) fn regions(&self) -> impl Iterator<Item = &Entity> {
        self.entities.iter().filter(|e| e.is_region())
    }

    /// If `region` is in a drawer: out of the cabinet's front, horizontal.
    pub(crate) fn front_of_drawer(&self, region: &Entity) -> Option<Vec3> {
        let joint = drawer_joint(&region.name)?;
        self.joint(&joint).ok()?;
        Some(front(self.entity(&region.category).ok()?))
    }

    /// If something of its own fixture is above `region`, so that only the
    /// open front leads in: out of that front, horizontal.
    pub(crate) fn front_of_cover(&self, region: &Entity) -> Option<Vec3> {
        let cover = self.entity(&top_side(&region.category)).ok()?;
        let beneath = cover.local(region.pos.at_height(cover.pos.z)).abs() - cover.half;
        let covered = beneath.max_coordinate() < 0.0 && region.pos.z < cover.pos.z;
        let drawer = self.front_of_drawer(region).is_some();
        (covered && !drawer).then(|| self.entity(&region.category).ok().map(front))?
    }
}

/// The joint of the drawer that has `region` in it, by LIBERO's naming.
pub(crate) fn drawer_joint(region: &str) -> Option<String> {
    region
        .strip_suffix("_region")
        .map(|drawer| format!("{drawer}_level"))
}

/// The region on top of `fixture`, by LIBERO's naming.
fn top_side(fixture: &str) -> String {
    format!("{fixture}_top_side")
}

/// LIBERO's cabinets and its microwave open along their own -y.
fn front(fixture: &Entity) -> Vec3 {
    fixture.quat.rotate(Vec3::new(0.0, -1.0, 0.0))
}

/// A drawer's walls around its region, m.
const DRAWER_WALL_M: f64 = 0.01;
/// A drawer's handle bar from the centre of its region, out of the cabinet's
/// front and up, and its half extents across the bar and along it, m (LIBERO's
/// two cabinets agree on them).
pub(crate) const HANDLE_OUT_M: f64 = 0.113;
pub(crate) const HANDLE_UP_M: f64 = -0.0045;
const HANDLE_HALF_M: (f64, f64) = (0.012, 0.048);

/// A box that can be run into.
#[derive(Clone, Debug)]
pub(crate) struct Solid {
    /// Name of the object or fixture that it is, or is part of.
    pub(crate) owner: String,
    pub(crate) centre: Vec3,
    pub(crate) quat: Quat,
    /// Half extents along its own axes.
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

    /// Distance of `p` from the box along the axis along which it is furthest outside;
    /// negative within.
    pub(crate) fn gap(&self, p: Vec3) -> f64 {
        let offset = self.quat.inverse().rotate(p - self.centre);
        (offset.abs() - self.half).max_coordinate()
    }

    /// The same, seen from above.
    pub(crate) fn gap_from_above(&self, p: Vec3) -> f64 {
        self.gap(p.at_height(self.centre.z))
    }

    /// Returns true if, seen from above, the box overlaps the rectangle around `p` that
    /// reaches out by these two horizontal vectors, which are at right angles: no axis of
    /// either separates the two.
    pub(crate) fn overlaps_from_above(&self, p: Vec3, reach: [Vec3; 2]) -> bool {
        let inward = self.quat.inverse();
        let offset = inward.rotate((p - self.centre).at_height(0.0));
        let [a, b] = reach.map(|r| inward.rotate(r));
        let own = offset.abs() - self.half - a.abs() - b.abs();
        let apart = |r: Vec3| offset.dot(r).abs() > r.dot(r) + r.abs().dot(self.half);
        own.max_coordinate() < 0.0 && !apart(a) && !apart(b)
    }
}

/// The solids of a scene. The box of a cabinet with an open drawer says little
/// about what is beside that drawer, so that cabinets are taken apart: the
/// body under its top, each drawer, and each handle.
fn solids(world: &World) -> Vec<Solid> {
    let mut solids = Vec::new();
    for e in world.entities.iter().filter(|e| !e.is_region()) {
        let parts = world.regions().filter(|r| r.category == e.name);
        let drawers = parts.filter_map(|r| Some((r, world.front_of_drawer(r)?)));
        let drawers: Vec<Solid> = drawers.flat_map(|(r, out)| drawer(e, r, out)).collect();
        let whole = Solid {
            owner: e.name.clone(),
            centre: e.centre,
            quat: Quat::IDENTITY,
            half: e.half,
        };
        match world.entity(&top_side(&e.name)) {
            Ok(top) if !drawers.is_empty() => {
                let centre = top.pos.at_height(e.centre.z);
                let half = top.half.at_height(e.half.z);
                solids.push(Solid {
                    centre,
                    quat: top.quat,
                    half,
                    ..whole
                });
                solids.extend(drawers);
            }
            _ => solids.push(whole),
        }
    }
    solids
}

/// The drawer around `region`, and its handle.
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
    [
        Solid {
            centre,
            quat: region.quat,
            half,
            ..handle.clone()
        },
        handle,
    ]
}

/// Paths are looked at every few centimetres: a number beyond all measure would
/// keep this busy for minutes.
fn within(values: &[f64], largest: f64, owner: &str, field: &str) -> Result<(), String> {
    // NaN is within no bound.
    let is_within = |value: &f64| value.abs() <= largest;
    match values.iter().find(|value| !is_within(value)) {
        Some(value) => Err(format!(
            "{field} of '{owner}' holds {value}, as in no scene"
        )),
        None => Ok(()),
    }
}

fn vec3(values: &[f64; 3], owner: &str, field: &str) -> Result<Vec3, String> {
    within(values, LARGEST_M, owner, field)?;
    let [x, y, z] = *values;
    Ok(Vec3::new(x, y, z))
}

fn quat(values: &[f64; 4], owner: &str) -> Result<Quat, String> {
    within(values, LARGEST_OF_UNIT, owner, "quat")?;
    let [w, x, y, z] = *values;
    let v = Vec3::new(x, y, z);
    Ok(Quat { w, v })
}
