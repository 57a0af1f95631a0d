//! Exact (Clopper–Pearson) interval of a success probability.

use crate::{Count, Interval};

/// Number of bisection steps, beyond the precision of an `f64`.
const BISECTIONS: u32 = 60;

/// Returns the Clopper–Pearson interval of a success probability at a confidence
/// `level`, such as 0.95: all probabilities that neither of two one-sided exact
/// binomial tests at (1 − `level`) / 2 rejects. It covers the truth with at least
/// the stated probability. `None` without a rollout.
///
/// Source: C. J. Clopper and E. S. Pearson, The use of confidence or fiducial
/// limits illustrated in the case of the binomial, Biometrika 26 (1934), 404–413.
pub fn clopper_pearson(count: Count, level: f64) -> Option<Interval> {
    let Count { successes, n } = count;
    if n == 0 {
        return None;
    }
    let tail = (1.0 - level) / 2.0;
    // P(X ≤ k) falls with p; P(X ≥ k) = P(n − X ≤ n − k) is its mirror image.
    let high = |k: u64| if k == n { 1.0 } else { bisect(|p| at_most(k, n, p) > tail) };
    Some([1.0 - high(n - successes), high(successes)])
}

/// Returns the point in [0, 1] at which a condition changes from true (at 0) to false (at 1).
fn bisect(holds: impl Fn(f64) -> bool) -> f64 {
    let (mut low, mut high) = (0.0, 1.0);
    for _ in 0..BISECTIONS {
        let middle = f64::midpoint(low, high);
        if holds(middle) { low = middle } else { high = middle }
    }
    f64::midpoint(low, high)
}

/// P(X ≤ k) of X ~ Bin(n, p), for 0 < p < 1.
fn at_most(k: u64, n: u64, p: f64) -> f64 {
    // Works in logarithms, because (1 − p)ⁿ underflows for many rollouts.
    let mut ln_term = n as f64 * (-p).ln_1p();
    let ln_odds = p.ln() - (-p).ln_1p();
    let mut sum = ln_term.exp();
    for i in 0..k {
        ln_term += ((n - i) as f64 / (i + 1) as f64).ln() + ln_odds;
        sum += ln_term.exp();
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;

    fn interval(successes: u64, n: u64, level: f64) -> Interval {
        clopper_pearson(Count { successes, n }, level).expect("rollouts")
    }

    #[test]
    fn intervals_of_only_successes_or_only_failures_equal_the_closed_form() {
        for n in [1, 5, 8, 400] {
            let end = 0.025_f64.powf(1.0 / n as f64);
            let [low, high] = interval(n, n, 0.95);
            assert!((low - end).abs() < 1e-12 && high == 1.0, "{n}: {low} {high}");
            let [low, high] = interval(0, n, 0.95);
            assert!(low == 0.0 && (high - (1.0 - end)).abs() < 1e-12, "{n}");
        }
        assert_eq!(clopper_pearson(Count::default(), 0.95), None);
    }

    #[test]
    fn the_interval_covers_the_truth_as_often_as_stated() {
        for n in [3_u64, 10, 24] {
            for truth in (1..100).map(|percent| f64::from(percent) / 100.0) {
                let covered = |k: u64| {
                    let [low, high] = interval(k, n, 0.9);
                    low <= truth && truth <= high
                };
                let chance = |k: u64| match k {
                    0 => at_most(0, n, truth),
                    k => at_most(k, n, truth) - at_most(k - 1, n, truth),
                };
                let coverage: f64 = (0..=n).filter(|&k| covered(k)).map(chance).sum();
                assert!(coverage >= 0.9, "{n} rollouts at {truth}: {coverage}");
            }
        }
    }
}
