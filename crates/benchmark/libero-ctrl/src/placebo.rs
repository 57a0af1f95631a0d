//! The placebo level: the conditions of a design, without latency, at a radius too small to affect
//! any policy.
//! Changed outcomes at this level are the noise floor of every paired measure.

use crate::level::Level;

/// Smallest and largest radius of a placebo.
pub const PLACEBO_RADII: [f64; 2] = [0.001, 0.5];

/// Settings of a design's level `L0`. Directions, initial states and seeds are determined as
/// at the other levels; the instruction stays canonical.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Placebo {
    /// Radius in normalised coordinates, within [`PLACEBO_RADII`].
    pub radius: Level,
    /// Configurations to run at the placebo level; `None` for all of the design's.
    pub configs: Option<Vec<u16>>,
}

impl Placebo {
    /// Default radius, at which a camera turns by less than 0.1°.
    pub const DEFAULT_RADIUS: Level = Level::of_radius_micros(20_000);

    /// Returns true if a radius is valid for a placebo.
    pub(crate) fn is_valid_radius(radius: Level) -> bool {
        (PLACEBO_RADII[0]..=PLACEBO_RADII[1]).contains(&radius.radius())
    }

    /// Returns true if the placebo level includes a configuration of the design.
    pub(crate) fn includes(&self, config: u16) -> bool {
        let configs = self.configs.as_ref();
        configs.is_none_or(|configs| configs.contains(&config))
    }
}

impl Default for Placebo {
    fn default() -> Self {
        Self { radius: Self::DEFAULT_RADIUS, configs: None }
    }
}
