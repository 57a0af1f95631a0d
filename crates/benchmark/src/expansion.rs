//! Expands a design into manifest rows: its rollouts, their order and their values.
//! Replicates repeat the same rows.

use std::collections::{BTreeMap, BTreeSet};

use crate::axis::Axis;
use crate::axis_set::AxisSet;
use crate::campaign::{CampaignSpec, Rollouts};
use crate::condition::Condition;
use crate::design::{Design, DesignError, Nominal, Placebo, check_at};
use crate::directions::{direction, init_id};
use crate::latency::execution_at;
use crate::level::Level;
use crate::paraphrase::paraphrase;
use crate::perturbation::Perturbation;
use crate::presets::{PRESETS, apply_direction};
use crate::rollout_id::RolloutId;
use crate::row::ManifestRow;
use crate::spec_error::SpecError;
use crate::suite::{INIT_STATES_PER_TASK, Suite, TaskRef};

impl CampaignSpec {
    /// Returns the campaign's rows under its execution model, in the order of [`Design::expand`];
    /// those of LIBERO's family or of a suite file stay in the order given.
    pub fn expand(&self) -> Result<Vec<ManifestRow>, SpecError> {
        self.check()?;
        let rows = match &self.rollouts {
            Rollouts::Design(design) => design.expand()?,
            Rollouts::Rows(rows) => paired_units_first(rows.clone()),
        };
        let rows = rows.into_iter().map(|row| row.under(&self.execution));
        Ok(rows.collect())
    }
}

impl Design {
    /// Returns the design's rows in paired units: the nominal rollout of a task and configuration,
    /// followed by the perturbed rollouts of the same task and configuration. The units are in the
    /// order of configurations, then of tasks, so that interim paired figures cover all tasks
    /// early. Nominal rollouts from the remaining initial states come last.
    pub fn expand(&self) -> Result<Vec<ManifestRow>, DesignError> {
        self.check()?;
        let mut rows = Vec::new();
        let mut nominal = BTreeSet::new();
        for &config in &self.configs {
            for &task in &self.tasks {
                let init_id = init_id(task, config, self.seed);
                if self.nominal != Nominal::None && nominal.insert((task, init_id)) {
                    rows.push(nominal_row(task, init_id));
                }
                for &level in &self.levels {
                    if !self.runs_config(level, config) {
                        continue;
                    }
                    for condition in self.conditions() {
                        if check_at(condition, level).is_ok() {
                            rows.push(self.perturbed_row(task, condition, level, config));
                        }
                    }
                }
            }
        }
        if self.nominal == Nominal::All {
            for &task in &self.tasks {
                let remaining = (0..INIT_STATES_PER_TASK).filter(|&id| nominal.insert((task, id)));
                rows.extend(remaining.map(|init_id| nominal_row(task, init_id)));
            }
        }
        Ok(rows)
    }

    /// Returns the design's rows over a user's tasks. `tasks` has a row of each in the order of their
    /// indices; the rollouts start from the first `states` initial states.
    pub fn expand_over(
        self,
        tasks: &[ManifestRow],
        states: u16,
    ) -> Result<Vec<ManifestRow>, DesignError> {
        let design = Self { tasks: tasks.iter().map(|row| row.id.task()).collect(), ..self };
        let mut nominal = BTreeSet::new();
        let mut rows = Vec::new();
        for mut row in design.expand()? {
            let task = row.id.task();
            let given = &tasks[usize::from(task.index())];
            row.init_id %= states;
            if row.id.config().is_none() {
                if !nominal.insert((task, row.init_id)) {
                    continue;
                }
                row.id = RolloutId::nominal(task, row.init_id);
                row.init_slot = row.init_id;
            }
            let mut own = given.own.clone();
            if let Some(own) = &mut own {
                given.suite_name().clone_into(&mut own.suite);
            }
            let instruction = given.instruction.clone();
            row = ManifestRow {
                max_steps: given.max_steps,
                settle_steps: given.settle_steps,
                protocol: given.protocol.clone(),
                files: given.files,
                instruction,
                own,
                ..row
            };
            if row.id.condition().axes(design.axis_set()).contains(Axis::Language) {
                let mut all = TaskRef::all();
                let Some(alike) = all.find(|other| other.instruction() == row.instruction) else {
                    return Err(DesignError::NoParaphrase { task, given: row.instruction });
                };
                if let Some(own) = &mut row.own {
                    own.instruction.clone_from(&row.instruction);
                }
                row.paraphrase_as(alike);
            }
            rows.push(row);
        }
        Ok(rows)
    }

    /// Returns the row of a configuration under a condition of this design at any level,
    /// including levels that the design does not run; the direction is the same at all levels.
    pub fn row_at(
        &self,
        task: TaskRef,
        condition: Condition,
        level: Level,
        config: u16,
    ) -> Result<ManifestRow, DesignError> {
        let single = Self {
            tasks: vec![task],
            axes: condition.axes(self.axis_set()).axes().collect(),
            subsets: Vec::new(),
            levels: vec![level],
            configs: vec![config],
            placebo: match level {
                Level::L0 => Placebo { configs: None, ..self.placebo.clone() },
                _ => Placebo::default(),
            },
            ..self.clone()
        };
        single.check()?;
        check_at(condition, level)?;
        Ok(self.perturbed_row(task, condition, level, config))
    }

    pub(crate) fn perturbed_row(
        &self,
        task: TaskRef,
        condition: Condition,
        level: Level,
        config: u16,
    ) -> ManifestRow {
        let axes = condition.axes(self.axis_set());
        let placebo_radius = (level == Level::L0).then_some(self.placebo.radius);
        let mut perturbation = Perturbation::default();
        for axis in axes.axes() {
            let direction = direction(self.directions, task, axis, config, self.seed);
            let radius = placebo_radius.unwrap_or(level);
            apply_direction(&mut perturbation, axis, radius, &direction);
        }
        let id = RolloutId::perturbed(task, condition, level, config)
            .expect("the conditions of a design perturb");
        let init_id = init_id(task, config, self.seed);
        let mut row =
            ManifestRow { placebo_radius, ..ManifestRow::new(id, config, init_id, perturbation) };
        if condition.sets_execution() {
            row.execution = execution_at(level).expect("a validated design has delays");
        }
        if axes.contains(Axis::Language) && task.suite() != Suite::Own {
            row.paraphrase_as(task);
        }
        row
    }
}

impl ManifestRow {
    fn paraphrase_as(&mut self, task: TaskRef) {
        // A level has ten paraphrases; configurations from 10 on repeat them.
        let paraphrase = paraphrase(task, self.id.level(), self.id.number() % PRESETS);
        self.instruction = paraphrase.text;
        self.variant_id = Some(paraphrase.variant_id);
    }
}

pub(crate) fn nominal_row(task: TaskRef, init_id: u16) -> ManifestRow {
    let id = RolloutId::nominal(task, init_id);
    ManifestRow::new(id, init_id, init_id, Perturbation::default())
}

/// Sorts rows of any origin into the order of [`Design::expand`].
fn paired_units_first(mut rows: Vec<ManifestRow>) -> Vec<ManifestRow> {
    let mut first_configs = BTreeMap::new();
    for row in &rows {
        if let Some(config) = row.id.config() {
            let entry = first_configs.entry((row.id.task(), row.init_id));
            let first = entry.or_insert(config);
            *first = config.min(*first);
        }
    }
    rows.sort_by_key(|row| {
        let (id, task) = (row.id, row.id.task());
        let paired = first_configs.get(&(task, row.init_id)).copied();
        let unit = id.config().or(paired);
        (unit.is_none(), unit, id.variant().is_none().then_some((task, id.level(), id)))
    });
    rows
}

/// Error: no rollout of the protocol has this id.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("make the manifest row of {id}: {problem}")]
pub struct NoSuchRow {
    pub id: RolloutId,
    pub problem: String,
}

/// Returns the row of an id in LIBERO-CTRL v0.1; configurations that v0.1 does not have are drawn
/// with design seed 0. Simultaneous perturbs all six axes or, at unnamed radii, which have
/// no paraphrases, the five metric axes.
pub fn row_of(id: RolloutId) -> Result<ManifestRow, NoSuchRow> {
    let problem = |problem: String| NoSuchRow { id, problem };
    if id.task().suite() == Suite::Simulated {
        let remedy = "it is a rollout of another simulator, which campaigns run";
        return Err(problem(remedy.to_owned()));
    }
    if id.variant().is_some() {
        let remedy = match id.task().suite() {
            Suite::Own => {
                "it is a rollout of a suite file; give the file to `worker rollout` with --suite-file"
            }
            _ => "it is a rollout of LIBERO's family, which `worker rollout` and campaigns run",
        };
        return Err(problem(remedy.to_owned()));
    }
    let Some(config) = id.config() else {
        return match id.number() {
            state if state < INIT_STATES_PER_TASK => Ok(nominal_row(id.task(), state)),
            _ => Err(problem("the task has no such initial state".to_owned())),
        };
    };
    let combined = match id.level().is_named() || id.is_placebo() {
        true => AxisSet::ALL,
        false => AxisSet::from_iter(Axis::METRIC),
    };
    let design = Design { axes: combined.axes().collect(), ..Design::v0_1() };
    let row = design.row_at(id.task(), id.condition(), id.level(), config);
    row.map_err(|error| problem(error.to_string()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::axis_set::AxisSet;
    use crate::directions::Directions;

    fn metric_design() -> Design {
        Design { axes: Axis::METRIC.to_vec(), ..Design::v0_1() }
    }

    #[test]
    fn five_axes_have_six_conditions_at_every_configuration() {
        let rows = metric_design().expand().expect("rows");
        assert_eq!(rows.len(), 2_000 + 40 * 10 * 3 * 6);
        let ids: BTreeSet<RolloutId> = rows.iter().map(|row| row.id).collect();
        assert_eq!(ids.len(), rows.len());
    }

    #[test]
    fn a_configuration_follows_its_nominal_rollout() {
        let rows = metric_design().expand().expect("rows");
        let ids: Vec<String> = rows.iter().map(|row| row.id.to_string()).collect();
        assert_eq!(
            ids[..8],
            [
                "spatial/t0/nominal/i43",
                "spatial/t0/camera/L1/c00",
                "spatial/t0/lighting/L1/c00",
                "spatial/t0/robot/L1/c00",
                "spatial/t0/sensor/L1/c00",
                "spatial/t0/actuation/L1/c00",
                "spatial/t0/simultaneous/L1/c00",
                "spatial/t0/camera/L2/c00",
            ]
        );
        assert_eq!(ids[19], "spatial/t1/nominal/i24");
        assert_eq!(rows[6].init_id, 43);
        assert_eq!(rows[6].perturbation.axes(), Axis::METRIC);
    }

    #[test]
    fn simultaneous_combines_exactly_the_axes_of_its_design() {
        let design = Design {
            axes: vec![Axis::Camera, Axis::Robot],
            nominal: Nominal::None,
            levels: vec![Level::L2],
            tasks: select("libero_goal/3"),
            configs: vec![4],
            ..metric_design()
        };
        let rows = design.expand().expect("rows");
        let conditions: Vec<Condition> = rows.iter().map(|row| row.id.condition()).collect();
        assert_eq!(
            conditions,
            [
                Condition::Single(Axis::Camera),
                Condition::Single(Axis::Robot),
                Condition::Simultaneous
            ]
        );
        assert_eq!(rows[2].perturbation.camera, rows[0].perturbation.camera);
        assert_eq!(rows[2].perturbation.robot, rows[1].perturbation.robot);
        assert_eq!(rows[2].perturbation.axes(), [Axis::Camera, Axis::Robot]);
    }

    #[test]
    fn a_subset_has_the_parameters_of_its_axes_in_other_conditions() {
        let without_subsets = Design {
            nominal: Nominal::None,
            levels: vec![Level::L2],
            tasks: select("libero_goal/3"),
            configs: vec![4],
            ..Design::v0_1()
        };
        let design = Design {
            subsets: ["camera+language", "lighting+robot+sensor"]
                .map(|set| set.parse().expect("a set"))
                .to_vec(),
            ..without_subsets.clone()
        };
        let rows = design.expand().expect("rows");
        let row = |condition: &str| {
            let id = format!("goal/t3/{condition}/L2/c04").parse();
            let id: RolloutId = id.expect("an id");
            rows.iter().find(|row| row.id == id).expect(condition)
        };
        let (pair, all) = (row("camera+language"), row("simultaneous"));
        assert_eq!(pair.perturbation.camera, all.perturbation.camera);
        assert_eq!(pair.perturbation.axes(), [Axis::Camera]);
        assert_eq!(pair.instruction, row("language").instruction);
        let triple = row("lighting+robot+sensor");
        assert_eq!(triple.perturbation.robot, row("robot").perturbation.robot);
        assert_eq!(triple.instruction, row("camera").instruction);
        assert_eq!(all.only(AxisSet::from_iter([Axis::Camera, Axis::Language])), Ok(pair.clone()));
        assert_eq!(all.only("lighting+robot+sensor".parse().expect("a set")), Ok(triple.clone()));
        assert_eq!(all.axes(), AxisSet::ALL);
        let others = rows.iter().filter(|row| !matches!(row.id.condition(), Condition::Subset(_)));
        assert!(others.eq(without_subsets.expand().expect("rows").iter()));
        let text = crate::manifest::to_text(&rows);
        assert_eq!(crate::manifest::parse(&text), Ok(rows));
    }

    #[test]
    fn a_configuration_has_one_direction_and_initial_state_at_every_radius() {
        let design = Design {
            axes: vec![Axis::Camera, Axis::Robot],
            configs: vec![4, 17],
            tasks: select("libero_goal/3"),
            seed: 9,
            ..metric_design()
        };
        for row in design.expand().expect("rows") {
            let id = row.id;
            let Some(config) = id.config() else { continue };
            let at = |level: Level| design.row_at(id.task(), id.condition(), level, config);
            assert_eq!(at(id.level()), Ok(row.clone()));
            let far = at("r12".parse().expect("a level")).expect("a row");
            assert_eq!(far.init_id, row.init_id);
            for axis in row.perturbation.axes() {
                let pairs = far.perturbation.values(axis).into_iter();
                for (far, near) in pairs.zip(row.perturbation.values(axis)) {
                    let expected = near * 12.0 / id.level().radius();
                    assert!((far - expected).abs() < 1e-5, "{id}: {far} {near}");
                }
            }
        }
        let task = "libero_goal/3".parse().expect("a task");
        let between = "r3".parse().expect("a level");
        let all = Condition::Simultaneous;
        let row = Design::v0_1().row_at(task, all, between, 4);
        assert_eq!(row, Err(DesignError::NotAt { axis: Axis::Language, level: between }));
    }

    #[test]
    fn a_placebo_has_the_same_configurations_at_a_small_radius() {
        let design = Design {
            levels: vec![Level::L0, Level::L2],
            configs: vec![4, 17],
            tasks: select("libero_goal/3"),
            placebo: Placebo { configs: Some(vec![4]), ..Placebo::default() },
            ..Design::v0_1()
        };
        let rows = design.expand().expect("rows");
        let (placebo, others): (Vec<_>, Vec<_>) = rows.iter().partition(|row| row.id.is_placebo());
        let ids: Vec<String> = placebo.iter().map(|row| row.id.to_string()).collect();
        assert_eq!((ids.len(), ids[0].as_str()), (7, "goal/t3/camera/L0/c04"));
        let without_placebo =
            Design { levels: vec![Level::L2], placebo: Placebo::default(), ..design.clone() };
        let rows_without_placebo = without_placebo.expand().expect("rows");
        assert!(others.into_iter().eq(&rows_without_placebo));
        for row in &placebo {
            let id = row.id;
            let condition = id.condition();
            // The radius of L2, 4, is 200 times the placebo's, 0.02.
            let far = design.row_at(id.task(), condition, Level::L2, 4);
            let far = far.expect("a row");
            assert_eq!((row.init_id, row.axes()), (far.init_id, far.axes()), "{id}");
            assert_eq!(row.instruction, id.task().instruction());
            assert_eq!(row.placebo_radius, Some(Placebo::DEFAULT_RADIUS));
            for axis in row.perturbation.axes() {
                let pairs = far.perturbation.values(axis).into_iter();
                for (far, near) in pairs.zip(row.perturbation.values(axis)) {
                    assert!((far / 200.0 - near).abs() < 1e-6, "{id}: {far} {near}");
                }
            }
            let at = design.row_at(id.task(), condition, Level::L0, 4);
            assert_eq!(at.as_ref(), Ok(*row));
            assert_eq!(crate::row_of(id).as_ref(), Ok(*row));
        }
        let text = crate::manifest::to_text(&rows);
        assert!(text.contains("\"placebo_radius\":0.02"));
        assert_eq!(crate::manifest::parse(&text), Ok(rows));
    }

    #[test]
    fn own_directions_change_only_the_parameters() {
        let shared =
            Design { configs: vec![4, 17], tasks: select("libero_goal/3"), ..Design::v0_1() };
        let own = Design { directions: Directions::Own, ..shared.clone() };
        let [shared, own] = [shared, own].map(|design| design.expand().expect("rows"));
        assert_eq!(shared.len(), own.len());
        for (shared, own) in shared.iter().zip(&own) {
            let same = ManifestRow { perturbation: own.perturbation, ..shared.clone() };
            assert_eq!(&same, own);
            let is_metric = !shared.perturbation.axes().is_empty();
            assert_eq!(shared.perturbation != own.perturbation, is_metric, "{}", own.id);
        }
        let text = crate::manifest::to_text(&own);
        assert_eq!(crate::manifest::parse(&text), Ok(own));
    }

    #[test]
    fn nominal_selects_all_initial_states_those_of_the_configurations_or_none() {
        let count = |nominal| {
            let design = Design {
                nominal,
                tasks: select("libero_goal"),
                levels: vec![Level::L1],
                ..metric_design()
            };
            let rows = design.expand().expect("rows");
            let nominal = rows.iter().filter(|row| row.id.config().is_none());
            nominal.count()
        };
        assert_eq!(count(Nominal::All), 500);
        assert_eq!(count(Nominal::Eval), 100);
        assert_eq!(count(Nominal::None), 0);
    }

    #[test]
    fn the_design_of_v0_1_has_10_400_rows() {
        let rows = Design::v0_1().expand().expect("rows");
        let nominal = rows.iter().filter(|row| row.id.config().is_none());
        assert_eq!((nominal.count(), rows.len()), (2_000, 10_400));
    }

    #[test]
    fn an_imported_manifest_runs_in_the_order_of_a_design() {
        let rows = Design::v0_1().expand().expect("rows");
        let mut unsorted = rows.clone();
        unsorted.sort_by_key(|row| row.id);
        assert_ne!(unsorted, rows);
        assert_eq!(paired_units_first(unsorted), rows);
    }

    #[test]
    fn the_language_axis_and_simultaneous_have_the_same_paraphrase_and_others_none() {
        let design = Design {
            axes: vec![Axis::Camera, Axis::Language],
            nominal: Nominal::None,
            levels: vec![Level::L2],
            tasks: select("libero_goal/3"),
            configs: vec![4],
            ..metric_design()
        };
        let rows = design.expand().expect("rows");
        let [camera, language, simultaneous] = rows.as_slice() else {
            panic!("{} rows", rows.len());
        };
        assert_eq!(camera.instruction, camera.id.task().instruction());
        assert_eq!(camera.variant_id, None);
        assert_ne!(language.instruction, camera.instruction);
        assert_eq!(language.variant_id.as_deref(), Some("t3/L2/v04"));
        assert_eq!(language.perturbation, Perturbation::default());
        assert_eq!(simultaneous.instruction, language.instruction);
        assert_eq!(simultaneous.variant_id, language.variant_id);
        assert_eq!(simultaneous.perturbation, camera.perturbation);
    }

    fn select(tasks: &str) -> Vec<TaskRef> {
        crate::design::select_tasks(tasks).expect("tasks")
    }
}
