//! Multiple testing: Holm's correction and simultaneous max-t intervals.

use rand_chacha::ChaCha12Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

use crate::bootstrap::{Bootstrap, quantile};

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
                match variance > 0.0 {
                    true => sum.abs() / variance.sqrt(),
                    false => f64::INFINITY,
                }
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
}
