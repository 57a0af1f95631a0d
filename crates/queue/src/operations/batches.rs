//! Insertion and deletion of large campaigns in batches: the writer serves workers between batches,
//! and an incomplete campaign is hidden. A campaign that was being inserted or deleted when the
//! coordinator stopped is deleted at the next start; an interrupted creation must be requested
//! again.

use std::sync::Arc;

use super::context::Context;
use super::shared::Shared;
use crate::expand::NewCampaign;
use crate::ids::{CampaignId, PolicyId};
use crate::store::failpoint::Step;
use crate::store::{StoreError, campaigns, hidden, policies, stops};

/// Most jobs that one transaction adds or removes, so that it takes some tens of milliseconds.
pub(super) const JOBS_PER_BATCH: usize = 500;

/// Inserts a campaign of any size with an unused name, whose files go into `folder`.
pub(super) async fn insert(
    shared: &Shared,
    new: &NewCampaign,
    folder: &str,
) -> Result<(), StoreError> {
    let mut context = Context::begin(shared, vec![Step::CreateCampaign]).await?;
    let now = context.now;
    let id = campaigns::insert_without_jobs(&mut context.tx, new, folder, now).await?;
    hidden::hide_new(&mut context.tx, id).await?;
    context.commit().await?;
    let inserted = insert_jobs(shared, new, id, folder).await;
    if inserted.is_err() {
        // The incomplete campaign is hidden; if its removal fails, the next start removes it.
        let removed = match policy_of(shared, id).await {
            Ok(policy) => remove(shared, id, policy).await,
            Err(error) => Err(error),
        };
        if let Err(error) = removed {
            tracing::warn!("failed to {}; the next start tries again", error.with_cause());
        }
    }
    inserted
}

async fn insert_jobs(
    shared: &Shared,
    new: &NewCampaign,
    id: CampaignId,
    folder: &str,
) -> Result<(), StoreError> {
    for batch in new.jobs.chunks(JOBS_PER_BATCH) {
        let mut context = Context::begin(shared, vec![Step::CreateCampaign]).await?;
        campaigns::append_jobs(&mut context.tx, id, batch).await?;
        context.commit().await?;
    }
    let mut context = Context::begin(shared, vec![Step::CreateCampaign]).await?;
    let now = context.now;
    campaigns::take_name(&mut context.tx, &new.name).await?;
    hidden::publish(&mut context.tx, id, (&new.name, folder), now).await?;
    if let Some(configurations) = new.stoppable_configurations {
        stops::insert(&mut context.tx, id, configurations).await?;
    }
    context.cache.clear_campaigns();
    context.commit().await
}

async fn policy_of(shared: &Shared, id: CampaignId) -> Result<PolicyId, StoreError> {
    let mut view = shared.store.read().await?;
    Ok(campaigns::by_id(&mut view, id).await?.policy_id)
}

/// Deletes a campaign that is already hidden.
pub(super) async fn remove(
    shared: &Shared,
    id: CampaignId,
    policy: PolicyId,
) -> Result<(), StoreError> {
    loop {
        let mut context = Context::begin(shared, vec![Step::DeleteCampaign]).await?;
        let deleted = hidden::delete_jobs(&mut context.tx, id, JOBS_PER_BATCH).await?;
        if deleted == JOBS_PER_BATCH as u64 {
            context.commit().await?;
            continue;
        }
        campaigns::delete(&mut context.tx, id).await?;
        policies::remove_unused(&mut context.tx, policy).await?;
        context.cache.clear();
        return context.commit().await;
    }
}

/// Returns the campaigns that were being inserted or deleted when the coordinator last stopped,
/// with their policies.
pub(crate) async fn interrupted(
    shared: &Shared,
) -> Result<Vec<(CampaignId, PolicyId)>, StoreError> {
    let mut view = shared.store.read().await?;
    hidden::all(&mut view).await
}

/// Deletes incomplete campaigns of the previous run. Then never returns, because a background task
/// of the queue that ends counts as one that panicked.
pub(crate) async fn run(shared: Arc<Shared>, interrupted: Vec<(CampaignId, PolicyId)>) {
    for (id, policy) in interrupted {
        match remove(&shared, id, policy).await {
            Ok(()) => tracing::info!("deleted a campaign left incomplete by the previous run"),
            Err(error) => {
                tracing::error!("failed to {}; the next start tries again", error.with_cause());
            }
        }
    }
    std::future::pending().await
}

#[cfg(test)]
pub(super) mod tests {
    use std::collections::BTreeSet;
    use std::path::Path;
    use std::time::Duration;

    use rand_chacha::ChaCha8Rng;
    use rand_chacha::rand_core::SeedableRng;
    use serde_json::json;

    use super::*;
    use crate::clock::SystemClock;
    use crate::ids::CampaignName;
    use crate::invariants;
    use crate::queue::Queue;
    use crate::store::Store;
    use crate::timing::Timing;

    pub(in crate::operations) async fn start(folder: &Path) -> Arc<Queue> {
        let store = Store::open(folder).await.expect("a store");
        let (clock, rng) = (Arc::new(SystemClock::start()), ChaCha8Rng::seed_from_u64(1));
        let queue = Queue::start(store, clock, rng, Timing::default()).await;
        queue.expect("a queue")
    }

    /// Returns a campaign of more than two batches.
    fn large_campaign(replicates: u32) -> NewCampaign {
        let spec = json!({
            "name": "large",
            "policy": {"name": "expert", "endpoint": "http://127.0.0.1:50051"},
            "tasks": ["object"], "axes": ["camera", "sensor"], "levels": ["L1", "L2", "L3"],
            "configs": (0..10).collect::<Vec<_>>(), "replicates": replicates, "record": "transitions",
        });
        NewCampaign::from_json(&spec.to_string()).expect("a campaign")
    }

    async fn assert_invariants(folder: &Path) {
        let violations = invariants::check(folder).await;
        assert_eq!(violations.expect("a database"), []);
    }

    async fn count(queue: &Queue, sql: &'static str) -> i64 {
        let mut view = queue.store().read().await.expect("a view");
        sqlx::query_scalar(sql).fetch_one(&mut *view).await.expect("a count")
    }

    #[tokio::test]
    async fn a_full_disk_is_named_with_its_remedy_and_keeps_no_part_of_a_campaign() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let queue = start(folder.path()).await;
        for (pages, created) in [("1", false), ("1000000", true)] {
            let mut context = Context::begin(&queue.shared, vec![]).await.expect("begun");
            let limit = format!("PRAGMA max_page_count = {pages}");
            let limit = sqlx::raw_sql(sqlx::AssertSqlSafe(limit)).execute(&mut *context.tx);
            limit.await.expect("a limit");
            drop(context);
            let result = queue.create_campaign(&large_campaign(3)).await;
            assert_eq!(result.is_ok(), created, "{result:?}");
            if let Err(error) = result {
                assert!(error.to_string().contains("is full; make room there"), "{error}");
                assert_eq!(count(&queue, "SELECT count(*) FROM campaign").await, 0);
            }
        }
    }

    /// Regression: creating or deleting a campaign was one transaction of the only writer, which
    /// made every worker wait.
    #[tokio::test(flavor = "multi_thread")]
    async fn a_large_campaign_is_inserted_and_deleted_in_hidden_batches() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let new = large_campaign(3);
        let jobs = i64::try_from(new.jobs.len()).expect("few");
        assert!(new.jobs.len() > 2 * JOBS_PER_BATCH);
        let mut queue = start(folder.path()).await;
        let created = queue.create_campaign(&new).await.expect("created");
        assert_eq!(created.jobs_added, new.jobs.len() as u64);
        assert_invariants(folder.path()).await;
        assert_eq!(count(&queue, "SELECT count(*) FROM job").await, jobs);
        let again = queue.create_campaign(&new).await.expect("created again");
        assert_eq!(again.jobs_added, 0);
        let name = CampaignName::parse("large").expect("a name");
        // Workers are served while it is extended.
        let larger = large_campaign(20);
        let more = larger.jobs.len() as i64;
        let mut seen = BTreeSet::new();
        let mut extension = Box::pin(queue.extend_campaign(&name, larger));
        let extended = loop {
            tokio::select! {
                extended = &mut extension => break extended,
                count = count(&queue, "SELECT count(*) FROM job") => seen.insert(count),
            };
        };
        drop(extension);
        assert_eq!(extended.expect("extended").jobs_total, more.unsigned_abs());
        assert!(seen.range(jobs + 1..more).count() > 0, "{seen:?} of {more}");
        assert_invariants(folder.path()).await;
        let mut view = queue.view().await.expect("a view");
        let campaign = view.campaign(&name).await.expect("the campaign");
        assert_eq!((campaign.folder.as_str(), campaign.record.as_str()), ("large", "transitions"));
        assert!(campaign.state.may_lease());
        drop(view);
        let counts = queue.delete_campaign(&name).await.expect("deleted");
        assert_eq!(counts.total(), more.unsigned_abs());
        assert_eq!(count(&queue, "SELECT count(*) FROM campaign").await, 0);

        // The coordinator stops in the middle of an insertion, and in the middle of a deletion.
        for is_deletion in [false, true] {
            let shared = &queue.shared;
            if is_deletion {
                queue.create_campaign(&new).await.expect("created");
                let mut context = Context::begin(shared, vec![]).await.expect("begun");
                let campaign = context.campaign_named(&name).await.expect("the campaign");
                hidden::hide_deleted(&mut context.tx, campaign.id).await.expect("hidden");
                let deleted =
                    hidden::delete_jobs(&mut context.tx, campaign.id, JOBS_PER_BATCH).await;
                assert_eq!(deleted.expect("deleted"), JOBS_PER_BATCH as u64);
                context.commit().await.expect("stored");
            } else {
                let mut context = Context::begin(shared, vec![]).await.expect("begun");
                let (now, tx) = (context.now, &mut context.tx);
                let id = campaigns::insert_without_jobs(tx, &new, "large", now).await;
                let id = id.expect("stored");
                hidden::hide_new(tx, id).await.expect("hidden");
                let batch = &new.jobs[..JOBS_PER_BATCH];
                campaigns::append_jobs(tx, id, batch).await.expect("stored");
                context.commit().await.expect("stored");
            }
            let part = count(&queue, "SELECT count(*) FROM job").await;
            assert!(part > 0 && part < jobs, "{part}");
            assert_invariants(folder.path()).await;
            let mut view = queue.view().await.expect("a view");
            assert!(view.statuses().await.expect("statuses").is_empty());
            let policies = view.policies().await.expect("policies");
            assert!(policies.iter().all(|policy| policy.campaigns.is_empty()));
            drop(view);
            queue.close().await.expect("closed");

            let restarted = start(folder.path()).await;
            let mut remaining = part;
            for _ in 0..1_000 {
                remaining = count(&restarted, "SELECT count(*) FROM campaign").await;
                if remaining == 0 {
                    break;
                }
                tokio::time::sleep(Duration::from_millis(10)).await;
            }
            assert_eq!(remaining, 0, "no campaign remains");
            queue = restarted;
        }
        queue.close().await.expect("closed");
    }
}
