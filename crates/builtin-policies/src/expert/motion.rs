//! Servo of the hand: a proportional controller on the true pose, and the detour over
//! obstacles. Other modules choose the target pose.
//!
//! An action moves the set point of LIBERO's operational-space controller relative to
//! the current pose of the hand, so that feeding back the error at every step acts as
//! a spring with the controller's own stiffness; a gain above one makes the spring
//! stiffer, and saturation limits the speed to about 0.3 m/s.

use std::f64::consts::{FRAC_1_SQRT_2, FRAC_PI_2, PI};

use crate::expert::geometry::{Quat, Vec3, half_turn};
use crate::expert::world::{Entity, Solid, World};

/// One control step's action: end-effector translation (3) and rotation (3),
/// gripper (-1 open, 1 closed), each in -1..1.
pub type Action = [f32; 7];

/// Size of one unit of action: m and rad (LIBERO's OSC_POSE settings).
const UNIT_M: f64 = 0.05;
const UNIT_RAD: f64 = 0.5;
/// Gain of the position error, which stiffens the spring. The controller is critically damped at a
/// gain of 1; a gain of 2 still settles without visible overshoot.
const POSITION_GAIN: f64 = 2.0;
/// Number of steps by which the position is extrapolated, to damp the stiffer spring and to
/// compensate the delay of a step.
const LOOKAHEAD_STEPS: f64 = 1.5;
/// Distance from the point between the fingertips to their lower end, m (Panda hand of
/// robosuite 1.4.0).
pub(crate) const FINGERTIP_M: f64 = 0.0095;
/// Vertical clearance between the hand's load and obstacles below it, m.
const CLEARANCE_M: f64 = 0.02;
/// Half the width of the moving fingers and their load, m.
const CORRIDOR_M: f64 = 0.06;
/// Horizontal distance from the goal within which the hand descends regardless of neighbours, m.
const ARRIVAL_M: f64 = 0.03;
/// Height above the goal from which the hand first moves sideways, m.
const HIGH_M: f64 = 0.05;
/// Displacement per step below which the hand counts as stopped, m.
const STILL_M: f64 = 0.0008;

/// Tolerances of a hand on a straight path: distance before its start or beyond its end, m, and
/// angle, rad.
const ALONG_M: f64 = 0.015;
const ALIGNED_RAD: f64 = 0.25;
/// Largest angle between the hand and the half turn of [`pointing_down`] at which
/// [`pointing_down_like`] returns the half turn, rad.
const SYMMETRIC_RAD: f64 = 0.3;
/// Opening beyond which the fingers count as open, m; the hand opens to 0.08 m.
pub(crate) const FINGERS_OPEN_M: f64 = 0.065;
/// Range of the opening, m, in which fingers at rest hold an object.
const GRASPED_M: (f64, f64) = (0.0015, 0.0765);
/// A hand counts as stuck if it stays within this distance, m, for [`TRAIL_STEPS`].
const STUCK_M: f64 = 0.02;
const TRAIL_STEPS: usize = 16;
/// Change of the opening per step, m, below which fingers hold a mechanism: a held mechanism shifts
/// between the fingers while the hand moves. The opening of free fingers changes by three times as
/// much.
const HOLDING_M: f64 = 0.002;
/// Number of steps without motion after which the fingers count as at rest.
const AT_REST_STEPS: u32 = 2;

/// A pose of the hand: the point between the fingertips, and its orientation
/// (x: closing direction, z: pointing direction of the fingers).
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct HandPose {
    pub(crate) pos: Vec3,
    pub(crate) quat: Quat,
}

impl HandPose {
    pub(crate) fn moved(self, by: Vec3) -> Self {
        Self { pos: self.pos + by, ..self }
    }

    pub(crate) fn turn_from(self, world: &World) -> f64 {
        let turn = self.quat.after(world.grip_quat.inverse());
        turn.rotation_vector().norm()
    }

    /// Returns true if the hand is on the straight path from this pose to `goal`: at most
    /// `aside` m beside the path, at most [`ALONG_M`] before its start or beyond its end, and
    /// oriented like one of the two poses.
    pub(crate) fn is_on_path_to(self, goal: HandPose, world: &World, aside: f64) -> bool {
        let turned = self.turn_from(world).min(goal.turn_from(world));
        self.is_straight_to(goal, world, aside) && turned < ALIGNED_RAD
    }

    /// As [`Self::is_on_path_to`], in any orientation.
    pub(crate) fn is_straight_to(self, goal: HandPose, world: &World, aside: f64) -> bool {
        let way = goal.pos - self.pos;
        let length = way.norm().max(f64::MIN_POSITIVE);
        let ahead = way * (1.0 / length);
        let along = (world.grip - self.pos).dot(ahead);
        let beside = (world.grip - self.pos - ahead * along).norm();
        let within = -ALONG_M..length + ALONG_M;
        beside < aside && within.contains(&along)
    }

    /// Returns true if the hand is within these tolerances of the pose, in metres and
    /// radians.
    pub(crate) fn is_near(self, world: &World, near_m: f64, near_rad: f64) -> bool {
        (self.pos - world.grip).norm() < near_m && self.turn_from(world) < near_rad
    }
}

/// Returns the orientation of a hand that points down and closes along the horizontal direction
/// `angle`. Of the two symmetric orientations, this is the orientation nearer to the robot's rest
/// pose, in which the hand closes along the world's y. It is at most a quarter turn from the rest
/// pose, which is within the range of the last joint.
pub(crate) fn pointing_down(angle: f64) -> Quat {
    let rest = Quat { w: 0.0, v: Vec3::new(FRAC_1_SQRT_2, FRAC_1_SQRT_2, 0.0) };
    Quat::turn(Vec3::UP, half_turn(angle - FRAC_PI_2)).after(rest)
}

/// Returns the half turn of [`pointing_down`] if the hand is within [`SYMMETRIC_RAD`] of it, and
/// otherwise [`pointing_down`]. At a quarter turn from the rest pose, [`pointing_down`] alone would
/// jump by half a turn with the slightest rotation of an object.
pub(crate) fn pointing_down_like(world: &World, angle: f64) -> Quat {
    let quat = pointing_down(angle);
    let turn = quat.after(world.grip_quat.inverse()).rotation_vector();
    if turn.norm() > PI - SYMMETRIC_RAD { Quat::turn(Vec3::UP, PI).after(quat) } else { quat }
}

/// Tilts `quat`, the orientation of a hand that points down, by `angle` so that the fingers
/// turn towards the horizontal direction `ahead`.
pub(crate) fn tilted(quat: Quat, ahead: Vec3, angle: f64) -> Quat {
    let down = Vec3::UP * -1.0;
    Quat::turn(down.cross(ahead), angle).after(quat)
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Fingers {
    Open,
    Close,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Command {
    pub(crate) hand: HandPose,
    pub(crate) fingers: Fingers,
    /// Largest vertical action component, 0..1.
    pub(crate) pace: f64,
}

pub(crate) fn servo(world: &World, motion: &Motion, command: &Command) -> Action {
    let predicted = world.grip + motion.per_step() * LOOKAHEAD_STEPS;
    let shift = (command.hand.pos - predicted) * (POSITION_GAIN / UNIT_M);
    let turn = command.hand.quat.after(world.grip_quat.inverse()).rotation_vector();
    // Horizontal and vertical components are saturated separately, so that a long descent does not
    // slow the horizontal correction.
    let across = saturate(shift.at_height(0.0), 1.0);
    let upward = shift.z.clamp(-command.pace, command.pace);
    let turn = saturate(turn * (1.0 / UNIT_RAD), 1.0);
    let fingers = match command.fingers {
        Fingers::Open => -1.0,
        Fingers::Close => 1.0,
    };
    [across.x, across.y, upward, turn.x, turn.y, turn.z, fingers].map(|v| v as f32)
}

/// Shortens `v` until no coordinate exceeds `limit`, keeping its direction.
fn saturate(v: Vec3, limit: f64) -> Vec3 {
    let largest = v.max_abs();
    if largest > limit { v * (limit / largest) } else { v }
}

/// Load of the moving hand, or the object that it is about to grasp.
#[derive(Clone, Copy, Debug)]
pub(crate) enum HandLoad<'a> {
    /// No load; the lowest part of the hand is this far below the grip point, m.
    Empty(f64),
    /// The hand moves to grasp this object, which is not an obstacle.
    For(&'a Entity),
    With(&'a Entity),
}

impl HandLoad<'_> {
    fn is_load(&self, solid: &Solid) -> bool {
        match self {
            Self::Empty(_) => false,
            Self::For(object) | Self::With(object) => object.name == solid.owner,
        }
    }

    /// Distance of the lowest part below the grip point, m.
    fn hang(&self, world: &World) -> f64 {
        match self {
            Self::Empty(hang) => *hang,
            Self::For(_) => FINGERTIP_M,
            Self::With(object) => FINGERTIP_M.max(world.grip.z - object.bottom()),
        }
    }
}

/// Returns the next waypoint towards `goal` that avoids obstacles: out from under overhead
/// obstacles, straight up until the path is clear, then across, then down.
pub(crate) fn detour(world: &World, goal: Vec3, load: HandLoad) -> Vec3 {
    let aside = (goal - world.grip).horizontal_norm();
    if aside < ARRIVAL_M {
        // Far above the goal, moves sideways first, because there may be an edge below.
        let is_high = world.grip.z > goal.z + HIGH_M && aside > ARRIVAL_M / 2.0;
        return goal.at_height(if is_high { world.grip.z } else { goal.z });
    }
    let over = load.hang(world) + CLEARANCE_M;
    let highest = highest_on_the_way(world, goal, load);
    let needed = highest.map_or(goal.z, |top| goal.z.max(top + over));
    if world.grip.z > needed - CLEARANCE_M / 2.0 {
        return goal.at_height(needed);
    }
    match way_from_under(world, load) {
        Some(way) => world.grip + way * CORRIDOR_M,
        None => world.grip.at_height(needed + CLEARANCE_M),
    }
}

fn highest_on_the_way(world: &World, goal: Vec3, load: HandLoad) -> Option<f64> {
    let start = world.grip;
    let steps = ((goal - start).horizontal_norm() / (CORRIDOR_M / 2.0)).ceil().max(1.0);
    let crossed = |solid: &&Solid| {
        (0..=steps as u32).any(|i| {
            let p = start + (goal - start) * (f64::from(i) / steps);
            solid.gap_from_above(p) < CORRIDOR_M
        })
    };
    let obstacles = world.solids().iter().filter(|solid| !load.is_load(solid));
    obstacles.filter(crossed).map(Solid::top).max_by(f64::total_cmp)
}

/// `None` if no object is held or no solid is above it.
fn way_from_under(world: &World, load: HandLoad) -> Option<Vec3> {
    let HandLoad::With(object) = load else {
        return None;
    };
    let room = CLEARANCE_M / 2.0;
    let reach =
        [Vec3::new(object.half.x + room, 0.0, 0.0), Vec3::new(0.0, object.half.y + room, 0.0)];
    let overhead = |solid: &&Solid| {
        let is_above = solid.bottom() > object.centre.z && !load.is_load(solid);
        is_above && solid.overlaps_from_above(object.centre, reach)
    };
    let solid = world.solids().iter().find(overhead)?;
    let away = (object.centre - solid.centre).at_height(0.0);
    Some(away * (1.0 / away.norm().max(CLEARANCE_M)))
}

pub(crate) fn is_partly_open(world: &World) -> bool {
    let (shut, open) = GRASPED_M;
    shut < world.opening && world.opening < open
}

#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Motion {
    /// Grip point and opening of the fingers in the last observation.
    last: Option<(Vec3, f64)>,
    per_step: Vec3,
    still_steps: u32,
    finger_still_steps: u32,
    /// Change of the opening of the fingers in the last step, m.
    opening_change: f64,
    /// Positions of the hand in the last steps, the latest last.
    trail: [Vec3; TRAIL_STEPS],
}

impl Motion {
    pub(crate) fn observe(&mut self, world: &World) {
        if let Some((grip, opening)) = self.last {
            self.per_step = world.grip - grip;
            let is_still = self.per_step.norm() < STILL_M;
            self.still_steps = if is_still { self.still_steps + 1 } else { 0 };
            self.opening_change = world.opening - opening;
            let are_fingers_still = self.opening_change.abs() < STILL_M;
            self.finger_still_steps =
                if are_fingers_still { self.finger_still_steps + 1 } else { 0 };
        }
        self.trail.rotate_left(1);
        self.trail[TRAIL_STEPS - 1] = world.grip;
        self.last = Some((world.grip, world.opening));
    }

    /// Displacement of the hand in the last step, m.
    pub(crate) fn per_step(&self) -> Vec3 {
        self.per_step
    }

    pub(crate) fn still_steps(&self) -> u32 {
        self.still_steps
    }

    pub(crate) fn is_stuck(&self) -> bool {
        let latest = self.trail[TRAIL_STEPS - 1];
        let away = |place: &Vec3| (*place - latest).norm();
        self.trail.iter().all(|place| away(place) < STUCK_M)
    }

    /// Returns the distance between the latest place of the hand and that of `steps` steps ago, or
    /// the earliest known, m.
    pub(crate) fn moved(&self, steps: u32) -> f64 {
        let latest = TRAIL_STEPS - 1;
        (self.trail[latest] - self.trail[latest.saturating_sub(steps as usize)]).norm()
    }

    pub(crate) fn grasps(&self, world: &World) -> bool {
        is_partly_open(world) && self.finger_still_steps >= AT_REST_STEPS
    }

    /// Returns true if partly open fingers, see [`is_partly_open`], hold a mechanism, also while
    /// the mechanism moves.
    pub(crate) fn holds_mechanism(&self) -> bool {
        self.opening_change.abs() < HOLDING_M
    }

    pub(crate) fn opens(&self) -> bool {
        self.opening_change > STILL_M
    }

    /// Returns true if fingers at a grasp should close: they are open, still closing, or have only
    /// just stopped.
    pub(crate) fn may_close(&self, world: &World) -> bool {
        let has_just_stopped =
            self.opening_change < STILL_M && self.finger_still_steps < AT_REST_STEPS;
        world.opening > FINGERS_OPEN_M || has_just_stopped
    }

    pub(crate) fn finger_still_steps(&self) -> u32 {
        self.finger_still_steps
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::expert::kinematic_scene::KinematicScene;

    fn scene() -> KinematicScene {
        KinematicScene::new("on", &["a", "b"])
    }

    fn command(world: &World, by: Vec3, pace: f64) -> Command {
        let hand = HandPose { pos: world.grip + by, quat: world.grip_quat };
        Command { hand, fingers: Fingers::Close, pace }
    }

    #[test]
    fn a_distant_goal_saturates_the_action_and_keeps_its_direction() {
        let world = scene().world();
        let far = command(&world, Vec3::new(0.4, -0.2, 0.0), 1.0);
        let action = servo(&world, &Motion::default(), &far);
        assert_eq!(action[0], 1.0);
        assert!((action[1] + 0.5).abs() < 1e-6, "{action:?}");
    }

    #[test]
    fn a_low_pace_limits_the_vertical_action_and_not_the_horizontal() {
        let world = scene().world();
        let far = command(&world, Vec3::new(0.4, 0.0, -0.4), 0.3);
        let action = servo(&world, &Motion::default(), &far);
        assert_eq!((action[0], action[2]), (1.0, -0.3));
    }

    #[test]
    fn a_hand_at_its_goal_stays_there() {
        let world = scene().world();
        let action = servo(&world, &Motion::default(), &command(&world, Vec3::default(), 1.0));
        assert!(action[..6].iter().all(|v| v.abs() < 1e-6), "{action:?}");
        assert_eq!(action[6], 1.0);
    }

    #[test]
    fn opposite_closing_directions_give_the_orientation_nearer_to_the_rest_pose() {
        for angle in [-1.3, -0.4, 0.2, 1.0, 1.5] {
            let pose = pointing_down(angle);
            assert!(
                pose.after(pointing_down(angle + std::f64::consts::PI).inverse())
                    .rotation_vector()
                    .norm()
                    < 1e-9
            );
            let from_rest = pose.after(pointing_down(FRAC_PI_2).inverse()).rotation_vector();
            assert!(from_rest.norm() <= FRAC_PI_2 + 1e-9, "{angle}");
            assert!((pose.rotate(Vec3::UP) + Vec3::UP).norm() < 1e-9, "points down");
        }
    }

    #[test]
    fn a_hand_at_a_quarter_turn_keeps_its_orientation_when_the_object_turns_slightly() {
        let mut scene = scene();
        // pointing_down differs by half a turn on the two sides of the x axis.
        for (hand, angle) in [(0.01, -0.01), (-0.01, 0.01)] {
            let pose = pointing_down(hand);
            scene.state.grip_quat_wxyz = [pose.w, pose.v.x, pose.v.y, pose.v.z];
            let world = scene.world();
            let turn = |quat: Quat| quat.after(world.grip_quat.inverse()).rotation_vector();
            assert!(turn(pointing_down(angle)).norm() > 3.0);
            assert!(turn(pointing_down_like(&world, angle)).norm() < 0.03);
        }
    }

    #[test]
    fn a_tilted_hand_points_ahead() {
        let ahead = Vec3::heading(0.7);
        let pose = tilted(pointing_down(0.7), ahead, FRAC_PI_2);
        assert!((pose.rotate(Vec3::UP) - ahead).norm() < 1e-9);
    }

    #[test]
    fn the_hand_climbs_over_obstacles_before_it_crosses() {
        let mut world = scene().object("tower", [0.2, 0.0, 0.25], [0.03, 0.03, 0.25]).world();
        let goal = Vec3::new(0.4, 0.0, 0.1);
        let up = detour(&world, goal, HandLoad::Empty(FINGERTIP_M));
        assert_eq!((up.x, up.y), (0.0, 0.0));
        assert!(up.z > 0.5 + FINGERTIP_M + CLEARANCE_M);
        world.grip.z = up.z;
        let across = detour(&world, goal, HandLoad::Empty(FINGERTIP_M));
        assert_eq!((across.x, across.y), (goal.x, goal.y));
        assert!(across.z > 0.5);
        world.grip = goal.at_height(up.z);
        assert_eq!(detour(&world, goal, HandLoad::Empty(FINGERTIP_M)), goal);
    }

    #[test]
    fn a_held_object_comes_out_from_under_a_shelf_before_it_goes_up() {
        let scene = scene().object("cup", [0.0, 0.0, 0.3], [0.04, 0.04, 0.05]).object(
            "shelf",
            [0.05, 0.0, 0.5],
            [0.06, 0.2, 0.02],
        );
        let world = scene.world();
        let cup = world.entity("cup").unwrap();
        let next = detour(&world, Vec3::new(0.3, 0.0, 0.7), HandLoad::With(cup));
        assert!(next.x < -0.03 && next.z == world.grip.z, "{next:?}");
    }

    #[test]
    fn still_steps_counts_the_steps_since_the_hand_stopped() {
        let mut scene = scene();
        let mut motion = Motion::default();
        scene.apply([1.0, 0.0, 0.0, 0.0, 0.0, 0.0, -1.0]);
        motion.observe(&scene.world());
        scene.apply([1.0, 0.0, 0.0, 0.0, 0.0, 0.0, -1.0]);
        motion.observe(&scene.world());
        assert_eq!(motion.still_steps(), 0);
        assert!(motion.per_step().x > 0.01);
        for _ in 0..3 {
            motion.observe(&scene.world());
        }
        assert_eq!(motion.still_steps(), 3);
    }
}
