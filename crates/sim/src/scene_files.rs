//! Compiled scenes in files that all processes of a machine map: MuJoCo's arrays and the software
//! renderer's meshes and textures in their memory layout. The first process that compiles a scene
//! writes it; the kernel keeps one copy of the pages in use.
//!
//! A file is written under a temporary name and renamed, and afterwards neither changed nor
//! truncated, since truncating a mapped file kills the process that maps it. A file's name is a
//! digest of everything that its contents depend on, so builds with different layouts share no
//! file. Textures have files of their own, since scenes share them. On any failure, the scene is
//! compiled into the process's own memory, and [`SceneFolder::take_problem`] returns the first
//! error.

mod container;
mod folder;
#[cfg(test)]
mod tests;

use std::env::consts::ARCH;
use std::error::Error;
use std::ffi::OsStr;
use std::fs;
use std::os::unix::fs::MetadataExt;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, OnceLock};

use scene::{AssetPack, Scene, Sources};
use sha2::{Digest, Sha256};

pub use folder::{SceneFileError, SceneFolder};

use crate::mujoco::{self, Model, STRUCTURE};
use crate::render::Prepared;

const FORMAT: u32 = 2;
/// Number of hexadecimal digits in the name of a scene or texture.
const NAME_DIGITS: usize = 32;
/// Value of `ROLLOUT_SCENES` and `--scenes` that disables scene files.
const OFF: &str = "off";

pub(crate) struct LoadedScene {
    pub(crate) model: Model,
    /// `None` until the software renderer first draws the scene.
    pub(crate) prepared: Option<Arc<Prepared>>,
}

impl SceneFolder {
    /// The argument of [`SceneFolder::choose`], else `$ROLLOUT_SCENES`, else `rollout/scenes` in
    /// the user's cache folder. `None` if scene files are disabled.
    pub fn of_process() -> Option<&'static Self> {
        let chosen = CHOSEN_FOLDER.get_or_init(|| {
            let setting = std::env::var_os("ROLLOUT_SCENES");
            from_setting(setting.as_deref())
        });
        chosen.as_ref()
    }

    /// Chooses the folder of this process, or `off`; must be called before the folder is used.
    pub fn choose(setting: &OsStr) {
        // An earlier choice is kept, since its scenes may be mapped.
        let _ = CHOSEN_FOLDER.set(from_setting(Some(setting)));
    }

    /// Returns the first error of scene files in this process, once.
    pub fn take_problem() -> Option<String> {
        static IS_REPORTED: AtomicBool = AtomicBool::new(false);
        PROBLEM.get().filter(|_| !IS_REPORTED.swap(true, Ordering::Relaxed)).cloned()
    }
}

/// A digest of the MJCF, of the files that it references, and of the program's [`layout`].
pub(crate) fn name_of_scene(scene: &Scene, pack: &AssetPack, sources: &Sources) -> String {
    let mut hash = Sha256::new();
    hash.update(layout());
    hash.update(pack.digest());
    // The robot's files have no stored digest and would take long to read. They are written only at
    // installation, so size and modification time suffice.
    for file in scene.robot_files(sources) {
        if let Ok(metadata) = fs::metadata(&file) {
            for number in [metadata.len() as i64, metadata.mtime(), metadata.mtime_nsec()] {
                hash.update(number.to_le_bytes());
            }
        }
    }
    hash.update(scene.portable_mjcf());
    hex::encode(&hash.finalize()[..NAME_DIGITS / 2])
}

/// Parts that a layout depends on: machine, MuJoCo, and the code that prepares meshes and textures.
fn layout() -> String {
    let endian = if cfg!(target_endian = "big") { "big" } else { "little" };
    let (mujoco, raster) = (mujoco::version(), raster::SOURCES);
    format!("{FORMAT} {ARCH} {endian} {STRUCTURE} {mujoco} {raster}\n")
}

static CHOSEN_FOLDER: OnceLock<Option<SceneFolder>> = OnceLock::new();

fn from_setting(setting: Option<&OsStr>) -> Option<SceneFolder> {
    match setting.filter(|setting| !setting.is_empty()) {
        Some(setting) if setting == OFF => None,
        Some(folder) => Some(SceneFolder::new(Path::new(folder))),
        None => Some(SceneFolder::new(&terminal::cache_folder().join("scenes"))),
    }
}

static PROBLEM: OnceLock<String> = OnceLock::new();

fn record_problem(error: &SceneFileError) {
    PROBLEM.get_or_init(|| {
        let cause = error.source().map(|cause| format!(": {cause}"));
        format!(
            "a scene is kept in the memory of this process alone: failed to {error}{}",
            cause.unwrap_or_default()
        )
    });
}
