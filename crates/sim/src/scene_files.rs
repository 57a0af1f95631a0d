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
mod evict;
mod folder;
#[cfg(test)]
mod tests;

use std::env::consts::ARCH;
use std::error::Error;
use std::ffi::OsStr;
use std::fs;
use std::os::unix::fs::MetadataExt;
use std::path::Path;
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

use scene::{AssetPack, Scene, Sources};
use sha2::{Digest, Sha256};

pub use folder::{SceneFileError, SceneFolder};

use crate::error::SimError;
use crate::mujoco::{self, Model, STRUCTURE};
use crate::render::{Prepared, PreparedBytes};

const FORMAT: u32 = 1;
const NAME_DIGITS: usize = 32;
/// Value of `ROLLOUT_SCENES` and `--scenes` that disables scene files.
const OFF: &str = "off";

/// Name of a scene or texture: hexadecimal digits.
type Name = [u8; NAME_DIGITS];

pub(crate) struct LoadedScene {
    pub(crate) model: Model,
    pub(crate) prepared: Preparation,
}

pub(crate) enum Preparation {
    Missing,
    InMemory(Arc<Prepared>),
    InFile(PreparedBytes),
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
        let mut problem = PROBLEM.lock().unwrap_or_else(PoisonError::into_inner);
        match std::mem::replace(&mut *problem, Problem::Reported) {
            Problem::Found(problem) => Some(problem),
            Problem::Reported => None,
            Problem::None => {
                *problem = Problem::None;
                None
            }
        }
    }

    /// Maps the scene with this name, or compiles it and stores it for other processes. Only one
    /// process at a time compiles a scene; others wait for its file.
    pub(crate) fn obtain(
        &self,
        name: &Name,
        compile: impl FnOnce() -> Result<Model, SimError>,
    ) -> Result<LoadedScene, SimError> {
        let lock = match self.load_or_lock(name) {
            Ok(Ok(loaded)) => return Ok(loaded),
            Ok(Err(lock)) => lock,
            Err(problem) => {
                record_problem(&problem);
                return Ok(LoadedScene::in_memory(compile()?));
            }
        };
        let model = compile()?;
        // A scene that the software renderer cannot draw is rejected when it is drawn.
        let Ok(prepared) = Prepared::from_model(&model) else {
            return Ok(LoadedScene::in_memory(model));
        };
        let stored = self.store(name, &model, &prepared);
        drop(lock);
        match stored.and_then(|()| self.load(name)) {
            Ok(Some(loaded)) => {
                drop((model, prepared));
                mujoco::return_freed_memory();
                return Ok(loaded);
            }
            Ok(None) => {}
            Err(problem) => record_problem(&problem),
        }
        Ok(LoadedScene { model, prepared: Preparation::InMemory(Arc::new(prepared)) })
    }

    /// Returns the scene, or the lock that a process holds while it compiles the scene.
    fn load_or_lock(&self, name: &Name) -> Result<Result<LoadedScene, fs::File>, SceneFileError> {
        if let Some(loaded) = self.load(name)? {
            return Ok(Ok(loaded));
        }
        let lock = self.lock(&format!("{}.lock", name_text(name)))?;
        // Another process may have stored the scene in the meantime.
        Ok(self.load(name)?.ok_or(lock))
    }
}

impl LoadedScene {
    pub(crate) fn in_memory(model: Model) -> Self {
        Self { model, prepared: Preparation::Missing }
    }
}

/// A digest of the MJCF, of the files that it references, and of the program's [`layout`].
pub(crate) fn name_of_scene(scene: &Scene, pack: &AssetPack, sources: &Sources) -> Name {
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
    digits(&hash.finalize())
}

/// Parts that a layout depends on: machine, MuJoCo, and the code that prepares meshes and textures.
fn layout() -> String {
    let endian = if cfg!(target_endian = "big") { "big" } else { "little" };
    let (mujoco, raster) = (mujoco::version(), raster::SOURCES);
    format!("{FORMAT} {ARCH} {endian} {STRUCTURE} {mujoco} {raster}\n")
}

fn digits(digest: &[u8]) -> Name {
    const DIGITS: &[u8] = b"0123456789abcdef";
    std::array::from_fn(|at| {
        let byte = digest[at / 2];
        DIGITS[usize::from(if at % 2 == 0 { byte >> 4 } else { byte & 15 })]
    })
}

fn name_text(name: &Name) -> &str {
    std::str::from_utf8(name).expect("digits")
}

static CHOSEN_FOLDER: OnceLock<Option<SceneFolder>> = OnceLock::new();

fn from_setting(setting: Option<&OsStr>) -> Option<SceneFolder> {
    match setting.filter(|setting| !setting.is_empty()) {
        Some(setting) if setting == OFF => None,
        Some(folder) => Some(SceneFolder::new(Path::new(folder))),
        None => Some(SceneFolder::new(&terminal::cache_folder().join("scenes"))),
    }
}

enum Problem {
    None,
    Found(String),
    Reported,
}

static PROBLEM: Mutex<Problem> = Mutex::new(Problem::None);

fn record_problem(error: &SceneFileError) {
    let mut problem = PROBLEM.lock().unwrap_or_else(PoisonError::into_inner);
    if let Problem::None = *problem {
        let cause = error.source().map(|cause| format!(": {cause}"));
        *problem = Problem::Found(format!(
            "a scene is kept in the memory of this process alone: failed to {error}{}",
            cause.unwrap_or_default()
        ));
    }
}
