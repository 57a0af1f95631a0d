//! Errors of a gateway's configuration.

use std::path::PathBuf;

use policy_backends::spec::BackendSpecError;
use thiserror::Error;

use super::name::{RouteName, RouteNameError};

/// Largest number of replicas of one checkpoint.
pub const MAX_REPLICAS: usize = 64;

/// Reason why a configuration is invalid. The message follows "failed to …".
#[derive(Debug, Error)]
pub enum ConfigError {
    #[error("find a route: give at least one --route NAME=BACKEND, or a [policy.NAME] in --config")]
    NoRoute,
    /// The file cannot be read.
    #[error("read {path:?}: give the path of a gateway's configuration, as in docs/POLICIES.md")]
    Unreadable { path: PathBuf, source: std::io::Error },
    /// The file is not a valid configuration.
    #[error("read line {line} of {path:?} as a gateway's configuration: {problem}")]
    Toml {
        path: PathBuf,
        /// Number of the line, from 1.
        line: usize,
        /// Description of the fault in that line.
        problem: String,
    },
    /// The routes of the file are invalid.
    #[error("use {path:?}")]
    InFile { path: PathBuf, source: Box<ConfigError> },
    /// A route or suite has no replica.
    #[error(
        "find a server for policy {name}: give `replicas`, or a `suites` table, with at least one \
         server each"
    )]
    NoReplica { name: RouteName },
    /// A policy has both `replicas` and `suites`.
    #[error("choose between `replicas` and `suites` of policy {name}: give one of them")]
    ReplicasAndSuites { name: RouteName },
    /// A checkpoint has more replicas than the limit.
    #[error(
        "take more than {MAX_REPLICAS} replicas of one checkpoint of policy {name}: serve the \
         others under another policy's name"
    )]
    TooManyReplicas { name: RouteName },
    /// A server is given twice as a replica.
    #[error("tell two replicas of policy {name} apart: {replica} is given twice")]
    DuplicateReplica {
        name: RouteName,
        /// Replica as written.
        replica: String,
    },
    /// The longest wait for an answer is out of range.
    #[error("use answer_within_secs = {secs} of policy {name}: take a positive number up to 3600")]
    AnswerWithin {
        name: RouteName,
        /// Seconds as written.
        secs: f64,
    },
    /// The text is not `NAME=BACKEND`.
    #[error("read route {text:?}: write NAME=BACKEND, for example expert=builtin:expert")]
    Form {
        /// Text as written.
        text: String,
    },
    /// The name is empty or too long, or has characters that are not allowed.
    #[error(transparent)]
    Name(#[from] RouteNameError),
    /// Two routes have the same name.
    #[error("tell two routes named {name} apart: give each its own name")]
    DuplicateRoute { name: RouteName },
    /// The text does not specify a back-end.
    #[error(transparent)]
    Backend(#[from] BackendSpecError),
    /// A TLS server is given without a certificate authority.
    #[error(
        "trust {replica} of policy {name}: give the certificate authority that signed its \
         certificate, as `ca = \"FILE\"` in --config"
    )]
    NoAuthority {
        name: RouteName,
        /// Replica as written.
        replica: String,
    },
}
