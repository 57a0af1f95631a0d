//! Locates the files that tests read: the sources that the set-up unpacked, and the
//! reference data that only some machines have.

use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use libero_ctrl::TaskRef;
use scene::pack::LIBERO;
use scene::{AssetPack, SceneError, Sources, TaskFiles};

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

/// Opens a pack as a program's `--assets` names it, with what tasks need.
///
/// # Errors
/// If it is none, or cannot be fetched.
pub fn open_pack(
    name_or_path: &str,
    sources: &Sources,
    tasks: impl IntoIterator<Item = TaskRef>,
) -> Result<AssetPack, SceneError> {
    let pack = AssetPack::open(name_or_path, sources)?;
    let tasks = tasks.into_iter();
    let tasks = tasks.map(|task| TaskFiles::of_task(sources, task));
    pack.provide_with_bar(&tasks.collect::<Vec<_>>())?;
    Ok(pack)
}

/// LIBERO's assets, or none, after saying which test is skipped for that: they are
/// fetched once for all tests, as far as the 40 tasks need them, and there may be no
/// network.
///
/// # Panics
/// If a file is there and altered, and cannot be replaced.
pub fn libero(sources: &Sources, test: &str) -> Option<AssetPack> {
    static FETCHED: OnceLock<Result<AssetPack, String>> = OnceLock::new();
    let fetched = FETCHED.get_or_init(|| {
        let pack = open_pack(LIBERO, sources, TaskRef::all());
        pack.map_err(|error| error.to_string())
    });
    match fetched {
        Ok(pack) => Some(pack.clone()),
        Err(error) => {
            println!("skipped {test}: failed to {error}");
            None
        }
    }
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
