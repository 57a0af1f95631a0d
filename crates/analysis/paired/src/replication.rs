//! Comparison of a further replicate with the first: the same configurations and
//! realised perturbations with a different policy seed.

use std::collections::BTreeMap;

use libero_ctrl::{Condition, Level};
use serde::{Deserialize, Serialize};

use crate::bootstrap::{Bootstrap, Interval};
use crate::interval::{NoInterval, intervals};
use crate::measures::{Configuration, Tally};
use crate::outcomes::{Matched, Records, Transition};

/// Comparison of a replicate with replicate 0 over the rollouts that have an outcome in both.
/// Source: section 6 of the protocol.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Replication {
    /// The replicate that is compared with replicate 0.
    pub replicate: u32,
    /// Flips over all rollouts.
    pub flips: Flips,
    /// Flips over the rollouts of each condition.
    pub flips_by_condition: BTreeMap<Condition, Flips>,
    /// Changes of the measures, for each level with configurations complete in both
    /// replicates.
    pub changes: BTreeMap<Level, Change>,
}

/// Number of rollouts whose outcome differs between two policy seeds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Flips {
    /// Rollouts with an outcome in both replicates.
    pub compared: u64,
    /// Rollouts whose outcomes differ.
    pub flipped: u64,
}

impl Flips {
    /// Returns `flipped` / `compared`; `None` without a rollout.
    pub fn rate(&self) -> Option<f64> {
        (self.compared > 0).then(|| self.flipped as f64 / self.compared as f64)
    }

    fn add(&mut self, differ: bool) {
        self.compared += 1;
        self.flipped += u64::from(differ);
    }
}

/// Measures of a replicate minus those of replicate 0, over the configurations that are complete
/// in both replicates. The bootstrap resamples the two replicates of a task together.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Change {
    /// Configurations that are complete in both replicates.
    pub n: u64,
    /// Configurations with the same transition in both replicates.
    pub same_transition: u64,
    /// Configurations that are emergent or compensated in replicate 0.
    pub changed: u64,
    /// Configurations counted in `changed` that have the same transition in the later replicate.
    pub changed_again: u64,
    /// Change of `s_sim`.
    pub s_sim: f64,
    /// Change of `d`.
    pub d: f64,
    /// Interval of the change of `d`.
    pub d_ci95: Option<Interval>,
    /// Change of `i`.
    pub i: f64,
    /// Interval of the change of `i`.
    pub i_ci95: Option<Interval>,
    /// Change of `r_e`.
    pub r_e: f64,
    /// Interval of the change of `r_e`.
    pub r_e_ci95: Option<Interval>,
    /// Change of `r_c`.
    pub r_c: f64,
    /// Interval of the change of `r_c`.
    pub r_c_ci95: Option<Interval>,
    /// Change of `r_d`.
    pub r_d: f64,
    /// Interval of the change of `r_d`.
    pub r_d_ci95: Option<Interval>,
    /// Reason why intervals are absent; `None` if all are present.
    pub no_interval: Option<NoInterval>,
}

impl Replication {
    /// Compares a replicate with replicate 0.
    pub fn of(records: &Records, replicate: u32, bootstrap: &Bootstrap) -> Self {
        let mut flips = Flips::default();
        let mut by_condition: BTreeMap<Condition, Flips> = BTreeMap::new();
        for (&(number, id), outcome) in &records.outcomes {
            let first = records.outcome(0, id).success();
            if let (true, Some(later), Some(first)) =
                (number == replicate, outcome.success(), first)
            {
                flips.add(later != first);
                by_condition.entry(id.condition()).or_default().add(later != first);
            }
        }
        Self {
            replicate,
            flips,
            flips_by_condition: by_condition,
            changes: changes(records.configurations(), replicate, bootstrap),
        }
    }
}

fn changes(all: &[Matched], replicate: u32, bootstrap: &Bootstrap) -> BTreeMap<Level, Change> {
    let key = |matched: &Matched| (matched.level, matched.task, matched.config);
    let first = all.iter().filter(|matched| matched.replicate == 0);
    let first: BTreeMap<_, _> = first.map(|matched| (key(matched), matched)).collect();
    let mut pairs: BTreeMap<Level, [Vec<Configuration>; 2]> = BTreeMap::new();
    for matched in all.iter().filter(|matched| matched.replicate == replicate) {
        let first = first.get(&key(matched));
        let first = first.and_then(|first| first.configuration());
        if let (Some(first), Some(later)) = (first, matched.configuration()) {
            let [firsts, laters] = pairs.entry(matched.level).or_default();
            firsts.push(first);
            laters.push(later);
        }
    }
    let pairs = pairs.into_iter();
    pairs
        .map(|(level, [first, later])| (level, Change::between(&first, &later, bootstrap)))
        .collect()
}

impl Change {
    /// Compares the outcomes of the same configurations, in the same order, in replicate 0 and in
    /// a later one.
    fn between(first: &[Configuration], later: &[Configuration], bootstrap: &Bootstrap) -> Self {
        let axes: Vec<_> = first[0].alone.keys().copied().collect();
        let clusters = [first, later].map(|outcomes| Tally::of_tasks(outcomes, &axes));
        let changes = |draws: &[u32]| {
            let rates = |replicate: usize| {
                Tally::resampled(&clusters[replicate], draws).rates().measures_with_intervals()
            };
            let (first, later) = (rates(0), rates(1));
            std::array::from_fn::<f64, 5, _>(|i| later[i] - first[i])
        };
        let tasks = clusters[0].len();
        let once = vec![1; tasks];
        let [d, i, r_e, r_c, r_d] = changes(&once);
        let (shown, no_interval) = intervals(bootstrap, tasks, changes);
        let [d_ci95, i_ci95, r_e_ci95, r_c_ci95, r_d_ci95] = shown;
        let s_sim = |replicate: usize| Tally::resampled(&clusters[replicate], &once).rates().s_sim;
        let transition = |c: &Configuration| Transition::between(c.conjunction(), c.simultaneous);
        let (mut same, mut changed, mut again) = (0, 0, 0);
        for (first, later) in first.iter().zip(later) {
            let (first, later) = (transition(first), transition(later));
            let is_change = matches!(first, Transition::Emergent | Transition::Compensated);
            same += u64::from(first == later);
            changed += u64::from(is_change);
            again += u64::from(is_change && first == later);
        }
        Self {
            n: first.len() as u64,
            same_transition: same,
            changed,
            changed_again: again,
            s_sim: s_sim(1) - s_sim(0),
            d,
            d_ci95,
            i,
            i_ci95,
            r_e,
            r_e_ci95,
            r_c,
            r_c_ci95,
            r_d,
            r_d_ci95,
            no_interval,
        }
    }
}
