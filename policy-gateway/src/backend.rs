//! Interface between the gateway and the back-end of a route. Responsible for
//! the trait and for the errors of a back-end; one module per kind of back-end.

use std::{fmt, time::Duration};

use policy_protocol::{ActionFault, DescriptionFault};
use proto::policy::{DescribeResponse, InferRequest, InferResponse, ResetRequest};
use thiserror::Error;
use tonic::{Code, Status};
use transport::{Settings, Trouble, answer, is_outage_code};

use crate::health::Cause;

pub mod builtin;
pub mod grpc;
pub mod numpy;
pub mod open;
pub mod openpi;
pub mod recorder;
pub mod replay;
mod shown;
pub mod vla_eval;
pub mod websocket;

/// Names, in messages, of the settings with which a gateway's user addresses a
/// policy server.
pub(crate) const SETTINGS: Settings = Settings {
    address: "its route",
    authority: "`ca` of the policy",
    clear: "grpc://",
    encrypted: "https://",
};

/// Something that answers for a policy. The `policy` field of requests is the
/// caller's name of the route and means nothing to a back-end.
#[tonic::async_trait]
pub trait Backend: fmt::Display + Send + Sync {
    /// Describes the policy and its inputs, with the checkpoint for `suite` if
    /// it has several. Speaks [`proto::PROTOCOL_VERSION`].
    ///
    /// # Errors
    /// As every method here: [`BackendError`].
    async fn describe(&self, suite: &str) -> Result<DescribeResponse, BackendError>;

    /// Starts an episode; one that is open is started anew.
    ///
    /// # Errors
    /// [`BackendError`].
    async fn reset(&self, request: ResetRequest) -> Result<(), BackendError>;

    /// Notes that an episode is over. Nothing happens in those that keep nothing
    /// of one; what goes wrong is nobody's loss.
    async fn end(&self, _session: &str) {}

    /// Answers one observation, unchecked.
    ///
    /// # Errors
    /// [`BackendError`].
    async fn infer(&self, request: InferRequest) -> Result<InferResponse, BackendError>;

    /// Answers several independent observations at once, each unchecked, in
    /// their order; one after the other where a policy knows no batches.
    ///
    /// # Errors
    /// [`BackendError`], if none of them was answered.
    async fn infer_batch(
        &self,
        requests: Vec<InferRequest>,
    ) -> Result<Vec<Result<InferResponse, BackendError>>, BackendError> {
        let mut answers = Vec::with_capacity(requests.len());
        for request in requests {
            answers.push(self.infer(request).await);
        }
        Ok(answers)
    }
}

/// Why a back-end did not answer. Each has one gRPC code, which says to a worker
/// whether the infrastructure failed (`UNAVAILABLE`, `DEADLINE_EXCEEDED`,
/// `RESOURCE_EXHAUSTED`: not charged to the rollout) or the policy did.
#[derive(Clone, Debug, Error)]
pub enum BackendError {
    /// No connection, or it broke, or to something else.
    #[error("cannot reach the policy server at {address}: {trouble}")]
    Unreachable {
        /// host:port.
        address: String,
        /// Cause found at that address.
        trouble: Box<Trouble>,
    },
    /// It does not let this gateway in.
    #[error(
        "the policy server at {address} does not let this gateway in: {reason}; put a token that \
         it knows into the `token_file` of the policy, then reload the configuration (SIGHUP)"
    )]
    Barred {
        /// host:port.
        address: String,
        /// Answer of the server.
        reason: String,
    },
    /// It is out, and only a probe goes through.
    #[error("{backend} {cause}; it is tried again in {:.1} s", retry_in.as_secs_f64())]
    Out {
        /// Back-end as configured.
        backend: String,
        /// Reason for which it is out.
        cause: Cause,
        /// Time until the next attempt.
        retry_in: Duration,
    },
    /// Connected, but silent.
    #[error("{backend} did not answer within {:.1} s", limit.as_secs_f64())]
    TimedOut {
        /// Back-end as configured.
        backend: String,
        /// Longest silence.
        limit: Duration,
    },
    /// An error that says more of the server than of the query.
    #[error("{backend} is out, because it {cause}")]
    Sick {
        /// Back-end as configured.
        backend: String,
        /// Reason for which it is out.
        cause: Cause,
    },
    /// It describes itself as nothing that can be run.
    #[error("policy {policy:?} describes itself wrongly: {fault}")]
    Description {
        /// The policy's own name.
        policy: String,
        /// Fault of the description.
        fault: DescriptionFault,
    },
    /// It describes itself otherwise than before, or than its replicas.
    #[error(
        "it {difference}; put the same weights everywhere, then reload the gateway's \
         configuration (SIGHUP)"
    )]
    Disagrees {
        /// Difference, and the description that it is measured by.
        difference: String,
    },
    /// It answered nonsense.
    #[error("{fault}")]
    Nonsense {
        /// Fault of the answer.
        fault: ActionFault,
    },
    /// Too many queries wait for it.
    #[error("{queued} queries wait for their batch already; try again later")]
    QueueFull {
        /// Queries that wait.
        queued: usize,
    },
    /// A query that waited in vain for its turn at a server that is at work.
    #[error(
        "{backend} has more queries before it than it answers within {:.0} s; run fewer slots, or \
         give its route more replicas",
        waited.as_secs_f64()
    )]
    Crowded {
        /// Back-end as configured.
        backend: String,
        /// Time in the queue.
        waited: Duration,
    },
    /// A batch that came to nothing, through no fault of its queries.
    #[error("the batch ended without an answer to this query")]
    BatchLost,
    /// An answer to a batch that does not fit it.
    #[error("it answered a batch of {asked} with {answered} results")]
    BatchSize {
        /// Queries sent.
        asked: usize,
        /// Results that came.
        answered: usize,
    },
    /// It answered with an error of its own.
    #[error("the policy server at {address} answered: {}", answer(status))]
    Refused {
        /// host:port.
        address: String,
        /// Answer of the server.
        status: Box<Status>,
    },
    /// It serves something that cannot be run as it is meant.
    #[error("the policy server at {address} cannot be run here: {reason}")]
    Unsuited {
        /// host:port.
        address: String,
        /// Reason, with the remedy.
        reason: String,
    },
    /// A session that is not open, because it never was, or because the
    /// gateway restarted or forgot it since: the episode is lost, through no
    /// fault of the policy.
    #[error(
        "the session is not open here (the gateway may have restarted since its Reset); start \
         the rollout again"
    )]
    SessionLost,
    /// A stateful policy was not asked in order.
    #[error("a stateful policy answers its queries in order, and query {expected} is next")]
    OutOfOrder {
        /// The query index that it waits for.
        expected: u32,
    },
    /// A built-in policy could not answer.
    #[error("the policy failed: {message}")]
    Policy {
        /// In the policy's words.
        message: String,
    },
}

impl BackendError {
    /// The gRPC code that says it to a worker.
    pub fn code(&self) -> Code {
        match self {
            Self::Unreachable { .. }
            | Self::Barred { .. }
            | Self::Out { .. }
            | Self::Sick { .. }
            | Self::Disagrees { .. }
            | Self::BatchLost
            | Self::SessionLost => Code::Unavailable,
            Self::QueueFull { .. } | Self::Crowded { .. } => Code::ResourceExhausted,
            Self::TimedOut { .. } => Code::DeadlineExceeded,
            // An exception that a server let through, in most languages.
            Self::Refused { status, .. } if status.code() == Code::Unknown => Code::Internal,
            Self::Refused { status, .. } => status.code(),
            Self::Unsuited { .. }
            | Self::OutOfOrder { .. }
            | Self::Description {
                fault: DescriptionFault::Version { .. },
                ..
            } => Code::FailedPrecondition,
            Self::Policy { .. }
            | Self::Description { .. }
            | Self::Nonsense { .. }
            | Self::BatchSize { .. } => Code::Internal,
        }
    }

    /// Returns true if the infrastructure failed, not this query.
    pub fn is_outage(&self) -> bool {
        is_outage_code(self.code())
    }
}
