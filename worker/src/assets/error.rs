//! Failures of `worker assets`.

use std::io;
use std::path::PathBuf;

use benchmark::family::protocol::Benchmark;
use scene::SceneError;
use scene::assets::AssetsError;

/// Reason why an asset pack could not be listed, verified or fetched. Messages read
/// after "failed to …".
#[derive(Debug, thiserror::Error)]
pub enum PackError {
    #[error(transparent)]
    Scene(#[from] SceneError),
    #[error(transparent)]
    Assets(#[from] AssetsError),
    #[error(
        "verify {}: files that are not LIBERO's: {count}. `worker assets fetch` replaces those of \
         its own folder; in a folder of yours, replace them, or accept that its results go by the \
         name `custom`\n  {named}",
        folder.display()
    )]
    Differs {
        folder: PathBuf,
        count: usize,
        /// The first of these files, with their differences.
        named: String,
    },
    #[error(
        "verify {}: it cannot show all tasks; `worker assets fetch --into DIR` fills a folder with \
         what they need\n{}",
        folder.display(),
        description.trim_end()
    )]
    Incomplete { folder: PathBuf, description: String },
    #[error(
        "verify {}: its files were changed after unpacking; remove the folder, and it is unpacked \
         again",
        folder.display()
    )]
    Primitives { folder: PathBuf },
    #[error(
        "fetch the task files of {benchmark} from a checkout: a package index has them; leave \
         --checkout out"
    )]
    Checkout { benchmark: Benchmark },
    #[error("print the result")]
    Print(#[source] io::Error),
}
