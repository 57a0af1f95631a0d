//! Partial progress of rollouts, and its paired difference between two policies. Success is
//! the main measure; progress distinguishes policies in rollouts that both fail or both solve.

use std::collections::BTreeSet;

use benchmark::attempt::GoalProgress;
use benchmark::{Directions, RolloutId, TaskRef};
use serde::{Deserialize, Serialize};

use crate::inference::estimate::{Estimate, Scale};
use crate::inference::hypotheses::holm;
use crate::inference::sample::{Row, Sample};

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Progress {
    pub id: RolloutId,
    /// Number of the replicate, from 0.
    pub replicate: u32,
    /// Control steps until success or, without success, until the rollout ended; `None` if
    /// unknown.
    pub steps: Option<u32>,
    /// Predicates of the goal that held; `None` if unknown.
    pub goal: Option<GoalProgress>,
}

impl Progress {
    /// Returns the largest share of the goal's predicates that held together at any step; `None` if
    /// it is unknown or the goal has no predicates.
    pub fn goal_share(&self) -> Option<f64> {
        let goal = self.goal.filter(|goal| goal.predicates > 0)?;
        Some(f64::from(goal.at_most) / f64::from(goal.predicates))
    }
}

/// The progress of one rollout under both policies, A and B.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ProgressPair {
    pub(crate) task: TaskRef,
    /// Configuration, or initial state of a nominal rollout.
    pub(crate) number: u16,
    pub(crate) progress: [Progress; 2],
}

/// Differences in progress of two policies over the rollouts with an outcome for both.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ProgressDifference {
    /// Largest share of the goal's predicates that held together at any step.
    pub goal: Option<MeanDifference>,
    /// Control steps until success; a failure counts with the steps until its end, which is
    /// the step budget. Successes and failures are both included.
    pub steps: Option<MeanDifference>,
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct MeanDifference {
    /// Rollouts whose value is known for both policies.
    pub n: u64,
    pub tasks: u64,
    pub mean_a: f64,
    pub mean_b: f64,
    /// `mean_a` − `mean_b` with an interval for each target of inference.
    pub difference: Estimate,
    /// Two-sided p-value of the t test of the difference, for new tasks; absent without a
    /// standard error.
    pub p: Option<f64>,
    /// `p` after Holm's correction for the rows of the comparison.
    pub holm_p: Option<f64>,
}

/// Function that returns the compared value of a rollout; `None` if it is unknown.
type Value = fn(&Progress) -> Option<f64>;

impl ProgressDifference {
    /// Computes the differences of each set of pairs; `None` if no value is known for both
    /// policies. `directions` has one entry per set.
    pub(crate) fn of_each(
        sets: &[Vec<ProgressPair>],
        directions: &[Directions],
    ) -> Vec<Option<Self>> {
        let each = |value: Value, scale: Scale| {
            let sets = sets.iter().zip(directions);
            let each = sets
                .map(|(pairs, directions)| MeanDifference::new(pairs, *directions, scale, value));
            with_holm(each.collect())
        };
        let goals = each(Progress::goal_share, Scale::Difference);
        let steps = each(|progress| progress.steps.map(f64::from), Scale::Mean);
        let goals_and_steps = goals.into_iter().zip(steps);
        goals_and_steps
            .map(|(goal, steps)| {
                (goal.is_some() || steps.is_some()).then_some(Self { goal, steps })
            })
            .collect()
    }
}

impl MeanDifference {
    fn new(
        pairs: &[ProgressPair],
        directions: Directions,
        scale: Scale,
        value: Value,
    ) -> Option<Self> {
        let row = |pair: &ProgressPair| {
            let [a, b] = &pair.progress;
            Some(Row {
                task: pair.task,
                direction: pair.number,
                values: vec![1.0, value(a)?, value(b)?],
            })
        };
        let rows: Vec<Row> = pairs.iter().filter_map(row).collect();
        let sample = Sample::new(&rows, directions)?;
        let tasks: BTreeSet<TaskRef> = rows.iter().map(|row| row.task).collect();
        let difference = Estimate::of(&sample, scale, &|sums| (sums[1] - sums[2]) / sums[0])?;
        let mean = |column: usize| sample.sums()[column] / rows.len() as f64;
        Some(Self {
            n: rows.len() as u64,
            tasks: tasks.len() as u64,
            mean_a: mean(1),
            mean_b: mean(2),
            p: difference.p(),
            holm_p: None,
            difference,
        })
    }
}

/// Fills in Holm's p-values over the rows that have a p-value.
fn with_holm(mut each: Vec<Option<MeanDifference>>) -> Vec<Option<MeanDifference>> {
    let tested = each.iter_mut().flatten().filter(|mean| mean.p.is_some());
    let tested: Vec<&mut MeanDifference> = tested.collect();
    let p_values: Vec<f64> = tested.iter().filter_map(|mean| mean.p).collect();
    for (difference, p) in tested.into_iter().zip(holm(&p_values)) {
        difference.holm_p = Some(p);
    }
    each
}
