//! The two files that make a task: its BDDL problem and its initial states.

use std::path::PathBuf;

use libero_ctrl::TaskRef;

use crate::bddl::Problem;
use crate::error::SceneError;
use crate::sources::Sources;

/// Paths of a task's files.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct TaskFiles {
    /// The BDDL problem file.
    pub bddl: PathBuf,
    /// The `.pruned_init` file.
    pub init: PathBuf,
}

impl TaskFiles {
    /// The files of one of the 40 evaluation tasks.
    pub fn of_task(sources: &Sources, task: TaskRef) -> Self {
        let (suite, stem) = (task.suite().name(), task.name());
        Self {
            bddl: sources.bddl_file(suite, stem),
            init: sources.init_file(suite, stem),
        }
    }

    /// Reads the problem.
    pub fn problem(&self) -> Result<Problem, SceneError> {
        let what = "BDDL file";
        let text = std::fs::read_to_string(&self.bddl).map_err(|source| SceneError::Read {
            what: what.to_owned(),
            path: self.bddl.clone(),
            remedy: "run `cargo xtask setup`, or give the file's right name".to_owned(),
            source,
        })?;
        Problem::parse(&text).map_err(|error| SceneError::Malformed {
            what: what.to_owned(),
            path: self.bddl.clone(),
            problem: error.to_string(),
        })
    }
}
