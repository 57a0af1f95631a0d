//! Specification of a campaign: a policy and the rollouts to measure it on. This module
//! parses and validates the specification; `design` defines the rollouts of a design, and
//! `manifest` validates rows.

use serde::{Deserialize, Serialize};

use crate::axis::Axis;
use crate::axis_set::AxisSet;
use crate::condition::{Condition, Realisation};
use crate::design::{Design, DesignError, Nominal, Placebo, select_tasks};
use crate::design_version::DesignVersion;
use crate::directions::Directions;
use crate::execution::Execution;
use crate::level::Level;
use crate::look::Look;
use crate::manifest;
use crate::names::UnknownName;
use crate::presets::PRESETS;
use crate::row::ManifestRow;
use crate::spec_error::{MAX_REPLICATES, SpecError};
use crate::stop::{self, Stop, StopError};
use crate::suite::TaskRef;
use crate::thresholds::Thresholds;
use crate::wanted::{RendererKind, Wanted};
use crate::wording::JsonError;

/// The specification of a campaign, as people and tools write it in JSON.
///
/// The fields of [`Rollouts`] are flattened into the specification: `tasks`, `axes`, `levels` and
/// optionally `subsets`, `configs`, `nominal`, `design_seed`, `directions`, `placebo_radius` and
/// `placebo_configs`; or, instead of all these, `rows`. Tasks are written as `libero_goal/3`,
/// `libero_goal` (its ten tasks) or `all`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "SpecText", into = "SpecText")]
pub struct CampaignSpec {
    /// Name, unique at a coordinator.
    pub name: String,
    pub policy: PolicyRoute,
    pub rollouts: Rollouts,
    /// Purpose of rows that follow from the outcomes of another campaign.
    pub purpose: Option<Purpose>,
    /// Source of the random elements of perturbations.
    pub realisation: Realisation,
    /// Number of runs of every rollout, each with a different policy seed.
    pub replicates: u32,
    pub record: Record,
    /// Asset pack, renderer and look required of workers. The first result fixes them if they are
    /// unspecified.
    pub wanted: Wanted,
    /// Rule for stopping early; without a rule, all rollouts run.
    pub stop: Option<Stop>,
    /// Behaviour of the robot while a response of its policy is pending.
    pub execution: Execution,
}

/// Source of a campaign's rows.
#[derive(Clone, Debug, PartialEq)]
pub enum Rollouts {
    /// Rows of a design, expanded with the protocol's parameters and this project's paraphrases.
    Design(Design),
    /// Rows that a client sends, unchanged, including their instructions.
    Rows(Vec<ManifestRow>),
}

/// Purpose of a campaign whose rows follow from the outcomes of another campaign, the *source*, and
/// its own. The campaign starts without rows; a client computes and appends them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Purpose {
    /// Find the minimal subsets of axes that change an outcome.
    Explanation(Explanation),
    /// Find the radius at which success turns to failure.
    Thresholds(Thresholds),
}

#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PolicyRoute {
    pub name: String,
    /// URL of the gateway, or of the policy itself.
    pub endpoint: String,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Record {
    #[default]
    None,
    Failures,
    /// Rollouts of configurations whose outcome changes under simultaneous perturbation,
    /// and their nominal rollouts; replayed afterwards from the actions stored with every
    /// rollout.
    Transitions,
    All,
}

/// Parameters of a campaign that explains another campaign: it runs subsets of the axes in
/// configurations whose outcome changed under simultaneous perturbation.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Explanation {
    pub campaign: String,
    /// Largest number of rollouts; `None` if every transition is explained.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub budget: Option<u32>,
    /// Seed of the order in which transitions are explained.
    #[serde(default)]
    pub seed: u64,
    /// True if every subset is run, not only the subsets needed to find the minimal subsets.
    #[serde(default)]
    pub exhaustive: bool,
    /// Largest number of replicates that decide whether a subset succeeds, for a policy that
    /// samples; `None` if one rollout decides.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub repeats: Option<u32>,
}

impl Rollouts {
    /// Returns the protocol of the rows, if they are of LIBERO's family or of a suite file; `None`
    /// for LIBERO-CTRL, and for a suite file's tasks under its axes.
    pub fn protocol(&self) -> Option<&str> {
        match self {
            Self::Design(_) => None,
            Self::Rows(rows) => {
                let first = rows.first()?;
                first.protocol.as_deref().filter(|_| first.id.variant().is_some())
            }
        }
    }

    /// Returns the execution model of a campaign whose specification names none.
    pub fn execution(&self) -> Execution {
        match self {
            Self::Rows(rows) => manifest::execution(rows),
            Self::Design(_) => Execution::Wait,
        }
    }
}

impl Purpose {
    pub fn source(&self) -> &str {
        match self {
            Self::Explanation(Explanation { campaign, .. })
            | Self::Thresholds(Thresholds { campaign, .. }) => campaign,
        }
    }

    pub fn set_source(&mut self, name: &str) {
        match self {
            Self::Explanation(Explanation { campaign, .. })
            | Self::Thresholds(Thresholds { campaign, .. }) => name.clone_into(campaign),
        }
    }
}

impl CampaignSpec {
    pub fn from_json(text: &str) -> Result<Self, SpecError> {
        let spec: Self = serde_json::from_str(text)
            .map_err(|error| SpecError::Json { problem: JsonError::from(error).to_string() })?;
        spec.check()?;
        Ok(spec)
    }

    pub fn check(&self) -> Result<(), SpecError> {
        let empty = |field, remedy| Err(SpecError::Empty { field, remedy });
        if self.name.is_empty() {
            return empty("name", "name the campaign");
        }
        if self.policy.name.is_empty() {
            return empty("policy.name", "write the policy's name at its endpoint");
        }
        if !is_endpoint(&self.policy.endpoint) {
            return Err(SpecError::Endpoint);
        }
        if !(1..=MAX_REPLICATES).contains(&self.replicates) {
            let given = self.replicates;
            return Err(SpecError::Replicates { given });
        }
        if let Some(given) = self.wanted.unknown_assets() {
            let given = given.to_owned();
            return Err(SpecError::Assets { given });
        }
        if let Some(purpose) = &self.purpose {
            if purpose.source().is_empty() {
                return empty("purpose.campaign", "name the campaign to explain or to measure");
            }
            if self.rollouts != Rollouts::Rows(Vec::new()) {
                return Err(SpecError::Purpose);
            }
            if self.realisation == Realisation::Reference {
                return Err(SpecError::Unmatched);
            }
            if let Purpose::Thresholds(thresholds) = purpose
                && let Some((field, given, valid)) = thresholds.out_of_range()
            {
                return Err(SpecError::Radius { field, given, valid });
            }
        }
        match &self.rollouts {
            Rollouts::Design(design) => {
                design.check()?;
                self.check_axes(design.conditions())?;
            }
            Rollouts::Rows(_) if self.purpose.is_some() => {}
            Rollouts::Rows(rows) => self.check_rows(rows)?,
        }
        if self.stop.is_some() {
            if self.replicates != 1 {
                return Err(StopError::Replicates { given: self.replicates }.into());
            }
            match &self.rollouts {
                Rollouts::Design(design) if design.axis_set().len() < 2 => {
                    return Err(StopError::NotSimultaneous.into());
                }
                Rollouts::Design(_) => {}
                Rollouts::Rows(rows) => stop::check_rows(rows)?,
            }
        }
        Ok(())
    }

    pub fn check_rows(&self, rows: &[ManifestRow]) -> Result<(), SpecError> {
        manifest::check(rows)?;
        let (row_model, given) = (manifest::execution(rows), self.execution.clone());
        if !row_model.is_wait() && row_model != given {
            return Err(SpecError::Execution { given, row_model });
        }
        if self.record != Record::None && rows.iter().any(|row| row.simulator.is_some()) {
            return Err(SpecError::Films);
        }
        self.check_axes(rows.iter().map(|row| row.id.condition()))
    }

    /// Rejects an execution model beside an axis that sets it.
    fn check_axes(&self, run: impl IntoIterator<Item = Condition>) -> Result<(), SpecError> {
        match run.into_iter().any(Condition::sets_execution) && !self.execution.is_wait() {
            true => Err(SpecError::Latency { given: self.execution.clone() }),
            false => Ok(()),
        }
    }

    pub fn version(&self) -> DesignVersion {
        let version = match (&self.purpose, &self.rollouts) {
            (Some(purpose), _) => DesignVersion::of_purpose(purpose),
            (None, Rollouts::Design(design)) => design.version(),
            (None, Rollouts::Rows(rows)) => DesignVersion::of_rows(rows),
        };
        version.under(&self.execution)
    }
}

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
    rows: Option<Vec<ManifestRow>>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    purpose: Option<Purpose>,
    #[serde(default)]
    realisation: Realisation,
    #[serde(default = "default_replicates")]
    replicates: u32,
    #[serde(default)]
    record: Record,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    assets: Option<String>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    renderer: Option<RendererKind>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    look: Option<Look>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    stop: Option<Stop>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    execution: Option<Execution>,
}

#[derive(Debug, thiserror::Error)]
enum TextError {
    #[error(
        "the field `{0}` is missing: a specification has `tasks`, `axes` and `levels`, or `rows` \
         instead"
    )]
    Missing(&'static str),
    #[error("`{0}` and `rows` both define the rollouts: remove one of them")]
    ConflictingSources(&'static str),
    #[error(transparent)]
    Task(#[from] UnknownName),
    #[error(transparent)]
    Design(#[from] DesignError),
}

impl TryFrom<SpecText> for CampaignSpec {
    type Error = TextError;

    fn try_from(mut text: SpecText) -> Result<Self, TextError> {
        let rollouts = match text.rows.take() {
            Some(rows) => {
                check_has_no_design(&text)?;
                Rollouts::Rows(rows)
            }
            None => Rollouts::Design(design(&mut text)?),
        };
        Ok(Self {
            name: text.name,
            policy: text.policy,
            realisation: text.realisation,
            replicates: text.replicates,
            record: text.record,
            wanted: Wanted { assets: text.assets, renderer: text.renderer, look: text.look },
            stop: text.stop,
            execution: text.execution.unwrap_or_else(|| rollouts.execution()),
            rollouts,
            purpose: text.purpose,
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
            rows: None,
            purpose: spec.purpose,
            realisation: spec.realisation,
            replicates: spec.replicates,
            record: spec.record,
            assets: spec.wanted.assets,
            renderer: spec.wanted.renderer,
            look: spec.wanted.look,
            stop: spec.stop,
            execution: (!spec.execution.is_wait()).then_some(spec.execution),
        };
        match spec.rollouts {
            Rollouts::Rows(rows) => text.rows = Some(rows),
            Rollouts::Design(design) => {
                if design.has_placebo() {
                    text.placebo_radius = Some(design.placebo.radius.radius());
                }
                text.axes = Some(design.axes);
                text.placebo_configs = design.placebo.configs;
                text.directions =
                    Some(design.directions).filter(|directions| *directions != Directions::Shared);
                text.tasks = Some(design.tasks.iter().map(TaskRef::to_string).collect());
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

fn check_has_no_design(text: &SpecText) -> Result<(), TextError> {
    let written = [
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
    match written.into_iter().find(|(_, is_written)| *is_written) {
        Some((field, _)) => Err(TextError::ConflictingSources(field)),
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
        configs: text.configs.take().unwrap_or_else(|| (0..PRESETS).collect()),
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

fn default_replicates() -> u32 {
    1
}

/// True for the URL of a gRPC server, which is shown to everybody who may see the campaign.
fn is_endpoint(url: &str) -> bool {
    let is_of_host = |char: char| char.is_ascii_alphanumeric() || ".-_:[]".contains(char);
    url.split_once("://").is_some_and(|(scheme, host)| {
        let host = host.strip_suffix('/').unwrap_or(host);
        ["http", "https", "grpc", "grpcs"].contains(&scheme)
            && !host.is_empty()
            && host.chars().all(is_of_host)
    })
}

#[cfg(test)]
mod tests;
