//! Rows of tasks of other simulators, which `docs/SIMULATORS.md` describes: the part of a manifest
//! row that names the task, and the short form in which people write such rows.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use crate::axis::{ActsOn, Axis};
use crate::axis_set::AxisSet;
use crate::condition::Condition;
use crate::directions::{Directions, direction};
use crate::latency::execution_at;
use crate::level::Level;
use crate::own_task::{InvalidField, check_name, check_range, invalid, quoted};
use crate::perturbation::Perturbation;
use crate::presets::apply_direction;
use crate::rollout_id::RolloutId;
use crate::row::ManifestRow;
use crate::suite::TaskRef;

/// Longest name of a task, bytes.
const MAX_TASK_BYTES: usize = 128;
/// Longest instruction, bytes, which is also that of instructions in results.
const MAX_INSTRUCTION_BYTES: usize = 4096;
/// Step budget of a row that names none: the simulator's own, which a row can only shorten, is below
/// it.
const MAX_STEPS: u32 = 10_000;
/// Identifier of the paraphrase of a row in the short form.
const GIVEN: &str = "given";

/// Parameters of axes that act in the simulator, by axis.
pub type Parameters = BTreeMap<Axis, Map<String, Value>>;

/// A task of another simulator.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SimulatedTask {
    /// Name under which workers serve the simulator, their option `--simulator NAME=COMMAND`.
    pub name: String,
    /// Name of the task, as the simulator describes it.
    pub task: String,
    /// Instruction without the language axis; empty for the one that the simulator describes.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub instruction: String,
    /// Passed to the simulator as they are.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub perturb: Parameters,
}

impl SimulatedTask {
    /// Returns the part of a condition whose axes act in the worker, and not in the simulator.
    pub(crate) fn acting_in_worker(&self, condition: Condition) -> Condition {
        match condition {
            Condition::Single(axis) if self.perturb.contains_key(&axis) => Condition::Nominal,
            Condition::Subset(axes) => {
                Condition::of(axes.without(self.perturb.keys().copied().collect()))
            }
            condition => condition,
        }
    }

    pub(crate) fn check(
        &self,
        condition: Condition,
        in_worker: &Perturbation,
    ) -> Result<(), InvalidField> {
        check_name("simulator.name", &self.name)?;
        check_line("simulator.task", &self.task, 1, MAX_TASK_BYTES)?;
        check_line("simulator.instruction", &self.instruction, 0, MAX_INSTRUCTION_BYTES)?;
        let given: AxisSet = self.perturb.keys().copied().collect();
        if let Some(axis) = given.axes().find(|axis| !acts_in_simulator(*axis)) {
            let remedy = "this axis acts in the worker: give its parameters as those of LIBERO";
            return Err(invalid("simulator.perturb", &quoted(axis.name()), remedy));
        }
        if let Some(axis) = in_worker.axes().into_iter().find(|axis| acts_in_simulator(*axis)) {
            let remedy = "this axis acts in the simulator: give its parameters in \
                          `simulator.perturb`";
            return Err(invalid("perturb", &quoted(axis.name()), remedy));
        }
        let expected: AxisSet =
            condition.axes(given).axes().filter(|axis| acts_in_simulator(*axis)).collect();
        match given == expected {
            true => Ok(()),
            false => {
                let remedy = format!("give parameters of {expected}, the condition's axes");
                Err(invalid("simulator.perturb", &quoted(given.name()), &remedy))
            }
        }
    }

    pub(crate) fn only(&mut self, axes: AxisSet) {
        self.perturb.retain(|axis, _| axes.contains(*axis));
    }
}

fn acts_in_simulator(axis: Axis) -> bool {
    axis.def().acts_on == ActsOn::Scene
}

fn check_line(field: &str, text: &str, least: usize, most: usize) -> Result<(), InvalidField> {
    match (least..=most).contains(&text.len()) && !text.contains(char::is_control) {
        true => Ok(()),
        false => {
            let remedy = format!("write {least} to {most} bytes on one line");
            Err(invalid(field, &quoted(&text.escape_debug().to_string()), &remedy))
        }
    }
}

/// A row in the short form. What it leaves out follows from the simulator's description, and the
/// parameters of sensor and actuation from LIBERO-CTRL's directions and units.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct ShortRow {
    simulator: String,
    task: String,
    /// Seed of the simulator's reset. Rows of the same task and seed are paired.
    seed: u16,
    /// Perturbed axes: none in a nominal row; several perturb at once.
    #[serde(default)]
    axes: Vec<Axis>,
    radius: Option<f64>,
    /// True if the radius is that of the placebo level.
    #[serde(default)]
    placebo: bool,
    /// Configuration, which determines directions and random elements; the seed if not given.
    config: Option<u16>,
    /// Parameters by axis: of every axis that acts in the simulator, and of others in place of those
    /// of the configuration's direction.
    #[serde(default)]
    perturb: Parameters,
    /// Paraphrase, if language is perturbed.
    language: Option<String>,
    instruction: Option<String>,
    max_steps: Option<u32>,
}

/// Places of tasks in a manifest, by simulator and name, in the order of their first rows.
#[derive(Default)]
pub(crate) struct TaskPlaces(BTreeMap<(String, String), TaskRef>);

impl TaskPlaces {
    fn of(&mut self, row: &ShortRow) -> Result<TaskRef, InvalidField> {
        let key = (row.simulator.clone(), row.task.clone());
        if let Some(task) = self.0.get(&key) {
            return Ok(*task);
        }
        let index = u8::try_from(self.0.len()).map_err(|_| {
            invalid("task", &quoted(&row.task), "a manifest has at most 256 tasks: divide it")
        })?;
        let task = TaskRef::simulated(index);
        self.0.insert(key, task);
        Ok(task)
    }
}

impl ShortRow {
    pub(crate) fn complete(self, places: &mut TaskPlaces) -> Result<ManifestRow, InvalidField> {
        let task = places.of(&self)?;
        let axes: AxisSet = self.axes.iter().copied().collect();
        let (id, placebo_radius) = self.id(task, axes)?;
        let config = id.config().unwrap_or(self.seed);
        let radius = placebo_radius.unwrap_or(id.level());
        let mut in_worker = Map::new();
        let mut perturb = Parameters::new();
        for (axis, parameters) in self.perturb {
            match acts_in_simulator(axis) {
                true => perturb.insert(axis, parameters).map_or((), drop),
                false => drop(in_worker.insert(axis.to_string(), Value::Object(parameters))),
            }
        }
        let field = |axis: Axis| format!("perturb.{axis}");
        let mut perturbation = Perturbation::from_manifest(Condition::Simultaneous, in_worker)
            .map_err(|error| invalid("perturb", "invalid", &error.to_string()))?;
        let given: AxisSet =
            perturbation.axes().into_iter().chain(perturb.keys().copied()).collect();
        if let Some(axis) = given.without(axes).axes().next() {
            return Err(invalid(&field(axis), "given", "add the axis to `axes`"));
        }
        for axis in axes.without(given).axes() {
            if acts_in_simulator(axis) {
                let remedy = "the axis acts in the simulator: give the parameters that it passes \
                              to the environment";
                return Err(invalid(&field(axis), "missing", remedy));
            }
            let direction = direction(Directions::Shared, task, axis, config, 0);
            apply_direction(&mut perturbation, axis, radius, &direction);
        }
        let is_reworded = axes.contains(Axis::Language) && placebo_radius.is_none();
        if is_reworded != self.language.is_some() {
            let remedy = "write the paraphrase in rows that perturb language, and in no others";
            let given = if is_reworded { "missing" } else { "given" };
            return Err(invalid("language", given, remedy));
        }
        let instruction = self.instruction.unwrap_or_default();
        let max_steps = self.max_steps.unwrap_or(MAX_STEPS);
        check_range("max_steps", max_steps, 1, MAX_STEPS)?;
        let mut row = ManifestRow {
            instruction: self.language.unwrap_or_else(|| instruction.clone()),
            variant_id: axes.contains(Axis::Language).then(|| GIVEN.to_owned()),
            max_steps,
            settle_steps: 0,
            placebo_radius,
            simulator: Some(Box::new(SimulatedTask {
                name: self.simulator,
                task: self.task,
                instruction,
                perturb,
            })),
            ..ManifestRow::new(id, id.number(), self.seed, perturbation)
        };
        if id.condition().sets_execution() {
            row.execution = execution_at(id.level()).ok_or_else(|| {
                let given = id.level().radius().to_string();
                invalid("radius", &given, "write an even radius: a control step of delay is 2")
            })?;
        }
        Ok(row)
    }

    fn id(&self, task: TaskRef, axes: AxisSet) -> Result<(RolloutId, Option<Level>), InvalidField> {
        let level = self.radius.map(|radius| {
            Level::of_radius(radius)
                .ok_or_else(|| invalid("radius", &radius.to_string(), "write 0.001 to 100"))
        });
        let level = level.transpose()?;
        let condition = match axes.len() {
            0 => Condition::Nominal,
            1 => Condition::of(axes),
            _ if axes.contains(Axis::Latency) => {
                let remedy = "latency is combined with no other axis: perturb it alone";
                return Err(invalid("axes", &quoted(axes.name()), remedy));
            }
            _ => Condition::Simultaneous,
        };
        match (level, condition) {
            (None, Condition::Nominal) if !self.placebo => {
                Ok((RolloutId::nominal(task, self.seed), None))
            }
            (Some(radius), condition) if condition != Condition::Nominal => {
                let level = if self.placebo { Level::L0 } else { radius };
                let config = self.config.unwrap_or(self.seed);
                let id = RolloutId::perturbed(task, condition, level, config)
                    .expect("the condition has a configuration");
                Ok((id, self.placebo.then_some(radius)))
            }
            _ => {
                let given = if level.is_some() { "given" } else { "missing" };
                let remedy = "write a radius in rows with axes, and in no others";
                Err(invalid("radius", given, remedy))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::manifest;
    use crate::task_key::TaskKey;

    fn parse(line: &str) -> Result<ManifestRow, String> {
        let fields = r#"{"simulator": "metaworld", "task": "reach-v3", "seed": 7"#;
        let rows = manifest::parse(&format!("{fields}{line}}}"));
        rows.map(|mut rows| rows.remove(0)).map_err(|error| error.to_string())
    }

    fn row(line: &str) -> ManifestRow {
        parse(line).expect(line)
    }

    #[test]
    fn short_rows_are_completed_and_keep_their_meaning_as_stored_rows() {
        let check = |line: &str, id: &str| {
            let row = row(line);
            assert_eq!((row.id.to_string().as_str(), row.init_id), (id, 7));
            assert_eq!(TaskKey::of_row(&row), "simulated/metaworld/reach-v3");
            for stored in [serde_json::to_string(&row).expect("JSON"), row.published()] {
                assert_eq!(serde_json::from_str::<ManifestRow>(&stored).expect(&stored), row);
            }
            row
        };
        let nominal = check("", "sim/t0/nominal/i07");
        assert!(nominal.instruction.is_empty() && nominal.axes().is_empty());
        let sensor = check(r#", "axes": ["sensor"], "radius": 4"#, "sim/t0/sensor/r4/c07");
        let both = r#", "axes": ["sensor", "actuation"], "radius": 4, "config": 3"#;
        let both = check(both, "sim/t0/simultaneous/r4/c03");
        assert_eq!(both.axes(), AxisSet::from_iter([Axis::Sensor, Axis::Actuation]));
        assert_ne!(both.perturbation.sensor, sensor.perturbation.sensor);
        let alone = both.only(AxisSet::of(Axis::Sensor)).expect("one of its axes");
        assert_eq!(alone.id.to_string(), "sim/t0/sensor/r4/c03");
        let camera = r#", "axes": ["camera", "language"], "radius": 1, "language": "reach it",
            "instruction": "reach", "perturb": {"camera": {"yaw": 0.1}}"#;
        let camera = check(&camera.replace('\n', ""), "sim/t0/simultaneous/r1/c07");
        assert_eq!(camera.axes().name(), "camera+language");
        assert_eq!(camera.canonical_instruction(), "reach");
        for (axis, instruction) in [(Axis::Camera, "reach"), (Axis::Language, "reach it")] {
            let alone = camera.only(AxisSet::of(axis)).expect("one of its axes");
            assert_eq!((alone.axes(), &*alone.instruction), (AxisSet::of(axis), instruction));
            let stored = serde_json::to_string(&alone).expect("JSON");
            assert_eq!(serde_json::from_str::<ManifestRow>(&stored).expect("reads"), alone);
        }
        check(
            r#", "axes": ["actuation"], "radius": 0.02, "placebo": true"#,
            "sim/t0/actuation/L0/c07",
        );
        let late = check(r#", "axes": ["latency"], "radius": 4"#, "sim/t0/latency/r4/c07");
        assert_eq!(late.execution.to_string(), "overlap:2");
    }

    #[test]
    fn invalid_short_rows_are_refused_with_the_field_and_the_remedy() {
        let check = |line: &str, expected: &str| {
            let error = parse(line).expect_err(line);
            assert!(error.contains("line 1") && error.contains(expected), "{error}");
        };
        check(r#", "axes": ["sensor"]"#, "`radius` is missing: write a radius in rows with axes");
        check(r#", "radius": 2"#, "`radius` is given");
        check(r#", "axes": ["friction"], "radius": 2"#, "read axis `friction`: valid are camera");
        check(r#", "axes": ["camera"], "radius": 2"#, "`perturb.camera` is missing: the axis acts");
        check(r#", "perturb": {"camera": {}}"#, "`perturb.camera` is given: add the axis");
        check(r#", "axes": ["language"], "radius": 2"#, "`language` is missing");
        check(r#", "axes": ["latency"], "radius": 3"#, "write an even radius");
        check(r#", "axes": ["sensor", "latency"], "radius": 2"#, "perturb it alone");
        check(r#", "max_steps": 0"#, "`max_steps` is 0: write 1 to 10000");
        check(r#", "steps": 9"#, "there is no field `steps`");
        check(r#", "axes": ["sensor"], "radius": 2, "perturb": {"sensor": {}}"#, "`noise_sigma`");
        let [reach, push] = ["reach", "push"].map(|task| {
            let text = format!(r#"{{"simulator": "metaworld", "task": "{task}", "seed": 0}}"#);
            manifest::parse(&text).expect("a row").remove(0)
        });
        let error = manifest::check(&[reach, ManifestRow { init_id: 1, ..push }]);
        let error = error.expect_err("two tasks of one number").to_string();
        assert!(error.contains("metaworld/push, but for simulated/metaworld/reach"), "{error}");
        let unnamed = manifest::parse(r#"{"simulator": "Meta World", "task": "a", "seed": 0}"#);
        let unnamed = unnamed.expect_err("no name").to_string();
        assert!(unnamed.contains("`simulator.name` is `Meta World`"), "{unnamed}");
    }
}
