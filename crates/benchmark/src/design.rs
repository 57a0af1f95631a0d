//! Design of a campaign: a selection from the protocol, or an extension of it. This module
//! defines and validates designs; `design_version` identifies them, and `expansion` expands them
//! into rows.

use std::fmt::Write;

use serde::{Deserialize, Serialize};

use crate::axis::{Axis, Radii};
use crate::axis_set::AxisSet;
use crate::condition::Condition;
use crate::design_version::DesignVersion;
use crate::directions::{Directions, MAX_CONFIGS};
use crate::level::Level;
use crate::names::UnknownName;
use crate::presets::PRESETS;
use crate::row::MAX_ROWS;
use crate::suite::{INIT_STATES_PER_TASK, Suite, TaskRef};

/// Tasks × configurations × levels × conditions, and nominal rollouts.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Design {
    /// Tasks, in the benchmark's order, each once.
    pub tasks: Vec<TaskRef>,
    /// Perturbed axes: each alone and, if two or more of them are combined, these simultaneously.
    pub axes: Vec<Axis>,
    /// Further conditions: proper subsets of two or more axes.
    pub subsets: Vec<AxisSet>,
    /// Levels of every axis. L0 is the placebo level.
    pub levels: Vec<Level>,
    /// Configurations: 0 to 9 are the protocol's presets; others are drawn.
    pub configs: Vec<u16>,
    pub nominal: Nominal,
    /// Seed of the configurations beyond the presets, and of task-specific directions.
    pub seed: u64,
    pub directions: Directions,
    /// Settings of the placebo level; the defaults if L0 is not among `levels`.
    pub placebo: Placebo,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Nominal {
    /// All fifty initial states of every task.
    #[default]
    All,
    /// The initial states of the design's configurations.
    Eval,
    None,
}

#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum DesignError {
    #[error("`{field}` is empty, {remedy}")]
    Empty { field: &'static str, remedy: &'static str },
    #[error("`{field}` has {given}, valid are {valid}")]
    OutOfRange { field: &'static str, given: u64, valid: String },
    #[error(
        "`subsets` has {given}, valid are sets of two axes or more of {axes}, but not all of them: \
         single axes and all at once always run"
    )]
    Subset { given: AxisSet, axes: AxisSet },
    #[error("`{field}` applies to the placebo level only: add L0 to `levels`, or remove `{field}`")]
    NoPlacebo { field: &'static str },
    #[error(
        "`placebo_radius` is {given}, valid are {} to {}", PLACEBO_RADII[0], PLACEBO_RADII[1]
    )]
    PlaceboRadius { given: f64 },
    #[error("`placebo_configs` has {given}, which is not in `configs`")]
    PlaceboConfig { given: u16 },
    #[error("axis `{axis}` {}", not_at(*axis, *level))]
    NotAt { axis: Axis, level: Level },
    #[error(
        "axis `language` has paraphrases of LIBERO's instructions only, and {task} has `{given}`: \
         remove it from `axes`, write one of LIBERO's as the task's `prompt`, or import a manifest \
         with its own instructions"
    )]
    NoParaphrase { task: TaskRef, given: String },
    #[error(
        "the design has up to {rows} rollouts, at most {MAX_ROWS} are possible: divide the design"
    )]
    TooLarge {
        /// The bound: configurations with the same initial state share a nominal rollout, but are
        /// counted separately.
        rows: usize,
    },
}

impl Design {
    /// LIBERO-CTRL v0.1: 2,000 nominal and 8,400 perturbed rollouts.
    pub fn v0_1() -> Self {
        Self {
            tasks: TaskRef::all().collect(),
            axes: Axis::ALL.to_vec(),
            subsets: Vec::new(),
            levels: Level::PERTURBED.to_vec(),
            configs: (0..PRESETS).collect(),
            nominal: Nominal::All,
            seed: 0,
            directions: Directions::default(),
            placebo: Placebo::default(),
        }
    }

    /// Returns the design with every list sorted and deduplicated, so that equivalent
    /// designs compare equal.
    pub fn in_order(self) -> Self {
        Self {
            tasks: in_order(self.tasks),
            axes: in_order(self.axes),
            subsets: in_order(self.subsets),
            levels: in_order(self.levels),
            configs: in_order(self.configs),
            placebo: Placebo { configs: self.placebo.configs.map(in_order), ..self.placebo },
            ..self
        }
    }

    pub fn check(&self) -> Result<(), DesignError> {
        let empty = |field, remedy| Err(DesignError::Empty { field, remedy });
        if self.tasks.is_empty() {
            return empty("tasks", "write for example libero_goal/3 or all");
        }
        let perturbs_nothing = self.axes.is_empty();
        if perturbs_nothing != self.levels.is_empty() {
            let missing = if perturbs_nothing { "axes" } else { "levels" };
            return empty(
                missing,
                "axes and levels go together: give both, or neither for nominal rollouts",
            );
        }
        if perturbs_nothing && self.nominal == Nominal::None {
            return empty("axes", "and `nominal` is none, so that the design has no rollouts");
        }
        let axes = self.axis_set();
        let is_valid = |set: AxisSet| set.len() > 1 && set.is_subset(axes) && set != axes;
        if let Some(&given) = self.subsets.iter().find(|&&set| !is_valid(set)) {
            return Err(DesignError::Subset { given, axes });
        }
        if self.configs.is_empty() {
            return empty("configs", "write some, such as 0 to 9");
        }
        if let Some(&config) = self.configs.iter().find(|&&config| config >= MAX_CONFIGS) {
            return Err(DesignError::OutOfRange {
                field: "configs",
                given: u64::from(config),
                valid: format!("0 to {}", MAX_CONFIGS - 1),
            });
        }
        self.check_placebo()?;
        // An axis without a placebo is left out at L0.
        for &level in self.levels.iter().filter(|level| **level != Level::L0) {
            self.axes.iter().try_for_each(|axis| check_at(Condition::Single(*axis), level))?;
        }
        match self.max_rows() {
            rows if rows > MAX_ROWS => Err(DesignError::TooLarge { rows }),
            _ => Ok(()),
        }
    }

    fn check_placebo(&self) -> Result<(), DesignError> {
        let Placebo { radius, configs } = &self.placebo;
        if !self.has_placebo() {
            let field = match configs {
                Some(_) => "placebo_configs",
                None if *radius != Placebo::DEFAULT_RADIUS => "placebo_radius",
                None => return Ok(()),
            };
            return Err(DesignError::NoPlacebo { field });
        }
        if !Placebo::is_valid_radius(*radius) {
            let given = radius.radius();
            return Err(DesignError::PlaceboRadius { given });
        }
        if configs.as_ref().is_some_and(Vec::is_empty) {
            return Err(DesignError::Empty {
                field: "placebo_configs",
                remedy: "write some of `configs`, or leave it out for all of them",
            });
        }
        let mut given = configs.iter().flatten();
        match given.find(|config| !self.configs.contains(config)) {
            Some(&given) => Err(DesignError::PlaceboConfig { given }),
            None => Ok(()),
        }
    }

    pub fn has_placebo(&self) -> bool {
        self.levels.contains(&Level::L0)
    }

    /// Only the placebo level may exclude configurations.
    pub(crate) fn runs_config(&self, level: Level, config: u16) -> bool {
        level != Level::L0 || self.placebo.includes(config)
    }

    pub fn axis_set(&self) -> AxisSet {
        self.axes.iter().copied().collect::<AxisSet>().combined()
    }

    /// Returns the perturbed conditions: each axis alone, the subsets and, if the design combines
    /// two axes or more, simultaneous.
    pub fn conditions(&self) -> Vec<Condition> {
        let mut conditions: Vec<Condition> =
            self.axes.iter().copied().map(Condition::Single).collect();
        conditions.extend(self.subsets.iter().copied().map(Condition::of));
        if self.axis_set().len() > 1 {
            conditions.push(Condition::Simultaneous);
        }
        conditions
    }

    pub fn version(&self) -> DesignVersion {
        if self.has_same_rollouts(&Self::v0_1()) {
            return DesignVersion::v0_1();
        }
        let (combined, others): (Vec<Axis>, Vec<Axis>) =
            self.axes.iter().partition(|axis| axis.def().is_combined);
        let text = serde_json::to_string(&(
            &self.tasks,
            combined,
            &self.levels,
            &self.configs,
            self.nominal,
            self.effective_seed(),
        ));
        let mut text = text.expect("names and numbers serialise");
        // Later fields are appended only if present, so that older designs keep their versions.
        for subset in &self.subsets {
            text.push_str(subset.name());
        }
        if self.directions == Directions::Own {
            text.push_str("own directions");
        }
        for axis in others {
            text.push_str(axis.name());
        }
        if self.has_placebo() {
            let Placebo { radius, configs } = &self.placebo;
            let _ = write!(text, "placebo {} {configs:?}", radius.radius());
        }
        DesignVersion::custom(&text)
    }

    fn has_same_rollouts(&self, other: &Self) -> bool {
        let without_seed = |design: &Self| Self { seed: 0, ..design.clone() };
        without_seed(self) == without_seed(other) && self.effective_seed() == other.effective_seed()
    }

    fn effective_seed(&self) -> Option<u64> {
        let draws_configs = self.configs.iter().any(|&config| config >= PRESETS);
        (draws_configs || self.directions == Directions::Own).then_some(self.seed)
    }

    /// Returns an upper bound of the number of rows: perturbed rollouts, and nominal rollouts, one
    /// for each configuration if they start from the configurations' initial states.
    fn max_rows(&self) -> usize {
        let configs_at = |level: &Level| {
            let configs = self.configs.iter();
            configs.filter(|&&config| self.runs_config(*level, config)).count()
        };
        let config_levels: usize = self.levels.iter().map(configs_at).sum();
        let states = usize::from(INIT_STATES_PER_TASK);
        let nominal = match self.nominal {
            Nominal::All => states,
            Nominal::Eval => self.configs.len().min(states),
            Nominal::None => 0,
        };
        let rows_per_task = config_levels * self.conditions().len() + nominal;
        self.tasks.len() * rows_per_task
    }
}

pub(crate) fn check_at(condition: Condition, level: Level) -> Result<(), DesignError> {
    match condition {
        Condition::Single(axis) if !axis.def().radii.contains(level) => {
            Err(DesignError::NotAt { axis, level })
        }
        _ => Ok(()),
    }
}

fn not_at(axis: Axis, level: Level) -> String {
    match axis.def().radii {
        Radii::Named => format!(
            "has paraphrases at L1, L2 and L3 and not at {level}: remove it from `axes`, or import \
             a manifest with its own instructions"
        ),
        Radii::Any | Radii::Multiples(_) => format!(
            "delays responses by half the radius in control steps, which is not a positive whole \
             number at {level}: write L1, L2, L3 (1, 2 and 4 steps) or an even radius, or remove \
             it from `axes`"
        ),
    }
}

/// Parses a selection of tasks: `all`, a suite, or one task.
pub fn select_tasks(text: &str) -> Result<Vec<TaskRef>, UnknownName> {
    if text == "all" {
        return Ok(TaskRef::all().collect());
    }
    if text.contains('/') {
        return Ok(vec![text.parse()?]);
    }
    Ok(text.parse::<Suite>()?.tasks().collect())
}

fn in_order<T: Ord>(mut values: Vec<T>) -> Vec<T> {
    values.sort();
    values.dedup();
    values
}

/// Smallest and largest radius of a placebo.
pub const PLACEBO_RADII: [f64; 2] = [0.001, 0.5];

/// Settings of a design's level `L0`. Directions, initial states and seeds are determined as
/// at the other levels; the instruction stays canonical. Changed outcomes at this level are the noise
/// floor of every paired measure.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Placebo {
    /// Radius in normalised coordinates, within [`PLACEBO_RADII`].
    pub radius: Level,
    /// Configurations to run at the placebo level; `None` for all of the design's.
    pub configs: Option<Vec<u16>>,
}

impl Placebo {
    /// Default radius, at which a camera turns by less than 0.1°.
    pub const DEFAULT_RADIUS: Level = Level::of_radius_micros(20_000);

    pub(crate) fn is_valid_radius(radius: Level) -> bool {
        (PLACEBO_RADII[0]..=PLACEBO_RADII[1]).contains(&radius.radius())
    }

    pub(crate) fn includes(&self, config: u16) -> bool {
        let configs = self.configs.as_ref();
        configs.is_none_or(|configs| configs.contains(&config))
    }
}

impl Default for Placebo {
    fn default() -> Self {
        Self { radius: Self::DEFAULT_RADIUS, configs: None }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn small() -> Design {
        Design {
            tasks: select_tasks("libero_goal/3").expect("a task"),
            axes: vec![Axis::Camera, Axis::Robot],
            subsets: Vec::new(),
            levels: vec![Level::L2],
            configs: vec![4],
            nominal: Nominal::Eval,
            ..Design::v0_1()
        }
    }

    #[test]
    fn only_the_full_design_of_v0_1_has_that_version() {
        let whole = Design::v0_1();
        assert_eq!(whole.version().as_str(), "v0.1");
        // The design draws nothing from the seed.
        let seeded = Design { seed: 7, ..whole.clone() };
        assert_eq!(seeded.version().as_str(), "v0.1");
        let mut versions = vec![small().version(), whole.version()];
        let mut add = |change: fn(&mut Design)| {
            let mut design = Design::v0_1();
            change(&mut design);
            assert!(design.version().as_str().starts_with("custom-"), "{design:?}");
            versions.push(design.version());
        };
        add(|design| design.configs = vec![0]);
        add(|design| design.configs.push(10));
        add(|design| {
            design.configs.push(10);
            design.seed = 7;
        });
        add(|design| design.nominal = Nominal::Eval);
        add(|design| {
            design.axes.pop();
        });
        add(|design| design.subsets = vec!["camera+robot".parse().expect("a set")]);
        add(|design| design.subsets = vec!["camera+sensor".parse().expect("a set")]);
        add(|design| {
            design.axes.pop();
            design.levels.push("r2.5".parse().expect("a level"));
        });
        add(|design| design.directions = Directions::Own);
        add(|design| {
            design.directions = Directions::Own;
            design.seed = 7;
        });
        add(|design| design.levels.insert(0, Level::L0));
        add(|design| {
            design.levels.insert(0, Level::L0);
            design.placebo.configs = Some(vec![0]);
        });
        let distinct: std::collections::BTreeSet<_> = versions.iter().collect();
        assert_eq!(distinct.len(), versions.len());
    }

    #[test]
    fn imported_rows_have_version_v0_1_only_if_identical() {
        let mut rows = Design::v0_1().expand().expect("rows");
        rows.reverse();
        assert_eq!(DesignVersion::of_manifest(&rows).as_str(), "v0.1");
        rows[17].instruction.push('!');
        let changed = DesignVersion::of_manifest(&rows);
        assert!(changed.as_str().starts_with("rows-"), "{changed}");
        assert_eq!(changed.to_string().parse(), Ok(changed.clone()));
        rows.pop();
        assert_ne!(DesignVersion::of_manifest(&rows), changed);
    }

    #[test]
    fn a_subset_has_at_least_two_but_not_all_axes_of_the_design() {
        let check = |text: &str, axes: &[Axis]| {
            let design = Design {
                axes: axes.to_vec(),
                subsets: vec![text.parse().expect("a set")],
                ..small()
            };
            design.check().map_err(|error| error.to_string())
        };
        assert_eq!(check("camera+robot", &Axis::METRIC), Ok(()));
        for (text, axes) in [
            ("camera", &Axis::METRIC[..]),
            ("none", &Axis::METRIC),
            ("camera+language", &Axis::METRIC),
            ("camera+robot", &[Axis::Camera, Axis::Robot]),
        ] {
            let error = check(text, axes).expect_err(text);
            assert!(error.contains(&format!("`subsets` has {text}")), "{error}");
        }
    }

    #[test]
    fn a_placebo_without_l0_or_with_unknown_configurations_or_too_large_a_radius_is_refused() {
        let check = |levels: &[Level], radius: f64, configs: Option<Vec<u16>>| {
            let radius = Level::of_radius(radius).expect("a radius");
            let design =
                Design { levels: levels.to_vec(), placebo: Placebo { radius, configs }, ..small() };
            design.check().map_err(|error| error.to_string())
        };
        let both = [Level::L0, Level::L2];
        assert_eq!(check(&both, 0.02, None), Ok(()));
        assert_eq!(check(&both, 0.05, Some(vec![4])), Ok(()));
        assert_eq!(check(&both[..1], 0.02, None), Ok(()));
        for (levels, radius, configs, expected) in [
            (&both[1..], 0.05, None, "add L0 to `levels`"),
            (
                &both[1..],
                0.02,
                Some(vec![4]),
                "`placebo_configs` applies to the placebo level only",
            ),
            (&both, 0.02, Some(vec![3]), "`placebo_configs` has 3"),
            (&both, 0.02, Some(vec![]), "`placebo_configs` is empty"),
            (&both, 2.0, None, "`placebo_radius` is 2, valid are 0.001 to 0.5"),
        ] {
            let error = check(levels, radius, configs).expect_err(expected);
            assert!(error.contains(expected), "{error}");
        }
    }

    #[test]
    fn a_language_axis_is_refused_where_there_are_no_paraphrases() {
        let design = Design {
            axes: vec![Axis::Language],
            levels: vec![Level::L1, "r2.5".parse().expect("a level")],
            ..small()
        };
        let error = design.check().expect_err("no paraphrases").to_string();
        assert!(error.contains("not at r2.5"), "{error}");
    }

    #[test]
    fn a_design_with_too_many_rollouts_is_refused_before_it_is_expanded() {
        let levels = (1..=9).map(|tenths| format!("r1.{tenths}").parse().expect("a level"));
        let design = Design {
            axes: Axis::METRIC.to_vec(),
            levels: levels.collect(),
            configs: (0..MAX_CONFIGS).collect(),
            ..Design::v0_1()
        };
        let cases =
            [(Nominal::All, 2_162_000), (Nominal::Eval, 2_162_000), (Nominal::None, 2_160_000)];
        for (nominal, rows) in cases {
            let design = Design { nominal, ..design.clone() };
            let error = design.check().expect_err("too large");
            assert_eq!(error, DesignError::TooLarge { rows });
        }
        let error = design.check().expect_err("too large").to_string();
        assert!(error.contains("the design has up to 2162000 rollouts, at most 250000"), "{error}");
    }
}
