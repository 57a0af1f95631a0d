//! Point estimates at a look, with strata weighted by their share of the population.

use std::collections::{BTreeMap, BTreeSet};

use libero_ctrl::{Level, Measure, Stop, Strata, Suite, TaskRef};

use crate::outcomes::Records;
use crate::sequential::campaign::CampaignLook;
use crate::sequential::measures::value;
use crate::sequential::order::Unit;

/// Number of units of a stratum, number of its drawn units with a known outcome, and sums of each
/// measure over these drawn units.
#[derive(Clone, Default)]
struct Stratum {
    units: f64,
    known: f64,
    sums: BTreeMap<Measure, f64>,
}

impl CampaignLook {
    /// Returns the estimate of each measure at each level: the mean over strata, weighted by
    /// their share of the population that the interval is about, and clamped to the interval.
    /// Strata are drawn in turn, so that small ones are over-represented: an unweighted mean
    /// would weight suites of 100 and of 30 configurations equally.
    ///
    /// A level is omitted while a stratum has no known outcome.
    pub fn estimates(
        &self,
        records: &Records,
        stop: &Stop,
    ) -> BTreeMap<Level, BTreeMap<Measure, f64>> {
        let used: BTreeSet<Unit> = self.used.iter().copied().collect();
        let mut levels: BTreeMap<Level, BTreeMap<(Suite, Option<TaskRef>), Stratum>> =
            BTreeMap::new();
        for matched in records.configurations() {
            let Some(look) = self.levels.get(&matched.level) else {
                continue;
            };
            if matched.replicate != 0 {
                continue;
            }
            let task = matched.task;
            let task_stratum = (stop.strata == Strata::Tasks).then_some(task);
            let strata = levels.entry(matched.level).or_default();
            let stratum = strata.entry((task.suite(), task_stratum)).or_default();
            stratum.units += 1.0;
            let known = matched.transition();
            if let Some(transition) = known.filter(|_| used.contains(&(task, matched.config))) {
                stratum.known += 1.0;
                for &measure in look.intervals.keys() {
                    *stratum.sums.entry(measure).or_default() += value(measure, transition) as f64;
                }
            }
        }
        let is_known =
            |strata: &BTreeMap<_, Stratum>| strata.values().all(|stratum| stratum.known > 0.0);
        levels.retain(|_, strata| is_known(strata));
        let level_estimates = |(level, strata): (Level, BTreeMap<_, Stratum>)| {
            let total: f64 = strata.values().map(|stratum| stratum.units).sum();
            let intervals = self.levels[&level].intervals.iter();
            let estimates = intervals.map(|(&measure, interval)| {
                let weighted_mean =
                    |stratum: &Stratum| stratum.units * stratum.sums[&measure] / stratum.known;
                let mean = strata.values().map(weighted_mean).sum::<f64>() / total;
                (measure, mean.clamp(interval.low(), interval.high()))
            });
            (level, estimates.collect())
        };
        levels.into_iter().map(level_estimates).collect()
    }
}
