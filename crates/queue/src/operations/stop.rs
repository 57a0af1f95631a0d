//! Campaigns that may stop early: the stop rule is evaluated as outcomes arrive.
//!
//! The stopping point is a pure function of the outcomes. It can therefore be evaluated again as
//! jobs settle and at every start, which also repairs interrupted evaluations.
//!
//! When a campaign stops, its leases are revoked. Their results could not change an interval:
//! intervals use only the configurations up to the look at which the rule was met, in which no
//! rollout is leased.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::{Duration, Instant};

use benchmark::{RolloutId, TaskRef};
use paired::{CampaignLook, Records};
use sqlx::SqliteConnection;

use super::context::Context;
use super::records::{on_blocking_thread, records};
use super::shared::Shared;
use crate::ids::CampaignId;
use crate::store::failpoint::Step;
use crate::store::stops::{self, Stoppable};
use crate::store::{Doing, StoreError, undecodable};

/// Pause between two evaluations, so that outcomes that arrive together are evaluated together.
const PAUSE: Duration = Duration::from_millis(100);
/// Pause after a long evaluation, as a multiple of its duration: evaluations of a campaign of any
/// size use at most a fifth of a core.
const PAUSE_PER_COST: u32 = 4;
/// Pause after a failed evaluation; the disk may be full.
const PAUSE_AFTER_FAILURE: Duration = Duration::from_secs(5);

/// First incomplete configuration of each campaign at the last evaluation. While it is unchanged,
/// new outcomes cannot change the result of the stop rule.
type Fronts = BTreeMap<CampaignId, Front>;

/// A configuration or a nominal rollout: the task, true for a configuration, and the number of the
/// configuration or of the initial state.
type Front = (TaskRef, bool, u16);

/// Stops campaigns whose rule is met, as outcomes arrive.
pub(crate) async fn run(shared: Arc<Shared>) {
    let mut settled = shared.settled.subscribe();
    let mut fronts = Fronts::new();
    loop {
        settled.mark_unchanged();
        let began = Instant::now();
        if let Err(error) = evaluate_rules(&shared, &mut fronts).await {
            tracing::error!("failed to {}", error.with_cause());
            fronts.clear();
            tokio::time::sleep(PAUSE_AFTER_FAILURE).await;
            continue;
        }
        tokio::time::sleep(PAUSE.max(began.elapsed() * PAUSE_PER_COST)).await;
        // Never closes: the sender belongs to the same queue.
        let _ = settled.changed().await;
    }
}

async fn evaluate_rules(shared: &Shared, fronts: &mut Fronts) -> Result<(), StoreError> {
    let mut view = shared.store.read().await?;
    let mut met = Vec::new();
    let stoppable = stops::stoppable(&mut view).await?;
    fronts.retain(|id, _| stoppable.iter().any(|campaign| campaign.campaign == *id));
    for campaign in stoppable {
        let first = stops::first_unsettled(&mut view, campaign.campaign).await?;
        // A complete campaign has no rollouts left to save.
        let Some(first) = first else { continue };
        let order = first.unit_order;
        let first: RolloutId = first
            .rollout_id
            .parse()
            .map_err(undecodable)
            .doing("parse the id of the first unsettled rollout")?;
        let front = (first.task(), first.config().is_some(), first.number());
        if fronts.insert(campaign.campaign, front) == Some(front) {
            continue;
        }
        if let Some(look) = when_met(&mut view, &campaign).await? {
            met.push((campaign.campaign, order, look));
        }
    }
    drop(view);
    for (campaign, order, look) in met {
        if !stop(shared, campaign, order, &look).await? {
            fronts.remove(&campaign);
        }
    }
    Ok(())
}

/// Stops a campaign whose rule is met at `look`, unless the campaign was cancelled after the
/// evaluation, or one of the rollouts before `order`, which the evaluation used, was taken out of
/// quarantine. Returns true if this call stopped the campaign.
///
/// The rule is not evaluated again here: for 150,000 outcomes that takes most of a minute, during
/// which the transaction would block every claim and result.
async fn stop(
    shared: &Shared,
    campaign: CampaignId,
    order: i64,
    look: &CampaignLook,
) -> Result<bool, StoreError> {
    let mut context = Context::begin(shared, vec![Step::Stop]).await?;
    let stoppable = stops::stoppable(&mut context.tx).await?;
    let first = stops::first_unsettled(&mut context.tx, campaign).await?;
    let is_valid = stoppable.iter().any(|stoppable| stoppable.campaign == campaign)
        && first.is_none_or(|first| first.unit_order >= order);
    if !is_valid {
        return Ok(false);
    }
    let name = context.campaign(campaign).await?.name.clone();
    stops::stop(&mut context.tx, campaign, look.used.len(), context.now).await?;
    let explanation = "the campaign has stopped early: its rule is met";
    context.revoke_leases(campaign, explanation).await?;
    context.cache.clear_campaigns();
    context.commit().await?;
    let (used, total) = (look.used.len(), look.units);
    tracing::info!(campaign = %name, "stopped early after {used} of {total} configurations");
    shared.work.notify_waiters();
    Ok(true)
}

/// Returns the look at which a campaign's stop rule is first met, if it is met.
async fn when_met(
    tx: &mut SqliteConnection,
    campaign: &Stoppable,
) -> Result<Option<CampaignLook>, StoreError> {
    let stop = campaign.stop.clone();
    let records = records(tx, campaign.campaign).await?;
    let found = on_blocking_thread(move || {
        Records::new(&records).map(|records| CampaignLook::when_met(&records, &stop))
    });
    let found = found.await.map_err(undecodable);
    found.doing("read the outcomes for a stop rule")
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::super::batches::tests::start;
    use super::*;
    use crate::expand::NewCampaign;

    /// Regression: evaluating the rule inside the transaction blocked every claim for 40 s. The
    /// rule is evaluated before the transaction, which must therefore detect that an evaluation is
    /// out of date.
    #[tokio::test(flavor = "multi_thread")]
    async fn an_evaluation_is_outdated_once_an_earlier_rollout_waits_again() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let queue = start(folder.path()).await;
        let spec = json!({
            "name": "early",
            "policy": {"name": "expert", "endpoint": "http://127.0.0.1:50051"},
            "tasks": ["object/0"], "axes": ["camera", "sensor"], "levels": ["L2"],
            "configs": [0, 1, 2, 3], "stop": {"rule": "width(S_sim) < 0.1", "seed": 7},
        });
        let new = NewCampaign::from_json(&spec.to_string()).expect("a campaign");
        queue.create_campaign(&new).await.expect("created");
        let mut view = queue.shared.store.read().await.expect("a view");
        let stoppable = stops::stoppable(&mut view).await.expect("a list");
        let campaign = stoppable[0].campaign;
        let first = stops::first_unsettled(&mut view, campaign).await;
        let first = first.expect("read").expect("every rollout waits");
        drop(view);
        let look = CampaignLook {
            used: vec![("object/0".parse().expect("a task"), 0)],
            units: 4,
            levels: BTreeMap::new(),
        };
        let shared = &queue.shared;
        let outdated = stop(shared, campaign, first.unit_order + 1, &look).await;
        assert!(!outdated.expect("evaluated"), "an earlier rollout waits");
        let current = stop(shared, campaign, first.unit_order, &look).await;
        assert!(current.expect("stopped"));
        let repeated = stop(shared, campaign, first.unit_order, &look).await;
        assert!(!repeated.expect("evaluated"), "the campaign has already stopped");
    }
}
