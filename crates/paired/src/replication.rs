//! Replicates: outcomes that another policy seed changes, and the components of variance between
//! tasks, between configurations of a task, and chance.

use std::collections::{BTreeMap, BTreeSet};

use benchmark::{Condition, Level, TaskRef};
use serde::{Deserialize, Serialize};

use crate::outcomes::{Matched, Records};

/// Number of rollouts whose outcome differs between two policy seeds. Source: section 6 of the
/// protocol.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Flips {
    /// Rollouts with an outcome in a further replicate and in the first.
    pub compared: u64,
    /// Rollouts whose outcomes differ.
    pub flipped: u64,
}

impl Flips {
    /// Returns `flipped` / `compared`; `None` without a rollout.
    pub fn rate(&self) -> Option<f64> {
        (self.compared > 0).then(|| self.flipped as f64 / self.compared as f64)
    }
}

/// Compares every further replicate with the first, by condition.
pub(crate) fn flips(records: &Records) -> BTreeMap<Condition, Flips> {
    let mut flips: BTreeMap<Condition, Flips> = BTreeMap::new();
    for (&(replicate, id), outcome) in &records.outcomes {
        let pair = (outcome.success(), records.outcome(0, id).success());
        if let (1.., (Some(later), Some(first))) = (replicate, pair) {
            let of_condition = flips.entry(id.condition()).or_default();
            of_condition.compared += 1;
            of_condition.flipped += u64::from(later != first);
        }
    }
    flips
}

/// Components of the variance of simultaneous success at one level, all replicates pooled.
/// Variances are of outcomes, 0 or 1; standard errors are of the success rate for new
/// tasks.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Components {
    pub level: Level,
    /// Number of replicates; every counted configuration has an outcome in each.
    pub replicates: u64,
    /// Counted configurations.
    pub n: u64,
    /// Variance between tasks.
    pub tasks: f64,
    /// Variance between configurations of a task.
    pub configurations: f64,
    /// Variance between replicates of a configuration: chance.
    pub replicate: f64,
    /// Design effect: variance of the rate, relative to the variance of as many independent
    /// outcomes; absent if all outcomes are equal.
    pub design_effect: Option<f64>,
    pub standard_error: f64,
}

impl Components {
    /// Computes the components of each level with at least two replicates, two tasks, and a
    /// task with two configurations.
    ///
    /// Nested analysis of variance: σ²_e = MS_e, σ²_c = (MS_c − MS_e)/k and
    /// σ²_t = (MS_t − MS_c)/(k·m), clamped at 0, for T tasks, on average m configurations per
    /// task and k replicates, with MS_t, MS_c and MS_e the mean squares between tasks, between
    /// configurations of a task and between replicates of a configuration. The variance of the
    /// rate is σ²_t/T + σ²_c/(T·m) + σ²_e/(T·m·k).
    ///
    /// Source: S. R. Searle, G. Casella and C. E. McCulloch, Variance Components (1992),
    /// section 3.5.
    pub(crate) fn of_each(matched: &[Matched]) -> Vec<Self> {
        let replicates: BTreeSet<u32> =
            matched.iter().map(|configuration| configuration.replicate).collect();
        let mut levels: BTreeMap<Level, BTreeMap<(TaskRef, u16), Vec<f64>>> = BTreeMap::new();
        for matched in matched {
            if let Some(success) = matched.simultaneous.success() {
                let configurations = levels.entry(matched.level).or_default();
                let outcomes = configurations.entry((matched.task, matched.config)).or_default();
                outcomes.push(f64::from(u8::from(success)));
            }
        }
        let components = |(level, configurations): (Level, BTreeMap<(TaskRef, u16), Vec<f64>>)| {
            let complete = configurations.into_iter();
            let complete = complete.filter(|(_, outcomes)| outcomes.len() == replicates.len());
            Self::new(level, replicates.len(), complete)
        };
        levels.into_iter().filter_map(components).collect()
    }

    /// Computes the components of one level from configurations with an outcome in every
    /// replicate.
    fn new(
        level: Level,
        replicates: usize,
        configurations: impl Iterator<Item = ((TaskRef, u16), Vec<f64>)>,
    ) -> Option<Self> {
        let mut tasks: BTreeMap<TaskRef, Vec<f64>> = BTreeMap::new();
        let k = replicates as f64;
        let mut within = 0.0;
        for ((task, _), outcomes) in configurations {
            let mean = outcomes.iter().sum::<f64>() / k;
            within += outcomes.iter().map(|y| (y - mean).powi(2)).sum::<f64>();
            tasks.entry(task).or_default().push(mean);
        }
        let n = tasks.values().map(Vec::len).sum::<usize>() as f64;
        let t = tasks.len() as f64;
        if replicates < 2 || t < 2.0 || n <= t {
            return None;
        }
        let mean = tasks.values().flatten().sum::<f64>() / n;
        let (mut between_tasks, mut between_configurations) = (0.0, 0.0);
        for means in tasks.values() {
            let task_mean = means.iter().sum::<f64>() / means.len() as f64;
            between_tasks += means.len() as f64 * (task_mean - mean).powi(2);
            between_configurations +=
                means.iter().map(|mean| (mean - task_mean).powi(2)).sum::<f64>();
        }
        let m = n / t;
        let chance = within / (n * (k - 1.0));
        let ms_configurations = k * between_configurations / (n - t);
        let ms_tasks = k * between_tasks / (t - 1.0);
        let configurations = ((ms_configurations - chance) / k).max(0.0);
        let tasks = ((ms_tasks - ms_configurations) / (k * m)).max(0.0);
        let variance = (tasks + (configurations + chance / k) / m) / t;
        let independent = mean * (1.0 - mean) / (n * k);
        Some(Self {
            level,
            replicates: replicates as u64,
            n: n as u64,
            tasks,
            configurations,
            replicate: chance,
            design_effect: (independent > 0.0).then(|| variance / independent),
            standard_error: variance.sqrt(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn variance_only_between_replicates_is_attributed_to_chance() {
        let components = |outcomes: [[f64; 2]; 4]| {
            let keys = TaskRef::all().take(2).flat_map(|task| [(task, 0), (task, 1)]);
            let configurations = keys.zip(outcomes).map(|(key, outcomes)| (key, outcomes.to_vec()));
            Components::new(Level::L2, 2, configurations).expect("two tasks and replicates")
        };
        let chance = components([[0.0, 1.0], [1.0, 0.0], [0.0, 1.0], [1.0, 0.0]]);
        assert_eq!((chance.tasks, chance.configurations, chance.replicate), (0.0, 0.0, 0.5));
        // A variance of 0.5 over eight outcomes.
        assert!((chance.standard_error.powi(2) - 0.5 / 8.0).abs() < 1e-12);
        let tasks = components([[0.0, 0.0], [0.0, 0.0], [1.0, 1.0], [1.0, 1.0]]);
        assert_eq!((tasks.tasks, tasks.configurations, tasks.replicate), (0.5, 0.0, 0.0));
    }
}
