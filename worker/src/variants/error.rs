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
    #[error("use {}", path.display())]
    SuiteFile { path: PathBuf, source: SuiteFileError },
    #[error("use {}: check its path and permissions", path.display())]
    File { path: PathBuf, source: io::Error },
}
