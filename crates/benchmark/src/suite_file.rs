//! Suite files: benchmarks that users define as data. A file names the BDDL file and the initial
//! states of every task, and the rules under which the tasks run. `docs/FAMILY.md` describes the
//! fields.

use std::collections::BTreeSet;

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use crate::axis::Axis;
use crate::axis_set::AxisSet;
use crate::design::{Design, DesignError};
use crate::expansion::NoSuchRow;
use crate::own_task::{
    Beginning, Changes, InvalidField, OwnTask, check_name, check_path, check_range, invalid, quoted,
};
use crate::perturbation::Perturbation;
use crate::rollout_id::RolloutId;
use crate::row::ManifestRow;
use crate::suite::{INIT_STATES_PER_TASK, TaskRef, instruction_of_name};
use crate::variant_name::VariantName;
use crate::wording::JsonError;

/// Placeholder for the task's name in the paths of a suite.
const NAME: char = '*';
/// Largest number of tasks of a file: their positions must fit a byte in rollout ids.
const MAX_TASKS: usize = 256;
/// Largest step budget, control steps.
const MAX_BUDGET: u32 = 100_000;
/// Largest number of control steps before the policy starts.
const MAX_WAITS: u32 = 1000;
/// Length limit of a prompt, bytes, which is also that of instructions in results.
const MAX_PROMPT_BYTES: usize = 4096;
/// Number of digits of a file's digest in the name of its protocol.
const DIGEST_DIGITS: usize = 16;

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum SuitePrompt {
    /// The words of the task's name, as in LIBERO.
    Name,
    /// The instruction in the task's BDDL file, in lower case.
    Bddl,
}

impl SuitePrompt {
    pub const fn name(self) -> &'static str {
        match self {
            Self::Name => "name",
            Self::Bddl => "bddl",
        }
    }
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SuiteFile {
    pub name: String,
    /// Folder of the task files, relative to the folder of a worker's option `--sources`;
    /// `suites/NAME` if not given.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub folder: Option<String>,
    pub start: Beginning,
    pub prompt: SuitePrompt,
    pub seed: u32,
    /// Control steps with the no-op action before the policy's first observation.
    pub waits: u32,
    /// Step budget of the policy, control steps.
    pub budget: u32,
    /// Number of trials of each task. Trial i starts from initial state i, or from reset i if
    /// `start` is a reset. Not part of the digest.
    #[serde(default = "all_states")]
    pub trials: u16,
    pub suites: Vec<FileSuite>,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FileSuite {
    pub name: String,
    /// Path of the BDDL files in the folder, with `*` in place of the task's name.
    pub bddl: String,
    /// Path of the initial states in the folder, with `*` in place of the task's name.
    pub states: String,
    /// Step budget of the policy; `None` for [`SuiteFile::budget`].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub budget: Option<u32>,
    pub tasks: Vec<FileTask>,
}

/// A task of a suite file: its name, or a table with its name and further fields.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(from = "TaskText", into = "TaskText")]
pub struct FileTask {
    /// Name of the task's files, without folder and ending.
    pub name: String,
    /// Prompt; `None` if it comes from the source [`SuiteFile::prompt`].
    pub prompt: Option<String>,
    /// Settings that differ from LIBERO's, and the checksum of the task's files.
    pub changes: Changes,
}

#[derive(Serialize, Deserialize)]
#[serde(
    untagged,
    expecting = "a task is its name, or a table with `name` and any of `prompt`, \
    `view`, `posture`, `noise` and `sha256`"
)]
enum TaskText {
    Name(String),
    Table(TaskTable),
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct TaskTable {
    name: String,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    prompt: Option<String>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    view: Option<[u16; 5]>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    posture: Option<[f64; 7]>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    noise: Option<u8>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    sha256: Option<String>,
}

impl From<TaskText> for FileTask {
    fn from(text: TaskText) -> Self {
        match text {
            TaskText::Name(name) => Self { name, prompt: None, changes: Changes::default() },
            TaskText::Table(table) => Self {
                name: table.name,
                prompt: table.prompt,
                changes: Changes {
                    view: table.view,
                    posture: table.posture,
                    noise: table.noise,
                    sha256: table.sha256,
                },
            },
        }
    }
}

impl From<FileTask> for TaskText {
    fn from(task: FileTask) -> Self {
        if task.prompt.is_none() && task.changes == Changes::default() {
            return Self::Name(task.name);
        }
        let changes = task.changes;
        Self::Table(TaskTable {
            name: task.name,
            prompt: task.prompt,
            view: changes.view,
            posture: changes.posture,
            noise: changes.noise,
            sha256: changes.sha256,
        })
    }
}

#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SuiteFileError {
    #[error("read suite file: {problem}; docs/FAMILY.md describes its fields")]
    Json { problem: String },
    #[error("read suite file: {0}")]
    Value(InvalidField),
}

impl SuiteFile {
    pub fn from_json(text: &str) -> Result<Self, SuiteFileError> {
        let file: Self = serde_json::from_str(text).map_err(|error| SuiteFileError::Json {
            problem: JsonError::from(error).to_string(),
        })?;
        file.check().map_err(SuiteFileError::Value)?;
        Ok(file)
    }

    pub fn check(&self) -> Result<(), InvalidField> {
        check_name("name", &self.name)?;
        if let Some(folder) = &self.folder {
            check_path("folder", folder)?;
        }
        check_range("waits", self.waits, 0, MAX_WAITS)?;
        check_range("budget", self.budget, 1, MAX_BUDGET)?;
        let states = INIT_STATES_PER_TASK.into();
        check_range("trials", self.trials.into(), 1, states)?;
        let tasks = self.tasks().count();
        if !(1..=MAX_TASKS).contains(&tasks) {
            let remedy = format!("write 1 to {MAX_TASKS} tasks; divide larger files");
            return Err(invalid("suites", &format!("{tasks} tasks"), &remedy));
        }
        let mut names = BTreeSet::new();
        let mut tasks = Vec::new();
        for (index, suite) in self.suites.iter().enumerate() {
            let field = |name: &str| format!("suites[{index}].{name}");
            check_name(&field("name"), &suite.name)?;
            if !names.insert(&suite.name) {
                let remedy = "another suite has this name; choose another name";
                return Err(invalid(&field("name"), &quoted(&suite.name), remedy));
            }
            for (name, path) in [("bddl", &suite.bddl), ("states", &suite.states)] {
                check_path(&field(name), path)?;
                if !path.contains(NAME) && suite.tasks.len() > 1 {
                    let remedy = "write * in place of the task's name";
                    return Err(invalid(&field(name), &quoted(path), remedy));
                }
            }
            if let Some(budget) = suite.budget {
                check_range(&field("budget"), budget, 1, MAX_BUDGET)?;
            }
            for (task_index, task) in suite.tasks.iter().enumerate() {
                let field = |name: &str| field(&format!("tasks[{task_index}].{name}"));
                task.check(&field)?;
                let instruction = self.instruction(task);
                let budget = suite.budget.unwrap_or(self.budget);
                let conditions = (self.own_task(suite, task), instruction, budget);
                if tasks.contains(&conditions) {
                    let remedy = "an earlier task has the same files and conditions, and would \
                                  count twice; remove one";
                    return Err(invalid(&field("name"), &quoted(&task.name), remedy));
                }
                tasks.push(conditions);
            }
        }
        Ok(())
    }

    pub fn folder(&self) -> String {
        let default_folder = || format!("suites/{}", self.name);
        self.folder.clone().unwrap_or_else(default_folder)
    }

    /// Returns the SHA-256 of the file's content, hex, which does not depend on the formatting of
    /// the file or the number of trials.
    pub fn digest(&self) -> String {
        let content = Self { trials: 0, ..self.clone() };
        let text = serde_json::to_string(&content).expect("texts and numbers serialise");
        hex::encode(Sha256::digest(text.as_bytes()))
    }

    /// Returns the name of the protocol in results: the benchmark's name and the first digits of
    /// the file's digest, as in `libero_90@0123456789abcdef`. Results of two protocols are never
    /// pooled.
    pub fn protocol(&self) -> String {
        format!("{}@{}", self.name, &self.digest()[..DIGEST_DIGITS])
    }

    /// Returns the rows of all rollouts, by suite, task and trial. The instruction is empty if only
    /// the BDDL file has it.
    pub fn rows(&self) -> Vec<ManifestRow> {
        let protocol = self.protocol();
        let tasks = self.tasks().enumerate();
        let rows = tasks.flat_map(|(index, (suite, task))| {
            let index = u8::try_from(index).expect("a file has at most 256 tasks");
            let name = VariantName::own(&suite.name).expect("checked names are valid");
            let row = ManifestRow {
                instruction: self.instruction(task),
                max_steps: suite.budget.unwrap_or(self.budget),
                settle_steps: self.waits,
                protocol: Some(protocol.clone()),
                own: Some(Box::new(self.own_task(suite, task))),
                ..ManifestRow::new(
                    RolloutId::of_variant(TaskRef::own(index), name, 0),
                    0,
                    0,
                    Perturbation::default(),
                )
            };
            (0..self.trials).map(move |trial| ManifestRow {
                id: RolloutId::of_variant(TaskRef::own(index), name, trial),
                init_slot: trial,
                init_id: trial,
                ..row.clone()
            })
        });
        rows.collect()
    }

    /// Returns the rows of a design, whose tasks are those of this file and whose initial states are
    /// the first [`Self::trials`] of each task.
    pub fn perturbed(&self, design: Design) -> Result<Vec<ManifestRow>, DesignError> {
        let tasks = Self { trials: 1, ..self.clone() }.rows();
        design.expand_over(&tasks, self.trials)
    }

    /// Returns the row of an id. A simultaneous rollout perturbs the metric axes.
    pub fn row_of(&self, id: RolloutId) -> Result<ManifestRow, NoSuchRow> {
        let problem = |problem: String| NoSuchRow { id, problem };
        let rows = match (id.variant(), id.condition()) {
            (Some(_), _) => Self { trials: INIT_STATES_PER_TASK, ..self.clone() }.rows(),
            (None, condition) => {
                let of_id = condition.axes(AxisSet::EMPTY);
                let metric = AxisSet::from_iter(Axis::METRIC);
                let all = metric.axes().chain(of_id.without(metric).axes());
                let design = Design {
                    axes: all.filter(|_| id.config().is_some()).collect(),
                    subsets: if of_id.len() > 1 { vec![of_id] } else { Vec::new() },
                    levels: id.config().map_or_else(Vec::new, |_| vec![id.level()]),
                    configs: vec![id.config().unwrap_or_default()],
                    ..Design::v0_1()
                };
                let rows = self.perturbed(design);
                rows.map_err(|error| problem(error.to_string()))?
            }
        };
        let mut rows = rows.into_iter();
        let unknown = || problem("the file has no such task, suite or initial state".to_owned());
        rows.find(|row| row.id == id).ok_or_else(unknown)
    }

    fn tasks(&self) -> impl Iterator<Item = (&FileSuite, &FileTask)> {
        let suites = self.suites.iter();
        suites.flat_map(|suite| suite.tasks.iter().map(move |task| (suite, task)))
    }

    fn instruction(&self, task: &FileTask) -> String {
        match (&task.prompt, self.prompt) {
            (Some(prompt), _) => prompt.clone(),
            (None, SuitePrompt::Name) => instruction_of_name(&task.name),
            (None, SuitePrompt::Bddl) => String::new(),
        }
    }

    fn own_task(&self, suite: &FileSuite, task: &FileTask) -> OwnTask {
        OwnTask {
            folder: self.folder(),
            bddl: suite.bddl.replace(NAME, &task.name),
            states: suite.states.replace(NAME, &task.name),
            states_folder: None,
            sentence: None,
            start: self.start,
            seed: self.seed,
            changes: task.changes.clone(),
            suite: String::new(),
            instruction: String::new(),
        }
    }
}

impl FileTask {
    fn check(&self, field: &dyn Fn(&str) -> String) -> Result<(), InvalidField> {
        if self.name.contains(['/', '\\', NAME]) {
            let remedy = "write the name of its files, without folder and ending";
            return Err(invalid(&field("name"), &quoted(&self.name), remedy));
        }
        check_path(&field("name"), &self.name)?;
        if self.prompt.as_deref().is_some_and(|text| text.trim().is_empty()) {
            let remedy = "write a sentence, or leave the field out";
            return Err(invalid(&field("prompt"), "empty", remedy));
        }
        let prompt = self.prompt.as_deref().unwrap_or_default();
        if prompt.len() > MAX_PROMPT_BYTES || prompt.contains(char::is_control) {
            let remedy = format!("write at most {MAX_PROMPT_BYTES} bytes on one line");
            return Err(invalid(&field("prompt"), "too long or of several lines", &remedy));
        }
        self.changes.check(field)
    }
}

const fn all_states() -> u16 {
    INIT_STATES_PER_TASK
}

#[cfg(test)]
mod tests;
