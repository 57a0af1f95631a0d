//! Percentile intervals by resampling tasks. Configurations of a task are not
//! independent of one another, so whole tasks are drawn, with replacement, and
//! a task drawn twice counts twice.

use rand_chacha::ChaCha12Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};
use serde::{Deserialize, Serialize};

/// Lower and upper end of a 95 % interval.
pub type Interval = [f64; 2];

/// How intervals are made. The default is the protocol's: 4,000 replicates, and
/// a fixed seed, so that a report is a function of its records.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Bootstrap {
    /// Resamplings.
    pub replicates: u32,
    /// Seed of the ChaCha stream that draws them.
    pub seed: u64,
}

impl Default for Bootstrap {
    fn default() -> Self {
        Self {
            replicates: 4000,
            seed: 20_260_904,
        }
    }
}

impl Bootstrap {
    /// Intervals of `N` statistics over `clusters` clusters. `statistics` gets,
    /// per cluster, how often it was drawn.
    ///
    /// None with fewer than two clusters: there is nothing to resample.
    pub fn intervals<const N: usize>(
        &self,
        clusters: usize,
        mut statistics: impl FnMut(&[u32]) -> [f64; N],
    ) -> Option<[Interval; N]> {
        if clusters < 2 || self.replicates == 0 {
            return None;
        }
        let mut rng = ChaCha12Rng::seed_from_u64(self.seed);
        let mut draws = vec![0; clusters];
        let mut values: [Vec<f64>; N] = std::array::from_fn(|_| Vec::new());
        for _ in 0..self.replicates {
            draws.fill(0);
            for _ in 0..clusters {
                // The upper half of the product is uniform in 0..clusters.
                let wide = u128::from(rng.next_u64()) * clusters as u128;
                draws[(wide >> 64) as usize] += 1;
            }
            for (values, value) in values.iter_mut().zip(statistics(&draws)) {
                values.push(value);
            }
        }
        Some(values.map(|mut values| {
            values.sort_unstable_by(f64::total_cmp);
            [quantile(&values, 0.025), quantile(&values, 0.975)]
        }))
    }
}

/// A quantile of sorted values, by linear interpolation.
fn quantile(sorted: &[f64], share: f64) -> f64 {
    let position = share * (sorted.len() - 1) as f64;
    let below = sorted[position.floor() as usize];
    let above = sorted[position.ceil() as usize];
    below + (above - below) * position.fract()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_interpolate_as_numpys() {
        let values = [1.0, 2.0, 4.0, 8.0];
        assert_eq!(quantile(&values, 0.5), 3.0);
        assert!((quantile(&values, 0.975) - 7.7).abs() < 1e-12);
        assert_eq!(quantile(&values, 0.0), 1.0);
    }

    #[test]
    fn the_interval_of_a_mean_is_that_of_its_normal_approximation() {
        let means: Vec<f64> = (0..40).map(|i| f64::from(i % 10)).collect();
        let mean = |draws: &[u32]| {
            let sum: f64 = draws
                .iter()
                .zip(&means)
                .map(|(&d, m)| f64::from(d) * m)
                .sum();
            [sum / 40.0]
        };
        let [[low, high]] = Bootstrap::default().intervals(40, mean).expect("clusters");
        // Deviation of one value is √8.25, of the mean of 40 that over √40.
        let half_width = 1.96 * (8.25_f64 / 40.0).sqrt();
        assert!((low - (4.5 - half_width)).abs() < 0.05, "{low}");
        assert!((high - (4.5 + half_width)).abs() < 0.05, "{high}");
    }

    #[test]
    fn one_cluster_has_no_interval() {
        assert_eq!(Bootstrap::default().intervals(1, |_| [0.0]), None);
    }
}
