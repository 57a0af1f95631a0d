//! Target of a check, and the reasons for which it cannot be checked.

use thiserror::Error;
use tonic::Status;
use transport::{Access, AccessError, Trouble, answer};

use super::front::FrontError;

/// Queries of one probing episode.
pub const QUERIES: u32 = 5;

/// Server and policy to check.
#[derive(Clone, Debug)]
pub struct Target {
    /// `http://HOST:PORT` or `grpc://HOST:PORT`.
    pub url: String,
    /// Name of the policy; empty selects the only one.
    pub policy: String,
    /// The suite whose task is made up, one of [`scene::TASKS`].
    pub suite: String,
    /// Credentials of the client.
    pub access: Access,
}

/// Reason for which a server cannot be checked. Reads after "failed to …".
#[derive(Debug, Error)]
pub enum ConformanceError {
    /// The URL is not `grpc://HOST:PORT`.
    #[error(
        "read {url:?} as a policy server's address: write grpc://HOST:PORT, or https:// for one \
         over TLS, or ws://HOST:PORT for an openpi server, or vla-eval://HOST:PORT for a model \
         server of vla-eval"
    )]
    Url {
        /// URL as given.
        url: String,
    },
    /// No URL to call over TLS.
    #[error(transparent)]
    Access(#[from] AccessError),
    /// No policy server is there.
    #[error("reach the policy server at {url}: {trouble}")]
    Connect {
        /// URL as given.
        url: String,
        /// Cause found at that address.
        trouble: Box<Trouble>,
    },
    /// No gateway can stand in front of it.
    #[error(transparent)]
    Front(#[from] FrontError),
    /// It does not say what it is.
    #[error("have {url} describe its policy: {}", answer(status))]
    Describe {
        /// URL as given.
        url: String,
        /// Answer of the server.
        status: Box<Status>,
    },
    /// It answers no query.
    #[error("play one episode with {url}: {}", answer(status))]
    Episode {
        /// URL as given.
        url: String,
        /// Answer of the server.
        status: Box<Status>,
    },
}
