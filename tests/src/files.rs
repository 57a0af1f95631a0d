//! Locates files for tests: the unpacked packages of robosuite and LIBERO, asset packs, and the
//! reference data, which only some machines have.

use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use benchmark::TaskRef;
use scene::pack::LIBERO;
use scene::{AssetPack, SceneError, Sources, TaskFiles};

/// Opens the unpacked packages of robosuite and LIBERO, which every test of the simulator needs.
pub fn sources() -> Sources {
    Sources::open(&Sources::default_dir()).expect("the sources; run `cargo xtask setup`")
}

/// Opens the built-in asset pack.
pub fn primitives(sources: &Sources) -> AssetPack {
    AssetPack::open("primitives", sources).expect("the built-in pack")
}

/// Opens the pack given by a program's `--assets`, with the files that tasks need.
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

/// Opens LIBERO's assets. The files for the 40 tasks are fetched once for all tests; if that
/// fails, for example without a network, prints that `test` is skipped and returns `None`.
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

/// Returns a folder of the reference data beside this checkout. If it does not exist, prints
/// that `test` is skipped and returns `None`.
pub fn shared(folder: &str, test: &str) -> Option<PathBuf> {
    let dir = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared").join(folder);
    if dir.is_dir() {
        return Some(dir);
    }
    println!("skipped {test}: no reference data at {}", dir.display());
    None
}

/// Makes a folder of assets with links to a pack's files. The folders `writable` inside it are real
/// folders instead of links, so that files can be added to them.
pub fn folder_with_links(pack: &Path, writable: &[&str]) -> tempfile::TempDir {
    let folder = tempfile::tempdir().expect("a folder");
    for subfolder in [&[""], writable].concat() {
        let target = folder.path().join(subfolder);
        std::fs::create_dir_all(&target).expect("a folder");
        for entry in std::fs::read_dir(pack.join(subfolder)).expect("a pack") {
            let entry = entry.expect("a file");
            if !writable.iter().any(|name| entry.file_name() == **name) {
                let link = target.join(entry.file_name());
                std::os::unix::fs::symlink(entry.path(), link).expect("a link");
            }
        }
    }
    folder
}
