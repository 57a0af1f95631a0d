//! The noise floor: the values that the measures take without any perturbation, and a
//! level's excess over them.
//!
//! S_conj is a minimum over several outcomes and S_sim is one outcome, so that I and R_d
//! are positive for a policy with random outcomes even if no axis has an effect. At a placebo
//! level, whose radius is too small to affect any policy, the measures take these values.

use std::collections::BTreeMap;

use benchmark::{Directions, TaskRef};
use serde::{Deserialize, Serialize};

use crate::inference::estimate::{Estimate, Scale, share};
use crate::inference::sample::{Row, Sample};
use crate::outcomes::Matched;

/// The four measures of simultaneity.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Simultaneity {
    /// Share of emergent failures.
    pub r_e: Estimate,
    /// Share of compensated successes.
    pub r_c: Estimate,
    /// `r_e` + `r_c`.
    pub r_d: Estimate,
    /// `r_c` − `r_e`.
    pub i: Estimate,
}

/// The noise floor and a level's excess over it, paired by task.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Excess {
    /// Complete configurations of the level.
    pub n: u64,
    /// Complete configurations of the placebo.
    pub placebo: u64,
    /// The placebo's measures, averaged over all choices of one rollout of each configuration as
    /// the simultaneous one.
    pub floor: Simultaneity,
    /// The level's measures minus the floor.
    pub excess: Simultaneity,
}

/// Columns of a row for the level: 1 if the configuration is complete, 1 if it is emergent, and 1
/// if it is compensated.
const LEVEL: [usize; 3] = [0, 1, 2];
/// Columns of a row for the placebo: 1 if the configuration is complete, and the probabilities that
/// it is emergent and compensated, from [`expected`].
const PLACEBO: [usize; 3] = [3, 4, 5];

impl Excess {
    /// Computes the excess over the complete configurations of the level and the placebo.
    /// `None` if the level or the placebo has no complete configuration, or if the numbers of
    /// their axes differ.
    pub(crate) fn of(
        matched: &[Matched],
        placebo: &[Matched],
        directions: Directions,
    ) -> Option<Self> {
        let mut rows: BTreeMap<(TaskRef, u16), Vec<f64>> = BTreeMap::new();
        let mut counts = [0_u64; 2];
        let mut axes: Option<usize> = None;
        let columns = [LEVEL, PLACEBO];
        for (source, configurations) in [matched, placebo].into_iter().enumerate() {
            for matched in configurations {
                let Some(configuration) = matched.configuration() else {
                    continue;
                };
                let alone = configuration.alone.values().filter(|&&success| success);
                let (alone, all) = (alone.count(), configuration.alone.len());
                if *axes.get_or_insert(all) != all {
                    return None;
                }
                let (emergent, compensated) = match source {
                    0 => (
                        f64::from(u8::from(alone == all && !configuration.simultaneous)),
                        f64::from(u8::from(alone < all && configuration.simultaneous)),
                    ),
                    _ => expected(alone + usize::from(configuration.simultaneous), all + 1),
                };
                let row = rows.entry((matched.task, matched.config));
                let row = row.or_insert_with(|| vec![0.0; 6]);
                for (column, value) in columns[source].into_iter().zip([1.0, emergent, compensated])
                {
                    row[column] += value;
                }
                counts[source] += 1;
            }
        }
        let rows: Vec<Row> = rows
            .into_iter()
            .map(|((task, direction), values)| Row { task, direction, values })
            .collect();
        let sample = Sample::new(&rows, directions)?;
        let simultaneity = |scale, statistic: &dyn Fn(&[f64], [f64; 2]) -> f64| {
            let estimate = |scale, weights: [f64; 2]| {
                Estimate::of(&sample, scale, &|sums| statistic(sums, weights))
            };
            Some(Simultaneity {
                r_e: estimate(scale, [1.0, 0.0])?,
                r_c: estimate(scale, [0.0, 1.0])?,
                r_d: estimate(scale, [1.0, 1.0])?,
                i: estimate(Scale::Difference, [-1.0, 1.0])?,
            })
        };
        let measure = |sums: &[f64], [n, e, c]: [usize; 3], weights: [f64; 2]| {
            weights[0] * share(e, n)(sums) + weights[1] * share(c, n)(sums)
        };
        let floor = |sums: &[f64], weights| measure(sums, PLACEBO, weights);
        let excess = |sums: &[f64], weights| measure(sums, LEVEL, weights) - floor(sums, weights);
        Some(Self {
            n: counts[0],
            placebo: counts[1],
            floor: simultaneity(Scale::Share, &floor)?,
            excess: simultaneity(Scale::Difference, &excess)?,
        })
    }
}

/// Returns the probabilities that a configuration with `successes` among `rollouts` is an
/// emergent failure and a compensated success, if each rollout is equally likely to be the
/// simultaneous one.
///
/// The rollouts of a placebo are exchangeable, because no perturbation is large enough to matter.
/// The average has the same expectation as the measure itself and a smaller variance
/// (D. Blackwell, Annals of Mathematical Statistics 18 (1947), 105–110). A configuration with a
/// single failure is emergent if the failure is the simultaneous rollout. A configuration with any
/// failure is compensated if the simultaneous rollout succeeds.
fn expected(successes: usize, rollouts: usize) -> (f64, f64) {
    let part = |count: usize| count as f64 / rollouts as f64;
    let failures = rollouts - successes;
    let emergent = if failures == 1 { part(1) } else { 0.0 };
    let compensated = if failures > 0 { part(successes) } else { 0.0 };
    (emergent, compensated)
}

/// Returns upper bounds of R_d and I by chance alone, given the share `flips` of pairs of
/// identical rollouts that end differently: (k + 1)/2 and (k − 1)/2 times that share, for k
/// axes.
///
/// A configuration that succeeds with probability p, independently under each of k axes
/// and simultaneously, has two different outcomes with probability f = 2p(1 − p), has
/// I = p − p^k = f·(1 + p + … + p^(k−2))/2 ≤ f·(k − 1)/2, and
/// R_d = p − p^k + 2p^k(1 − p) ≤ f·(k + 1)/2. Configurations may differ in p.
pub fn chance_bounds(flips: f64, axes: usize) -> [f64; 2] {
    let k = axes as f64;
    [(k + 1.0) / 2.0, (k - 1.0) / 2.0].map(|times| (flips * times).min(1.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_average_over_choices_of_the_simultaneous_rollout_has_the_expectation_of_the_measure() {
        let p: f64 = 0.9;
        let (mut emergent, mut compensated) = (0.0, 0.0);
        // Outcomes under six axes alone and simultaneously, as the bits of a number.
        for outcomes in 0..1_u32 << 7 {
            let successes = outcomes.count_ones();
            let weight = p.powi(successes as i32) * (1.0 - p).powi(7 - successes as i32);
            let (e, c) = expected(successes as usize, 7);
            emergent += weight * e;
            compensated += weight * c;
        }
        assert!((emergent - p.powi(6) * (1.0 - p)).abs() < 1e-12);
        assert!((compensated - p * (1.0 - p.powi(6))).abs() < 1e-12);
        let [r_d, i] = chance_bounds(2.0 * p * (1.0 - p), 6);
        assert!(emergent + compensated <= r_d && compensated - emergent <= i);
    }
}
