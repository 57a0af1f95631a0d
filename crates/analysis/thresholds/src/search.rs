//! Search for thresholds.

use libero_ctrl::{Axis, AxisSet, Condition, Level, Thresholds};

/// Parameters of the search for a threshold.
///
/// First all radii of a grid are run, whatever their outcomes, so that every ray is
/// seen to fail and to recover with the same resolution. Then the first bracket in
/// which success turns to failure is halved until it is narrow enough. A radius
/// between two that succeed is not run: a failure there stays unseen.
#[derive(Clone, Debug, PartialEq)]
pub struct Search {
    /// The radii that are run in any case, from the smallest.
    pub grid: Vec<Level>,
    /// Width that the bracket must not exceed, radius; none where there are no radii
    /// between those of the grid.
    pub tolerance: Option<f64>,
}

impl Search {
    /// Search for the thresholds of a condition in a campaign of these axes. Language
    /// has wordings at the protocol's levels and nothing between or beyond, so that a
    /// condition with it is run at those only.
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

    /// The largest radius that is run.
    pub fn largest(&self) -> Option<Level> {
        self.grid.last().copied()
    }

    /// The most rollouts that a ray takes of which the outcomes at some radii are
    /// supplied, whatever all outcomes are: the rest of the grid, and as many halvings
    /// as the widest bracket needs that quarantine can leave.
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
