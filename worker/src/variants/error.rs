//! Errors of `worker variants`.

use std::io;
use std::path::PathBuf;

use libero_ctrl::NoSuchRow;
use scene::SceneError;

use crate::single::SingleError;

/// Reason for which variants were not run.
#[derive(Debug, thiserror::Error)]
pub enum VariantsError {
    /// No variant is of all that was asked for.
    #[error("choose variants: none is of all that was asked for; leave a filter out")]
    Nothing,
    /// The protocol is another benchmark's.
    #[error(
        "run {benchmark} under protocol `{protocol}`: it is another benchmark's; docs/FAMILY.md \
         lists the protocols of each"
    )]
    Foreign {
        /// The protocol.
        protocol: &'static str,
        /// The benchmark.
        benchmark: &'static str,
    },
    /// LIBERO-Plus' task map does not have a variant.
    #[error(
        "choose variant `{name}`: its name is well-formed, and LIBERO-Plus' task map does not \
         have it; `worker variants --list` names those that it has"
    )]
    Unused {
        /// Its name.
        name: String,
    },
    /// Files of some are missing.
    #[error(
        "run {lacking} of the {chosen} chosen rollouts, whose files are missing:\n{report}\nGive \
         --runnable to run the others without them"
    )]
    Lacking {
        /// Number of those that cannot run.
        lacking: usize,
        /// Number of all.
        chosen: usize,
        /// What is missing, and for which.
        report: String,
    },
    /// A task file is missing or wrong.
    #[error(transparent)]
    Task(#[from] SceneError),
    /// The protocol has no such row.
    #[error(transparent)]
    Row(#[from] NoSuchRow),
    /// A rollout has no result.
    #[error(transparent)]
    Single(#[from] SingleError),
    /// Earlier results cannot be pooled with those to come.
    #[error(
        "add to {}: its results are of {what} `{found}`, and this run is of `{expected}`; numbers \
         of the two measure different things, so give another --output", path.display()
    )]
    Pinned {
        /// The results.
        path: PathBuf,
        /// What differs.
        what: &'static str,
        /// In the results.
        found: String,
        /// In this run.
        expected: String,
    },
    /// A line of earlier results is malformed.
    #[error("read line {line} of {}: {problem}; remove the line", path.display())]
    Malformed {
        /// The results.
        path: PathBuf,
        /// Line, from 1.
        line: usize,
        /// Problem of the line.
        problem: String,
    },
    /// A file cannot be read or written.
    #[error("use {}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// Error of the system.
        #[source]
        source: io::Error,
    },
}
