//! Replays recorded actions in place of a policy, regardless of the scene. Reads n rows of seven
//! numbers from the array `actions` of an NPZ file (such as a `trace.npz`), from an NPY file, or
//! from JSON lines.

use std::fs::File;
use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};

use proto::checks::ACTION_WIDTH;
use proto::policy::{DescribeResponse, Observation};
use sha2::{Digest, Sha256};
use zip::ZipArchive;

use super::error::SingleError;
use super::npy::Header;
use crate::actor::{Action, Actor, Description, PolicyError, PolicySession};
use benchmark::{JsonError, Query};

/// Most actions of a recording, well above every step budget of the protocol.
const MAX_RECORDED_ACTIONS: usize = 10_000;
/// Longest line of JSON lines, bytes.
const MAX_LINE_BYTES: u64 = 4096;

/// Recorded actions, with the position of the replay.
#[derive(Debug)]
pub struct RecordedActions {
    path: PathBuf,
    actions: Vec<Action>,
    next: usize,
}

impl RecordedActions {
    /// Reads a file, whose extension determines its format.
    pub fn read(path: &Path) -> Result<Self, SingleError> {
        let failed = |problem: String| SingleError::Recorded { path: path.to_owned(), problem };
        let actions = read_actions(path).map_err(failed)?;
        Self::new(path, actions)
    }

    /// Takes the actions that a file holds.
    pub fn new(path: &Path, actions: Vec<Action>) -> Result<Self, SingleError> {
        let failed = |problem: String| SingleError::Recorded { path: path.to_owned(), problem };
        for (row, action) in actions.iter().enumerate() {
            if let Some(index) = action.iter().position(|number| !number.is_finite()) {
                let number = action[index];
                return Err(failed(format!("number {index} of action {row} is {number}")));
            }
        }
        if actions.is_empty() {
            return Err(failed("it holds no action".to_owned()));
        }
        Ok(Self { path: path.to_owned(), actions, next: 0 })
    }

    /// Returns the number of actions, after which the replay ends.
    pub fn count(&self) -> u32 {
        // At most MAX_RECORDED_ACTIONS.
        self.actions.len() as u32
    }

    /// Returns the SHA-256 over the actions, hex.
    fn digest(&self) -> String {
        let mut hash = Sha256::new();
        for number in self.actions.as_flattened() {
            hash.update(number.to_le_bytes());
        }
        hex::encode(hash.finalize())
    }
}

impl Actor for RecordedActions {
    fn describe(&mut self, _session: PolicySession<'_>) -> Result<Description, PolicyError> {
        let about = DescribeResponse {
            name: "recorded actions".to_owned(),
            checkpoint: self.path.display().to_string(),
            checkpoint_digest: self.digest(),
            ..DescribeResponse::default()
        };
        Ok(Description {
            about,
            state: Vec::new(),
            horizon: self.actions.len(),
            execute: self.actions.len(),
        })
    }

    fn reset(
        &mut self,
        _session: PolicySession<'_>,
        _instruction: &str,
        _seed: u64,
    ) -> Result<(), PolicyError> {
        self.next = 0;
        Ok(())
    }

    fn infer(
        &mut self,
        _session: PolicySession<'_>,
        _query_index: u32,
        _observation: Observation,
        horizon: usize,
        _: Option<&Query>,
    ) -> Result<Vec<Action>, PolicyError> {
        let following = self.actions.iter().skip(self.next).take(horizon);
        let answer: Vec<Action> = following.copied().collect();
        if answer.is_empty() {
            return Err(PolicyError::RecordingEnded {
                path: self.path.clone(),
                actions: self.actions.len(),
            });
        }
        self.next += answer.len();
        Ok(answer)
    }
}

fn read_actions(path: &Path) -> Result<Vec<Action>, String> {
    let open = || File::open(path).map(BufReader::new);
    let open = || open().map_err(|error| error.to_string());
    match path.extension().and_then(|extension| extension.to_str()) {
        Some("npz") => {
            let mut archive = ZipArchive::new(open()?).map_err(|error| error.to_string())?;
            let array = archive.by_name("actions.npy");
            read_rows(array.map_err(|_| "it has no array `actions`".to_owned())?)
        }
        Some("npy") => read_rows(open()?),
        Some("jsonl" | "json") => read_lines(open()?),
        _ => Err("its name must end in .npz, .npy, .jsonl or .json".to_owned()),
    }
}

fn read_rows(mut file: impl Read) -> Result<Vec<Action>, String> {
    let header = Header::read(&mut file)?;
    let [rows, ACTION_WIDTH] = header.shape[..] else {
        return Err(format!("its shape is {:?}, not [n, {ACTION_WIDTH}]", header.shape));
    };
    if rows > MAX_RECORDED_ACTIONS {
        return Err(too_many());
    }
    let numbers = header.floats(&mut file, rows * ACTION_WIDTH)?;
    Ok(numbers.as_chunks::<ACTION_WIDTH>().0.to_vec())
}

fn read_lines(mut reader: impl BufRead) -> Result<Vec<Action>, String> {
    let mut actions = Vec::new();
    for line in 1.. {
        let mut text = String::new();
        let limited = reader.by_ref().take(MAX_LINE_BYTES).read_line(&mut text);
        if limited.map_err(|error| format!("line {line}: {error}"))? == 0 {
            break;
        }
        if text.trim().is_empty() {
            continue;
        }
        if actions.len() == MAX_RECORDED_ACTIONS {
            return Err(too_many());
        }
        let action = serde_json::from_str(&text);
        let problem = |error: serde_json::Error| {
            let problem = JsonError::from(error);
            let problem = problem.problem();
            format!("line {line}: {problem}; write [x, y, z, rx, ry, rz, gripper]")
        };
        actions.push(action.map_err(problem)?);
    }
    Ok(actions)
}

fn too_many() -> String {
    format!("it holds more than {MAX_RECORDED_ACTIONS} actions")
}
