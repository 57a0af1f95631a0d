//! Names of tasks for the queue: LIBERO's task, and the benchmark whose own files a rollout needs.

use std::fmt;

use crate::benchmark::Benchmark;
use crate::row::ManifestRow;
use crate::suite::{Suite, TaskRef};

/// Beginning of the keys of other simulators' tasks.
const SIMULATED: &str = "simulated/";

/// A task with the benchmark whose task files it needs beside LIBERO's. Displays as
/// `libero_goal/8`, or as `libero_goal/8+libero-plus`. Workers name the keys that they cannot run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TaskKey {
    pub task: TaskRef,
    /// Benchmark whose task files are needed; `None` if LIBERO's suffice.
    pub files: Option<Benchmark>,
}

impl TaskKey {
    /// Returns the text of a row's key. The key of a suite file's task has the file's name and
    /// digest, as in `own/17+libero_90@0123456789abcdef`, since two files may have the same name;
    /// that of another simulator's task its names, as in `simulated/metaworld/reach-v3`.
    pub fn of_row(row: &ManifestRow) -> String {
        let task = row.id.task();
        match (&row.simulator, task.suite(), &row.protocol) {
            (Some(simulated), ..) => format!("{SIMULATED}{}/{}", simulated.name, simulated.task),
            (None, Suite::Own, Some(protocol)) => format!("{task}+{protocol}"),
            _ => Self { task, files: row.files }.to_string(),
        }
    }

    /// Returns the name of the simulator that the rollouts of a key need; `None` if they run in
    /// LIBERO.
    pub fn simulator_of(text: &str) -> Option<&str> {
        let (name, _) = text.strip_prefix(SIMULATED)?.split_once('/')?;
        Some(name)
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
        let (_, name) = text.split_once('+').filter(|_| Self::simulator_of(text).is_none())?;
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_key_of_a_suite_file_names_the_file_and_its_digest() {
        let file = crate::SuiteFile::from_json(
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
}
