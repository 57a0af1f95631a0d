//! Interface of a rollout's actors (a policy behind a connection, or a recording) and the types of
//! their queries and answers. The implementations are in `policy` and `single`.

use std::path::PathBuf;
use std::time::Duration;

use benchmark::{Query, TooLate};
use proto::checks::{ACTION_WIDTH, ActionFault, DescriptionFault};
use proto::policy::{DescribeResponse, Observation, StateField};
use transport::{AccessError, EndpointError};

/// One control step's action: translation, rotation, gripper. The simulator clips numbers beyond
/// [-1, 1].
pub type Action = [f64; ACTION_WIDTH];

/// Reason why a policy gave no usable answer. The message is a whole sentence; campaigns show
/// the message beside the rollout, so it names neither rollout nor session.
#[derive(Debug, thiserror::Error)]
pub enum PolicyError {
    #[error("a policy cannot be called: failed to {0}")]
    Endpoint(#[source] EndpointError),
    #[error("a policy cannot be called: failed to {0}")]
    Access(#[source] AccessError),
    #[error("a policy cannot be called: failed to start the client ({0})")]
    Runtime(#[source] std::io::Error),
    /// The policy did not answer, answered that it is unavailable for now, or refused to describe
    /// itself.
    #[error("{}", sentence(policy, endpoint, "did not answer", call, problem))]
    Unavailable {
        /// The call: "Describe", "Reset", "query 3".
        call: String,
        policy: String,
        endpoint: String,
        problem: String,
        /// Number of queries that the policy had answered in this attempt; `None` if it had not
        /// even described itself, or is overloaded.
        answered: Option<u32>,
    },
    #[error("{} at {endpoint} cannot be used: {fault}", label(policy))]
    Description { policy: String, endpoint: String, fault: DescriptionFault },
    #[error(
        "{} cannot be run in LIBERO: it asks for {wanted}, which only other simulators have \
         (docs/SIMULATORS.md)",
        label(policy)
    )]
    Foreign {
        policy: String,
        /// A reading by name, or a camera.
        wanted: String,
    },
    #[error("{} cannot be run this way: {problem}", label(policy))]
    TooLate {
        policy: String,
        /// Length and delay of the answers. Part of the message rather than its source, because
        /// campaigns show a single sentence.
        problem: TooLate,
    },
    #[error(
        "{} at {endpoint} gave an invalid answer to {call}: {fault}; \
         `policy-gateway check` looks for the cause",
        label(policy)
    )]
    InvalidAnswer {
        /// The call: "query 3".
        call: String,
        policy: String,
        endpoint: String,
        fault: ActionFault,
    },
    #[error("{}", sentence(policy, endpoint, "failed at", call, problem))]
    Failed {
        /// The call: "Reset", "query 3".
        call: String,
        policy: String,
        endpoint: String,
        problem: String,
    },
    #[error(
        "the recording {} ends after {actions} actions, before the rollout does",
        path.display()
    )]
    RecordingEnded { path: PathBuf, actions: usize },
}

/// Returns a policy's name for use in a sentence; an empty name means the server's only policy.
fn label(policy: &str) -> String {
    match policy {
        "" => "the policy".to_owned(),
        name => format!("policy `{name}`"),
    }
}

/// Composes the sentence of a failed call. A gateway's answer names the policy already, as its
/// route; the sentence then does not name the policy again.
fn sentence(policy: &str, endpoint: &str, verb: &str, call: &str, problem: &str) -> String {
    let is_named = |end| problem.contains(&format!("route {policy}{end}"));
    if !policy.is_empty() && (is_named(" ") || is_named(":")) {
        format!("{call} failed: {problem}")
    } else {
        format!("{} at {endpoint} {verb} {call}: {problem}", label(policy))
    }
}

#[derive(Clone, Debug, PartialEq)]
pub struct Description {
    /// Description as the policy gave it.
    pub about: DescribeResponse,
    /// Robot readings that the policy asks for, in the policy's order.
    pub state: Vec<StateField>,
    /// Maximum number of actions per answer.
    pub horizon: usize,
    /// Actions executed per answer.
    pub execute: usize,
}

/// Names and deadline of the session in which a policy is called.
#[derive(Clone, Copy, Debug)]
pub struct PolicySession<'a> {
    /// The policy's name at the endpoint.
    pub policy: &'a str,
    pub session: &'a str,
    /// The rollout's suite; a policy may have a separate checkpoint for each suite.
    pub suite: &'a str,
    /// Longest wait for one answer.
    pub deadline: Duration,
}

/// Source of a rollout's actions: a policy behind a connection, or a recording.
pub trait Actor {
    fn describe(&mut self, session: PolicySession<'_>) -> Result<Description, PolicyError>;

    /// Starts an episode. Actors that keep no state between episodes do nothing.
    fn reset(
        &mut self,
        _session: PolicySession<'_>,
        _instruction: &str,
        _seed: u64,
    ) -> Result<(), PolicyError> {
        Ok(())
    }

    /// Ends the episode at the actor. Errors are ignored: a policy bounds its stored sessions in
    /// any case.
    fn end(&mut self, _session: PolicySession<'_>) {}

    /// Returns the actions for one observation: between one and `horizon`, finite, not yet clipped.
    /// `under_way` holds the answer's delay and the commands that are scheduled already; `None`
    /// unless the execution model sends them to the actor.
    fn infer(
        &mut self,
        session: PolicySession<'_>,
        query_index: u32,
        observation: Observation,
        horizon: usize,
        under_way: Option<&Query>,
    ) -> Result<Vec<Action>, PolicyError>;
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Regression: errors read as imperatives and named policy and session twice ("use the answer
    /// of policy `bad` to query 0 of session … session …").
    #[test]
    fn errors_are_sentences_that_name_the_policy_once() {
        let failed = |policy: &str, problem: &str| PolicyError::Failed {
            call: "query 0".to_owned(),
            policy: policy.to_owned(),
            endpoint: "http://gpu-1:5000".to_owned(),
            problem: problem.to_owned(),
        };
        let raised = "infer raised ValueError: no frame";
        assert_eq!(
            failed("bad", raised).to_string(),
            format!("policy `bad` at http://gpu-1:5000 failed at query 0: {raised}")
        );
        assert_eq!(
            failed("", raised).to_string(),
            format!("the policy at http://gpu-1:5000 failed at query 0: {raised}")
        );
        let by_gateway = "route bad (grpc://gpu-1:5000): the policy failed";
        assert_eq!(failed("bad", by_gateway).to_string(), format!("query 0 failed: {by_gateway}"));
    }
}
