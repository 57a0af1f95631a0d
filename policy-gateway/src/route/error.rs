//! Errors of a route, as returned to workers.

use std::time::Duration;

use policy_backends::BackendError;
use policy_backends::sessions::MAX_SESSION_BYTES;
use policy_backends::shorten::shorten;
use proto::checks::ActionFault;
use thiserror::Error;
use tonic::{Code, Status};
use transport::{chain, is_outage_code};

use crate::config::RouteName;
use crate::observation_budget::MAX_OBSERVATION_BYTES;

/// Reason why a route did not answer.
#[derive(Debug, Error)]
pub enum RouteError {
    #[error("route {route}{}", replica_problem(replica, source))]
    Replica { route: RouteName, replica: String, source: Box<BackendError> },
    #[error(
        "route {route} ({replica}) got an answer to query {query_index} that is no chunk of \
         actions: {source}; `policy-gateway check {replica}` looks for the cause"
    )]
    Action { route: RouteName, replica: String, query_index: u32, source: ActionFault },
    /// The session is not open: it was never reset, or the gateway restarted or discarded it. The
    /// episode is lost, through no fault of the policy.
    #[error(
        "route {route}: session {session:?} is not open here (the gateway may have restarted \
         since its Reset); start the rollout again"
    )]
    SessionLost { route: RouteName, session: String },
    #[error(
        "route {route} has a checkpoint per suite{}; it has them for {known}",
        suite_problem(suite)
    )]
    Suite {
        route: RouteName,
        /// Requested suite; empty if none is named.
        suite: String,
        known: String,
    },
    #[error("a session's name has 1 to {MAX_SESSION_BYTES} bytes, this one has {bytes}")]
    Session { bytes: usize },
    #[error("route {route} takes no new sessions: it was taken out of the configuration")]
    Retired { route: RouteName },
    #[error(
        "route {route} has {sessions} rollouts under way, as many as its policy servers answer in \
         time at {:.2} s a query; run fewer slots, or give the route more replicas",
        per_query.as_secs_f64()
    )]
    Full { route: RouteName, sessions: usize, per_query: Duration },
    #[error(
        "this gateway holds {} MiB of observations that wait for their answers; try again later, \
         or give policies more replicas",
        MAX_OBSERVATION_BYTES >> 20
    )]
    Overloaded,
}

/// Formats the message after the route's name. Adds the replica unless its error names it, so that
/// the message names the replica exactly once.
fn replica_problem(replica: &str, source: &BackendError) -> String {
    let problem = source.to_string();
    let address = replica.split_once("://").map_or(replica, |(_, rest)| rest);
    let address = address.split('/').next().unwrap_or(address);
    match problem.contains(address) {
        true => format!(": {problem}"),
        false => format!(" ({replica}): {problem}"),
    }
}

/// Formats the reason why a route with a checkpoint per suite has none for a request.
fn suite_problem(suite: &str) -> String {
    match suite.is_empty() {
        true => ", and the request names no suite".to_owned(),
        false => format!(" and none for {suite:?}"),
    }
}

impl RouteError {
    /// Returns the gRPC code to answer a worker with: see [`BackendError`].
    pub fn code(&self) -> Code {
        match self {
            Self::Replica { source, .. } => source.code(),
            Self::Action { .. } => Code::Internal,
            Self::SessionLost { .. } | Self::Retired { .. } => Code::Unavailable,
            Self::Suite { .. } | Self::Session { .. } => Code::InvalidArgument,
            Self::Full { .. } | Self::Overloaded => Code::ResourceExhausted,
        }
    }

    /// Returns true if the infrastructure failed, not this query.
    pub fn is_outage(&self) -> bool {
        is_outage_code(self.code())
    }
}

impl RouteError {
    /// Returns the error and its causes in one line, shortened by [`shorten`].
    pub fn one_line(&self) -> String {
        shorten(&chain(self))
    }
}

impl From<RouteError> for Status {
    fn from(error: RouteError) -> Self {
        Self::new(error.code(), error.one_line())
    }
}
