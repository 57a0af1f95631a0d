//! Decides which bootstrap intervals to report. The percentile bootstrap always yields two
//! numbers, even meaningless ones; such intervals are withheld here with a reason.

use std::fmt;

use serde::{Deserialize, Serialize};

use crate::bootstrap::{Bootstrap, Interval};

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
/// of all cases. docs/REPORT.md has simulations.
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

/// Returns the interval, or the reason why it is withheld.
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
