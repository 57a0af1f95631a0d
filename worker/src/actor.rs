//! What acts in a rollout, and what it is asked and answers. Responsible for
//! nothing but the seam: policies behind a connection are `policy`'s, recordings
//! `single`'s.

use std::time::Duration;

use proto::policy::{DescribeResponse, Observation, StateField};
use transport::{AccessError, EndpointError};

/// The cameras of a LIBERO scene that policies may look through.
pub(crate) const CAMERAS: [&str; 2] = ["agentview", "robot0_eye_in_hand"];
/// Numbers per action: translation, rotation, gripper.
pub const ACTION_WIDTH: usize = 7;

/// One control step's action, each number in [-1, 1].
pub type Action = [f64; ACTION_WIDTH];

/// Why a policy gave no usable answer.
#[derive(Debug, thiserror::Error)]
pub enum PolicyError {
    /// The endpoint is not one.
    #[error(transparent)]
    Endpoint(#[from] EndpointError),
    /// The endpoint cannot be called over TLS.
    #[error(transparent)]
    Access(#[from] AccessError),
    /// No runtime to call from.
    #[error("start the policy client: {0}")]
    Runtime(#[source] std::io::Error),
    /// No answer, or an answer that says "not now".
    #[error("{call} {} at {endpoint}: {problem}", named(policy))]
    Unavailable {
        /// "describe", "reset", "ask".
        call: &'static str,
        /// Which policy.
        policy: String,
        /// Where.
        endpoint: String,
        /// What happened.
        problem: String,
    },
    /// It describes itself as something that no rollout can work with.
    #[error("use {} at {endpoint}: its description {problem}", named(policy))]
    Description {
        /// Which policy.
        policy: String,
        /// Where.
        endpoint: String,
        /// What is wrong with it.
        problem: String,
    },
    /// It answered, and the answer cannot be executed.
    #[error(
        "use the answer of {} to query {query} of session {session}: {violation}",
        named(policy)
    )]
    Misbehaved {
        /// Which policy.
        policy: String,
        /// In which session.
        session: String,
        /// To which query; "reset" before the first.
        query: String,
        /// What is wrong with it.
        violation: String,
    },
}

/// A policy in a sentence; the only one of its server has no name.
fn named(policy: &str) -> String {
    match policy {
        "" => "the policy".to_owned(),
        name => format!("policy `{name}`"),
    }
}

impl PolicyError {
    /// Whether the policy answered at all: what it answered is charged to the
    /// rollout, that it did not is not. Neither is a description that fits no
    /// rollout, because all of the policy's rollouts would pay for it.
    pub fn is_misbehaviour(&self) -> bool {
        matches!(self, Self::Misbehaved { .. })
    }
}

/// A checked description of a policy.
#[derive(Clone, Debug, PartialEq)]
pub struct Description {
    /// As the policy gave it.
    pub about: DescribeResponse,
    /// The robot readings it wants, in its order.
    pub state: Vec<StateField>,
    /// Actions per answer at most.
    pub horizon: usize,
    /// Actions executed per answer.
    pub execute: usize,
}

/// Whom to ask, in which session, for how long.
#[derive(Clone, Copy, Debug)]
pub struct PolicySession<'a> {
    /// The policy's name at the endpoint.
    pub policy: &'a str,
    /// The session's name.
    pub session: &'a str,
    /// The rollout's suite, of which a policy may have a checkpoint of its own.
    pub suite: &'a str,
    /// Longest wait for one answer.
    pub deadline: Duration,
}

/// What acts in rollouts: a policy behind a connection, or a recording.
pub trait Actor {
    /// What it is and wants to see.
    ///
    /// # Errors
    /// If it does not answer, speaks another version, or describes something
    /// that no rollout can work with.
    fn describe(&mut self, session: PolicySession<'_>) -> Result<Description, PolicyError>;

    /// Starts an episode. Nothing happens in those that keep nothing from one
    /// episode to the next.
    ///
    /// # Errors
    /// If it does not answer or refuses.
    fn reset(
        &mut self,
        _session: PolicySession<'_>,
        _suite: &str,
        _instruction: &str,
        _seed: u64,
    ) -> Result<(), PolicyError> {
        Ok(())
    }

    /// Notes that the episode is over. What goes wrong is nobody's loss: a policy
    /// bounds what it keeps in any case.
    fn end(&mut self, _session: PolicySession<'_>) {}

    /// Its answers to one observation: between one and `horizon` actions,
    /// finite, not yet clipped.
    ///
    /// # Errors
    /// If it does not answer, or answers something else.
    fn infer(
        &mut self,
        session: PolicySession<'_>,
        query_index: u32,
        observation: Observation,
        horizon: usize,
    ) -> Result<Vec<Action>, PolicyError>;
}

/// The action with every number in [-1, 1].
pub fn clip(action: Action) -> Action {
    action.map(|number| number.clamp(-1.0, 1.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_numbers_outside_the_range_are_clipped() {
        let inside = [1.0, -1.0, 0.5, 0.0, 0.0, 0.0, -1.0];
        assert_eq!(clip(inside), inside);
        let outside = [1.5, -1.0, 0.5, 0.0, 0.0, 0.0, -3.0];
        assert_eq!(clip(outside), inside);
    }
}
