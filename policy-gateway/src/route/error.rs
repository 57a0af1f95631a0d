//! Errors of a route, as the worker's call returns them.

use std::time::Duration;

use policy_protocol::ActionFault;
use thiserror::Error;
use tonic::{Code, Status};
use transport::{chain, is_outage_code};

use crate::{
    backend::BackendError, config::RouteName, held::MAX_HELD_BYTES, sessions::MAX_SESSION_BYTES,
};

/// Reason for which a route did not answer.
#[derive(Debug, Error)]
pub enum RouteError {
    /// The replica did not.
    #[error("route {route}{}", of_replica(replica, source))]
    Replica {
        /// Name of the route.
        route: RouteName,
        /// Its back-end as configured.
        replica: String,
        /// The reason.
        #[source]
        source: Box<BackendError>,
    },
    /// The policy answered nonsense.
    #[error(
        "route {route} ({replica}) got an answer to query {query_index} that is no chunk of \
         actions: {source}; `policy-gateway doctor {replica}` looks for the cause"
    )]
    Action {
        /// Name of the route.
        route: RouteName,
        /// Its back-end as configured.
        replica: String,
        /// Index of the query in its session.
        query_index: u32,
        /// Fault of the answer.
        #[source]
        source: ActionFault,
    },
    /// A session that is not open, because it never was, or because the gateway
    /// restarted or forgot it since: the episode is lost, through no fault of
    /// the policy.
    #[error(
        "route {route}: session {session:?} is not open here (the gateway may have restarted \
         since its Reset); start the rollout again"
    )]
    SessionLost {
        /// Name of the route.
        route: RouteName,
        /// The episode.
        session: String,
    },
    /// No checkpoint for what is asked.
    #[error(
        "route {route} has a checkpoint per suite and none for {suite:?}; it has them for {known}"
    )]
    Suite {
        /// Name of the route.
        route: RouteName,
        /// Suite as asked for.
        suite: String,
        /// The suites that it has.
        known: String,
    },
    /// A session without a name, or with a book for one.
    #[error("a session's name has 1 to {MAX_SESSION_BYTES} bytes, this one {bytes}")]
    Session {
        /// Length of the name.
        bytes: usize,
    },
    /// The configuration no longer names the route.
    #[error("route {route} takes no new sessions: it was taken out of the configuration")]
    Retired {
        /// Name of the route.
        route: RouteName,
    },
    /// As many sessions are open as its replicas can answer in time.
    #[error(
        "route {route} has {sessions} rollouts under way, as many as its policy servers answer in \
         time at {:.2} s a query; run fewer slots, or give the route more replicas",
        per_query.as_secs_f64()
    )]
    Full {
        /// Name of the route.
        route: RouteName,
        /// Open sessions.
        sessions: usize,
        /// Time of the slowest replica for one query.
        per_query: Duration,
    },
    /// Too many queries wait already.
    #[error(
        "this gateway holds {} MiB of observations that wait for their answers; try again later, \
         or give policies more replicas",
        MAX_HELD_BYTES >> 20
    )]
    Overloaded,
}

/// The part of a message after the route's name. The replica is named once: here, or by
/// its error.
fn of_replica(replica: &str, source: &BackendError) -> String {
    let problem = source.to_string();
    let address = replica.split_once("://").map_or(replica, |(_, rest)| rest);
    let address = address.split('/').next().unwrap_or(address);
    match problem.contains(address) {
        true => format!(": {problem}"),
        false => format!(" ({replica}): {problem}"),
    }
}

impl RouteError {
    /// The gRPC code that says it to a worker: see [`BackendError`].
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

impl From<RouteError> for Status {
    fn from(error: RouteError) -> Self {
        Self::new(error.code(), chain(&error))
    }
}
