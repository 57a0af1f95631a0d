//! The placebo level: all conditions of a design at a radius so small that no policy
//! should care. Outcomes that change there are the noise floor of every paired measure.

use crate::level::Level;

/// Smallest and largest radius of a placebo.
pub const PLACEBO_RADII: [f64; 2] = [0.001, 0.5];

/// Form of a design's level `L0`. Directions, initial states and seeds' recipes are
/// those of its other levels; the instruction stays canonical.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Placebo {
    /// Radius in normalised coordinates, within [`PLACEBO_RADII`].
    pub radius: Level,
    /// Configurations that are run at it, some of the design's; none for all of them.
    pub configs: Option<Vec<u16>>,
}

impl Placebo {
    /// The radius unless another is asked for: a camera turns by less than 0.1°.
    pub const DEFAULT_RADIUS: Level = Level::of_radius_micros(20_000);

    /// Returns true if a radius may be a placebo's.
    pub(crate) fn may_have(radius: Level) -> bool {
        (PLACEBO_RADII[0]..=PLACEBO_RADII[1]).contains(&radius.radius())
    }

    /// Returns true if a configuration of the design is run at it.
    pub(crate) fn has(&self, config: u16) -> bool {
        let configs = self.configs.as_ref();
        configs.is_none_or(|configs| configs.contains(&config))
    }
}

impl Default for Placebo {
    fn default() -> Self {
        Self {
            radius: Self::DEFAULT_RADIUS,
            configs: None,
        }
    }
}
