//! What is done to a rollout: the axes of perturbation, their conditions and
//! realisations. How much is in `level` and `presets`.

use std::fmt;
use std::str::FromStr;

use crate::names::{UnknownName, serde_as_text};

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
    /// All axes, in the reference's order.
    pub const ALL: [Self; 6] = [
        Self::Camera,
        Self::Lighting,
        Self::Robot,
        Self::Sensor,
        Self::Actuation,
        Self::Language,
    ];

    /// The axes with numbers for parameters: all but language.
    pub const METRIC: [Self; 5] = [
        Self::Camera,
        Self::Lighting,
        Self::Robot,
        Self::Sensor,
        Self::Actuation,
    ];

    /// Name in rollout ids and manifests.
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

/// Which axes are perturbed in a rollout.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Condition {
    /// None: the nominal rollout.
    Clean,
    /// One axis alone.
    Single(Axis),
    /// Simultaneous: all axes of the campaign at once. Ids call it
    /// `combination`, as the published ones do.
    Combination,
}

impl Condition {
    /// Name in rollout ids and manifests.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Clean => "clean",
            Self::Single(axis) => axis.name(),
            Self::Combination => "combination",
        }
    }

    /// What people read: `nominal`, an axis's name, or the paper's
    /// `simultaneous`.
    pub const fn label(self) -> &'static str {
        match self {
            Self::Clean => "nominal",
            Self::Single(axis) => axis.name(),
            Self::Combination => "simultaneous",
        }
    }
}

impl fmt::Display for Condition {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

impl FromStr for Condition {
    type Err = UnknownName;

    fn from_str(text: &str) -> Result<Self, UnknownName> {
        match text {
            "clean" => Ok(Self::Clean),
            "combination" => Ok(Self::Combination),
            axis => axis.parse().map(Self::Single).map_err(|_| {
                let mut valid = vec!["clean", "combination"];
                valid.extend(Axis::ALL.map(Axis::name));
                UnknownName::new("condition", text, &valid)
            }),
        }
    }
}

serde_as_text!(Condition);

/// Where the random elements of a perturbation come from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Realisation {
    /// From a stream keyed by configuration and axis, so that an axis alone
    /// and the same axis in a combination are realised identically.
    #[default]
    Matched,
    /// From NumPy's streams seeded by the rollout id, as the reference
    /// implementation draws them.
    Reference,
}

impl Realisation {
    /// Name in campaigns and results.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Matched => "matched",
            Self::Reference => "reference",
        }
    }
}

impl fmt::Display for Realisation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

impl FromStr for Realisation {
    type Err = UnknownName;

    fn from_str(text: &str) -> Result<Self, UnknownName> {
        let both = [Self::Matched, Self::Reference];
        both.into_iter()
            .find(|realisation| realisation.name() == text)
            .ok_or_else(|| UnknownName::new("realisation", text, &both.map(Self::name)))
    }
}

serde_as_text!(Realisation);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn conditions_read_back_from_their_text() {
        let singles = Axis::ALL.map(Condition::Single);
        for condition in [Condition::Clean, Condition::Combination]
            .into_iter()
            .chain(singles)
        {
            assert_eq!(condition.to_string().parse(), Ok(condition));
        }
    }

    #[test]
    fn a_misspelt_axis_lists_the_six() {
        let error = "camrea".parse::<Axis>().expect_err("no such axis");
        assert_eq!(
            error.to_string(),
            "read axis `camrea`: valid are camera, lighting, robot, sensor, actuation, language"
        );
    }
}
