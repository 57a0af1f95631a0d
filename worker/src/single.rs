//! `worker rollout`: one rollout from the command line, for looking at a case.
//! Does what a slot does, without a coordinator, and writes what came of it to
//! a folder: `result.json`, `trace.npz`, `video.mp4`, and `frames/` with the
//! first and the last picture of both cameras and those of the first and the
//! last query as the policy saw them, all upright.

mod looker;
mod own_task;
mod recorded;
mod trace;

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use protocol::{Axis, Condition, Design, ManifestRow, Nominal, RolloutId};
use scene::{SceneError, TaskFiles};
use serde::Serialize;
use sim::Simulator;

use crate::actor::Actor;
use crate::message::{Assignment, Finished, Session};
use crate::policy::PolicyError;
use crate::rollout::{self, RolloutError, Stage};

use looker::Looker;
pub use own_task::OwnTask;
pub use recorded::RecordedActions;

/// Why there is no result.
#[derive(Debug, thiserror::Error)]
pub enum SingleError {
    /// The id names no rollout of the protocol.
    #[error("make the manifest row of {id}: {problem}")]
    Row {
        /// The id.
        id: RolloutId,
        /// Why not.
        problem: String,
    },
    /// A task of one's own cannot be read.
    #[error(transparent)]
    Task(#[from] SceneError),
    /// Nothing to tell the policy.
    #[error(
        "find an instruction in {}: it has no `(:language …)`; give one with --instruction",
        bddl.display()
    )]
    NoInstruction {
        /// The BDDL file.
        bddl: PathBuf,
    },
    /// Recorded actions cannot be read.
    #[error("read recorded actions {}: {problem}", path.display())]
    Recorded {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        problem: String,
    },
    /// The policy cannot be called.
    #[error(transparent)]
    Policy(#[from] PolicyError),
    /// The rollout has no outcome.
    #[error(transparent)]
    Rollout(#[from] RolloutError),
    /// A file cannot be written.
    #[error("write {}", path.display())]
    Write {
        /// Which.
        path: PathBuf,
        /// What happened.
        #[source]
        source: io::Error,
    },
}

/// The row of an id in LIBERO-CTRL v0.1, or beyond it in the design of seed 0.
/// A combination combines all six axes, or at a radius of its own, for which
/// there are no paraphrases, the five metric ones.
///
/// # Errors
/// If there is no such configuration.
pub fn row_of(id: RolloutId) -> Result<ManifestRow, SingleError> {
    let problem = |problem: String| SingleError::Row { id, problem };
    let mut design = Design {
        tasks: vec![id.task()],
        ..Design::v0_1()
    };
    if let Some(config) = id.config() {
        design.axes = match id.condition() {
            Condition::Single(axis) => vec![axis],
            _ if id.level().is_named() => Axis::ALL.to_vec(),
            _ => Axis::METRIC.to_vec(),
        };
        design.levels = vec![id.level()];
        design.configs = vec![config];
        design.nominal = Nominal::None;
    }
    let rows = design
        .expand()
        .map_err(|error| problem(error.to_string()))?;
    let row = rows.into_iter().find(|row| row.id == id);
    row.ok_or_else(|| problem("the protocol has no such configuration".to_owned()))
}

/// What to do, and what to keep of it.
pub struct Order<'a> {
    /// The rollout.
    pub assignment: &'a Assignment,
    /// A task that stands in for the row's.
    pub files: Option<TaskFiles>,
    /// Whether to draw the first and the last picture of both cameras.
    pub draw: bool,
    /// Where everything is written.
    pub output: &'a Path,
}

/// What `result.json` holds.
#[derive(Debug, Serialize)]
struct ResultFile<'a> {
    /// The files that stood in for those of the row's task.
    #[serde(skip_serializing_if = "Option::is_none")]
    own_task: Option<OwnFiles<'a>>,
    assignment: &'a Assignment,
    finished: &'a Finished,
}

#[derive(Debug, Serialize)]
struct OwnFiles<'a> {
    bddl: &'a Path,
    init: &'a Path,
}

/// Runs one rollout and writes what came of it. Where it breaks off, its trace
/// and pictures up to there are written all the same.
///
/// # Errors
/// If it has no outcome, or a file cannot be written.
pub fn run(
    simulator: &mut Simulator,
    actor: &mut dyn Actor,
    order: &Order<'_>,
) -> Result<Finished, SingleError> {
    let output = order.output;
    fs::create_dir_all(output).map_err(|source| write_error(output, source))?;
    let mut looker = Looker::new(order.draw);
    let stage = match &order.files {
        None => Stage::of_the_protocol(simulator),
        Some(files) => Stage::of_files(simulator, files.clone()),
    };
    let stage = match order.draw {
        true => stage,
        false => stage.with_a_renderer_only_if_needed(),
    };
    let finished = rollout::run(stage, actor, order.assignment, &mut looker);
    looker.write(output)?;
    let finished = finished?;
    let path = output.join("result.json");
    let text = serde_json::to_vec_pretty(&ResultFile {
        own_task: order.files.as_ref().map(|files| OwnFiles {
            bddl: &files.bddl,
            init: &files.init,
        }),
        assignment: order.assignment,
        finished: &finished,
    });
    let written = text.map_err(io::Error::from);
    let written = written.and_then(|text| fs::write(&path, text));
    written.map_err(|source| write_error(&path, source))?;
    Ok(finished)
}

/// The session of a rollout that no coordinator leased.
pub fn session(id: &RolloutId, replicate: u32) -> Session {
    Session::new(id, replicate, 0)
}

fn write_error(path: &Path, source: io::Error) -> SingleError {
    SingleError::Write {
        path: path.to_owned(),
        source,
    }
}

#[cfg(test)]
mod tests;
