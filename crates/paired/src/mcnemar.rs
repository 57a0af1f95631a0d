//! McNemar's test of paired outcomes, exactly.

/// Two-sided exact p-value of `b` changes one way against `c` the other, under
/// the hypothesis that either way is equally likely: twice the smaller tail of
/// Bin(b + c, ½), at most 1.
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

    fn check(b: u64, c: u64, expected: f64) {
        for p in [mcnemar_exact(b, c), mcnemar_exact(c, b)] {
            let off = (p - expected).abs() / expected;
            assert!(off < 1e-10, "{b} {c}: {p}");
        }
    }

    /// `scipy.stats.binomtest(b, b + c, 0.5).pvalue`.
    #[test]
    fn p_values_equal_scipys() {
        check(0, 0, 1.0);
        check(5, 5, 1.0);
        check(0, 5, 0.0625);
        check(54, 55, 1.0);
        check(28, 57, 0.0021949089077805926);
        check(65, 14, 5.194941262584353e-09);
        check(700, 900, 6.319484959450105e-07);
    }
}
