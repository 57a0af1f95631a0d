//! Actors of rollouts, with their queries and answers. Responsible for nothing
//! but the interface: policies behind a connection are `policy`'s, recordings
//! `single`'s.

use std::path::PathBuf;
use std::time::Duration;

use libero_ctrl::{Query, TooLate};
use policy_protocol::{ACTION_WIDTH, ActionFault, DescriptionFault};
use proto::policy::{DescribeResponse, Observation, StateField};
use transport::{AccessError, EndpointError};

/// One control step's action, each number in [-1, 1].
pub type Action = [f64; ACTION_WIDTH];

/// Why a policy gave no usable answer, in a whole sentence. Campaigns show it beside the
/// rollout that it is of, so that it names neither rollout nor session.
#[derive(Debug, thiserror::Error)]
pub enum PolicyError {
    /// The endpoint is not one.
    #[error("a policy cannot be called: failed to {0}")]
    Endpoint(#[source] EndpointError),
    /// The endpoint cannot be called over TLS.
    #[error("a policy cannot be called: failed to {0}")]
    Access(#[source] AccessError),
    /// No runtime to call from.
    #[error("a policy cannot be called: failed to start the client ({0})")]
    Runtime(#[source] std::io::Error),
    /// No answer, or an answer that says "not now".
    #[error("{}", sentence(policy, endpoint, "did not answer", call, problem))]
    Unavailable {
        /// The call: "Describe", "Reset", "query 3".
        call: String,
        /// The policy's name at the endpoint.
        policy: String,
        /// The campaign's endpoint.
        endpoint: String,
        /// A sentence of what happened and what to do.
        problem: String,
        /// Queries that it had answered in this session, if it was there at the first
        /// one and is gone now; none if it never was there, or is overloaded.
        answered: Option<u32>,
    },
    /// It describes itself as something that no rollout can work with.
    #[error("{} at {endpoint} cannot be used: {fault}", named(policy))]
    Description {
        /// The policy's name at the endpoint.
        policy: String,
        /// The campaign's endpoint.
        endpoint: String,
        /// Fault of the description.
        fault: DescriptionFault,
    },
    /// Its answers are so short, and so late, that none would be executed.
    #[error("{} cannot be run so: {problem}", named(policy))]
    TooLate {
        /// The policy's name at the endpoint.
        policy: String,
        /// Its answers and their delay. Part of the message, for campaigns show one sentence.
        problem: TooLate,
    },
    /// It answered, and the answer cannot be executed.
    #[error(
        "{} at {endpoint} answered {call} with what is no chunk of actions: {fault}; \
         `policy-gateway doctor` looks for the cause",
        named(policy)
    )]
    Nonsense {
        /// The call: "query 3".
        call: String,
        /// The policy's name at the endpoint.
        policy: String,
        /// The campaign's endpoint.
        endpoint: String,
        /// The fault of the answer.
        fault: ActionFault,
    },
    /// It answered with an error.
    #[error("{}", sentence(policy, endpoint, "failed at", call, problem))]
    Failed {
        /// The call: "Reset", "query 3".
        call: String,
        /// The policy's name at the endpoint.
        policy: String,
        /// The campaign's endpoint.
        endpoint: String,
        /// The answer.
        problem: String,
    },
    /// A recording has no more actions.
    #[error("the recording {} ends after {actions} actions, and the rollout goes on", path.display())]
    Ended {
        /// The file.
        path: PathBuf,
        /// Actions in it.
        actions: usize,
    },
}

/// The name of a policy in a sentence; the only one of its server has none.
fn named(policy: &str) -> String {
    match policy {
        "" => "the policy".to_owned(),
        name => format!("policy `{name}`"),
    }
}

/// A sentence of a call that failed. A gateway names the policy in its answer, as its
/// route; then the sentence does not name it again.
fn sentence(policy: &str, endpoint: &str, verb: &str, call: &str, problem: &str) -> String {
    let is_named = |end| problem.contains(&format!("route {policy}{end}"));
    if !policy.is_empty() && (is_named(" ") || is_named(":")) {
        format!("{call} failed: {problem}")
    } else {
        format!("{} at {endpoint} {verb} {call}: {problem}", named(policy))
    }
}

/// A checked description of a policy.
#[derive(Clone, Debug, PartialEq)]
pub struct Description {
    /// Description as the policy gave it.
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

/// Source of a rollout's actions: a policy behind a connection, or a recording.
pub trait Actor {
    /// Describes the actor and its inputs.
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
    /// finite, not yet clipped. It is told what is executed meanwhile, if anything is said of
    /// it.
    ///
    /// # Errors
    /// If it does not answer, or answers something else.
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

    /// Defect: errors read as orders and named policy and session twice ("use the answer
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
        assert_eq!(
            failed("bad", by_gateway).to_string(),
            format!("query 0 failed: {by_gateway}")
        );
    }
}
