//! Asset packs: folders in LIBERO's layout with the models of categories and arenas. Every result
//! records the name and digest of its pack.
//!
//! The name `libero` means exactly LIBERO's official content. Its digest is a constant of the
//! program, even if only the files of one task are present; each file is verified against the table
//! when a scene first uses it.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use crate::assets::{Table, VerifiedFolder};
use benchmark::Look;
use sha2::{Digest, Sha256};

use crate::error::SceneError;
use crate::sources::{AssetRoot, RootKind, Sources};

/// Files of the built-in pack with their paths inside the pack, written by `build.rs`.
mod builtin {
    include!(concat!(env!("OUT_DIR"), "/primitives.rs"));
}

pub const PRIMITIVES: &str = "primitives";
pub const LIBERO: &str = "libero";
pub const CUSTOM: &str = "custom";

#[derive(Debug, Clone)]
pub struct AssetPack {
    name: &'static str,
    dir: PathBuf,
    digest: String,
    verified: Option<Arc<VerifiedFolder>>,
    is_managed: bool,
    differences: Vec<String>,
    look: Look,
}

impl AssetPack {
    /// Opens `primitives`, `libero`, or a folder in LIBERO's layout, which counts as `libero` if it
    /// holds files of LIBERO and none of them is altered, else as `custom`. The built-in pack is
    /// unpacked into the sources' folder on first use. Files of `libero` may still be missing.
    pub fn open(name_or_path: &str, sources: &Sources) -> Result<Self, SceneError> {
        match name_or_path {
            PRIMITIVES => Self::unpack_primitives(&sources.dir().join("packs")),
            LIBERO => {
                let dir = Sources::fetched_pack(sources.dir());
                let dir = std::path::absolute(&dir).unwrap_or(dir);
                Ok(Self::libero(dir, true))
            }
            path => Self::open_folder(Path::new(path)),
        }
    }

    /// Opens a pack whose digest another process has computed, so that a folder is not read twice.
    pub fn open_known(
        name_or_path: &str,
        sources: &Sources,
        digest: &str,
    ) -> Result<Self, SceneError> {
        if matches!(name_or_path, PRIMITIVES | LIBERO) {
            return Self::open(name_or_path, sources);
        }
        let dir = existing_folder(Path::new(name_or_path))?;
        if digest == Table::libero().digest() {
            return Ok(Self::libero(dir, false));
        }
        Ok(Self::custom(dir, digest.to_owned(), Vec::new()))
    }

    fn libero(dir: PathBuf, is_managed: bool) -> Self {
        Self {
            name: LIBERO,
            digest: Table::libero().digest().to_owned(),
            verified: Some(Arc::new(VerifiedFolder::new(Table::libero(), &dir))),
            dir,
            is_managed,
            differences: Vec::new(),
            look: Look::default(),
        }
    }

    fn custom(dir: PathBuf, digest: String, differences: Vec<String>) -> Self {
        let look = Look::default();
        Self { name: CUSTOM, dir, digest, verified: None, is_managed: false, differences, look }
    }

    /// Opens a given folder as the target of a fetch of LIBERO's assets. The folder need not exist.
    pub fn to_fetch_into(dir: &Path) -> Self {
        let dir = std::path::absolute(dir).unwrap_or_else(|_| dir.to_owned());
        Self::libero(dir, false)
    }

    fn open_folder(dir: &Path) -> Result<Self, SceneError> {
        let dir = existing_folder(dir)?;
        let pack = Self::libero(dir, false);
        let verified = pack.verified.as_ref().expect("a pack of LIBERO's assets");
        let (differences, present) = verified.differences();
        if differences.is_empty() && present > 0 {
            return Ok(pack);
        }
        let differences =
            differences.iter().map(|(path, difference)| format!("{path} ({difference})"));
        let digest = digest_of_folder(&pack.dir)?;
        Ok(Self::custom(pack.dir, digest, differences.collect()))
    }

    /// Opens a folder for tasks that need files beside LIBERO's, such as LIBERO-PRO's models: as
    /// `custom`, with a digest of all its files. [`open`](Self::open) would ignore the other files.
    pub fn open_whole(dir: &Path) -> Result<Self, SceneError> {
        let dir = existing_folder(dir)?;
        let digest = digest_of_folder(&dir)?;
        Ok(Self::custom(dir, digest, Vec::new()))
    }

    /// Returns the pack for scenes with this look. Packs are opened with the default look.
    pub fn with_look(self, look: Look) -> Self {
        Self { look, ..self }
    }

    pub fn look(&self) -> Look {
        self.look
    }

    pub fn name(&self) -> &str {
        self.name
    }

    /// SHA-256 over the names and contents of all files, hex, even if `libero` is incomplete.
    pub fn digest(&self) -> &str {
        &self.digest
    }

    pub fn dir(&self) -> &Path {
        &self.dir
    }

    /// Returns LIBERO's files in the pack's folder; `None` for other packs.
    pub fn verified(&self) -> Option<&Arc<VerifiedFolder>> {
        self.verified.as_ref()
    }

    /// True if opened as `libero`, so that files are fetched on demand; false for a given folder.
    pub fn is_managed(&self) -> bool {
        self.is_managed
    }

    /// LIBERO's files that are altered or missing in a `custom` folder, each with its difference.
    pub fn differences(&self) -> &[String] {
        &self.differences
    }

    pub(crate) fn root(&self) -> AssetRoot {
        AssetRoot { kind: RootKind::Pack, dir: self.dir.clone(), verified: self.verified.clone() }
    }

    fn unpack_primitives(packs: &Path) -> Result<Self, SceneError> {
        let mut hash = Sha256::new();
        for (inside, bytes) in builtin::FILES {
            hash_file(&mut hash, inside, bytes);
        }
        let digest = hex::encode(hash.finalize());
        let dir = packs.join(format!("{PRIMITIVES}-{}", &digest[..12]));
        if !dir.is_dir() {
            // Slots that start together never see an incomplete pack.
            let temporary = packs.join(format!(".{PRIMITIVES}-{}", std::process::id()));
            for (inside, bytes) in builtin::FILES {
                let path = temporary.join(inside);
                let folder = path.parent().expect("inside the pack");
                std::fs::create_dir_all(folder).map_err(|source| write_error(folder, source))?;
                std::fs::write(&path, bytes).map_err(|source| write_error(&path, source))?;
            }
            if let Err(source) = std::fs::rename(&temporary, &dir)
                && !dir.is_dir()
            {
                return Err(write_error(&dir, source));
            }
            // Removes the temporary folder if another process was faster; its pack is identical.
            let _ = std::fs::remove_dir_all(&temporary);
        }
        Ok(Self { name: PRIMITIVES, ..Self::custom(dir, digest, Vec::new()) })
    }
}

fn existing_folder(dir: &Path) -> Result<PathBuf, SceneError> {
    let arenas = dir.join("scenes");
    std::fs::metadata(&arenas).map_err(|source| SceneError::Read {
        what: "asset pack".to_owned(),
        path: arenas,
        remedy: "--assets takes `libero`, `primitives` or the path of a LIBERO assets folder"
            .to_owned(),
        source,
    })?;
    std::path::absolute(dir).map_err(|source| read_error(dir, source))
}

/// Returns the SHA-256 over the names and contents of all files below a folder, hex.
pub fn digest_of_folder(dir: &Path) -> Result<String, SceneError> {
    let mut files = Vec::new();
    list_files(dir, &mut files)?;
    files.sort();
    let mut hash = Sha256::new();
    for path in &files {
        let inside = path.strip_prefix(dir).expect("listed below the folder");
        let bytes = std::fs::read(path).map_err(|source| read_error(path, source))?;
        hash_file(&mut hash, &inside.to_string_lossy(), &bytes);
    }
    Ok(hex::encode(hash.finalize()))
}

/// Nesting beyond which folders are ignored, so that cycles of symbolic links end; no real pack is
/// so deep.
const MAX_DEPTH: usize = 12;

fn list_files(dir: &Path, files: &mut Vec<PathBuf>) -> Result<(), SceneError> {
    let mut folders = vec![(dir.to_owned(), 0)];
    while let Some((folder, depth)) = folders.pop() {
        let entries = std::fs::read_dir(&folder).map_err(|source| read_error(&folder, source))?;
        for entry in entries {
            let path = entry.map_err(|source| read_error(&folder, source))?.path();
            if !path.is_dir() {
                files.push(path);
            } else if depth < MAX_DEPTH {
                folders.push((path, depth + 1));
            }
        }
    }
    Ok(())
}

fn hash_file(hash: &mut Sha256, inside: &str, bytes: &[u8]) {
    hash.update((inside.len() as u64).to_le_bytes());
    hash.update(inside.as_bytes());
    hash.update((bytes.len() as u64).to_le_bytes());
    hash.update(bytes);
}

fn read_error(path: &Path, source: std::io::Error) -> SceneError {
    SceneError::Read {
        what: "asset pack".to_owned(),
        path: path.to_owned(),
        remedy: "check that the folder is complete and readable".to_owned(),
        source,
    }
}

fn write_error(path: &Path, source: std::io::Error) -> SceneError {
    let path = path.to_owned();
    SceneError::Unpack { path, source }
}
