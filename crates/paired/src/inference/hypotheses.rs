//! Exact and equivalence tests, and corrections of several p-values and intervals.

use rand_chacha::ChaCha12Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

use crate::bootstrap::{Bootstrap, quantile};
use crate::inference::estimate::Estimate;
use crate::inference::student_t::upper_tail;

/// Adjusts p-values for multiple testing. If all hypotheses with an adjusted value below 5 % are
/// rejected, the probability of any false rejection is at most 5 %. The j-th smallest of
/// m becomes max_{i ≤ j} min(1, (m − i + 1)·p_(i)).
///
/// Source: S. Holm, A simple sequentially rejective multiple test procedure,
/// Scandinavian Journal of Statistics 6 (1979), 65–70.
pub fn holm(p_values: &[f64]) -> Vec<f64> {
    let mut order: Vec<usize> = (0..p_values.len()).collect();
    order.sort_by(|&a, &b| p_values[a].total_cmp(&p_values[b]));
    let mut adjusted = vec![0.0; p_values.len()];
    let mut greatest: f64 = 0.0;
    for (rank, &at) in order.iter().enumerate() {
        let remaining = (p_values.len() - rank) as f64;
        greatest = greatest.max((remaining * p_values[at]).min(1.0));
        adjusted[at] = greatest;
    }
    adjusted
}

/// Returns the half-width, in standard errors, of simultaneous 95 % intervals of several
/// statistics of the same tasks: the 95th percentile of max_k |Σ_g w_g u_gk| / s*_k over
/// random signs w, with u the jackknife's pseudo-values of task g and statistic k and s* the
/// standard error under the same signs. `strata` has the number of consecutive tasks in each
/// stratum. s* has the same strata as the statistics' own standard errors, because an s* pooled
/// over four suites made the intervals of 40 tasks too narrow. `None` with fewer than two tasks in
/// a stratum, without variance, or if s* is 0 under at least 5 % of the signs.
///
/// Sources: J. P. Romano and M. Wolf, Exact and approximate stepdown methods for multiple
/// hypothesis testing, JASA 100 (2005), 94–108; signs of whole clusters: A. C. Cameron,
/// J. B. Gelbach and D. L. Miller, Review of Economics and Statistics 90 (2008), 414–427.
pub fn max_t(pseudo_values: &[Vec<f64>], strata: &[usize], bootstrap: &Bootstrap) -> Option<f64> {
    let tasks = pseudo_values.first()?.len();
    let varies = |values: &&Vec<f64>| values.iter().any(|value| value.abs() > 1e-12);
    let statistics: Vec<&Vec<f64>> = pseudo_values.iter().filter(varies).collect();
    if strata.iter().any(|&tasks| tasks < 2) || statistics.is_empty() {
        return None;
    }
    let mut rng = ChaCha12Rng::seed_from_u64(bootstrap.seed);
    let mut greatest: Vec<f64> = (0..bootstrap.replicates)
        .map(|_| {
            let signs: Vec<f64> =
                (0..tasks).map(|_| if rng.next_u32() & 1 == 1 { 1.0 } else { -1.0 }).collect();
            let t_values = statistics.iter().map(|values| {
                let (sum, variance) = under_signs(values, &signs, strata);
                if variance > 0.0 { sum.abs() / variance.sqrt() } else { f64::INFINITY }
            });
            t_values.fold(0.0, f64::max)
        })
        .collect();
    greatest.sort_unstable_by(f64::total_cmp);
    let critical = quantile(&greatest, 0.95);
    critical.is_finite().then_some(critical)
}

/// Returns the sum of signed values, and its variance estimated within the strata.
fn under_signs(values: &[f64], signs: &[f64], strata: &[usize]) -> (f64, f64) {
    let (mut total, mut variance, mut first) = (0.0, 0.0, 0);
    for &tasks in strata {
        let (mut sum, mut squares) = (0.0, 0.0);
        for (u, w) in values[first..].iter().zip(&signs[first..]).take(tasks) {
            sum += u * w;
            squares += u * u;
        }
        let g = tasks as f64;
        let deviation_squares = squares - sum * sum / g;
        // With two tasks, opposite signs may leave a variance that is only a rounding error.
        if deviation_squares > 1e-12 * squares {
            variance += deviation_squares * g / (g - 1.0);
        }
        total += sum;
        first += tasks;
    }
    (total, variance)
}

/// Returns the two-sided exact p-value of the tasks' net changes under the hypothesis that both
/// signs of each task's change are equally likely: the share of the 2^G assignments of signs to the
/// G tasks whose sum is at least as far from 0 as the observed sum. Unlike McNemar's test, this
/// test accounts for the correlation of rollouts of a task.
///
/// The distribution of the sum is computed by convolution, one task after the other, without
/// enumerating or sampling assignments.
///
/// Source: R. A. Fisher, The Design of Experiments (1935), section 21; for clusters:
/// I. A. Canay, J. P. Romano and A. M. Shaikh, Econometrica 85 (2017), 1013–1030.
pub fn sign_flip_p(net: &[i64]) -> f64 {
    let reach = net.iter().map(|change| change.unsigned_abs() as usize).sum::<usize>();
    // Index `reach + s` has the probability of the sum s.
    let mut probabilities = vec![0.0; 2 * reach + 1];
    probabilities[reach] = 1.0;
    for change in net {
        let size = change.unsigned_abs() as usize;
        if size == 0 {
            continue;
        }
        let mut next = vec![0.0; probabilities.len()];
        for (sum, p) in probabilities.iter().enumerate().filter(|(_, p)| **p > 0.0) {
            next[sum + size] += p / 2.0;
            next[sum - size] += p / 2.0;
        }
        probabilities = next;
    }
    let observed = net.iter().sum::<i64>().unsigned_abs() as usize;
    let as_extreme = probabilities.iter().enumerate();
    let as_extreme = as_extreme.filter(|(sum, _)| sum.abs_diff(reach) >= observed);
    as_extreme.map(|(_, p)| p).sum::<f64>().min(1.0)
}

/// Largest difference that counts as equivalent, a fraction: 5 points, the tolerance of the
/// reproduction gate.
pub const EQUIVALENCE_MARGIN: f64 = 0.05;

/// Returns the p-value of the two one-sided tests (TOST) that a difference lies beyond
/// ±[`EQUIVALENCE_MARGIN`], for new tasks: the greater of P(T > (Δ + v)/s) and
/// P(T > (Δ − v)/s), with Δ the margin, v the difference, s its standard error and T of Student's
/// t distribution. `None` without a standard error.
///
/// Source: D. J. Schuirmann, A comparison of the two one-sided tests procedure and the
/// power approach for assessing the equivalence of average bioavailability, Journal of
/// Pharmacokinetics and Biopharmaceutics 15 (1987), 657–680.
pub fn equivalence_p(difference: &Estimate) -> Option<f64> {
    let (error, df) = (difference.standard_error?, difference.df?);
    let tail = |distance: f64| upper_tail(distance / error, df);
    let value = difference.value;
    Some(tail(EQUIVALENCE_MARGIN + value).max(tail(EQUIVALENCE_MARGIN - value)))
}

/// Returns the two-sided exact p-value of `b` changes in one direction against `c` in the
/// other, under the hypothesis that both directions are equally likely: twice the smaller tail of
/// Bin(b + c, ½), at most 1:
/// p = min(1, 2·Σ_{k ≤ min(b, c)} C(b + c, k)·2^−(b + c)).
///
/// Source: Q. McNemar, Psychometrika 12 (1947), 153–157; the exact form is the
/// binomial (sign) test.
pub fn mcnemar_exact(b: u64, c: u64) -> f64 {
    let changes = b + c;
    let ln_half_power = changes as f64 * 0.5_f64.ln();
    let mut ln_ways = 0.0;
    let mut tail = 0.0;
    for k in 0..=b.min(c) {
        tail += (ln_ways + ln_half_power).exp();
        ln_ways += ((changes - k) as f64 / (k + 1) as f64).ln();
    }
    (2.0 * tail).min(1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn holm_multiplies_the_smallest_p_value_by_the_number_of_hypotheses() {
        let adjusted = holm(&[0.01, 0.04, 0.03, 0.005]);
        for (p, expected) in adjusted.iter().zip([0.03, 0.06, 0.06, 0.02]) {
            assert!((p - expected).abs() < 1e-12, "{adjusted:?}");
        }
    }

    #[test]
    fn the_half_width_of_one_statistic_is_that_of_students_t_and_of_many_is_greater() {
        let mut rng = ChaCha12Rng::seed_from_u64(1);
        let mut column = || -> Vec<f64> {
            let values: Vec<f64> =
                (0..40).map(|_| rng.next_u32() as f64 / f64::from(u32::MAX)).collect();
            let mean = values.iter().sum::<f64>() / 40.0;
            values.iter().map(|value| value - mean).collect()
        };
        let columns: Vec<Vec<f64>> = (0..20).map(|_| column()).collect();
        let of_one = max_t(&columns[..1], &[40], &Bootstrap::default()).expect("a spread");
        let of_twenty = max_t(&columns, &[40], &Bootstrap::default()).expect("a spread");
        assert!((of_one - 2.02).abs() < 0.1, "{of_one}");
        // Šidák's quantile for 20 independent statistics.
        assert!((of_twenty - 3.2).abs() < 0.2, "{of_twenty}");
    }

    #[test]
    fn strata_widen_intervals_by_leaving_fewer_degrees_of_freedom() {
        let mut rng = ChaCha12Rng::seed_from_u64(2);
        let mut values = Vec::new();
        for _ in 0..4 {
            let stratum: Vec<f64> =
                (0..3).map(|_| rng.next_u32() as f64 / f64::from(u32::MAX)).collect();
            let mean = stratum.iter().sum::<f64>() / 3.0;
            values.extend(stratum.iter().map(|value| value - mean));
        }
        let critical = |strata: &[usize]| max_t(&[values.clone()], strata, &Bootstrap::default());
        let [pooled, stratified] =
            [critical(&[12]), critical(&[3; 4])].map(|width| width.expect("a spread"));
        assert!(stratified > 1.03 * pooled, "{stratified} {pooled}");
        assert_eq!(critical(&[11, 1]), None);
        // With two pairs of tasks, one in four assignments of signs leaves no variance.
        let pairs = vec![vec![0.1, -0.1, 0.3, -0.3]];
        assert_eq!(max_t(&pairs, &[2, 2], &Bootstrap::default()), None);
    }

    #[test]
    fn the_p_value_equals_that_of_an_enumeration_of_all_signs() {
        let net = [3, -1, 2, 0, 5, 1, -2_i64];
        let observed = net.iter().sum::<i64>().abs();
        let as_extreme = (0..1_u32 << net.len()).filter(|signs| {
            let sum: i64 = net
                .iter()
                .enumerate()
                .map(|(at, change)| if signs >> at & 1 == 1 { -change } else { *change })
                .sum();
            sum.abs() >= observed
        });
        let expected = as_extreme.count() as f64 / f64::from(1_u32 << net.len());
        assert!((sign_flip_p(&net) - expected).abs() < 1e-12);
        assert_eq!(sign_flip_p(&[]), 1.0);
        assert_eq!(sign_flip_p(&[4]), 1.0);
    }
}
