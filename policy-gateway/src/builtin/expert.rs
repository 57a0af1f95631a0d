//! `builtin:expert`: a scripted manipulator for LIBERO's tasks, deterministic,
//! that looks at no camera and asks for the simulator's own state instead. It
//! exists to exercise the whole service with rollouts that mostly succeed, and
//! every result of it is marked privileged: it is no baseline for policies
//! that see. Skills live in the rooms below; this file only runs them one
//! after the other.

mod geometry;
mod goal;
mod grasp;
mod motion;
mod place;
mod routine;
mod transfer;
mod world;

use std::collections::VecDeque;

use proto::policy::{DescribeResponse, Language, Observation, ResetRequest};

use super::BuiltinPolicy;
use goal::Skill;
use motion::{Command, Fingers, HandPose, Motion};
use world::World;

/// What the expert declares: no cameras, no robot readings, privileged state,
/// one action per query.
pub fn describe() -> DescribeResponse {
    DescribeResponse {
        protocol_version: proto::PROTOCOL_VERSION,
        name: "expert".to_owned(),
        checkpoint: "builtin:expert".to_owned(),
        checkpoint_digest: String::new(),
        parameters: 0,
        cameras: Vec::new(),
        state: Vec::new(),
        horizon: 1,
        execute: 1,
        stateful: true,
        stochastic: false,
        language: Language::Ignored.into(),
        max_batch: 1,
        privileged: true,
    }
}

/// One episode.
#[derive(Debug)]
pub struct Expert {
    /// What is left to do; none before the first observation.
    plan: Option<VecDeque<Skill>>,
    motion: Motion,
}

impl Expert {
    /// A fresh episode. The goal comes with the observations, not with the
    /// instruction, so the request is not looked at.
    pub fn new(_reset: &ResetRequest) -> Self {
        Self {
            plan: None,
            motion: Motion::default(),
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
    ) -> Result<Vec<[f32; 7]>, String> {
        let state = observation.privileged.as_ref();
        let state = state
            .ok_or("the observation carries no privileged state, which the expert asks for")?;
        let world = World::read(state)?;
        self.motion.observe(&world);
        let command = self.command(&world)?;
        Ok(vec![motion::servo(&world, &self.motion, &command)])
    }
}
