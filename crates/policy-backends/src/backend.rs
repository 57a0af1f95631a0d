//! The trait of a back-end, and its errors.

use std::fmt;
use std::time::Duration;

use proto::checks::{ActionFault, DescriptionFault};
use proto::policy::{DescribeResponse, InferRequest, InferResponse, ResetRequest};
use thiserror::Error;
use tonic::{Code, Status};
use transport::{ConnectError, Settings, is_outage_code, status_text};

use crate::shorten::shorten;

/// Names of a gateway's settings for a policy server, for messages about failed connections.
pub(crate) const SETTINGS: Settings = Settings {
    address: "its route",
    authority: "`ca` of the policy",
    clear: "grpc://",
    encrypted: "https://",
};

/// A back-end that answers for a policy. Back-ends ignore the `policy` field of requests, which is
/// the caller's name of the route.
#[tonic::async_trait]
pub trait Backend: fmt::Display + Send + Sync {
    /// Describes the policy and its inputs, with the checkpoint for `suite` if it has several. The
    /// description is not checked; a remote server's may be of another protocol version.
    ///
    /// # Errors
    /// See [`BackendError`], as for every method here.
    async fn describe(&self, suite: &str) -> Result<DescribeResponse, BackendError>;

    /// Starts an episode; restarts the episode if its session is open.
    async fn reset(&self, request: ResetRequest) -> Result<(), BackendError>;

    /// Ends an episode and ignores errors. By default, does nothing.
    async fn end(&self, _session: &str) {}

    /// Answers one observation. The answer is not checked.
    async fn infer(&self, request: InferRequest) -> Result<InferResponse, BackendError>;

    /// Answers several independent observations as one batch, or one after the other if the policy
    /// takes no batches. The answers are in the order of the requests, and are not checked.
    ///
    /// # Errors
    /// If the batch failed as a whole; the error of a single observation is in its place among the
    /// answers.
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

/// Reason why a back-end did not answer. Its gRPC code tells a worker whether the infrastructure
/// failed (a code of [`is_outage_code`], such as `UNAVAILABLE`: not charged to the rollout), or
/// whether the policy failed.
#[derive(Clone, Debug, Error)]
pub enum BackendError {
    #[error("cannot reach the policy server at {address}: {trouble}")]
    Unreachable { address: String, trouble: Box<ConnectError> },
    #[error(
        "the policy server at {address} rejects this gateway's token: {reason}; put a token that \
         it accepts into the `token_file` of the policy, then reload the configuration (SIGHUP)"
    )]
    TokenRejected { address: String, reason: String },
    /// The server is out of service; only probes are sent until the server answers a probe.
    #[error("{backend} {cause}; it is tried again in {:.1} s", retry_in.as_secs_f64())]
    OutOfService { backend: String, cause: Cause, retry_in: Duration },
    #[error("{backend} did not answer within {:.1} s", limit.as_secs_f64())]
    TimedOut { backend: String, limit: Duration },
    #[error("{backend} is out of service, because it {cause}")]
    Broken { backend: String, cause: Cause },
    #[error("policy {policy:?} has an invalid description: {fault}")]
    Description { policy: String, fault: DescriptionFault },
    #[error(
        "it {difference}; put the same weights everywhere, then reload the gateway's \
         configuration (SIGHUP)"
    )]
    DescriptionDiffers { difference: String },
    #[error("{fault}")]
    InvalidActions { fault: ActionFault },
    #[error("{queued} queries are already waiting for a batch; try again later")]
    QueueFull { queued: usize },
    #[error(
        "{backend} has more queries in its queue than it answers within {:.0} s; run fewer slots, \
         or give its route more replicas",
        waited.as_secs_f64()
    )]
    Overloaded { backend: String, waited: Duration },
    /// The batch ended unanswered, through no fault of its queries.
    #[error("the batch ended without an answer to this query")]
    BatchLost,
    #[error("it answered a batch of {asked} with {answered} results")]
    BatchSize { asked: usize, answered: usize },
    #[error("the policy server at {address} answered: {}", status_text(status))]
    Refused { address: String, status: Box<Status> },
    #[error("the policy server at {address} cannot be run here: {reason}")]
    UnsupportedPolicy { address: String, reason: String },
    /// The session is not open: it was never reset, or the gateway restarted or discarded it. The
    /// episode is lost, through no fault of the policy.
    #[error(
        "the session is not open here (the gateway may have restarted since its Reset); start \
         the rollout again"
    )]
    SessionLost,
    #[error("a stateful policy answers its queries in order, and query {expected} is next")]
    OutOfOrder { expected: u32 },
    #[error("the policy failed: {message}")]
    Policy { message: String },
}

impl BackendError {
    pub fn code(&self) -> Code {
        match self {
            Self::Unreachable { .. }
            | Self::TokenRejected { .. }
            | Self::OutOfService { .. }
            | Self::Broken { .. }
            | Self::DescriptionDiffers { .. }
            | Self::BatchLost
            | Self::SessionLost => Code::Unavailable,
            Self::QueueFull { .. } | Self::Overloaded { .. } => Code::ResourceExhausted,
            Self::TimedOut { .. } => Code::DeadlineExceeded,
            // Servers in most languages report an uncaught exception as `UNKNOWN`.
            Self::Refused { status, .. } if status.code() == Code::Unknown => Code::Internal,
            Self::Refused { status, .. } => status.code(),
            Self::UnsupportedPolicy { .. }
            | Self::OutOfOrder { .. }
            | Self::Description { fault: DescriptionFault::Version { .. }, .. } => {
                Code::FailedPrecondition
            }
            Self::Policy { .. }
            | Self::Description { .. }
            | Self::InvalidActions { .. }
            | Self::BatchSize { .. } => Code::Internal,
        }
    }

    /// Returns true if the infrastructure failed rather than this query.
    pub fn is_outage(&self) -> bool {
        is_outage_code(self.code())
    }
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Cause {
    Unreachable(String),
    /// The settings are wrong, for example the address of another server.
    Misconfigured(String),
    TokenRejected(String),
    /// The server's description differs from its earlier description, or from that of the other
    /// replicas.
    DescriptionDiffers(String),
    NoAnswer,
    /// Different tasks got the same error.
    RepeatedError(String),
    /// The server's process cannot recover from an error.
    Broken(String),
}

impl Cause {
    /// Bounds memory and log entries.
    pub fn shortened(self) -> Self {
        match self {
            Self::Unreachable(problem) => Self::Unreachable(shorten(&problem)),
            Self::Misconfigured(problem) => Self::Misconfigured(shorten(&problem)),
            Self::TokenRejected(error) => Self::TokenRejected(shorten(&error)),
            Self::DescriptionDiffers(difference) => Self::DescriptionDiffers(shorten(&difference)),
            Self::NoAnswer => Self::NoAnswer,
            Self::RepeatedError(error) => Self::RepeatedError(shorten(&error)),
            Self::Broken(error) => Self::Broken(shorten(&error)),
        }
    }

    /// Returns true if the server counts as recovered only after an answered query or, if it
    /// repeated an error, also after a different error.
    pub fn needs_query(&self) -> bool {
        matches!(self, Self::NoAnswer | Self::RepeatedError(_) | Self::Broken(_))
    }
}

impl fmt::Display for Cause {
    /// Writes a predicate, whose subject is the server's name.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Unreachable(problem) | Self::Misconfigured(problem) => {
                write!(f, "cannot be reached: {problem}")
            }
            Self::TokenRejected(error) => write!(f, "cannot be queried: {error}"),
            Self::DescriptionDiffers(difference) => f.write_str(difference),
            Self::NoAnswer => f.write_str("did not answer in time"),
            Self::RepeatedError(error) => write!(f, "gave different tasks the same error: {error}"),
            Self::Broken(error) => write!(
                f,
                "gave an error from which its process does not recover (restart it): {error}"
            ),
        }
    }
}
