//! Sources of a scene's files: the robot models of robosuite, the BDDL files and initial
//! states of hf-libero (both unpacked by `cargo xtask setup`), and an asset pack.

use std::fmt;
use std::path::{Component, Path, PathBuf};
use std::sync::Arc;

use assets::{Difference, VerifiedFolder};
use libero_family::protocol::Benchmark;

use crate::error::SceneError;

/// The folder with the unpacked wheels: `robosuite/` (its `models/assets`) and
/// `libero/` (its `bddl_files` and `init_files`).
#[derive(Debug, Clone)]
pub struct Sources {
    dir: PathBuf,
}

impl Sources {
    /// Opens the folder, checking that its parts are there.
    pub fn open(dir: &Path) -> Result<Self, SceneError> {
        // MuJoCo looks for files with relative names elsewhere.
        let sources = Self {
            dir: std::path::absolute(dir).unwrap_or_else(|_| dir.to_owned()),
        };
        for part in [
            "robosuite/base.xml",
            "libero/bddl_files",
            "libero/init_files",
        ] {
            let path = dir.join(part);
            std::fs::metadata(&path).map_err(|source| SceneError::Read {
                what: "simulation source".to_owned(),
                path,
                remedy: "run `cargo xtask setup`, or point --sources at the folder it filled"
                    .to_owned(),
                source,
            })?;
        }
        Ok(sources)
    }

    /// `$ROLLOUT_SOURCES`, else what a release archive has beside its programs,
    /// else where `cargo xtask setup` puts the sources: `rollout/sources` in the
    /// user's cache folder.
    pub fn default_dir() -> PathBuf {
        if let Some(dir) = std::env::var_os("ROLLOUT_SOURCES") {
            return PathBuf::from(dir);
        }
        if let Some(dir) = Self::of_release() {
            return dir;
        }
        Self::in_cache()
    }

    /// `rollout/sources` in the user's cache folder.
    fn in_cache() -> PathBuf {
        Self::cache_folder().join("sources")
    }

    /// `rollout` in the user's cache folder.
    pub fn cache_folder() -> PathBuf {
        let cache = std::env::var_os("XDG_CACHE_HOME")
            .map(PathBuf::from)
            .or_else(|| std::env::var_os("HOME").map(|home| Path::new(&home).join(".cache")));
        cache.unwrap_or_default().join("rollout")
    }

    /// The folder that LIBERO's assets are fetched into: `packs/libero` in the sources.
    /// The folder of a release archive may be read-only; there it is the one in the
    /// user's cache folder, unless the archive's has been filled.
    pub fn fetched_pack(dir: &Path) -> PathBuf {
        Self::fetched(dir, "packs/libero")
    }

    /// The folder that the task files of a benchmark of LIBERO's family are fetched into, in
    /// the sources or, as with [`fetched_pack`](Self::fetched_pack), in the cache.
    pub fn family(dir: &Path, benchmark: Benchmark) -> PathBuf {
        Self::fetched(dir, benchmark.name())
    }

    fn fetched(dir: &Path, name: &str) -> PathBuf {
        let here = dir.join(name);
        let is_of_release = || {
            let canonical = dir.canonicalize().ok();
            canonical.is_some() && canonical == Self::of_release()
        };
        if !here.is_dir() && is_of_release() {
            return Self::in_cache().join(name);
        }
        here
    }

    /// `share/rollout/sources` beside the `bin` that this program lies in.
    fn of_release() -> Option<PathBuf> {
        let program = std::env::current_exe().ok()?.canonicalize().ok()?;
        let dir = program.parent()?.with_file_name("share/rollout/sources");
        dir.is_dir().then_some(dir)
    }

    /// The folder itself.
    pub fn dir(&self) -> &Path {
        &self.dir
    }

    /// The BDDL file of a task: suite's full name, file stem.
    pub fn bddl_file(&self, suite: &str, stem: &str) -> PathBuf {
        self.dir
            .join("libero/bddl_files")
            .join(suite)
            .join(format!("{stem}.bddl"))
    }

    /// The released initial states of a task: suite's full name, file stem.
    pub fn init_file(&self, suite: &str, stem: &str) -> PathBuf {
        self.dir
            .join("libero/init_files")
            .join(suite)
            .join(format!("{stem}.pruned_init"))
    }

    pub(crate) fn robosuite(&self) -> AssetRoot {
        AssetRoot {
            kind: RootKind::Robosuite,
            dir: self.dir.join("robosuite"),
            verified: None,
        }
    }
}

/// Asset folder that a file is in.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum RootKind {
    Pack,
    Robosuite,
}

impl RootKind {
    const ALL: [Self; 2] = [Self::Pack, Self::Robosuite];

    /// Placeholder of the folder in composed MJCF, so that the text, and with it the
    /// scene's digest, is the same on every machine.
    fn token(self) -> &'static str {
        match self {
            Self::Pack => "@pack",
            Self::Robosuite => "@robosuite",
        }
    }
}

/// A folder that pieces are read from.
#[derive(Debug, Clone)]
pub(crate) struct AssetRoot {
    pub(crate) kind: RootKind,
    pub(crate) dir: PathBuf,
    /// Present if the files must be LIBERO's.
    pub(crate) verified: Option<Arc<VerifiedFolder>>,
}

impl AssetRoot {
    pub(crate) fn kind(&self) -> RootKind {
        self.kind
    }

    pub(crate) fn path(&self, file: &str) -> PathBuf {
        self.dir.join(file)
    }

    /// The path in this folder of a file that composed MJCF names, if it is in it.
    pub(crate) fn inside<'a>(&self, file: &'a str) -> Option<&'a str> {
        file.strip_prefix(self.kind.token())?.strip_prefix('/')
    }

    /// Holds a file against LIBERO's table, if the pack goes by LIBERO's name. Whether
    /// it is there is left to who reads it.
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
        Err(SceneError::NotLiberos {
            what: what.to_owned(),
            path: self.path(inside),
            difference,
        })
    }

    pub(crate) fn remedy(&self) -> String {
        match self.kind {
            RootKind::Pack => format!(
                "the asset pack {} lacks it; `worker assets fetch` gets LIBERO's own, which \
                 `--assets libero` names",
                self.dir.display()
            ),
            RootKind::Robosuite => "run `cargo xtask setup` again".to_owned(),
        }
    }
}

/// A file inside an asset folder, as composed MJCF names it:
/// `@pack/textures/x.png`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct FileRef {
    kind: RootKind,
    path: String,
}

impl FileRef {
    /// The file that a piece in `folder` calls `name`; it must stay inside the
    /// asset folder.
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
        Ok(Self {
            kind,
            path: parts.join("/"),
        })
    }
}

impl fmt::Display for FileRef {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.kind.token(), self.path)
    }
}

/// Replaces the folder tokens of composed MJCF by this machine's folders.
pub(crate) fn locate_files(mjcf: &str, roots: [&AssetRoot; 2]) -> String {
    let mut text = mjcf.to_owned();
    for kind in RootKind::ALL {
        if let Some(root) = roots.iter().find(|root| root.kind == kind) {
            let from = format!("file=\"{}/", kind.token());
            let dir = root.dir.to_string_lossy();
            let dir = dir
                .replace('&', "&amp;")
                .replace('<', "&lt;")
                .replace('"', "&quot;");
            text = text.replace(&from, &format!("file=\"{dir}/"));
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn file_names_become_independent_of_the_folder() {
        let resolve = |folder: &str, name: &str| {
            FileRef::resolve(RootKind::Pack, Path::new(folder), name).map(|file| file.to_string())
        };
        assert_eq!(
            resolve("scenes", "../textures/a.png"),
            Ok("@pack/textures/a.png".to_owned())
        );
        assert_eq!(
            resolve("a/b", "c/d.msh"),
            Ok("@pack/a/b/c/d.msh".to_owned())
        );
        assert!(
            resolve("a", "../../etc/passwd")
                .unwrap_err()
                .contains("outside")
        );
        assert!(resolve("a", "/etc/passwd").unwrap_err().contains("outside"));
    }
}
