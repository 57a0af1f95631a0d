//! Names of tasks for the queue: LIBERO's task, and the benchmark whose own files a rollout needs.

use std::fmt;

use libero_ctrl::{ManifestRow, RolloutId, TaskRef};

use crate::case::{Case, Subject};
use crate::protocol::Benchmark;

/// A task with the benchmark whose task files it needs beside LIBERO's. Displays as
/// `libero_goal/8`, or as `libero_goal/8+libero-plus`. Workers name the keys that they cannot run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TaskKey {
    /// LIBERO's task.
    pub task: TaskRef,
    /// Benchmark whose task files are needed; `None` if LIBERO's suffice.
    pub files: Option<Benchmark>,
}

impl TaskKey {
    /// Returns the key of a rollout that is not of a suite file. The key of a variant that no
    /// benchmark has names no files, so that a worker gets the rollout and reports the error.
    fn of_rollout(id: RolloutId) -> Self {
        let files = match id.variant() {
            None => None,
            Some(_) => Case::of_id(id).ok().and_then(|case| own_files(&case)),
        };
        Self { task: id.task(), files }
    }

    /// Returns the text of a row's key. The key of a suite file's task has the file's name and
    /// digest, as in `own/17+libero_90@0123456789abcdef`, since two files may have the same name.
    pub fn of_row(row: &ManifestRow) -> String {
        match (&row.own, &row.protocol) {
            (Some(_), Some(protocol)) => format!("{}+{protocol}", row.id.task()),
            _ => Self::of_rollout(row.id).to_string(),
        }
    }

    pub fn of_task(task: TaskRef) -> impl Iterator<Item = Self> {
        let benchmarks = Benchmark::ALL.map(Some).into_iter();
        let files = [None].into_iter().chain(benchmarks);
        files.map(move |files| Self { task, files })
    }

    /// Returns for every task the key of the rollouts that need a benchmark's task files.
    pub fn needing(benchmark: Benchmark) -> impl Iterator<Item = Self> {
        TaskRef::all().map(move |task| Self { task, files: Some(benchmark) })
    }

    /// Returns the benchmark whose task files a key needs, from the key's text.
    pub fn files_of(text: &str) -> Option<Benchmark> {
        let (_, name) = text.split_once('+')?;
        let mut all = Benchmark::ALL.into_iter();
        all.find(|benchmark| benchmark.name() == name)
    }
}

impl fmt::Display for TaskKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.files {
            None => write!(f, "{}", self.task),
            Some(benchmark) => write!(f, "{}+{}", self.task, benchmark.name()),
        }
    }
}

/// Returns the benchmark whose task files a case needs.
fn own_files(case: &Case) -> Option<Benchmark> {
    match case.subject {
        Subject::Unperturbed | Subject::Own(_) => None,
        Subject::Pro(_) => Some(Benchmark::Pro),
        Subject::Para(_) => Some(Benchmark::Para),
        Subject::Plus(entry) => {
            let variant = &entry.variant;
            let has_own = variant.bddl_stem() != case.task.name() || variant.has_one_state();
            has_own.then_some(Benchmark::Plus)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_key_of_a_suite_file_names_the_file_and_its_digest() {
        let file = libero_ctrl::SuiteFile::from_json(
            r#"{"name": "drawers", "start": "reset", "prompt": "bddl", "seed": 0, "waits": 0,
                "budget": 9, "trials": 1, "suites": [{"name": "near", "bddl": "*.bddl",
                "states": "*.npz", "tasks": ["a", "b"]}]}"#,
        );
        let file = file.expect("a suite file");
        let keys: Vec<String> = file.rows().iter().map(TaskKey::of_row).collect();
        let protocol = file.protocol();
        assert_eq!(keys, [0, 1].map(|task| format!("own/{task}+{protocol}")));
        assert_eq!(TaskKey::files_of(&keys[0]), None);
    }

    #[test]
    fn a_key_names_the_benchmark_whose_files_a_rollout_needs() {
        for (id, expected) in [
            ("goal/t8/clean/i00", "libero_goal/8"),
            ("goal/t8/plus:unperturbed/i00", "libero_goal/8"),
            ("goal/t8/plus:noise_30/i00", "libero_goal/8"),
            ("goal/t8/plus:initstate_19/i00", "libero_goal/8"),
            ("goal/t8/plus:language_1/i00", "libero_goal/8+libero-plus"),
            ("goal/t8/plus:level1_sample1/i00", "libero_goal/8+libero-plus"),
            ("object/t0/plus:tb_18/i00", "libero_object/0+libero-plus"),
            ("goal/t8/pro:swap/i07", "libero_goal/8+libero-pro"),
            ("goal/t8/para:act_hint_1/i00", "libero_goal/8+libero-para"),
            ("goal/t8/para:unperturbed/i00", "libero_goal/8"),
        ] {
            let key = TaskKey::of_rollout(id.parse().expect("an id"));
            assert_eq!(key.to_string(), expected, "{id}");
            assert_eq!(TaskKey::files_of(expected), key.files);
            assert!(TaskKey::of_task(key.task).any(|other| other == key));
            if let Some(benchmark) = key.files {
                assert!(TaskKey::needing(benchmark).any(|other| other == key));
            }
        }
    }
}
