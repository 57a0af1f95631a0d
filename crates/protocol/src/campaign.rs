//! A campaign: which policy is measured on which rollouts. This module reads
//! and checks the specification; which rollouts a design has is `design`'s
//! business, and what an imported row may say is `manifest`'s.

use serde::{Deserialize, Serialize};

use crate::axis::Axis;
use crate::axis_set::AxisSet;
use crate::condition::Realisation;
use crate::design::{Design, DesignError, DesignVersion, Nominal, select_tasks};
use crate::explanation::Explanation;
use crate::level::Level;
use crate::manifest::{self, ManifestErrors};
use crate::names::UnknownName;
use crate::presets::PRESETS;
use crate::row::ManifestRow;
use crate::stop::{self, Stop, StopError};
use crate::suite::TaskRef;
use crate::wanted::{MIN_DIGEST_DIGITS, RendererKind, Wanted};
use crate::wording::JsonError;

/// Most replicates of a campaign: replicates multiply its rollouts.
pub const MAX_REPLICATES: u32 = 100;

/// The specification of a campaign, as people and tools write it in JSON.
///
/// The fields of its [`Rollouts`] stand beside the others: `tasks`, `axes`,
/// `levels` and, optional, `subsets`, `configs`, `nominal` and `design_seed`; or
/// `manifest`, or `explains`, instead of all these. Tasks are written as
/// `libero_goal/3`, `libero_goal` (its ten tasks) or `all`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "SpecText", into = "SpecText")]
pub struct CampaignSpec {
    /// Name, unique at a coordinator.
    pub name: String,
    /// The policy that acts.
    pub policy: PolicyRoute,
    /// The rollouts to run.
    pub rollouts: Rollouts,
    /// Where random elements come from.
    pub realisation: Realisation,
    /// How often every rollout runs, each time with another policy seed.
    pub replicates: u32,
    /// Which rollouts are filmed.
    pub record: Record,
    /// What its workers must run on, where that matters before the first result
    /// decides it.
    pub wanted: Wanted,
    /// When it ends early; without it, it runs to its end.
    pub stop: Option<Stop>,
}

/// Where the rows of a campaign come from.
#[derive(Clone, Debug, PartialEq)]
pub enum Rollouts {
    /// From a design, expanded with the protocol's figures and this project's
    /// paraphrases.
    Design(Design),
    /// From a manifest: the rows as they stand, instructions included.
    Manifest(Vec<ManifestRow>),
    /// From the outcomes of another campaign.
    Explanation(Explanation),
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

/// Which rollouts of a campaign are filmed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Record {
    /// None.
    #[default]
    None,
    /// Those that fail.
    Failures,
    /// Those of configurations whose outcome simultaneous perturbation changes,
    /// and their nominal rollouts: afterwards, from the actions that are kept
    /// with every rollout.
    Transitions,
    /// All.
    All,
}

/// A specification that cannot run.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
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
    /// Too few or too many replicates.
    #[error(
        "read campaign specification: `replicates` has {given}, valid are 1 to {MAX_REPLICATES}"
    )]
    Replicates {
        /// What it says.
        given: u32,
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
    /// No asset pack's name or digest.
    #[error(
        "read campaign specification: `assets` is `{given}`, write `primitives`, `libero` or the \
         first {MIN_DIGEST_DIGITS} digits or more of a pack's digest (workers are given the folder)"
    )]
    Assets {
        /// What it says.
        given: String,
    },
    /// Another realisation than `matched`, in a campaign that explains.
    #[error(
        "read campaign specification: `explains` with `realisation` reference, in which an axis \
         is another perturbation in each condition: write matched"
    )]
    Unmatched,
    /// A rule that cannot end the campaign.
    #[error("read campaign specification: {0}")]
    Stop(#[from] StopError),
    /// A design that cannot be run.
    #[error("read campaign specification: {0}")]
    Design(#[from] DesignError),
    /// Imported rows that cannot be run. The lines are those of a manifest with
    /// one row a line.
    #[error(transparent)]
    Manifest(#[from] ManifestErrors),
}

impl CampaignSpec {
    /// Reads and checks a specification.
    ///
    /// # Errors
    /// Names what is wrong and what would be right.
    pub fn from_json(text: &str) -> Result<Self, SpecError> {
        let spec: Self = serde_json::from_str(text).map_err(|error| SpecError::Json {
            problem: JsonError::from(error).to_string(),
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
        if !(1..=MAX_REPLICATES).contains(&self.replicates) {
            let given = self.replicates;
            return Err(SpecError::Replicates { given });
        }
        if let Some(given) = self.wanted.unknown_assets() {
            let given = given.to_owned();
            return Err(SpecError::Assets { given });
        }
        match &self.rollouts {
            Rollouts::Design(design) => design.check()?,
            Rollouts::Manifest(rows) => manifest::check(rows)?,
            Rollouts::Explanation(explanation) => {
                if explanation.campaign.is_empty() {
                    return empty("explains.campaign", "name the campaign to explain");
                }
                if self.realisation != Realisation::Matched {
                    return Err(SpecError::Unmatched);
                }
            }
        }
        if let Some(stop) = &self.stop {
            stop.check(self.replicates)?;
            match &self.rollouts {
                Rollouts::Design(design) if design.axes.len() < 2 => {
                    return Err(StopError::NotSimultaneous.into());
                }
                Rollouts::Design(_) => {}
                Rollouts::Manifest(rows) => stop::check_rows(rows)?,
                Rollouts::Explanation(_) => return Err(StopError::Explains.into()),
            }
        }
        Ok(())
    }

    /// Which design this is.
    pub fn version(&self) -> DesignVersion {
        match &self.rollouts {
            Rollouts::Design(design) => design.version(),
            Rollouts::Manifest(rows) => DesignVersion::of_manifest(rows),
            Rollouts::Explanation(explanation) => DesignVersion::of_explanation(explanation),
        }
    }
}

/// A specification as it is written.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct SpecText {
    name: String,
    policy: PolicyRoute,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    tasks: Option<Vec<String>>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    axes: Option<Vec<Axis>>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    subsets: Option<Vec<AxisSet>>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    levels: Option<Vec<Level>>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    configs: Option<Vec<u16>>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    nominal: Option<Nominal>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    design_seed: Option<u64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    manifest: Option<Vec<ManifestRow>>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    explains: Option<Explanation>,
    #[serde(default)]
    realisation: Realisation,
    #[serde(default = "one")]
    replicates: u32,
    #[serde(default)]
    record: Record,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    assets: Option<String>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    renderer: Option<RendererKind>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    stop: Option<Stop>,
}

/// Fields that do not go together, or a task that is none.
#[derive(Debug, thiserror::Error)]
enum TextError {
    #[error(
        "the field `{0}` is not there: a campaign has `tasks`, `axes` and `levels`, or a \
         `manifest`, or `explains` another"
    )]
    Missing(&'static str),
    #[error("`{other}` beside `{field}`, which says what is run by itself: take one of them out")]
    Beside {
        other: &'static str,
        field: &'static str,
    },
    #[error(transparent)]
    Task(#[from] UnknownName),
}

impl TryFrom<SpecText> for CampaignSpec {
    type Error = TextError;

    fn try_from(mut text: SpecText) -> Result<Self, TextError> {
        let rollouts = match (text.manifest.take(), text.explains.take()) {
            (Some(_), Some(_)) => {
                let (other, field) = ("explains", "manifest");
                return Err(TextError::Beside { other, field });
            }
            (Some(rows), None) => {
                no_design(&text, "manifest")?;
                Rollouts::Manifest(rows)
            }
            (None, Some(explanation)) => {
                no_design(&text, "explains")?;
                Rollouts::Explanation(explanation)
            }
            (None, None) => Rollouts::Design(design(&mut text)?),
        };
        Ok(Self {
            name: text.name,
            policy: text.policy,
            rollouts,
            realisation: text.realisation,
            replicates: text.replicates,
            record: text.record,
            wanted: Wanted {
                assets: text.assets,
                renderer: text.renderer,
            },
            stop: text.stop,
        })
    }
}

impl From<CampaignSpec> for SpecText {
    fn from(spec: CampaignSpec) -> Self {
        let mut text = Self {
            name: spec.name,
            policy: spec.policy,
            tasks: None,
            axes: None,
            subsets: None,
            levels: None,
            configs: None,
            nominal: None,
            design_seed: None,
            manifest: None,
            explains: None,
            realisation: spec.realisation,
            replicates: spec.replicates,
            record: spec.record,
            assets: spec.wanted.assets,
            renderer: spec.wanted.renderer,
            stop: spec.stop,
        };
        match spec.rollouts {
            Rollouts::Manifest(rows) => text.manifest = Some(rows),
            Rollouts::Explanation(explanation) => text.explains = Some(explanation),
            Rollouts::Design(design) => {
                text.tasks = Some(design.tasks.iter().map(TaskRef::to_string).collect());
                text.axes = Some(design.axes);
                text.subsets = Some(design.subsets).filter(|subsets| !subsets.is_empty());
                text.levels = Some(design.levels);
                text.configs = Some(design.configs);
                text.nominal = Some(design.nominal);
                text.design_seed = (design.seed != 0).then_some(design.seed);
            }
        }
        text
    }
}

/// Refuses what a design has beside a field that stands instead of it.
fn no_design(text: &SpecText, field: &'static str) -> Result<(), TextError> {
    let written = [
        ("tasks", text.tasks.is_some()),
        ("axes", text.axes.is_some()),
        ("subsets", text.subsets.is_some()),
        ("levels", text.levels.is_some()),
        ("configs", text.configs.is_some()),
        ("nominal", text.nominal.is_some()),
        ("design_seed", text.design_seed.is_some()),
    ];
    match written.iter().find(|(_, written)| *written) {
        Some((other, _)) => Err(TextError::Beside { other, field }),
        None => Ok(()),
    }
}

fn design(text: &mut SpecText) -> Result<Design, TextError> {
    let names = text.tasks.take().ok_or(TextError::Missing("tasks"))?;
    let mut tasks = Vec::new();
    for name in names {
        tasks.extend(select_tasks(&name)?);
    }
    let design = Design {
        tasks,
        axes: text.axes.take().ok_or(TextError::Missing("axes"))?,
        subsets: text.subsets.take().unwrap_or_default(),
        levels: text.levels.take().ok_or(TextError::Missing("levels"))?,
        configs: text
            .configs
            .take()
            .unwrap_or_else(|| (0..PRESETS).collect()),
        nominal: text.nominal.unwrap_or_default(),
        seed: text.design_seed.unwrap_or_default(),
    };
    Ok(design.in_order())
}

fn one() -> u32 {
    1
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
        let design = design(&spec);
        assert_eq!(design.tasks.len(), 2);
        assert_eq!(design.axes, [Axis::Camera, Axis::Sensor]);
        assert_eq!(design.configs, (0..10).collect::<Vec<_>>());
        let text = serde_json::to_string(&spec).expect("JSON");
        assert_eq!(CampaignSpec::from_json(&text).expect("reads back"), spec);
    }

    fn design(spec: &CampaignSpec) -> &Design {
        match &spec.rollouts {
            Rollouts::Design(design) => design,
            Rollouts::Manifest(_) | Rollouts::Explanation(_) => panic!("{spec:?}"),
        }
    }

    #[test]
    fn a_manifest_stands_in_place_of_a_design() {
        let rows = Design::v0_1().expand().expect("rows");
        let row = &rows[..1];
        let mut json = serde_json::json!({
            "name": "imported",
            "policy": {"name": "expert", "endpoint": "http://127.0.0.1:50051"},
            "manifest": row,
        });
        let spec = CampaignSpec::from_json(&json.to_string()).expect("a specification");
        assert_eq!(spec.rollouts, Rollouts::Manifest(row.to_vec()));
        let text = serde_json::to_string(&spec).expect("JSON");
        assert_eq!(CampaignSpec::from_json(&text).expect("reads back"), spec);

        json["configs"] = serde_json::json!([0]);
        let error = CampaignSpec::from_json(&json.to_string()).expect_err("both");
        assert!(
            error.to_string().contains("`configs` beside `manifest`"),
            "{error}"
        );
    }

    #[test]
    fn an_explanation_stands_in_place_of_a_design_and_has_no_rows_of_its_own() {
        let mut json = serde_json::json!({
            "name": "why",
            "policy": {"name": "expert", "endpoint": "http://127.0.0.1:50051"},
            "explains": {"campaign": "first", "budget": 200},
        });
        let spec = CampaignSpec::from_json(&json.to_string()).expect("a specification");
        assert_eq!(spec.expand(), Ok(Vec::new()));
        assert!(spec.version().as_str().starts_with("explains-"));
        let text = serde_json::to_string(&spec).expect("JSON");
        assert_eq!(CampaignSpec::from_json(&text).expect("reads back"), spec);

        json["realisation"] = "reference".into();
        let error = CampaignSpec::from_json(&json.to_string()).expect_err("unmatched");
        assert!(error.to_string().contains("write matched"), "{error}");
        json["levels"] = serde_json::json!(["L2"]);
        let error = CampaignSpec::from_json(&json.to_string()).expect_err("both");
        assert!(
            error.to_string().contains("`levels` beside `explains`"),
            "{error}"
        );
    }

    #[test]
    fn imported_rows_are_checked_like_those_of_a_file() {
        let check = |rows: &[ManifestRow], expected: &str| {
            let json = serde_json::json!({
                "name": "imported",
                "policy": {"name": "expert", "endpoint": "http://127.0.0.1:50051"},
                "manifest": rows,
            });
            let error = CampaignSpec::from_json(&json.to_string()).expect_err(expected);
            assert!(error.to_string().contains(expected), "{error}");
        };
        let rows = Design::v0_1().expand().expect("rows");
        check(&[], "it has no rows");
        check(
            &[rows[0].clone(), rows[0].clone()],
            "line 2: spatial/t0/clean/i43 is already",
        );
        let mut weaker = rows[1].clone();
        weaker.perturbation = rows[8].perturbation;
        check(&[weaker], "have radius");
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
        check("levels", json("null"), "the field `levels` is not there");
        check(
            "configs",
            json("[1000]"),
            "`configs` has 1000, valid are 0 to 999",
        );
        check("nominal", json(r#""some""#), "`some` has no meaning; write");
        check(
            "replicates",
            json("0"),
            "`replicates` has 0, valid are 1 to 100",
        );
        check("colour", json("1"), "there is no field `colour`");
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
