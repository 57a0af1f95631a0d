//! Creates back-ends from their specifications.

use std::sync::Arc;

use thiserror::Error;
use transport::{Access, AccessError};

use crate::{
    backend::Backend,
    builtin::{
        backend::BuiltinBackend,
        student::{self, WeightsFileError},
    },
    grpc::{AddressError, GrpcBackend},
    openpi::{OpenpiAddressError, OpenpiBackend},
    recording::RecordingError,
    replay::Replay,
    spec::BackendSpec,
    vla_eval::{VlaEvalAddressError, VlaEvalBackend},
};

/// Creates the back-end of a specification, without connecting.
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
    /// The certificate authority or the token cannot be read.
    #[error(transparent)]
    Access(#[from] AccessError),
    /// The recordings cannot be replayed.
    #[error(transparent)]
    Recording(#[from] RecordingError),
    /// The weights cannot be used.
    #[error(transparent)]
    Weights(#[from] WeightsFileError),
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
