//! The privileged observation as the expert reads it: checked once, then
//! looked up by name. Not responsible for deciding anything.

use proto::policy::{PrivilegedState, entity::Kind};

use super::geometry::{Quat, Vec3};

/// An object, a fixture or a region.
#[derive(Clone, Debug)]
pub(super) struct Entity {
    pub(super) name: String,
    pub(super) kind: Kind,
    /// Category of an object or fixture; of a region, the instance it is on.
    pub(super) category: String,
    /// Origin of the body, which is what goal predicates measure.
    pub(super) pos: Vec3,
    pub(super) quat: Quat,
    /// World-aligned box of the collision geometry; of a region, its size
    /// along its own axes.
    pub(super) centre: Vec3,
    pub(super) half: Vec3,
}

impl Entity {
    pub(super) fn top(&self) -> f64 {
        self.centre.z + self.half.z
    }

    pub(super) fn bottom(&self) -> f64 {
        self.centre.z - self.half.z
    }

    /// Half height of a region, whichever of its axes points up.
    pub(super) fn upright_half_height(&self) -> f64 {
        let up = self.quat.inverse().rotate(Vec3::UP).abs();
        up.dot(self.half)
    }

    /// `p` in a region's own axes, from its centre.
    pub(super) fn local(&self, p: Vec3) -> Vec3 {
        self.quat.inverse().rotate(p - self.pos)
    }
}

/// One instant of the simulation.
#[derive(Clone, Debug)]
pub(super) struct World {
    entities: Vec<Entity>,
    joints: Vec<(String, f64)>,
    pub(super) goal: Vec<Predicate>,
    /// Point between the fingertips.
    pub(super) grip: Vec3,
    /// x: closing direction, z: where the fingers point.
    pub(super) grip_quat: Quat,
    /// Distance between the fingers, m.
    pub(super) opening: f64,
}

/// One goal predicate, arguments as the task file names them.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Predicate {
    pub(super) name: String,
    pub(super) arguments: Vec<String>,
}

impl World {
    /// Reads the message.
    ///
    /// # Errors
    /// Names the field that is missing or of the wrong width.
    pub(super) fn read(state: &PrivilegedState) -> Result<Self, String> {
        let mut entities = Vec::with_capacity(state.entities.len());
        for e in &state.entities {
            entities.push(Entity {
                name: e.name.clone(),
                kind: e.kind(),
                category: e.category.clone(),
                pos: vec3(&e.pos, &e.name, "pos")?,
                quat: quat(&e.quat, &e.name)?,
                centre: vec3(&e.centre, &e.name, "centre")?,
                half: vec3(&e.half_extents, &e.name, "half_extents")?,
            });
        }
        let goal = state.goal.iter();
        Ok(Self {
            entities,
            joints: state
                .joints
                .iter()
                .map(|j| (j.name.clone(), j.position))
                .collect(),
            goal: goal
                .map(|g| Predicate {
                    name: g.predicate.clone(),
                    arguments: g.arguments.clone(),
                })
                .collect(),
            grip: vec3(&state.grip_pos, "gripper", "grip_pos")?,
            grip_quat: quat(&state.grip_quat, "gripper")?,
            opening: state.gripper_opening,
        })
    }

    /// The entity called `name`.
    ///
    /// # Errors
    /// Names what is not in the scene.
    pub(super) fn entity(&self, name: &str) -> Result<&Entity, String> {
        let found = self.entities.iter().find(|e| e.name == name);
        found.ok_or_else(|| format!("the scene has no object, fixture or region named '{name}'"))
    }

    /// Position of a joint, rad or m.
    ///
    /// # Errors
    /// Names what is not in the scene.
    pub(super) fn joint(&self, name: &str) -> Result<f64, String> {
        let found = self.joints.iter().find(|(n, _)| n == name);
        found
            .map(|j| j.1)
            .ok_or_else(|| format!("the scene has no joint named '{name}'"))
    }

    /// Names of the joints of the instance `owner`.
    pub(super) fn joints_of(&self, owner: &str) -> impl Iterator<Item = &str> {
        let prefix = format!("{owner}_");
        self.joints
            .iter()
            .map(|j| j.0.as_str())
            .filter(move |n| n.starts_with(&prefix))
    }

    /// Everything that can be run into.
    pub(super) fn solids(&self) -> impl Iterator<Item = &Entity> {
        self.entities.iter().filter(|e| e.kind != Kind::Site)
    }

    /// All regions.
    pub(super) fn regions(&self) -> impl Iterator<Item = &Entity> {
        self.entities.iter().filter(|e| e.kind == Kind::Site)
    }
}

fn vec3(values: &[f64], owner: &str, field: &str) -> Result<Vec3, String> {
    match *values {
        [x, y, z] => Ok(Vec3::new(x, y, z)),
        _ => Err(format!(
            "{field} of '{owner}' has {} numbers, not 3",
            values.len()
        )),
    }
}

fn quat(values: &[f64], owner: &str) -> Result<Quat, String> {
    match *values {
        [w, x, y, z] => Ok(Quat {
            w,
            v: Vec3::new(x, y, z),
        }),
        _ => Err(format!(
            "quat of '{owner}' has {} numbers, not 4",
            values.len()
        )),
    }
}
