//! Parameters of the search for thresholds: grid and tolerance.

use benchmark::{AxisSet, Condition, Level, Radii, Thresholds};

/// Amount by which a bracket may exceed the tolerance: ample for the rounding of radii to six
/// decimals.
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
    /// Distance between neighbouring radii that can be run; `None` if all can, or only those of the
    /// grid.
    pub spacing: Option<f64>,
}

impl Search {
    /// Returns the search for the thresholds of a condition in a campaign of the given axes, over
    /// the radii at which all axes of the condition run.
    pub fn of(thresholds: &Thresholds, condition: Condition, axes: AxisSet) -> Self {
        let radii: Vec<Radii> = condition.axes(axes).axes().map(|axis| axis.def().radii).collect();
        let spacing = radii.iter().find_map(|radii| match radii {
            Radii::Multiples(of) => Some(*of),
            Radii::Any | Radii::Named => None,
        });
        let mut max_radius = thresholds.max_radius;
        if let Some(spacing) = spacing {
            max_radius = (max_radius / spacing).floor() * spacing;
        }
        let mut grid = Thresholds { max_radius, ..thresholds.clone() }.grid();
        grid.retain(|level| radii.iter().all(|radii| radii.contains(*level)));
        // A bracket's width is a multiple of the spacing; rounded down, so that `most_rollouts` counts
        // the halvings that `halfway` makes.
        let tolerance = match spacing {
            Some(spacing) => (thresholds.tolerance / spacing).floor().max(1.0) * spacing,
            None => thresholds.tolerance,
        };
        let tolerance = (!radii.contains(&Radii::Named)).then_some(tolerance);
        Self { grid, tolerance, spacing }
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

    pub fn largest(&self) -> Option<Level> {
        self.grid.last().copied()
    }

    /// Returns the upper bound of the number of further rollouts of a ray: the radii of the grid
    /// for which `has_outcome` is false, and the halvings of the widest bracket that quarantined
    /// rollouts can leave: from 0 to the largest radius.
    pub fn most_rollouts(&self, has_outcome: impl Fn(Level) -> bool) -> u32 {
        let grid = self.grid.iter().filter(|level| !has_outcome(**level));
        let widest = self.largest().map_or(0.0, Level::radius);
        let halvings = match self.tolerance {
            Some(tolerance) => (widest / tolerance).log2().ceil().max(0.0) as u32,
            None => 0,
        };
        grid.count() as u32 + halvings
    }
}
