//! Folder of scene files: permissions, trust, and locks.

use std::fs::{self, DirBuilder, File, OpenOptions, Permissions, TryLockError};
use std::io;
use std::os::unix::fs::{DirBuilderExt, MetadataExt, OpenOptionsExt, PermissionsExt};
use std::path::{Path, PathBuf};
use std::thread;
use std::time::{Duration, Instant};

use bytes::Bytes;
use rustix::fs::{OFlags, Timespec, Timestamps, UTIME_NOW, futimens};

use super::container;
use super::{LoadedScene, Name, Preparation, digits, layout, name_text};
use crate::mujoco::Model;
use crate::render::{Prepared, PreparedBytes, digest_of_texture};

/// Limit of the files' total size, GiB, unless `$ROLLOUT_SCENES_GIB` sets another limit.
const LIMIT_GIB: u64 = 16;
/// Compiling takes seconds; a worker treats a slot without progress for minutes as stuck.
const MAX_LOCK_WAIT: Duration = Duration::from_secs(60);
const POLL: Duration = Duration::from_millis(10);
const READ_ONLY: u32 = 0o444;
const OTHERS_WRITE: u32 = 0o022;
/// User id of root, whose files are trusted like those of this process's user.
const ROOT: u32 = 0;
pub(super) const TEMPORARY_PREFIX: &str = ".aside-";
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
    File {
        doing: &'static str,
        path: PathBuf,
        #[source]
        source: io::Error,
    },
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
    /// Simulated free disk space in tests, bytes.
    #[cfg(test)]
    pub(super) room: std::sync::atomic::AtomicU64,
}

/// An opened file with trusted permissions, whose header has the file's name and length.
struct Opened {
    file: File,
    checksum: u128,
    /// File metadata that changes when the file is written.
    stamp: String,
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
            #[cfg(test)]
            room: std::sync::atomic::AtomicU64::new(u64::MAX),
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

    /// Maps a scene; `None` if one of its files is missing, incomplete or not trusted.
    pub(super) fn load(&self, name: &Name) -> Result<Option<LoadedScene>, SceneFileError> {
        if !self.exists_and_is_trusted()? {
            return Ok(None);
        }
        let path = self.scene(name_text(name));
        let Some(scene) = self.open(&path, name)? else {
            return Ok(None);
        };
        let failed = |source| failure("read", &path, source);
        // The lock keeps the file, but the mapping stays valid without it, too. `try_lock_shared`
        // never waits: any reader of the file could hold an exclusive lock for ever.
        let _ = scene.file.try_lock_shared();
        if scene.file.metadata().map_err(failed)?.nlink() == 0 {
            return Ok(None);
        }
        let lock = scene.file.try_clone().map_err(failed)?;
        let Some(sections) = container::map(&scene.file, Some(lock)).map_err(failed)? else {
            return Ok(None);
        };
        let mut unchecked = vec![(scene.file, scene.checksum)];
        let mut stamps = scene.stamp;
        let Some(names) = names_of_textures(&sections) else {
            return Ok(None);
        };
        let mut textures = Vec::new();
        for texture in names {
            let path = self.texture(name_text(texture));
            let Some(opened) = self.open(&path, texture)? else {
                return Ok(None);
            };
            stamps += &opened.stamp;
            let mapped = container::map(&opened.file, None);
            textures.push(mapped.map_err(|source| failure("read", &path, source))?);
            unchecked.push((opened.file, opened.checksum));
        }
        if !self.was_checked(name, &stamps) {
            for (file, checksum) in &unchecked {
                if !container::has_checksum(file, *checksum).map_err(failed)? {
                    return Ok(None);
                }
            }
            self.record_check(name, &stamps);
        }
        Ok(assemble(&sections, textures))
    }

    /// Stores a scene and its missing textures; evicts other scenes if there is no room.
    pub(super) fn store(
        &self,
        name: &Name,
        model: &Model,
        prepared: &Prepared,
    ) -> Result<(), SceneFileError> {
        let image = model.image().ok_or(SceneFileError::Layout)?;
        let _lock = self.lock("store.lock")?;
        let mut names = Vec::new();
        for (texture, [largest, smaller]) in model.textures().zip(prepared.textures()) {
            let digest = digest_of_texture(&texture, largest);
            let mut hash = twox_hash::XxHash3_128::new();
            hash.write(self.layout.as_bytes());
            hash.write(&digest.to_le_bytes());
            let name = digits(&hash.finish_128().to_be_bytes());
            let path = self.texture(name_text(&name));
            if !self.is_whole(&path, &name)? {
                self.write(&path, &name, &[vec![largest], vec![smaller]])?;
            }
            names.extend(name);
        }
        let meshes: Vec<Vec<u8>> = prepared.meshes().collect();
        let mut sections =
            vec![vec![names.as_slice()], vec![image.structure.as_slice()], image.arrays.to_vec()];
        sections.extend(meshes.iter().map(|mesh| vec![mesh.as_slice()]));
        self.write(&self.scene(name_text(name)), name, &sections)?;
        self.make_room(name_text(name)).map_err(|source| failure("make room in", &self.dir, source))
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
                Ok(()) => return Ok(file),
                // The caller proceeds without locks: eviction requires a lock, and two processes
                // that write one scene write identical files.
                Err(TryLockError::Error(_)) => return Ok(file),
                Err(TryLockError::WouldBlock) if started.elapsed() < self.max_wait => {
                    thread::sleep(POLL);
                }
                Err(TryLockError::WouldBlock) => {
                    return Err(SceneFileError::Busy { path, secs: self.max_wait.as_secs() });
                }
            }
        }
    }

    pub(super) fn scene(&self, name: &str) -> PathBuf {
        self.dir.join(format!("{name}.scene"))
    }

    pub(super) fn texture(&self, name: &str) -> PathBuf {
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

    /// `None` if the file is missing or not trusted, or its header has another name or length.
    fn open(&self, path: &Path, name: &Name) -> Result<Option<Opened>, SceneFileError> {
        let options = OpenOptions::new().read(true).custom_flags(no_links()).open(path);
        let file = match options {
            Ok(file) => file,
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
            Err(error) => return Err(failure("read", path, error)),
        };
        let failed = |source| failure("read", path, source);
        let metadata = file.metadata().map_err(failed)?;
        if !(metadata.is_file() && self.is_trusted(&metadata)) {
            return Ok(None);
        }
        let checksum = container::read_head(&file, name, metadata.len()).map_err(failed)?;
        Ok(checksum.map(|checksum| Opened {
            stamp: format!(
                "{} {} {} {}.{:09} {}.{:09}\n",
                name_text(name),
                metadata.ino(),
                metadata.len(),
                metadata.mtime(),
                metadata.mtime_nsec(),
                metadata.ctime(),
                metadata.ctime_nsec()
            ),
            checksum,
            file,
        }))
    }

    fn is_whole(&self, path: &Path, name: &Name) -> Result<bool, SceneFileError> {
        let Some(Opened { file, checksum, .. }) = self.open(path, name)? else {
            return Ok(false);
        };
        container::has_checksum(&file, checksum).map_err(|source| failure("read", path, source))
    }

    /// Renames the temporary file once it is on disk and read-only.
    fn write(
        &self,
        path: &Path,
        name: &Name,
        sections: &[Vec<&[u8]>],
    ) -> Result<(), SceneFileError> {
        let written = (|| {
            let mut temporary =
                tempfile::Builder::new().prefix(TEMPORARY_PREFIX).tempfile_in(&self.dir)?;
            // Released when this process ends; another that then locks the file may remove it.
            let _ = temporary.as_file().try_lock();
            let out = temporary.as_file_mut();
            #[cfg(test)]
            let out = &mut super::tests::Disk { file: out, room: &self.room };
            container::write(out, name, sections)?;
            temporary.as_file().sync_data()?;
            temporary.as_file().set_permissions(Permissions::from_mode(READ_ONLY))?;
            temporary.persist(path).map_err(|error| error.error).map(drop)
        })();
        written.map_err(|source| failure("write", path, source))
    }

    /// Returns true if checked in this state since this boot; then marks the scene as used.
    fn was_checked(&self, name: &Name, stamps: &str) -> bool {
        let Some(record) = self.check_record_path(name) else {
            return false;
        };
        if fs::read_to_string(&record).is_ok_and(|recorded| recorded == stamps) {
            // Sets the modification time, which eviction uses as the time of last use. In a folder
            // of another user, the time cannot be set.
            if let Ok(file) = OpenOptions::new().write(true).open(record) {
                let now = Timespec { tv_sec: 0, tv_nsec: UTIME_NOW };
                let _ = futimens(&file, &Timestamps { last_access: now, last_modification: now });
            }
            return true;
        }
        false
    }

    /// Records the check; without a record, the files are checked again next time.
    fn record_check(&self, name: &Name, stamps: &str) {
        let Some(record) = self.check_record_path(name) else {
            return;
        };
        let written = (|| {
            let temporary =
                tempfile::Builder::new().prefix(TEMPORARY_PREFIX).tempfile_in(&self.dir)?;
            fs::write(temporary.path(), stamps)?;
            temporary.persist(record).map_err(|error| error.error)
        })();
        drop(written);
    }

    /// Path of the record of a check since this boot; each machine has its own records.
    fn check_record_path(&self, name: &Name) -> Option<PathBuf> {
        let boot = fs::read_to_string("/proc/sys/kernel/random/boot_id").ok()?;
        let file = format!("{}.{}.checked", name_text(name), boot.trim());
        Some(self.dir.join(file))
    }
}

/// Reads the names of a scene's textures from its sections; `None` if they are invalid.
pub(super) fn names_of_textures(sections: &[Bytes]) -> Option<&[Name]> {
    let digits = sections.get(TEXTURES)?;
    let (names, rest) = digits.as_chunks();
    let are_names = rest.is_empty() && digits.iter().all(u8::is_ascii_hexdigit);
    are_names.then_some(names)
}

/// Restores a scene from mapped sections; `None` if they do not belong to a scene.
fn assemble(sections: &[Bytes], textures: Vec<Option<Vec<Bytes>>>) -> Option<LoadedScene> {
    let (structure, arrays) = (sections.get(STRUCTURE)?, sections.get(ARRAYS)?);
    // SAFETY: `store` wrote the sections; the name shows that the layout is the same, and the
    // checksum that the sections were not changed since.
    #[allow(unsafe_code, reason = "a model of mapped arrays")]
    let model = unsafe { Model::from_image(structure, arrays.clone())? };
    let textures = textures.into_iter().map(|sections| <[Bytes; 2]>::try_from(sections?).ok());
    Some(LoadedScene {
        model,
        prepared: Preparation::InFile(PreparedBytes {
            meshes: sections[MESHES..].to_vec(),
            textures: textures.collect::<Option<_>>()?,
        }),
    })
}

fn failure(doing: &'static str, path: &Path, source: io::Error) -> SceneFileError {
    SceneFileError::File { doing, path: path.to_owned(), source }
}

/// Returns the flag that refuses symbolic links, which could lead to a file that changes.
fn no_links() -> i32 {
    OFlags::NOFOLLOW.bits() as i32
}
