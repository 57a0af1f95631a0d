//! Expansion of a campaign's specification into the rows of the job table, and the digest of the
//! specification. `ManifestRow` defines the contents of rows, `CampaignSpec::expand` their order: in
//! a design, a configuration's nominal rollout precedes its perturbed rollouts.

use std::collections::{BTreeMap, BTreeSet};

use benchmark::seeds::policy_seed;
use benchmark::{
    CampaignSpec, Condition, JsonError, ManifestRow, Record, RolloutId, SpecError, Stop, TaskKey,
    Wanted,
};
use paired::{Unit, drawn_order};
use serde_json::{Map, Value};
use sha2::{Digest, Sha256};

use crate::ids::{CampaignName, NameError};

#[derive(Clone, Debug)]
pub struct NewCampaign {
    pub name: CampaignName,
    /// Specification, JSON.
    pub spec: String,
    /// SHA-256 of the specification, hex.
    pub spec_digest: String,
    /// Name of the policy at its endpoint.
    pub policy: String,
    pub policy_endpoint: String,
    pub realisation: String,
    /// Execution model, as text.
    pub execution: String,
    /// Rollouts to be filmed, as [`Record`] names them.
    pub record: &'static str,
    /// Requirements on the workers.
    pub wanted: Wanted,
    /// Name of the campaign whose results are compared with this one's; `None` if there is none.
    pub source: Option<CampaignName>,
    /// Number of configurations if the campaign may stop early, in which case its jobs follow a
    /// random order of the configurations; `None` in other campaigns.
    pub stoppable_configurations: Option<usize>,
    /// Jobs in the campaign's order; none in a campaign that has a source.
    pub jobs: Vec<NewJob>,
    /// Sum of the control steps of all rollouts if none reaches its goal.
    pub step_budget: u64,
    /// Priority, one of [`PRIORITIES`](crate::rules::campaign::PRIORITIES); 0 by default.
    pub priority: i32,
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NewJob {
    pub rollout_id: String,
    pub replicate: u32,
    /// Key of the task and its files, as [`TaskKey::of_row`] writes it.
    pub task: String,
    pub init_id: u16,
    /// Place in the campaign's order of jobs, from 0; see [`NewCampaign::from_spec`].
    pub unit_order: i64,
    /// The manifest row, JSON.
    pub manifest_row: String,
    pub policy_seed: u64,
}

impl NewJob {
    pub fn is_placebo(&self) -> bool {
        self.rollout_id.parse::<RolloutId>().is_ok_and(|id| id.is_placebo())
    }

    fn is_simultaneous(&self) -> bool {
        let id = self.rollout_id.parse::<RolloutId>();
        id.is_ok_and(|id| id.condition() == Condition::Simultaneous)
    }

    pub(crate) fn new(
        row: &ManifestRow,
        replicate: u32,
        unit_order: i64,
    ) -> Result<Self, JsonError> {
        Ok(Self {
            rollout_id: row.id.to_string(),
            replicate,
            task: TaskKey::of_row(row),
            init_id: row.init_id,
            unit_order,
            manifest_row: serde_json::to_string(row).map_err(JsonError::from)?,
            policy_seed: policy_seed(&row.id, replicate),
        })
    }
}

/// A specification that cannot be expanded into a campaign.
#[derive(Debug, thiserror::Error)]
pub enum ExpandError {
    #[error(transparent)]
    Spec(#[from] SpecError),
    /// The name, which also names a folder, is invalid.
    #[error(transparent)]
    Name(#[from] NameError),
    #[error("write a campaign's manifest rows as JSON")]
    Json(#[from] JsonError),
}

impl NewCampaign {
    pub fn from_json(spec: &str) -> Result<NewCampaign, ExpandError> {
        NewCampaign::from_spec(&CampaignSpec::from_json(spec)?)
    }

    /// Expands a specification into its rows, once per replicate: in the order of the module's
    /// documentation, or in a random order if the campaign may stop early. All rows of a replicate
    /// come before those of the next.
    pub fn from_spec(spec: &CampaignSpec) -> Result<NewCampaign, ExpandError> {
        let name = CampaignName::parse(&spec.name)?;
        let mut rows = spec.expand()?;
        let stoppable_configurations =
            spec.stop.as_ref().map(|stop| order_randomly(&mut rows, stop));
        let budgets = rows.iter().map(|row| u64::from(row.max_steps));
        let step_budget = budgets.sum::<u64>() * u64::from(spec.replicates);
        let mut jobs = Vec::with_capacity(rows.len() * spec.replicates as usize);
        for replicate in 0..spec.replicates {
            for row in &rows {
                jobs.push(NewJob::new(row, replicate, jobs.len() as i64)?);
            }
        }
        let text = serde_json::to_string(spec).map_err(JsonError::from)?;
        Ok(NewCampaign {
            name,
            spec_digest: digest(&text),
            spec: text,
            policy: spec.policy.name.clone(),
            policy_endpoint: spec.policy.endpoint.clone(),
            realisation: spec.realisation.to_string(),
            execution: spec.execution.to_string(),
            wanted: spec.wanted.clone(),
            source: spec
                .purpose
                .as_ref()
                .map(|purpose| CampaignName::parse(purpose.source()))
                .transpose()?,
            stoppable_configurations,
            record: match spec.record {
                Record::None => "none",
                Record::Failures => "failures",
                Record::Transitions => "transitions",
                Record::All => "all",
            },
            jobs,
            step_budget,
            priority: 0,
        })
    }

    pub(crate) fn has_simultaneous(&self) -> bool {
        self.jobs.iter().any(NewJob::is_simultaneous)
    }

    pub fn tasks(&self) -> BTreeSet<&str> {
        self.jobs.iter().map(|job| job.task.as_str()).collect()
    }
}

/// Sorts rows into a random order of their configurations. A nominal rollout precedes the first
/// configuration that is compared with it; nominal rollouts without a configuration come last.
/// Returns the number of configurations.
fn order_randomly(rows: &mut [ManifestRow], stop: &Stop) -> usize {
    let unit = |row: &ManifestRow| -> Option<Unit> { Some((row.id.task(), row.id.config()?)) };
    let order = drawn_order(stop, rows.iter().filter_map(unit));
    let places: BTreeMap<Unit, usize> = order.units().copied().zip(0..).collect();
    let mut first_places = BTreeMap::new();
    for row in rows.iter() {
        if let Some(unit) = unit(row) {
            let first = first_places.entry((row.id.task(), row.init_id));
            let first = first.or_insert(usize::MAX);
            *first = places[&unit].min(*first);
        }
    }
    rows.sort_by_key(|row| match unit(row) {
        Some(unit) => (places[&unit], true),
        None => {
            let paired = first_places.get(&(row.id.task(), row.init_id));
            (paired.copied().unwrap_or(usize::MAX), false)
        }
    });
    places.len()
}

pub(crate) fn altered(
    spec: &str,
    change: impl FnOnce(&mut CampaignSpec),
) -> Result<(String, String), ExpandError> {
    let mut spec = CampaignSpec::from_json(spec)?;
    change(&mut spec);
    spec.check()?;
    let text = serde_json::to_string(&spec).map_err(JsonError::from)?;
    let digest = digest(&text);
    Ok((text, digest))
}

pub fn differing_fields(first: &str, second: &str) -> String {
    let fields = |text: &str| match serde_json::from_str(text) {
        Ok(Value::Object(fields)) => fields,
        _ => Map::new(),
    };
    let (first, second) = (fields(first), fields(second));
    let names: BTreeSet<&String> = first.keys().chain(second.keys()).collect();
    let differing: Vec<String> = names
        .into_iter()
        .filter(|name| first.get(*name) != second.get(*name))
        .map(|name| format!("`{name}`"))
        .collect();
    differing.join(", ")
}

fn digest(text: &str) -> String {
    hex::encode(Sha256::digest(text.as_bytes()))
}
