//! Asset packs: folders in LIBERO's layout with the models of categories and
//! arenas. A pack is known by its digest, which goes with every result.

use std::path::{Path, PathBuf};

use sha2::{Digest, Sha256};

use crate::error::SceneError;
use crate::sources::{AssetRoot, RootKind, Sources};

/// The built-in pack: every file with its path inside the pack.
mod builtin {
    include!(concat!(env!("OUT_DIR"), "/primitives.rs"));
}

/// Name of the built-in pack.
pub const PRIMITIVES: &str = "primitives";

/// An opened asset pack.
#[derive(Debug, Clone)]
pub struct AssetPack {
    name: String,
    dir: PathBuf,
    digest: String,
}

impl AssetPack {
    /// Opens `primitives`, or a folder in LIBERO's layout. The built-in pack
    /// is unpacked beside the sources at its first use.
    pub fn open(name_or_path: &str, sources: &Sources) -> Result<Self, SceneError> {
        if name_or_path == PRIMITIVES {
            return Self::unpack_primitives(&sources.dir().join("packs"));
        }
        let dir = Path::new(name_or_path);
        let arena = dir.join("scenes");
        std::fs::metadata(&arena).map_err(|source| SceneError::Read {
            what: "asset pack".to_owned(),
            path: arena,
            remedy: "--assets takes `primitives` or the path of a LIBERO assets folder".to_owned(),
            source,
        })?;
        let dir = std::path::absolute(dir).map_err(|source| read_error(dir, source))?;
        let mut files = Vec::new();
        list_files(&dir, &mut files)?;
        files.sort();
        let mut hash = Sha256::new();
        for path in &files {
            let inside = path
                .strip_prefix(&dir)
                .expect("listed below it")
                .to_string_lossy();
            let bytes = std::fs::read(path).map_err(|source| read_error(path, source))?;
            hash_file(&mut hash, &inside, &bytes);
        }
        Ok(Self {
            name: "libero".to_owned(),
            dir,
            digest: hex(&hash.finalize()),
        })
    }

    /// `primitives`, or `libero` for a folder.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// SHA-256 over the names and contents of all files, hex.
    pub fn digest(&self) -> &str {
        &self.digest
    }

    /// The pack's folder on this machine.
    pub fn dir(&self) -> &Path {
        &self.dir
    }

    pub(crate) fn root(&self) -> AssetRoot {
        AssetRoot {
            kind: RootKind::Pack,
            dir: self.dir.clone(),
        }
    }

    fn unpack_primitives(packs: &Path) -> Result<Self, SceneError> {
        let mut hash = Sha256::new();
        for (inside, bytes) in builtin::FILES {
            hash_file(&mut hash, inside, bytes);
        }
        let digest = hex(&hash.finalize());
        let dir = packs.join(format!("{PRIMITIVES}-{}", &digest[..12]));
        if !dir.is_dir() {
            // Written aside and renamed, so that slots which start together
            // never see half a pack.
            let aside = packs.join(format!(".{PRIMITIVES}-{}", std::process::id()));
            for (inside, bytes) in builtin::FILES {
                let path = aside.join(inside);
                let folder = path.parent().expect("inside the pack");
                std::fs::create_dir_all(folder).map_err(|source| write_error(folder, source))?;
                std::fs::write(&path, bytes).map_err(|source| write_error(&path, source))?;
            }
            if let Err(source) = std::fs::rename(&aside, &dir)
                && !dir.is_dir()
            {
                return Err(write_error(&dir, source));
            }
            // Another process may have been faster; its copy is the same.
            let _ = std::fs::remove_dir_all(&aside);
        }
        Ok(Self {
            name: PRIMITIVES.to_owned(),
            dir,
            digest,
        })
    }
}

/// Deeper nesting than any pack has; ends a loop of links.
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
    SceneError::Read {
        what: "unpacked asset pack".to_owned(),
        path: path.to_owned(),
        remedy: "make the sources folder writable, or point --sources elsewhere".to_owned(),
        source,
    }
}

/// Lower-case hexadecimal.
pub(crate) fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}
