//! Specifications of back-ends, as routes and command lines write them.

use std::{fmt, path::PathBuf, str::FromStr};

use thiserror::Error;

use crate::{
    builtin::{Builtin, UnknownBuiltin},
    grpc::{AddressError, GrpcAddress},
    openpi::{OpenpiAddress, OpenpiAddressError},
    vla_eval::{VlaEvalAddress, VlaEvalAddressError},
};

/// Back-end that answers for a policy: `builtin:NAME`, `grpc://HOST:PORT[/POLICY]` (`https://` over
/// TLS), `ws://HOST:PORT` (`wss://` over TLS), `vla-eval://HOST:PORT` (`vla-evals://` over TLS),
/// `student:FILE`, or `replay:FOLDER`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum BackendSpec {
    /// A policy inside the gateway.
    Builtin(Builtin),
    /// The built-in student with the weights of a file.
    Student(PathBuf),
    /// Remote policy server.
    Grpc(GrpcAddress),
    /// openpi policy server.
    Openpi(OpenpiAddress),
    /// vla-eval model server.
    VlaEval(VlaEvalAddress),
    /// Folder of recordings.
    Replay(PathBuf),
}

impl BackendSpec {
    /// Returns true if the server is reached over TLS.
    pub fn is_encrypted(&self) -> bool {
        match self {
            Self::Builtin(_) | Self::Student(_) | Self::Replay(_) => false,
            Self::Grpc(address) => address.encrypted,
            Self::Openpi(address) => address.host_port.encrypted,
            Self::VlaEval(address) => address.host_port.encrypted,
        }
    }
}

impl FromStr for BackendSpec {
    type Err = BackendSpecError;

    fn from_str(text: &str) -> Result<Self, BackendSpecError> {
        match text.split_once(':') {
            Some(("builtin", name)) => Ok(Self::Builtin(name.parse()?)),
            Some(("grpc" | "https", _)) => Ok(Self::Grpc(text.parse()?)),
            Some(("ws" | "wss", _)) => Ok(Self::Openpi(text.parse()?)),
            Some(("vla-eval" | "vla-evals", _)) => Ok(Self::VlaEval(text.parse()?)),
            Some(("student", file)) if !file.is_empty() => Ok(Self::Student(file.into())),
            Some(("replay", folder)) if !folder.is_empty() => Ok(Self::Replay(folder.into())),
            _ => Err(BackendSpecError::Kind { text: text.to_owned() }),
        }
    }
}

impl fmt::Display for BackendSpec {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Builtin(builtin) => builtin.fmt(f),
            Self::Grpc(address) => address.fmt(f),
            Self::Openpi(address) => address.fmt(f),
            Self::VlaEval(address) => address.fmt(f),
            Self::Student(file) => write!(f, "student:{}", file.display()),
            Self::Replay(folder) => write!(f, "replay:{}", folder.display()),
        }
    }
}

/// The text does not specify a back-end. The message follows "failed to …".
#[derive(Debug, Error)]
pub enum BackendSpecError {
    #[error(
        "read back-end {text:?}: write grpc://HOST:PORT, or https://HOST:PORT over TLS, or \
         ws://HOST:PORT for an openpi server, or vla-eval://HOST:PORT for a model server of \
         vla-eval, or builtin:NAME, or student:FILE, or replay:FOLDER"
    )]
    Kind { text: String },
    /// The built-in policy does not exist.
    #[error(transparent)]
    Builtin(#[from] UnknownBuiltin),
    /// The gRPC address is invalid.
    #[error(transparent)]
    Address(#[from] AddressError),
    /// The openpi server's address is invalid.
    #[error(transparent)]
    Openpi(#[from] OpenpiAddressError),
    /// The vla-eval model server's address is invalid.
    #[error(transparent)]
    VlaEval(#[from] VlaEvalAddressError),
}
