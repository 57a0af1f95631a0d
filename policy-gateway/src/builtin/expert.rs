//! `builtin:expert`: a scripted manipulator for LIBERO's tasks, deterministic,
//! that looks at no camera and asks for the simulator's own state instead. It
//! exists to exercise the whole service with rollouts that mostly succeed, and
//! every result of it is marked privileged: it is no baseline for policies
//! that see. Skills live in the rooms below; this file only runs them one
//! after the other.

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

use proto::policy::{DescribeResponse, Language, Observation, ResetRequest};

use super::instance::{Action, BuiltinPolicy};
use geometry::Vec3;
use goal::Skill;
use motion::{Command, Fingers, HandPose, Motion};
use world::World;

/// What the expert declares: no cameras, no robot readings, privileged state,
/// one action per query.
pub fn describe() -> DescribeResponse {
    DescribeResponse {
        protocol_version: proto::PROTOCOL_VERSION,
        name: "expert".to_owned(),
        checkpoint: format!("builtin:expert {}", env!("CARGO_PKG_VERSION")),
        horizon: 1,
        execute: 1,
        stateful: true,
        language: Language::Ignored.into(),
        privileged: true,
        ..DescribeResponse::default()
    }
}

/// One episode.
#[derive(Debug)]
pub struct Expert {
    /// What is left to do; none before the first observation.
    plan: Option<VecDeque<Skill>>,
    motion: Motion,
    /// As seen in the first observation, when the hand is at rest.
    shoulder: Option<Vec3>,
}

impl Expert {
    /// A fresh episode. The goal comes with the observations, not with the
    /// instruction, so the request is not looked at.
    pub fn new(_reset: &ResetRequest) -> Self {
        Self {
            plan: None,
            motion: Motion::default(),
            shoulder: None,
        }
    }

    /// The next skill's command; a plan that has run out is made anew, since
    /// an episode that goes on has not reached its goal.
    fn command(&mut self, world: &World) -> Result<Command, String> {
        let mut plan = match self.plan.take() {
            Some(plan) => plan,
            None => goal::plan(world)?.into(),
        };
        let mut wanted = None;
        while let (None, Some(skill)) = (wanted, plan.front_mut()) {
            wanted = skill.step(world, &self.motion)?;
            if wanted.is_none() {
                plan.pop_front();
            }
        }
        self.plan = (!plan.is_empty()).then_some(plan);
        let here = HandPose {
            pos: world.grip,
            quat: world.grip_quat,
        };
        Ok(wanted.unwrap_or(Command {
            hand: here,
            fingers: Fingers::Open,
            pace: 1.0,
        }))
    }
}

impl BuiltinPolicy for Expert {
    fn infer(
        &mut self,
        _query_index: u32,
        observation: &Observation,
    ) -> Result<Vec<Action>, String> {
        let state = observation.privileged.as_ref();
        let state = state
            .ok_or("the observation carries no privileged state, which the expert asks for")?;
        let mut world = World::read(state)?;
        world.shoulder = *self.shoulder.get_or_insert(world.shoulder);
        self.motion.observe(&world);
        let command = self.command(&world)?;
        Ok(vec![motion::servo(&world, &self.motion, &command)])
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

    /// Every action of an episode of `steps` steps.
    fn episode(steps: u32) -> Vec<Action> {
        let (mut scene, mut expert) = (scene(), Expert::new(&ResetRequest::default()));
        let mut actions = Vec::new();
        for query_index in 0..steps {
            let observation = Observation {
                privileged: Some(scene.state.clone()),
                ..Observation::default()
            };
            let answer = expert.infer(query_index, &observation).expect("an answer");
            scene.apply(answer[0]);
            actions.extend(answer);
        }
        actions
    }

    #[test]
    fn an_episode_is_the_same_twice_and_every_action_is_in_range() {
        let actions = episode(250);
        assert_eq!(actions, episode(250));
        assert_eq!(actions.len(), 250);
        assert!(actions.iter().flatten().all(|v| (-1.0..=1.0).contains(v)));
    }

    #[test]
    fn an_observation_without_privileged_state_is_refused() {
        let mut expert = Expert::new(&ResetRequest::default());
        let refusal = expert.infer(0, &Observation::default()).unwrap_err();
        assert!(refusal.contains("privileged"), "{refusal}");
    }

    #[test]
    fn an_entity_of_the_wrong_width_is_refused_by_name() {
        let mut state = scene().state;
        state.entities[0].pos.pop();
        let observation = Observation {
            privileged: Some(state),
            ..Observation::default()
        };
        let mut expert = Expert::new(&ResetRequest::default());
        let refusal = expert.infer(0, &observation).unwrap_err();
        assert!(
            refusal.contains("bowl_1") && refusal.contains("pos"),
            "{refusal}"
        );
    }

    #[test]
    fn a_number_as_in_no_scene_is_refused_by_name() {
        for number in [1e256, -101.0, f64::NAN, f64::INFINITY] {
            let mut state = scene().state;
            state.grip_pos[1] = number;
            let observation = Observation {
                privileged: Some(state),
                ..Observation::default()
            };
            let mut expert = Expert::new(&ResetRequest::default());
            let refusal = expert.infer(0, &observation).unwrap_err();
            let expected = format!("grip_pos of 'gripper' holds {number}");
            assert!(refusal.contains(&expected), "{refusal}");
        }
    }

    #[test]
    fn it_says_that_it_is_privileged_and_needs_no_camera() {
        let described = describe();
        assert!(described.privileged && described.cameras.is_empty());
        assert_eq!((described.horizon, described.execute), (1, 1));
    }
}
