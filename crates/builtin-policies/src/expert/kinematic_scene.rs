//! Test double of the simulator without contacts. The hand follows actions like LIBERO's
//! controller in free space; closed fingers hold the object between them; released
//! objects drop to the floor. Physics is covered by tests on the real simulator.

use benchmark::{Entity, EntityKind, Predicate, Privileged};

use crate::expert::geometry::{Quat, Vec3};
use crate::expert::world::World;

/// Stiffness of the controller's spring, which is critically damped (OSC_POSE of LIBERO: kp 150).
const STIFFNESS: f64 = 150.0;
/// Distance of the spring's goal from the hand per unit of action, m.
const UNIT_M: f64 = 0.05;
const SUBSTEPS: u32 = 25;
const SUBSTEP_SECS: f64 = 0.002;
/// Rotation per step at full action, rad; approximate.
const STEP_RAD: f64 = 0.15;
/// Travel of the fingers per step, m.
const FINGER_STEP_M: f64 = 0.01;
/// Distance between the fingers when they hold an object, m.
const HOLDING_M: f64 = 0.02;
/// Largest distance from the grip point at which an object can be held, m.
const REACH_M: f64 = 0.08;
/// Half extents of the mug, m.
pub(crate) const MUG_M: [f64; 3] = [0.03, 0.03, 0.05];

pub(crate) struct KinematicScene {
    pub(crate) state: Privileged,
    /// Number of times that the fingers will close without grasping the object.
    pub(crate) failing_grasps: u32,
    held: Option<usize>,
    velocity: [f64; 3],
}

impl KinematicScene {
    /// Creates a scene with the hand at rest 0.3 m above the origin and the floor at height 0.
    pub(crate) fn new(goal: &str, arguments: &[&str]) -> Self {
        let state = Privileged {
            goal: vec![predicate(goal, arguments)],
            grip_pos: [0.0, 0.0, 0.3],
            grip_quat_wxyz: [0.0, 0.5_f64.sqrt(), 0.5_f64.sqrt(), 0.0],
            gripper_opening: 0.08,
            ..Privileged::default()
        };
        Self { state, failing_grasps: 0, held: None, velocity: [0.0; 3] }
    }

    pub(crate) fn mug_before_oven() -> Self {
        Self::new("in", &["mug_1", "oven_1_inside"])
            .object("mug_1", [0.0, 0.0, 0.05], MUG_M)
            .fixture("oven_1", [0.0, 0.4, 0.1], [0.2, 0.1, 0.1])
            .region("oven_1_inside", "oven_1", [0.0, 0.4, 0.1], [0.12, 0.08, 0.08])
            .region("oven_1_top_side", "oven_1", [0.0, 0.4, 0.2], [0.15, 0.1, 0.001])
    }

    pub(crate) fn goal(mut self, name: &str, arguments: &[&str]) -> Self {
        self.state.goal.push(predicate(name, arguments));
        self
    }

    pub(crate) fn joint(mut self, name: &str, position: f64) -> Self {
        self.state.joints.push((name.to_owned(), position));
        self
    }

    pub(crate) fn object(self, name: &str, centre: [f64; 3], half: [f64; 3]) -> Self {
        self.entity(name, EntityKind::Object, name.trim_end_matches("_1"), centre, half)
    }

    pub(crate) fn fixture(self, name: &str, centre: [f64; 3], half: [f64; 3]) -> Self {
        self.entity(name, EntityKind::Fixture, name.trim_end_matches("_1"), centre, half)
    }

    pub(crate) fn region(self, name: &str, parent: &str, centre: [f64; 3], half: [f64; 3]) -> Self {
        self.entity(name, EntityKind::Site, parent, centre, half)
    }

    fn entity(
        mut self,
        name: &str,
        kind: EntityKind,
        category: &str,
        centre: [f64; 3],
        half: [f64; 3],
    ) -> Self {
        self.state.entities.push(Entity {
            name: name.to_owned(),
            kind,
            category: category.to_owned(),
            pos: centre,
            quat_wxyz: [1.0, 0.0, 0.0, 0.0],
            half_extents: half,
            centre,
        });
        self
    }

    pub(crate) fn world(&self) -> World {
        World::read(&self.state).expect("a valid scene")
    }

    pub(crate) fn apply(&mut self, action: [f32; 7]) {
        let a = action.map(f64::from);
        let shift = self.pull_hand([a[0], a[1], a[2]]);
        self.shift_hand(shift);
        let turn = Vec3::new(a[3], a[4], a[5]);
        if turn.norm() > 1e-6 {
            let turned = Quat::turn(turn * (1.0 / turn.norm()), turn.norm() * STEP_RAD);
            let q = turned.after(self.world().grip_quat);
            self.state.grip_quat_wxyz = [q.w, q.v.x, q.v.y, q.v.z];
        }
        if a[6] > 0.0 { self.close() } else { self.open() }
    }

    pub(crate) fn knock_out_of_hand(&mut self) {
        if let Some(held) = self.held.take() {
            drop_to_floor(&mut self.state.entities[held]);
        }
    }

    /// Returns the displacement of the hand by the controller's spring in one step.
    fn pull_hand(&mut self, action: [f64; 3]) -> [f64; 3] {
        std::array::from_fn(|i| {
            let (goal, velocity) = (action[i] * UNIT_M, &mut self.velocity[i]);
            let mut moved = 0.0;
            for _ in 0..SUBSTEPS {
                let damping = 2.0 * STIFFNESS.sqrt() * *velocity;
                *velocity += (STIFFNESS * (goal - moved) - damping) * SUBSTEP_SECS;
                moved += *velocity * SUBSTEP_SECS;
            }
            moved
        })
    }

    fn shift_hand(&mut self, shift: [f64; 3]) {
        add(&mut self.state.grip_pos, shift);
        if let Some(held) = self.held {
            let object = &mut self.state.entities[held];
            add(&mut object.pos, shift);
            add(&mut object.centre, shift);
        }
    }

    fn close(&mut self) {
        if self.held.is_some() {
            return;
        }
        let opening = (self.state.gripper_opening - FINGER_STEP_M).max(0.0);
        let has_just_closed =
            opening <= FINGER_STEP_M && self.state.gripper_opening > FINGER_STEP_M;
        self.state.gripper_opening = opening;
        if has_just_closed && self.failing_grasps > 0 {
            self.failing_grasps -= 1;
        } else if has_just_closed {
            self.held = self.between_fingers();
            if self.held.is_some() {
                self.state.gripper_opening = HOLDING_M;
            }
        }
    }

    fn open(&mut self) {
        self.state.gripper_opening = (self.state.gripper_opening + FINGER_STEP_M).min(0.08);
        self.knock_out_of_hand();
    }

    fn between_fingers(&self) -> Option<usize> {
        let near = |e: &Entity| {
            let gaps = (0..3).map(|i| self.state.grip_pos[i] - e.centre[i]);
            e.kind == EntityKind::Object
                && gaps.map(|gap| gap * gap).sum::<f64>() < REACH_M * REACH_M
        };
        self.state.entities.iter().position(near)
    }
}

fn predicate(name: &str, arguments: &[&str]) -> Predicate {
    let arguments = arguments.iter().map(|a| (*a).to_owned()).collect();
    Predicate { name: name.to_owned(), arguments }
}

fn add(point: &mut [f64], shift: [f64; 3]) {
    for (p, s) in point.iter_mut().zip(shift) {
        *p += s;
    }
}

fn drop_to_floor(object: &mut Entity) {
    let fall = object.half_extents[2] - object.centre[2];
    add(&mut object.pos, [0.0, 0.0, fall]);
    add(&mut object.centre, [0.0, 0.0, fall]);
}
