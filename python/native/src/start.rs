use benchmark::attempt::{Capsule, tenths_of_mm};
use benchmark::numpy::LegacyRng;
use benchmark::{ManifestRow, Realisation, RolloutId, TaskRef, row_of};
use pyo3::prelude::*;
use serde::Deserialize;
use sim::episode::NO_OP;
use sim::{ActionFrame, Conditions, Environment, ReadyScene, Reset};

use crate::error::{invalid, simulation, value};

pub(crate) enum Start {
    Row(Box<ManifestRow>),
    Sampled(Sampled),
    Legacy(Legacy),
    Repeated(Repeated),
}

/// A finished rollout up to a control step.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Repeated {
    capsule: Box<Capsule>,
    /// Control steps that are repeated.
    steps: usize,
}

/// Start of the original's `OffScreenRenderEnv`: `seed`, reset, `set_init_state`, settling.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Legacy {
    /// Seed of NumPy's legacy generator, which places fixtures and, without a state, all objects.
    legacy_seed: u32,
    /// Number of times that the original has loaded its model by the end of this start's reset.
    rounds: u32,
    settle_steps: u32,
    settle_action: [f64; 7],
    /// Time, qpos, qvel; `None` keeps the placement of the reset.
    #[serde(default)]
    state: Option<Vec<f64>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Sampled {
    /// Seed of NumPy's legacy generator.
    sampled: u32,
    settle_steps: u32,
    /// Row whose perturbations are applied. Its initial state is ignored, and fixtures are
    /// placed as in campaigns.
    #[serde(default)]
    perturbed: Option<Box<ManifestRow>>,
}

/// The original has loaded its model once at construction and once at the reset.
const JOINT_SAMPLER_ROUNDS: u32 = 2;

impl Start {
    /// Parses JSON: a row; or `{"sampled": SEED, "settle_steps": N, "perturbed": ROW}` with
    /// optional `perturbed`; or `{"legacy_seed": SEED, "rounds": N, "settle_steps": N,
    /// "settle_action": [..], "state": [..]}` with optional `state`; or
    /// `{"capsule": CAPSULE, "steps": N}`.
    ///
    /// # Errors
    /// If the JSON has none of these forms.
    pub(crate) fn read(json: &str) -> PyResult<Self> {
        let read = || {
            let value: serde_json::Value = serde_json::from_str(json)?;
            if value.get("sampled").is_some() {
                return serde_json::from_value(value).map(Self::Sampled);
            }
            if value.get("capsule").is_some() {
                return serde_json::from_value(value).map(Self::Repeated);
            }
            if value.get("legacy_seed").is_some() {
                return serde_json::from_value(value).map(Self::Legacy);
            }
            serde_json::from_value(value).map(|row| Self::Row(Box::new(row)))
        };
        read().map_err(not_a_row)
    }

    /// Starts the rollout in an environment of its scene and runs the settling steps.
    /// Perturbations use the matched realisation, or that of the capsule. Returns the conditions
    /// that change actions and frames; `None` if the start has no manifest row.
    ///
    /// # Errors
    /// If `ready` is needed and missing, the task has no such initial state, a state has the wrong
    /// length, objects cannot be placed, the physics diverges, or the robot does not move as in the
    /// capsule.
    pub(crate) fn begin(
        &self,
        ready: Option<&ReadyScene>,
        environment: &mut Environment,
    ) -> PyResult<Option<Conditions>> {
        match self {
            Self::Row(row) => begin_row(ready, environment, row, Realisation::Matched).map(Some),
            Self::Repeated(repeated) => repeated.begin(ready, environment).map(Some),
            Self::Sampled(placement) => {
                let mut rng = LegacyRng::seed(placement.sampled);
                let reset = environment.reset(&mut rng, Reset::Hard, JOINT_SAMPLER_ROUNDS);
                reset.map_err(simulation)?;
                let conditions = match &placement.perturbed {
                    Some(row) => {
                        let (state, ready) = (environment.state(), require_initial_states(ready)?);
                        let matched = Realisation::Matched;
                        let conditions =
                            Conditions::begin_at(state, ready, environment, row, matched);
                        Some(conditions.map_err(simulation)?)
                    }
                    None => None,
                };
                for _ in 0..placement.settle_steps {
                    environment.step(&NO_OP).map_err(simulation)?;
                }
                Ok(conditions)
            }
            Self::Legacy(start) => start.begin(environment).map(|()| None),
        }
    }
}

fn begin_row(
    ready: Option<&ReadyScene>,
    environment: &mut Environment,
    row: &ManifestRow,
    realisation: Realisation,
) -> PyResult<Conditions> {
    let ready = require_initial_states(ready)?;
    let conditions = Conditions::begin(ready, environment, row, realisation);
    let conditions = conditions.map_err(simulation)?;
    conditions.settle(environment).map_err(simulation)?;
    Ok(conditions)
}

impl Repeated {
    fn begin(
        &self,
        ready: Option<&ReadyScene>,
        environment: &mut Environment,
    ) -> PyResult<Conditions> {
        let Capsule { manifest_row: row, measurement, actions, path, .. } = &*self.capsule;
        if !self.capsule.is_of_libero() {
            return Err(invalid(format_args!(
                "begin in {}: capsules of LIBERO's own forty tasks can be begun in",
                row.id
            )));
        }
        let realisation = measurement.provenance.realisation.parse().map_err(value)?;
        let mut conditions = begin_row(ready, environment, row, realisation)?;
        for action in actions.iter().take(self.steps) {
            let action = action.map(f64::from);
            let step = conditions.step(environment, &action, ActionFrame::Relative);
            step.map_err(simulation)?;
        }
        let position = tenths_of_mm(environment.robot_state().eef_pos);
        if path.get(self.steps) != Some(&position) {
            return Err(invalid(format_args!(
                "repeat {} steps of {}: the robot moves otherwise than in the capsule, which was \
                 made with asset pack {}, look {} and MuJoCo {}",
                self.steps,
                row.id,
                measurement.provenance.pin.asset_pack_digest,
                measurement.provenance.pin.look,
                measurement.provenance.pin.mujoco_version
            )));
        }
        Ok(conditions)
    }
}

impl Legacy {
    fn begin(&self, environment: &mut Environment) -> PyResult<()> {
        if let Some(state) = &self.state {
            check_width(environment, state)?;
        }
        let mut rng = LegacyRng::seed(self.legacy_seed);
        let reset = environment.reset(&mut rng, Reset::Hard, self.rounds);
        reset.map_err(simulation)?;
        if let Some(state) = &self.state {
            environment.set_state(state);
            environment.forward();
            environment.post_process();
            environment.observe_now();
        }
        for _ in 0..self.settle_steps {
            environment.step(&self.settle_action).map_err(simulation)?;
        }
        Ok(())
    }
}

/// Checks that a vector has the length of a state of an environment's scene.
///
/// # Errors
/// `ValueError` if the length differs.
pub(crate) fn check_width(environment: &Environment, numbers: &[f64]) -> PyResult<()> {
    let model = environment.model();
    let needed = 1 + model.nq() + model.nv();
    if numbers.len() == needed {
        return Ok(());
    }
    Err(invalid(format_args!(
        "load a state of {} numbers: a state of this scene has {needed} (time, {} of qpos, {} of \
         qvel); is it of another task?",
        numbers.len(),
        model.nq(),
        model.nv()
    )))
}

/// Returns the names of the axes that a manifest row, JSON, perturbs.
///
/// # Errors
/// `ValueError` if the JSON is not a row.
#[pyfunction]
pub(crate) fn perturbed_axes(row: &str) -> PyResult<Vec<String>> {
    let row: ManifestRow = serde_json::from_str(row).map_err(not_a_row)?;
    Ok(row.axes().axes().map(|axis| axis.to_string()).collect())
}

fn not_a_row(error: serde_json::Error) -> PyErr {
    invalid(format_args!(
        "read a configuration: {error}; it has the columns of a campaign's manifest"
    ))
}

fn require_initial_states(ready: Option<&ReadyScene>) -> PyResult<&ReadyScene> {
    ready.ok_or_else(|| invalid("begin at an initial state: give Scene its init_file"))
}

#[pyfunction]
pub(crate) fn task(name: &str) -> PyResult<(&'static str, u8, &'static str, String, u32)> {
    let task: TaskRef = name.parse().map_err(value)?;
    let suite = task.suite();
    Ok((suite.name(), task.index(), task.name(), task.instruction(), suite.max_steps()))
}

#[pyfunction]
pub(crate) fn configuration_row(id: &str) -> PyResult<String> {
    let id: RolloutId = id.parse().map_err(value)?;
    row_of(id).map_err(value).map(|row| json(&row))
}

#[pyfunction]
pub(crate) fn nominal_row(task: &str, initial_state: u16) -> PyResult<String> {
    let task: TaskRef = task.parse().map_err(value)?;
    let id = RolloutId::nominal(task, initial_state);
    let row = ManifestRow::new(id, initial_state, initial_state, Default::default());
    Ok(json(&row))
}

fn json(row: &ManifestRow) -> String {
    serde_json::to_string(row).expect("a row is JSON")
}
