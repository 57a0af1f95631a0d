//! `builtin:noop`: stands still with an open gripper. Measures the cost of a rollout without a
//! policy, and gives the lower bound of success rates.

use proto::policy::{DescribeResponse, Language, Observation};

use super::{Action, BuiltinPolicy};

/// Zero motion with an open gripper: the action of LIBERO's settling steps.
pub const NOOP_ACTION: Action = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, -1.0];

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
