//! One row of a manifest: the unit of work, in the format of the reference's JSON Lines.
//! A row holds the drawn parameter values, so that no parameter is drawn again when it runs.
//! `manifest` parses whole files of rows.

use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use crate::axis::{ActsOn, Axis};
use crate::axis_set::AxisSet;
use crate::benchmark::Benchmark;
use crate::condition::Condition;
use crate::design::{PLACEBO_RADII, Placebo};
use crate::execution::Execution;
use crate::latency::execution_at;
use crate::level::Level;
use crate::names::UnknownName;
use crate::own_task::{InvalidField, OwnTask};
use crate::perturbation::{PerturbError, Perturbation};
use crate::presets::SETTLE_STEPS;
use crate::rollout_id::RolloutId;
use crate::simulated::SimulatedTask;
use crate::suite::{INIT_STATES_PER_TASK, Suite};

/// Largest number of rows of a campaign, designed or imported.
pub const MAX_ROWS: usize = 250_000;

/// Definition of a rollout, without the values that differ between replicates and without the
/// realisation and the policy, which are the same in all rollouts of a campaign.
///
/// Serialises to the row format of the reference implementation, whose columns repeat suite, task,
/// axis, level, configuration and split; when a row is parsed, these columns must agree with the
/// id. [`Self::published`] also has the reference's names.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "FlatRow", into = "FlatRow")]
pub struct ManifestRow {
    pub id: RolloutId,
    /// Index of the initial state in the design: the configuration, or in a row without a
    /// configuration the initial state itself.
    pub init_slot: u16,
    /// Index of the initial state among the task's released initial states.
    pub init_id: u16,
    /// The policy's instruction, verbatim.
    pub instruction: String,
    /// Identifier of the instruction's paraphrase; `None` if language is not perturbed.
    pub variant_id: Option<String>,
    /// Step budget of the policy, control steps.
    pub max_steps: u32,
    /// Control steps without action before the policy starts.
    pub settle_steps: u32,
    pub perturbation: Perturbation,
    /// Radius of a row at the placebo level; `None` for all other rows.
    pub placebo_radius: Option<Level>,
    pub execution: Execution,
    /// Name of the protocol of a row of LIBERO's family or of a suite file; `None` for a row of
    /// LIBERO-CTRL. If a row has a protocol and only the BDDL file has the instruction,
    /// `instruction` is empty.
    pub protocol: Option<String>,
    /// Files and conditions of the task of a row with a protocol; `None` for all other rows.
    pub own: Option<Box<OwnTask>>,
    /// Benchmark whose task files the rollout needs; `None` if LIBERO's or its own suffice.
    pub files: Option<Benchmark>,
    /// Task of a row of another simulator, whose `init_id` is the seed of the reset; `None` for all
    /// other rows.
    pub simulator: Option<Box<SimulatedTask>>,
}

impl ManifestRow {
    /// Creates a row with the protocol's step budget and the canonical instruction.
    pub fn new(id: RolloutId, init_slot: u16, init_id: u16, perturbation: Perturbation) -> Self {
        Self {
            id,
            init_slot,
            init_id,
            instruction: id.task().instruction(),
            variant_id: None,
            max_steps: id.task().suite().max_steps(),
            settle_steps: SETTLE_STEPS,
            perturbation,
            placebo_radius: None,
            execution: Execution::Wait,
            protocol: None,
            own: None,
            files: None,
            simulator: None,
        }
    }

    /// Returns the row as the reference writes it, JSON.
    pub(crate) fn published(&self) -> String {
        let condition = self.id.condition();
        let row = FlatRow {
            rollout_id: self.id.published(),
            split: splits(condition)[1].to_owned(),
            axis: condition.published().to_owned(),
            ..self.clone().into()
        };
        serde_json::to_string(&row).expect("a row of text and numbers serialises")
    }

    /// A row of the latency axis keeps its own model.
    pub fn under(self, execution: &Execution) -> Self {
        match self.id.condition().sets_execution() {
            true => self,
            false => Self { execution: execution.clone(), ..self },
        }
    }

    /// Radius of the perturbation; 0 for a nominal row or one of another benchmark.
    pub fn radius(&self) -> f64 {
        self.placebo_radius.unwrap_or(self.id.level()).radius()
    }

    pub fn axes(&self) -> AxisSet {
        let given = self.perturbation.axes().into_iter();
        let given = given.chain(self.variant_id.is_some().then_some(Axis::Language));
        let given = given.chain(self.simulator.iter().flat_map(|of| of.perturb.keys().copied()));
        self.id.condition().axes(given.collect())
    }

    /// Describes the perturbation along one of the row's axes, one line per parameter.
    pub fn describe(&self, axis: Axis) -> Vec<String> {
        let def = axis.def();
        match def.acts_on {
            ActsOn::Answers => {
                vec!["The policy's answers are delayed; nothing else is perturbed.".to_owned()]
            }
            ActsOn::Instruction if self.id.is_placebo() => {
                vec!["the canonical instruction, as placebo".to_owned()]
            }
            ActsOn::Instruction => {
                let variant = self.variant_id.as_deref().unwrap_or("as in the manifest");
                vec![format!("paraphrase {variant}")]
            }
            ActsOn::Scene | ActsOn::Pictures | ActsOn::Actions => {
                let values = def.parameters.iter().zip(self.perturbation.values(axis));
                // Typographic minus before numbers; hyphens within words stay.
                values.map(|(it, value)| (it.text)(value).replace(" -", " −")).collect()
            }
        }
    }

    /// Returns the instruction without the language axis; empty if another simulator has it.
    pub fn canonical_instruction(&self) -> String {
        if let Some(simulated) = &self.simulator {
            return simulated.instruction.clone();
        }
        match &self.own {
            Some(own) if self.variant_id.is_some() => own.instruction.clone(),
            Some(_) if self.id.task().suite() == Suite::Own => self.instruction.clone(),
            _ => self.id.task().instruction(),
        }
    }

    /// Returns the name of the suite that is sent to a policy: that of LIBERO's suite, the name in
    /// the suite file, or the simulator's.
    pub fn suite_name(&self) -> &str {
        if let Some(simulated) = &self.simulator {
            return &simulated.name;
        }
        let own = self.own.as_deref().map(|own| own.suite.as_str());
        own.filter(|suite| !suite.is_empty()).unwrap_or(self.id.suite_name())
    }

    /// Returns the row of the same configuration restricted to some of its axes, each
    /// perturbed as in this row, which must perturb all of `axes`.
    pub fn only(&self, axes: AxisSet) -> Result<Self, UnknownName> {
        let id = self.id;
        let config = id.number();
        let id = RolloutId::perturbed(id.task(), Condition::of(axes), id.level(), config)?;
        let mut row = Self { id, perturbation: self.perturbation.only(axes), ..self.clone() };
        if !axes.contains(Axis::Language) {
            row.instruction = self.canonical_instruction();
            row.variant_id = None;
            if let Some(own) = &mut row.own {
                own.instruction.clear();
            }
        }
        if let Some(simulated) = &mut row.simulator {
            simulated.only(axes);
        }
        Ok(row)
    }
}

#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum RowError {
    #[error(transparent)]
    Name(#[from] UnknownName),
    #[error("read row {id}: `{column}` is {given}, but the id says {expected}")]
    Contradiction { id: RolloutId, column: &'static str, given: String, expected: String },
    #[error("read row {id}: `init_id` is {given}, valid are 0 to 49")]
    InitState { id: RolloutId, given: u16 },
    #[error(
        "read row {id}: `placebo_radius` is {}, write {} to {} in perturbed rows at L0, and \
         leave it out of other rows",
        radius_text(*given), PLACEBO_RADII[0], PLACEBO_RADII[1]
    )]
    Placebo { id: RolloutId, given: Option<f64> },
    #[error(
        "read row {id}: `execution` is {given}, {}",
        expected.as_ref().map_or_else(
            || "but its level has no delay: choose L1, L2, L3 or an even radius".to_owned(),
            |model| format!("write the delay of its level: {model}"),
        )
    )]
    Latency { id: RolloutId, given: Execution, expected: Option<Execution> },
    #[error("read row {id}: `policy_seed` is {given}, but seeds follow from the id: write 0")]
    PolicySeed { id: RolloutId, given: u64 },
    #[error(
        "read row {id}: `protocol` is {}; write a protocol in rows of LIBERO-Plus, LIBERO-PRO, \
         LIBERO-Para \
         and suite files only",
        given.as_deref().unwrap_or("missing")
    )]
    Protocol { id: RolloutId, given: Option<String> },
    #[error(
        "read row {id}: `own` is {}; write a task in rows with a protocol only",
        if *is_given { "given" } else { "missing" }
    )]
    Own { id: RolloutId, is_given: bool },
    #[error("read row {id}: {problem}")]
    OwnTask { id: RolloutId, problem: InvalidField },
    #[error(
        "read row {id}: `simulator` is {}; write it in rows whose ids begin with sim/ only",
        if *is_given { "given" } else { "missing" }
    )]
    Simulator { id: RolloutId, is_given: bool },
    #[error("read row {id}: `num_steps_wait` is {given}: write 0 in rows of other simulators")]
    Settling { id: RolloutId, given: u32 },
    #[error("read row {id}: {problem}")]
    Perturb {
        id: RolloutId,
        /// Problem with the parameters. It is part of the message, because serde errors do
        /// not keep a source.
        problem: PerturbError,
    },
}

/// Serialised form of a row: the columns of the reference implementation in their order there,
/// with this project's optional columns.
#[derive(Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct FlatRow {
    rollout_id: String,
    split: String,
    suite: String,
    task_id: u8,
    axis: String,
    level: Level,
    config: Option<u16>,
    init_slot: u16,
    init_id: u16,
    language: String,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    variant_id: Option<String>,
    max_steps: u32,
    num_steps_wait: u32,
    policy_seed: u64,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    placebo_radius: Option<f64>,
    #[serde(default, skip_serializing_if = "Execution::is_wait")]
    execution: Execution,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    protocol: Option<String>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    own: Option<Box<OwnTask>>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    files: Option<Benchmark>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    simulator: Option<Box<SimulatedTask>>,
    #[serde(default)]
    perturb: Map<String, Value>,
}

/// Returns the value of the column `split`, and the reference's.
fn splits(condition: Condition) -> [&'static str; 2] {
    match condition {
        Condition::Nominal => [condition.name(), condition.published()],
        _ => ["eval"; 2],
    }
}

impl From<ManifestRow> for FlatRow {
    fn from(row: ManifestRow) -> Self {
        let id = row.id;
        Self {
            rollout_id: id.to_string(),
            split: splits(id.condition())[0].to_owned(),
            suite: id.task().suite().to_string(),
            task_id: id.task().index(),
            axis: id.condition().to_string(),
            level: id.level(),
            config: id.config(),
            init_slot: row.init_slot,
            init_id: row.init_id,
            language: row.instruction,
            variant_id: row.variant_id,
            max_steps: row.max_steps,
            num_steps_wait: row.settle_steps,
            policy_seed: 0,
            placebo_radius: row.placebo_radius.map(Level::radius),
            execution: row.execution,
            protocol: row.protocol,
            own: row.own,
            files: row.files,
            perturb: row.perturbation.to_manifest(in_worker(id, row.simulator.as_deref())),
            simulator: row.simulator,
        }
    }
}

impl TryFrom<FlatRow> for ManifestRow {
    type Error = RowError;

    fn try_from(flat: FlatRow) -> Result<Self, RowError> {
        let id: RolloutId = flat.rollout_id.parse()?;
        let condition = id.condition();
        let [split, published] = splits(condition);
        if flat.split != published {
            check_column(id, "split", flat.split.as_str(), split)?;
        }
        check_column(id, "suite", flat.suite, id.task().suite().to_string())?;
        check_column(id, "task_id", flat.task_id, id.task().index())?;
        check_column(id, "axis", flat.axis.parse()?, condition)?;
        if flat.level.radius() != id.level().radius() {
            check_column(id, "level", flat.level, id.level())?;
        }
        match flat.config {
            Some(given) => check_column(id, "config", given, id.number())?,
            None if id.config().is_none() => {}
            None => check_column(id, "config", "null".to_owned(), id.number().to_string())?,
        }
        if id.config().is_none() {
            check_column(id, "init_id", flat.init_id, id.number())?;
        }
        let is_given = flat.simulator.is_some();
        if is_given != (id.task().suite() == Suite::Simulated) {
            return Err(RowError::Simulator { id, is_given });
        }
        if is_given && flat.num_steps_wait != 0 {
            let given = flat.num_steps_wait;
            return Err(RowError::Settling { id, given });
        }
        if flat.init_id >= INIT_STATES_PER_TASK && !is_given {
            let given = flat.init_id;
            return Err(RowError::InitState { id, given });
        }
        if flat.policy_seed != 0 {
            let given = flat.policy_seed;
            return Err(RowError::PolicySeed { id, given });
        }
        let has_protocol = id.variant().is_some() || id.task().suite() == Suite::Own;
        if flat.protocol.is_some() != has_protocol {
            let given = flat.protocol;
            return Err(RowError::Protocol { id, given });
        }
        let is_given = flat.own.is_some();
        if is_given != has_protocol {
            return Err(RowError::Own { id, is_given });
        }
        if let Some(Err(problem)) = flat.own.as_deref().map(OwnTask::check) {
            return Err(RowError::OwnTask { id, problem });
        }
        if condition.sets_execution() {
            let (given, expected) = (flat.execution.clone(), execution_at(id.level()));
            if Some(&given) != expected.as_ref() {
                return Err(RowError::Latency { id, given, expected });
            }
        }
        let given = flat.placebo_radius;
        let placebo_radius = given.and_then(Level::of_radius);
        let is_valid = match placebo_radius {
            Some(radius) => id.is_placebo() && Placebo::is_valid_radius(radius),
            None => given.is_none() && !id.is_placebo(),
        };
        if !is_valid {
            return Err(RowError::Placebo { id, given });
        }
        let acting = in_worker(id, flat.simulator.as_deref());
        let perturbation = Perturbation::from_manifest(acting, flat.perturb)
            .map_err(|problem| RowError::Perturb { id, problem })?;
        if let Some(Err(problem)) =
            flat.simulator.as_deref().map(|simulated| simulated.check(condition, &perturbation))
        {
            return Err(RowError::OwnTask { id, problem });
        }
        Ok(Self {
            id,
            init_slot: flat.init_slot,
            init_id: flat.init_id,
            instruction: flat.language,
            variant_id: flat.variant_id,
            max_steps: flat.max_steps,
            settle_steps: flat.num_steps_wait,
            perturbation,
            placebo_radius,
            execution: flat.execution,
            protocol: flat.protocol,
            own: flat.own,
            files: flat.files,
            simulator: flat.simulator,
        })
    }
}

/// Returns the part of a row's condition whose parameters are in the column `perturb`.
fn in_worker(id: RolloutId, simulated: Option<&SimulatedTask>) -> Condition {
    simulated.map_or(id.condition(), |simulated| simulated.acting_in_worker(id.condition()))
}

fn radius_text(radius: Option<f64>) -> String {
    radius.map_or_else(|| "missing".to_owned(), |radius| radius.to_string())
}

fn check_column<T: PartialEq + ToString>(
    id: RolloutId,
    column: &'static str,
    given: T,
    expected: T,
) -> Result<(), RowError> {
    if given == expected {
        return Ok(());
    }
    Err(RowError::Contradiction {
        id,
        column,
        given: given.to_string(),
        expected: expected.to_string(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::perturbation::{CameraShift, SensorCorruption};
    use crate::presets::apply_preset;
    use serde_json::json;

    fn row(id: &str, axes: &[Axis]) -> ManifestRow {
        let id: RolloutId = id.parse().expect("an id");
        let mut perturbation = Perturbation::default();
        for &axis in axes {
            apply_preset(&mut perturbation, axis, id.level(), id.number());
        }
        ManifestRow::new(id, id.number(), 6, perturbation)
    }

    #[test]
    fn a_single_axis_row_has_the_references_columns() {
        let row = row("goal/t0/actuation/L1/c01", &[Axis::Actuation]);
        assert_eq!(
            serde_json::to_value(&row).expect("JSON"),
            json!({
                "rollout_id": "goal/t0/actuation/L1/c01", "split": "eval",
                "suite": "libero_goal", "task_id": 0, "axis": "actuation",
                "level": "L1", "config": 1, "init_slot": 1, "init_id": 6,
                "language": "open the middle drawer of the cabinet",
                "max_steps": 300, "num_steps_wait": 10, "policy_seed": 0,
                "perturb": {
                    "gain_log2": -0.015895, "bias_frac": -0.010856,
                    "misalign_deg": 0.126524, "lag_tau": -0.021299,
                    "noise_frac": 0.018419,
                },
            })
        );
    }

    #[test]
    fn rows_are_parsed_from_their_json() {
        for row in [
            row("goal/t0/simultaneous/L1/c01", &Axis::METRIC),
            row("goal/t0/sensor/L3/c09", &[Axis::Sensor]),
            row("goal/t0/nominal/i06", &[]),
        ] {
            let text = serde_json::to_string(&row).expect("JSON");
            let read: ManifestRow = serde_json::from_str(&text).expect("reads back");
            assert_eq!(read, row);
        }
    }

    /// The reference's clean file omits empty columns.
    #[test]
    fn rows_of_the_references_clean_file_are_parsed() {
        let read: ManifestRow = serde_json::from_value(json!({
            "rollout_id": "goal/t0/clean/i06", "split": "clean",
            "suite": "libero_goal", "task_id": 0, "axis": "clean", "level": "L0",
            "config": null, "init_slot": 6, "init_id": 6,
            "language": "open the middle drawer of the cabinet",
            "max_steps": 300, "num_steps_wait": 10, "policy_seed": 0,
        }))
        .expect("reads");
        assert_eq!(read, row("goal/t0/nominal/i06", &[]));
    }

    #[test]
    fn a_column_that_contradicts_the_id_is_named() {
        let valid = serde_json::to_value(row("goal/t0/sensor/L3/c09", &[Axis::Sensor]));
        let valid = valid.expect("JSON");
        let check = |column: &str, value: Value, expected: &str| {
            let mut invalid = valid.clone();
            invalid[column] = value;
            let error = serde_json::from_value::<ManifestRow>(invalid).expect_err(column);
            assert!(error.to_string().contains(expected), "{error}");
        };
        check("level", json!("L2"), "`level` is L2, but the id says L3");
        check("task_id", json!(1), "`task_id` is 1, but the id says 0");
        check("config", json!(null), "`config` is null, but the id says 9");
        check("init_id", json!(50), "`init_id` is 50, valid are 0 to 49");
        check("policy_seed", json!(7), "write 0");
        check("colour", json!("red"), "unknown field `colour`");
        check("perturb", json!({"blur_sigma": 1.0}), "is missing");
        check("placebo_radius", json!(0.02), "leave it out of other rows");
        let mut placebo = valid.clone();
        placebo["level"] = json!("L0");
        placebo["rollout_id"] = json!("goal/t0/sensor/L0/c09");
        let error = serde_json::from_value::<ManifestRow>(placebo).expect_err("no radius");
        assert!(error.to_string().contains("`placebo_radius` is missing"), "{error}");
    }

    #[test]
    fn perturbations_have_units_and_only_meaningful_signs() {
        let perturbation = Perturbation {
            camera: Some(CameraShift::from([-3.4, 1.25, 0.021, 0.0, -0.005])),
            sensor: Some(SensorCorruption::from([-0.02, 0.7, -1.0, 2.5])),
            ..Perturbation::default()
        };
        let id = "object/t0/simultaneous/L2/c00".parse().expect("an id");
        let row = ManifestRow::new(id, 0, 0, perturbation);
        assert_eq!(
            row.describe(Axis::Camera),
            [
                "azimuth −3.4°",
                "elevation +1.2°",
                "distance +2.1 cm",
                "look-at point along x +0.0 cm",
                "look-at point along y −0.5 cm",
            ]
        );
        assert_eq!(
            row.describe(Axis::Sensor),
            [
                "noise, standard deviation 2.00 % of full scale",
                "blur, standard deviation 0.70 px at 128 px",
                "JPEG quality 50",
                "motion blur 2.50 px at 128 px",
            ]
        );
        assert!(row.describe(Axis::Robot).is_empty());
    }
}
