use std::{fmt, path::PathBuf, str::FromStr, sync::Arc};

use thiserror::Error;
use transport::{Access, AccessError};

use crate::{
    backend::Backend,
    builtin::{
        Builtin, UnknownBuiltin,
        backend::BuiltinBackend,
        student::{self, WeightsFileError},
    },
    grpc::{AddressError, GrpcAddress, GrpcBackend},
    openpi::{OpenpiAddress, OpenpiAddressError, OpenpiBackend},
    recording::RecordingError,
    replay::Replay,
    vla_eval::{VlaEvalAddress, VlaEvalAddressError, VlaEvalBackend},
};

/// Back-end that answers for a policy: `builtin:NAME`, `grpc://HOST:PORT[/POLICY]` (`https://` over
/// TLS), `ws://HOST:PORT` (`wss://` over TLS), `vla-eval://HOST:PORT` (`vla-evals://` over TLS),
/// `student:FILE`, or `replay:FOLDER`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum BackendSpec {
    Builtin(Builtin),
    /// The built-in student with the weights of a file.
    Student(PathBuf),
    Grpc(GrpcAddress),
    Openpi(OpenpiAddress),
    VlaEval(VlaEvalAddress),
    Replay(PathBuf),
}

impl BackendSpec {
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
    #[error(transparent)]
    Builtin(#[from] UnknownBuiltin),
    #[error(transparent)]
    Address(#[from] AddressError),
    #[error(transparent)]
    Openpi(#[from] OpenpiAddressError),
    #[error(transparent)]
    VlaEval(#[from] VlaEvalAddressError),
}

/// Creates the back-end of a specification, without connecting.
///
/// # Errors
/// See [`UnusableBackend`].
pub fn open(spec: &BackendSpec, access: &Access) -> Result<Arc<dyn Backend>, UnusableBackend> {
    Ok(match spec {
        BackendSpec::Builtin(builtin) => {
            Arc::new(BuiltinBackend::new(spec.to_string(), builtin.policy()))
        }
        BackendSpec::Student(weights) => {
            let policy = student::read(weights)?;
            Arc::new(BuiltinBackend::new(spec.to_string(), policy))
        }
        BackendSpec::Grpc(address) => {
            let endpoint = address.endpoint()?;
            Arc::new(GrpcBackend::new(address.clone(), endpoint, access)?)
        }
        BackendSpec::Openpi(address) => {
            Arc::new(OpenpiBackend::new(address.clone(), access.clone())?)
        }
        BackendSpec::VlaEval(address) => {
            Arc::new(VlaEvalBackend::new(address.clone(), access.clone())?)
        }
        BackendSpec::Replay(folder) => Arc::new(Replay::open(folder)?),
    })
}

/// Reason why a back-end cannot be created. The message follows "failed to …".
#[derive(Debug, Error)]
pub enum UnusableBackend {
    #[error(transparent)]
    Access(#[from] AccessError),
    #[error(transparent)]
    Recording(#[from] RecordingError),
    #[error(transparent)]
    Weights(#[from] WeightsFileError),
    #[error(transparent)]
    Address(#[from] AddressError),
    #[error(transparent)]
    Openpi(#[from] OpenpiAddressError),
    #[error(transparent)]
    VlaEval(#[from] VlaEvalAddressError),
}
