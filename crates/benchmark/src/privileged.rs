//! Privileged state of the simulator, the observation of scripted experts. Other crates read
//! it from a simulator and send it to policies.

use std::fmt;

/// State of the scene and the gripper at the end of the control step, without the lag of frames and
/// robot readings.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Privileged {
    pub entities: Vec<Entity>,
    /// Name and position, m or rad, of each joint of objects and fixtures except free joints.
    pub joints: Vec<(String, f64)>,
    /// Predicates that must all hold.
    pub goal: Vec<Predicate>,
    /// Site between the fingertips, world frame, m.
    pub grip_pos: [f64; 3],
    /// Orientation of that site, world frame, w x y z.
    pub grip_quat_wxyz: [f64; 4],
    /// Distance between the fingers, m: 0 is closed, 0.08 open.
    pub gripper_opening: f64,
}

#[derive(Debug, Clone, PartialEq)]
pub struct Entity {
    pub name: String,
    pub kind: EntityKind,
    /// Category; for a site, the name of the instance that carries it.
    pub category: String,
    /// Position, world frame, m.
    pub pos: [f64; 3],
    /// Orientation, world frame, w x y z.
    pub quat_wxyz: [f64; 4],
    /// Half extents, m: of the world-aligned bounding box of the collision geometry, or of the site
    /// along its own axes.
    pub half_extents: [f64; 3],
    /// Centre of this box, world frame, m.
    pub centre: [f64; 3],
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum EntityKind {
    Object,
    Fixture,
    Site,
}

/// A predicate over names: `(On a b)`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Predicate {
    /// Name in lower case: `on`, `in`, `open`, `close`, `turnon`, `turnoff`.
    pub name: String,
    /// Names of the arguments, one or two.
    pub arguments: Vec<String>,
}

impl fmt::Display for Predicate {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "({} {})", self.name, self.arguments.join(" "))
    }
}
