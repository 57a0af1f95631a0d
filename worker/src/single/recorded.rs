//! Recorded actions in place of a policy: replayed one after another, whatever
//! becomes of the scene. Responsible for reading them: an NPZ file with an array
//! `actions` (such as a `trace.npz`), an NPY file, or JSON lines, each with n
//! rows of seven numbers.

use std::fs::File;
use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};

use npyz::npz::NpzArchive;
use npyz::{DType, NpyFile, TypeChar};
use proto::policy::{DescribeResponse, Observation};
use sha2::{Digest, Sha256};

use super::SingleError;
use crate::actor::Actor;
use crate::digest::hex;
use crate::policy::{ACTION_WIDTH, Action, Description, Episode, PolicyError};

/// Most actions of a recording: far more than any budget of the protocol.
const MAX_RECORDED_ACTIONS: usize = 10_000;
/// Longest line of JSON lines, bytes.
const MAX_LINE_BYTES: u64 = 4096;

/// Actions from a file.
#[derive(Debug)]
pub struct RecordedActions {
    path: PathBuf,
    actions: Vec<Action>,
    next: usize,
}

impl RecordedActions {
    /// Reads a file; its ending says of which kind it is.
    ///
    /// # Errors
    /// If it cannot be read, or holds no actions that a robot can execute.
    pub fn read(path: &Path) -> Result<Self, SingleError> {
        let failed = |problem: String| SingleError::Recorded {
            path: path.to_owned(),
            problem,
        };
        let actions = read_actions(path).map_err(failed)?;
        for (row, action) in actions.iter().enumerate() {
            if let Some(place) = action.iter().position(|number| !number.is_finite()) {
                let number = action[place];
                return Err(failed(format!(
                    "number {place} of action {row} is {number}"
                )));
            }
        }
        if actions.is_empty() {
            return Err(failed("it holds no action".to_owned()));
        }
        Ok(Self {
            path: path.to_owned(),
            actions,
            next: 0,
        })
    }

    /// How many there are: a replay is over after so many control steps.
    pub fn count(&self) -> u32 {
        // At most MAX_RECORDED_ACTIONS.
        self.actions.len() as u32
    }

    /// SHA-256 over the numbers, hex.
    fn digest(&self) -> String {
        let mut hash = Sha256::new();
        for number in self.actions.as_flattened() {
            hash.update(number.to_le_bytes());
        }
        hex(&hash.finalize())
    }
}

impl Actor for RecordedActions {
    fn describe(&mut self, _episode: Episode<'_>) -> Result<Description, PolicyError> {
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
        _episode: Episode<'_>,
        _suite: &str,
        _instruction: &str,
        _seed: u64,
    ) -> Result<(), PolicyError> {
        self.next = 0;
        Ok(())
    }

    fn infer(
        &mut self,
        episode: Episode<'_>,
        query_index: u32,
        _observation: Observation,
        horizon: usize,
    ) -> Result<Vec<Action>, PolicyError> {
        let rest = self.actions.iter().skip(self.next).take(horizon);
        let answer: Vec<Action> = rest.copied().collect();
        if answer.is_empty() {
            return Err(PolicyError::Misbehaved {
                policy: self.path.display().to_string(),
                session: episode.session.to_owned(),
                query: query_index.to_string(),
                violation: format!("the recording ends after {} actions", self.actions.len()),
            });
        }
        self.next += answer.len();
        Ok(answer)
    }
}

fn read_actions(path: &Path) -> Result<Vec<Action>, String> {
    let open = || File::open(path).map(BufReader::new);
    let open = || open().map_err(|error| error.to_string());
    match path.extension().and_then(|ending| ending.to_str()) {
        Some("npz") => {
            let mut archive = NpzArchive::new(open()?).map_err(|error| error.to_string())?;
            let array = archive
                .by_name("actions")
                .map_err(|error| error.to_string())?;
            rows_of(array.ok_or("it has no array `actions`")?)
        }
        Some("npy") => rows_of(NpyFile::new(open()?).map_err(|error| error.to_string())?),
        Some("jsonl" | "json") => read_lines(open()?),
        _ => Err("its name must end in .npz, .npy or .jsonl".to_owned()),
    }
}

fn rows_of(array: NpyFile<impl Read>) -> Result<Vec<Action>, String> {
    let shape = array.shape().to_vec();
    let [rows, width] = shape[..] else {
        return Err(format!("its shape is {shape:?}, not [n, {ACTION_WIDTH}]"));
    };
    if width != ACTION_WIDTH as u64 {
        return Err(format!("its shape is {shape:?}, not [n, {ACTION_WIDTH}]"));
    }
    if rows > MAX_RECORDED_ACTIONS as u64 {
        return Err(too_many());
    }
    if array.order() != npyz::Order::C {
        return Err("it is in Fortran order: write it with numpy.ascontiguousarray".to_owned());
    }
    let dtype = array.dtype();
    let kind = match &dtype {
        DType::Plain(kind) => (kind.type_char(), kind.num_bytes()),
        _ => return Err("it is a structured array".to_owned()),
    };
    let numbers = match kind {
        (TypeChar::Float, Some(8)) => array.into_vec::<f64>(),
        (TypeChar::Float, Some(4)) => array
            .into_vec::<f32>()
            .map(|numbers| numbers.into_iter().map(f64::from).collect()),
        _ => return Err(format!("it holds {}, not floats", dtype.descr())),
    };
    let numbers = numbers.map_err(|error| error.to_string())?;
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
        let problem = |error| format!("line {line}: {error}; write [x, y, z, rx, ry, rz, gripper]");
        actions.push(action.map_err(problem)?);
    }
    Ok(actions)
}

fn too_many() -> String {
    format!("it holds more than {MAX_RECORDED_ACTIONS} actions")
}
