//! A deterministic scripted policy for LIBERO's tasks that observes the simulator's
//! privileged state instead of cameras. It exercises the whole service with rollouts
//! that mostly succeed, and provides demonstrations for visual policies, for which it is not a
//! baseline. The modules define skills; this file runs the skills in sequence.

mod geometry;
mod goal;
mod grasp;
#[cfg(test)]
mod kinematic_scene;
mod motion;
mod place;
mod routine;
mod transfer;
mod world;

use std::collections::VecDeque;
use std::f64::consts::FRAC_PI_2;

use benchmark::Privileged;

use geometry::Vec3;
use goal::Skill;
use motion::{Command, Fingers, HandPose, Motion};
use world::World;

pub use motion::Action;

#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ExpertError {
    #[error("the scene has {given} objects, fixtures and regions; the expert supports {most}")]
    Entities { given: usize, most: usize },
    #[error("the scene has no object, fixture or region named '{name}'")]
    NoEntity { name: String },
    #[error("the scene has no joint named '{name}'")]
    NoJointNamed { name: String },
    #[error("'{fixture}' has no joint")]
    NoJoint { fixture: String },
    #[error("'{region}' is in no drawer")]
    NoDrawer { region: String },
    #[error("'{object}' cannot be held")]
    NotGraspable { object: String },
    #[error("the expert has no skill for the goal '{goal}'; run this task with another policy")]
    NoSkill { goal: String },
    #[error("{field} of '{owner}' is {value}, outside the range that the expert supports")]
    OutOfRange { field: &'static str, owner: String, value: f64 },
}

/// Number of steps after which a hand far from its target counts as stuck.
const PATIENCE_STEPS: u32 = 20;
/// Distances from the target beyond which the hand counts as far, m and rad.
const FAR_M: f64 = 0.012;
const FAR_RAD: f64 = 0.25;
/// Number of steps of a stuck hand's retreat: up in the first half, back to rest in the second.
const BACKING_STEPS: u32 = 32;
/// Displacement in some steps below which a hand far from its target makes no progress, m.
const PROGRESS_M: f64 = 0.008;
/// Height of the target above the hand in the first half of the retreat, m.
const STEP_M: f64 = 0.05;

/// State of the scripted policy in one rollout. A clone continues like the original.
#[derive(Clone, Debug, Default)]
pub struct Expert {
    /// Remaining skills; `None` before the first observation.
    plan: Option<VecDeque<Skill>>,
    motion: Motion,
    /// Position of the shoulder, from the first observation, when the hand is at rest.
    shoulder: Option<Vec3>,
    /// Number of consecutive steps of the expert in which the hand was far from its target.
    far_steps: u32,
    backing_steps: u32,
    /// True if the last action was a step of that retreat.
    is_retreating: bool,
    /// True if another controller has driven the robot since the last action.
    is_interrupted: bool,
}

impl Expert {
    /// Returns the action for a state. Must be called at every control step, in order, even
    /// while another controller drives the robot ([`Self::interrupt`]), because the policy
    /// tracks its own actions and the motion of the hand.
    pub fn act(&mut self, state: &Privileged) -> Result<Action, ExpertError> {
        let mut world = World::read(state)?;
        world.shoulder = *self.shoulder.get_or_insert(world.shoulder);
        self.motion.observe(&world);
        if self.is_interrupted {
            (self.far_steps, self.backing_steps) = (0, 0);
        }
        let command = self.command(&world)?;
        let command = self.unstuck(&world, command);
        Ok(motion::servo(&world, &self.motion, &command))
    }

    /// Reports that the robot did not execute the last action. The next action is then replanned:
    /// the expert derives the remaining goals, the held object and the phase of its skill from the
    /// state and the hand's motion. Of its plan, it keeps only the grasps tried on the next object
    /// and the pose of an object in the hand.
    /// Without this call, the other controller's steps would count as the expert's own, and a hand
    /// held still by the other controller would be mistaken for a hand stopped by an object.
    pub fn interrupt(&mut self) {
        self.is_interrupted = true;
    }

    /// Returns true if the last action moved a stuck hand back. Such an action depends on how long
    /// the hand has been stuck, which neither a picture nor the state shows.
    #[must_use]
    pub fn is_retreating(&self) -> bool {
        self.is_retreating
    }

    /// Returns true if the hand was far from its target in all of the last `steps` steps and hardly
    /// moved.
    #[must_use]
    pub fn makes_no_progress(&self, steps: u32) -> bool {
        self.far_steps >= steps && self.motion.moved(steps) < PROGRESS_M
    }

    /// Returns `command`, unless the hand is stuck: caught on an object, or at a joint limit of the
    /// arm, which the expert does not foresee. A stuck hand first moves up and then back to its
    /// rest position, for a number of steps.
    fn unstuck(&mut self, world: &World, command: Command) -> Command {
        // Commands at a lower pace move the hand near obstacles, where contact may stop it.
        let travels = command.pace >= 1.0;
        let is_far = !command.hand.is_near(world, FAR_M, FAR_RAD);
        self.far_steps = if travels && is_far { self.far_steps + 1 } else { 0 };
        if self.far_steps >= PATIENCE_STEPS && self.motion.is_stuck() {
            (self.far_steps, self.backing_steps) = (0, BACKING_STEPS);
        }
        self.is_retreating = self.backing_steps > 0;
        if !self.is_retreating {
            return command;
        }
        self.backing_steps -= 1;
        let up = world.grip + Vec3::UP * STEP_M;
        let pos = match self.backing_steps >= BACKING_STEPS / 2 {
            true => up,
            false => world.rest().at_height(world.rest().z.max(world.grip.z)),
        };
        Command { hand: HandPose { pos, quat: motion::pointing_down(FRAC_PI_2) }, ..command }
    }

    /// Replans when the plan is exhausted: an episode that continues has not reached its goal.
    fn command(&mut self, world: &World) -> Result<Command, ExpertError> {
        let is_interrupted = std::mem::take(&mut self.is_interrupted);
        let mut plan = match (self.plan.take(), is_interrupted) {
            (plan, true) => goal::resume(world, &self.motion, &plan.unwrap_or_default())?.into(),
            (Some(plan), false) => plan,
            (None, false) => goal::plan(world)?.into(),
        };
        let mut next = None;
        while let (None, Some(skill)) = (next, plan.front_mut()) {
            next = skill.step(world, &self.motion)?;
            if next.is_none() {
                plan.pop_front();
            }
        }
        self.plan = (!plan.is_empty()).then_some(plan);
        let current = HandPose { pos: world.grip, quat: world.grip_quat };
        Ok(next.unwrap_or(Command { hand: current, fingers: Fingers::Open, pace: 1.0 }))
    }
}

#[cfg(test)]
mod tests {
    use super::kinematic_scene::KinematicScene;
    use super::*;

    fn scene() -> KinematicScene {
        KinematicScene::new("on", &["bowl_1", "plate_1"])
            .object("bowl_1", [-0.1, -0.1, 0.025], [0.054, 0.054, 0.025])
            .object("plate_1", [0.05, 0.2, 0.01], [0.069, 0.069, 0.01])
    }

    fn episode(steps: u32) -> Vec<Action> {
        let (mut scene, mut expert) = (scene(), Expert::default());
        let mut actions = Vec::new();
        for _ in 0..steps {
            let action = expert.act(&scene.state).expect("an action");
            scene.apply(action);
            actions.push(action);
        }
        actions
    }

    #[test]
    fn episodes_are_deterministic_and_every_action_is_in_range() {
        let actions = episode(250);
        assert_eq!(actions, episode(250));
        assert_eq!(actions.len(), 250);
        assert!(actions.iter().flatten().all(|v| (-1.0..=1.0).contains(v)));
    }

    /// Returns true if the goal is reached within `steps` steps. `override_action` may replace the
    /// expert's action at each step.
    fn succeeds_in(
        mut scene: KinematicScene,
        steps: u32,
        override_action: impl Fn(u32, Action) -> Option<Action>,
    ) -> bool {
        let mut expert = Expert::default();
        (0..steps).any(|step| {
            let action = expert.act(&scene.state).expect("an action");
            let replacement = override_action(step, action);
            if replacement.is_some() {
                expert.interrupt();
            }
            scene.apply(replacement.unwrap_or(action));
            let world = scene.world();
            goal::plan(&world).expect("a plan").is_empty() && world.opening > motion::FINGERS_OPEN_M
        })
    }

    fn succeeds(steps: u32, override_action: impl Fn(u32, Action) -> Option<Action>) -> bool {
        succeeds_in(scene(), steps, override_action)
    }

    #[test]
    fn an_expert_interrupted_at_every_step_succeeds() {
        // An interrupted expert derives the phase of its skill from state and motion.
        assert!(succeeds(250, |_, action| Some(action)));
    }

    #[test]
    fn an_expert_interrupted_at_every_step_puts_a_mug_into_a_covered_region() {
        let oven = KinematicScene::mug_before_oven;
        assert!(succeeds_in(oven(), 400, |_, _| None), "uninterrupted");
        assert!(succeeds_in(oven(), 400, |_, action| Some(action)));
    }

    #[test]
    fn the_expert_succeeds_after_another_controller_stops_moves_or_opens_the_hand() {
        let still = |gripper| move |_: Action| [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, gripper];
        let aside = |_: Action| [0.6, -0.6, 0.3, 0.0, 0.0, 0.0, 1.0];
        let controllers: [&dyn Fn(Action) -> Action; 3] = [&still(-1.0), &still(1.0), &aside];
        for (number, controller) in controllers.iter().enumerate() {
            for first in (10..120).step_by(10) {
                let overridden = first..first + 12;
                let succeeded = succeeds(300, |step, action| {
                    overridden.contains(&step).then(|| controller(action))
                });
                assert!(succeeded, "controller {number} from step {first} on");
            }
        }
    }

    #[test]
    fn an_expert_that_takes_over_a_held_object_keeps_the_hand_closed() {
        let (mut scene, mut expert) = (scene(), Expert::default());
        for _ in 0..200 {
            if scene.state.entities[0].pos[2] > 0.05 {
                break;
            }
            let action = expert.act(&scene.state).expect("an action");
            scene.apply(action);
        }
        assert!(scene.state.entities[0].pos[2] > 0.05, "the expert lifts the bowl");
        // A new expert takes over a grasp that it has not observed.
        let mut new_expert = Expert::default();
        for _ in 0..4 {
            new_expert.interrupt();
            let action = new_expert.act(&scene.state).expect("an action");
            scene.apply([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]);
            if action[6] > 0.0 {
                return;
            }
        }
        panic!("the expert opens the hand");
    }

    #[test]
    fn an_out_of_range_number_is_refused_by_name() {
        for number in [1e256, -101.0, f64::NAN, f64::INFINITY] {
            let valid = scene().joint("drawer_1_slide", 0.1).state;
            let (mut position, mut joint, mut opening) = (valid.clone(), valid.clone(), valid);
            position.grip_pos[1] = number;
            joint.joints[0].1 = number;
            opening.gripper_opening = number;
            for (state, field) in [
                (position, "grip_pos of 'gripper'"),
                (joint, "position of 'drawer_1_slide'"),
                (opening, "gripper_opening of 'gripper'"),
            ] {
                let refusal = Expert::default().act(&state).unwrap_err().to_string();
                let expected = format!("{field} is {number}");
                assert!(refusal.contains(&expected), "{refusal}");
            }
        }
    }
}
