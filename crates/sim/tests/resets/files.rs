use std::path::{Path, PathBuf};

use benchmark::TaskRef;
use benchmark::presets::ENV_SEED;
use scene::{AssetPack, Problem, Sources, TaskFiles, compose};
use sim::{Environment, SimError};

/// BDDL text of a scene outside all suites, which [`recorded`](crate::recorded) also resets.
pub(crate) fn crowded() -> String {
    include_str!("crowded.bddl").to_owned()
}

pub(crate) fn sources() -> Sources {
    Sources::open(&Sources::default_dir()).expect("the sources; run `cargo xtask setup`")
}

/// Returns the built-in pack, followed by LIBERO's pack if it can be fetched.
pub(crate) fn packs() -> Vec<AssetPack> {
    let open = |name: &str| AssetPack::open(name, &sources()).expect("a pack");
    let libero = open("libero");
    let tasks = TaskRef::all().map(|task| TaskFiles::of_task(&sources(), task));
    let libero = match libero.provide_with_bar(&tasks.collect::<Vec<_>>()) {
        Ok(_) => Some(libero),
        Err(error) => {
            println!("skipped: failed to {error}");
            None
        }
    };
    std::iter::once(open("primitives")).chain(libero).collect()
}

/// Folder beside this checkout; prints that the test is skipped if it does not exist.
pub(crate) fn shared(name: &str) -> Option<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared").join(name);
    if folder.is_dir() {
        return Some(folder);
    }
    println!("skipped: {} is not here", folder.display());
    None
}

pub(crate) fn bddl(file: &str) -> String {
    let path = Sources::default_dir().join("libero/bddl_files").join(file);
    std::fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

pub(crate) fn compile(text: &str, pack: &AssetPack) -> Result<Environment, SimError> {
    let problem = Problem::parse(text).expect("a problem");
    let scene = compose(&problem, pack, &sources(), ENV_SEED)?;
    Environment::new(scene, pack, &sources())
}
