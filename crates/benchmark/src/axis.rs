//! The axes: [`AXES`] defines each once. Rows, ids, columns, figures, pages and messages follow from
//! it. An axis with numbers also has an entry in `perturbation!` and in `data/presets.json`; an array of
//! the model that it changes is in `each_own_array!` and `slices!` of `sim`, and in the documentation of
//! Python's `set_model_array`. Results accept realised values of [`Axis::METRIC`] only.

use std::fmt;
use std::str::FromStr;

use crate::latency::STEPS_PER_RADIUS;
use crate::level::Level;
use crate::names::{UnknownName, serde_as_text};
use crate::perturbation::{
    ActuationDistortion, CameraShift, LightingShift, Parameter, RobotShift, SensorCorruption,
};

/// One kind of perturbation.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Axis {
    Camera,
    Lighting,
    Robot,
    Sensor,
    Actuation,
    Language,
    Latency,
}

pub struct AxisDef {
    pub axis: Axis,
    /// Name in rollout ids, manifests, columns and command lines.
    pub name: &'static str,
    /// Noun phrase for the perturbation, in docs/PROTOCOL.md and the help of `--axes`.
    pub about: &'static str,
    /// True for the protocol's six axes, which *simultaneous* and sets perturb together. Any other
    /// axis runs only alone and is in no paired measure.
    pub is_combined: bool,
    pub acts_on: ActsOn,
    /// True if values are drawn besides the parameters.
    pub is_random: bool,
    pub radii: Radii,
    /// The numbers in the row's `perturb`. `data/presets.json` has their units and directions.
    pub parameters: &'static [Parameter],
}

/// Part of a rollout that an axis perturbs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ActsOn {
    /// The scene at its start.
    Scene,
    Pictures,
    Actions,
    Instruction,
    /// The time of the policy's answers: the axis sets the execution model of its rows.
    Answers,
}

/// Radii at which an axis can run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Radii {
    Any,
    /// Those of L1, L2 and L3. At the placebo level nothing is perturbed.
    Named,
    /// Multiples of this radius; there is no placebo.
    Multiples(f64),
}

/// The protocol's axes in the order of the reference implementation, then further ones.
pub const AXES: &[AxisDef] = &[
    AxisDef {
        parameters: &CameraShift::PARAMETERS,
        ..define(Axis::Camera, "camera", ActsOn::Scene, "pose of the `agentview` camera")
    },
    AxisDef {
        parameters: &LightingShift::PARAMETERS,
        ..define(
            Axis::Lighting,
            "lighting",
            ActsOn::Scene,
            "lights and the headlight's ambient term",
        )
    },
    AxisDef {
        parameters: &RobotShift::PARAMETERS,
        ..define(Axis::Robot, "robot", ActsOn::Scene, "initial pose of the end-effector")
    },
    AxisDef {
        is_random: true,
        parameters: &SensorCorruption::PARAMETERS,
        ..define(Axis::Sensor, "sensor", ActsOn::Pictures, "corruption of the rendered pictures")
    },
    AxisDef {
        is_random: true,
        parameters: &ActuationDistortion::PARAMETERS,
        ..define(
            Axis::Actuation,
            "actuation",
            ActsOn::Actions,
            "distortion of the actions on their way to the controller",
        )
    },
    AxisDef {
        radii: Radii::Named,
        ..define(Axis::Language, "language", ActsOn::Instruction, "paraphrase of the instruction")
    },
    AxisDef {
        is_combined: false,
        radii: Radii::Multiples(1.0 / STEPS_PER_RADIUS),
        ..define(
            Axis::Latency,
            "latency",
            ActsOn::Answers,
            "delay of the policy's answers by R/2 control steps at radius R: 1, 2, 4 at L1, L2, L3",
        )
    },
];

/// Returns a combined axis without random values and parameters, at any radius.
const fn define(axis: Axis, name: &'static str, acts_on: ActsOn, about: &'static str) -> AxisDef {
    let (is_random, radii, parameters) = (false, Radii::Any, &[]);
    AxisDef { axis, name, about, is_combined: true, acts_on, is_random, radii, parameters }
}

impl AxisDef {
    /// True if the first observation of a rollout shows the axis.
    pub const fn in_first_frame(&self) -> bool {
        matches!(self.acts_on, ActsOn::Scene | ActsOn::Pictures)
    }
}

impl Radii {
    pub fn contains(self, level: Level) -> bool {
        match self {
            Self::Any => true,
            Self::Named => level.is_named() || level == Level::L0,
            Self::Multiples(of) => level.radius() >= of && level.radius() % of == 0.0,
        }
    }
}

impl Axis {
    /// The protocol's six axes, which *simultaneous* perturbs.
    pub const ALL: [Self; 6] = protocol(false);

    /// The protocol's axes with numeric parameters: all except language.
    pub const METRIC: [Self; 5] = protocol(true);

    /// Returns every axis, also those that are perturbed only alone.
    pub fn every() -> impl Iterator<Item = Self> + Clone {
        AXES.iter().map(|def| def.axis)
    }

    pub const fn def(self) -> &'static AxisDef {
        &AXES[self as usize]
    }

    /// Returns the name in rollout ids and manifests.
    pub const fn name(self) -> &'static str {
        self.def().name
    }
}

const fn protocol<const N: usize>(only_metric: bool) -> [Axis; N] {
    let (mut axes, mut count, mut i) = ([Axis::Camera; N], 0, 0);
    while i < AXES.len() {
        if AXES[i].is_combined && !(only_metric && AXES[i].parameters.is_empty()) {
            axes[count] = AXES[i].axis;
            count += 1;
        }
        i += 1;
    }
    axes
}

impl fmt::Display for Axis {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

impl FromStr for Axis {
    type Err = UnknownName;

    fn from_str(text: &str) -> Result<Self, UnknownName> {
        Self::every().find(|axis| axis.name() == text).ok_or_else(|| {
            UnknownName::new("axis", text, &Self::every().map(Self::name).collect::<Vec<_>>())
        })
    }
}

serde_as_text!(Axis);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_axis_is_defined_in_its_place_documented_and_listed_for_an_unknown_one() {
        let page = include_str!("../../../docs/PROTOCOL.md");
        for axis in Axis::every() {
            let AxisDef { axis: defined, name, about, .. } = axis.def();
            let line = format!("| `{name}` | {about} |");
            assert!(axis == *defined && page.contains(&line), "docs/PROTOCOL.md lacks {line}");
        }
        let names = "camera, lighting, robot, sensor, actuation, language, latency";
        let error = "camrea".parse::<Axis>().expect_err("no such axis");
        assert_eq!(error.to_string(), format!("read axis `camrea`: valid are {names}"));
    }
}
