//! Manipulation without carrying: drawers, the stove's knob, the microwave's door, and
//! flat objects that are dragged. Each manipulation is a short sequence of stages, whose poses
//! follow the mechanism as it moves. Bounding boxes do not show the movable part of a fixture, so
//! the necessary dimensions of LIBERO's fixture models are constants here.

use std::f64::consts::FRAC_PI_2;

use crate::expert::ExpertError;
use crate::expert::geometry::{Quat, Vec3};
use crate::expert::motion::{
    self, Command, FINGERS_OPEN_M, FINGERTIP_M, Fingers, HandLoad, HandPose, Motion, detour,
    pointing_down, tilted,
};
use crate::expert::world::{Entity, HANDLE_OUT_M, HANDLE_UP_M, World, drawer_joint};

/// Joint position below which a drawer counts as open, m; drawers open towards negative positions.
pub(crate) const DRAWER_COUNTS_AS_OPEN_M: f64 = -0.14;
/// Joint positions at which a drawer is released, m; it then coasts a little. The first satisfies
/// the predicate `open`. The second, less far open, is for a drawer that receives an object.
pub(crate) const DRAWER_OPEN_M: f64 = -0.155;
pub(crate) const DRAWER_AJAR_M: f64 = -0.118;
/// Joint position at which a drawer is safely closed, m; a drawer counts as closed above 0.
const DRAWER_CLOSED_M: f64 = 0.003;
/// Tilt of the hand when it reaches for a handle from the front, and when it pushes a drawer
/// shut with the fingertips ahead of the palm, rad.
const PULL_TILT: f64 = FRAC_PI_2;
const PUSH_TILT: f64 = 0.6;
/// Angle to which the stove's knob is turned, rad; the stove counts as on from 0.5 rad.
const KNOB_ON: f64 = 0.8;
/// Depth of the grip point below the top of the knob's ridge, m.
const KNOB_DEPTH_M: f64 = 0.018;
/// Position of the hinge of the microwave's door, and height of the top of the door, m, both from
/// the microwave's origin along its axes.
const HINGE: Vec3 = Vec3::new(-0.1725, -0.088, 0.0);
const DOOR_TOP_M: f64 = 0.188;
/// Contact point of the hand, m: distance from the hinge along the door, depth below the top
/// of the door (so that the palm passes above the handle), and distance in front of the plane
/// through the middle of the door.
const DOOR_REACH_M: f64 = 0.17;
const DOOR_DEPTH_M: f64 = 0.05;
const DOOR_FRONT_M: f64 = 0.044;
/// Angle to which the microwave's door is closed, rad; the door counts as closed above -0.005 rad.
const DOOR_CLOSED: f64 = -0.003;
/// Lead of the hand's goal over a mechanism, m and rad, which pulls the mechanism along.
const LEAD_M: f64 = 0.05;
const LEAD_RAD: f64 = 0.4;
/// Distance from the mechanism before and after the manipulation, m.
const STANDOFF_M: f64 = 0.09;
/// Tolerances for proceeding to the next stage, m and rad.
const NEAR_M: f64 = 0.01;
const NEAR_RAD: f64 = 0.1;
const FINGER_STEPS: u32 = 8;
/// Number of steps after which a stage ends regardless of progress.
const PATIENCE_STEPS: u32 = 80;
/// Largest distance of the hand from the path between two stages at which a resumed routine takes
/// the hand to be on that path, m.
const ASIDE_M: f64 = 0.02;
/// Distance from a handle or knob within which the hand closes, m.
const AT_M: f64 = 0.012;
/// Distance from a handle or knob within which partly open fingers hold it, m.
const HELD_M: f64 = 0.025;
/// Height above the contact point within which the hand presses on a flat object, m. A hand that
/// drags an object is held 8 mm above that point by the object's rim.
const PRESSING_M: f64 = 0.012;
/// Share of full vertical speed in all stages but the approach.
const GENTLE: f64 = 0.4;
/// Distance from the centre at which fingertips drag a flat object by its upper face, and
/// distance from the goal at which the object is released, m.
const DRAG_FROM_M: f64 = 0.03;
const DRAG_DONE_M: f64 = 0.012;
/// Lead of the goal over the fingertips when dragging, m.
const DRAG_LEAD_M: f64 = 0.05;

#[derive(Clone, Debug, PartialEq)]
pub(crate) enum RoutineTask {
    /// Open the drawer that contains the region to the joint position `to`, m.
    PullDrawer {
        region: String,
        to: f64,
    },
    PushDrawer {
        region: String,
    },
    TurnKnob {
        stove: String,
    },
    PushDoor {
        microwave: String,
    },
    Drag {
        object: String,
        region: String,
    },
}

#[derive(Clone, Debug)]
pub(crate) struct Routine {
    task: RoutineTask,
    stage: u32,
    ticks: u32,
}

struct Stage {
    hand: HandPose,
    fingers: Fingers,
    until: Until,
}

enum Until {
    AtPoseAfterDetour,
    AtPoseOrStopped,
    Steps(u32),
    /// The flag is true: the mechanism has reached its target position, or the hand has lost it.
    ConditionHolds(bool),
}

impl Routine {
    pub(crate) fn new(task: RoutineTask) -> Self {
        Self { task, stage: 0, ticks: 0 }
    }

    pub(crate) fn task(&self) -> &RoutineTask {
        &self.task
    }

    /// Resumes at the stage derived from the state of the world.
    ///
    /// # Errors
    /// If the scene lacks an entity or joint, or the region to open or close is in no drawer.
    pub(crate) fn resume(&mut self, world: &World, motion: &Motion) -> Result<(), ExpertError> {
        self.stage = self.task.current_stage(world, motion)?;
        self.ticks = 0;
        Ok(())
    }

    /// Returns the command for this step; `None` after the last stage.
    ///
    /// # Errors
    /// If the scene lacks an entity or joint, or the region to open or close is in no drawer.
    pub(crate) fn step(
        &mut self,
        world: &World,
        motion: &Motion,
    ) -> Result<Option<Command>, ExpertError> {
        while let Some(stage) = self.task.stage(self.stage, world)? {
            if !self.is_complete(&stage, world, motion) {
                self.ticks += 1;
                let is_travelling = matches!(stage.until, Until::AtPoseAfterDetour);
                let mut hand = stage.hand;
                if is_travelling {
                    hand.pos = detour(world, hand.pos, HandLoad::Empty(STANDOFF_M));
                }
                let pace = if is_travelling { 1.0 } else { GENTLE };
                return Ok(Some(Command { hand, fingers: stage.fingers, pace }));
            }
            self.stage += 1;
            self.ticks = 0;
        }
        Ok(None)
    }

    fn is_complete(&self, stage: &Stage, world: &World, motion: &Motion) -> bool {
        let is_near = stage.hand.is_near(world, NEAR_M, NEAR_RAD);
        // In the first steps of a stage the hand has not yet set off.
        let has_stopped = self.ticks > 5 && motion.still_steps() >= 3;
        let is_complete = match stage.until {
            Until::AtPoseAfterDetour => is_near,
            Until::AtPoseOrStopped => is_near || has_stopped,
            Until::Steps(steps) => self.ticks >= steps,
            Until::ConditionHolds(holds) => holds,
        };
        is_complete || self.ticks >= PATIENCE_STEPS
    }
}

impl RoutineTask {
    fn current_stage(&self, world: &World, motion: &Motion) -> Result<u32, ExpertError> {
        let (Some(first), Some(second)) = (self.stage(0, world)?, self.stage(1, world)?) else {
            return Ok(0);
        };
        let (from, to) = (first.hand, second.hand);
        let is_on_the_way = from.is_on_path_to(to, world, ASIDE_M);
        let distance = (to.pos - world.grip).norm();
        Ok(match self {
            Self::PullDrawer { .. } | Self::TurnKnob { .. } => {
                let is_open = world.opening > FINGERS_OPEN_M;
                if let Self::TurnKnob { stove } = self
                    && is_at_knob(world, stove)?
                {
                    // Open fingers do not turn the knob further, and leave it if it is on.
                    let position = only_joint(world, stove)?;
                    match is_open {
                        true if knob_is_on(position) => return Ok(5),
                        false if position > KNOB_ON => return Ok(4),
                        _ => {}
                    }
                }
                if distance < HELD_M && motion::is_partly_open(world) && !is_open {
                    // Not `grasps`: the opening varies while the mechanism moves.
                    if motion.holds_mechanism() { 3 } else { 2 }
                } else if distance < AT_M && is_on_the_way && motion.may_close(world) {
                    2
                } else {
                    u32::from(is_on_the_way && is_open)
                }
            }
            Self::PushDrawer { .. } => u32::from(is_on_the_way),
            // The orientation is not compared: it changes by half a turn as the door closes.
            // The hand lags behind a door that is nearly closed, so that it is further aside.
            Self::PushDoor { .. } => u32::from(from.is_straight_to(to, world, 2.0 * ASIDE_M)),
            Self::Drag { object, .. } => {
                let entity = world.entity(object)?;
                let widest = entity.half.x.max(entity.half.y);
                let aside = (world.grip - entity.centre).horizontal_norm();
                let is_pressing = world.grip.z < to.pos.z + PRESSING_M && aside < widest;
                if is_pressing { 2 } else { u32::from(is_on_the_way) }
            }
        })
    }

    fn stage(&self, number: u32, world: &World) -> Result<Option<Stage>, ExpertError> {
        match self {
            Self::PullDrawer { region, to } => pull_drawer(number, world, region, *to),
            Self::PushDrawer { region } => push_drawer(number, world, region),
            Self::TurnKnob { stove } => turn_knob(number, world, stove),
            Self::PushDoor { microwave } => push_door(number, world, microwave),
            Self::Drag { object, region } => drag(number, world, object, region),
        }
    }
}

pub(crate) fn drawer_is_closed(position: f64) -> bool {
    position > 0.0
}

pub(crate) fn door_is_closed(position: f64) -> bool {
    position > -0.005
}

pub(crate) fn knob_is_on(position: f64) -> bool {
    position >= 0.5
}

/// Returns true if the hand is at a stove's knob, or leaves it.
pub(crate) fn is_at_knob(world: &World, stove: &str) -> Result<bool, ExpertError> {
    let Some(leaving) = turn_knob(5, world, stove)? else { return Ok(false) };
    let from = world.grip - leaving.hand.pos;
    Ok(from.horizontal_norm() < AT_M && from.z < -NEAR_M)
}

struct Drawer {
    /// Joint position, m.
    position: f64,
    handle: Vec3,
    /// Horizontal direction out of the cabinet's front.
    out: Vec3,
}

impl Drawer {
    fn find(world: &World, region: &str) -> Result<Self, ExpertError> {
        let joint = drawer_joint(region).unwrap_or_default();
        let inside = world.entity(region)?;
        let out = world.front_of_drawer(inside);
        let out = out.ok_or_else(|| ExpertError::NoDrawer { region: region.to_owned() })?;
        let handle = inside.pos + out * HANDLE_OUT_M + Vec3::UP * HANDLE_UP_M;
        Ok(Self { position: world.joint(&joint)?, handle, out })
    }
}

fn pull_drawer(
    number: u32,
    world: &World,
    region: &str,
    to: f64,
) -> Result<Option<Stage>, ExpertError> {
    let drawer = Drawer::find(world, region)?;
    // The fingers close on the bar of the handle from above and below.
    let upright = pointing_down(drawer.out.y.atan2(drawer.out.x));
    let quat = tilted(upright, drawer.out * -1.0, PULL_TILT);
    let at = |away: f64| HandPose { pos: drawer.handle + drawer.out * away, quat };
    let current = HandPose { pos: world.grip, quat };
    Ok(Some(match number {
        0 => stage(at(STANDOFF_M), Fingers::Open, Until::AtPoseAfterDetour),
        1 => stage(at(0.0), Fingers::Open, Until::AtPoseOrStopped),
        2 => stage(at(0.0), Fingers::Close, Until::Steps(FINGER_STEPS)),
        3 => {
            let is_open = drawer.position < to;
            let is_lost = (world.grip - drawer.handle).norm() > STANDOFF_M / 2.0;
            stage(at(LEAD_M), Fingers::Close, Until::ConditionHolds(is_open || is_lost))
        }
        4 => stage(current, Fingers::Open, Until::Steps(FINGER_STEPS)),
        5 => stage(at(STANDOFF_M), Fingers::Open, Until::AtPoseOrStopped),
        _ => return Ok(None),
    }))
}

fn push_drawer(number: u32, world: &World, region: &str) -> Result<Option<Stage>, ExpertError> {
    let drawer = Drawer::find(world, region)?;
    let along_bar = drawer.out.cross(Vec3::UP);
    let upright = pointing_down(along_bar.y.atan2(along_bar.x));
    let quat = tilted(upright, drawer.out * -1.0, PUSH_TILT);
    let at = |away: f64| HandPose { pos: drawer.handle + drawer.out * away, quat };
    Ok(Some(match number {
        0 => stage(at(STANDOFF_M), Fingers::Close, Until::AtPoseAfterDetour),
        1 => {
            let is_closed = drawer.position > DRAWER_CLOSED_M;
            stage(at(-LEAD_M), Fingers::Close, Until::ConditionHolds(is_closed))
        }
        2 => stage(at(STANDOFF_M), Fingers::Close, Until::AtPoseOrStopped),
        _ => return Ok(None),
    }))
}

fn turn_knob(number: u32, world: &World, stove: &str) -> Result<Option<Stage>, ExpertError> {
    let knob = world.entity(stove)?;
    let position = only_joint(world, stove)?;
    let forward = knob.quat.rotate(Vec3::new(1.0, 0.0, 0.0));
    let ridge = forward.y.atan2(forward.x) + position;
    let at = |ahead: f64, above: f64| HandPose {
        pos: knob.pos.at_height(knob.top() + above),
        quat: pointing_down(ridge + ahead + FRAC_PI_2),
    };
    Ok(Some(match number {
        0 => stage(at(0.0, STANDOFF_M / 2.0), Fingers::Open, Until::AtPoseAfterDetour),
        1 => stage(at(0.0, -KNOB_DEPTH_M), Fingers::Open, Until::AtPoseOrStopped),
        2 => stage(at(0.0, -KNOB_DEPTH_M), Fingers::Close, Until::Steps(FINGER_STEPS)),
        3 => {
            let is_on = position > KNOB_ON;
            stage(at(LEAD_RAD, -KNOB_DEPTH_M), Fingers::Close, Until::ConditionHolds(is_on))
        }
        4 => stage(at(0.0, -KNOB_DEPTH_M), Fingers::Open, Until::Steps(FINGER_STEPS)),
        5 => stage(at(0.0, STANDOFF_M / 2.0), Fingers::Open, Until::AtPoseOrStopped),
        _ => return Ok(None),
    }))
}

fn push_door(number: u32, world: &World, microwave: &str) -> Result<Option<Stage>, ExpertError> {
    let oven = world.entity(microwave)?;
    let angle = only_joint(world, microwave)?;
    let at = |angle: f64, front: f64| {
        let turned = oven.quat.after(Quat::turn(Vec3::UP, angle));
        let along = turned.rotate(Vec3::new(1.0, 0.0, 0.0));
        let out = turned.rotate(Vec3::new(0.0, -1.0, 0.0));
        let hinge = oven.pos + oven.quat.rotate(HINGE);
        let height = oven.pos.z + DOOR_TOP_M - DOOR_DEPTH_M;
        let pos = (hinge + along * DOOR_REACH_M + out * front).at_height(height);
        HandPose { pos, quat: pointing_down(along.y.atan2(along.x)) }
    };
    let pushed = at(angle + LEAD_RAD, DOOR_FRONT_M / 2.0);
    Ok(Some(match number {
        0 => stage(at(angle, DOOR_FRONT_M + STANDOFF_M), Fingers::Close, Until::AtPoseAfterDetour),
        1 => stage(pushed, Fingers::Close, Until::ConditionHolds(angle > DOOR_CLOSED)),
        2 => stage(at(angle, DOOR_FRONT_M + STANDOFF_M), Fingers::Close, Until::AtPoseOrStopped),
        _ => return Ok(None),
    }))
}

fn drag(
    number: u32,
    world: &World,
    object: &str,
    region: &str,
) -> Result<Option<Stage>, ExpertError> {
    let (entity, goal) = (world.entity(object)?, world.entity(region)?);
    let to_goal = (goal.pos - entity.pos).at_height(0.0);
    let distance = to_goal.norm();
    let ahead = to_goal * (1.0 / distance.max(DRAG_DONE_M));
    let quat = pointing_down(ahead.y.atan2(ahead.x) + FRAC_PI_2);
    let at = |along: f64, height: f64| HandPose {
        pos: (entity.centre + ahead * along).at_height(height),
        quat,
    };
    let pressing = entity.bottom() + FINGERTIP_M;
    let widest = entity.half.x.max(entity.half.y);
    Ok(Some(match number {
        0 => stage(
            at(DRAG_FROM_M, entity.top() + STANDOFF_M / 2.0),
            Fingers::Close,
            Until::AtPoseAfterDetour,
        ),
        1 => stage(at(DRAG_FROM_M, pressing), Fingers::Close, Until::AtPoseOrStopped),
        2 => {
            let has_slipped = (world.grip - entity.centre).horizontal_norm() > widest;
            let is_done = distance < DRAG_DONE_M || has_slipped;
            let pulled = at(DRAG_FROM_M + DRAG_LEAD_M, pressing);
            stage(pulled, Fingers::Close, Until::ConditionHolds(is_done))
        }
        3 => stage(
            at(DRAG_FROM_M, entity.top() + STANDOFF_M / 2.0),
            Fingers::Close,
            Until::AtPoseOrStopped,
        ),
        _ => return Ok(None),
    }))
}

pub(crate) fn only_joint(world: &World, fixture: &str) -> Result<f64, ExpertError> {
    let name = world.joints_of(fixture).next();
    let name = name.ok_or_else(|| ExpertError::NoJoint { fixture: fixture.to_owned() })?;
    world.joint(name)
}

/// Returns true if `object` is too flat and too wide for the hand to lift: wider than the hand
/// opens, 0.08 m, and less than a quarter as high as wide.
pub(crate) fn must_be_dragged(object: &Entity) -> bool {
    let narrower = object.half.x.min(object.half.y);
    narrower > 0.04 && object.half.z < 0.25 * narrower
}

fn stage(hand: HandPose, fingers: Fingers, until: Until) -> Stage {
    Stage { hand, fingers, until }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::expert::kinematic_scene::KinematicScene;

    fn with_hand(mut scene: KinematicScene, hand: HandPose, openings: &[f64]) -> (World, Motion) {
        let (p, q) = (hand.pos, hand.quat);
        scene.state.grip_pos = [p.x, p.y, p.z];
        scene.state.grip_quat_wxyz = [q.w, q.v.x, q.v.y, q.v.z];
        let mut motion = Motion::default();
        for opening in openings {
            scene.state.gripper_opening = *opening;
            motion.observe(&scene.world());
        }
        (scene.world(), motion)
    }

    #[test]
    fn a_hand_keeps_turning_a_knob_that_shifts_between_its_fingers() {
        let scene = || {
            KinematicScene::new("turnon", &["stove_1"])
                .fixture("stove_1", [0.0, 0.4, 0.05], [0.1, 0.1, 0.05])
                .joint("stove_1_button", 0.1)
        };
        let task = RoutineTask::TurnKnob { stove: "stove_1".to_owned() };
        let at_knob = task.stage(2, &scene().world()).unwrap().unwrap().hand;
        let stage_after = |openings: &[f64]| {
            let (world, motion) = with_hand(scene(), at_knob, openings);
            task.current_stage(&world, &motion).unwrap()
        };
        assert_eq!(stage_after(&[0.026, 0.026, 0.027]), 3, "the knob shifts between the fingers");
        assert_eq!(stage_after(&[0.06, 0.05, 0.04]), 2, "the fingers close");
        assert_eq!(stage_after(&[0.0; 5]), 0, "there is nothing between the fingers");
    }

    #[test]
    fn a_hand_at_a_knob_that_is_on_finishes_the_turn_and_leaves() {
        let task = RoutineTask::TurnKnob { stove: "stove_1".to_owned() };
        let stage_at = |position: f64, opening: f64| {
            let scene = KinematicScene::new("turnon", &["stove_1"])
                .fixture("stove_1", [0.0, 0.4, 0.05], [0.1, 0.1, 0.05])
                .joint("stove_1_button", position);
            let at_knob = task.stage(2, &scene.world()).unwrap().unwrap().hand;
            let (world, motion) = with_hand(scene, at_knob, &[opening; 3]);
            assert!(is_at_knob(&world, "stove_1").unwrap());
            task.current_stage(&world, &motion).unwrap()
        };
        assert_eq!(stage_at(0.6, 0.026), 3, "turns further");
        assert_eq!(stage_at(0.9, 0.026), 4, "opens the fingers");
        assert_eq!(stage_at(0.9, 0.08), 5, "leaves");
    }

    #[test]
    fn a_hand_that_turns_with_the_door_keeps_pushing_it() {
        let scene = || {
            KinematicScene::new("close", &["microwave_1"])
                .fixture("microwave_1", [0.0, 0.4, 0.1], [0.2, 0.1, 0.1])
                .joint("microwave_1_door", -0.4)
        };
        let task = RoutineTask::PushDoor { microwave: "microwave_1".to_owned() };
        let pose = |number| task.stage(number, &scene().world()).unwrap().unwrap().hand;
        let (from, to) = (pose(0), pose(1));
        for turned in [0.0, 0.8, 1.6, 2.4] {
            let pos = (from.pos + to.pos) * 0.5;
            let quat = Quat::turn(Vec3::UP, turned).after(from.quat);
            let (world, motion) = with_hand(scene(), HandPose { pos, quat }, &[0.0]);
            assert_eq!(task.current_stage(&world, &motion).unwrap(), 1, "{turned}");
        }
    }
}
