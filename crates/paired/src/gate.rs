//! The reproduction gate: compares a policy's nominal success with the rate published by its
//! authors. Robustness is worth interpreting only for a policy that passes.

use benchmark::Suite;
use serde::{Deserialize, Serialize};

use crate::inference::student_t::upper_tail;
use crate::outcomes::Count;

/// Largest difference that passes, as a fraction: 5 points. Source: section 6
/// of the protocol.
pub const GATE_TOLERANCE: f64 = 0.05;
/// Number of nominal rollouts behind published figures over all suites: 40 tasks × 50
/// initial states.
pub const GATE_ROLLOUTS: u64 = 2000;
/// Number of nominal rollouts behind the published figure of one suite: 10 tasks × 50
/// initial states.
pub const GATE_ROLLOUTS_OF_A_SUITE: u64 = 500;

/// Nominal success against the published figure.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Gate {
    /// The published success rate, a fraction.
    pub published: f64,
    pub nominal: Count,
    /// The measured rate − `published`; absent without a counted rollout.
    pub difference: Option<f64>,
    pub verdict: GateVerdict,
    /// Equivalence p-value: tests the hypothesis that the policy's rate on these tasks differs
    /// from `published`, taken as exact, by more than [`GATE_TOLERANCE`]. A small value
    /// confirms the reproduction instead of merely not refuting it. Absent if a task has fewer
    /// than two nominal rollouts, or if the outcomes of each task are all equal.
    pub equivalence_p: Option<f64>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum GateVerdict {
    /// Enough nominal rollouts have results, and the difference is within [`GATE_TOLERANCE`].
    Passed,
    /// Enough nominal rollouts have results, and the difference exceeds [`GATE_TOLERANCE`].
    Failed,
    /// Fewer nominal rollouts have results than the published figure is based on.
    Undecided,
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct SuiteGate {
    pub suite: Suite,
    /// Nominal success of the suite against its published figure.
    #[serde(flatten)]
    pub gate: Gate,
}

impl Gate {
    /// Evaluates the gate: |successes / n − published| ≤ [`GATE_TOLERANCE`] with
    /// n ≥ [`GATE_ROLLOUTS`].
    pub fn new(published: f64, nominal: Count) -> Self {
        Self::evaluate(GATE_ROLLOUTS, published, nominal)
    }

    pub fn of_suite(published: f64, nominal: Count) -> Self {
        Self::evaluate(GATE_ROLLOUTS_OF_A_SUITE, published, nominal)
    }

    fn evaluate(min_rollouts: u64, published: f64, nominal: Count) -> Self {
        let difference = nominal.rate().map(|rate| rate - published);
        // A difference of exactly the tolerance passes, despite rounding.
        let is_within = |difference: f64| difference.abs() <= GATE_TOLERANCE + 1e-9;
        let verdict = match difference {
            Some(difference) if nominal.n >= min_rollouts => match is_within(difference) {
                true => GateVerdict::Passed,
                false => GateVerdict::Failed,
            },
            _ => GateVerdict::Undecided,
        };
        Self { published, nominal, difference, verdict, equivalence_p: None }
    }

    /// Adds the equivalence test, from the nominal rollouts of each task: two one-sided
    /// t tests with the variance within tasks, Σ_t (n_t/n)²·p_t(1 − p_t)/(n_t − 1).
    pub(crate) fn with_tasks(mut self, tasks: &[Count]) -> Self {
        let n: u64 = tasks.iter().map(|task| task.n).sum();
        let variance = tasks.iter().map(|task| {
            let rate = task.rate().unwrap_or_default();
            let weight = task.n as f64 / n as f64;
            weight * weight * rate * (1.0 - rate) / (task.n as f64 - 1.0)
        });
        let error = variance.sum::<f64>().sqrt();
        let has_variance = tasks.iter().all(|task| task.n > 1) && error > 0.0;
        self.equivalence_p = self.difference.filter(|_| has_variance).map(|difference| {
            let df = (n - tasks.len() as u64) as f64;
            upper_tail((GATE_TOLERANCE - difference.abs()) / error, df)
        });
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn check(published: f64, successes: u64, n: u64, expected: GateVerdict) {
        let gate = Gate::new(published, Count { successes, n });
        assert_eq!(gate.verdict, expected, "{gate:?}");
    }

    #[test]
    fn a_difference_of_five_points_passes_and_a_greater_one_fails() {
        check(0.971, 1934, 2000, GateVerdict::Passed);
        check(0.95, 2000, 2000, GateVerdict::Passed);
        check(0.95, 1799, 2000, GateVerdict::Failed);
        check(0.95, 1800, 2000, GateVerdict::Passed);
    }

    #[test]
    fn too_few_rollouts_leave_the_gate_undecided() {
        check(0.95, 1999, 1999, GateVerdict::Undecided);
        check(0.95, 0, 0, GateVerdict::Undecided);
    }

    /// Two tasks of 50 states: the rate is 90 %, its standard error 2.9 points.
    #[test]
    fn a_difference_within_the_tolerance_does_not_show_equivalence() {
        let tasks = [50, 40].map(|successes| Count { successes, n: 50 });
        let nominal = Count { successes: 90, n: 100 };
        let p = |published| Gate::new(published, nominal).with_tasks(&tasks).equivalence_p;
        let [equal, different] = [0.90, 0.94].map(|published| p(published).expect("variance"));
        // SciPy: stats.t.sf(0.05 / (0.2 * 0.8 / 49 / 4) ** 0.5, 98).
        assert!((equal - 0.042_0).abs() < 5e-4, "{equal}");
        assert!(different > 0.3, "{different}");
    }

    /// A suite's gate needs 500 rollouts, not the 2,000 of all suites.
    #[test]
    fn five_hundred_rollouts_decide_the_gate_of_a_suite() {
        let gate = |n| Gate::of_suite(0.97, Count { successes: 480, n }).verdict;
        assert_eq!(gate(500), GateVerdict::Passed);
        assert_eq!(gate(499), GateVerdict::Undecided);
    }
}
