//! Exact McNemar test of paired outcomes.

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
