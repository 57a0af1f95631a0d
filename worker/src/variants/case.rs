//! One rollout of a run: a variant of LIBERO-Plus, a task of LIBERO-PRO, or a task as LIBERO
//! has it, from one of its initial states.

use libero_ctrl::{ManifestRow, RolloutId, TaskRef, row_of};
use libero_family::corruption::Corruption;
use libero_family::plus::{Entry, start_posture};
use libero_family::pro::ProSuite;
use libero_family::protocol::{Beginning, Benchmark, Protocol};
use scene::{Sources, TaskFiles};
use sim::{Start, VariantStart};

use super::error::VariantsError;

/// What a rollout is of.
#[derive(Clone, Copy, Debug)]
pub enum Subject {
    /// A task as LIBERO has it.
    Unperturbed,
    /// A variant of LIBERO-Plus.
    Plus(&'static Entry),
    /// A task of LIBERO-PRO.
    Pro(ProSuite),
}

/// One rollout under a protocol.
#[derive(Clone, Copy, Debug)]
pub struct Case {
    /// What it is of.
    pub subject: Subject,
    /// LIBERO's task.
    pub task: TaskRef,
    /// Which trial, from 0: it begins at the initial state of this number.
    pub trial: u16,
}

impl Case {
    /// The unperturbed rollouts beside which cases stand: those of their tasks and trials.
    pub fn unperturbed(cases: &[Self]) -> Vec<Self> {
        let mut beside: Vec<_> = cases.iter().map(|case| (case.task, case.trial)).collect();
        beside.sort();
        beside.dedup();
        let unperturbed = beside.into_iter().map(|(task, trial)| Self {
            subject: Subject::Unperturbed,
            task,
            trial,
        });
        unperturbed.collect()
    }

    /// True if another case is of the same files.
    pub(super) fn files_are_of(&self, other: &Self) -> bool {
        let suite = |case: &Self| match case.subject {
            Subject::Pro(suite) => Some(suite),
            _ => None,
        };
        self.task == other.task && suite(self).is_some() && suite(self) == suite(other)
    }

    /// The benchmark; none of an unperturbed rollout.
    pub fn benchmark(&self) -> Option<Benchmark> {
        match self.subject {
            Subject::Unperturbed => None,
            Subject::Plus(_) => Some(Benchmark::Plus),
            Subject::Pro(_) => Some(Benchmark::Pro),
        }
    }

    /// Name in results and of its folder: the benchmark's, with the trial of those that have
    /// several.
    pub fn name(&self) -> String {
        let (task, trial) = (self.task.name(), self.trial);
        match self.subject {
            Subject::Plus(entry) => entry.variant.to_string(),
            Subject::Pro(suite) => format!("{suite}/{task}/e{trial:02}"),
            Subject::Unperturbed => format!("{}/{task}/e{trial:02}", self.task.suite()),
        }
    }

    /// Row of the tables that it counts in: a dimension of LIBERO-Plus or a suite of
    /// LIBERO-PRO; none of an unperturbed rollout.
    pub fn group(&self) -> Option<String> {
        match self.subject {
            Subject::Unperturbed => None,
            Subject::Plus(entry) => Some(entry.dimension().name().to_owned()),
            Subject::Pro(suite) => Some(suite.to_string()),
        }
    }

    /// Difficulty, 1 to 5, where one is given.
    pub fn difficulty(&self) -> Option<u8> {
        match self.subject {
            Subject::Plus(entry) => entry.difficulty,
            _ => None,
        }
    }

    /// Its task files.
    pub fn files(&self, sources: &Sources) -> TaskFiles {
        match self.subject {
            Subject::Unperturbed => TaskFiles::of_task(sources, self.task),
            Subject::Plus(entry) => TaskFiles::of_variant(sources, &entry.variant),
            Subject::Pro(suite) => TaskFiles::of_pro_task(sources, suite, self.task),
        }
    }

    /// The row of its rollout: the trial's initial state, the protocol's prompt, waits and
    /// budget.
    ///
    /// # Errors
    /// If its BDDL file cannot be read.
    pub fn row(
        &self,
        files: &TaskFiles,
        protocol: &Protocol,
    ) -> Result<ManifestRow, VariantsError> {
        let sentence = files.problem()?.language;
        let mut row = row_of(RolloutId::clean(self.task, self.trial))?;
        row.instruction = match self.subject {
            Subject::Plus(entry) => protocol.prompt.of(&entry.variant, &sentence),
            _ => protocol.prompt.of_task(self.task, &sentence),
        };
        row.settle_steps = protocol.waits;
        row.max_steps = protocol.budget(self.task.suite());
        Ok(row)
    }

    /// How it begins.
    pub fn start(&self, protocol: &Protocol) -> VariantStart {
        let variant = match self.subject {
            Subject::Plus(entry) => Some(entry.variant),
            _ => None,
        };
        VariantStart {
            view: variant.map(|variant| variant.view()),
            posture: variant.and_then(|it| it.robot()).and_then(start_posture),
            seed: protocol.seed,
            earlier_resets: u32::from(self.trial),
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
