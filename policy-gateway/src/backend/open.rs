//! Creates back-ends from their specifications.

use std::sync::Arc;

use transport::Access;

use super::{
    Backend, builtin::BuiltinBackend, grpc::GrpcBackend, openpi::OpenpiBackend, replay::Replay,
    vla_eval::VlaEvalBackend,
};
use crate::{
    builtin::student,
    config::{BackendSpec, UnusableBackend},
};

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
