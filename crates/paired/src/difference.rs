//! Differences between two policies, A and B, over the same rollouts: success rates, the
//! rollouts that only one of them solves, and intervals of the difference.

use std::collections::{BTreeMap, BTreeSet};

use benchmark::{Directions, TaskRef};
use serde::{Deserialize, Serialize};

use crate::bootstrap::{Bootstrap, Interval, MIN_TASKS, NoInterval, interval_or_reason};
use crate::inference::estimate::{Estimate, Scale, defined};
use crate::inference::hypotheses::{equivalence_p, holm, max_t, mcnemar_exact, sign_flip_p};
use crate::inference::sample::{Row, Sample};
use crate::outcomes::Outcome;

/// The outcomes of one rollout of both policies.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Pair {
    /// Task of the rollout: the cluster that the bootstrap draws.
    pub task: TaskRef,
    /// Configuration, or initial state of a nominal rollout.
    pub number: u16,
    pub a: Outcome,
    pub b: Outcome,
}

/// The paired difference of two policies over the rollouts with an outcome for both.
/// Rates and differences are fractions.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Difference {
    /// Rollouts with an outcome for both policies.
    pub n: u64,
    pub tasks: u64,
    /// Success rate of A over these rollouts.
    pub s_a: f64,
    /// Success rate of B over these rollouts.
    pub s_b: f64,
    /// `s_a` − `s_b` = (`a_only` − `b_only`) / `n`: positive if A is better.
    pub difference: f64,
    /// 95 % interval of `difference`, by the same cluster bootstrap over tasks as
    /// [`Measures`](crate::Measures).
    pub difference_ci95: Option<Interval>,
    pub no_interval: Option<NoInterval>,
    /// Rollouts that both policies solve.
    pub both: u64,
    /// Rollouts that only A solves.
    pub a_only: u64,
    /// Rollouts that only B solves.
    pub b_only: u64,
    /// Rollouts that neither policy solves.
    pub neither: u64,
    /// Exact two-sided McNemar test of `a_only` against `b_only`.
    pub mcnemar_p: f64,
    /// The difference with an interval for each target of inference. For nominal rollouts,
    /// initial states take the place of directions.
    pub estimate: Estimate,
    /// Exact two-sided sign-flip p-value over tasks.
    pub sign_flip_p: f64,
    /// `sign_flip_p` after Holm's correction for the rows of the comparison.
    pub holm_p: f64,
    /// 95 % interval that holds simultaneously with those of all other rows.
    pub simultaneous_ci95: Option<Interval>,
    /// p-value of the hypothesis that the difference lies beyond ±5 points, see
    /// [`equivalence_p`].
    pub equivalence_p: Option<f64>,
    /// Comparison of the policies by task.
    pub profile: Profile,
}

/// Comparison of two policies by task.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Profile {
    pub tasks: BTreeMap<TaskRef, f64>,
    pub a_better: u64,
    pub b_better: u64,
    /// Probability of improvement with intervals: the probability that A does better than B
    /// in a task drawn at random, where ties count half. The estimate has no interval for the
    /// tasks of the sample, and none for new directions if tasks share their directions.
    ///
    /// Source: R. Agarwal et al., Deep reinforcement learning at the edge of the
    /// statistical precipice, NeurIPS 2021.
    pub improvement: Estimate,
}

/// Lowest and highest difference over all possible outcomes of quarantined rollouts. The
/// bounds are sharp.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct DifferenceBounds {
    /// Rollouts that are missing for neither policy.
    pub n: u64,
    /// Rollouts counted in `n` that are quarantined for A or for B.
    pub affected: u64,
    pub difference: [f64; 2],
}

/// Counts of one task's rollouts by the policies that succeed.
#[derive(Clone, Copy, Debug, Default)]
struct Tally {
    both: u64,
    a_only: u64,
    b_only: u64,
    neither: u64,
}

impl Tally {
    fn add(&mut self, a: bool, b: bool) {
        *match (a, b) {
            (true, true) => &mut self.both,
            (true, false) => &mut self.a_only,
            (false, true) => &mut self.b_only,
            (false, false) => &mut self.neither,
        } += 1;
    }

    fn n(&self) -> u64 {
        self.both + self.a_only + self.b_only + self.neither
    }

    fn rate(&self, count: u64) -> f64 {
        count as f64 / self.n() as f64
    }
}

impl Difference {
    /// Computes the difference of each set of pairs, where all tasks share the same directions;
    /// `None` for a set without a rollout that has an outcome for both policies. The order of
    /// pairs does not matter. Sets with the same number of tasks share one pass of resampling.
    pub fn of_each(sets: &[Vec<Pair>], bootstrap: &Bootstrap) -> Vec<Option<Self>> {
        Self::of_sets(sets, &vec![Directions::Shared; sets.len()], bootstrap)
    }

    /// Computes the difference of each set of pairs, as [`Difference::of_each`] does.
    /// `directions` has one entry per set.
    pub(crate) fn of_sets(
        sets: &[Vec<Pair>],
        directions: &[Directions],
        bootstrap: &Bootstrap,
    ) -> Vec<Option<Self>> {
        let clusters: Vec<Vec<Tally>> = sets.iter().map(|pairs| tallies(pairs)).collect();
        let mut sets_by_size: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
        for (set, tasks) in clusters.iter().enumerate() {
            if tasks.len() >= MIN_TASKS {
                sets_by_size.entry(tasks.len()).or_default().push(set);
            }
        }
        let mut intervals: Vec<Option<Interval>> = vec![None; sets.len()];
        for (tasks, members) in sets_by_size {
            let computed = bootstrap.intervals_of_many(tasks, members.len(), |draws, values| {
                for (value, &member) in values.iter_mut().zip(&members) {
                    *value = resampled_difference(&clusters[member], draws);
                }
            });
            for (member, interval) in members.iter().zip(computed.into_iter().flatten()) {
                intervals[*member] = Some(interval);
            }
        }
        let each = sets.iter().zip(directions).zip(&clusters).zip(intervals);
        let mut differences: Vec<Option<Self>> = each
            .map(|(((pairs, directions), clusters), interval)| {
                Self::new(pairs, *directions, clusters, interval)
            })
            .collect();
        correct_for_multiplicity(&mut differences, bootstrap);
        differences
    }

    fn new(
        pairs: &[Pair],
        directions: Directions,
        clusters: &[Tally],
        interval: Option<Interval>,
    ) -> Option<Self> {
        let mut total = Tally::default();
        for task in clusters {
            total.both += task.both;
            total.a_only += task.a_only;
            total.b_only += task.b_only;
            total.neither += task.neither;
        }
        if total.n() == 0 {
            return None;
        }
        let interval = interval_or_reason(clusters.len(), interval);
        let net = |task: &Tally| task.a_only as i64 - task.b_only as i64;
        let sign_flip_p = sign_flip_p(&clusters.iter().map(net).collect::<Vec<_>>());
        let estimate = estimate(pairs, directions)?;
        Some(Self {
            equivalence_p: equivalence_p(&estimate),
            estimate,
            sign_flip_p,
            holm_p: sign_flip_p,
            simultaneous_ci95: None,
            profile: Profile::new(pairs, directions)?,
            n: total.n(),
            tasks: clusters.len() as u64,
            s_a: total.rate(total.both + total.a_only),
            s_b: total.rate(total.both + total.b_only),
            difference: resampled_difference(clusters, &vec![1; clusters.len()]),
            difference_ci95: interval.ok(),
            no_interval: interval.err(),
            both: total.both,
            a_only: total.a_only,
            b_only: total.b_only,
            neither: total.neither,
            mcnemar_p: mcnemar_exact(total.a_only, total.b_only),
        })
    }
}

impl DifferenceBounds {
    /// Computes the bounds over the pairs without a missing rollout; `None` if `affected` is 0.
    pub fn of(pairs: &[Pair]) -> Option<Self> {
        let (mut n, mut affected, mut lowest, mut highest) = (0_u64, 0_u64, 0_i64, 0_i64);
        for Pair { a, b, .. } in pairs {
            let (Some([a_low, a_high]), Some([b_low, b_high])) =
                (a.possible_successes(), b.possible_successes())
            else {
                continue;
            };
            n += 1;
            affected += u64::from(a_low != a_high || b_low != b_high);
            lowest += a_low - b_high;
            highest += a_high - b_low;
        }
        (affected > 0).then(|| Self {
            n,
            affected,
            difference: [lowest, highest].map(|sum| sum as f64 / n as f64),
        })
    }
}

/// Returns the tally of each task that has a rollout with an outcome for both policies, ordered by
/// task.
fn tallies(pairs: &[Pair]) -> Vec<Tally> {
    let mut tasks: BTreeMap<TaskRef, Tally> = BTreeMap::new();
    for Pair { task, a, b, .. } in pairs {
        if let (Some(a), Some(b)) = (a.success(), b.success()) {
            tasks.entry(*task).or_default().add(a, b);
        }
    }
    tasks.into_values().collect()
}

/// Returns the difference over tasks, each weighted by the number of times that the resampling
/// drew the task.
fn resampled_difference(clusters: &[Tally], draws: &[u32]) -> f64 {
    let (mut net, mut n) = (0.0, 0.0);
    for (task, &times) in clusters.iter().zip(draws) {
        let times = f64::from(times);
        net += times * (task.a_only as f64 - task.b_only as f64);
        n += times * task.n() as f64;
    }
    net / n
}

/// Returns a row for each rollout with an outcome for both policies, with the columns 1 and A − B.
fn rows(pairs: &[Pair]) -> Vec<Row> {
    let rows = pairs.iter().filter_map(|pair| {
        let number = |outcome: Outcome| Some(f64::from(u8::from(outcome.success()?)));
        Some(Row {
            task: pair.task,
            direction: pair.number,
            values: vec![1.0, number(pair.a)? - number(pair.b)?],
        })
    });
    rows.collect()
}

fn estimate(pairs: &[Pair], directions: Directions) -> Option<Estimate> {
    let rows = rows(pairs);
    let sample = Sample::new(&rows, directions)?;
    Estimate::of(&sample, Scale::Difference, &|sums| sums[1] / sums[0])
}

impl Profile {
    /// Returns the tasks in which A is farthest behind B and farthest ahead of it, each with
    /// A − B; of tasks with equal differences, the first.
    pub fn extremes(&self) -> Option<[(TaskRef, f64); 2]> {
        let pick =
            |extreme: Option<(TaskRef, f64)>, (&task, &change): (&TaskRef, &f64), sign: f64| {
                match extreme {
                    Some((_, value)) if sign * value <= sign * change => extreme,
                    _ => Some((task, change)),
                }
            };
        let [least, most] = [1.0, -1.0]
            .map(|sign| self.tasks.iter().fold(None, |extreme, task| pick(extreme, task, sign)));
        Some([least?, most?])
    }

    fn new(pairs: &[Pair], directions: Directions) -> Option<Self> {
        let mut sums: BTreeMap<TaskRef, [f64; 2]> = BTreeMap::new();
        for row in rows(pairs) {
            let sum = sums.entry(row.task).or_default();
            sum[0] += row.values[0];
            sum[1] += row.values[1];
        }
        let tasks: BTreeMap<TaskRef, f64> =
            sums.into_iter().map(|(task, [n, net])| (task, net / n)).collect();
        let better = |sign: f64| tasks.values().filter(|change| **change * sign > 0.0).count();
        let rows: Vec<Row> = tasks
            .iter()
            .map(|(&task, &change)| Row {
                task,
                direction: 0,
                values: vec![
                    1.0,
                    if change == 0.0 { 0.5 } else { f64::from(u8::from(change > 0.0)) },
                ],
            })
            .collect();
        let sample = Sample::new(&rows, Directions::Own)?;
        let improvement = Estimate::of(&sample, Scale::Share, &|sums| sums[1] / sums[0]);
        let mut improvement = defined(improvement);
        if directions == Directions::Shared {
            // The spread of tasks under the same directions says nothing about other directions.
            improvement.new_tasks_and_directions = None;
        }
        Some(Self {
            a_better: better(1.0) as u64,
            b_better: better(-1.0) as u64,
            improvement,
            tasks,
        })
    }
}

/// Corrects the rows of a comparison for multiplicity: Holm's p-values and max-t intervals.
fn correct_for_multiplicity(differences: &mut [Option<Difference>], bootstrap: &Bootstrap) {
    let mut present: Vec<&mut Difference> = differences.iter_mut().flatten().collect();
    let p_values: Vec<f64> = present.iter().map(|difference| difference.sign_flip_p).collect();
    for (difference, p) in present.iter_mut().zip(holm(&p_values)) {
        difference.holm_p = p;
    }
    let tasks: BTreeSet<TaskRef> =
        present.iter().flat_map(|difference| difference.profile.tasks.keys().copied()).collect();
    let tasks: Vec<TaskRef> = tasks.into_iter().collect();
    let strata = strata(&tasks);
    // The pseudo-value of a task is its difference minus the mean of its stratum. It equals the
    // jackknife's only if all tasks have the same number of rollouts.
    let pseudo = present.iter().map(|difference| {
        let by_task = &difference.profile.tasks;
        let mut values = Vec::with_capacity(tasks.len());
        let mut remaining = tasks.as_slice();
        for &size in &strata {
            let (stratum, others) = remaining.split_at(size);
            remaining = others;
            let changes: Vec<f64> =
                stratum.iter().filter_map(|task| by_task.get(task).copied()).collect();
            let mean = changes.iter().sum::<f64>() / changes.len() as f64;
            let value = |task| by_task.get(task).map_or(0.0, |change| change - mean);
            values.extend(stratum.iter().map(value));
        }
        values
    });
    let Some(critical) = max_t(&pseudo.collect::<Vec<_>>(), &strata, bootstrap) else {
        return;
    };
    for difference in present {
        difference.simultaneous_ci95 = difference.estimate.standard_error.map(|error| {
            let half = critical * error;
            let value = difference.difference;
            [(value - half).max(-1.0), (value + half).min(1.0)]
        });
    }
}

/// Returns the number of tasks in each stratum, as for the standard errors: each suite is a
/// stratum, or all tasks are a single stratum if any suite has only one task. `tasks` are ordered
/// by suite.
fn strata(tasks: &[TaskRef]) -> Vec<usize> {
    let by_suite = tasks.chunk_by(|a, b| a.suite() == b.suite());
    let by_suite: Vec<usize> = by_suite.map(<[TaskRef]>::len).collect();
    if by_suite.contains(&1) { vec![tasks.len()] } else { by_suite }
}
