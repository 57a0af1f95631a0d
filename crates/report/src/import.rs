//! Import of result files of the reference implementation and of `coordinator export`:
//! `rollouts.jsonl`, one policy per folder, and optionally an `about.json` beside it with
//! metadata that the rows lack.
//!
//! Lines are read one at a time. A file with a bad line is rejected as a whole, with the
//! numbers of its bad lines, because a partial import would change the figures.

use std::collections::{BTreeMap, HashMap};
use std::fs::File;
use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};

use benchmark::attempt::GoalProgress;
use benchmark::{Condition, Directions, Execution, JsonError, Level, RolloutId, Suite};
use benchmark::{Look, MAX_ROWS, Realisation};
use paired::{Count, Outcome, Progress, Record};
use serde::Deserialize;
use sha2::{Digest, Sha256};

use crate::subject::{Origin, Setups, Subject};

const ROWS: &str = "rollouts.jsonl";
const ABOUT: &str = "about.json";
/// Largest length of a line, bytes, its newline included.
const MAX_LINE_BYTES: u64 = 64 << 10;
/// Largest `about.json` that is read, bytes.
const MAX_ABOUT_BYTES: u64 = 64 << 10;
/// Largest number of bad lines that an error lists; further ones are only counted.
const MAX_NAMED: usize = 10;
/// Largest number of rows in a file: ten replicates of the largest design.
const MAX_FILE_ROWS: usize = 10 * MAX_ROWS;
/// Largest file, bytes; [`MAX_FILE_ROWS`] rows of a few hundred bytes need less. Without a limit,
/// reading a sparse file or a device takes hours or never ends.
const MAX_FILE_BYTES: u64 = 4 << 30;

/// A file that cannot be read as results.
#[derive(Debug, thiserror::Error)]
pub enum ImportError {
    #[error("read {path}: name a folder that holds {ROWS}, or such a file")]
    Read { path: PathBuf, source: std::io::Error },
    #[error(
        "import {path}: {} bad, nothing was imported: {}",
        lines_are(.bad),
        reasons(.named, .bad)
    )]
    Lines { path: PathBuf, bad: usize, named: Vec<BadLine> },
    #[error("import {path}: it has more than {MAX_FILE_ROWS} rows; divide the file")]
    TooLong { path: PathBuf },
    #[error("import {path}: it is larger than {} GiB; divide the file", MAX_FILE_BYTES >> 30)]
    TooLarge { path: PathBuf },
    #[error("import {path}: it has no row")]
    Empty { path: PathBuf },
    #[error("read {path}, which describes the rows")]
    About { path: PathBuf, source: JsonError },
}

/// A line that is not a valid result row.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BadLine {
    /// Number of the line, from 1.
    pub number: usize,
    pub reason: String,
}

/// Content of `about.json`; every field may be absent.
#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct About {
    policy: Option<String>,
    source: String,
    realisation: Option<Realisation>,
    look: Option<Look>,
    published_nominal: Option<f64>,
    nominal: Option<Count>,
    directions: Directions,
}

/// A result row of the reference implementation. Fields that repeat parts of the id are
/// checked against the id; times are ignored.
#[derive(Deserialize)]
struct Row {
    rollout_id: RolloutId,
    success: bool,
    #[serde(default)]
    replicate: u32,
    init_id: Option<u16>,
    axis: Option<Condition>,
    level: Option<Level>,
    suite: Option<String>,
    task_id: Option<u8>,
    config: Option<u16>,
    policy: Option<String>,
    steps: Option<u32>,
    placebo_radius: Option<f64>,
    /// Protocol of LIBERO's family or of a suite file; `None` in other rows.
    protocol: Option<String>,
    goal_predicates: Option<u32>,
    goal_at_end: Option<u32>,
    goal_at_most: Option<u32>,
    #[serde(default)]
    execution: Execution,
}

/// Reads one policy's results from a folder, or from a file of rows.
pub fn import(path: &Path) -> Result<Subject, ImportError> {
    let (rows, about) = match path.is_dir() {
        true => (path.join(ROWS), read_about(&path.join(ABOUT))?),
        false => (path.to_owned(), About::default()),
    };
    let read_error = |source| ImportError::Read { path: rows.clone(), source };
    let mut reading = Reading::default();
    let mut digest = Sha256::new();
    let file = File::open(&rows).map_err(read_error)?;
    let size_bytes = file.metadata().map_err(read_error)?.len();
    let mut read_bytes = 0;
    let mut file = BufReader::new(file);
    let mut line = Vec::new();
    // True while the remainder of a line beyond the limit is skipped.
    let mut is_remainder = false;
    loop {
        if size_bytes.max(read_bytes) > MAX_FILE_BYTES {
            return Err(ImportError::TooLarge { path: rows });
        }
        line.clear();
        let read = file.by_ref().take(MAX_LINE_BYTES + 1).read_until(b'\n', &mut line);
        let read = read.map_err(read_error)? as u64;
        if read == 0 {
            break;
        }
        read_bytes += read;
        digest.update(&line);
        let was_remainder = std::mem::replace(&mut is_remainder, !line.ends_with(b"\n"));
        if was_remainder {
            continue;
        }
        if reading.records.len() == MAX_FILE_ROWS {
            return Err(ImportError::TooLong { path: rows });
        }
        reading.add_line(&line);
    }
    if reading.bad > 0 {
        let Reading { bad, named, .. } = reading;
        return Err(ImportError::Lines { path: rows, bad, named });
    }
    if reading.records.is_empty() {
        return Err(ImportError::Empty { path: rows });
    }
    let is_of_variants = reading.records.iter().any(|record| record.id.variant().is_some());
    let name = path.file_name().map(|name| name.to_string_lossy().into_owned());
    let name = name.unwrap_or_else(|| ".".to_owned());
    Ok(Subject {
        policy: about.policy.or(reading.policy).unwrap_or_else(|| name.clone()),
        origin: Origin::File { name, digest: hex::encode(digest.finalize()), source: about.source },
        realisation: about.realisation,
        look: about.look,
        execution: reading.execution.unwrap_or_default(),
        records: reading.records,
        errors: Vec::new(),
        divergent: Vec::new(),
        left_out: 0,
        beyond: None,
        fingerprints: None,
        provenances: Vec::new(),
        published_nominal: about.published_nominal,
        directions: about.directions,
        placebo_radius: reading.placebo_radius,
        progress: reading.progress,
        published_by_suite: Vec::new(),
        reported_nominal: about.nominal,
        setups: Setups::default(),
        derived: None,
        // A suite file's tasks under LIBERO-CTRL's axes are reported as LIBERO's are.
        protocol: reading.protocol.filter(|_| is_of_variants),
        early_stop: None,
        simulated: BTreeMap::new(),
    })
}

fn read_about(path: &Path) -> Result<About, ImportError> {
    let path = path.to_owned();
    let file = match File::open(&path) {
        Ok(file) => file,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(About::default()),
        Err(source) => return Err(ImportError::Read { path, source }),
    };
    let about = serde_json::from_reader(file.take(MAX_ABOUT_BYTES));
    about.map_err(|error: serde_json::Error| ImportError::About { path, source: error.into() })
}

/// Rows and bad lines read so far.
#[derive(Default)]
struct Reading {
    number: usize,
    records: Vec<Record>,
    progress: Vec<Progress>,
    /// Radius of the rows at the placebo level.
    placebo_radius: Option<f64>,
    /// Line number of each rollout and replicate, to report duplicates.
    lines: HashMap<(RolloutId, u32), usize>,
    policy: Option<String>,
    /// Execution model of the rows outside the latency axis: that of the first row, or `Wait` if
    /// the first row is of the latency axis, which campaigns run only together with `Wait`.
    execution: Option<Execution>,
    /// Protocol of the first row, if it has one.
    protocol: Option<String>,
    bad: usize,
    /// The first bad lines, which the error names.
    named: Vec<BadLine>,
}

impl Reading {
    fn add_line(&mut self, line: &[u8]) {
        self.number += 1;
        let is_too_long = line.len() as u64 > MAX_LINE_BYTES;
        if !is_too_long && line.iter().all(u8::is_ascii_whitespace) {
            return;
        }
        match self.parse(line) {
            Ok(record) => self.records.push(record),
            Err(reason) => {
                self.bad += 1;
                if self.named.len() < MAX_NAMED {
                    let number = self.number;
                    self.named.push(BadLine { number, reason });
                }
            }
        }
    }

    fn parse(&mut self, line: &[u8]) -> Result<Record, String> {
        if line.len() as u64 > MAX_LINE_BYTES {
            return Err(format!("it is longer than {MAX_LINE_BYTES} bytes"));
        }
        let row: Row = serde_json::from_slice(line.trim_ascii_end()).map_err(|error| {
            // serde_json sees a single line and always reports line 1.
            let error = JsonError::from(error);
            match error.place() {
                Some((_, column)) => format!("{}, at column {column}", error.problem()),
                None => error.problem().to_owned(),
            }
        })?;
        row.check_consistency()?;
        if let Some(protocol) = &row.protocol {
            // The protocol of a suite file is `NAME@DIGEST`.
            let is_of_suite_file = protocol.contains('@');
            if is_of_suite_file != (row.rollout_id.task().suite() == Suite::Own) {
                return Err(format!(
                    "rollout {} does not belong to the benchmark of protocol `{protocol}`",
                    row.rollout_id
                ));
            }
        }
        let key = (row.rollout_id, row.replicate);
        if let Some(earlier) = self.lines.insert(key, self.number) {
            return Err(format!("{} is on line {earlier} too", row.rollout_id));
        }
        let policy = row.policy.clone();
        match (&self.policy, policy) {
            (Some(earlier), Some(policy)) if *earlier != policy => {
                return Err(format!(
                    "it is of policy `{policy}`, earlier lines are of `{earlier}`: one policy per \
                     file"
                ));
            }
            (None, Some(policy)) => self.policy = Some(policy),
            _ => {}
        }
        let is_latency = row.rollout_id.condition().sets_execution();
        let first = self.execution.get_or_insert_with(|| match is_latency {
            true => Execution::Wait,
            false => row.execution.clone(),
        });
        if !is_latency && *first != row.execution {
            return Err(format!(
                "it ran under execution model `{}`, earlier lines under `{first}`: one model per \
                 file",
                row.execution
            ));
        }
        if self.records.is_empty() {
            self.protocol.clone_from(&row.protocol);
        }
        if self.protocol != row.protocol {
            let described = |protocol: &Option<String>| match protocol {
                Some(protocol) => format!("under protocol `{protocol}`"),
                None => "without `protocol`".to_owned(),
            };
            return Err(format!(
                "it is {}, earlier lines are {}: one protocol of LIBERO's family per file",
                described(&row.protocol),
                described(&self.protocol)
            ));
        }
        match (self.placebo_radius, row.placebo_radius) {
            (Some(earlier), Some(radius)) if earlier != radius => {
                return Err(format!(
                    "its `placebo_radius` is {radius}, that of earlier lines {earlier}: one radius \
                     per file"
                ));
            }
            (None, radius) => self.placebo_radius = radius,
            _ => {}
        }
        let progress = Progress {
            id: row.rollout_id,
            replicate: row.replicate,
            steps: row.steps,
            goal: row.goal(),
        };
        if progress.steps.is_some() || progress.goal.is_some() {
            self.progress.push(progress);
        }
        Ok(Record {
            id: row.rollout_id,
            init_id: row.initial_state()?,
            replicate: row.replicate,
            outcome: Outcome::from(row.success),
        })
    }
}

impl Row {
    fn check_consistency(&self) -> Result<(), String> {
        let (id, task) = (self.rollout_id, self.rollout_id.task());
        let agreements = [
            ("axis", self.axis.is_none_or(|axis| axis == id.condition())),
            ("level", self.level.is_none_or(|level| level.radius() == id.level().radius())),
            ("suite", self.suite.as_deref().is_none_or(|suite| suite == task.suite().name())),
            ("task_id", self.task_id.is_none_or(|index| index == task.index())),
            (
                "config",
                self.config
                    .is_none_or(|config| id.config().is_none_or(|expected| expected == config)),
            ),
        ];
        if let Some((field, _)) = agreements.iter().find(|(_, agrees)| !agrees) {
            return Err(format!("`{field}` contradicts the rollout id {id}"));
        }
        match self.goal().is_none_or(|goal| goal.agrees_with(self.success)) {
            true => Ok(()),
            false => Err(
                "`goal_predicates`, `goal_at_end` and `goal_at_most` contradict one another or \
                 `success`"
                    .to_owned(),
            ),
        }
    }

    /// Returns the progress towards the goal; `None` if the row lacks one of its three columns.
    fn goal(&self) -> Option<GoalProgress> {
        Some(GoalProgress {
            predicates: self.goal_predicates?,
            at_end: self.goal_at_end?,
            at_most: self.goal_at_most?,
        })
    }

    /// Returns the row's initial state. If the row gives none, returns the state in its id if the
    /// rollout is nominal, or the protocol's state for configurations 0 to 9.
    fn initial_state(&self) -> Result<u16, String> {
        let config = self.rollout_id.config();
        let default_state = match config {
            None => Some(self.rollout_id.number()),
            Some(config) => {
                self.rollout_id.task().eval_init_ids().get(usize::from(config)).copied()
            }
        };
        let stated = self.init_id.or(default_state);
        stated.ok_or_else(|| format!("{} has no `init_id`", self.rollout_id))
    }
}

fn lines_are(bad: &usize) -> String {
    match bad {
        1 => "1 line is".to_owned(),
        bad => format!("{bad} lines are"),
    }
}

fn reasons(named: &[BadLine], bad: &usize) -> String {
    let mut lines: Vec<String> =
        named.iter().map(|line| format!("line {}: {}", line.number, line.reason)).collect();
    if *bad > named.len() {
        lines.push(format!("and {} more", bad - named.len()));
    }
    lines.join("; ")
}
