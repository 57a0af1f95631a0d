//! A campaign: which policy is measured on which rollouts. This module reads
//! and checks the specification; which rollouts a design has is `design`'s
//! business, and what an imported row may say is `manifest`'s.

use serde::{Deserialize, Serialize};

use crate::axis::Axis;
use crate::axis_set::AxisSet;
use crate::condition::Realisation;
use crate::design::{Design, DesignError, DesignVersion, Nominal, select_tasks};
use crate::directions::Directions;
use crate::execution::Execution;
use crate::explanation::Explanation;
use crate::level::Level;
use crate::manifest::{self, ManifestErrors};
use crate::names::UnknownName;
use crate::placebo::Placebo;
use crate::presets::PRESETS;
use crate::row::ManifestRow;
use crate::stop::{self, Stop, StopError};
use crate::suite::TaskRef;
use crate::thresholds::Thresholds;
use crate::wanted::{MIN_DIGEST_DIGITS, RendererKind, Wanted};
use crate::wording::JsonError;

/// Most replicates of a campaign: replicates multiply its rollouts.
pub const MAX_REPLICATES: u32 = 100;

/// The specification of a campaign, as people and tools write it in JSON.
///
/// The fields of its [`Rollouts`] stand beside the others: `tasks`, `axes`,
/// `levels` and, optional, `subsets`, `configs`, `nominal`, `design_seed`, `directions`,
/// `placebo_radius` and `placebo_configs`; or `manifest`, `explains` or `thresholds`, instead of all these. Tasks are written as
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
    /// Source of random elements.
    pub realisation: Realisation,
    /// Number of runs of every rollout, each with another policy seed.
    pub replicates: u32,
    /// Rollouts that are filmed.
    pub record: Record,
    /// Asset pack and renderer required of its workers; what is left open is decided by the first
    /// result.
    pub wanted: Wanted,
    /// Rule by which it ends early; without one it runs to its end.
    pub stop: Option<Stop>,
    /// The robot's conduct while an answer of its policy is under way.
    pub execution: Execution,
}

/// Source of a campaign's rows.
#[derive(Clone, Debug, PartialEq)]
pub enum Rollouts {
    /// Rows of a design, expanded with the protocol's figures and this project's paraphrases.
    Design(Design),
    /// Rows of a manifest as they stand, instructions included.
    Manifest(Vec<ManifestRow>),
    /// Subsets of the axes that follow from the outcomes of another campaign.
    Explanation(Explanation),
    /// Further radii that follow from the outcomes of another campaign.
    Thresholds(Thresholds),
}

impl Rollouts {
    /// The campaign from whose outcomes they follow, if they do.
    pub fn source(&self) -> Option<&str> {
        match self {
            Self::Design(_) | Self::Manifest(_) => None,
            Self::Explanation(Explanation { campaign, .. })
            | Self::Thresholds(Thresholds { campaign, .. }) => Some(campaign),
        }
    }

    /// Says how the campaign is called from whose outcomes they follow.
    pub fn set_source(&mut self, name: &str) {
        match self {
            Self::Design(_) | Self::Manifest(_) => {}
            Self::Explanation(Explanation { campaign, .. })
            | Self::Thresholds(Thresholds { campaign, .. }) => name.clone_into(campaign),
        }
    }
}

/// A policy and where it answers.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PolicyRoute {
    /// Name of the policy at the endpoint.
    pub name: String,
    /// URL of the gateway, or of the policy itself.
    pub endpoint: String,
}

/// Rollouts of a campaign that are filmed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Record {
    /// No rollout.
    #[default]
    None,
    /// Rollouts that fail.
    Failures,
    /// Rollouts of configurations whose outcome simultaneous perturbation changes,
    /// and their nominal rollouts: afterwards, from the actions that are kept
    /// with every rollout.
    Transitions,
    /// Every rollout.
    All,
}

/// A specification that cannot run.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SpecError {
    /// Not JSON, an unknown or missing field, or an unknown name in one.
    #[error("read campaign specification: {problem}")]
    Json {
        /// Problem and its line.
        problem: String,
    },
    /// A field that must not be empty.
    #[error("read campaign specification: `{field}` is empty, {remedy}")]
    Empty {
        /// The field.
        field: &'static str,
        /// Remedy: the value to write.
        remedy: &'static str,
    },
    /// Too few or too many replicates.
    #[error(
        "read campaign specification: `replicates` has {given}, valid are 1 to {MAX_REPLICATES}"
    )]
    Replicates {
        /// The number given.
        given: u32,
    },
    /// Not a URL.
    #[error(
        "read campaign specification: `policy.endpoint` is `{given}`, \
         write a URL such as http://127.0.0.1:50051"
    )]
    Endpoint {
        /// The text given.
        given: String,
    },
    /// No asset pack's name or digest.
    #[error(
        "read campaign specification: `assets` is `{given}`, write `primitives`, `libero` or the \
         first {MIN_DIGEST_DIGITS} digits or more of a pack's digest (workers are given the folder)"
    )]
    Assets {
        /// The text given.
        given: String,
    },
    /// Another realisation than `matched`, in a campaign that follows from outcomes.
    #[error(
        "read campaign specification: `{field}` with `realisation` reference, in which an axis \
         is another perturbation in each condition: write matched"
    )]
    Unmatched {
        /// The field that says what it follows from.
        field: &'static str,
    },
    /// A radius outside its range.
    #[error(
        "read campaign specification: `{field}` is {given}, valid are {} to {}", valid[0], valid[1]
    )]
    Radius {
        /// The field.
        field: &'static str,
        /// The radius given.
        given: f64,
        /// Valid range.
        valid: [f64; 2],
    },
    /// A rule that cannot end the campaign.
    #[error("read campaign specification: {0}")]
    Stop(StopError),
    /// A design that cannot be run.
    #[error("read campaign specification: {0}")]
    Design(DesignError),
    /// Imported rows that cannot be run. The lines are those of a manifest with
    /// one row a line.
    #[error(transparent)]
    Manifest(#[from] ManifestErrors),
}

// Their words are part of this error's: as its source, they would be said twice.
impl From<StopError> for SpecError {
    fn from(error: StopError) -> Self {
        Self::Stop(error)
    }
}

impl From<DesignError> for SpecError {
    fn from(error: DesignError) -> Self {
        Self::Design(error)
    }
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
                self.check_matched("explains")?;
            }
            Rollouts::Thresholds(thresholds) => {
                if thresholds.campaign.is_empty() {
                    return empty("thresholds.campaign", "name the campaign to go on with");
                }
                if let Some((field, given, valid)) = thresholds.out_of_range() {
                    return Err(SpecError::Radius {
                        field,
                        given,
                        valid,
                    });
                }
                self.check_matched("thresholds")?;
            }
        }
        if let Some(stop) = &self.stop {
            stop.check(self.replicates)?;
            let follows = |field| StopError::Follows { field };
            match &self.rollouts {
                Rollouts::Design(design) if design.axes.len() < 2 => {
                    return Err(StopError::NotSimultaneous.into());
                }
                Rollouts::Design(_) => {}
                Rollouts::Manifest(rows) => stop::check_rows(rows)?,
                Rollouts::Explanation(_) => return Err(follows("explains").into()),
                Rollouts::Thresholds(_) => return Err(follows("thresholds").into()),
            }
        }
        Ok(())
    }

    fn check_matched(&self, field: &'static str) -> Result<(), SpecError> {
        match self.realisation {
            Realisation::Matched => Ok(()),
            Realisation::Reference => Err(SpecError::Unmatched { field }),
        }
    }

    /// Returns the version of the design that its rollouts belong to.
    pub fn version(&self) -> DesignVersion {
        let version = match &self.rollouts {
            Rollouts::Design(design) => design.version(),
            Rollouts::Manifest(rows) => DesignVersion::of_manifest(rows),
            Rollouts::Explanation(explanation) => DesignVersion::of_explanation(explanation),
            Rollouts::Thresholds(thresholds) => DesignVersion::of_thresholds(thresholds),
        };
        version.under(&self.execution)
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
    directions: Option<Directions>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    placebo_radius: Option<f64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    placebo_configs: Option<Vec<u16>>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    manifest: Option<Vec<ManifestRow>>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    explains: Option<Explanation>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    thresholds: Option<Thresholds>,
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
    #[serde(default, skip_serializing_if = "Execution::is_wait")]
    execution: Execution,
}

/// Fields that do not go together, or a task that is none.
#[derive(Debug, thiserror::Error)]
enum TextError {
    #[error(
        "the field `{0}` is not there: a campaign has `tasks`, `axes` and `levels`, or a \
         `manifest`, or `explains` another, or measures `thresholds` of another"
    )]
    Missing(&'static str),
    #[error("`{other}` beside `{field}`, which says what is run by itself: take one of them out")]
    Beside {
        other: &'static str,
        field: &'static str,
    },
    #[error(transparent)]
    Task(#[from] UnknownName),
    #[error(transparent)]
    Design(#[from] DesignError),
}

impl TryFrom<SpecText> for CampaignSpec {
    type Error = TextError;

    fn try_from(mut text: SpecText) -> Result<Self, TextError> {
        no_two_sources(&text)?;
        let rollouts = if let Some(rows) = text.manifest.take() {
            Rollouts::Manifest(rows)
        } else if let Some(explanation) = text.explains.take() {
            Rollouts::Explanation(explanation)
        } else if let Some(thresholds) = text.thresholds.take() {
            Rollouts::Thresholds(thresholds)
        } else {
            Rollouts::Design(design(&mut text)?)
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
            execution: text.execution,
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
            directions: None,
            placebo_radius: None,
            placebo_configs: None,
            manifest: None,
            explains: None,
            thresholds: None,
            realisation: spec.realisation,
            replicates: spec.replicates,
            record: spec.record,
            assets: spec.wanted.assets,
            renderer: spec.wanted.renderer,
            stop: spec.stop,
            execution: spec.execution,
        };
        match spec.rollouts {
            Rollouts::Manifest(rows) => text.manifest = Some(rows),
            Rollouts::Explanation(explanation) => text.explains = Some(explanation),
            Rollouts::Thresholds(thresholds) => text.thresholds = Some(thresholds),
            Rollouts::Design(design) => {
                if design.has_placebo() {
                    text.placebo_radius = Some(design.placebo.radius.radius());
                }
                text.placebo_configs = design.placebo.configs;
                text.directions = Some(design.directions).filter(|it| *it != Directions::Shared);
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

/// Refuses whatever else says what is run beside a field that does so by itself.
fn no_two_sources(text: &SpecText) -> Result<(), TextError> {
    let written = [
        ("manifest", text.manifest.is_some()),
        ("explains", text.explains.is_some()),
        ("thresholds", text.thresholds.is_some()),
        ("tasks", text.tasks.is_some()),
        ("axes", text.axes.is_some()),
        ("subsets", text.subsets.is_some()),
        ("levels", text.levels.is_some()),
        ("configs", text.configs.is_some()),
        ("nominal", text.nominal.is_some()),
        ("design_seed", text.design_seed.is_some()),
        ("directions", text.directions.is_some()),
        ("placebo_radius", text.placebo_radius.is_some()),
        ("placebo_configs", text.placebo_configs.is_some()),
    ];
    let by_themselves = &written[..3];
    let Some(&(field, _)) = by_themselves.iter().find(|(_, written)| *written) else {
        return Ok(());
    };
    let is_other = |(name, written): &&(&str, bool)| *written && *name != field;
    match written.iter().find(is_other) {
        Some(&(other, _)) => Err(TextError::Beside { other, field }),
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
        directions: text.directions.unwrap_or_default(),
        placebo: Placebo {
            radius: placebo_radius(text.placebo_radius)?,
            configs: text.placebo_configs.take(),
        },
    };
    Ok(design.in_order())
}

fn placebo_radius(given: Option<f64>) -> Result<Level, DesignError> {
    match given {
        None => Ok(Placebo::DEFAULT_RADIUS),
        Some(given) => Level::of_radius(given).ok_or(DesignError::PlaceboRadius { given }),
    }
}

fn one() -> u32 {
    1
}

#[cfg(test)]
mod tests;
