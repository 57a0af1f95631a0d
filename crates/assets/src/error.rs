//! What can go wrong while a pack is fetched, or its manifest made.

use std::io;
use std::path::PathBuf;

/// Why an asset pack could not be fetched, or its files listed. Messages read
/// after "failed to …".
#[derive(Debug, thiserror::Error)]
pub enum AssetsError {
    /// A file or folder cannot be read.
    #[error("read {}", path.display())]
    Read {
        /// Which.
        path: PathBuf,
        /// What happened.
        #[source]
        source: io::Error,
    },
    /// A manifest is none.
    #[error("understand manifest {}: {problem}", path.display())]
    Manifest {
        /// Which.
        path: PathBuf,
        /// What is wrong with it.
        problem: String,
    },
    /// A file or folder cannot be written.
    #[error("write {}", path.display())]
    Write {
        /// Which.
        path: PathBuf,
        /// What happened.
        #[source]
        source: io::Error,
    },
    /// Something is where the pack is to go.
    #[error("fetch into {}: it is there already; {remedy}", folder.display())]
    Occupied {
        /// Where.
        folder: PathBuf,
        /// What to do: [`Program::occupied`](crate::Program::occupied).
        remedy: &'static str,
    },
    /// The pack is being fetched already.
    #[error(
        "fetch into {}: another fetch into it is under way; wait until that has ended, or stop \
         it and fetch again",
        folder.display()
    )]
    Busy {
        /// Where.
        folder: PathBuf,
    },
    /// The caller wanted no more of it.
    #[error(
        "fetch everything: it was interrupted; what has arrived is kept, and the same command \
         goes on from there"
    )]
    Interrupted,
    /// The hub gives no answer.
    #[error(
        "reach the hub at {url}: {problem} (tried {tries} times); what has arrived is kept, and \
         the same command goes on from there. Where this machine has no way to the hub, give a \
         mirror with --hub, or copy the assets folder from a machine that has it and point \
         {assets} at it"
    )]
    Unreachable {
        /// What was asked for.
        url: String,
        /// What happened the last time.
        problem: String,
        /// How often it was tried.
        tries: u32,
        /// What a pack is given with: [`Program::assets`](crate::Program::assets).
        assets: &'static str,
    },
    /// The hub answers, and says no.
    #[error(
        "get {url}: the hub answers {status}; is it the right hub, and is the repository still \
         public? A copy of the assets folder from another machine can be given with {assets}"
    )]
    Refused {
        /// What was asked for.
        url: String,
        /// The HTTP status.
        status: u16,
        /// What a pack is given with: [`Program::assets`](crate::Program::assets).
        assets: &'static str,
    },
    /// The hub's answer is not the list of files that it should be.
    #[error("understand the hub's answer to {url}: {problem}")]
    Answer {
        /// What was asked for.
        url: String,
        /// What is wrong with it.
        problem: String,
    },
    /// A file never arrived as the hub describes it.
    #[error(
        "get {url} unaltered: {problem} (tried {tries} times); does something between this \
         machine and the hub change it?"
    )]
    Altered {
        /// What was asked for.
        url: String,
        /// How it differs.
        problem: String,
        /// How often it was tried.
        tries: u32,
    },
}
