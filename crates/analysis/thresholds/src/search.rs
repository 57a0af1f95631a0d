//! Parameters of the search for thresholds: grid and tolerance.

use libero_ctrl::{Axis, AxisSet, Condition, Level, Thresholds};

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
}

impl Search {
    /// Returns the search for the thresholds of a condition in a campaign of the given axes.
    /// Language has wordings only at the protocol's levels, so that a condition that
    /// perturbs it is run only at those.
    pub fn of(thresholds: &Thresholds, condition: Condition, axes: AxisSet) -> Self {
        let mut grid = thresholds.grid();
        if !condition.axes(axes).contains(Axis::Language) {
            return Self {
                grid,
                tolerance: Some(thresholds.tolerance),
            };
        }
        grid.retain(|level| level.is_named());
        Self {
            grid,
            tolerance: None,
        }
    }

    /// Returns the largest radius of the grid.
    pub fn largest(&self) -> Option<Level> {
        self.grid.last().copied()
    }

    /// Returns the upper bound of the number of rollouts of a ray whose outcomes at some
    /// radii are supplied: the rest of the grid, and the halvings of the widest bracket that
    /// quarantined rollouts can leave.
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
