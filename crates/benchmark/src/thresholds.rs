use serde::{Deserialize, Serialize};

use crate::condition::Condition;
use crate::level::Level;

/// Valid range of [`Thresholds::tolerance`], in units of radius.
pub const TOLERANCES: [f64; 2] = [0.01, 100.0];
/// Valid range of [`Thresholds::max_radius`].
pub const MAX_RADII: [f64; 2] = [2.0, 100.0];

/// Parameters of a campaign that measures the thresholds of another campaign, the source: it runs
/// the source's configurations at further radii.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Thresholds {
    pub campaign: String,
    /// Conditions of the source campaign that are measured; empty for all its conditions.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub conditions: Vec<Condition>,
    /// Largest width of a finished bracket between success and failure, in units of radius.
    #[serde(default = "default_tolerance")]
    pub tolerance: f64,
    /// The largest radius that is run.
    #[serde(default = "default_max_radius")]
    pub max_radius: f64,
    /// Largest number of rollouts; `None` if every configuration is measured.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub budget: Option<u32>,
    /// Seed of the random order in which configurations are measured, as many as `budget` covers.
    #[serde(default)]
    pub seed: u64,
}

impl Thresholds {
    pub const DEFAULT_TOLERANCE: f64 = 0.5;
    /// Default largest radius: twice that of L3.
    pub const DEFAULT_MAX_RADIUS: f64 = 16.0;

    /// Returns the radii that are always run: those of the protocol's levels, continued by
    /// doubling up to the largest radius, which is included.
    pub fn grid(&self) -> Vec<Level> {
        let doubled = (0..).map(|k| Level::L1.radius() * f64::from(1 << k));
        let mut radii: Vec<f64> = doubled.take_while(|&r| r < self.max_radius).collect();
        radii.push(self.max_radius);
        radii.into_iter().filter_map(Level::of_radius).collect()
    }

    pub(crate) fn out_of_range(&self) -> Option<(&'static str, f64, [f64; 2])> {
        let fields = [
            ("purpose.thresholds.tolerance", self.tolerance, TOLERANCES),
            ("purpose.thresholds.max_radius", self.max_radius, MAX_RADII),
        ];
        let is_outside =
            |(_, given, [low, high]): &(&str, f64, [f64; 2])| !(*low..=*high).contains(given);
        fields.into_iter().find(is_outside)
    }
}

fn default_tolerance() -> f64 {
    Thresholds::DEFAULT_TOLERANCE
}

fn default_max_radius() -> f64 {
    Thresholds::DEFAULT_MAX_RADIUS
}

#[cfg(test)]
mod tests {
    use super::*;

    fn up_to(max_radius: f64) -> Thresholds {
        Thresholds {
            campaign: "first".to_owned(),
            conditions: Vec::new(),
            tolerance: Thresholds::DEFAULT_TOLERANCE,
            max_radius,
            budget: None,
            seed: 0,
        }
    }

    #[test]
    fn the_grid_continues_the_protocols_levels_by_doubling() {
        let grid = |max_radius| -> Vec<String> {
            let grid = up_to(max_radius).grid();
            grid.iter().map(Level::to_string).collect()
        };
        assert_eq!(grid(16.0), ["L1", "L2", "L3", "r16"]);
        assert_eq!(grid(2.0), ["L1"]);
        assert_eq!(grid(5.5), ["L1", "L2", "r5.5"]);
        assert_eq!(grid(100.0), ["L1", "L2", "L3", "r16", "r32", "r64", "r100"]);
    }
}
