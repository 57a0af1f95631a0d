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
    #[error("read {path:?}: give the path of a gateway's configuration, as in docs/POLICIES.md")]
    Unreadable { path: PathBuf, source: std::io::Error },
    #[error("read line {line} of {path:?} as a gateway's configuration: {problem}")]
    Toml {
        path: PathBuf,
        /// Number of the line, from 1.
        line: usize,
        problem: String,
    },
    #[error("use {path:?}")]
    InFile { path: PathBuf, source: Box<ConfigError> },
    #[error(
        "find a server for policy {name}: give `replicas`, or a `suites` table, with at least one \
         server each"
    )]
    NoReplica { name: RouteName },
    #[error("choose between `replicas` and `suites` of policy {name}: give one of them")]
    ReplicasAndSuites { name: RouteName },
    #[error(
        "take more than {MAX_REPLICAS} replicas of one checkpoint of policy {name}: serve the \
         others under another policy's name"
    )]
    TooManyReplicas { name: RouteName },
    #[error("tell two replicas of policy {name} apart: {replica} is given twice")]
    DuplicateReplica { name: RouteName, replica: String },
    #[error("use answer_within_secs = {secs} of policy {name}: take a positive number up to 3600")]
    AnswerWithin { name: RouteName, secs: f64 },
    #[error("read route {text:?}: write NAME=BACKEND, for example expert=builtin:expert")]
    Form { text: String },
    /// The name is empty or too long, or has characters that are not allowed.
    #[error(transparent)]
    Name(#[from] RouteNameError),
    #[error("tell two routes named {name} apart: give each its own name")]
    DuplicateRoute { name: RouteName },
    /// The text does not specify a back-end.
    #[error(transparent)]
    Backend(#[from] BackendSpecError),
    #[error(
        "trust {replica} of policy {name}: give the certificate authority that signed its \
         certificate, as `ca = \"FILE\"` in --config"
    )]
    NoAuthority { name: RouteName, replica: String },
}
