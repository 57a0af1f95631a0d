//! Stages the folder that becomes the archive. The archive can be unpacked anywhere, also over a
//! prefix such as `/usr/local`.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result};

use crate::process::capture;
use crate::step::step;

use super::licences;
use super::native::{Elf, oldest_glibc};
use super::release::PROGRAMS;

const MUJOCO: &str = "libmujoco.so.3.3.7";

/// Extensions of the files that scenes are made from. No program reads the other files of the
/// source folders, which together are twice as large as these.
const SCENE_EXTENSIONS: [&str; 5] = ["bddl", "obj", "pruned_init", "stl", "xml"];

/// Folders of the archive for documents, and for the files that scenes are made from, where
/// `scene::Sources` looks for them beside `bin`.
pub(super) const DOCUMENTS: &str = "share/doc/rollout";
const SOURCES: &str = "share/rollout/sources";

/// Folder with files for users: the Python package for policies with the protocol, scripts and
/// manifests of `deploy`, published outcomes.
pub(super) const FOR_USERS: &str = "share/rollout";

/// Staged folder, and what its programs need from the machine.
pub(crate) struct Staged {
    pub(crate) folder: PathBuf,
    pub(crate) glibc: (u32, u32),
    /// Libraries, other than glibc's.
    pub(crate) libraries: BTreeSet<String>,
}

pub(crate) fn fill(root: &Path, cache: &Path, programs: &Path, folder: &Path) -> Result<Staged> {
    let elf = Elf::provide(cache)?;
    let staged = step("programs, libraries", || install(cache, programs, folder, &elf))?;
    step("manual pages, completions", || shell_files(folder))?;
    step("files of scenes", || scenes(cache, folder))?;
    let documents_folder = folder.join(DOCUMENTS);
    step("documents", || documents(root, folder, &documents_folder).map(|()| "copied"))?;
    step("licences", || match licences::tool(root) {
        // Only a development archive: `dist::run` requires the tool before it builds a release.
        Err(error) => Ok(format!("skipped: {error:#}")),
        Ok(()) => {
            licences::write(root, cache, &documents_folder)?;
            Ok("written".to_owned())
        }
    })?;
    Ok(staged)
}

impl std::fmt::Display for Staged {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let (major, minor) = self.glibc;
        write!(f, "for glibc {major}.{minor} or newer")?;
        self.libraries.iter().try_for_each(|name| write!(f, ", {name}"))
    }
}

fn install(cache: &Path, programs: &Path, folder: &Path, elf: &Elf) -> Result<Staged> {
    let bin = folder.join("bin");
    std::fs::create_dir_all(&bin)?;
    let library = folder.join("lib/rollout").join(MUJOCO);
    copy(&cache.join("mujoco-3.3.7").join(MUJOCO), &library)?;
    let mut libraries = BTreeSet::new();
    for name in PROGRAMS {
        libraries.append(&mut elf.install(&programs.join(name), &bin.join(name))?);
    }
    libraries.remove(MUJOCO);
    let mut files: Vec<PathBuf> = PROGRAMS.iter().map(|name| bin.join(name)).collect();
    files.push(library);
    Ok(Staged { folder: folder.to_owned(), glibc: oldest_glibc(&files)?, libraries })
}

/// Returns a command for one of the archive's programs, with an empty environment.
fn program(folder: &Path, name: &str) -> Command {
    let mut program = Command::new(folder.join("bin").join(name));
    program.env_clear();
    program
}

fn shell_files(folder: &Path) -> Result<String> {
    let share = folder.join("share");
    for name in PROGRAMS {
        capture(program(folder, name).arg("manual").arg(&share))?;
    }
    Ok(format!("{} pages", std::fs::read_dir(share.join("man/man1"))?.count()))
}

/// Copies the robot's models and the task files, and lets the worker unpack its built-in pack
/// beside them now, because users may not be able to write into the archive's folder.
fn scenes(cache: &Path, folder: &Path) -> Result<String> {
    let to = folder.join(SOURCES);
    for part in ["robosuite", "libero"] {
        let from = cache.join("sources").join(part);
        for file in files(&from)? {
            let ending = file.extension().and_then(|name| name.to_str()).unwrap_or_default();
            if SCENE_EXTENSIONS.contains(&ending) {
                copy(&from.join(&file), &to.join(part).join(&file))?;
            }
        }
    }
    let mut worker = program(folder, "worker");
    capture(worker.args(["assets", "primitives"]))?;
    Ok(format!("{} files", files(&to)?.len()))
}

fn documents(root: &Path, folder: &Path, to: &Path) -> Result<()> {
    for name in ["README.md", "CHANGELOG.md", "LICENSE-APACHE", "LICENSE-MIT"] {
        copy(&root.join(name), &to.join(name))?;
    }
    let pages = root.join("docs");
    for page in files(&pages)? {
        if page.extension().is_some_and(|extension| extension == "md") {
            copy(&pages.join(&page), &to.join("docs").join(&page))?;
        }
    }
    let to = folder.join(FOR_USERS);
    for name in ["deploy", "examples", "policies/src", "proto/rollout/policy"] {
        let from = root.join(name);
        for file in files(&from)?.iter().filter(|file| is_source(file)) {
            copy(&from.join(file), &to.join(name).join(file))?;
        }
    }
    for name in ["policies/README.md", "policies/pyproject.toml"] {
        copy(&root.join(name), &to.join(name))?;
    }
    Ok(())
}

/// Returns true if a file is a source, not one of Python's by-products.
fn is_source(file: &Path) -> bool {
    let is_by_product = |part: &str| part == "__pycache__" || part.ends_with(".egg-info");
    !file.iter().filter_map(|part| part.to_str()).any(is_by_product)
}

fn copy(from: &Path, to: &Path) -> Result<()> {
    let folder = to.parent().context("name a file")?;
    std::fs::create_dir_all(folder)?;
    std::fs::copy(from, to).with_context(|| format!("copy {}", from.display()))?;
    Ok(())
}

/// Returns all files below a folder, as sorted relative paths.
pub(super) fn files(folder: &Path) -> Result<Vec<PathBuf>> {
    let mut found = Vec::new();
    let mut pending = vec![PathBuf::new()];
    while let Some(relative) = pending.pop() {
        let path = folder.join(&relative);
        let entries = std::fs::read_dir(&path);
        for entry in entries.with_context(|| format!("read {}", path.display()))? {
            let entry = entry?;
            let relative = relative.join(entry.file_name());
            if entry.file_type()?.is_dir() { pending.push(relative) } else { found.push(relative) }
        }
    }
    found.sort();
    Ok(found)
}
