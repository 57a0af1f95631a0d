//! Survival curves: the share of configurations that still succeed at a radius.
//!
//! A configuration *survives* up to a radius if it succeeds nominally and at every radius that was
//! run, up to and including this one. The curve starts at the nominal success rate over all
//! configurations; those that fail nominally survive to no radius. The curve is therefore
//! comparable with a report's rates, and equal to them at the levels of the grid if no
//! configuration recovers from a failure.
//!
//! The position of a threshold within its bracket is unknown. The curve assumes a uniform
//! distribution; the *band* covers every possible position. At a radius that was run for
//! every configuration, curve and band coincide. A threshold without a known failure is
//! right-censored at the largest success: beyond this radius the curve treats the configuration
//! like the configurations that survived so far, and the band covers all possibilities.
//!
//! Intervals cover the band: from the lower end of an interval of its minimum to the upper
//! end of an interval of its maximum, over resampled tasks. They hold for any position of
//! the thresholds in their brackets (J. L. Horowitz, C. F. Manski, Nonparametric analysis of
//! randomized experiments with missing covariate and outcome data, Journal of the American
//! Statistical Association 95 (2000), 77–84).

use std::collections::BTreeMap;

use crate::{Bootstrap, Interval, NoInterval, intervals_of_many};
use benchmark::{Condition, Level, TaskRef};
use serde::Serialize;

use super::search::Search;
use super::threshold::{Finding, Threshold};

const HALF: f64 = 0.5;
/// Largest number of fixed-point iterations for censored configurations.
const MAX_ITERATIONS: u32 = 1_000;
/// Change of a share below which the iteration has converged.
const CONVERGED: f64 = 1e-12;

/// Survival curve of configurations over the radius, under one condition.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Curve {
    pub condition: Condition,
    /// Radii that are run for every configuration.
    pub grid: Vec<f64>,
    /// Largest radius of the grid, where the curve ends.
    pub largest_radius: f64,
    /// True if radii between those of the grid are run, that is, if language is not
    /// perturbed.
    pub is_bisected: bool,
    /// Number of configurations in the curve: those that fail nominally, and those that succeed
    /// nominally with no rollout of the grid missing; outcomes of the grid may be quarantined.
    pub n: u64,
    pub tasks: usize,
    /// Number of excluded configurations: a rollout of the grid is missing, or the nominal rollout
    /// has no outcome.
    pub left_out: u64,
    pub nominal_fails: u64,
    /// Configurations that survive up to the largest radius, where their threshold is
    /// censored.
    pub beyond: u64,
    /// Configurations that are censored below the largest radius because its outcome is
    /// quarantined.
    pub censored: u64,
    /// Configurations that succeed again at a radius beyond a failure, including excluded ones.
    pub not_monotone: u64,
    /// Points of the curve from radius 0 on, with linear interpolation between them. Empty if `n`
    /// is 0.
    pub points: Vec<Point>,
    /// Radius at which half of the configurations survive.
    pub half_success: HalfSuccess,
}

/// A point of a curve. Shares are fractions of the configurations.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Point {
    pub radius: f64,
    /// The level of this radius, if the protocol has one.
    pub level: Option<Level>,
    pub survival: f64,
    /// The smallest and the largest share that the brackets allow.
    pub band: [f64; 2],
    /// Interval of `survival` by resampling tasks, valid for any position of the thresholds
    /// in their brackets; absent if resampling cannot give one.
    pub ci95: Option<Interval>,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct HalfSuccess {
    /// Radius at which the curve crosses one half; `None` without a configuration, if fewer than
    /// half succeed nominally, if more than half survive up to the largest radius, or if the
    /// condition perturbs language, so that brackets are not narrowed.
    pub radius: Option<f64>,
    /// Range of the radius over all positions of the thresholds in their brackets; `None` without a
    /// configuration.
    pub bounds: Option<Interval>,
    /// Interval by resampling tasks, including the uncertainty of brackets. A lower end at 0 means
    /// that possibly no more than half survive beyond radius 0; an upper end at the largest radius
    /// means that possibly half survive up to every smaller one.
    pub ci95: Option<Interval>,
    pub no_interval: Option<NoInterval>,
}

#[derive(Clone, Copy, Debug)]
enum Survives {
    /// The configuration fails nominally.
    Never,
    /// The configuration survives up to a radius in this bracket.
    Until([f64; 2]),
    /// The configuration survives up to the largest radius.
    Throughout,
    /// The configuration survives up to this radius; outcomes beyond are unknown.
    AtLeast(f64),
}

impl Survives {
    fn from_finding(finding: &Finding) -> Option<Self> {
        let survives = match finding.threshold {
            Threshold::NominalFails => Some(Self::Never),
            Threshold::Between { succeeds_at, fails_at } => {
                Some(Self::Until([succeeds_at.radius(), fails_at.radius()]))
            }
            Threshold::Beyond => Some(Self::Throughout),
            Threshold::Open { succeeds_at } => Some(Self::AtLeast(succeeds_at.radius())),
            Threshold::NominalUnknown => None,
        };
        survives.filter(|_| finding.is_grid_complete)
    }

    /// Returns the probability of survival up to a radius for a threshold that is uniform in its
    /// bracket. `curve` returns the share of all configurations that survive up to a radius. Beyond
    /// the radius of censoring, the probability is this share, conditional on survival up to the
    /// radius of censoring.
    fn expected(self, radius: f64, curve: impl Fn(f64) -> f64) -> f64 {
        match self {
            Self::Never => 0.0,
            Self::Until([low, high]) => ((high - radius) / (high - low)).clamp(0.0, 1.0),
            Self::Throughout => 1.0,
            Self::AtLeast(until) if radius <= until => 1.0,
            Self::AtLeast(until) => match curve(until) {
                share if share > 0.0 => curve(radius) / share,
                _ => 0.0,
            },
        }
    }

    /// Returns two flags: the configuration certainly survives up to a radius, and possibly does.
    fn bounds(self, radius: f64) -> [bool; 2] {
        match self {
            Self::Never => [false; 2],
            Self::Until([low, high]) => [radius <= low, radius < high],
            Self::Throughout => [true; 2],
            Self::AtLeast(until) => [radius <= until, true],
        }
    }

    /// Returns the known ends of the bracket.
    fn ends(self) -> impl Iterator<Item = f64> {
        let ends = match self {
            Self::Until(ends) => [Some(ends[0]), Some(ends[1])],
            Self::AtLeast(until) => [Some(until), None],
            Self::Never | Self::Throughout => [None; 2],
        };
        ends.into_iter().flatten()
    }
}

impl Curve {
    pub(crate) fn new(
        condition: Condition,
        search: &Search,
        findings: &[(TaskRef, Finding)],
        bootstrap: &Bootstrap,
    ) -> Self {
        let thresholds = findings.iter();
        let thresholds = thresholds
            .filter_map(|(task, finding)| Some((*task, Survives::from_finding(finding)?)));
        let thresholds: Vec<(TaskRef, Survives)> = thresholds.collect();
        let count = |matches: fn(&Survives) -> bool| {
            thresholds.iter().filter(|(_, survives)| matches(survives)).count()
        };
        let recovers = |(_, finding): &&(TaskRef, Finding)| !finding.recovers_at.is_empty();
        let largest_radius = search.largest().map_or(0.0, Level::radius);
        let clusters = Clusters::new(&thresholds, search);
        let (points, mut half_success) = clusters.points(&thresholds, bootstrap);
        half_success.radius = half_success.radius.filter(|_| search.tolerance.is_some());
        Self {
            condition,
            grid: search.grid.iter().map(|level| level.radius()).collect(),
            largest_radius,
            is_bisected: search.tolerance.is_some(),
            n: thresholds.len() as u64,
            tasks: clusters.tasks.len(),
            left_out: (findings.len() - thresholds.len()) as u64,
            nominal_fails: count(|survives| matches!(survives, Survives::Never)) as u64,
            beyond: count(|survives| matches!(survives, Survives::Throughout)) as u64,
            censored: count(|survives| matches!(survives, Survives::AtLeast(_))) as u64,
            not_monotone: findings.iter().filter(recovers).count() as u64,
            points,
            half_success,
        }
    }

    /// Returns the point at a radius of the grid.
    pub fn at(&self, radius: f64) -> Option<&Point> {
        self.points.iter().find(|point| point.radius == radius)
    }
}

/// The configurations grouped by task, which is the unit of resampling.
struct Clusters {
    /// Radii at which the slope of the curve can change.
    radii: Vec<f64>,
    tasks: Vec<Task>,
}

struct Task {
    n: f64,
    /// Smallest, then largest possible number of configurations that survive up to each radius.
    survive: [Vec<f64>; 2],
}

impl Clusters {
    fn new(thresholds: &[(TaskRef, Survives)], search: &Search) -> Self {
        let mut radii: Vec<f64> = search.grid.iter().map(|level| level.radius()).collect();
        radii.push(0.0);
        radii.extend(thresholds.iter().flat_map(|(_, survives)| survives.ends()));
        radii.sort_by(f64::total_cmp);
        radii.dedup();
        let mut tasks: BTreeMap<TaskRef, Task> = BTreeMap::new();
        for (task, survives) in thresholds {
            let task = tasks.entry(*task).or_insert_with(|| Task {
                n: 0.0,
                survive: [vec![0.0; radii.len()], vec![0.0; radii.len()]],
            });
            task.n += 1.0;
            for (k, &radius) in radii.iter().enumerate() {
                for (sum, survives) in task.survive.iter_mut().zip(survives.bounds(radius)) {
                    sum[k] += f64::from(survives);
                }
            }
        }
        Self { radii, tasks: tasks.into_values().collect() }
    }

    fn points(
        &self,
        thresholds: &[(TaskRef, Survives)],
        bootstrap: &Bootstrap,
    ) -> (Vec<Point>, HalfSuccess) {
        if thresholds.is_empty() {
            let half_success = HalfSuccess {
                radius: None,
                bounds: None,
                ci95: None,
                no_interval: Some(NoInterval::TooFewTasks),
            };
            return (Vec::new(), half_success);
        }
        let (tasks, count) = (self.tasks.len(), 2 * (self.radii.len() + 1));
        let mut values = vec![0.0; count];
        self.statistics(&vec![1; tasks], &mut values);
        let statistics = |draws: &[u32], values: &mut [f64]| self.statistics(draws, values);
        let intervals = intervals_of_many(bootstrap, tasks, count, statistics);
        let interval = |k: usize| {
            let ends = [2 * k, 2 * k + 1].map(|place| match intervals[place] {
                // An end that is the same in all resamplings is exact.
                Err(NoInterval::NoSpread) => Ok([values[place]; 2]),
                ends => ends,
            });
            let [[low, _], [_, high]] = [ends[0]?, ends[1]?];
            if high > low { Ok([low, high]) } else { Err(NoInterval::NoSpread) }
        };
        let survival = self.survival(thresholds);
        let shares = self.radii.iter().zip(&survival).enumerate();
        let points = shares.map(|(k, (&radius, &survival))| Point {
            radius,
            level: Level::of_radius(radius).filter(|level| level.is_named()),
            survival,
            band: [values[2 * k], values[2 * k + 1]],
            ci95: interval(k).ok(),
        });
        let crosses_half = survival.first().is_some_and(|share| *share >= HALF)
            && survival.last().is_some_and(|share| *share <= HALF);
        let half_interval = interval(self.radii.len());
        let half = HalfSuccess {
            radius: crosses_half.then(|| self.crossing(&survival)),
            bounds: Some([values[count - 2], values[count - 1]]),
            ci95: half_interval.ok(),
            no_interval: half_interval.err(),
        };
        (points.collect(), half)
    }

    /// Computes the curve at each radius as Efron's self-consistent estimate: censored
    /// configurations survive with the curve's own conditional probability, which is
    /// iterated to a fixed point (B. Efron, The two sample problem with censored data,
    /// Proceedings of the Fifth Berkeley Symposium 4 (1967), 831–853).
    fn survival(&self, thresholds: &[(TaskRef, Survives)]) -> Vec<f64> {
        let mut survival = vec![1.0; self.radii.len()];
        for _ in 0..MAX_ITERATIONS {
            let curve = |radius: f64| {
                let place = self.radii.partition_point(|smaller| *smaller < radius);
                survival[place]
            };
            let share = |&radius: &f64| {
                let expected =
                    thresholds.iter().map(|(_, survives)| survives.expected(radius, curve));
                expected.sum::<f64>() / thresholds.len() as f64
            };
            let updated: Vec<f64> = self.radii.iter().map(share).collect();
            let pairs = updated.iter().zip(&survival);
            let change = pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
            survival = updated;
            if change < CONVERGED {
                break;
            }
        }
        survival
    }

    /// Writes the least and the greatest survival at each radius, alternating, over tasks
    /// weighted by `draws`; then the radii between which survival crosses one half.
    fn statistics(&self, draws: &[u32], values: &mut [f64]) {
        values.fill(0.0);
        let mut n = 0.0;
        for (task, &drawn) in self.tasks.iter().zip(draws) {
            let drawn = f64::from(drawn);
            n += drawn * task.n;
            for k in 0..self.radii.len() {
                values[2 * k] += drawn * task.survive[0][k];
                values[2 * k + 1] += drawn * task.survive[1][k];
            }
        }
        for sum in values.iter_mut() {
            *sum /= n;
        }
        let survival = |k: usize, end: usize| values[2 * k + end];
        let places = 0..self.radii.len();
        // The median of the brackets' lower ends, and the median of their upper ends.
        let low = places.clone().rev().find(|&k| survival(k, 0) > HALF);
        let high = places.clone().find(|&k| survival(k, 1) < HALF);
        let low = low.map_or(0.0, |k| self.radii[k]);
        let last = self.radii.last().copied().unwrap_or_default();
        let high = high.map_or(last, |k| self.radii[k]);
        values[2 * self.radii.len()] = low;
        values[2 * self.radii.len() + 1] = high;
    }

    /// Returns the radius at which a curve crosses one half, by linear interpolation.
    fn crossing(&self, survival: &[f64]) -> f64 {
        let first_below_half = survival.iter().position(|share| *share <= HALF);
        match first_below_half {
            None => self.radii.last().copied().unwrap_or_default(),
            Some(0) => 0.0,
            Some(k) => {
                let [before, after] = [survival[k - 1], survival[k]];
                let share = (before - HALF) / (before - after);
                self.radii[k - 1] + share * (self.radii[k] - self.radii[k - 1])
            }
        }
    }
}
