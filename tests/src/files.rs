//! Where tests find what they read: the sources that the set-up unpacked, and
//! the reference data that only some machines have.

use std::path::{Path, PathBuf};

use scene::{AssetPack, Sources};

/// The unpacked sources.
///
/// # Panics
/// If they are missing: no test of the simulator means anything without them.
pub fn sources() -> Sources {
    Sources::open(&Sources::default_dir()).expect("the sources; run `cargo xtask setup`")
}

/// The built-in asset pack.
///
/// # Panics
/// If it cannot be unpacked.
pub fn primitives(sources: &Sources) -> AssetPack {
    AssetPack::open("primitives", sources).expect("the built-in pack")
}

/// A folder of the reference data beside this checkout, or none, after saying
/// which test is skipped for that.
pub fn shared(folder: &str, test: &str) -> Option<PathBuf> {
    let dir = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../../shared")
        .join(folder);
    if dir.is_dir() {
        return Some(dir);
    }
    println!("skipped {test}: no reference data at {}", dir.display());
    None
}
