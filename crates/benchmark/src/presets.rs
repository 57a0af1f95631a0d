//! Presets of LIBERO-CTRL v0.1: directions, units, evaluation states, step budgets
//! and sizes of demonstrated actions, read from `data/presets.json`. This module computes
//! parameters from them; `perturbation` defines the parameters' meaning.
//!
//! Source: the numbers in `manifests/v0.1/manifest.json` of the protocol's released
//! code (arXiv 2609.15940).

use std::collections::BTreeMap;
use std::sync::LazyLock;

use serde::Deserialize;

use crate::axis::Axis;
use crate::level::Level;
use crate::perturbation::Perturbation;
use crate::suite::{Suite, TaskRef};

/// Number of presets per axis, and of configurations per task and level.
pub const PRESETS: u16 = 10;

/// Control steps without action before the policy starts. Meanwhile the objects settle, because the
/// released initial states place them above their supports.
pub const SETTLE_STEPS: u32 = 10;

/// Seed of NumPy's legacy generator before a scene is composed and before each
/// reset, so that every rollout of a task sees the same fixtures.
pub const ENV_SEED: u32 = 20_260_904;

/// Returns the units of an axis's parameters, that is, their values at radius 1. Empty for
/// the language axis.
pub fn unit(axis: Axis) -> &'static [f64] {
    let presets = presets().axes.get(axis.name());
    presets.map_or(&[], |presets| &presets.unit)
}

/// Sets the parameters of preset `config` of `axis` at `level` in a perturbation. The language
/// axis has no parameters.
///
/// # Panics
/// If `config` is not below [`PRESETS`].
pub fn apply_preset(perturbation: &mut Perturbation, axis: Axis, level: Level, config: u16) {
    apply_direction(perturbation, axis, level, preset_direction(axis, config));
}

/// Sets the parameters of `axis` in `direction` at `level` in a perturbation. The
/// language axis has no parameters.
///
/// Every parameter is radius × unit × direction, rounded to six decimals.
///
/// # Panics
/// If `direction` has fewer components than the axis has parameters.
pub(crate) fn apply_direction(
    perturbation: &mut Perturbation,
    axis: Axis,
    level: Level,
    direction: &[f64],
) {
    let (unit, radius) = (unit(axis), level.radius());
    perturbation.set(axis, |i| round6(radius * unit[i] * direction[i]));
}

/// Returns the direction of preset `config`: a unit vector, empty for the language axis.
///
/// # Panics
/// If `config` is not below [`PRESETS`].
pub(crate) fn preset_direction(axis: Axis, config: u16) -> &'static [f64] {
    let presets = presets().axes.get(axis.name());
    presets.map_or(&[], |presets| &presets.directions[usize::from(config)])
}

/// Returns the indices of the components of an axis that are at least 0 in drawn directions: the
/// camera's distance, the hand's height, lag and noise of the actions. Presets may have negative
/// lag and noise, of which the simulator uses the magnitude.
pub(crate) fn half_space(axis: Axis) -> &'static [usize] {
    let presets = presets().axes.get(axis.name());
    presets.map_or(&[], |presets| &presets.half_space)
}

/// Rounds to six decimals like Python's `round(x, 6)`: correctly from the exact
/// binary value, ties to even, preserving the sign of zero.
pub fn round6(value: f64) -> f64 {
    // Formatting with a precision rounds the exact value; scaling by 10⁶ first
    // would round twice and differ in the last digit of some presets.
    format!("{value:.6}").parse().expect("a formatted float parses")
}

impl Suite {
    /// Step budget of the policy, control steps. A suite file defines the budget of its tasks.
    pub fn max_steps(self) -> u32 {
        self.presets().max_steps
    }

    /// Root mean square of the demonstrations' actions: translation and
    /// rotation, in action units. Scales the actuation axis.
    pub fn demo_action_rms(self) -> [f64; 2] {
        self.presets().demo_action_rms
    }

    /// LIBERO's longest suite stands in for those that are not LIBERO's.
    fn presets(self) -> &'static SuitePresets {
        let longest = Self::ALL.len() - 1;
        &presets().suites[self.ordinal().unwrap_or(longest)]
    }
}

impl TaskRef {
    /// Initial states of configurations 0 to 9; none for a task of a suite file.
    pub fn eval_init_ids(self) -> &'static [u16] {
        match self.suite() {
            Suite::Own | Suite::Simulated => &[],
            suite => &suite.presets().eval_init_ids[usize::from(self.index())],
        }
    }
}

struct SuitePresets {
    max_steps: u32,
    demo_action_rms: [f64; 2],
    eval_init_ids: [[u16; 10]; 10],
}

struct Presets {
    suites: [SuitePresets; 4],
    axes: BTreeMap<String, AxisPresets>,
}

fn presets() -> &'static Presets {
    static PRESETS: LazyLock<Presets> = LazyLock::new(|| {
        let file: PresetsFile = serde_json::from_str(include_str!("../data/presets.json"))
            .expect("the embedded presets are valid");
        Presets::from(file)
    });
    &PRESETS
}

struct AxisPresets {
    unit: Vec<f64>,
    half_space: Vec<usize>,
    directions: Vec<Vec<f64>>,
}

#[derive(Deserialize)]
struct PresetsFile {
    protocol: ProtocolFigures,
    axes: BTreeMap<String, AxisFigures>,
    directions: BTreeMap<String, Vec<Vec<f64>>>,
    eval_init_ids: BTreeMap<Suite, [[u16; 10]; 10]>,
}

#[derive(Deserialize)]
struct ProtocolFigures {
    max_steps: BTreeMap<Suite, u32>,
    demo_action_rms: BTreeMap<Suite, [f64; 2]>,
}

#[derive(Deserialize)]
struct AxisFigures {
    unit: Vec<f64>,
    half_space: Vec<usize>,
}

impl From<PresetsFile> for Presets {
    fn from(mut file: PresetsFile) -> Self {
        let suites = Suite::ALL.map(|suite| SuitePresets {
            max_steps: file.protocol.max_steps[&suite],
            demo_action_rms: file.protocol.demo_action_rms[&suite],
            eval_init_ids: file.eval_init_ids[&suite],
        });
        let axes = file.axes.into_iter().map(|(name, figures)| {
            let directions = file.directions.remove(&name).unwrap_or_default();
            let presets =
                AxisPresets { unit: figures.unit, half_space: figures.half_space, directions };
            (name, presets)
        });
        Self { suites, axes: axes.collect() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::Value;

    fn file() -> Value {
        serde_json::from_str(include_str!("../data/presets.json")).expect("JSON")
    }

    #[test]
    fn parameters_have_the_names_and_the_order_of_the_presets() {
        for axis in Axis::every().filter(|axis| !axis.def().parameters.is_empty()) {
            let keys: Vec<&str> = axis.def().parameters.iter().map(|it| it.key).collect();
            assert_eq!(file()["axes"][axis.name()]["keys"], serde_json::json!(keys));
            let AxisPresets { unit, directions, .. } = &presets().axes[axis.name()];
            assert_eq!(unit.len(), keys.len(), "{axis}");
            assert_eq!(directions.len(), usize::from(PRESETS), "{axis}");
            assert!(directions.iter().all(|d| d.len() == keys.len()), "{axis}");
        }
    }

    #[test]
    fn constants_equal_the_figures_of_the_file() {
        let protocol = &file()["protocol"];
        assert_eq!(protocol["env_seed"], ENV_SEED);
        assert_eq!(protocol["num_steps_wait"], SETTLE_STEPS);
        assert_eq!(protocol["eval_configs"], PRESETS);
        for level in Level::PERTURBED {
            let multiplier = &file()["severity_multipliers"][level.to_string()];
            assert_eq!(multiplier, &level.radius());
        }
        assert_eq!(Suite::Long.max_steps(), 520);
        assert_eq!(Suite::Goal.demo_action_rms(), [0.739, 0.143]);
    }

    /// The parameters of `spatial/t0/simultaneous/L1/c01` and two parameters that lie on a
    /// decimal tie, as the manifest of the reference implementation writes them.
    #[test]
    fn parameters_equal_the_references_digits() {
        let values = |axis, level, config| {
            let mut perturbation = Perturbation::default();
            apply_preset(&mut perturbation, axis, level, config);
            perturbation.values(axis)
        };
        let camera = values(Axis::Camera, Level::L1, 1);
        assert_eq!(camera, [-3.58936, 0.404697, 0.063736, 0.013033, -0.016198]);
        let robot = values(Axis::Robot, Level::L1, 1);
        assert_eq!(robot, [0.00361, -0.024367, 0.016343, 4.716338, 1.696958, -4.05363]);
        let lighting = values(Axis::Lighting, Level::L2, 1);
        assert_eq!(lighting[1], -0.617393);
        let lighting = values(Axis::Lighting, Level::L1, 2);
        assert_eq!(lighting[1], -0.091088);
    }

    #[test]
    fn directions_are_unit_vectors() {
        for (axis, presets) in &presets().axes {
            for direction in &presets.directions {
                let length = direction.iter().map(|x| x * x).sum::<f64>().sqrt();
                assert!((length - 1.0).abs() < 2e-4, "{axis}: {length}");
            }
        }
    }

    #[test]
    fn round6_rounds_like_python() {
        assert_eq!(round6(0.5e-6), 0.0);
        assert_eq!(round6(1.25), 1.25);
        assert_eq!(round6(2.675_000_5), 2.675);
        assert!(round6(-1e-9).is_sign_negative());
    }
}
