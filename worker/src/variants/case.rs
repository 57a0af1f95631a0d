//! One rollout of a run: a variant, or a task unperturbed.

use libero_ctrl::{ManifestRow, RolloutId, TaskRef, row_of};
use libero_family::corruption::Corruption;
use libero_family::plus::{Entry, start_posture};
use libero_family::protocol::{Beginning, Protocol};
use scene::{Sources, TaskFiles};
use sim::{Start, VariantStart};

use super::error::VariantsError;

/// One rollout under a protocol: a variant, or a task unperturbed.
pub struct Case {
    /// The variant; none: the task as LIBERO has it.
    pub entry: Option<&'static Entry>,
    /// LIBERO's task.
    pub task: TaskRef,
}

impl Case {
    /// The variants of an audit that can run, after the unperturbed rollouts of their tasks.
    pub fn of(runnable: &[&'static Entry]) -> Vec<Self> {
        let mut tasks: Vec<TaskRef> = runnable.iter().map(|entry| entry.variant.task).collect();
        tasks.sort();
        tasks.dedup();
        let nominal = tasks.into_iter().map(|task| Self { entry: None, task });
        let variants = runnable.iter().map(|entry| Self {
            entry: Some(entry),
            task: entry.variant.task,
        });
        nominal.chain(variants).collect()
    }

    /// Name in results and of its folder: the benchmark's.
    pub fn name(&self) -> String {
        match self.entry {
            Some(entry) => entry.variant.to_string(),
            None => self.task.name().to_owned(),
        }
    }

    /// Its task files.
    pub fn files(&self, sources: &Sources) -> TaskFiles {
        match self.entry {
            Some(entry) => TaskFiles::of_variant(sources, &entry.variant),
            None => TaskFiles::of_task(sources, self.task),
        }
    }

    /// The row of its rollout: initial state 0, the protocol's prompt, waits and budget.
    ///
    /// # Errors
    /// If its BDDL file cannot be read.
    pub fn row(
        &self,
        files: &TaskFiles,
        protocol: &Protocol,
    ) -> Result<ManifestRow, VariantsError> {
        let sentence = files.problem()?.language;
        let mut row = row_of(RolloutId::clean(self.task, 0))?;
        row.instruction = match self.entry {
            Some(entry) => protocol.prompt.of(&entry.variant, &sentence),
            None => protocol.prompt.of_task(self.task, &sentence),
        };
        row.settle_steps = protocol.waits;
        row.max_steps = protocol.budget(self.task.suite());
        Ok(row)
    }

    /// How it begins.
    pub fn start(&self, protocol: &Protocol) -> VariantStart {
        let variant = self.entry.map(|entry| entry.variant);
        VariantStart {
            view: variant.map(|variant| variant.view()),
            posture: variant.and_then(|it| it.robot()).and_then(start_posture),
            seed: protocol.seed,
            start: match protocol.beginning {
                Beginning::InitialState => Start::InitialState,
                Beginning::Reset => Start::Reset,
            },
            corruption: variant
                .and_then(|it| it.corruption())
                .and_then(Corruption::new),
        }
    }
}
