//! What can go wrong with asset packs.

use std::io;
use std::path::PathBuf;

use scene::SceneError;

/// Why an asset pack could not be listed, verified or fetched. Messages read
/// after "failed to …".
#[derive(Debug, thiserror::Error)]
pub enum AssetsError {
    /// The pack cannot be opened.
    #[error(transparent)]
    Scene(#[from] SceneError),
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
    /// A pack is not what its manifest says.
    #[error(
        "verify {}: it is not as {} has it; files that differ: {count}\n  {named}",
        folder.display(),
        manifest.display()
    )]
    Differs {
        /// The pack.
        folder: PathBuf,
        /// What it was compared with.
        manifest: PathBuf,
        /// How many files differ.
        count: usize,
        /// The first of them, and how.
        named: String,
    },
    /// A pack that has no manifest cannot show all tasks.
    #[error(
        "verify {}: it cannot show all tasks; fetch LIBERO's assets again with \
         `worker assets fetch`, or copy what is missing from a folder that has it\n{}",
        folder.display(),
        description.trim_end()
    )]
    Incomplete {
        /// The pack.
        folder: PathBuf,
        /// What it has, and what it lacks.
        description: String,
    },
    /// The built-in pack was changed after it was unpacked.
    #[error(
        "verify {}: it is not as it was unpacked; remove the folder, and it is unpacked again",
        folder.display()
    )]
    Primitives {
        /// Where it is.
        folder: PathBuf,
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
    /// Nothing can be printed.
    #[error("print what was found")]
    Print(#[source] io::Error),
    /// Something is where the pack is to go.
    #[error(
        "fetch into {}: it is there already; see `worker assets verify` whether it is whole, \
         or move it away and fetch again",
        folder.display()
    )]
    Occupied {
        /// Where.
        folder: PathBuf,
    },
    /// The hub gives no answer.
    #[error(
        "reach the hub at {url}: {problem} (tried {tries} times); what has arrived is kept, and \
         the same command goes on from there. Where this machine has no way to the hub, give a \
         mirror with --hub, or copy the assets folder from a machine that has it and point \
         --assets at it"
    )]
    Unreachable {
        /// What was asked for.
        url: String,
        /// What happened the last time.
        problem: String,
        /// How often it was tried.
        tries: u32,
    },
    /// The hub answers, and says no.
    #[error(
        "get {url}: the hub answers {status}; is it the right hub, and is the repository still \
         public? A copy of the assets folder from another machine can be given with --assets"
    )]
    Refused {
        /// What was asked for.
        url: String,
        /// The HTTP status.
        status: u16,
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
