//! What can go wrong with asset packs.

use std::io;
use std::path::PathBuf;

use assets::AssetsError;
use scene::SceneError;

/// Why an asset pack could not be listed, verified or fetched. Messages read
/// after "failed to …".
#[derive(Debug, thiserror::Error)]
pub enum PackError {
    /// The pack cannot be opened.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// The pack cannot be fetched, or its files cannot be listed.
    #[error(transparent)]
    Assets(#[from] AssetsError),
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
    /// Nothing can be printed.
    #[error("print what was found")]
    Print(#[source] io::Error),
}
