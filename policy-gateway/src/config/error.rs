//! Errors of a gateway's configuration.

use std::path::PathBuf;

use thiserror::Error;

use super::name::{RouteName, RouteNameError};
use crate::{
    backend::{grpc::AddressError, openpi::OpenpiAddressError, vla_eval::VlaEvalAddressError},
    builtin::UnknownBuiltin,
};

/// Replicas of one checkpoint.
pub const MAX_REPLICAS: usize = 64;

/// Reason for which routes cannot be served. Reads after "failed to …".
#[derive(Debug, Error)]
pub enum ConfigError {
    /// There is no route to serve.
    #[error("find a route: give at least one --route NAME=BACKEND, or a [policy.NAME] in --config")]
    NoRoute,
    /// A file that cannot be read.
    #[error("read {path:?}: give the path of a gateway's configuration, as in docs/POLICIES.md")]
    Unreadable {
        /// Path of the file.
        path: PathBuf,
        /// Error of the system.
        source: std::io::Error,
    },
    /// A file that is no configuration.
    #[error("read line {line} of {path:?} as a gateway's configuration: {problem}")]
    Toml {
        /// Path of the file.
        path: PathBuf,
        /// Number of the line, from 1.
        line: usize,
        /// Problem on that line.
        problem: String,
    },
    /// Something in a file that cannot be meant.
    #[error("use {path:?}")]
    InFile {
        /// Path of the file.
        path: PathBuf,
        /// Error in the file.
        source: Box<ConfigError>,
    },
    /// No replica to answer.
    #[error(
        "find a server for policy {name}: give `replicas`, or a `suites` table, each with one at least"
    )]
    NoReplica {
        /// Name of the route.
        name: RouteName,
    },
    /// Both ways of naming servers.
    #[error("choose between `replicas` and `suites` of policy {name}: give one of them")]
    BothKinds {
        /// Name of the route.
        name: RouteName,
    },
    /// More than the limit.
    #[error("take more than {MAX_REPLICAS} replicas of one checkpoint of policy {name}")]
    TooManyReplicas {
        /// Name of the route.
        name: RouteName,
    },
    /// The same server as two replicas.
    #[error("tell two replicas of policy {name} apart: {replica} is given twice")]
    ReplicaTwice {
        /// Name of the route.
        name: RouteName,
        /// Replica as written.
        replica: String,
    },
    /// No time to answer.
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
    /// A name that would be hard to quote.
    #[error(transparent)]
    Name(#[from] RouteNameError),
    /// The same name for two routes.
    #[error("tell two routes named {name} apart: give each its own name")]
    Twice {
        /// The name.
        name: RouteName,
    },
    /// No such kind.
    #[error(
        "read back-end {text:?}: write grpc://HOST:PORT, or https:// for one over TLS, or \
         ws://HOST:PORT for an openpi server, or vla-eval://HOST:PORT for a model server of \
         vla-eval, or builtin:NAME, or student:FILE, or replay:FOLDER"
    )]
    Backend {
        /// Text as written.
        text: String,
    },
    /// `builtin:` and something unknown.
    #[error(transparent)]
    Builtin(#[from] UnknownBuiltin),
    /// `grpc://` and no address.
    #[error(transparent)]
    Address(#[from] AddressError),
    /// `ws://` and no address.
    #[error(transparent)]
    Openpi(#[from] OpenpiAddressError),
    /// `vla-eval://` and no address.
    #[error(transparent)]
    VlaEval(#[from] VlaEvalAddressError),
    /// TLS with a server whose certificate no authority vouches for.
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
