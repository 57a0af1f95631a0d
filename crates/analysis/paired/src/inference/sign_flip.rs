//! Exact sign-flip test of clustered differences.

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

#[cfg(test)]
mod tests {
    use super::*;

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
