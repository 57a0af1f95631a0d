//! Survival curves: which share of the configurations still succeeds at a radius.
//!
//! A configuration *survives* up to a radius if it succeeds nominally and at every
//! smaller radius that was run. The curve begins at the nominal success rate, over all
//! configurations: those that fail nominally survive to no radius. So it is comparable
//! with a report's rates; where no configuration recovers from a failure, it is equal to
//! them at the levels of the grid.
//!
//! The place of a threshold within its bracket is not known. The curve takes it as
//! uniform there; the *band* is what every other place would give. At a radius that was
//! run of every configuration, both are the same. A threshold beyond the largest success
//! whose failure is not known is censored on the right: the curve goes on with it as with
//! the others that came so far, the band with everything that it may be.
//!
//! Intervals are about what the band allows: from the lower end of an interval of the least
//! to the upper end of an interval of the most, over resampled tasks. So they hold wherever
//! in their brackets the thresholds lie, and are never narrower than the brackets there
//! (J. L. Horowitz, C. F. Manski, Nonparametric analysis of randomized experiments with
//! missing covariate and outcome data, Journal of the American Statistical Association 95
//! (2000), 77–84).

use std::collections::BTreeMap;

use libero_ctrl::{Condition, Level, TaskRef};
use paired::{Bootstrap, Interval, NoInterval, intervals_of_many};
use serde::Serialize;

use crate::found::{Found, Threshold};
use crate::search::Search;

/// One half of all configurations.
const HALF: f64 = 0.5;
/// Most rounds in which the share of censored configurations is settled, and the change
/// of a share that ends them.
const MOST_ROUNDS: u32 = 1_000;
const CHANGE: f64 = 1e-12;

/// Survival curve of configurations over the radius, under one condition.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Curve {
    /// Condition: the perturbed axes.
    pub condition: Condition,
    /// The radii that were run of every configuration.
    pub grid: Vec<f64>,
    /// The largest of them; the curve ends there.
    pub largest_radius: f64,
    /// True if radii between those of the grid are run: not where language is perturbed.
    pub is_bisected: bool,
    /// Configurations that it is over: those of which every radius of the grid has been
    /// run, and those that fail nominally.
    pub n: u64,
    /// Number of their tasks.
    pub tasks: usize,
    /// Configurations that it leaves out: outcomes of the grid are missing still, or the
    /// nominal rollout is in quarantine.
    pub left_out: u64,
    /// Configurations that fail nominally.
    pub nominal_fails: u64,
    /// Configurations that survive up to the largest radius: there, their threshold is
    /// censored.
    pub beyond: u64,
    /// Configurations that are censored below it, because the outcome there is in
    /// quarantine.
    pub censored: u64,
    /// Configurations that succeed again at a larger radius than one at which they fail.
    pub not_monotone: u64,
    /// The curve, from radius 0 on, straight between these points. None where it is over
    /// no configuration.
    pub points: Vec<Point>,
    /// Radius at which half of the configurations survive.
    pub half_success: HalfSuccess,
}

/// A point of a curve. Shares are fractions of the configurations.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Point {
    /// The radius.
    pub radius: f64,
    /// The protocol's name of that radius, if it has one.
    pub level: Option<Level>,
    /// The share that survives.
    pub survival: f64,
    /// The smallest and the largest share that the brackets allow.
    pub band: [f64; 2],
    /// Interval of `survival`, by resampling tasks, wherever the thresholds lie in their
    /// brackets; none where that cannot give one.
    pub ci95: Option<Interval>,
}

/// The radius up to which half of all configurations survive.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct HalfSuccess {
    /// Radius at which the curve crosses one half; none if fewer than half succeed
    /// nominally, more than half survive up to the largest radius, or brackets are not
    /// narrowed there.
    pub radius: Option<f64>,
    /// Range of the radius for these configurations, wherever the thresholds are in their
    /// brackets; none where the curve is over no configuration.
    pub bounds: Option<Interval>,
    /// Interval, by resampling tasks, brackets included. An end at 0 means less than
    /// half nominally, one at the largest radius, half or more there.
    pub ci95: Option<Interval>,
    /// Reason why there is no interval.
    pub no_interval: Option<NoInterval>,
}

/// The threshold of one configuration.
#[derive(Clone, Copy, Debug)]
enum Survives {
    /// The configuration fails nominally.
    Never,
    /// Up to a radius between these.
    Until([f64; 2]),
    /// Up to the largest radius.
    Throughout,
    /// Up to this radius; what is beyond is not known.
    AtLeast(f64),
}

impl Survives {
    fn of(found: &Found) -> Option<Self> {
        let survives = match found.threshold {
            Threshold::NominalFails => Some(Self::Never),
            Threshold::Between {
                succeeds_at,
                fails_at,
            } => Some(Self::Until([succeeds_at.radius(), fails_at.radius()])),
            Threshold::Beyond => Some(Self::Throughout),
            Threshold::Open { succeeds_at } => Some(Self::AtLeast(succeeds_at.radius())),
            Threshold::NominalUnknown => None,
        };
        survives.filter(|_| found.is_on_grid)
    }

    /// Probability that it survives up to a radius, if its threshold is uniform in its
    /// bracket, and, where it is censored, as likely as `others` that survive as far.
    fn expected(self, radius: f64, others: impl Fn(f64) -> f64) -> f64 {
        match self {
            Self::Never => 0.0,
            Self::Until([low, high]) => ((high - radius) / (high - low)).clamp(0.0, 1.0),
            Self::Throughout => 1.0,
            Self::AtLeast(known) if radius <= known => 1.0,
            Self::AtLeast(known) => match others(known) {
                share if share > 0.0 => others(radius) / share,
                _ => 0.0,
            },
        }
    }

    /// Returns whether it certainly survives up to a radius, and whether it possibly does.
    fn bounds(self, radius: f64) -> [bool; 2] {
        match self {
            Self::Never => [false; 2],
            Self::Until([low, high]) => [radius <= low, radius < high],
            Self::Throughout => [true; 2],
            Self::AtLeast(known) => [radius <= known, true],
        }
    }

    fn ends(self) -> impl Iterator<Item = f64> {
        let ends = match self {
            Self::Until(ends) => [Some(ends[0]), Some(ends[1])],
            Self::AtLeast(known) => [Some(known), None],
            Self::Never | Self::Throughout => [None; 2],
        };
        ends.into_iter().flatten()
    }
}

impl Curve {
    /// The curve of a condition, over the rays of which this was found.
    pub(crate) fn of(
        condition: Condition,
        search: &Search,
        found: &[(TaskRef, Found)],
        bootstrap: &Bootstrap,
    ) -> Self {
        let known = found.iter();
        let known = known.filter_map(|(task, found)| Some((*task, Survives::of(found)?)));
        let known: Vec<(TaskRef, Survives)> = known.collect();
        let count = |is: fn(&Survives) -> bool| known.iter().filter(|(_, it)| is(it)).count();
        let recovers = |(_, found): &&(TaskRef, Found)| !found.recovers_at.is_empty();
        let largest_radius = search.largest().map_or(0.0, Level::radius);
        let clusters = Clusters::of(&known, search);
        let (points, mut half_success) = clusters.points(&known, bootstrap);
        half_success.radius = half_success.radius.filter(|_| search.tolerance.is_some());
        Self {
            condition,
            grid: search.grid.iter().map(|level| level.radius()).collect(),
            largest_radius,
            is_bisected: search.tolerance.is_some(),
            n: known.len() as u64,
            tasks: clusters.tasks.len(),
            left_out: (found.len() - known.len()) as u64,
            nominal_fails: count(|it| matches!(it, Survives::Never)) as u64,
            beyond: count(|it| matches!(it, Survives::Throughout)) as u64,
            censored: count(|it| matches!(it, Survives::AtLeast(_))) as u64,
            not_monotone: found.iter().filter(recovers).count() as u64,
            points,
            half_success,
        }
    }

    /// The point at a radius of the grid.
    pub fn at(&self, radius: f64) -> Option<&Point> {
        self.points.iter().find(|point| point.radius == radius)
    }
}

/// The configurations task by task: what is resampled.
struct Clusters {
    /// Radii at which the curve can bend.
    radii: Vec<f64>,
    tasks: Vec<Task>,
}

/// The configurations of one task.
struct Task {
    n: f64,
    /// Number of them that survive up to each radius: the fewest, then the most.
    survive: [Vec<f64>; 2],
}

impl Clusters {
    fn of(known: &[(TaskRef, Survives)], search: &Search) -> Self {
        let mut radii: Vec<f64> = search.grid.iter().map(|level| level.radius()).collect();
        radii.push(0.0);
        radii.extend(known.iter().flat_map(|(_, survives)| survives.ends()));
        radii.sort_by(f64::total_cmp);
        radii.dedup();
        let mut tasks: BTreeMap<TaskRef, Task> = BTreeMap::new();
        for (task, survives) in known {
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
        Self {
            radii,
            tasks: tasks.into_values().collect(),
        }
    }

    /// The curve's points, and where it crosses one half.
    fn points(
        &self,
        known: &[(TaskRef, Survives)],
        bootstrap: &Bootstrap,
    ) -> (Vec<Point>, HalfSuccess) {
        if known.is_empty() {
            let nothing = HalfSuccess {
                radius: None,
                bounds: None,
                ci95: None,
                no_interval: Some(NoInterval::TooFewTasks),
            };
            return (Vec::new(), nothing);
        }
        let (tasks, count) = (self.tasks.len(), 2 * (self.radii.len() + 1));
        let mut values = vec![0.0; count];
        self.statistics(&vec![1; tasks], &mut values);
        let statistics = |draws: &[u32], values: &mut [f64]| self.statistics(draws, values);
        let intervals = intervals_of_many(bootstrap, tasks, count, statistics);
        let interval = |k: usize| {
            let ends = [2 * k, 2 * k + 1].map(|place| match intervals[place] {
                // An end that no resampling moves is its value.
                Err(NoInterval::NoSpread) => Ok([values[place]; 2]),
                ends => ends,
            });
            let [[low, _], [_, high]] = [ends[0]?, ends[1]?];
            match high > low {
                true => Ok([low, high]),
                false => Err(NoInterval::NoSpread),
            }
        };
        let survival = self.survival(known);
        let of_curve = self.radii.iter().zip(&survival).enumerate();
        let points = of_curve.map(|(k, (&radius, &survival))| Point {
            radius,
            level: Level::of_radius(radius).filter(|level| level.is_named()),
            survival,
            band: [values[2 * k], values[2 * k + 1]],
            ci95: interval(k).ok(),
        });
        let crosses = survival.first().is_some_and(|it| *it >= HALF)
            && survival.last().is_some_and(|it| *it <= HALF);
        let of_half = interval(self.radii.len());
        let half = HalfSuccess {
            radius: crosses.then(|| self.crossing(&survival)),
            bounds: Some([values[count - 2], values[count - 1]]),
            ci95: of_half.ok(),
            no_interval: of_half.err(),
        };
        (points.collect(), half)
    }

    /// The curve at each radius. Censored configurations survive as the others do, of
    /// which they are some: the share is what makes that so (B. Efron, The two sample
    /// problem with censored data, Proceedings of the Fifth Berkeley Symposium 4 (1967),
    /// 831–853).
    fn survival(&self, known: &[(TaskRef, Survives)]) -> Vec<f64> {
        let mut survival = vec![1.0; self.radii.len()];
        for _ in 0..MOST_ROUNDS {
            let others = |radius: f64| {
                let place = self.radii.partition_point(|it| *it < radius);
                survival[place]
            };
            let share = |&radius: &f64| {
                let expected = known.iter().map(|(_, it)| it.expected(radius, others));
                expected.sum::<f64>() / known.len() as f64
            };
            let next: Vec<f64> = self.radii.iter().map(share).collect();
            let pairs = next.iter().zip(&survival);
            let change = pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
            survival = next;
            if change < CHANGE {
                break;
            }
        }
        survival
    }

    /// The least and the most survival at each radius over tasks that were drawn so often,
    /// in turn, and then the radii between which it crosses one half.
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
        let at = |k: usize, end: usize| values[2 * k + end];
        let places = 0..self.radii.len();
        // The median of the brackets' lower ends, and that of their upper ends.
        let low = places.clone().rev().find(|&k| at(k, 0) > HALF);
        let high = places.clone().find(|&k| at(k, 1) < HALF);
        let low = low.map_or(0.0, |k| self.radii[k]);
        let last = self.radii.last().copied().unwrap_or_default();
        let high = high.map_or(last, |k| self.radii[k]);
        values[2 * self.radii.len()] = low;
        values[2 * self.radii.len() + 1] = high;
    }

    /// Returns the radius at which a curve crosses one half, straight between its points.
    fn crossing(&self, survival: &[f64]) -> f64 {
        let below = survival.iter().position(|share| *share <= HALF);
        match below {
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
