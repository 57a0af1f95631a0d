//! Folder of scene files: permissions, trust, locks, and the limit of its size.

use std::fs::{self, DirBuilder, File, OpenOptions, Permissions, TryLockError};
use std::io;
use std::os::unix::fs::{DirBuilderExt, MetadataExt, OpenOptionsExt, PermissionsExt};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::thread;
use std::time::{Duration, Instant, SystemTime};

use bytes::Bytes;
use rustix::fs::OFlags;

use super::container;
use super::{LoadedScene, NAME_DIGITS, layout, record_problem};
use crate::error::SimError;
use crate::mujoco::{self, Model};
use crate::render::{Prepared, digest_of_texture};

/// Limit of the files' total size, GiB, unless `$ROLLOUT_SCENES_GIB` sets another limit.
const LIMIT_GIB: u64 = 16;
/// Compiling takes seconds; a worker treats a slot without progress for minutes as stuck.
const MAX_LOCK_WAIT: Duration = Duration::from_secs(60);
const POLL: Duration = Duration::from_millis(10);
const READ_ONLY: u32 = 0o444;
const OTHERS_WRITE: u32 = 0o022;
/// User id of root, whose files are trusted like those of this process's user.
const ROOT: u32 = 0;
pub(super) const TEMPORARY: &str = ".aside-";
/// Indices of the sections of a scene file. From [`MESHES`] on, each section is a mesh.
const TEXTURES: usize = 0;
const STRUCTURE: usize = 1;
const ARRAYS: usize = 2;
const MESHES: usize = 3;

#[derive(Debug, thiserror::Error)]
pub enum SceneFileError {
    #[error(
        "{doing} {}: choose another folder with ROLLOUT_SCENES, or none with ROLLOUT_SCENES=off",
        path.display()
    )]
    File { doing: &'static str, path: PathBuf, source: io::Error },
    #[error(
        "trust {} with scenes: user {owner} owns it and its mode is {mode:o}; it must belong to \
         this user or root, and nobody else may write to it: correct that, or choose another \
         folder with ROLLOUT_SCENES", path.display()
    )]
    Untrusted { path: PathBuf, owner: u32, mode: u32 },
    #[error("wait for {}: other processes have held it for {secs} s", path.display())]
    Busy { path: PathBuf, secs: u64 },
    #[error("use ROLLOUT_SCENES_GIB={given}: write a whole number of GiB, such as 16")]
    Limit { given: String },
    #[error("store a model in a file: its arrays do not have the expected layout")]
    Layout,
}

#[derive(Debug)]
pub struct SceneFolder {
    pub(super) dir: PathBuf,
    /// Limit of the files' total size, bytes.
    pub(super) limit: u64,
    pub(super) user: u32,
    pub(super) layout: String,
    pub(super) max_wait: Duration,
}

fn given_limit() -> Option<String> {
    let given = std::env::var("ROLLOUT_SCENES_GIB").ok();
    given.filter(|text| !text.is_empty())
}

/// Returns the limit of the files' total size, bytes.
pub(super) fn limit(given: Option<&str>) -> Result<u64, SceneFileError> {
    let gib = given.map_or(Ok(LIMIT_GIB), |text| text.trim().parse());
    let limit = gib.ok().and_then(|gib| gib.checked_mul(1 << 30));
    limit.ok_or_else(|| SceneFileError::Limit { given: given.unwrap_or_default().to_owned() })
}

impl SceneFolder {
    /// Describes a folder, which is created when the first scene is stored.
    pub fn new(dir: &Path) -> Self {
        Self {
            dir: std::path::absolute(dir).unwrap_or_else(|_| dir.to_owned()),
            limit: limit(given_limit().as_deref()).unwrap_or(LIMIT_GIB << 30),
            user: rustix::process::geteuid().as_raw(),
            layout: layout(),
            max_wait: MAX_LOCK_WAIT,
        }
    }

    /// Creates the folder if needed. It may be read-only: another user may have filled it.
    pub fn check(&self) -> Result<(), SceneFileError> {
        limit(given_limit().as_deref())?;
        if self.exists_and_is_trusted()? {
            return Ok(());
        }
        let created = DirBuilder::new().recursive(true).mode(0o700).create(&self.dir);
        created.map_err(|source| failure("create", &self.dir, source))?;
        self.exists_and_is_trusted().map(drop)
    }

    /// Maps the scene with this name, or compiles it and stores it for other processes. Only one
    /// process at a time compiles a scene; others wait for its file.
    pub(crate) fn obtain(
        &self,
        name: &str,
        compile: impl FnOnce() -> Result<Model, SimError>,
    ) -> Result<LoadedScene, SimError> {
        let lock = match self.load_or_lock(name) {
            Ok(Ok(loaded)) => return Ok(loaded),
            Ok(Err(lock)) => lock,
            Err(problem) => {
                record_problem(&problem);
                return Ok(LoadedScene { model: compile()?, prepared: None });
            }
        };
        let model = compile()?;
        // A scene that the software renderer cannot draw is rejected when it is drawn.
        let Ok(prepared) = Prepared::from_model(&model) else {
            return Ok(LoadedScene { model, prepared: None });
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
        Ok(LoadedScene { model, prepared: Some(Arc::new(prepared)) })
    }

    /// Returns the scene, or the lock that a process holds while it compiles the scene.
    fn load_or_lock(&self, name: &str) -> Result<Result<LoadedScene, File>, SceneFileError> {
        if let Some(loaded) = self.load(name)? {
            return Ok(Ok(loaded));
        }
        let lock = self.lock(&lock_of(name))?;
        // Another process may have stored the scene in the meantime.
        Ok(self.load(name)?.ok_or(lock))
    }

    /// Maps a scene; `None` if one of its files is missing, incomplete or not trusted.
    pub(super) fn load(&self, name: &str) -> Result<Option<LoadedScene>, SceneFileError> {
        if !self.exists_and_is_trusted()? {
            return Ok(None);
        }
        let Some(sections) = self.map(&self.scene(name), name)? else {
            return Ok(None);
        };
        let mut textures = Vec::new();
        for texture in names_of_textures(&sections) {
            let mapped = self.map(&self.texture(texture), texture)?;
            let Some(Ok(levels)) = mapped.map(<[Bytes; 2]>::try_from) else {
                return Ok(None);
            };
            textures.push(levels);
        }
        Ok(restore(&sections, &textures))
    }

    /// Stores a scene and its missing textures; removes other files if there is no room.
    fn store(&self, name: &str, model: &Model, prepared: &Prepared) -> Result<(), SceneFileError> {
        let image = model.image().ok_or(SceneFileError::Layout)?;
        let _lock = self.lock("store.lock")?;
        let started = now();
        let mut names = String::new();
        for (texture, [largest, smaller]) in model.textures().zip(prepared.textures()) {
            let digest = digest_of_texture(&texture, largest);
            let mut hash = twox_hash::XxHash3_128::new();
            hash.write(self.layout.as_bytes());
            hash.write(&digest.to_le_bytes());
            let name = hex::encode(hash.finish_128().to_be_bytes());
            let path = self.texture(&name);
            if self.map(&path, &name)?.is_none() {
                self.write(&path, &name, &[vec![largest], vec![smaller]])?;
            }
            names += &name;
        }
        let meshes: Vec<Vec<u8>> = prepared.meshes().collect();
        let mut sections =
            vec![vec![names.as_bytes()], vec![image.structure.as_slice()], image.arrays.to_vec()];
        sections.extend(meshes.iter().map(|mesh| vec![mesh.as_slice()]));
        self.write(&self.scene(name), name, &sections)?;
        self.make_room(started).map_err(|source| failure("make room in", &self.dir, source))
    }

    /// Removes temporary files of crashed writers, and the least recently used files until the rest
    /// is within the limit, but none that was used since `started`. A mapped file stays mapped. The
    /// caller holds the folder's lock.
    fn make_room(&self, started: SystemTime) -> io::Result<()> {
        let mut files = Vec::new();
        for entry in fs::read_dir(&self.dir)? {
            let entry = entry?;
            let (name, path) = (entry.file_name().to_string_lossy().into_owned(), entry.path());
            if name.starts_with(TEMPORARY) {
                fs::remove_file(path)?;
            } else if !name.ends_with(".lock") {
                let metadata = entry.metadata()?;
                files.push((metadata.modified()?, metadata.len(), path));
            }
        }
        files.sort();
        let mut total: u64 = files.iter().map(|(_, bytes, _)| bytes).sum();
        for (used, bytes, path) in files {
            if total <= self.limit || used >= started {
                break;
            }
            fs::remove_file(path)?;
            total -= bytes;
        }
        Ok(())
    }

    /// Waits for the lock with this name, up to the time limit; dropping the file releases it.
    pub(super) fn lock(&self, name: &str) -> Result<File, SceneFileError> {
        self.check()?;
        let path = self.dir.join(name);
        let file = OpenOptions::new()
            .write(true)
            .create(true)
            .truncate(false)
            .mode(0o600)
            .custom_flags(no_links())
            .open(&path)
            .map_err(|source| failure("write", &path, source))?;
        let started = Instant::now();
        loop {
            match file.try_lock() {
                // A file system without locks: two processes that write one scene write identical
                // files.
                Ok(()) | Err(TryLockError::Error(_)) => return Ok(file),
                Err(TryLockError::WouldBlock) if started.elapsed() < self.max_wait => {
                    thread::sleep(POLL);
                }
                Err(TryLockError::WouldBlock) => {
                    return Err(SceneFileError::Busy { path, secs: self.max_wait.as_secs() });
                }
            }
        }
    }

    fn scene(&self, name: &str) -> PathBuf {
        self.dir.join(format!("{name}.scene"))
    }

    fn texture(&self, name: &str) -> PathBuf {
        self.dir.join(format!("{name}.texture"))
    }

    /// Returns true if the folder exists and is trusted, false if it does not exist.
    fn exists_and_is_trusted(&self) -> Result<bool, SceneFileError> {
        let metadata = match fs::metadata(&self.dir) {
            Ok(metadata) => metadata,
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(false),
            Err(error) => return Err(failure("read", &self.dir, error)),
        };
        match self.is_trusted(&metadata) {
            true => Ok(true),
            false => Err(SceneFileError::Untrusted {
                path: self.dir.clone(),
                owner: metadata.uid(),
                mode: metadata.mode() & 0o7777,
            }),
        }
    }

    fn is_trusted(&self, metadata: &fs::Metadata) -> bool {
        [self.user, ROOT].contains(&metadata.uid()) && metadata.mode() & OTHERS_WRITE == 0
    }

    /// Maps a file and marks it as used; `None` if it is missing, not trusted or damaged.
    fn map(&self, path: &Path, name: &str) -> Result<Option<Vec<Bytes>>, SceneFileError> {
        let failed = |source| failure("read", path, source);
        let file = match OpenOptions::new().read(true).custom_flags(no_links()).open(path) {
            Ok(file) => file,
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
            Err(error) => return Err(failed(error)),
        };
        let metadata = file.metadata().map_err(failed)?;
        if !(metadata.is_file() && self.is_trusted(&metadata)) {
            return Ok(None);
        }
        // In a folder of another user, the time cannot be set.
        let _ = file.set_modified(now());
        container::map(&file, name, metadata.len()).map_err(failed)
    }

    /// Renames the temporary file once it is on disk and read-only.
    fn write(
        &self,
        path: &Path,
        name: &str,
        sections: &[Vec<&[u8]>],
    ) -> Result<(), SceneFileError> {
        let written = (|| {
            let mut temporary =
                tempfile::Builder::new().prefix(TEMPORARY).tempfile_in(&self.dir)?;
            container::write(temporary.as_file_mut(), name, sections)?;
            // By the same clock as in `map`; the kernel's time of a write may be earlier by a tick.
            temporary.as_file().set_modified(now())?;
            temporary.as_file().sync_data()?;
            temporary.as_file().set_permissions(Permissions::from_mode(READ_ONLY))?;
            temporary.persist(path).map_err(|error| error.error).map(drop)
        })();
        written.map_err(|source| failure("write", path, source))
    }
}

/// Returns the name of the lock under which a scene is compiled. Scenes share a few locks, so that
/// no lock needs to be removed.
pub(super) fn lock_of(name: &str) -> String {
    format!("{}.lock", &name[..2])
}

fn names_of_textures(sections: &[Bytes]) -> impl Iterator<Item = &str> {
    let names = sections.get(TEXTURES).map_or(&[][..], |names| names.as_chunks().0);
    names.iter().filter_map(|name: &[u8; NAME_DIGITS]| std::str::from_utf8(name).ok())
}

/// Restores a scene from mapped sections; `None` if they do not belong to a scene.
fn restore(sections: &[Bytes], textures: &[[Bytes; 2]]) -> Option<LoadedScene> {
    let (structure, arrays) = (sections.get(STRUCTURE)?, sections.get(ARRAYS)?);
    // SAFETY: `store` wrote the sections; the name shows that the layout is the same, and the
    // checksum that the sections were not changed since.
    #[allow(unsafe_code, reason = "a model of mapped arrays")]
    let model = unsafe { Model::from_image(structure, arrays.clone())? };
    let prepared = Prepared::from_bytes(&model, &sections[MESHES..], textures).ok()?;
    Some(LoadedScene { model, prepared: Some(Arc::new(prepared)) })
}

fn failure(doing: &'static str, path: &Path, source: io::Error) -> SceneFileError {
    SceneFileError::File { doing, path: path.to_owned(), source }
}

/// Returns the flag that refuses symbolic links, which could lead to a file that changes.
fn no_links() -> i32 {
    OFlags::NOFOLLOW.bits() as i32
}

/// Returns the time of a file's use, which is compared with those of other files.
#[allow(clippy::disallowed_methods, reason = "only files' times are compared with it")]
fn now() -> SystemTime {
    SystemTime::now()
}
