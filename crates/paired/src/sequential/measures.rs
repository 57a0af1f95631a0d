//! Confidence sequences of one policy's measures, and looks (interim analyses) at them.

use std::collections::BTreeMap;

use benchmark::{Clause, Measure, StopRule};
use serde::{Deserialize, Serialize};

use crate::outcomes::Transition;
use crate::sequential::e_process::ConfidenceSequence;
use crate::sequential::order::Order;

/// An interval of a rate or a difference of rates over a finite population. Its ends are
/// whole numbers of units and therefore exact.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct RateInterval {
    /// Least total over the population that is not ruled out.
    pub least: i64,
    /// Greatest total over the population that is not ruled out.
    pub greatest: i64,
    /// Units of the population.
    pub units: u64,
}

impl RateInterval {
    /// Returns the lower end, a fraction.
    pub fn low(&self) -> f64 {
        self.least as f64 / self.units as f64
    }

    /// Returns the upper end, a fraction.
    pub fn high(&self) -> f64 {
        self.greatest as f64 / self.units as f64
    }

    /// Returns upper end − lower end, a fraction; 0 once the value is known exactly.
    pub fn width(&self) -> f64 {
        (self.greatest - self.least) as f64 / self.units as f64
    }

    /// Returns true if a value is outside; the ends are inside.
    pub fn excludes(&self, value: f64) -> bool {
        value < self.low() || self.high() < value
    }
}

/// Intervals after a number of units. All of them hold simultaneously, at all looks, with a
/// probability of at least 1 − α.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Look {
    /// Number of units that the intervals rest on: the first in the drawn order.
    pub used: usize,
    /// Units of the population.
    pub units: usize,
    pub intervals: BTreeMap<Measure, RateInterval>,
}

impl Look {
    /// Returns true if all clauses of a rule hold.
    pub fn meets(&self, rule: &StopRule) -> bool {
        rule.clauses().iter().all(|clause| self.holds(clause))
    }

    fn holds(&self, clause: &Clause) -> bool {
        let interval = self.intervals.get(&clause.measure());
        interval.is_some_and(|interval| match *clause {
            Clause::Width(_, width) => interval.width() < width,
            Clause::Excludes(_, value) => interval.excludes(value),
        })
    }
}

/// Confidence sequences of `S_sim`, `R_e`, `R_c`, `R_d` and `I` over the configurations of one level.
///
/// Configurations are added in the drawn order. A successful rollout ends sooner than a rollout that
/// runs out of steps, so that the configurations that happen to be complete are biased towards
/// success.
#[derive(Clone, Debug)]
pub struct SequentialMeasures {
    /// The stratum of each unit of the order, and whether the unit is the last of its round.
    order: Vec<(usize, bool)>,
    used: usize,
    sequences: BTreeMap<Measure, ConfidenceSequence>,
}

impl SequentialMeasures {
    /// Creates the sequences before the first configuration. The five intervals hold
    /// simultaneously, at all looks, with a probability of at least 1 − `alpha`, which they share
    /// equally (Bonferroni); the protocol's `alpha` is 0.05.
    ///
    /// # Panics
    /// If `alpha` is not between 0 and 1, or the order has no unit.
    pub fn new<U: Ord>(order: &Order<U>, alpha: f64) -> Self {
        assert!(alpha > 0.0 && alpha < 1.0, "α is between 0 and 1");
        assert!(!order.sizes().is_empty(), "the order has units");
        let alpha = alpha / Measure::ALL.len() as f64;
        let sequence = |measure| {
            let range = values(measure, &Transition::ALL);
            (measure, ConfidenceSequence::new(order.sizes(), range, alpha))
        };
        let rounds = order.rounds().iter();
        let drawn = rounds.flat_map(|round| {
            let last = round.len() - 1;
            round.iter().enumerate().map(move |(i, drawn)| (drawn.stratum, i == last))
        });
        Self {
            order: drawn.collect(),
            used: 0,
            sequences: Measure::ALL.into_iter().map(sequence).collect(),
        }
    }

    /// Adds the next configuration of the order with its possible transitions: exactly one, or
    /// several if a rollout is quarantined and its outcome will never be known
    /// ([`Matched::possible_transitions`]). The intervals are then valid for each of them.
    ///
    /// # Panics
    /// If no transition is possible, or no configuration is left.
    ///
    /// [`Matched::possible_transitions`]: crate::Matched::possible_transitions
    pub fn complete(&mut self, possible: &[Transition]) {
        let (stratum, ends_round) = self.order[self.used];
        self.used += 1;
        for (&measure, sequence) in &mut self.sequences {
            sequence.draw(stratum, values(measure, possible));
            if ends_round {
                sequence.end_round();
            }
        }
    }

    /// Returns the current intervals.
    pub fn look(&self) -> Look {
        let units = self.order.len();
        let interval = |sequence: &ConfidenceSequence| {
            let [least, greatest] = sequence.totals();
            RateInterval { least, greatest, units: units as u64 }
        };
        let sequences = self.sequences.iter();
        Look {
            used: self.used,
            units,
            intervals: sequences
                .map(|(&measure, sequence)| (measure, interval(sequence)))
                .collect(),
        }
    }
}

/// Returns the value of a measure for one configuration; the measure is the mean of the values.
pub(crate) fn value(measure: Measure, transition: Transition) -> i64 {
    let indicator = |other: Transition| i64::from(transition == other);
    let [emergent, compensated] = [Transition::Emergent, Transition::Compensated].map(indicator);
    match measure {
        Measure::SSim => indicator(Transition::StillSucceeds) + compensated,
        Measure::RE => emergent,
        Measure::RC => compensated,
        Measure::RD => emergent + compensated,
        Measure::I => compensated - emergent,
    }
}

pub(crate) fn values(measure: Measure, transitions: &[Transition]) -> [i64; 2] {
    let values = || {
        let transitions = transitions.iter();
        transitions.map(|&transition| value(measure, transition))
    };
    let ends = values().min().zip(values().max());
    let (least, greatest) = ends.expect("some transition is possible");
    [least, greatest]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rule(text: &str) -> StopRule {
        text.parse().expect(text)
    }

    /// Creates a look with intervals over a population of 400 units.
    fn look(intervals: &[(Measure, [i64; 2])]) -> Look {
        let interval = |&(measure, [least, greatest]): &(Measure, [i64; 2])| {
            let interval = RateInterval { least, greatest, units: 400 };
            (measure, interval)
        };
        Look { used: 200, units: 400, intervals: intervals.iter().map(interval).collect() }
    }

    #[test]
    fn a_width_is_compared_without_rounding() {
        // 32 of 400 is 0.08; in floating point, 0.12 − 0.04 is less than 0.08.
        let look = |greatest| look(&[(Measure::I, [16, greatest])]);
        assert!(!look(48).meets(&rule("width(I) < 0.08")));
        assert!(look(47).meets(&rule("width(I) < 0.08")));
    }

    #[test]
    fn the_ends_of_an_interval_are_not_excluded() {
        let look = look(&[(Measure::I, [0, 40])]);
        for (value, excluded) in [("0", false), ("0.1", false), ("-0.001", true), ("0.101", true)] {
            let rule = rule(&format!("I excludes {value}"));
            assert_eq!(look.meets(&rule), excluded, "{value}");
        }
    }

    #[test]
    fn all_clauses_must_hold() {
        let rule = rule("I excludes 0 and width(S_sim) < 0.1");
        let look = |i, s_sim| look(&[(Measure::I, i), (Measure::SSim, s_sim)]);
        assert!(look([1, 90], [0, 39]).meets(&rule));
        assert!(!look([0, 90], [0, 39]).meets(&rule));
        assert!(!look([1, 90], [0, 40]).meets(&rule));
    }
}
