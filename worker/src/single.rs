//! `worker rollout`: runs one rollout for inspection, without a coordinator. Writes `result.json`,
//! `trace.npz`, `video.mp4` and `frames/`, which holds the first and the last query's frames as
//! the policy saw them, and both cameras' first and last frame at the video's size; all upright
//! and with the sensor's corruption.

mod capture;
mod error;
mod npy;
mod own_task;
mod recorded;
mod trace;

use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::{fs, io};

use benchmark::attempt::{Provenance, RolloutResult};
use scene::TaskFiles;
use serde::Serialize;
use sim::{Simulator, VariantStart};
use transport::chain;

use crate::actor::{Action, Actor};
use crate::filming::film;
use crate::message::{Assignment, Finished};
use crate::rollout;
use crate::stage::Stage;

use capture::Capture;
pub use error::SingleError;
use error::write_error;
pub use own_task::OwnTask;
pub use recorded::RecordedActions;

/// Rollout to run, and the outputs to write.
pub struct Request<'a> {
    /// The rollout, as a coordinator would assign it.
    pub assignment: &'a Assignment,
    /// Task files that replace those of the row's task.
    pub files: Option<TaskFiles>,
    /// Initial conditions of a rollout of LIBERO's family or of a suite file.
    pub variant: Option<VariantStart>,
    /// True if the first and the last frame of both cameras are rendered.
    pub renders_ends: bool,
    pub output: &'a Path,
}

#[derive(Debug, Serialize)]
struct ResultFile<'a> {
    /// Task files that replaced those of the row's task.
    #[serde(skip_serializing_if = "Option::is_none")]
    own_task: Option<OwnFiles<'a>>,
    assignment: &'a Assignment,
    finished: FinishedFile<'a>,
}

#[derive(Debug, Serialize)]
struct OwnFiles<'a> {
    bddl: &'a Path,
    init: &'a Path,
}

#[derive(Debug, Serialize)]
struct FinishedFile<'a> {
    outcome: &'a RolloutResult,
    provenance: &'a Provenance,
    motion: MotionFile,
    /// Path of the video, if one was requested and could be made.
    video: Option<PathBuf>,
}

/// Motion of the robot as plain numbers.
#[derive(Debug, Serialize)]
struct MotionFile {
    /// End-effector positions at rest and after every control step, world frame, tenths of a
    /// millimetre.
    path: Vec<[i16; 3]>,
    /// Commands to the robot; empty unless the assignment keeps them.
    actions: Vec<Action>,
}

/// Runs one rollout and writes its outputs. If an error ends the rollout, the trace and frames up
/// to the error are still written.
pub fn run(
    simulator: &mut Simulator,
    actor: &mut dyn Actor,
    request: &Request<'_>,
) -> Result<Finished, SingleError> {
    let (assignment, output) = (request.assignment, request.output);
    fs::create_dir_all(output).map_err(|source| write_error(output, source))?;
    if output.join("result.json").exists() {
        terminal::complain(&format!("replacing the rollout in {}", output.display()));
    }
    let mut capture = Capture::new(request.renders_ends);
    let stage = match &request.files {
        None => Stage::of_the_protocol(simulator),
        Some(files) => Stage::of_files(simulator, files.clone()),
    };
    let stage = stage.with_variant(request.variant.clone());
    let mut stage = match request.renders_ends {
        true => stage,
        false => stage.with_a_renderer_only_if_needed(),
    };
    let simulated = rollout::run(&mut stage, actor, assignment, &mut capture);
    capture.write(output)?;
    let simulated = simulated?;
    let video = film(&mut stage, assignment, &simulated, &mut |_| ControlFlow::Continue(()));
    let video = video.unwrap_or_else(|error| {
        let session = &assignment.session;
        tracing::warn!("no video of {session}: failed to {}", chain(&error));
        None
    });
    let finished = simulated.finished;
    let actions = finished.motion.actions().into_iter();
    let path = output.join("result.json");
    let text = serde_json::to_vec_pretty(&ResultFile {
        own_task: request
            .files
            .as_ref()
            .map(|files| OwnFiles { bddl: &files.bddl, init: &files.init }),
        assignment,
        finished: FinishedFile {
            outcome: &finished.result,
            provenance: &finished.provenance,
            motion: MotionFile {
                path: finished.motion.path(),
                actions: actions.map(|action| action.map(f64::from)).collect(),
            },
            video,
        },
    });
    let written = text.map_err(io::Error::from);
    let written = written.and_then(|text| fs::write(&path, text));
    written.map_err(|source| write_error(&path, source))?;
    Ok(finished)
}

#[cfg(test)]
pub(crate) mod tests;
