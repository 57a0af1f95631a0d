//! Parameters of the search for thresholds: grid and tolerance.

use libero_ctrl::{Axis, AxisSet, Condition, Level, STEPS_PER_RADIUS, Thresholds, delay_at};

/// Rounding error by which a bracket may exceed the tolerance: radii have six decimals.
const ROUNDING: f64 = 1e-5;

/// Parameters of the search for a threshold.
///
/// First, all radii of a grid are run regardless of their outcomes, so that failures and
/// recoveries are observed with the same resolution along every ray. Then the first
/// bracket in which success turns to failure is halved until it is narrow enough. Radii
/// between two successes are not run; a failure there goes unnoticed.
#[derive(Clone, Debug, PartialEq)]
pub struct Search {
    /// Radii that are always run, in ascending order.
    pub grid: Vec<Level>,
    /// Largest width of a finished bracket, in units of radius; `None` if no radii between
    /// those of the grid exist.
    pub tolerance: Option<f64>,
    /// Distance between neighbouring radii that can be run; `None` for all conditions but latency.
    pub spacing: Option<f64>,
}

impl Search {
    /// Returns the search for the thresholds of a condition in a campaign of the given axes. A
    /// condition that perturbs language runs only at the protocol's levels, because only those have
    /// paraphrases. Latency runs only at radii whose delay is a whole number of control steps.
    pub fn of(thresholds: &Thresholds, condition: Condition, axes: AxisSet) -> Self {
        if condition == Condition::Latency {
            let spacing = 1.0 / STEPS_PER_RADIUS;
            let whole_steps = Thresholds {
                max_radius: (thresholds.max_radius / spacing).floor() * spacing,
                ..thresholds.clone()
            };
            let mut grid = whole_steps.grid();
            grid.retain(|level| delay_at(*level).is_some());
            return Self {
                grid,
                tolerance: Some(thresholds.tolerance.max(spacing)),
                spacing: Some(spacing),
            };
        }
        let mut grid = thresholds.grid();
        if !condition.axes(axes).contains(Axis::Language) {
            return Self { grid, tolerance: Some(thresholds.tolerance), spacing: None };
        }
        grid.retain(|level| level.is_named());
        Self { grid, tolerance: None, spacing: None }
    }

    /// Returns the radius that halves a bracket; `None` if the bracket is narrow enough, or if no
    /// radius within the bracket can be run.
    pub(crate) fn halfway(&self, [low, high]: [f64; 2]) -> Option<Level> {
        let tolerance = self.tolerance?;
        if high - low <= tolerance + ROUNDING {
            return None;
        }
        let middle = f64::midpoint(low, high);
        let middle = match self.spacing {
            Some(spacing) => (middle / spacing).floor() * spacing,
            None => middle,
        };
        Level::of_radius(middle).filter(|_| middle > low)
    }

    /// Returns the largest radius of the grid.
    pub fn largest(&self) -> Option<Level> {
        self.grid.last().copied()
    }

    /// Returns the upper bound of the number of further rollouts of a ray: the radii of the grid
    /// for which `is_supplied` is false, and the halvings of the widest bracket that quarantined
    /// rollouts can leave.
    pub fn most_rollouts(&self, is_supplied: impl Fn(Level) -> bool) -> u32 {
        let grid = self.grid.iter().filter(|level| !is_supplied(**level));
        let widest = self.largest().map_or(0.0, Level::radius);
        let halvings = match self.tolerance {
            Some(tolerance) => (widest / tolerance).log2().ceil().max(0.0) as u32,
            None => 0,
        };
        grid.count() as u32 + halvings
    }
}
