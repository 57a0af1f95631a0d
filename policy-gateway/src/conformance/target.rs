//! What is checked, and why it cannot be.

use thiserror::Error;
use tonic::Status;
use transport::Access;

use super::front::FrontError;

/// Queries of one probing episode.
pub const QUERIES: u32 = 5;

/// What to check.
#[derive(Clone, Debug)]
pub struct Target {
    /// `http://HOST:PORT` or `grpc://HOST:PORT`.
    pub url: String,
    /// Which policy there; empty: the only one.
    pub policy: String,
    /// The suite whose task is made up, one of [`scene::TASKS`].
    pub suite: String,
    /// How to get in.
    pub access: Access,
}

/// Why a server cannot be checked. Reads after "failed to …".
#[derive(Debug, Error)]
pub enum ConformanceError {
    /// Not `grpc://HOST:PORT`.
    #[error(
        "read {url:?} as a policy server's address: write grpc://HOST:PORT, or https:// for one \
         over TLS, or ws://HOST:PORT for an openpi server"
    )]
    Url {
        /// As given.
        url: String,
    },
    /// Nothing listens there.
    #[error("reach a policy server at {url}: start it, or correct the address")]
    Connect {
        /// As given.
        url: String,
        /// Why not.
        #[source]
        source: tonic::transport::Error,
    },
    /// No gateway can stand in front of it.
    #[error(transparent)]
    Front(#[from] FrontError),
    /// It does not say what it is.
    #[error("have {url} describe its policy: it answered {:?}: {}", status.code(), status.message())]
    Describe {
        /// As given.
        url: String,
        /// What it answered.
        status: Box<Status>,
    },
    /// It answers no query.
    #[error("play one episode with {url}: it answered {:?}: {}", status.code(), status.message())]
    Episode {
        /// As given.
        url: String,
        /// What it answered.
        status: Box<Status>,
    },
}
