//! How two policies, A and B, differ over the same rollouts: success rates, the
//! rollouts that only one of them solves, and how sure that is.

use std::collections::BTreeMap;

use protocol::TaskRef;
use serde::{Deserialize, Serialize};

use crate::bootstrap::{Bootstrap, Interval};
use crate::interval::{MIN_TASKS, NoInterval, shown};
use crate::mcnemar::mcnemar_exact;
use crate::outcomes::Outcome;

/// The outcomes of one rollout of both policies.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Pair {
    /// Its task: the cluster that the bootstrap draws.
    pub task: TaskRef,
    /// How it ended for A.
    pub a: Outcome,
    /// How it ended for B.
    pub b: Outcome,
}

/// The paired difference of two policies over rollouts with an outcome of both.
/// Rates and differences are fractions.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Difference {
    /// Rollouts with an outcome of both.
    pub n: u64,
    /// Tasks that they belong to.
    pub tasks: u64,
    /// Success rate of A over them.
    pub s_a: f64,
    /// Success rate of B over them.
    pub s_b: f64,
    /// `s_a` − `s_b` = (`a_only` − `b_only`) / `n`: positive where A is better.
    pub difference: f64,
    /// Its 95 % interval, by the same cluster bootstrap over tasks as
    /// [`Measures`](crate::Measures).
    pub difference_ci95: Option<Interval>,
    /// Why the interval is absent; absent where it is not.
    pub no_interval: Option<NoInterval>,
    /// Rollouts that both solve.
    pub both: u64,
    /// Rollouts that only A solves.
    pub a_only: u64,
    /// Rollouts that only B solves.
    pub b_only: u64,
    /// Rollouts that neither solves.
    pub neither: u64,
    /// Exact two-sided McNemar test of `a_only` against `b_only`.
    pub mcnemar_p: f64,
}

/// Lowest and highest difference over every outcome that quarantined rollouts
/// could have had. Both ends are reached by some outcomes.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct DifferenceBounds {
    /// Rollouts: those that are missing of neither.
    pub n: u64,
    /// Those among them that are quarantined of A or of B.
    pub affected: u64,
    /// Range of `difference`.
    pub difference: [f64; 2],
}

/// What is counted of the rollouts of one task.
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
    /// The differences of several sets of pairs, each none where no rollout has
    /// an outcome of both. The order of pairs changes nothing. All sets share
    /// one pass of resampling, where they have as many tasks as one another.
    pub fn of_each(sets: &[Vec<Pair>], bootstrap: &Bootstrap) -> Vec<Option<Self>> {
        let clusters: Vec<Vec<Tally>> = sets.iter().map(|pairs| of_tasks(pairs)).collect();
        let mut of_size: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
        for (set, tasks) in clusters.iter().enumerate() {
            if tasks.len() >= MIN_TASKS {
                of_size.entry(tasks.len()).or_default().push(set);
            }
        }
        let mut intervals: Vec<Option<Interval>> = vec![None; sets.len()];
        for (tasks, members) in of_size {
            let made = bootstrap.intervals_of_many(tasks, members.len(), |draws, values| {
                for (value, &member) in values.iter_mut().zip(&members) {
                    *value = drawn(&clusters[member], draws);
                }
            });
            for (member, interval) in members.iter().zip(made.into_iter().flatten()) {
                intervals[*member] = Some(interval);
            }
        }
        let each = clusters.iter().zip(intervals);
        each.map(|(clusters, interval)| Self::new(clusters, interval))
            .collect()
    }

    fn new(clusters: &[Tally], interval: Option<Interval>) -> Option<Self> {
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
        let interval = shown(clusters.len(), interval);
        Some(Self {
            n: total.n(),
            tasks: clusters.len() as u64,
            s_a: total.rate(total.both + total.a_only),
            s_b: total.rate(total.both + total.b_only),
            difference: drawn(clusters, &vec![1; clusters.len()]),
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
    /// Over some pairs; none where none is quarantined of either policy.
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

/// The tally of every task that has a pair with both outcomes, in the tasks'
/// order.
fn of_tasks(pairs: &[Pair]) -> Vec<Tally> {
    let mut tasks: BTreeMap<TaskRef, Tally> = BTreeMap::new();
    for Pair { task, a, b } in pairs {
        if let (Some(a), Some(b)) = (a.success(), b.success()) {
            tasks.entry(*task).or_default().add(a, b);
        }
    }
    tasks.into_values().collect()
}

/// The difference over tasks as often as they were drawn.
fn drawn(clusters: &[Tally], draws: &[u32]) -> f64 {
    let (mut net, mut n) = (0.0, 0.0);
    for (task, &times) in clusters.iter().zip(draws) {
        let times = f64::from(times);
        net += times * (task.a_only as f64 - task.b_only as f64);
        n += times * task.n() as f64;
    }
    net / n
}
