//! A user's own task: a BDDL file and its initial states, in place of the task of a row. The row
//! supplies the suite that is sent to the policy, the seeds, the step budget and the perturbation.

use std::path::PathBuf;

use benchmark::{ManifestRow, RolloutId, Suite, TaskRef, row_of};
use scene::TaskFiles;

use super::error::SingleError;

/// A user's own task, and the rollout whose place it takes.
#[derive(Debug)]
pub struct OwnTask {
    pub bddl: PathBuf,
    pub init: PathBuf,
    /// Index of the initial state, from 0.
    pub init_id: u16,
    /// The policy's instruction; `None` for the instruction in the BDDL file.
    pub instruction: Option<String>,
    /// Step budget of the policy; `None` for the budget of the row's suite.
    pub max_steps: Option<u32>,
    /// Rollout whose place the task takes; `None` for a nominal rollout of `libero_10`, the suite
    /// with the largest budget.
    pub id: Option<RolloutId>,
}

impl OwnTask {
    pub fn files(&self) -> TaskFiles {
        TaskFiles { bddl: self.bddl.clone(), init: self.init.clone() }
    }

    /// Returns the manifest row of the task's rollout. The language axis is left out, because its
    /// paraphrases exist only for the protocol's instructions.
    pub fn row(&self) -> Result<ManifestRow, SingleError> {
        self.files().problem()?;
        let nominal = || {
            let task = TaskRef::new(Suite::Long, 0).expect("every suite has a task 0");
            RolloutId::nominal(task, 0)
        };
        let mut row = row_of(self.id.unwrap_or_else(nominal))?;
        row.init_id = self.init_id;
        row.init_slot = self.init_id;
        row.variant_id = None;
        row.instruction = match &self.instruction {
            Some(instruction) => instruction.clone(),
            None => self.files().instruction()?,
        };
        row.max_steps = self.max_steps.unwrap_or(row.max_steps);
        Ok(row)
    }
}
