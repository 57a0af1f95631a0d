//! The policy that does nothing: it stands still with an open gripper. What a
//! rollout costs without a policy, and the floor of every success rate.

use proto::policy::{DescribeResponse, Language, Observation};

use super::instance::{Action, BuiltinPolicy};

/// No motion, gripper open: the action of LIBERO's settling steps.
pub const NOOP_ACTION: Action = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, -1.0];

/// Answers [`NOOP_ACTION`] to everything.
#[derive(Clone, Copy, Debug)]
pub struct Noop;

impl BuiltinPolicy for Noop {
    fn infer(
        &mut self,
        _query_index: u32,
        _observation: &Observation,
    ) -> Result<Vec<Action>, String> {
        Ok(vec![NOOP_ACTION])
    }
}

/// Looks at nothing, answers one action at a time.
pub fn describe() -> DescribeResponse {
    DescribeResponse {
        protocol_version: proto::PROTOCOL_VERSION,
        name: "noop".to_owned(),
        checkpoint: format!("builtin:noop {}", env!("CARGO_PKG_VERSION")),
        horizon: 1,
        execute: 1,
        language: Language::Ignored.into(),
        ..DescribeResponse::default()
    }
}
