//! Power analysis: the smallest differences that a design can detect.

use std::collections::BTreeMap;

use benchmark::{Level, TaskRef};
use serde::Serialize;

use crate::bootstrap::MIN_TASKS;
use crate::measures::Configuration;

/// Normal quantile of a two-sided test at 5 %: Φ⁻¹(0.975).
const Z_TEST: f64 = 1.959963984540054;
/// Normal quantile of a power of 80 %: Φ⁻¹(0.8).
const Z_POWER: f64 = 0.8416212335729143;
/// Number of bisection steps, enough for the precision of an `f64`.
const BISECTIONS: u32 = 60;

/// Parameters that the smallest detectable effect depends on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct PairedDesign {
    pub(crate) tasks: u32,
    /// Configurations of each task, on average.
    pub(crate) configs_per_task: f64,
    /// Expected or measured share of configurations whose outcome changes.
    pub(crate) r_d: f64,
    /// Intraclass correlation of simultaneous − conjunction among configurations
    /// of a task, from [`task_correlation`].
    pub(crate) task_correlation: f64,
}

/// Returns the smallest |I| that a two-sided test at 5 % detects with a power of 80 %.
///
/// Solves |I|·√n = z₀.₉₇₅·√(R_d·e) + z₀.₈·√((R_d − I²)·e) for |I|, with n
/// configurations and the design effect e = 1 + (m − 1)·ρ of m configurations
/// per task. `None` if even |I| = R_d, with every change in the same direction, is too small
/// to detect.
///
/// Sources: R. J. Connor, Sample size for testing differences in proportions
/// for the paired-sample design, Biometrics 43 (1987), 207–211; design effect:
/// L. Kish, Survey Sampling (1965), section 5.4.
pub(crate) fn minimum_detectable_effect(design: &PairedDesign) -> Option<f64> {
    let PairedDesign { tasks, configs_per_task, r_d, task_correlation } = *design;
    let n = f64::from(tasks) * configs_per_task;
    let design_effect = 1.0 + (configs_per_task - 1.0) * task_correlation;
    // Required minus actual |I|·√n: negative if |I| is detectable.
    let shortfall = |i: f64| {
        let test = Z_TEST * (r_d * design_effect).sqrt();
        let power = Z_POWER * ((r_d - i * i).max(0.0) * design_effect).sqrt();
        test + power - i * n.sqrt()
    };
    if !(design_effect > 0.0 && n > 0.0) || r_d <= 0.0 || shortfall(r_d) > 0.0 {
        return None;
    }
    let (mut low, mut high) = (0.0, r_d);
    for _ in 0..BISECTIONS {
        let middle = f64::midpoint(low, high);
        if shortfall(middle) > 0.0 { low = middle } else { high = middle }
    }
    Some(high)
}

/// Returns the intraclass correlation over tasks of simultaneous − conjunction, which is −1,
/// 0 or 1 per configuration: (B − W) / (B + (m₀ − 1)·W) with B and W the mean squares
/// between and within tasks and m₀ the average number of configurations of a
/// task, corrected for unequal numbers. Negative values are clamped to 0. `None` with fewer
/// than two tasks, if no task has two configurations, or if all values are equal.
///
/// Source: A. Donner, A review of inference procedures for the intraclass
/// correlation coefficient, International Statistical Review 54 (1986), 67–82,
/// section 2.
pub fn task_correlation(configurations: &[Configuration]) -> Option<f64> {
    correlation(configurations, |configuration| {
        f64::from(configuration.simultaneous) - f64::from(configuration.conjunction())
    })
}

/// Returns the intraclass correlation of `value`, see [`task_correlation`].
fn correlation(
    configurations: &[Configuration],
    value: impl Fn(&Configuration) -> f64,
) -> Option<f64> {
    let mut tasks: BTreeMap<TaskRef, Vec<f64>> = BTreeMap::new();
    for configuration in configurations {
        let values = tasks.entry(configuration.task).or_default();
        values.push(value(configuration));
    }
    let (k, n) = (tasks.len() as f64, configurations.len() as f64);
    if k < 2.0 || n <= k {
        return None;
    }
    let mean = tasks.values().flatten().sum::<f64>() / n;
    let (mut between, mut within, mut squares) = (0.0, 0.0, 0.0);
    for changes in tasks.values() {
        let m = changes.len() as f64;
        let task_mean = changes.iter().sum::<f64>() / m;
        between += m * (task_mean - mean).powi(2);
        within += changes.iter().map(|c| (c - task_mean).powi(2)).sum::<f64>();
        squares += m * m;
    }
    let (between, within) = (between / (k - 1.0), within / (n - k));
    let average = (n - squares / n) / (k - 1.0);
    let total = between + (average - 1.0) * within;
    (total > 0.0).then(|| ((between - within) / total).max(0.0))
}

/// The smallest differences that a two-sided test at 5 % detects with a power of 80 %, about new
/// tasks, if outcomes are like the student's published ones; fractions. `None` if even the largest
/// possible difference is too small, or if there are too few tasks for intervals.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Detectable {
    /// Level whose outcomes are assumed: that of the nearest radius.
    pub assumed_level: Level,
    /// Difference of the success rates of two policies under simultaneous perturbation, assuming
    /// that their outcomes are independent. If they are positively correlated, smaller differences
    /// are detectable.
    pub difference: Option<f64>,
    /// Difference of I from 0.
    pub i: Option<f64>,
}

/// The student's published outcomes (`examples/student`) at a level: `S_sim`, `R_d`, and the
/// correlations within tasks of simultaneous success and of simultaneous − conjunction.
const STUDENT: [(Level, [f64; 4]); 3] = [
    (Level::L1, [0.5575, 0.185, 0.4767, 0.0188]),
    (Level::L2, [0.3025, 0.2275, 0.2783, 0.0776]),
    (Level::L3, [0.0675, 0.1125, 0.0727, 0.0265]),
];

impl Detectable {
    pub fn at(level: Level, tasks: usize, configurations: usize) -> Self {
        let distance = |other: Level| (other.radius() - level.radius()).abs();
        let nearest = |a: &Level, b: &Level| distance(*a).total_cmp(&distance(*b));
        let [mut assumed, ..] = STUDENT;
        for other in STUDENT {
            if nearest(&other.0, &assumed.0).is_lt() {
                assumed = other;
            }
        }
        let (assumed_level, [s_sim, r_d, success_correlation, change_correlation]) = assumed;
        let smallest = |r_d, task_correlation| match tasks < MIN_TASKS {
            true => None,
            false => minimum_detectable_effect(&PairedDesign {
                tasks: tasks as u32,
                configs_per_task: configurations as f64 / tasks as f64,
                r_d,
                task_correlation,
            }),
        };
        Self {
            assumed_level,
            difference: smallest(2.0 * s_sim * (1.0 - s_sim), success_correlation),
            i: smallest(r_d, change_correlation),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::outcomes::{Outcome, Record, Records};
    use benchmark::Axis;

    #[test]
    fn the_assumed_outcomes_are_the_students_published_ones() {
        let rows = include_str!("../../../examples/student/rollouts.jsonl").lines();
        let records = rows.map(|row| {
            let row: serde_json::Value = serde_json::from_str(row).expect("JSON");
            Record {
                id: row["rollout_id"].as_str().expect("an id").parse().expect("an id"),
                init_id: row["init_id"].as_u64().expect("a state") as u16,
                replicate: 0,
                outcome: Outcome::from(row["success"].as_bool().expect("an outcome")),
            }
        });
        let records = Records::new(&records.collect::<Vec<_>>()).expect("each rollout once");
        for (level, expected) in STUDENT {
            let matched = records.configurations().iter().filter(|matched| matched.level == level);
            let configurations: Vec<_> = matched.filter_map(|m| m.configuration()).collect();
            let share = |is: fn(&Configuration) -> bool| {
                let count = configurations.iter().filter(|configuration| is(configuration)).count();
                count as f64 / configurations.len() as f64
            };
            let success = correlation(&configurations, |c| f64::from(c.simultaneous));
            let figures = [
                share(|configuration| configuration.simultaneous),
                share(|configuration| configuration.simultaneous != configuration.conjunction()),
                success.expect("several tasks"),
                task_correlation(&configurations).expect("several tasks"),
            ];
            assert_eq!(figures.map(|figure| (figure * 1e4).round() / 1e4), expected, "{level}");
        }
    }

    #[test]
    fn more_tasks_detect_smaller_differences_and_too_few_none() {
        let at = |level: &str, tasks| Detectable::at(level.parse().expect("a level"), tasks, 400);
        assert!(at("L2", 100).difference < at("L2", 40).difference);
        assert!(at("L2", 100).i < at("L2", 40).i && at("L2", 40).i < Some(0.1));
        assert_eq!(at("L2", 9).i, None);
        for (level, nearest) in [("r7", Level::L3), ("r0.1", Level::L1), ("L3", Level::L3)] {
            assert_eq!(at(level, 40).assumed_level, nearest, "{level}");
        }
    }

    fn design(tasks: u32, r_d: f64, task_correlation: f64) -> PairedDesign {
        PairedDesign { tasks, configs_per_task: 10.0, r_d, task_correlation }
    }

    #[test]
    fn four_times_the_tasks_detect_half_the_effect() {
        let small = minimum_detectable_effect(&design(40, 0.27, 0.0)).expect("detectable");
        let large = minimum_detectable_effect(&design(160, 0.27, 0.0)).expect("detectable");
        assert!((small / large - 2.0).abs() < 0.02, "{small} {large}");
        // About 2.8 standard errors of the mean over 400 configurations.
        let rough = 2.8 * (0.27_f64 / 400.0).sqrt();
        assert!((small - rough).abs() < 0.002, "{small} {rough}");
    }

    #[test]
    fn correlated_configurations_detect_only_larger_effects() {
        let independent = minimum_detectable_effect(&design(40, 0.27, 0.0));
        let correlated = minimum_detectable_effect(&design(40, 0.27, 0.1));
        assert!(correlated > independent);
    }

    #[test]
    fn too_few_changed_outcomes_make_no_effect_detectable() {
        assert_eq!(minimum_detectable_effect(&design(40, 0.0, 0.0)), None);
        assert_eq!(minimum_detectable_effect(&design(2, 0.05, 0.0)), None);
    }

    fn configurations(changes: &[&[i8]]) -> Vec<Configuration> {
        let tasks = TaskRef::all().zip(changes);
        let task_configurations = |(task, changes): (TaskRef, &&[i8])| {
            let configuration = move |&change: &i8| Configuration {
                task,
                alone: [(Axis::Camera, change < 0)].into(),
                simultaneous: change > 0,
            };
            changes.iter().map(configuration).collect::<Vec<_>>()
        };
        tasks.flat_map(task_configurations).collect()
    }

    #[test]
    fn correlation_is_one_for_uniform_tasks_and_zero_for_equal_tasks() {
        let uniform = configurations(&[&[1, 1, 1], &[-1, -1, -1], &[0, 0, 0]]);
        assert_eq!(task_correlation(&uniform), Some(1.0));
        let equal = configurations(&[&[1, 0, -1], &[-1, 0, 1], &[0, 1, -1]]);
        assert_eq!(task_correlation(&equal), Some(0.0));
        assert_eq!(task_correlation(&configurations(&[&[0, 0], &[0, 0]])), None);
        assert_eq!(task_correlation(&configurations(&[&[0, 1]])), None);
    }
}
