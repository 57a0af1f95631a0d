//! Errors of `worker rollout`.

use std::io;
use std::path::{Path, PathBuf};

use benchmark::NoSuchRow;
use scene::SceneError;

use crate::actor::PolicyError;
use crate::rollout::RolloutError;

/// Reason why `worker rollout` failed.
#[derive(Debug, thiserror::Error)]
pub enum SingleError {
    #[error(transparent)]
    Row(#[from] NoSuchRow),
    #[error(transparent)]
    Task(#[from] SceneError),
    #[error("read recorded actions {}: {problem}", path.display())]
    Recorded { path: PathBuf, problem: String },
    #[error("run the rollout: {0}")]
    Policy(#[from] PolicyError),
    #[error(transparent)]
    Rollout(#[from] RolloutError),
    #[error("write {}", path.display())]
    Write { path: PathBuf, source: io::Error },
}

pub(super) fn write_error(path: &Path, source: io::Error) -> SingleError {
    SingleError::Write { path: path.to_owned(), source }
}
