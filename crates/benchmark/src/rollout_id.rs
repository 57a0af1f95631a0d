//! Rollout ids: the identity of a rollout in a design, from which its seeds are derived. The
//! replicate is not part of the id.

use std::fmt;
use std::str::FromStr;

use crate::condition::Condition;
use crate::level::Level;
use crate::names::{UnknownName, serde_as_text};
use crate::suite::{INIT_STATES_PER_TASK, Suite, TaskRef};
use crate::variant_name::VariantName;

const PATTERN: &str = "SUITE/tN/CONDITION/LEVEL/cNN for configuration NN, for example \
                       spatial/t0/camera/L2/c00 or spatial/t0/simultaneous/L2/c00, or \
                       SUITE/tN/nominal/iNN for initial state NN, or \
                       SUITE/tN/BENCHMARK:CHANGE/iNN, for example goal/t8/plus:noise_30/i00, or \
                       own/tN/own:SUITE/iNN for a suite file, whose perturbed rollouts are \
                       own/tN/CONDITION/LEVEL/cNN";

/// Identifies one rollout: `spatial/t0/camera/L2/c00`.
///
/// The last number is the configuration. A nominal rollout has an initial state instead,
/// `spatial/t0/nominal/i07`. The parser also accepts `spatial/t0/nominal/L0/c07`, and the
/// reference's names of conditions.
///
/// A rollout of LIBERO's family has the benchmark, the benchmark's name of the change, and an
/// initial state: `goal/t8/plus:noise_30/i00`, `goal/t3/pro:swap/i07`,
/// `goal/t8/plus:unperturbed/i00`. A rollout of a suite file has the position of the task in the
/// file, and the name of the task's suite: `own/t17/own:libero_90/i03`. If the file's tasks are
/// perturbed, their rollouts, nominal ones included, are named as those of LIBERO's tasks:
/// `own/t17/camera/L2/c00`.
///
/// A rollout of another simulator is named likewise, by its task's place in the manifest and, if
/// nominal, by its seed; its level is always a radius: `sim/t3/sensor/r4/c07`,
/// `sim/t3/nominal/i07`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct RolloutId {
    task: TaskRef,
    condition: Condition,
    level: Level,
    number: u16,
    /// Name of the variant of LIBERO's family or of the suite of a suite file; `None` for a
    /// rollout of LIBERO-CTRL.
    variant: Option<VariantName>,
}

impl RolloutId {
    pub const fn nominal(task: TaskRef, init_id: u16) -> Self {
        Self {
            task,
            condition: Condition::Nominal,
            level: Level::L0,
            number: init_id,
            variant: None,
        }
    }

    pub const fn of_variant(task: TaskRef, variant: VariantName, init_id: u16) -> Self {
        Self {
            task,
            condition: Condition::Variant,
            level: Level::L0,
            number: init_id,
            variant: Some(variant),
        }
    }

    pub fn perturbed(
        task: TaskRef,
        condition: Condition,
        level: Level,
        config: u16,
    ) -> Result<Self, UnknownName> {
        let level = match task.suite() {
            Suite::Simulated => level.without_name(),
            _ => level,
        };
        let id = Self { task, condition, level, number: config, variant: None };
        if !has_config(condition) {
            return Err(unknown(&id.to_string()));
        }
        Ok(id)
    }

    pub const fn task(&self) -> TaskRef {
        self.task
    }

    pub const fn condition(&self) -> Condition {
        self.condition
    }

    /// Returns the level of perturbation; L0 in nominal rollouts, at the placebo level, and in
    /// rollouts of LIBERO's family or of a suite file.
    pub const fn level(&self) -> Level {
        self.level
    }

    pub fn is_placebo(&self) -> bool {
        self.level == Level::L0 && has_config(self.condition)
    }

    /// `None` for a nominal rollout, and for a rollout of LIBERO's family or of a suite file.
    pub fn config(&self) -> Option<u16> {
        has_config(self.condition).then_some(self.number)
    }

    pub const fn variant(&self) -> Option<VariantName> {
        self.variant
    }

    /// Returns the name of the suite that is sent to a policy: that of LIBERO's suite, or the name
    /// in the suite file.
    pub fn suite_name(&self) -> &str {
        match &self.variant {
            Some(name) if name.benchmark().is_none() => name.change(),
            _ => self.task.suite().name(),
        }
    }

    /// Returns the last number of the id: the configuration, or in a rollout without a
    /// configuration the initial state.
    pub const fn number(&self) -> u16 {
        self.number
    }

    /// Returns the id as the reference writes it: its manifests have this text, and seeds are
    /// derived from it.
    pub fn published(&self) -> String {
        self.text(self.condition.published())
    }

    fn text(&self, condition: &str) -> String {
        let (suite, task) = (self.task.suite().short_name(), self.task.index());
        let (level, number) = (self.level, self.number);
        match self.variant {
            Some(variant) => format!("{suite}/t{task}/{variant}/i{number:02}"),
            None if has_config(self.condition) => {
                format!("{suite}/t{task}/{condition}/{level}/c{number:02}")
            }
            None => format!("{suite}/t{task}/{condition}/i{number:02}"),
        }
    }
}

impl fmt::Display for RolloutId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.text(self.condition.name()))
    }
}

impl FromStr for RolloutId {
    type Err = UnknownName;

    fn from_str(text: &str) -> Result<Self, UnknownName> {
        let parts: Vec<&str> = text.split('/').collect();
        let [suite, task, rest @ ..] = parts.as_slice() else { return Err(unknown(text)) };
        let index = number(task, "t");
        let task = match *suite {
            "own" => index.and_then(|index| u8::try_from(index).ok()).map(TaskRef::own),
            "sim" => index.and_then(|index| u8::try_from(index).ok()).map(TaskRef::simulated),
            _ => {
                let suite: Suite = suite.parse()?;
                index.map(|index| TaskRef::new(suite, index.into())).transpose()?
            }
        };
        let task = task.ok_or_else(|| unknown(text))?;
        if let [name, state] = rest
            && name.contains(':')
        {
            let state = init_state(state).ok_or_else(|| unknown(text))?;
            let name: VariantName = name.parse()?;
            let is_of_suite = match task.suite() {
                Suite::Own => name.benchmark().is_none(),
                Suite::Simulated => false,
                _ => name.benchmark().is_some(),
            };
            return is_of_suite
                .then_some(Self::of_variant(task, name, state))
                .ok_or_else(|| unknown(text));
        }
        let (condition, level, number) = match rest {
            [condition, state] if condition.parse() == Ok(Condition::Nominal) => {
                (Condition::Nominal, Level::L0, number(state, "i"))
            }
            [condition, level, config] => (condition.parse()?, level.parse()?, number(config, "c")),
            _ => return Err(unknown(text)),
        };
        match number {
            Some(state) if condition == Condition::Nominal => {
                let is_valid = level == Level::L0
                    && (state < INIT_STATES_PER_TASK || task.suite() == Suite::Simulated);
                is_valid.then_some(Self::nominal(task, state)).ok_or_else(|| unknown(text))
            }
            Some(config) => Self::perturbed(task, condition, level, config),
            None => Err(unknown(text)),
        }
    }
}

serde_as_text!(RolloutId);

fn init_state(text: &str) -> Option<u16> {
    number(text, "i").filter(|state| *state < INIT_STATES_PER_TASK)
}

fn has_config(condition: Condition) -> bool {
    !matches!(condition, Condition::Nominal | Condition::Variant)
}

fn number(text: &str, prefix: &str) -> Option<u16> {
    let digits = text.strip_prefix(prefix)?;
    let is_number = !digits.is_empty() && digits.bytes().all(|byte| byte.is_ascii_digit());
    is_number.then(|| digits.parse().ok()).flatten()
}

fn unknown(given: &str) -> UnknownName {
    UnknownName::new("rollout id", given, &[PATTERN])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::axis::Axis;
    use crate::benchmark::Benchmark;

    fn check(text: &str, canonical: &str) {
        let id: RolloutId = text.parse().expect("an id");
        assert_eq!(id.to_string(), canonical);
    }

    #[test]
    fn ids_are_parsed_from_their_text() {
        check("spatial/t0/camera/L2/c00", "spatial/t0/camera/L2/c00");
        check("long/t5/combination/L3/c08", "long/t5/simultaneous/L3/c08");
        check("goal/t9/robot/r2.5/c123", "goal/t9/robot/r2.5/c123");
        check("goal/t9/robot/r4.0/c1", "goal/t9/robot/L2/c01");
        check("goal/t9/clean/i49", "goal/t9/nominal/i49");
        check("spatial/t0/clean/L0/c07", "spatial/t0/nominal/i07");
        check("spatial/t0/camera/L0/c03", "spatial/t0/camera/L0/c03");
        check("own/t255/camera/L2/c00", "own/t255/camera/L2/c00");
        check("own/t1/nominal/i00", "own/t1/nominal/i00");
        check("sim/t1/nominal/i1234", "sim/t1/nominal/i1234");
        check("sim/t1/sensor/L2/c07", "sim/t1/sensor/r4/c07");
        check("sim/t255/simultaneous/r2/c07", "sim/t255/simultaneous/r2/c07");
        check("sim/t255/sensor/L0/c07", "sim/t255/sensor/L0/c07");
        let id: RolloutId = "long/t5/sensor/L3/c08".parse().expect("an id");
        assert_eq!(id.task(), "libero_10/5".parse().expect("a task"));
        assert_eq!(id.condition(), Condition::Single(Axis::Sensor));
        assert_eq!((id.level(), id.config()), (Level::L3, Some(8)));
        let is_placebo = |text: &str| text.parse::<RolloutId>().expect("an id").is_placebo();
        assert!(is_placebo("spatial/t0/language/L0/c03"));
        assert!(!is_placebo("spatial/t0/nominal/i03") && !is_placebo("spatial/t0/language/L1/c03"));
    }

    #[test]
    fn ids_of_variants_are_parsed_and_sorted_by_task() {
        let texts = [
            "goal/t3/pro:swap/i07",
            "goal/t4/para:contextual_subordination_1/i00",
            "goal/t8/plus:level5_sample2/i00",
            "goal/t8/plus:noise_30/i00",
            "goal/t8/plus:unperturbed/i00",
            "goal/t8/pro:unperturbed/i00",
            "long/t0/plus:view_0_0_100_0_0/i00",
        ];
        let mut ids: Vec<RolloutId> = Vec::new();
        for text in texts {
            check(text, text);
            let id: RolloutId = text.parse().expect("an id");
            assert_eq!(id.condition(), Condition::Variant);
            assert!(id.config().is_none() && !id.is_placebo(), "{text}");
            ids.push(id);
        }
        let name = ids[3].variant().expect("a variant");
        assert_eq!((name.benchmark(), name.change()), (Some(Benchmark::Plus), "noise_30"));
        assert!(
            !name.is_unperturbed() && ids[4].variant().is_some_and(|name| name.is_unperturbed())
        );
        assert!(ids.is_sorted());
        let nominal: RolloutId = "goal/t8/nominal/i00".parse().expect("an id");
        assert!(!ids.contains(&nominal) && nominal.variant().is_none());
    }

    #[test]
    fn ids_of_suite_files_have_their_own_tasks_and_names() {
        check("own/t129/own:libero_90/i03", "own/t129/own:libero_90/i03");
        let id: RolloutId = "own/t129/own:libero_90/i03".parse().expect("an id");
        assert_eq!(id.task(), TaskRef::own(129));
        let name = id.variant().expect("a suite");
        assert_eq!((name.benchmark(), name.change()), (None, "libero_90"));
        assert_eq!(id.suite_name(), "libero_90");
        assert!("own/3".parse::<TaskRef>().is_err(), "no task without its file");
    }

    #[test]
    fn malformed_ids_are_refused() {
        for text in [
            "own/t256/own:libero_90/i03",
            "own/t1/own:libero_90/i50",
            "own/t1/own:unperturbed/i00",
            "own/t1/plus:noise_30/i00",
            "goal/t1/own:libero_90/i00",
            "own/t256/camera/L2/c00",
            "sim/t256/sensor/r4/c00",
            "sim/t1/own:metaworld/i00",
            "sim/t1/plus:noise_30/i00",
            "",
            "spatial",
            "spatial/t0/camera/L2",
            "spatial/t0/camera/L2/00",
            "spatial/t0/camera/L2/c+1",
            "spatial/t0/nominal/L1/c00",
            "spatial/t0/nominal/i50",
            "spatial/t0/nominal/L0/c50",
            "spatial/t0/camera/r0/c00",
            "spatial/t10/camera/L2/c00",
            "spatial/t0/camera/L2/c00/r1",
            "goal/t8/paraphrase:noise_30/i00",
            "goal/t8/plus:/i00",
            "goal/t8/plus:noise-31/i00",
            "goal/t8/plus:noise_30/i50",
            "goal/t8/plus:noise_30/c00",
            "goal/t8/plus:noise_30/L1/c00",
            "goal/t8/variant/L1/c00",
            "goal/t8/plus:a_change_of_more_than_31_characters/i00",
        ] {
            assert!(text.parse::<RolloutId>().is_err(), "{text}");
        }
    }
}
