//! Checks the files of a suite file's tasks.

use std::fs;
use std::path::Path;

use libero_ctrl::OwnTask;
use libero_ctrl::presets::ENV_SEED;
use libero_family::Lack;
use scene::{AssetPack, InitialStates, SceneError, Sources, TaskFiles, compose, needed_files};
use sha2::{Digest, Sha256};

use super::error::VariantsError;
use crate::digest::hex;

/// Initial states of a task.
#[derive(Clone, Debug)]
pub(super) struct States {
    path: String,
    count: usize,
}

impl States {
    /// Returns the lack of an initial state; `None` if the state exists.
    pub(super) fn lack(&self, init_id: u16) -> Option<Lack> {
        (usize::from(init_id) >= self.count).then(|| Lack::States {
            path: self.path.clone(),
            count: self.count,
        })
    }
}

/// Checks that a task's files exist, are those of the suite file, and make a scene. Returns its
/// initial states, or what it lacks.
///
/// # Errors
/// If an existing file cannot be read.
pub(super) fn check(
    own: &OwnTask,
    pack: &AssetPack,
    sources: &Sources,
) -> Result<Result<States, Lack>, VariantsError> {
    let folder = Sources::suite_folder(sources.dir(), &own.folder);
    let text = |path: &Path| path.display().to_string();
    if !folder.is_dir() {
        return Ok(Err(Lack::Folder(text(&folder))));
    }
    let files = TaskFiles::of_suite_file(sources, own);
    let mut missing = [&files.bddl, &files.init].into_iter();
    if let Some(path) = missing.find(|path| !path.is_file()) {
        return Ok(Err(Lack::File(text(path))));
    }
    if let Some(expected) = &own.changes.sha256 {
        let found = digest([&files.bddl, &files.init])?;
        if found != *expected {
            return Ok(Err(Lack::OtherFiles {
                bddl: text(&files.bddl),
                expected: expected.clone(),
                found,
            }));
        }
    }
    let states = try_scene(&files, pack, sources);
    Ok(states.map_err(|error| Lack::Scene(transport::chain(&error))))
}

fn try_scene(files: &TaskFiles, pack: &AssetPack, sources: &Sources) -> Result<States, SceneError> {
    let problem = files.problem()?;
    match pack.is_managed() {
        true => {
            needed_files(&problem)?;
        }
        false => {
            compose(&problem, pack, sources, ENV_SEED)?;
        }
    }
    let states = InitialStates::read(&files.init)?;
    Ok(States {
        path: files.init.display().to_string(),
        count: states.count(),
    })
}

/// Returns the SHA-256 of files in sequence, hex.
fn digest(paths: [&Path; 2]) -> Result<String, VariantsError> {
    let mut digest = Sha256::new();
    for path in paths {
        let bytes = fs::read(path).map_err(|source| VariantsError::File {
            path: path.to_owned(),
            source,
        })?;
        digest.update(bytes);
    }
    Ok(hex(&digest.finalize()))
}
