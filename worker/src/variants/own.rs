//! Checks the files of a suite file's tasks.

use std::path::Path;
use std::{fmt, fs};

use libero_ctrl::OwnTask;
use libero_ctrl::presets::ENV_SEED;
use libero_family::Lack;
use scene::{
    AssetPack, InitialStates, SceneError, Sources, TaskFiles, check_goal, compose, needed_files,
};
use sha2::{Digest, Sha256};

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
        (usize::from(init_id) >= self.count)
            .then(|| Lack::States { path: self.path.clone(), count: self.count })
    }
}

/// Largest task file, bytes: a hundred times the largest of LIBERO.
const MAX_FILE_BYTES: u64 = 64 << 20;

/// Checks that a task's files exist, have the digest that the suite file gives, if any, and make a
/// scene with a goal that can be evaluated and, if it is the prompt, an instruction. Returns the task's initial states, or the lack that prevents its rollouts.
pub(super) fn check(
    own: &OwnTask,
    prompts_by_file: bool,
    pack: &AssetPack,
    sources: &Sources,
) -> Result<States, Lack> {
    let folder = Sources::suite_folder(sources.dir(), &own.folder);
    let text = |path: &Path| path.display().to_string();
    if !folder.is_dir() {
        return Err(Lack::Folder(text(&folder)));
    }
    let files = TaskFiles::of_suite_file(sources, own);
    let mut missing = [&files.bddl, &files.init].into_iter();
    if let Some(path) = missing.find(|path| !path.is_file()) {
        return Err(Lack::File(text(path)));
    }
    if let Some(expected) = &own.changes.sha256 {
        let found = digest([&files.bddl, &files.init]).map_err(Lack::Scene)?;
        if found != *expected {
            return Err(Lack::OtherFiles {
                bddl: text(&files.bddl),
                expected: expected.clone(),
                found,
            });
        }
    }
    let instruction = if prompts_by_file { files.instruction().map(drop) } else { Ok(()) };
    let states = instruction.and_then(|()| try_scene(&files, pack, sources));
    states.map_err(|error| Lack::Scene(transport::chain(&error)))
}

fn try_scene(files: &TaskFiles, pack: &AssetPack, sources: &Sources) -> Result<States, SceneError> {
    let problem = files.problem()?;
    match pack.is_managed() {
        // The pack's files are fetched only when the rollout starts.
        true => {
            check_goal(&problem)?;
            needed_files(&problem)?;
        }
        false => {
            compose(&problem, pack, sources, ENV_SEED)?;
        }
    }
    let states = InitialStates::read(&files.init)?;
    Ok(States { path: files.init.display().to_string(), count: states.count() })
}

/// Returns the SHA-256 of files in sequence, hex, or the reason why a file cannot be read.
fn digest(paths: [&Path; 2]) -> Result<String, String> {
    let mut digest = Sha256::new();
    for path in paths {
        let problem = |problem: &dyn fmt::Display| format!("read {}: {problem}", path.display());
        let bytes = path.metadata().map_err(|error| problem(&error))?.len();
        if bytes > MAX_FILE_BYTES {
            let size = format!("it has {bytes} bytes, more than {MAX_FILE_BYTES}");
            return Err(problem(&size));
        }
        digest.update(fs::read(path).map_err(|error| problem(&error))?);
    }
    Ok(hex(&digest.finalize()))
}
