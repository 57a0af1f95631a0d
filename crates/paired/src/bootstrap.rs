//! Cluster bootstrap: percentile intervals by resampling tasks. Configurations of a task are
//! not independent, so whole tasks are drawn with replacement, and a task drawn twice counts
//! twice.

use std::num::NonZero;
use std::ops::Range;
use std::{fmt, thread};

use rand_chacha::ChaCha12Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};
use serde::{Deserialize, Serialize};

/// Lower and upper end of a 95 % interval.
pub type Interval = [f64; 2];

/// Largest number of resampling threads; further threads take longer to start than they save.
const MAX_THREADS: usize = 8;

/// Settings of the bootstrap. The default is the protocol's: 4,000 resamplings
/// and a fixed seed, so that a report depends on its records alone.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Bootstrap {
    pub replicates: u32,
    /// Seed of the ChaCha streams, one stream per resampling.
    pub seed: u64,
}

impl Default for Bootstrap {
    fn default() -> Self {
        Self { replicates: 4000, seed: 20_260_904 }
    }
}

impl Bootstrap {
    /// Returns percentile intervals of `N` statistics over `clusters` clusters: the
    /// 2.5th and 97.5th percentile of the statistics' values over all
    /// resamplings. `statistics` gets the number of times that each cluster was drawn.
    ///
    /// Resampling k depends on the seed and k alone, so that the result does not depend on the
    /// number of threads. `None` with fewer than two clusters or without resamplings.
    ///
    /// Source: B. Efron and R. Tibshirani, An Introduction to the Bootstrap
    /// (1993), section 13.3; tasks as clusters: section 6 of the protocol.
    pub fn intervals<const N: usize>(
        &self,
        clusters: usize,
        statistics: impl Fn(&[u32]) -> [f64; N] + Sync,
    ) -> Option<[Interval; N]> {
        let intervals = self.intervals_of_many(clusters, N, |draws, values| {
            values.copy_from_slice(&statistics(draws));
        });
        intervals?.try_into().ok()
    }

    /// Returns the intervals of `count` statistics, whose values `statistics` writes into a
    /// slice; `None` as for [`Self::intervals`]. All statistics are computed in one pass of
    /// resampling; each interval is the same as if it were computed alone.
    pub fn intervals_of_many(
        &self,
        clusters: usize,
        count: usize,
        statistics: impl Fn(&[u32], &mut [f64]) + Sync,
    ) -> Option<Vec<Interval>> {
        let cores = thread::available_parallelism().map_or(1, NonZero::get);
        self.intervals_on(cores.min(MAX_THREADS), clusters, count, statistics)
    }

    fn intervals_on(
        &self,
        threads: usize,
        clusters: usize,
        count: usize,
        statistics: impl Fn(&[u32], &mut [f64]) + Sync,
    ) -> Option<Vec<Interval>> {
        if clusters < 2 || self.replicates == 0 {
            return None;
        }
        let share = self.replicates.div_ceil(threads as u32);
        let shares = (0..self.replicates).step_by(share as usize);
        let shares = shares.map(|first| first..self.replicates.min(first + share));
        // One row of values per resampling.
        let values: Vec<f64> = thread::scope(|scope| {
            let statistics = &statistics;
            let resampling =
                |share| scope.spawn(move || self.resample(share, clusters, count, statistics));
            let threads: Vec<_> = shares.map(resampling).collect();
            let threads = threads.into_iter();
            threads.flat_map(|thread| thread.join().expect("a statistic does not panic")).collect()
        });
        let interval_of = |i: usize| {
            let mut values: Vec<f64> = values.iter().skip(i).step_by(count).copied().collect();
            values.sort_unstable_by(f64::total_cmp);
            [quantile(&values, 0.025), quantile(&values, 0.975)]
        };
        Some((0..count).map(interval_of).collect())
    }

    fn resample(
        &self,
        resamplings: Range<u32>,
        clusters: usize,
        count: usize,
        statistics: &(impl Fn(&[u32], &mut [f64]) + Sync),
    ) -> Vec<f64> {
        let mut rng = ChaCha12Rng::seed_from_u64(self.seed);
        let mut draws = vec![0; clusters];
        let mut values = vec![0.0; count * resamplings.len()];
        let rows = values.chunks_exact_mut(count.max(1));
        for (resampling, row) in resamplings.zip(rows) {
            rng.set_stream(u64::from(resampling));
            rng.set_word_pos(0);
            draws.fill(0);
            for _ in 0..clusters {
                // Lemire's multiply-shift: the upper half of the product is in 0..clusters.
                let product = u128::from(rng.next_u64()) * clusters as u128;
                draws[(product >> 64) as usize] += 1;
            }
            statistics(&draws, row);
        }
        values
    }
}

/// Returns the quantile of sorted values at `share`, a fraction, by linear interpolation between
/// the two nearest, as NumPy and SciPy do by default (Hyndman and Fan's type 7).
///
/// # Panics
/// If `sorted` is empty or `share` exceeds 1.
pub fn quantile(sorted: &[f64], share: f64) -> f64 {
    let position = share * (sorted.len() - 1) as f64;
    let below = sorted[position.floor() as usize];
    let above = sorted[position.ceil() as usize];
    below + (above - below) * position.fract()
}

/// Smallest number of tasks that gives a bootstrap interval; an interval by Student's t needs
/// [`FEWEST_TASKS`](crate::FEWEST_TASKS). From ten tasks on, a bootstrap interval of 95 % nominal
/// coverage has at least 90 % actual coverage if the tasks' values are normally distributed.
///
/// In that case the percentile interval of G tasks is the mean ± 1.96·√((G − 1)/G)
/// standard errors, which covers the truth with probability
/// P(|t_{G−1}| ≤ 1.96·√((G − 1)/G)): 75 % for three tasks, 85 % for five, 90.4 %
/// for ten, 94 % for forty. With fewer than four tasks, an end of the interval is
/// simply the most extreme task, because that task is drawn G times with
/// probability G^−G > 2.5 %; with two tasks the interval covers the truth in half
/// of all cases. docs/dev/STATISTICS.md has simulations.
///
/// Sources: T. Hesterberg, What teachers should know about the bootstrap, The
/// American Statistician 69 (2015), 371–386, section 4 (the interval is too
/// narrow by √((n − 1)/n), and uses normal instead of t quantiles); A. C. Cameron,
/// J. B. Gelbach and D. L. Miller, Bootstrap-based improvements for inference with clustered
/// errors, Review of Economics and Statistics 90 (2008), 414–427 (resampling
/// few clusters rejects too often).
pub const MIN_TASKS: usize = 10;

/// Widths up to this are rounding errors of equal values.
const NO_WIDTH: f64 = 1e-12;

/// Reason why a value has no interval.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum NoInterval {
    /// There are fewer tasks than [`MIN_TASKS`].
    TooFewTasks,
    /// Both ends of the interval are equal, for example because no outcome ever changes, or there
    /// are no resamplings. An interval of width 0 would suggest a certainty that the data do not
    /// support.
    NoSpread,
}

impl NoInterval {
    /// Text in place of an interval: `too few tasks`, `no spread`.
    pub const fn name(self) -> &'static str {
        match self {
            Self::TooFewTasks => "too few tasks",
            Self::NoSpread => "no spread",
        }
    }
}

impl fmt::Display for NoInterval {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

/// Returns intervals of `N` statistics over `tasks` tasks, and the reason why the first absent
/// interval is withheld.
pub(crate) fn intervals<const N: usize>(
    bootstrap: &Bootstrap,
    tasks: usize,
    statistics: impl Fn(&[u32]) -> [f64; N] + Sync,
) -> ([Option<Interval>; N], Option<NoInterval>) {
    // Skips the computation of intervals that would be withheld.
    let intervals = (tasks >= MIN_TASKS).then(|| bootstrap.intervals(tasks, statistics));
    let intervals = intervals.flatten().map_or([None; N], |all| all.map(Some));
    let shown = intervals.map(|interval| interval_or_reason(tasks, interval));
    let reason = shown.iter().find_map(|interval| interval.err());
    (shown.map(Result::ok), reason)
}

/// Returns for each of `count` statistics its interval, or the reason why it is withheld.
/// `statistics` writes the values for given draws of the tasks, as for
/// [`Bootstrap::intervals_of_many`].
pub fn intervals_of_many(
    bootstrap: &Bootstrap,
    tasks: usize,
    count: usize,
    statistics: impl Fn(&[u32], &mut [f64]) + Sync,
) -> Vec<Result<Interval, NoInterval>> {
    let computed =
        (tasks >= MIN_TASKS).then(|| bootstrap.intervals_of_many(tasks, count, statistics));
    let computed = computed.flatten();
    let each = (0..count).map(|i| computed.as_ref().map(|all| all[i]));
    each.map(|interval| interval_or_reason(tasks, interval)).collect()
}

pub(crate) fn interval_or_reason(
    tasks: usize,
    interval: Option<Interval>,
) -> Result<Interval, NoInterval> {
    if tasks < MIN_TASKS {
        return Err(NoInterval::TooFewTasks);
    }
    let has_width = |[low, high]: &Interval| high - low > NO_WIDTH;
    interval.filter(has_width).ok_or(NoInterval::NoSpread)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn mean(draws: &[u32]) -> [f64; 1] {
        let values = (0..40).map(|i| f64::from(i % 10));
        let sum: f64 = draws.iter().zip(values).map(|(&d, v)| f64::from(d) * v).sum();
        [sum / 40.0]
    }

    #[test]
    fn the_interval_of_a_mean_agrees_with_the_normal_approximation() {
        let [[low, high]] = Bootstrap::default().intervals(40, mean).expect("clusters");
        // The standard deviation of one value is √8.25; that of the mean of 40 is √(8.25 / 40).
        let half_width = 1.96 * (8.25_f64 / 40.0).sqrt();
        assert!((low - (4.5 - half_width)).abs() < 0.05, "{low}");
        assert!((high - (4.5 + half_width)).abs() < 0.05, "{high}");
    }

    #[test]
    fn intervals_do_not_depend_on_the_number_of_threads() {
        let bootstrap = Bootstrap { replicates: 1001, seed: 7 };
        let mean = |draws: &[u32], values: &mut [f64]| values.copy_from_slice(&mean(draws));
        let alone = bootstrap.intervals_on(1, 40, 1, mean);
        for threads in [2, 3, 7, 16] {
            assert_eq!(bootstrap.intervals_on(threads, 40, 1, mean), alone);
        }
    }

    #[test]
    fn every_resampling_draws_as_many_clusters_as_there_are() {
        let total = |draws: &[u32]| [f64::from(draws.iter().sum::<u32>())];
        let interval = Bootstrap::default().intervals(7, total);
        assert_eq!(interval, Some([[7.0, 7.0]]));
    }

    #[test]
    fn one_cluster_has_no_interval() {
        assert_eq!(Bootstrap::default().intervals(1, |_| [0.0]), None);
    }

    fn mean_interval(values: &[f64]) -> (Option<Interval>, Option<NoInterval>) {
        let ([interval], reason) = intervals(&Bootstrap::default(), values.len(), |draws| {
            let sum: f64 = draws.iter().zip(values).map(|(&d, v)| f64::from(d) * v).sum();
            [sum / values.len() as f64]
        });
        (interval, reason)
    }

    #[test]
    fn fewer_than_ten_tasks_have_no_interval_even_if_they_differ() {
        let values: Vec<f64> = (0..10).map(f64::from).collect();
        assert_eq!(mean_interval(&values[..2]), (None, Some(NoInterval::TooFewTasks)));
        assert_eq!(mean_interval(&values[..9]), (None, Some(NoInterval::TooFewTasks)));
        let (interval, reason) = mean_interval(&values);
        let [low, high] = interval.expect("ten tasks");
        assert!(low < 4.5 && 4.5 < high, "{low} {high}");
        assert_eq!(reason, None);
    }

    #[test]
    fn each_statistic_has_the_same_interval_alone_and_among_many() {
        let columns: [Vec<f64>; 2] = [(0..12).map(f64::from).collect(), vec![1.0; 12]];
        for tasks in [9, 12] {
            let mean = |draws: &[u32], column: &[f64]| {
                let sum: f64 = draws.iter().zip(column).map(|(&d, v)| f64::from(d) * v).sum();
                sum / tasks as f64
            };
            let many = intervals_of_many(&Bootstrap::default(), tasks, 2, |draws, values| {
                for (value, column) in values.iter_mut().zip(&columns) {
                    *value = mean(draws, column);
                }
            });
            for (column, result) in columns.iter().zip(many) {
                let (interval, reason) = mean_interval(&column[..tasks]);
                assert_eq!(result.ok(), interval);
                assert_eq!(result.err(), reason);
            }
        }
    }

    #[test]
    fn a_value_that_no_resampling_changes_has_no_interval() {
        assert_eq!(mean_interval(&[0.0; 40]), (None, Some(NoInterval::NoSpread)));
        assert_eq!(mean_interval(&[1.0 / 3.0; 40]), (None, Some(NoInterval::NoSpread)));
    }
}
