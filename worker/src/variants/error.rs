//! Errors of `worker variants`.

use std::io;
use std::path::PathBuf;

use libero_ctrl::{RolloutId, SuiteFileError};
use libero_family::SelectionError;
use scene::SceneError;
use sim::SimError;

use crate::single::SingleError;

/// Reason why variants were not run.
#[derive(Debug, thiserror::Error)]
pub enum VariantsError {
    /// The choice of variants is invalid, or files of some are missing.
    #[error(transparent)]
    Selection(#[from] SelectionError),
    /// A task file is missing or wrong.
    #[error(transparent)]
    Task(#[from] SceneError),
    /// A rollout has no result.
    #[error(transparent)]
    Single(#[from] SingleError),
    #[error("start {id}")]
    Start {
        id: RolloutId,
        #[source]
        source: Box<SimError>,
    },
    #[error("use {}", path.display())]
    SuiteFile {
        path: PathBuf,
        #[source]
        source: SuiteFileError,
    },
    #[error(
        "add to {}: its results are of {what} `{found}`, and this run is of `{expected}`; numbers \
         of the two measure different things, so give another --output", path.display()
    )]
    Pinned { path: PathBuf, what: &'static str, found: String, expected: String },
    #[error("read line {line} of {}: {problem}; remove the line", path.display())]
    Malformed {
        path: PathBuf,
        /// Number of the line, from 1.
        line: usize,
        problem: String,
    },
    #[error("use {}: check its path and permissions", path.display())]
    File {
        path: PathBuf,
        #[source]
        source: io::Error,
    },
}
