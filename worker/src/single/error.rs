//! Errors of `worker rollout`.

use std::io;
use std::path::{Path, PathBuf};

use libero_ctrl::NoSuchRow;
use scene::SceneError;

use crate::actor::PolicyError;
use crate::rollout::RolloutError;

/// Reason why `worker rollout` failed.
#[derive(Debug, thiserror::Error)]
pub enum SingleError {
    /// The id names no rollout of the protocol.
    #[error(transparent)]
    Row(#[from] NoSuchRow),
    /// The user's own task cannot be read.
    #[error(transparent)]
    Task(#[from] SceneError),
    /// The BDDL file has no instruction, and none was given.
    #[error(
        "find an instruction in {}: it has no `(:language …)`; give one with --instruction",
        bddl.display()
    )]
    NoInstruction {
        /// The BDDL file.
        bddl: PathBuf,
    },
    /// Recorded actions cannot be read.
    #[error("read recorded actions {}: {problem}", path.display())]
    Recorded {
        /// Path of the recording.
        path: PathBuf,
        /// Description of the file's fault.
        problem: String,
    },
    /// The policy cannot be called.
    #[error("run the rollout: {0}")]
    Policy(#[from] PolicyError),
    /// The rollout has no outcome.
    #[error(transparent)]
    Rollout(#[from] RolloutError),
    /// A file cannot be written.
    #[error("write {}", path.display())]
    Write {
        /// Path of the file.
        path: PathBuf,
        /// Error of the system.
        #[source]
        source: io::Error,
    },
}

pub(super) fn write_error(path: &Path, source: io::Error) -> SingleError {
    SingleError::Write {
        path: path.to_owned(),
        source,
    }
}
