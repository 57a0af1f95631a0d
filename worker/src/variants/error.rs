//! Errors of `worker variants`.

use std::io;
use std::path::PathBuf;

use benchmark::SuiteFileError;
use benchmark::family::SelectionError;
use scene::SceneError;

/// Reason why variants cannot be listed.
#[derive(Debug, thiserror::Error)]
pub enum VariantsError {
    /// The choice of variants is invalid, or files of some are missing.
    #[error(transparent)]
    Selection(#[from] SelectionError),
    /// A task file is missing or wrong.
    #[error(transparent)]
    Task(#[from] SceneError),
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
