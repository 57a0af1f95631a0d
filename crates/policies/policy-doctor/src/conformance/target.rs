//! Target of a conformance check, and the errors of the check.

use thiserror::Error;
use tonic::Status;
use transport::{Access, AccessError, ConnectError, status_text};

/// Queries per episode.
pub(super) const QUERIES: u32 = 5;

/// Server and policy to check.
#[derive(Clone, Debug)]
pub struct Target {
    /// `grpc://HOST:PORT` or `http://HOST:PORT`; over TLS, `https://HOST:PORT`.
    pub url: String,
    /// Address as the user gave it, for messages.
    pub shown: String,
    /// Name of the policy; empty selects the only policy of the server.
    pub policy: String,
    /// Suite of the synthetic task, one of `scene::TASKS`.
    pub suite: String,
    /// Credentials of the client.
    pub access: Access,
}

/// Reason why a server cannot be checked. The message follows "failed to …".
#[derive(Debug, Error)]
pub enum ConformanceError {
    #[error(
        "read {url:?} as a policy server's address: write grpc://HOST:PORT, or https://HOST:PORT \
         over TLS, or ws://HOST:PORT for an openpi server, or vla-eval://HOST:PORT for a model \
         server of vla-eval"
    )]
    Url { url: String },
    /// TLS cannot be set up for the URL.
    #[error(transparent)]
    Access(#[from] AccessError),
    #[error("reach the policy server at {url}: {trouble}")]
    Connect { url: String, trouble: Box<ConnectError> },
    #[error("have {url} describe its policy: {}", status_text(status))]
    Describe { url: String, status: Box<Status> },
    #[error("play one episode with {url}: {}", status_text(status))]
    Episode { url: String, status: Box<Status> },
}
