//! Errors of a gateway's configuration.

use std::path::PathBuf;

use thiserror::Error;

use super::name::{RouteName, RouteNameError};
use crate::{
    backend::{grpc::AddressError, openpi::OpenpiAddressError, vla_eval::VlaEvalAddressError},
    builtin::UnknownBuiltin,
};

/// Most replicas of one checkpoint.
pub const MAX_REPLICAS: usize = 64;

/// Reason why a configuration is invalid. Reads after "failed to …".
#[derive(Debug, Error)]
pub enum ConfigError {
    /// No route is given.
    #[error("find a route: give at least one --route NAME=BACKEND, or a [policy.NAME] in --config")]
    NoRoute,
    /// The file cannot be read.
    #[error("read {path:?}: give the path of a gateway's configuration, as in docs/POLICIES.md")]
    Unreadable {
        /// Path of the file.
        path: PathBuf,
        /// Error of the system.
        source: std::io::Error,
    },
    /// The file is not a valid configuration.
    #[error("read line {line} of {path:?} as a gateway's configuration: {problem}")]
    Toml {
        /// Path of the file.
        path: PathBuf,
        /// Number of the line, from 1.
        line: usize,
        /// Description of the fault in that line.
        problem: String,
    },
    /// The routes of the file are invalid.
    #[error("use {path:?}")]
    InFile {
        /// Path of the file.
        path: PathBuf,
        /// Error in the file.
        source: Box<ConfigError>,
    },
    /// A route or suite has no replica.
    #[error(
        "find a server for policy {name}: give `replicas`, or a `suites` table, each with one at least"
    )]
    NoReplica {
        /// Name of the route.
        name: RouteName,
    },
    /// A policy has both `replicas` and `suites`.
    #[error("choose between `replicas` and `suites` of policy {name}: give one of them")]
    BothKinds {
        /// Name of the route.
        name: RouteName,
    },
    /// A checkpoint has more replicas than the limit.
    #[error("take more than {MAX_REPLICAS} replicas of one checkpoint of policy {name}")]
    TooManyReplicas {
        /// Name of the route.
        name: RouteName,
    },
    /// A server is given twice as a replica.
    #[error("tell two replicas of policy {name} apart: {replica} is given twice")]
    ReplicaTwice {
        /// Name of the route.
        name: RouteName,
        /// Replica as written.
        replica: String,
    },
    /// The longest wait for an answer is out of range.
    #[error("use answer_within_secs = {secs} of policy {name}: take a positive number up to 3600")]
    AnswerWithin {
        /// Name of the route.
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
    /// The name has characters that are not allowed, or is too long.
    #[error(transparent)]
    Name(#[from] RouteNameError),
    /// Two routes have the same name.
    #[error("tell two routes named {name} apart: give each its own name")]
    Twice {
        /// The name.
        name: RouteName,
    },
    /// The text is not a known kind of back-end.
    #[error(
        "read back-end {text:?}: write grpc://HOST:PORT, or https:// for one over TLS, or \
         ws://HOST:PORT for an openpi server, or vla-eval://HOST:PORT for a model server of \
         vla-eval, or builtin:NAME, or student:FILE, or replay:FOLDER"
    )]
    Backend {
        /// Text as written.
        text: String,
    },
    /// The built-in policy does not exist.
    #[error(transparent)]
    Builtin(#[from] UnknownBuiltin),
    /// The address after `grpc://` is invalid.
    #[error(transparent)]
    Address(#[from] AddressError),
    /// The address after `ws://` is invalid.
    #[error(transparent)]
    Openpi(#[from] OpenpiAddressError),
    /// The address after `vla-eval://` is invalid.
    #[error(transparent)]
    VlaEval(#[from] VlaEvalAddressError),
    /// A TLS server is given without a certificate authority.
    #[error(
        "trust {replica} of policy {name}: give the certificate authority that signed its \
         certificate, as `ca = \"FILE\"` in --config"
    )]
    NoAuthority {
        /// Name of the route.
        name: RouteName,
        /// Replica as written.
        replica: String,
    },
}
