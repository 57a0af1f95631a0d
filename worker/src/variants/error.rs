//! Errors of `worker variants`.

use std::io;
use std::path::PathBuf;

use libero_ctrl::NoSuchRow;
use scene::SceneError;

use crate::single::SingleError;

/// Reason why variants were not run.
#[derive(Debug, thiserror::Error)]
pub enum VariantsError {
    /// No variant matches all filters.
    #[error("choose variants: none is of all that was asked for; leave a filter out")]
    Nothing,
    /// The protocol belongs to another benchmark.
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
    /// LIBERO-Plus' task map lacks the variant.
    #[error(
        "choose variant `{name}`: its name is well-formed, and LIBERO-Plus' task map does not \
         have it; `worker variants --list` names those that it has"
    )]
    Unused {
        /// Name of the variant.
        name: String,
    },
    /// Files of some rollouts are missing.
    #[error(
        "run {lacking} of the {chosen} chosen rollouts, whose files are missing:\n{report}\nGive \
         --runnable to run the others without them"
    )]
    Lacking {
        /// Number of rollouts with missing files.
        lacking: usize,
        /// Number of chosen rollouts.
        chosen: usize,
        /// Missing files, with the rollouts that need them.
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
    /// Earlier results cannot be pooled with the new ones.
    #[error(
        "add to {}: its results are of {what} `{found}`, and this run is of `{expected}`; numbers \
         of the two measure different things, so give another --output", path.display()
    )]
    Pinned {
        /// Path of the results.
        path: PathBuf,
        /// Property that differs.
        what: &'static str,
        /// Value in the results.
        found: String,
        /// Value of this run.
        expected: String,
    },
    /// A line of earlier results is malformed.
    #[error("read line {line} of {}: {problem}; remove the line", path.display())]
    Malformed {
        /// Path of the results.
        path: PathBuf,
        /// Number of the line, from 1.
        line: usize,
        /// Description of the fault.
        problem: String,
    },
    /// A file cannot be read or written.
    #[error("use {}", path.display())]
    File {
        /// Path of the file.
        path: PathBuf,
        /// Error of the system.
        #[source]
        source: io::Error,
    },
}
