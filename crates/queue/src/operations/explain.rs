//! Campaigns that explain others: as outcomes come, the jobs that follow from them
//! are added.
//!
//! What follows is a pure function of the outcomes, and jobs are only ever added.
//! So it is looked at again whenever something was settled and at every start, and
//! whatever was cut off on the way is made up for.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use paired::{Outcome, Record};
use protocol::{CampaignSpec, Explanation, ManifestRow, Rollouts};
use sqlx::SqliteConnection;

use super::context::Context;
use super::shared::Shared;
use crate::expand::NewJob;
use crate::ids::CampaignId;
use crate::rules::explanation::{self, Wanted};
use crate::store::explanations::{self, Explaining, OutcomeRow};
use crate::store::failpoint::Step;
use crate::store::{Doing, StoreError, undecodable};

/// Between two looks: outcomes that come together are looked at together.
const PAUSE: Duration = Duration::from_millis(100);
/// After a look that failed; the disk may be full.
const PAUSE_AFTER_FAILURE: Duration = Duration::from_secs(5);

/// Adds what follows from outcomes, as they come.
pub(crate) async fn run(shared: std::sync::Arc<Shared>) {
    loop {
        let pause = match look(&shared).await {
            Ok(()) => PAUSE,
            Err(error) => {
                tracing::error!("failed to {error}: {}", error.source);
                // What it was about to look at is still to be looked at.
                shared.outcomes.notify_one();
                PAUSE_AFTER_FAILURE
            }
        };
        tokio::time::sleep(pause).await;
        shared.outcomes.notified().await;
    }
}

/// Adds to every campaign that explains another what follows from the outcomes that
/// there are.
async fn look(shared: &Shared) -> Result<(), StoreError> {
    let mut view = shared.store.read().await?;
    let mut found = Vec::new();
    for campaign in explanations::explaining(&mut view).await? {
        // Which configurations have a transition is known when all have an outcome.
        if campaign.unsettled == 0 {
            let jobs = following(&mut view, &campaign).await?;
            found.extend((!jobs.is_empty()).then_some((campaign.campaign, jobs)));
        }
    }
    drop(view);
    for (campaign, jobs) in found {
        let mut context = Context::begin(shared, vec![Step::Explain]).await?;
        explanations::append(&mut context.tx, campaign, &jobs).await?;
        let name = context.campaign(campaign).await?.name.clone();
        context.cache.forget_campaigns();
        context.commit().await?;
        tracing::info!(campaign = %name, jobs = jobs.len(), "further rollouts follow");
        shared.work.notify_waiters();
    }
    Ok(())
}

/// The jobs that follow from what is known.
async fn following(
    tx: &mut SqliteConnection,
    campaign: &Explaining,
) -> Result<Vec<NewJob>, StoreError> {
    let Some(explanation) = to_explain(&campaign.spec)? else {
        return Ok(Vec::new());
    };
    let explained = records(tx, campaign.explained).await?;
    let own = records(tx, campaign.campaign).await?;
    let wanted = explanation::wanted(&explained, &own, &explanation);
    let ids: BTreeSet<String> = wanted
        .iter()
        .map(|it| it.simultaneous.to_string())
        .collect();
    let ids: Vec<String> = ids.into_iter().collect();
    let rows = explanations::rows(tx, campaign.explained, &ids).await?;
    let rows: Result<Vec<ManifestRow>, _> =
        rows.iter().map(|row| serde_json::from_str(row)).collect();
    let rows = rows
        .map_err(undecodable)
        .doing("read the rollouts to explain")?;
    let rows: BTreeMap<_, _> = rows.iter().map(|row| (row.id, row)).collect();
    let mut jobs = Vec::new();
    for Wanted {
        simultaneous,
        axes,
        replicates,
    } in wanted
    {
        let row = rows.get(&simultaneous).copied();
        let row = row
            .ok_or(sqlx::Error::RowNotFound)
            .doing("find a rollout to explain")?;
        let row = match axes == row.axes() {
            true => row.clone(),
            false => row
                .only(axes)
                .map_err(undecodable)
                .doing("perturb some axes only")?,
        };
        for replicate in replicates {
            let place = campaign.jobs + jobs.len() as i64;
            let job = NewJob::new(&row, replicate, place);
            jobs.push(job.map_err(undecodable).doing("write a rollout's row")?);
        }
    }
    Ok(jobs)
}

/// What a campaign of this specification is to explain.
pub(super) fn to_explain(spec: &str) -> Result<Option<Explanation>, StoreError> {
    let spec = CampaignSpec::from_json(spec).map_err(undecodable);
    let spec = spec.doing("read what is to be explained")?;
    Ok(match spec.rollouts {
        Rollouts::Explanation(explanation) => Some(explanation),
        Rollouts::Design(_) | Rollouts::Manifest(_) => None,
    })
}

/// What is known of a campaign's rollouts.
pub(super) async fn records(
    tx: &mut SqliteConnection,
    campaign: CampaignId,
) -> Result<Vec<Record>, StoreError> {
    let record = |row: OutcomeRow| {
        Ok(Record {
            id: row.rollout_id.parse().map_err(undecodable)?,
            init_id: row.init_id,
            replicate: row.replicate,
            outcome: match (row.success, row.is_quarantined) {
                (Some(success), _) => Outcome::from(success),
                (None, true) => Outcome::Quarantined,
                (None, false) => Outcome::Missing,
            },
        })
    };
    let rows = explanations::outcomes(tx, campaign).await?;
    let records: Result<_, sqlx::Error> = rows.into_iter().map(record).collect();
    records.doing("read the outcomes that an explanation follows from")
}
