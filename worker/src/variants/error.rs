//! Errors of `worker variants`.

use std::io;
use std::path::PathBuf;

use benchmark::family::SelectionError;
use benchmark::{RolloutId, SuiteFileError};
use scene::SceneError;
use sim::SimError;

/// Reason why variants cannot be listed or started.
#[derive(Debug, thiserror::Error)]
pub enum VariantsError {
    /// The choice of variants is invalid, or files of some are missing.
    #[error(transparent)]
    Selection(#[from] SelectionError),
    /// A task file is missing or wrong.
    #[error(transparent)]
    Task(#[from] SceneError),
    /// A rollout cannot be brought to its start.
    #[error("start {id}")]
    Start {
        /// The rollout.
        id: RolloutId,
        /// Error of the simulator.
        #[source]
        source: Box<SimError>,
    },
    /// The suite file is invalid.
    #[error("use {}", path.display())]
    SuiteFile {
        /// Path of the file.
        path: PathBuf,
        /// Error that names the field and the remedy.
        #[source]
        source: SuiteFileError,
    },
    /// A file cannot be read.
    #[error("use {}: check its path and permissions", path.display())]
    File {
        /// Path of the file.
        path: PathBuf,
        /// Error of the system.
        #[source]
        source: io::Error,
    },
}
