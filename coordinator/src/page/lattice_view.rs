//! Outcomes of a configuration under every subset of the axes, from the measuring campaign and
//! the campaign that explains it.

use benchmark::{AxisSet, CampaignSpec, Condition, Explanation, Purpose, RolloutId};
use paired::Record;
use paired::adaptive::subsets::{Lattice, configurations, own_configurations};
use queue::read::{Campaign, SubsetRow, View};

use super::campaign::address;
use super::problem::Problem;
use crate::reading::ReadError;

/// Campaign and its rows for one configuration.
pub(super) struct Source {
    pub(super) campaign: Campaign,
    pub(super) rows: Vec<SubsetRow>,
}

/// Outcomes of one configuration, and their campaigns.
pub(super) struct LatticeView {
    /// The configuration, named by its simultaneous rollout.
    pub(super) configuration: RolloutId,
    pub(super) outcomes: Lattice,
    /// Campaign that measured the configuration.
    pub(super) measured: Source,
    /// Campaign that explains the configuration, if there is one.
    pub(super) explaining: Option<Source>,
}

/// Reads the outcomes of a configuration; `None` if they form no lattice, for example because
/// `requested` is a nominal rollout or the campaign has fewer than two axes.
pub(super) async fn read(
    view: &mut View,
    campaign: &Campaign,
    requested: RolloutId,
) -> Result<Option<LatticeView>, Problem> {
    let simultaneous = |number| {
        RolloutId::perturbed(requested.task(), Condition::Simultaneous, requested.level(), number)
            .ok()
    };
    let Some(configuration) = requested.config().and_then(simultaneous) else {
        return Ok(None);
    };
    // A campaign that explains no other one counts as the measuring campaign.
    let (measured, candidates) = match explanation(view, campaign).await? {
        None => (campaign.clone(), view.derived_campaigns(campaign.id).await?),
        Some(_) => match view.source(campaign.id).await? {
            Some(source) => (source, vec![campaign.clone()]),
            None => return Ok(None),
        },
    };
    let measured = source(view, measured, requested).await?;
    // Uses the explaining campaign with the most rollouts of this configuration.
    let mut explaining: Option<(Source, Explanation)> = None;
    for candidate in candidates {
        let Some(explanation) = explanation(view, &candidate).await? else {
            continue;
        };
        let candidate = source(view, candidate, requested).await?;
        let most_rows = explaining.as_ref().map_or(0, |(source, _)| source.rows.len());
        if candidate.rows.len() > most_rows {
            explaining = Some((candidate, explanation));
        }
    }
    let records = records(&measured.rows)?;
    let lattices = match &explaining {
        None => own_configurations(&records),
        Some((source, explanation)) => {
            configurations(&records, &self::records(&source.rows)?, explanation.repeats)
        }
    };
    let explaining = explaining.map(|(source, _)| source);
    let outcomes = lattices.ok().and_then(|mut lattices| lattices.remove(&configuration));
    Ok(outcomes.map(|outcomes| LatticeView { configuration, outcomes, measured, explaining }))
}

/// Reads a campaign's rollouts of a configuration under all subsets of the axes, nominal included.
async fn source(
    view: &mut View,
    campaign: Campaign,
    requested: RolloutId,
) -> Result<Source, Problem> {
    let conditions = AxisSet::ALL.subsets().into_iter().map(Condition::of);
    let id = |condition| {
        RolloutId::perturbed(requested.task(), condition, requested.level(), requested.number())
    };
    let ids = conditions.filter_map(|condition| id(condition).ok());
    let ids: Vec<String> = ids.map(|id| id.to_string()).collect();
    let mut rows = view.subsets(campaign.id, &ids).await?;
    if let Some(first) = rows.first() {
        let nominal = RolloutId::nominal(requested.task(), first.job.init_id).to_string();
        rows.extend(view.subsets(campaign.id, &[nominal]).await?);
    }
    Ok(Source { campaign, rows })
}

async fn explanation(view: &mut View, campaign: &Campaign) -> Result<Option<Explanation>, Problem> {
    let spec = view.spec(campaign).await?;
    let spec = CampaignSpec::from_json(&spec)
        .map_err(|source| ReadError::Spec { campaign: campaign.name.clone(), source })?;
    Ok(match spec.purpose {
        Some(Purpose::Explanation(explanation)) => Some(explanation),
        _ => None,
    })
}

fn records(rows: &[SubsetRow]) -> Result<Vec<Record>, Problem> {
    let records: Result<_, _> = rows.iter().map(|row| row.job.record()).collect();
    Ok(records.map_err(ReadError::Name)?)
}

impl Source {
    /// Returns the rollouts under the subset `set` of the axes `full`.
    pub(super) fn rollouts_under(
        &self,
        set: AxisSet,
        full: AxisSet,
    ) -> impl Iterator<Item = (RolloutId, &SubsetRow)> {
        let rows = self.rows.iter();
        let rows =
            rows.filter_map(|row| Some((row.job.rollout_id.parse::<RolloutId>().ok()?, row)));
        rows.filter(move |(id, _)| id.condition().axes(full) == set)
    }
}

impl LatticeView {
    /// Iterates over the campaigns, the explaining one first.
    pub(super) fn sources(&self) -> impl Iterator<Item = &Source> {
        self.explaining.iter().chain([&self.measured])
    }

    /// Returns true if a rollout exists under several, but not all, axes.
    pub(super) fn has_subsets(&self) -> bool {
        let rows = self.sources().flat_map(|source| &source.rows);
        let mut ids = rows.filter_map(|row| row.job.rollout_id.parse::<RolloutId>().ok());
        ids.any(|id| matches!(id.condition(), Condition::Subset(_)))
    }

    /// Returns the address of the page that shows the rollout under a subset.
    pub(super) fn link(&self, set: AxisSet) -> Option<String> {
        let full = self.outcomes.full();
        self.sources().find_map(|source| {
            let (id, row) = source.rollouts_under(set, full).next()?;
            // A nominal rollout has its card on the pages of its configurations.
            let page = match id.config() {
                Some(_) => id,
                None => self.configuration,
            };
            let address = address(source.campaign.name.as_str(), page, row.job.replicate);
            Some(format!("{address}#{}", id.condition()))
        })
    }
}
