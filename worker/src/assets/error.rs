//! Failures of `worker assets`.

use std::io;
use std::path::PathBuf;

use assets::AssetsError;
use scene::SceneError;

/// Reason why an asset pack could not be listed, verified or fetched. Messages read
/// after "failed to …".
#[derive(Debug, thiserror::Error)]
pub enum PackError {
    /// The pack or a source file cannot be read or fetched.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// The origin of the fetch cannot be used.
    #[error(transparent)]
    Assets(#[from] AssetsError),
    /// Files of a pack are not LIBERO's.
    #[error(
        "verify {}: files that are not LIBERO's: {count}. `worker assets fetch` replaces those of \
         its own folder; in a folder of yours, replace them, or accept that its results go by the \
         name `custom`\n  {named}",
        folder.display()
    )]
    Differs {
        /// The pack's folder.
        folder: PathBuf,
        /// The number of files that differ.
        count: usize,
        /// The first of these files, with their differences.
        named: String,
    },
    /// The pack cannot show all tasks.
    #[error(
        "verify {}: it cannot show all tasks; `worker assets fetch --into DIR` fills a folder with \
         what they need\n{}",
        folder.display(),
        description.trim_end()
    )]
    Incomplete {
        /// The pack's folder.
        folder: PathBuf,
        /// Present and missing parts of the pack.
        description: String,
    },
    /// The built-in pack was changed after it was unpacked.
    #[error(
        "verify {}: it is not as it was unpacked; remove the folder, and it is unpacked again",
        folder.display()
    )]
    Primitives {
        /// The pack's folder.
        folder: PathBuf,
    },
    /// Standard output cannot be written.
    #[error("print what was found")]
    Print(#[source] io::Error),
}
