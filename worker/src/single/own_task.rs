//! A user's own task: a BDDL file and its initial states, in place of the task of a row. The row
//! supplies the suite that is sent to the policy, the seeds, the step budget and the perturbation.

use std::fs;
use std::path::PathBuf;

use libero_ctrl::{ManifestRow, RolloutId, Suite, TaskRef, row_of};
use scene::TaskFiles;

use super::error::SingleError;

/// A user's own task, and the rollout whose place it takes.
#[derive(Debug)]
pub struct OwnTask {
    pub bddl: PathBuf,
    /// The `.pruned_init` file.
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
    /// Returns the paths of the task's files.
    pub fn files(&self) -> TaskFiles {
        TaskFiles { bddl: self.bddl.clone(), init: self.init.clone() }
    }

    /// Returns the manifest row of the task's rollout. The language axis is left out, because its
    /// paraphrases exist only for the protocol's instructions.
    ///
    /// # Errors
    /// If the protocol has no such rollout, the BDDL file is malformed, or no instruction is
    /// found.
    pub fn row(&self) -> Result<ManifestRow, SingleError> {
        self.files().problem()?;
        let nominal = || {
            let task = TaskRef::new(Suite::Long, 0).expect("every suite has a task 0");
            RolloutId::clean(task, 0)
        };
        let mut row = row_of(self.id.unwrap_or_else(nominal))?;
        row.init_id = self.init_id;
        row.init_slot = self.init_id;
        row.variant_id = None;
        row.instruction = match &self.instruction {
            Some(instruction) => instruction.clone(),
            None => self.instruction_of_the_file()?,
        };
        row.max_steps = self.max_steps.unwrap_or(row.max_steps);
        Ok(row)
    }

    fn instruction_of_the_file(&self) -> Result<String, SingleError> {
        // The file was read a moment ago; if it cannot be read now, it counts as having no
        // instruction.
        let text = fs::read_to_string(&self.bddl).unwrap_or_default();
        instruction_in(&text).ok_or_else(|| SingleError::NoInstruction { bddl: self.bddl.clone() })
    }
}

/// Extracts the words of `(:language …)`, converted to lower case as in the original LIBERO.
fn instruction_in(bddl: &str) -> Option<String> {
    let lines = bddl.lines();
    let code: Vec<&str> = lines.filter_map(|line| line.split(';').next()).collect();
    let code = code.join("\n").to_lowercase();
    let (_, rest) = code.split_once("(:language")?;
    let (words, _) = rest.split_once(')')?;
    let words: Vec<&str> = words.split_whitespace().collect();
    (!words.is_empty()).then(|| words.join(" "))
}

#[cfg(test)]
mod tests {
    use super::instruction_in;

    #[test]
    fn the_instruction_is_read_from_the_bddl_file() {
        let check = |text: &str, expected: Option<&str>| {
            assert_eq!(instruction_in(text).as_deref(), expected, "{text}");
        };
        check("(define\n  (:Language Turn on\n  the stove)\n)", Some("turn on the stove"));
        check("; (:language a comment)\n(:language put it there)", Some("put it there"));
        check("(:language )", None);
        check("(define (:goal (And (On a b))))", None);
    }
}
