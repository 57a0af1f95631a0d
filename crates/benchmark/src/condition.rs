//! Condition of a rollout (its perturbed axes) and realisation of its random elements.
//! `level` and `presets` define the strengths of perturbations.

use std::fmt;
use std::str::FromStr;

use crate::axis::{ActsOn, Axis};
use crate::axis_set::AxisSet;
use crate::names::{UnknownName, serde_as_text};

/// Name of the condition of every rollout of LIBERO's family or of a suite file.
const VARIANT: &str = "variant";

/// The reference's names of two conditions, which are read everywhere and written in its formats.
pub const PUBLISHED: [(Condition, &str); 2] =
    [(Condition::Nominal, "clean"), (Condition::Simultaneous, "combination")];

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Condition {
    Nominal,
    Single(Axis),
    /// Two to five axes; constructed by [`Self::of`].
    Subset(AxisSet),
    /// All axes of the campaign at once.
    Simultaneous,
    /// A rollout of LIBERO's family, perturbed or not, or of a suite file; its id names the variant
    /// or the suite.
    Variant,
}

impl Condition {
    /// Returns the condition that perturbs exactly these axes; all six are [`Self::Simultaneous`].
    pub fn of(axes: AxisSet) -> Self {
        let mut each = axes.axes();
        match (each.next(), each.next()) {
            (None, _) => Self::Nominal,
            (Some(axis), None) => Self::Single(axis),
            _ if axes == AxisSet::ALL => Self::Simultaneous,
            _ => Self::Subset(axes),
        }
    }

    pub const fn axes(self, campaign: AxisSet) -> AxisSet {
        match self {
            Self::Nominal | Self::Variant => AxisSet::EMPTY,
            Self::Single(axis) => AxisSet::of(axis),
            Self::Subset(axes) => axes,
            Self::Simultaneous => campaign.combined(),
        }
    }

    /// True if the level sets the rollout's execution model; the campaign sets that of all others.
    pub fn sets_execution(self) -> bool {
        matches!(self, Self::Single(axis) if axis.def().acts_on == ActsOn::Answers)
    }

    /// Returns the name, as in the paper.
    pub fn name(self) -> &'static str {
        match self {
            Self::Nominal => "nominal",
            Self::Single(axis) => axis.name(),
            Self::Subset(axes) => axes.name(),
            Self::Simultaneous => "simultaneous",
            Self::Variant => VARIANT,
        }
    }

    /// Returns the reference's name, which its manifests have and which is hashed into seeds.
    pub fn published(self) -> &'static str {
        let published = PUBLISHED.iter().find(|(condition, _)| *condition == self);
        published.map_or(self.name(), |(_, name)| name)
    }
}

impl fmt::Display for Condition {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

impl FromStr for Condition {
    type Err = UnknownName;

    /// Parses the paper's name or the reference's.
    fn from_str(text: &str) -> Result<Self, UnknownName> {
        if let Some((condition, _)) = PUBLISHED.iter().find(|(_, name)| *name == text) {
            return Ok(*condition);
        }
        match text {
            "nominal" => Ok(Self::Nominal),
            "simultaneous" => Ok(Self::Simultaneous),
            VARIANT => Ok(Self::Variant),
            axes => match (axes.parse().map(Self::Single), axes.parse()) {
                (Ok(single), _) => Ok(single),
                (_, Ok(axes)) if axes != AxisSet::EMPTY => Ok(Self::of(axes)),
                _ => {
                    let mut valid = vec!["nominal", "simultaneous"];
                    valid.extend(Axis::every().map(Axis::name));
                    valid.push("several axes such as camera+robot");
                    Err(UnknownName::new("condition", text, &valid))
                }
            },
        }
    }
}

serde_as_text!(Condition);

/// Source of the random elements of a perturbation.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Realisation {
    /// A stream keyed by task, level, configuration and axis, so that an axis has the same random
    /// elements alone and in a combination.
    #[default]
    Matched,
    /// NumPy's streams seeded by the rollout id, as in the reference implementation.
    Reference,
}

impl Realisation {
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
        let all = [Self::Matched, Self::Reference];
        all.into_iter()
            .find(|realisation| realisation.name() == text)
            .ok_or_else(|| UnknownName::new("realisation", text, &all.map(Self::name)))
    }
}

serde_as_text!(Realisation);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn conditions_are_parsed_from_their_text() {
        let conditions: Vec<Condition> =
            AxisSet::ALL.subsets().into_iter().map(Condition::of).collect();
        for &condition in &conditions {
            assert_eq!(condition.to_string().parse(), Ok(condition));
        }
        let distinct: std::collections::BTreeSet<&str> =
            conditions.iter().map(|condition| condition.name()).collect();
        assert_eq!(distinct.len(), 64);
        assert!(distinct.contains("camera+robot"));
        for (condition, published) in PUBLISHED {
            assert_eq!((published.parse(), condition.published()), (Ok(condition), published));
        }
        let unknown = "sim".parse::<Condition>().expect_err("no condition").to_string();
        assert!(unknown.contains("nominal, simultaneous, camera"), "{unknown}");
        assert!("none".parse::<Condition>().is_err());
    }

    #[test]
    fn simultaneous_perturbs_all_axes_of_its_campaign() {
        let campaign = AxisSet::from_iter([Axis::Camera, Axis::Robot]);
        assert_eq!(Condition::Simultaneous.axes(campaign), campaign);
        assert_eq!(Condition::Single(Axis::Sensor).axes(campaign), AxisSet::of(Axis::Sensor));
        assert_eq!(Condition::of(campaign).axes(AxisSet::ALL), campaign);
    }
}
