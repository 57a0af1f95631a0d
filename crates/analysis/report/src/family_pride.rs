//! PRIDE, LIBERO-Para's score, of a campaign's rollouts.

use std::collections::BTreeMap;

use libero_ctrl::TaskRef;
use libero_family::para::{Distances, Paraphrased};
use paired::{Bootstrap, Interval, NoInterval, intervals_of_many};
use serde::Serialize;

/// Weights of the content words: 0.5 as in the released code, 0 for the structure alone, 1 for the
/// content words alone.
const ALPHAS: [f64; 3] = [0.5, 0.0, 1.0];

/// PRIDE with one weight of the content words.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Pride {
    /// Weight of the content words; the weight of the structure is 1 − `alpha`.
    pub alpha: f64,
    /// Successes, each weighted by the distance of its sentence from the task's instruction, per
    /// cent of the sum of all distances.
    pub percent: Option<f64>,
    /// 95 % interval of `percent`, by a bootstrap over tasks.
    pub interval: Option<Interval>,
    /// Reason why `interval` is withheld.
    pub no_interval: Option<NoInterval>,
}

impl Pride {
    /// Returns the score of the rollouts with each weight; empty without rollouts.
    pub(crate) fn all(rollouts: impl Iterator<Item = (TaskRef, Paraphrased)>) -> Vec<Self> {
        let mut by_task: BTreeMap<TaskRef, [Distances; ALPHAS.len()]> = BTreeMap::new();
        for (task, outcome) in rollouts {
            let sums = by_task.entry(task).or_default();
            for (sum, alpha) in sums.iter_mut().zip(ALPHAS) {
                sum.add(&outcome, alpha);
            }
        }
        if by_task.is_empty() {
            return Vec::new();
        }
        let tasks: Vec<_> = by_task.into_values().collect();
        let pride = |index: usize, draws: &dyn Fn(usize) -> f64| {
            let mut sum = Distances::default();
            for (task, sums) in tasks.iter().enumerate() {
                sum.reached += draws(task) * sums[index].reached;
                sum.total += draws(task) * sums[index].total;
            }
            sum.pride()
        };
        let bootstrap = Bootstrap::default();
        let intervals =
            intervals_of_many(&bootstrap, tasks.len(), ALPHAS.len(), |draws, values| {
                for (index, value) in values.iter_mut().enumerate() {
                    let drawn = pride(index, &|task| f64::from(draws[task]));
                    *value = drawn.unwrap_or_default();
                }
            });
        let lines = ALPHAS.into_iter().zip(intervals).enumerate();
        lines
            .map(|(index, (alpha, interval))| Self {
                alpha,
                percent: pride(index, &|_| 1.0),
                interval: interval.ok(),
                no_interval: interval.err(),
            })
            .collect()
    }

    /// Returns the name in tables.
    pub(crate) fn name(&self) -> String {
        let weight = match self.alpha {
            0.0 => ", structure alone",
            1.0 => ", content words alone",
            _ => "",
        };
        format!("α {}{weight}", self.alpha)
    }
}
