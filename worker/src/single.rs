//! `worker rollout`: one rollout from the command line, for looking at a case.
//! Does what a slot does, without a coordinator, and writes what came of it to
//! a folder: `result.json`, `video.mp4`, and `frames/` with the pictures of the
//! first and the last query as the policy saw them, turned upright.

use std::fs;
use std::io;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};

use image::{Rgb, RgbImage};
use protocol::{CampaignSpec, ManifestRow, Nominal, PolicyRoute, RolloutId};
use serde::Serialize;
use sim::{Frame, Observation, Simulator};

use crate::message::{Assignment, Finished, Session};
use crate::policy::{PolicyClient, PolicyError};
use crate::rollout::{self, RolloutError, Watcher};

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

/// The row of an id in LIBERO-CTRL v0.1: a combination combines all six axes.
///
/// # Errors
/// If the protocol has no such configuration, or it cannot be realised.
pub fn row_of(id: RolloutId) -> Result<ManifestRow, SingleError> {
    let problem = |problem: String| SingleError::Row { id, problem };
    // Nobody is asked there: the specification must only be complete.
    let policy = PolicyRoute {
        name: "policy".to_owned(),
        endpoint: "http://127.0.0.1:1".to_owned(),
    };
    let mut spec = CampaignSpec {
        tasks: vec![id.task()],
        ..CampaignSpec::v0_1("single", policy)
    };
    if let Some(config) = id.config() {
        spec.levels = vec![id.level()];
        spec.configs = vec![config];
        spec.nominal = Nominal::None;
    }
    let rows = spec.expand().map_err(|error| problem(error.to_string()))?;
    let row = rows.into_iter().find(|row| row.id == id);
    row.ok_or_else(|| problem("the protocol has no such configuration".to_owned()))
}

/// What `result.json` holds.
#[derive(Debug, Serialize)]
struct ResultFile<'a> {
    assignment: &'a Assignment,
    finished: &'a Finished,
}

/// Runs one rollout and writes what came of it to `output`.
///
/// # Errors
/// If it has no outcome, or a file cannot be written.
pub fn run(
    simulator: &mut Simulator,
    assignment: &Assignment,
    output: &Path,
) -> Result<Finished, SingleError> {
    let frames = output.join("frames");
    fs::create_dir_all(&frames).map_err(|source| write_error(&frames, source))?;
    let mut policy = PolicyClient::new(&assignment.policy_endpoint)?;
    let mut looker = Looker::default();
    let finished = rollout::run(simulator, &mut policy, assignment, &mut looker)?;
    for (query, shown) in looker.first.iter().chain(&looker.last) {
        for frame in shown {
            let path = frames.join(format!("query-{query:03}-{}.png", frame.camera));
            let saved = upright(frame).save(&path).map_err(io::Error::other);
            saved.map_err(|source| write_error(&path, source))?;
        }
    }
    let path = output.join("result.json");
    let text = serde_json::to_vec_pretty(&ResultFile {
        assignment,
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

/// Keeps what the policy saw at its first and at its last query.
#[derive(Default)]
struct Looker {
    first: Option<(u32, Vec<Frame>)>,
    last: Option<(u32, Vec<Frame>)>,
}

impl Watcher for Looker {
    fn progress(&mut self, _control_steps: u32) -> ControlFlow<()> {
        ControlFlow::Continue(())
    }

    fn observed(&mut self, query_index: u32, observation: &Observation) {
        let seen = Some((query_index, observation.frames.clone()));
        if self.first.is_none() {
            self.first = seen;
        } else {
            self.last = seen;
        }
    }
}

/// A frame with row 0 at its top.
fn upright(frame: &Frame) -> RgbImage {
    let (width, height) = (frame.width, frame.height);
    RgbImage::from_fn(width, height, |x, y| {
        let at = ((height - 1 - y) * width + x) as usize * 3;
        Rgb([frame.rgb[at], frame.rgb[at + 1], frame.rgb[at + 2]])
    })
}

fn write_error(path: &Path, source: io::Error) -> SingleError {
    SingleError::Write {
        path: path.to_owned(),
        source,
    }
}

#[cfg(test)]
mod tests {
    use protocol::Axis;

    use super::*;

    #[test]
    fn an_id_alone_says_what_is_simulated() {
        let row = |id: &str| row_of(id.parse().expect("an id"));
        let clean = row("spatial/t0/clean/L0/c07").expect("a row");
        assert_eq!((clean.init_id, clean.perturbation.axes().len()), (7, 0));
        let single = row("spatial/t0/camera/L2/c00").expect("a row");
        assert_eq!(
            (single.init_id, single.perturbation.axes()),
            (43, vec![Axis::Camera])
        );
        let all = row("spatial/t0/combination/L2/c00").expect("a row");
        assert_eq!(all.perturbation.axes(), Axis::METRIC);
        let paraphrased = row("spatial/t0/language/L2/c00").expect("a row");
        assert_eq!(all.instruction, paraphrased.instruction);
        assert_ne!(all.instruction, clean.instruction);
        let error = row("spatial/t0/camera/L2/c10").expect_err("ten configurations");
        assert!(error.to_string().contains("c10"), "{error}");
    }

    #[test]
    fn pictures_are_written_upright() {
        let frame = Frame {
            camera: "agentview".to_owned(),
            width: 1,
            height: 2,
            rgb: vec![1, 2, 3, 4, 5, 6],
        };
        assert_eq!(upright(&frame).into_raw(), [4, 5, 6, 1, 2, 3]);
    }
}
