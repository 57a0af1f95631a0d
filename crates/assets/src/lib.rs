//! Fetches LIBERO's assets from the hub that they are published on: resumed
//! where it was interrupted, and checked. What a pack holds, file by file, is a
//! [`Manifest`]; what packs are for is crate `scene`'s business.

#![forbid(unsafe_code)]

mod download;
mod error;
mod fetch;
mod hub;
mod manifest;
mod progress;

use std::path::{Path, PathBuf};

pub use error::AssetsError;
pub use fetch::Fetch;
pub use hub::{HUB, Hub, Program, hub_url};
pub use manifest::Manifest;
pub use progress::{Bar, Progress, size_in_words};

/// Where LIBERO's assets are put by default, of the sources folder that crate
/// `scene` reads.
pub fn fetched_pack(sources: &Path) -> PathBuf {
    sources.join("packs/libero")
}
