//! Back-ends: clients of policy servers, one module per protocol, and the policies that need no
//! server. Each back-end implements the trait [`Backend`] and has an entry in [`spec::KINDS`]; a
//! [`BackendSpec`] specifies and creates a back-end.
//!
//! A back-end neither checks answers nor retries: the gateway does. The tools that examine a server
//! thus receive its answers unchanged.

#![forbid(unsafe_code)]

use std::time::Duration;

mod backend;
pub mod builtin;
pub mod description;
pub mod grpc;
pub mod http2;
pub mod numpy;
mod observations;
pub mod openpi;
pub mod recorder;
pub mod recording;
pub mod replay;
pub mod sessions;
pub mod shorten;
pub mod spec;
pub mod vla_eval;
mod websocket;

pub use backend::{Backend, BackendError, Cause};
pub use spec::{BackendSpec, UnusableBackend};

/// Default of the gateway's longest wait for an answer: shorter than a worker's, so that the
/// gateway, not the worker, is the first to detect a server that does not answer.
pub const DEFAULT_ANSWER_WITHIN: Duration = Duration::from_secs(50);
