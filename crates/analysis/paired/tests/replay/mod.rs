//! Published outcomes, replayed in random orders.

use libero_ctrl::{Level, Measure, RolloutId, StopRule, TaskRef};
use paired::{Look, Order, Outcome, Record, Records, SequentialMeasures, Transition};
use serde::Deserialize;

const OUTCOMES: &str = include_str!("../../../../../examples/openvla_oft/rollouts.jsonl");

/// Largest probability that any interval excludes the true value at any look.
pub(crate) const ALPHA: f64 = 0.05;

/// A configuration's task and number.
pub(crate) type Unit = (TaskRef, u16);

/// The configurations of one level, each with its transition under simultaneous perturbation.
pub(crate) struct Population {
    pub(crate) units: Vec<(Unit, Transition)>,
}

/// Design of a drawn order.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Design {
    /// Rounds with one configuration of every task.
    Tasks,
    /// Rounds with one configuration of every suite.
    Suites,
    /// All configurations in one random order.
    Simple,
}

#[derive(Deserialize)]
struct Row {
    rollout_id: RolloutId,
    init_id: u16,
    success: bool,
}

impl Population {
    /// Returns OpenVLA-OFT's published outcomes at a level.
    pub(crate) fn published(level: Level) -> Self {
        let rows = OUTCOMES.lines().map(|line| {
            let row: Row = serde_json::from_str(line).expect("a row");
            Record {
                id: row.rollout_id,
                init_id: row.init_id,
                replicate: 0,
                outcome: Outcome::from(row.success),
            }
        });
        let records = Records::new(&rows.collect::<Vec<_>>()).expect("no duplicates");
        let matched = records.configurations().iter();
        let units = matched.filter(|configuration| configuration.level == level).map(|matched| {
            let transition = matched.transition().expect("published outcomes are known");
            ((matched.task, matched.config), transition)
        });
        Self { units: units.collect() }
    }

    pub(crate) fn order(&self, seed: u64, design: Design) -> Order<Unit> {
        let units = self.units.iter().map(|(unit, _)| *unit);
        match design {
            Design::Tasks => Order::new(seed, units, |&(task, _)| task),
            Design::Suites => Order::new(seed, units, |(task, _)| task.suite()),
            Design::Simple => Order::new(seed, units, |_| ()),
        }
    }

    pub(crate) fn transition(&self, unit: &Unit) -> Transition {
        let position = self.units.binary_search_by(|(other, _)| other.cmp(unit));
        self.units[position.expect("a configuration")].1
    }

    /// Iterates over the values of a measure, one per configuration.
    pub(crate) fn values(&self, measure: Measure) -> impl Iterator<Item = i64> {
        self.units.iter().map(move |(_, transition)| value(measure, *transition))
    }

    /// Returns the total of a measure over all configurations.
    pub(crate) fn total(&self, measure: Measure) -> i64 {
        self.values(measure).sum()
    }

    /// Evaluates the intervals after every configuration of an order. Returns true if all intervals
    /// held at all looks, and the number of configurations after which each rule was first met.
    pub(crate) fn replay(
        &self,
        order: &Order<Unit>,
        rules: &[StopRule],
    ) -> (bool, Vec<Option<usize>>) {
        let truth = Measure::ALL.map(|measure| (measure, self.total(measure)));
        let holds = |look: &Look| {
            truth.iter().all(|(measure, total)| {
                let interval = look.intervals[measure];
                (interval.least..=interval.greatest).contains(total)
            })
        };
        let mut sequential = SequentialMeasures::new(order, ALPHA);
        let (mut held, mut met) = (true, vec![None; rules.len()]);
        for unit in order.units() {
            sequential.complete(&[self.transition(unit)]);
            let look = sequential.look();
            held &= holds(&look);
            for (met, rule) in met.iter_mut().zip(rules) {
                if met.is_none() && look.meets(rule) {
                    *met = Some(look.used);
                }
            }
        }
        (held, met)
    }
}

/// Returns one configuration's value of a measure.
pub(crate) fn value(measure: Measure, transition: Transition) -> i64 {
    use Transition::{Compensated, Emergent, StillFails, StillSucceeds};
    match (measure, transition) {
        (Measure::SSim, StillSucceeds | Compensated) => 1,
        (Measure::RE, Emergent) | (Measure::RC, Compensated) => 1,
        (Measure::RD, Emergent | Compensated) => 1,
        (Measure::I, Compensated) => 1,
        (Measure::I, Emergent) => -1,
        (_, StillSucceeds | StillFails | Emergent | Compensated) => 0,
    }
}
