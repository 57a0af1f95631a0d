//! Looks (interim analyses) of a sequential analysis: the intervals after a number of units.

use std::collections::BTreeMap;

use libero_ctrl::{Clause, Measure, StopRule};
use serde::{Deserialize, Serialize};

/// An interval of a rate or a difference of rates over a finite population, or for new tasks. Its
/// ends are whole numbers of units and therefore exact; for new tasks they are rounded outwards to
/// a multiple of 1/2000.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct RateInterval {
    /// Least total over the population that is not ruled out.
    pub least: i64,
    /// Greatest total over the population that is not ruled out.
    pub greatest: i64,
    /// Units of the population; 2,000 for new tasks, whose population is not finite.
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
    /// Number of units that the intervals rest on: the drawn order up to its first
    /// incomplete unit.
    pub used: usize,
    /// Number of complete units that are not used because an earlier unit is incomplete.
    pub waiting: usize,
    /// Units of the population.
    pub units: usize,
    /// Interval of each measure.
    pub intervals: BTreeMap<Measure, RateInterval>,
}

impl Look {
    /// Returns true if all clauses of a rule hold. A clause about a measure that the look
    /// lacks does not hold, see [`StopRule::check`].
    pub fn meets(&self, rule: &StopRule) -> bool {
        rule.clauses().iter().all(|clause| self.holds(clause))
    }

    fn holds(&self, clause: &Clause) -> bool {
        let interval = self.intervals.get(&clause.measure());
        interval.is_some_and(|interval| match *clause {
            Clause::Width(_, width) => interval.width() < width,
            // A campaign's rule has one target, its configurations or new tasks; so has the look.
            Clause::Excludes(_, value) | Clause::ExcludesForNewTasks(_, value) => {
                interval.excludes(value)
            }
        })
    }
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
        Look {
            used: 200,
            waiting: 0,
            units: 400,
            intervals: intervals.iter().map(interval).collect(),
        }
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

    #[test]
    fn a_rule_about_a_measure_that_the_look_lacks_is_never_met() {
        let look = look(&[(Measure::I, [0, 0])]);
        assert!(!look.meets(&rule("width(difference) < 0.1")));
    }
}
