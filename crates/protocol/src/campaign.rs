//! A campaign: which policy is measured on which part of the design. This
//! module reads and checks the specification; `expansion` makes rows of it.
//!
//! LIBERO-CTRL v0.1 is one campaign among others: all six axes, three levels,
//! forty tasks, ten configurations and all nominal rollouts.

use std::collections::BTreeSet;

use serde::{Deserialize, Deserializer, Serialize};

use crate::condition::{Axis, Condition, Level, Realisation};
use crate::names::{UnknownName, serde_as_text};
use crate::presets::PRESETS;
use crate::suite::{Suite, TaskRef};

/// Most replicates of a campaign: replicates multiply its rollouts.
pub const MAX_REPLICATES: u32 = 100;

/// The specification of a campaign, as people and tools write it in JSON.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CampaignSpec {
    /// Name, unique at a coordinator.
    pub name: String,
    /// Who acts.
    pub policy: PolicyRoute,
    /// Tasks. Written as `libero_goal/3`, `libero_goal` (its ten tasks) or
    /// `all`; kept in the benchmark's order, each once.
    #[serde(deserialize_with = "tasks_from_text")]
    pub tasks: Vec<TaskRef>,
    /// Axes: each is perturbed alone, and all of them together.
    #[serde(deserialize_with = "in_order")]
    pub axes: Vec<Axis>,
    /// Levels of every axis.
    #[serde(deserialize_with = "in_order")]
    pub levels: Vec<Level>,
    /// Configurations, of 0 to 9.
    #[serde(default = "all_configs", deserialize_with = "in_order")]
    pub configs: Vec<u16>,
    /// Which nominal rollouts go with them.
    #[serde(default)]
    pub nominal: Nominal,
    /// Where random elements come from.
    #[serde(default)]
    pub realisation: Realisation,
    /// How often every rollout runs, with other policy seeds.
    #[serde(default = "one")]
    pub replicates: u32,
    /// Which rollouts are filmed.
    #[serde(default)]
    pub record: Record,
}

/// A policy and where it answers.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PolicyRoute {
    /// Its name at the endpoint.
    pub name: String,
    /// URL of the gateway, or of the policy itself.
    pub endpoint: String,
}

/// Which nominal rollouts a campaign contains.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Nominal {
    /// All fifty initial states of every task.
    #[default]
    All,
    /// The initial states of the campaign's configurations.
    Eval,
    /// None.
    None,
}

/// Which rollouts of a campaign are filmed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Record {
    /// None.
    #[default]
    None,
    /// Those that fail.
    Failures,
    /// All.
    All,
}

/// Which design a campaign follows: `v0.1` exactly for LIBERO-CTRL v0.1, else
/// `custom-` and a checksum of the design. Results of different designs are
/// never pooled.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct DesignVersion(String);

impl DesignVersion {
    /// The text.
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl std::fmt::Display for DesignVersion {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.0)
    }
}

impl std::str::FromStr for DesignVersion {
    type Err = UnknownName;

    fn from_str(text: &str) -> Result<Self, UnknownName> {
        match text == V0_1 || text.starts_with("custom-") {
            true => Ok(Self(text.to_owned())),
            false => Err(UnknownName::new("design", text, &[V0_1, "custom-CHECKSUM"])),
        }
    }
}

serde_as_text!(DesignVersion);

const V0_1: &str = "v0.1";

/// A specification that cannot run.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SpecError {
    /// Not JSON, an unknown or missing field, or an unknown name in one.
    #[error("read campaign specification: {problem}")]
    Json {
        /// Which, and in which line.
        problem: String,
    },
    /// A field that must not be empty.
    #[error("read campaign specification: `{field}` is empty, {remedy}")]
    Empty {
        /// The field.
        field: &'static str,
        /// What to write.
        remedy: &'static str,
    },
    /// A number outside its range.
    #[error("read campaign specification: `{field}` has {given}, valid are {valid}")]
    OutOfRange {
        /// The field.
        field: &'static str,
        /// The number.
        given: u64,
        /// Its range.
        valid: String,
    },
    /// Not a URL.
    #[error(
        "read campaign specification: `policy.endpoint` is `{given}`, \
         write a URL such as http://127.0.0.1:50051"
    )]
    Endpoint {
        /// What it says.
        given: String,
    },
}

impl CampaignSpec {
    /// LIBERO-CTRL v0.1: the whole design, 10,400 rollouts.
    pub fn v0_1(name: impl Into<String>, policy: PolicyRoute) -> Self {
        Self {
            name: name.into(),
            policy,
            tasks: TaskRef::all().collect(),
            axes: Axis::ALL.to_vec(),
            levels: Level::PERTURBED.to_vec(),
            configs: all_configs(),
            nominal: Nominal::All,
            realisation: Realisation::Matched,
            replicates: 1,
            record: Record::None,
        }
    }

    /// Reads and checks a specification.
    ///
    /// # Errors
    /// Names what is wrong and what would be right.
    pub fn from_json(text: &str) -> Result<Self, SpecError> {
        let spec: Self = serde_json::from_str(text).map_err(|error| SpecError::Json {
            problem: error.to_string(),
        })?;
        spec.check()?;
        Ok(spec)
    }

    /// Checks what the types leave open.
    ///
    /// # Errors
    /// Names what is wrong and what would be right.
    pub fn check(&self) -> Result<(), SpecError> {
        let empty = |field, remedy| Err(SpecError::Empty { field, remedy });
        if self.name.is_empty() {
            return empty("name", "name the campaign");
        }
        if self.policy.name.is_empty() {
            return empty("policy.name", "name the policy as its endpoint does");
        }
        if !self.policy.endpoint.contains("://") {
            let given = self.policy.endpoint.clone();
            return Err(SpecError::Endpoint { given });
        }
        if self.tasks.is_empty() {
            return empty("tasks", "write for example libero_goal/3 or all");
        }
        if self.axes.is_empty() != self.levels.is_empty() {
            return empty(
                if self.axes.is_empty() {
                    "axes"
                } else {
                    "levels"
                },
                "axes and levels go together: give both, or neither for nominal rollouts",
            );
        }
        if self.axes.is_empty() && self.nominal == Nominal::None {
            return empty("axes", "and no nominal rollouts are asked for either");
        }
        if self.configs.is_empty() {
            return empty("configs", "write some of 0 to 9");
        }
        let out_of_range = |field, given, valid: String| SpecError::OutOfRange {
            field,
            given,
            valid,
        };
        if let Some(&config) = self.configs.iter().find(|&&config| config >= PRESETS) {
            let valid = format!("0 to {}", PRESETS - 1);
            return Err(out_of_range("configs", u64::from(config), valid));
        }
        if self.levels.contains(&Level::L0) {
            return Err(out_of_range("levels", 0, "L1, L2, L3".to_owned()));
        }
        if !(1..=MAX_REPLICATES).contains(&self.replicates) {
            let valid = format!("1 to {MAX_REPLICATES}");
            return Err(out_of_range(
                "replicates",
                u64::from(self.replicates),
                valid,
            ));
        }
        Ok(())
    }

    /// The perturbed conditions: each axis alone, then, of two axes or more,
    /// their combination.
    pub fn conditions(&self) -> Vec<Condition> {
        let mut conditions: Vec<Condition> =
            self.axes.iter().copied().map(Condition::Single).collect();
        if conditions.len() > 1 {
            conditions.push(Condition::Combination);
        }
        conditions
    }

    /// Which design this is.
    pub fn version(&self) -> DesignVersion {
        let design = (
            &self.tasks,
            &self.axes,
            &self.levels,
            &self.configs,
            self.nominal,
        );
        let whole = Self::v0_1("", self.policy.clone());
        let whole = (
            &whole.tasks,
            &whole.axes,
            &whole.levels,
            &whole.configs,
            whole.nominal,
        );
        if design == whole {
            return DesignVersion(V0_1.to_owned());
        }
        let text = serde_json::to_string(&design).expect("names and numbers serialise");
        DesignVersion(format!("custom-{:08x}", crc32fast::hash(text.as_bytes())))
    }
}

fn all_configs() -> Vec<u16> {
    (0..PRESETS).collect()
}

fn one() -> u32 {
    1
}

/// Reads a list as a set: sorted, each once, so that equal designs are equal.
fn in_order<'de, T, D>(source: D) -> Result<Vec<T>, D::Error>
where
    T: Deserialize<'de> + Ord,
    D: Deserializer<'de>,
{
    Ok(BTreeSet::deserialize(source)?.into_iter().collect())
}

fn tasks_from_text<'de, D: Deserializer<'de>>(source: D) -> Result<Vec<TaskRef>, D::Error> {
    let mut tasks = BTreeSet::new();
    for text in Vec::<String>::deserialize(source)? {
        tasks.extend(select_tasks(&text).map_err(serde::de::Error::custom)?);
    }
    Ok(tasks.into_iter().collect())
}

/// The tasks that a text names: `all`, a suite, or one task.
///
/// # Errors
/// If it names none.
pub fn select_tasks(text: &str) -> Result<Vec<TaskRef>, UnknownName> {
    if text == "all" {
        return Ok(TaskRef::all().collect());
    }
    if text.contains('/') {
        return Ok(vec![text.parse()?]);
    }
    Ok(text.parse::<Suite>()?.tasks().collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn spec(changes: &[(&str, serde_json::Value)]) -> Result<CampaignSpec, SpecError> {
        let mut json = serde_json::json!({
            "name": "demo",
            "policy": {"name": "expert", "endpoint": "http://127.0.0.1:50051"},
            "tasks": ["libero_object/1", "libero_object/0", "libero_object/1"],
            "axes": ["sensor", "camera"],
            "levels": ["L1"],
            "nominal": "eval",
        });
        for (field, value) in changes {
            json[field] = value.clone();
        }
        CampaignSpec::from_json(&json.to_string())
    }

    #[test]
    fn a_specification_reads_back_and_is_in_order() {
        let spec = spec(&[]).expect("a specification");
        assert_eq!(spec.tasks.len(), 2);
        assert_eq!(spec.axes, [Axis::Camera, Axis::Sensor]);
        assert_eq!(spec.configs, (0..10).collect::<Vec<_>>());
        let text = serde_json::to_string(&spec).expect("JSON");
        assert_eq!(CampaignSpec::from_json(&text).expect("reads back"), spec);
    }

    #[test]
    fn only_the_whole_design_is_v0_1() {
        let whole = CampaignSpec::v0_1("whole", spec(&[]).expect("a specification").policy);
        assert_eq!(whole.version().as_str(), "v0.1");
        let replicated = CampaignSpec {
            replicates: 3,
            ..whole.clone()
        };
        assert_eq!(replicated.version().as_str(), "v0.1");
        let part = CampaignSpec {
            configs: vec![0],
            ..whole
        };
        assert!(part.version().as_str().starts_with("custom-"));
        assert_ne!(
            part.version(),
            spec(&[]).expect("a specification").version()
        );
    }

    #[test]
    fn bad_names_and_numbers_are_named_with_the_valid_ones() {
        let check = |field: &str, value: serde_json::Value, expected: &str| {
            let error = spec(&[(field, value)]).expect_err(field).to_string();
            assert!(error.contains(expected), "{error}");
        };
        let json = |text: &str| serde_json::from_str(text).expect("JSON");
        check(
            "tasks",
            json(r#"["libero_goat"]"#),
            "suite `libero_goat`: valid are libero_spatial",
        );
        check(
            "tasks",
            json(r#"["libero_goal/10"]"#),
            "libero_goal/0 to libero_goal/9",
        );
        check("tasks", json("[]"), "`tasks` is empty");
        check(
            "axes",
            json(r#"["camrea"]"#),
            "axis `camrea`: valid are camera",
        );
        check("axes", json("[]"), "go together");
        check(
            "levels",
            json(r#"["L4"]"#),
            "level `L4`: valid are L1, L2, L3",
        );
        check("levels", json(r#"["L0"]"#), "valid are L1, L2, L3");
        check(
            "configs",
            json("[10]"),
            "`configs` has 10, valid are 0 to 9",
        );
        check("nominal", json(r#""some""#), "unknown variant `some`");
        check(
            "replicates",
            json("0"),
            "`replicates` has 0, valid are 1 to 100",
        );
        check("colour", json("1"), "unknown field `colour`");
        check(
            "policy",
            json(r#"{"name": "p", "endpoint": "here"}"#),
            "is `here`",
        );
        check(
            "realisation",
            json(r#""matchd""#),
            "valid are matched, reference",
        );
    }
}
