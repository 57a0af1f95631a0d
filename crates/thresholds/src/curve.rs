//! Survival curves: which share of the configurations still succeeds at a radius.
//!
//! A configuration *survives* up to a radius if it succeeds nominally and at every
//! smaller radius that was run. The curve begins at the nominal success rate, over all
//! configurations: those that fail nominally survive to no radius. So it is comparable
//! with a report's rates; where no configuration recovers from a failure, it is equal to
//! them at the levels of the grid.
//!
//! Where within its bracket a threshold lies is not known. The curve takes it as
//! uniform there; the *band* is what every other place would give. At a radius that was
//! run of every configuration, both are the same.

use std::collections::BTreeMap;

use paired::{Bootstrap, Interval, NoInterval, intervals_of_many};
use protocol::{Condition, Level, TaskRef};
use serde::Serialize;

use crate::found::{Found, Threshold};
use crate::search::Search;

/// What is half of all configurations.
const HALF: f64 = 0.5;

/// How many configurations survive up to each radius, under one condition.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Curve {
    /// What is perturbed.
    pub condition: Condition,
    /// The radii that were run of every configuration.
    pub grid: Vec<f64>,
    /// The largest of them; the curve ends there.
    pub largest_radius: f64,
    /// Whether radii between those of the grid are run: not where language is
    /// perturbed.
    pub is_bisected: bool,
    /// Configurations that it is over: those of which every radius of the grid has been
    /// run, and those that fail nominally.
    pub n: u64,
    /// Their tasks.
    pub tasks: usize,
    /// Configurations that it leaves out, as long as outcomes are missing or in
    /// quarantine without which nothing can be said.
    pub left_out: u64,
    /// Those that fail nominally.
    pub nominal_fails: u64,
    /// Those that survive up to the largest radius: there, their threshold is censored.
    pub beyond: u64,
    /// Those that succeed again at a larger radius than one at which they fail.
    pub not_monotone: u64,
    /// The curve, from radius 0 on, straight between these points. None where it is over
    /// no configuration.
    pub points: Vec<Point>,
    /// Where half of the configurations survive.
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
    /// Interval of `survival`, by resampling tasks; none where that cannot give one.
    pub ci95: Option<Interval>,
}

/// The radius up to which half of all configurations survive.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct HalfSuccess {
    /// The radius; none if fewer than half succeed nominally, or more than half survive
    /// up to the largest radius.
    pub radius: Option<f64>,
    /// Its interval, by resampling tasks. An end at 0 means less than half nominally,
    /// one at the largest radius, more than half there.
    pub ci95: Option<Interval>,
    /// Why there is no interval.
    pub no_interval: Option<NoInterval>,
}

/// The threshold of one configuration.
#[derive(Clone, Copy, Debug)]
enum Survives {
    /// It fails nominally.
    Never,
    /// Up to a radius between these.
    Until([f64; 2]),
    /// Up to the largest radius.
    Throughout,
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
            Threshold::NominalUnknown | Threshold::Open => None,
        };
        survives.filter(|_| found.is_on_grid)
    }

    /// How likely it survives up to a radius, if its threshold is uniform in its bracket.
    fn expected(self, radius: f64) -> f64 {
        match self {
            Self::Never => 0.0,
            Self::Until([low, high]) => ((high - radius) / (high - low)).clamp(0.0, 1.0),
            Self::Throughout => 1.0,
        }
    }

    /// Whether it certainly survives up to a radius, and whether it possibly does.
    fn bounds(self, radius: f64) -> [bool; 2] {
        match self {
            Self::Never => [false; 2],
            Self::Until([low, high]) => [radius <= low, radius < high],
            Self::Throughout => [true; 2],
        }
    }

    fn ends(self) -> impl Iterator<Item = f64> {
        let ends = match self {
            Self::Until(ends) => Some(ends),
            Self::Never | Self::Throughout => None,
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
        let (points, half_success) = clusters.points(&known, bootstrap);
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
    /// How many of them survive up to each radius.
    survive: Vec<f64>,
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
                survive: vec![0.0; radii.len()],
            });
            task.n += 1.0;
            for (sum, &radius) in task.survive.iter_mut().zip(&radii) {
                *sum += survives.expected(radius);
            }
        }
        Self {
            radii,
            tasks: tasks.into_values().collect(),
        }
    }

    /// The curve's points, and the radius at which it crosses one half.
    fn points(
        &self,
        known: &[(TaskRef, Survives)],
        bootstrap: &Bootstrap,
    ) -> (Vec<Point>, HalfSuccess) {
        let mut values = vec![0.0; self.radii.len() + 1];
        self.statistics(&vec![1; self.tasks.len()], &mut values);
        let intervals = intervals_of_many(
            bootstrap,
            self.tasks.len(),
            values.len(),
            |draws, values| self.statistics(draws, values),
        );
        let n = known.len() as f64;
        let band = |radius: f64| {
            let bounds = known.iter().map(|(_, survives)| survives.bounds(radius));
            let sums = bounds.fold([0.0, 0.0], |[low, high], [certain, possible]| {
                [low + f64::from(certain), high + f64::from(possible)]
            });
            sums.map(|sum| sum / n)
        };
        let point = |((&radius, &survival), ci95): ((&f64, &f64), &Result<_, _>)| Point {
            radius,
            level: Level::of_radius(radius).filter(|level| level.is_named()),
            survival,
            band: band(radius),
            ci95: ci95.as_ref().ok().copied(),
        };
        let of_curve = self.radii.iter().zip(&values).zip(&intervals);
        let points = match known.is_empty() {
            true => Vec::new(),
            false => of_curve.map(point).collect(),
        };
        let survival = &values[..self.radii.len()];
        let crosses = survival.first().is_some_and(|it| *it >= HALF)
            && survival.last().is_some_and(|it| *it <= HALF);
        let of_half = intervals.last().copied();
        let half = HalfSuccess {
            radius: values.last().copied().filter(|_| crosses),
            ci95: of_half.and_then(Result::ok),
            no_interval: of_half.and_then(Result::err),
        };
        (points, half)
    }

    /// Survival at each radius over tasks that were drawn so often, and then the radius
    /// at which it crosses one half: 0 if it is below from the beginning, and the largest
    /// radius if it stays above.
    fn statistics(&self, draws: &[u32], values: &mut [f64]) {
        let (half, survival) = values.split_last_mut().expect("a value for the half");
        let mut n = 0.0;
        survival.fill(0.0);
        for (task, &drawn) in self.tasks.iter().zip(draws) {
            let drawn = f64::from(drawn);
            n += drawn * task.n;
            for (sum, of_task) in survival.iter_mut().zip(&task.survive) {
                *sum += drawn * of_task;
            }
        }
        for sum in survival.iter_mut() {
            *sum /= n;
        }
        *half = self.crossing(survival);
    }

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
