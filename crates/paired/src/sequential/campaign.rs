//! Interim looks at a campaign that may end early: its confidence sequences by level.

use std::collections::{BTreeMap, BTreeSet};

use benchmark::{Level, Measure, RolloutId, Stop, Strata, Suite, TaskRef};

use crate::outcomes::{Matched, Record, Records, Transition};
use crate::sequential::measures::{Look, SequentialMeasures, value};
use crate::sequential::order::{Order, Unit};

/// Largest probability that any interval of a level excludes the true value at any look.
pub const SEQUENTIAL_ALPHA: f64 = 0.05;

/// A look at a campaign that may end early. All levels rest on the same
/// configurations: the drawn order up to the first incomplete one.
///
/// A configuration is complete when all its rollouts have ended, at all levels and under
/// all conditions, including its nominal rollout if the campaign runs one. Rollouts that no
/// interval uses, such as those under latency, must have ended because other figures use them.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CampaignLook {
    /// Configurations that the look rests on, in the drawn order.
    pub used: Vec<Unit>,
    pub units: usize,
    pub levels: BTreeMap<Level, Look>,
}

pub fn drawn_order(stop: &Stop, units: impl IntoIterator<Item = Unit>) -> Order<Unit> {
    match stop.strata {
        Strata::Suites => Order::new(stop.seed, units, |(task, _)| task.suite()),
        Strata::Tasks => Order::new(stop.seed, units, |(task, _)| *task),
    }
}

impl CampaignLook {
    /// Returns the look at the current outcomes; `None` if the campaign has no configuration at a
    /// level other than L0.
    pub fn now(records: &Records, stop: &Stop) -> Option<Self> {
        Walk::begin(records, stop).map(|mut walk| {
            while walk.step() {}
            walk.look
        })
    }

    /// Returns the first look at which the rule holds at every level; `None` if the rule does not
    /// hold before the last configuration. Outcomes beyond this look in the drawn order do not
    /// affect the result.
    pub fn when_met(records: &Records, stop: &Stop) -> Option<Self> {
        let mut walk = Walk::begin(records, stop)?;
        while walk.step() {
            let mut looks = walk.look.levels.values();
            if looks.all(|look| look.meets(&stop.rule)) {
                return (walk.look.used.len() < walk.look.units).then_some(walk.look);
            }
        }
        None
    }

    /// Returns the records that count in a campaign that stopped early: those of the configurations
    /// that its last look rests on, with their nominal rollouts. All other records would bias
    /// figures, because a rollout that has finished tends to be short, and duration depends on the
    /// outcome. `None` if [`Self::when_met`] returns `None` or a record occurs twice.
    pub fn counted_when_met(records: &[Record], stop: &Stop) -> Option<Vec<Record>> {
        let matched = Records::new(records).ok()?;
        Some(Self::when_met(&matched, stop)?.counted(records))
    }

    fn counted(&self, records: &[Record]) -> Vec<Record> {
        let used: BTreeSet<Unit> = self.used.iter().copied().collect();
        let is_used = |record: &Record| unit(record.id).is_some_and(|unit| used.contains(&unit));
        let used_records = records.iter().filter(|record| is_used(record));
        let states: BTreeSet<RolloutId> = used_records.map(nominal).collect();
        let is_counted = |record: &&Record| is_used(record) || states.contains(&record.id);
        records.iter().filter(is_counted).copied().collect()
    }
}

fn unit(id: RolloutId) -> Option<Unit> {
    Some((id.task(), id.config()?))
}

fn nominal(record: &Record) -> RolloutId {
    RolloutId::nominal(record.id.task(), record.init_id)
}

/// Replay of the drawn order that adds one configuration per step.
struct Walk<'a> {
    order: Vec<Unit>,
    configurations: BTreeMap<(Level, Unit), &'a Matched>,
    /// Configurations with a rollout that has not ended.
    open: BTreeSet<Unit>,
    sequences: BTreeMap<Level, SequentialMeasures>,
    look: CampaignLook,
}

impl<'a> Walk<'a> {
    /// Starts the walk before the first configuration.
    fn begin(records: &'a Records, stop: &Stop) -> Option<Self> {
        let first_replicate = records.configurations().iter();
        let first_replicate = first_replicate.filter(|matched| matched.replicate == 0);
        let configurations: BTreeMap<(Level, Unit), &Matched> = first_replicate
            .map(|matched| ((matched.level, (matched.task, matched.config)), matched))
            .collect();
        let units: BTreeSet<Unit> = configurations.keys().map(|(_, unit)| *unit).collect();
        if units.is_empty() {
            return None;
        }
        // The placebo level only serves as the noise floor and may have few configurations.
        let levels = configurations.keys().map(|(level, _)| *level);
        let levels: BTreeSet<Level> = levels.filter(|level| *level != Level::L0).collect();
        if levels.is_empty() {
            return None;
        }
        let order = drawn_order(stop, units);
        let open = configurations.iter().filter(|(_, matched)| records.is_open(matched));
        let open = open.map(|((_, unit), _)| *unit).collect();
        let sequence = |level| (level, SequentialMeasures::new(&order, SEQUENTIAL_ALPHA));
        let sequences: BTreeMap<_, _> = levels.into_iter().map(sequence).collect();
        Some(Self {
            look: CampaignLook {
                used: Vec::new(),
                units: order.units().count(),
                levels: looks(&sequences),
            },
            order: order.units().copied().collect(),
            configurations,
            open,
            sequences,
        })
    }

    /// Adds the next configuration. Returns false if no configuration is left or the next one is
    /// incomplete.
    fn step(&mut self) -> bool {
        let Some(&unit) = self.order.get(self.look.used.len()) else {
            return false;
        };
        if self.open.contains(&unit) {
            return false;
        }
        let transitions = |level: &Level| -> Option<Vec<Transition>> {
            let matched = self.configurations.get(&(*level, unit))?;
            matched.possible_transitions()
        };
        let possible: Option<Vec<_>> = self.sequences.keys().map(transitions).collect();
        let Some(possible) = possible else {
            return false;
        };
        for (sequence, possible) in self.sequences.values_mut().zip(possible) {
            sequence.complete(&possible);
        }
        self.look.used.push(unit);
        self.look.levels = looks(&self.sequences);
        true
    }
}

fn looks(sequences: &BTreeMap<Level, SequentialMeasures>) -> BTreeMap<Level, Look> {
    let looks = sequences.iter();
    looks.map(|(&level, sequences)| (level, sequences.look())).collect()
}

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
