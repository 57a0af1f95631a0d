//! Compiled scenes in files that all processes of a machine map: MuJoCo's arrays and our
//! renderer's meshes and textures, laid out as they lie in memory. Who compiles a scene first
//! writes it; the kernel keeps one copy of what is used of it.
//!
//! A file is written aside and renamed, never changed afterwards, and never cut short, since a
//! mapping of a file that is shorter than it was kills its process. Its name is a digest of all
//! that it depends on, so that another program's files are other files. Textures, which scenes
//! have in common, are files of their own. Whatever goes wrong, the scene is compiled into the
//! process's own memory, and the first reason is kept for [`SceneFolder::take_problem`].

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

/// Changes whenever files are laid out otherwise.
const FORMAT: u32 = 1;
/// Digits of a name, hexadecimal.
const NAME_DIGITS: usize = 32;
/// Value of the environment variable and the option that keeps no files.
const OFF: &str = "off";

/// Name of a scene or texture: hexadecimal digits.
type Name = [u8; NAME_DIGITS];

/// A scene's model, and what is prepared of it, if it is.
pub(crate) struct Obtained {
    pub(crate) model: Model,
    pub(crate) prepared: Preparation,
}

/// Preparation of a model for the software renderer.
pub(crate) enum Preparation {
    /// The model is not prepared.
    Missing,
    /// Prepared in this process's memory.
    Made(Arc<Prepared>),
    /// Prepared in a scene file.
    Kept(PreparedBytes),
}

impl SceneFolder {
    /// The folder of this process: the one that [`SceneFolder::choose`] was given, else
    /// `$ROLLOUT_SCENES`, else `rollout/scenes` in the user's cache folder. None if scenes are
    /// not to be kept in files.
    pub fn of_process() -> Option<&'static Self> {
        let chosen = CHOSEN.get_or_init(|| {
            let setting = std::env::var_os("ROLLOUT_SCENES");
            from_setting(setting.as_deref())
        });
        chosen.as_ref()
    }

    /// Chooses the folder of this process, or `off`, before anything asks for it.
    pub fn choose(setting: &OsStr) {
        // An earlier choice stays, since its scenes may be mapped.
        let _ = CHOSEN.set(from_setting(Some(setting)));
    }

    /// The first reason why a scene of this process is not kept in a file; once.
    pub fn take_problem() -> Option<String> {
        let mut problem = PROBLEM.lock().unwrap_or_else(PoisonError::into_inner);
        match std::mem::replace(&mut *problem, Problem::Said) {
            Problem::Found(words) => Some(words),
            Problem::Said => None,
            Problem::None => {
                *problem = Problem::None;
                None
            }
        }
    }

    /// Maps the scene of this name, or compiles it and keeps it for others. One process at a
    /// time compiles a scene; others wait for its file.
    ///
    /// # Errors
    /// If the scene cannot be compiled. Trouble with files is no error.
    pub(crate) fn obtain(
        &self,
        name: &Name,
        compile: impl FnOnce() -> Result<Model, SimError>,
    ) -> Result<Obtained, SimError> {
        let lock = match self.load_or_lock(name) {
            Ok(Ok(kept)) => return Ok(kept),
            Ok(Err(lock)) => lock,
            Err(problem) => {
                note_problem(&problem);
                return Ok(Obtained::of(compile()?));
            }
        };
        let model = compile()?;
        // A scene that our renderer cannot draw is refused when it is to be drawn.
        let Ok(prepared) = Prepared::of(&model) else {
            return Ok(Obtained::of(model));
        };
        let stored = self.store(name, &model, &prepared);
        drop(lock);
        match stored.and_then(|()| self.load(name)) {
            Ok(Some(kept)) => {
                drop((model, prepared));
                mujoco::return_freed_memory();
                return Ok(kept);
            }
            Ok(None) => {}
            Err(problem) => note_problem(&problem),
        }
        Ok(Obtained {
            model,
            prepared: Preparation::Made(Arc::new(prepared)),
        })
    }

    /// The scene, or the lock under which it may be compiled.
    fn load_or_lock(&self, name: &Name) -> Result<Result<Obtained, fs::File>, SceneFileError> {
        if let Some(kept) = self.load(name)? {
            return Ok(Ok(kept));
        }
        let lock = self.lock(&format!("{}.lock", text(name)))?;
        // Another process may have been faster.
        Ok(self.load(name)?.ok_or(lock))
    }
}

impl Obtained {
    /// A model of this process alone.
    pub(crate) fn of(model: Model) -> Self {
        Self {
            model,
            prepared: Preparation::Missing,
        }
    }
}

/// Name of the file of a scene: of its MJCF, the files in it, and the program.
pub(crate) fn name_of_scene(scene: &Scene, pack: &AssetPack, sources: &Sources) -> Name {
    let mut hash = Sha256::new();
    hash.update(layout());
    hash.update(pack.digest());
    // Unlike the pack's files these have no digest yet, and reading them takes longer than
    // all else. They are written by an installation and not afterwards.
    for file in scene.robot_files(sources) {
        if let Ok(facts) = fs::metadata(&file) {
            for number in [facts.len() as i64, facts.mtime(), facts.mtime_nsec()] {
                hash.update(number.to_le_bytes());
            }
        }
    }
    hash.update(scene.portable_mjcf());
    digits(&hash.finalize())
}

/// All that the layout of files depends on: machine, MuJoCo, and the code that prepares.
fn layout() -> String {
    let endian = if cfg!(target_endian = "big") {
        "big"
    } else {
        "little"
    };
    let (mujoco, raster) = (mujoco::version(), raster::SOURCES);
    format!("{FORMAT} {ARCH} {endian} {STRUCTURE} {mujoco} {raster}\n")
}

/// The first digits of a digest.
fn digits(digest: &[u8]) -> Name {
    const DIGITS: &[u8] = b"0123456789abcdef";
    std::array::from_fn(|at| {
        let byte = digest[at / 2];
        DIGITS[usize::from(if at % 2 == 0 { byte >> 4 } else { byte & 15 })]
    })
}

fn text(name: &Name) -> &str {
    std::str::from_utf8(name).expect("digits")
}

static CHOSEN: OnceLock<Option<SceneFolder>> = OnceLock::new();

fn from_setting(setting: Option<&OsStr>) -> Option<SceneFolder> {
    match setting.filter(|setting| !setting.is_empty()) {
        Some(setting) if setting == OFF => None,
        Some(folder) => Some(SceneFolder::new(Path::new(folder))),
        None => Some(SceneFolder::new(&Sources::cache_folder().join("scenes"))),
    }
}

enum Problem {
    None,
    Found(String),
    Said,
}

static PROBLEM: Mutex<Problem> = Mutex::new(Problem::None);

fn note_problem(error: &SceneFileError) {
    let mut problem = PROBLEM.lock().unwrap_or_else(PoisonError::into_inner);
    if let Problem::None = *problem {
        let cause = error.source().map(|cause| format!(": {cause}"));
        *problem = Problem::Found(format!(
            "scenes are kept in the memory of each process: failed to {error}{}",
            cause.unwrap_or_default()
        ));
    }
}
