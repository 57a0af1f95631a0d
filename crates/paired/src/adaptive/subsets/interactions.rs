//! Interactions of the axes over configurations whose whole lattice was run.
//!
//! v(A) is the success rate under the subset A of the axes: a set function, or
//! a cooperative game with the axes as players and success as the worth. Its
//! Möbius transform is the effect of a set of axes beyond that of its subsets; its
//! Shapley values divide the change from nominal to simultaneous among the axes.
//! All are linear in counts of successes, so they are computed in integers and
//! add up exactly.

use std::collections::BTreeMap;
use std::ops::Range;

use crate::{Bootstrap, Interval, NoInterval, intervals_of_many, max_t};
use benchmark::{Axis, AxisSet, TaskRef};
use serde::{Deserialize, Serialize};

/// All outcomes of one configuration in one replicate.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CompleteLattice {
    task: TaskRef,
    full: AxisSet,
    /// Successes by subset, in order.
    successes: Vec<bool>,
}

/// Error: a subset of the axes has no outcome.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("axes {full}: {set} has no outcome")]
pub struct IncompleteLattice {
    pub full: AxisSet,
    /// The first subset without an outcome.
    pub set: AxisSet,
}

impl CompleteLattice {
    pub fn new(
        task: TaskRef,
        full: AxisSet,
        outcome: impl Fn(AxisSet) -> Option<bool>,
    ) -> Result<Self, IncompleteLattice> {
        let subsets = full.subsets().into_iter();
        let successes = subsets
            .map(|set| outcome(set).ok_or(IncompleteLattice { full, set }))
            .collect::<Result<_, _>>()?;
        Ok(Self { task, full, successes })
    }
}

/// An exact number with its interval.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Estimate {
    /// Numerator of the exact value. All estimates of one kind share a denominator, so that
    /// their numerators add up.
    pub numerator: i64,
    /// Denominator of the exact value, not reduced.
    pub denominator: i64,
    /// `numerator` / `denominator`.
    pub value: f64,
    /// 95 % interval by resampling tasks ([`Bootstrap`]).
    pub ci95: Option<Interval>,
    pub no_interval: Option<NoInterval>,
    /// 95 % interval that holds simultaneously with the intervals of all other estimates of its
    /// kind: Möbius interactions, Shapley values or pairs. Absent for success and sizes, if `ci95`
    /// is absent, and if [`max_t`] returns `None`.
    pub simultaneous_ci95: Option<Interval>,
}

/// Success by subset, and the effects and interactions of the axes derived from it. All values
/// are success rates or differences of them, as fractions; "over `n`" names the denominator.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Interactions {
    pub full: AxisSet,
    pub n: u64,
    pub tasks: u64,
    /// v(A): the success rate under each subset, over `n`.
    pub success: BTreeMap<AxisSet, Estimate>,
    /// The Möbius transform m(A) = Σ_{B⊆A} (−1)^{|A|−|B|} v(B) of each subset but
    /// the empty one, over `n`. For one axis it is the effect of that axis alone. For a
    /// pair it is the effect of the pair beyond the sum of the two single effects, negative
    /// if the pair does more harm than that sum. v(∅) + Σ_{A≠∅} m(A) = v(full).
    ///
    /// Source: J. C. Harsanyi, A simplified bargaining model for the n-person
    /// cooperative game, International Economic Review 4 (1963), 194–220
    /// (*dividends*).
    pub moebius: BTreeMap<AxisSet, Estimate>,
    /// For each number of axes, the sum of m over the subsets of that size, over
    /// `n`: the contributions of single axes, of pairs, of triples, and so on. They add up
    /// to v(full) − v(∅).
    pub sizes: BTreeMap<usize, Estimate>,
    /// The Shapley value of each axis, over 60·`n`: its effect, averaged over all
    /// orders in which the axes can be added; equivalently Σ_{A∋i} m(A) / |A|. They sum
    /// to v(full) − v(∅), simultaneous minus nominal success.
    ///
    /// Source: L. S. Shapley, A value for n-person games, in: Contributions to the
    /// Theory of Games II (1953), 307–317.
    pub shapley: BTreeMap<Axis, Estimate>,
    /// The Shapley interaction index of each pair, over 60·`n`: the change of one axis's
    /// effect by the presence of the other, averaged over the subsets of further axes
    /// present; Σ_{A⊇{i,j}} m(A) / (|A| − 1). The sum of indices has no meaning.
    ///
    /// Source: M. Grabisch and M. Roubens, An axiomatic approach to the concept of
    /// interaction among players in cooperative games, International Journal of Game
    /// Theory 28 (1999), 547–565, definition 2 and its form in Möbius coefficients.
    pub pairs: BTreeMap<AxisSet, Estimate>,
}

/// Common multiple of 1 to 6, so that division by |A| or |A| − 1 is exact for up to six axes.
const SIXTIETHS: i64 = 60;

impl Interactions {
    /// Computes the interactions over some configurations; `None` without a configuration.
    /// The order of configurations does not matter.
    ///
    /// # Panics
    /// If two configurations have different axes.
    pub fn of(configurations: &[CompleteLattice], bootstrap: &Bootstrap) -> Option<Self> {
        let full = configurations.first()?.full;
        let subsets = full.subsets();
        let clusters = Tally::of_tasks(configurations, full);
        let total = Tally::drawn(&clusters, &vec![1; clusters.len()]);
        let point = Numerators::new(&subsets, &total.successes);
        let intervals = intervals_of_many(
            bootstrap,
            clusters.len(),
            point.with_factors().count(),
            |draws, values| {
                let drawn = Tally::drawn(&clusters, draws);
                let numerators = Numerators::new(&subsets, &drawn.successes);
                for (value, (numerator, scale)) in values.iter_mut().zip(numerators.with_factors())
                {
                    *value = numerator as f64 / (scale * drawn.n) as f64;
                }
            },
        );
        let estimate = |((numerator, scale), interval): ((i64, i64), Result<Interval, _>)| {
            let denominator = scale * total.n;
            Estimate {
                numerator,
                denominator,
                value: numerator as f64 / denominator as f64,
                ci95: interval.ok(),
                no_interval: interval.err(),
                simultaneous_ci95: None,
            }
        };
        let mut estimates: Vec<Estimate> =
            point.with_factors().zip(intervals).map(estimate).collect();
        let deviations = deviations(&clusters, &subsets, &estimates);
        for family in point.families() {
            let deviations = &deviations[family.clone()];
            set_simultaneous_intervals(&mut estimates[family], deviations, bootstrap);
        }
        let mut estimates = estimates.into_iter();
        let success = subsets.iter().copied().zip(estimates.by_ref()).collect();
        let not_empty = subsets.iter().copied().filter(|set| !set.is_empty());
        let moebius = not_empty.zip(estimates.by_ref()).collect();
        let sizes = (1..=full.len()).zip(estimates.by_ref()).collect();
        let shapley = full.axes().zip(estimates.by_ref()).collect();
        let pairs = subsets.iter().copied().filter(|set| set.len() == 2);
        let pairs = pairs.zip(estimates.by_ref()).collect();
        Some(Self {
            full,
            n: total.n as u64,
            tasks: clusters.len() as u64,
            success,
            moebius,
            sizes,
            shapley,
            pairs,
        })
    }
}

/// Returns the deviation of each task's contribution from its expectation, a row per estimate:
/// (N − θ·m) / mean m, with θ the estimate, N the task's numerator divided by the factor of
/// [`Numerators::with_factors`], and m the task's number of configurations. Rows sum to 0.
fn deviations(clusters: &[Tally], subsets: &[AxisSet], estimates: &[Estimate]) -> Vec<Vec<f64>> {
    let tasks = clusters.len() as f64;
    let mean = clusters.iter().map(|task| task.n).sum::<i64>() as f64 / tasks;
    let mut rows = vec![Vec::with_capacity(clusters.len()); estimates.len()];
    for task in clusters {
        let numerators = Numerators::new(subsets, &task.successes);
        let values = rows.iter_mut().zip(estimates).zip(numerators.with_factors());
        for ((row, estimate), (numerator, scale)) in values {
            let value = numerator as f64 / scale as f64;
            row.push((value - estimate.value * task.n as f64) / mean);
        }
    }
    rows
}

fn set_simultaneous_intervals(
    estimates: &mut [Estimate],
    deviations: &[Vec<f64>],
    bootstrap: &Bootstrap,
) {
    // All tasks form a single stratum, as for the standard errors below.
    let tasks = deviations.first().map_or(0, Vec::len);
    let Some(critical) = max_t(deviations, &[tasks], bootstrap) else {
        return;
    };
    for (estimate, row) in estimates.iter_mut().zip(deviations) {
        let tasks = row.len() as f64;
        let squares: f64 = row.iter().map(|value| value * value).sum();
        let half = critical * (squares / (tasks * (tasks - 1.0))).sqrt();
        let interval = [estimate.value - half, estimate.value + half];
        estimate.simultaneous_ci95 = estimate.ci95.map(|_| interval);
    }
}

/// Counts of some configurations, additive over tasks.
struct Tally {
    n: i64,
    /// Successes by subset, in order.
    successes: Vec<i64>,
}

impl Tally {
    fn new(full: AxisSet) -> Self {
        Self { n: 0, successes: vec![0; 1 << full.len()] }
    }

    /// Returns the tally of each task, ordered by task.
    fn of_tasks(configurations: &[CompleteLattice], full: AxisSet) -> Vec<Self> {
        let mut clusters: BTreeMap<TaskRef, Self> = BTreeMap::new();
        for lattice in configurations {
            assert_eq!(lattice.full, full, "all configurations have the same axes");
            let tally = clusters.entry(lattice.task).or_insert_with(|| Self::new(full));
            tally.n += 1;
            for (count, &success) in tally.successes.iter_mut().zip(&lattice.successes) {
                *count += i64::from(success);
            }
        }
        clusters.into_values().collect()
    }

    /// Sums the tallies, each weighted by the number of times that its task was drawn.
    fn drawn(clusters: &[Self], draws: &[u32]) -> Self {
        let mut drawn = Self {
            n: 0,
            successes: vec![0; clusters.first().map_or(0, |first| first.successes.len())],
        };
        for (tally, &times) in clusters.iter().zip(draws) {
            drawn.n += i64::from(times) * tally.n;
            for (count, of_task) in drawn.successes.iter_mut().zip(&tally.successes) {
                *count += i64::from(times) * of_task;
            }
        }
        drawn
    }
}

/// The numerators of all estimates of [`Interactions`].
struct Numerators {
    success: Vec<i64>,
    moebius: Vec<i64>,
    sizes: Vec<i64>,
    /// Shapley values in 60ths.
    shapley: Vec<i64>,
    /// Pair interactions in 60ths.
    pairs: Vec<i64>,
}

impl Numerators {
    fn new(subsets: &[AxisSet], successes: &[i64]) -> Self {
        let sets = || subsets.iter().copied().zip(successes);
        let coefficient = |set: AxisSet| -> i64 {
            let subsets = sets().filter(|(subset, _)| subset.is_subset(set));
            let signed = subsets.map(|(subset, count)| match (set.len() - subset.len()) % 2 {
                0 => *count,
                _ => -count,
            });
            signed.sum()
        };
        let moebius: Vec<(AxisSet, i64)> = subsets
            .iter()
            .filter(|set| !set.is_empty())
            .map(|&set| (set, coefficient(set)))
            .collect();
        // Σ_{B⊇A} m(B) / (|B| − |A| + 1): Shapley value and interaction index.
        let index = |set: AxisSet| -> i64 {
            let supersets = moebius.iter().filter(|(superset, _)| set.is_subset(*superset));
            let shares = supersets.map(|(superset, coefficient)| {
                coefficient * (SIXTIETHS / (superset.len() - set.len() + 1) as i64)
            });
            shares.sum()
        };
        let of_size = |axes: usize| subsets.iter().filter(move |set| set.len() == axes);
        let largest_size = subsets.last().map_or(0, |full| full.len());
        let sum = |axes: usize| -> i64 {
            let of_size = moebius.iter().filter(|(set, _)| set.len() == axes);
            of_size.map(|(_, coefficient)| coefficient).sum()
        };
        Self {
            success: successes.to_vec(),
            sizes: (1..=largest_size).map(sum).collect(),
            shapley: of_size(1).map(|&set| index(set)).collect(),
            pairs: of_size(2).map(|&set| index(set)).collect(),
            moebius: moebius.into_iter().map(|(_, coefficient)| coefficient).collect(),
        }
    }

    /// Returns the index ranges in [`Self::with_factors`] of the families with simultaneous
    /// intervals: Möbius interactions, Shapley values, pairs.
    fn families(&self) -> [Range<usize>; 3] {
        let moebius = self.success.len()..self.success.len() + self.moebius.len();
        let shapley = moebius.end + self.sizes.len();
        let pairs = shapley + self.shapley.len();
        [moebius, shapley..pairs, pairs..pairs + self.pairs.len()]
    }

    /// Returns the numerators of all estimates in order, each with the factor by which `n` is
    /// multiplied to give its denominator.
    fn with_factors(&self) -> impl Iterator<Item = (i64, i64)> {
        let rates = self.success.iter().chain(&self.moebius).chain(&self.sizes);
        let sixtieths = self.shapley.iter().chain(&self.pairs);
        rates
            .map(|&numerator| (numerator, 1))
            .chain(sixtieths.map(|&numerator| (numerator, SIXTIETHS)))
    }
}
