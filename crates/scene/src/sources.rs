//! Sources of a scene's files: the robot models of robosuite, the BDDL files and initial
//! states of hf-libero (both unpacked by `cargo xtask setup`), and an asset pack.

use std::fmt;
use std::path::{Component, Path, PathBuf};
use std::sync::Arc;

use benchmark::family::protocol::Benchmark;

use crate::assets::{Difference, VerifiedFolder};
use crate::error::SceneError;

/// Remedy for missing files; users of a release archive have no cargo.
pub(crate) const REMEDY: &str = "run `cargo xtask setup`, or point --sources at the folder \
     share/rollout/sources of a release archive";

/// Folder with files of the Python wheels of robosuite and LIBERO: `robosuite/` holds files of robosuite's `models/assets`, and
/// `libero/` holds `bddl_files` and `init_files`.
#[derive(Debug, Clone)]
pub struct Sources {
    dir: PathBuf,
}

impl Sources {
    /// Opens the folder after checking that its parts exist.
    pub fn open(dir: &Path) -> Result<Self, SceneError> {
        // The path is made absolute, since MuJoCo does not resolve relative file names against the
        // current folder.
        let sources = Self { dir: std::path::absolute(dir).unwrap_or_else(|_| dir.to_owned()) };
        for part in ["robosuite/base.xml", "libero/bddl_files", "libero/init_files"] {
            let path = dir.join(part);
            std::fs::metadata(&path).map_err(|source| SceneError::Read {
                what: "simulation source".to_owned(),
                path,
                remedy: REMEDY.to_owned(),
                source,
            })?;
        }
        Ok(sources)
    }

    /// Returns `$ROLLOUT_SOURCES`, else the folder beside the programs of a release archive, else
    /// the folder of `cargo xtask setup`: `rollout/sources` in the user's cache folder.
    pub fn default_dir() -> PathBuf {
        let named = std::env::var_os("ROLLOUT_SOURCES").map(PathBuf::from);
        named.or_else(Self::release_dir).unwrap_or_else(Self::in_cache)
    }

    fn in_cache() -> PathBuf {
        terminal::cache_folder().join("sources")
    }

    /// Folder of LIBERO's fetched assets: `packs/libero` in the sources or, since a release archive
    /// may be read-only, in the user's cache folder unless the archive contains it.
    pub fn fetched_pack(dir: &Path) -> PathBuf {
        Self::fetched(dir, "packs/libero")
    }

    /// Folder of a benchmark's task files, chosen like [`fetched_pack`](Self::fetched_pack).
    pub fn family(dir: &Path, benchmark: Benchmark) -> PathBuf {
        Self::fetched(dir, benchmark.name())
    }

    /// Folder that a suite file names, chosen like [`fetched_pack`](Self::fetched_pack).
    pub fn suite_folder(dir: &Path, folder: &str) -> PathBuf {
        Self::fetched(dir, folder)
    }

    fn fetched(dir: &Path, name: &str) -> PathBuf {
        let in_dir = dir.join(name);
        let is_release_dir = || {
            let canonical = dir.canonicalize().ok();
            canonical.is_some() && canonical == Self::release_dir()
        };
        if !in_dir.is_dir() && is_release_dir() {
            return Self::in_cache().join(name);
        }
        in_dir
    }

    fn release_dir() -> Option<PathBuf> {
        let program = std::env::current_exe().ok()?.canonicalize().ok()?;
        let dir = program.parent()?.with_file_name("share/rollout/sources");
        dir.is_dir().then_some(dir)
    }

    pub fn dir(&self) -> &Path {
        &self.dir
    }

    pub fn bddl_file(&self, suite: &str, stem: &str) -> PathBuf {
        self.dir.join("libero/bddl_files").join(suite).join(format!("{stem}.bddl"))
    }

    pub fn init_file(&self, suite: &str, stem: &str) -> PathBuf {
        self.dir.join("libero/init_files").join(suite).join(format!("{stem}.pruned_init"))
    }

    pub(crate) fn robosuite(&self) -> AssetRoot {
        AssetRoot { kind: RootKind::Robosuite, dir: self.dir.join("robosuite"), verified: None }
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum RootKind {
    Pack,
    Robosuite,
}

impl RootKind {
    /// Makes composed MJCF, and so the scene's digest, independent of the machine.
    fn token(self) -> &'static str {
        match self {
            Self::Pack => "@pack",
            Self::Robosuite => "@robosuite",
        }
    }
}

#[derive(Debug, Clone)]
pub(crate) struct AssetRoot {
    pub(crate) kind: RootKind,
    pub(crate) dir: PathBuf,
    /// LIBERO's files and their digests, if the folder's files must be LIBERO's.
    pub(crate) verified: Option<Arc<VerifiedFolder>>,
}

impl AssetRoot {
    pub(crate) fn path(&self, file: &str) -> PathBuf {
        self.dir.join(file)
    }

    /// Strips the placeholder; `None` if the file is in a folder of the other kind.
    pub(crate) fn inside<'a>(&self, file: &'a str) -> Option<&'a str> {
        file.strip_prefix(self.kind.token())?.strip_prefix('/')
    }

    /// Accepts an unreadable file: the caller's attempt to read it fails.
    pub(crate) fn verify(&self, inside: &str, what: &str) -> Result<(), SceneError> {
        let Some(verified) = &self.verified else {
            return Ok(());
        };
        let difference = match verified.table().get(inside) {
            Some(file) => match verified.verify(file) {
                Ok(()) | Err(Difference::Missing | Difference::Unreadable(_)) => return Ok(()),
                Err(difference) => difference.to_string(),
            },
            None => "LIBERO has no such file".to_owned(),
        };
        Err(SceneError::NotLiberos { what: what.to_owned(), path: self.path(inside), difference })
    }

    pub(crate) fn remedy(&self) -> String {
        match self.kind {
            RootKind::Pack => format!(
                "the asset pack {} lacks the file; `worker assets fetch` fetches LIBERO's \
                 assets, which `--assets libero` selects",
                self.dir.display()
            ),
            RootKind::Robosuite => REMEDY.to_owned(),
        }
    }
}

/// A file inside an asset folder, in the notation of composed MJCF: `@pack/textures/x.png`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct FileRef {
    kind: RootKind,
    path: String,
}

impl FileRef {
    /// Resolves the file `name` relative to `folder`; the result must stay inside the asset folder.
    pub(crate) fn resolve(kind: RootKind, folder: &Path, name: &str) -> Result<Self, String> {
        let mut parts: Vec<&str> = Vec::new();
        let joined = folder.join(name);
        for component in joined.components() {
            match component {
                Component::CurDir => {}
                Component::Normal(part) => {
                    parts.push(part.to_str().ok_or("a file name is not UTF-8")?);
                }
                Component::ParentDir if parts.pop().is_some() => {}
                _ => return Err(format!("file `{name}` lies outside the asset folder")),
            }
        }
        Ok(Self { kind, path: parts.join("/") })
    }
}

impl fmt::Display for FileRef {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.kind.token(), self.path)
    }
}

/// Replaces the placeholders of composed MJCF by the folders' paths, escaped for XML.
pub(crate) fn locate_files(mjcf: &str, roots: [&AssetRoot; 2]) -> String {
    let mut text = mjcf.to_owned();
    for root in roots {
        let from = format!("file=\"{}/", root.kind.token());
        let dir = root.dir.to_string_lossy();
        let dir = dir.replace('&', "&amp;").replace('<', "&lt;").replace('"', "&quot;");
        text = text.replace(&from, &format!("file=\"{dir}/"));
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn file_names_are_resolved_inside_the_asset_folder() {
        let resolve = |folder: &str, name: &str| {
            FileRef::resolve(RootKind::Pack, Path::new(folder), name).map(|file| file.to_string())
        };
        assert_eq!(resolve("scenes", "../textures/a.png"), Ok("@pack/textures/a.png".to_owned()));
        assert_eq!(resolve("a/b", "c/d.msh"), Ok("@pack/a/b/c/d.msh".to_owned()));
        assert!(resolve("a", "../../etc/passwd").unwrap_err().contains("outside"));
        assert!(resolve("a", "/etc/passwd").unwrap_err().contains("outside"));
    }
}
