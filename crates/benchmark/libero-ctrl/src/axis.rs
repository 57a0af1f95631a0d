use std::fmt;
use std::str::FromStr;

use crate::names::{UnknownName, serde_as_text};

/// Name of the latency axis, which [`crate::AnyAxis`] adds to the protocol's six.
pub(crate) const LATENCY: &str = "latency";

/// One kind of perturbation.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Axis {
    /// Pose of the `agentview` camera.
    Camera,
    /// Lights and the headlight's ambient term.
    Lighting,
    /// Initial pose of the end-effector.
    Robot,
    /// Corruption of the rendered pictures.
    Sensor,
    /// Distortion of the actions on their way to the controller.
    Actuation,
    /// Paraphrase of the instruction.
    Language,
}

impl Axis {
    /// All axes, in the order of the reference implementation.
    pub const ALL: [Self; 6] =
        [Self::Camera, Self::Lighting, Self::Robot, Self::Sensor, Self::Actuation, Self::Language];

    /// Axes with numeric parameters: all except language.
    pub const METRIC: [Self; 5] =
        [Self::Camera, Self::Lighting, Self::Robot, Self::Sensor, Self::Actuation];

    /// Returns the name in rollout ids and manifests.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Camera => "camera",
            Self::Lighting => "lighting",
            Self::Robot => "robot",
            Self::Sensor => "sensor",
            Self::Actuation => "actuation",
            Self::Language => "language",
        }
    }
}

impl fmt::Display for Axis {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

impl FromStr for Axis {
    type Err = UnknownName;

    fn from_str(text: &str) -> Result<Self, UnknownName> {
        Self::ALL
            .into_iter()
            .find(|axis| axis.name() == text)
            .ok_or_else(|| UnknownName::new("axis", text, &Self::ALL.map(Self::name)))
    }
}

serde_as_text!(Axis);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_error_for_an_unknown_axis_lists_the_six_axes() {
        let error = "camrea".parse::<Axis>().expect_err("no such axis");
        assert_eq!(
            error.to_string(),
            "read axis `camrea`: valid are camera, lighting, robot, sensor, actuation, language"
        );
    }
}
