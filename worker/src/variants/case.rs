//! One rollout of a run: a variant of LIBERO-Plus, a task of LIBERO-PRO, or an unmodified task of
//! LIBERO, from one of its initial states.

use libero_ctrl::{ManifestRow, RolloutId, TaskRef, row_of};
use libero_family::corruption::Corruption;
use libero_family::plus::{Entry, start_posture};
use libero_family::pro::ProSuite;
use libero_family::protocol::{Beginning, Benchmark, Protocol};
use scene::{Sources, TaskFiles};
use sim::{Start, VariantStart};

use super::error::VariantsError;

/// Origin of a rollout's task.
#[derive(Clone, Copy, Debug)]
pub enum Subject {
    /// An unmodified task of LIBERO.
    Unperturbed,
    /// A variant of LIBERO-Plus.
    Plus(&'static Entry),
    /// A task of LIBERO-PRO.
    Pro(ProSuite),
}

/// One rollout under a protocol.
#[derive(Clone, Copy, Debug)]
pub struct Case {
    /// Origin of the task.
    pub subject: Subject,
    /// LIBERO's task.
    pub task: TaskRef,
    /// Number of the trial, from 0, which is also the index of its initial state.
    pub trial: u16,
}

impl Case {
    /// Returns the unperturbed rollouts of the cases' tasks and trials, to compare with.
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

    /// Returns true if another case is of the same LIBERO-PRO suite and task, and so has the same
    /// files.
    pub(super) fn files_are_of(&self, other: &Self) -> bool {
        let suite = |case: &Self| match case.subject {
            Subject::Pro(suite) => Some(suite),
            _ => None,
        };
        self.task == other.task && suite(self).is_some() && suite(self) == suite(other)
    }

    /// Returns the benchmark; `None` for an unperturbed rollout.
    pub fn benchmark(&self) -> Option<Benchmark> {
        match self.subject {
            Subject::Unperturbed => None,
            Subject::Plus(_) => Some(Benchmark::Plus),
            Subject::Pro(_) => Some(Benchmark::Pro),
        }
    }

    /// Returns the name used in results and for the output folder: the benchmark's own, with the
    /// trial's number if there are several.
    pub fn name(&self) -> String {
        let (task, trial) = (self.task.name(), self.trial);
        match self.subject {
            Subject::Plus(entry) => entry.variant.to_string(),
            Subject::Pro(suite) => format!("{suite}/{task}/e{trial:02}"),
            Subject::Unperturbed => format!("{}/{task}/e{trial:02}", self.task.suite()),
        }
    }

    /// Returns the row of the result tables in which the case counts: a dimension of LIBERO-Plus
    /// or a suite of LIBERO-PRO; `None` for an unperturbed rollout.
    pub fn group(&self) -> Option<String> {
        match self.subject {
            Subject::Unperturbed => None,
            Subject::Plus(entry) => Some(entry.dimension().name().to_owned()),
            Subject::Pro(suite) => Some(suite.to_string()),
        }
    }

    /// Returns the difficulty, 1 to 5, if LIBERO-Plus gives one.
    pub fn difficulty(&self) -> Option<u8> {
        match self.subject {
            Subject::Plus(entry) => entry.difficulty,
            _ => None,
        }
    }

    /// Returns the task's files.
    pub fn files(&self, sources: &Sources) -> TaskFiles {
        match self.subject {
            Subject::Unperturbed => TaskFiles::of_task(sources, self.task),
            Subject::Plus(entry) => TaskFiles::of_variant(sources, &entry.variant),
            Subject::Pro(suite) => TaskFiles::of_pro_task(sources, suite, self.task),
        }
    }

    /// Returns the manifest row of the rollout, with the trial's initial state and the protocol's
    /// prompt, waits and step budget.
    ///
    /// # Errors
    /// If the BDDL file cannot be read.
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

    /// Returns the initial conditions of the rollout.
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
