//! Campaigns that derive from others: jobs are added once all rollouts of the source are settled,
//! and then as the outcomes of the campaign's own jobs arrive.
//!
//! Derived jobs are a pure function of the outcomes, and jobs are only ever added. They are
//! therefore recomputed after jobs settle and at every start, which also repairs interrupted
//! work. A campaign is skipped if its own outcomes and its source's are unchanged since the last
//! pass, so that a pass reads one row for a finished campaign.

use std::collections::{BTreeMap, BTreeSet};
use std::panic::resume_unwind;
use std::sync::Arc;
use std::time::{Duration, Instant};

use adaptive::radii::{Measurement, Ray};
use libero_ctrl::{
    CampaignSpec, Explanation, Level, ManifestRow, Rollouts, Thresholds, UnknownName,
};
use paired::{CampaignLook, Record};
use sqlx::SqliteConnection;

use super::context::Context;
use super::shared::Shared;
use crate::expand::NewJob;
use crate::ids::CampaignId;
use crate::rules::explanation::{self, Addition};
use crate::store::campaigns;
use crate::store::derivations::{self, Derived, SourceEdition};
use crate::store::failpoint::Step;
use crate::store::outcomes::OutcomeRow;
use crate::store::stops::{self, EarlyStop};
use crate::store::{Doing, StoreError, undecodable};

/// Pause between two passes, so that outcomes that arrive together are processed together.
const PAUSE: Duration = Duration::from_millis(100);
/// Pause after a long pass, as a multiple of the pass's duration.
const PAUSE_PER_COST: u32 = 4;
/// Pause after a failed pass; the disk may be full.
const PAUSE_AFTER_FAILURE: Duration = Duration::from_secs(5);

/// Results of earlier passes.
#[derive(Default)]
struct Passes {
    /// Records of completed sources. They are read once, since a source stays the same unless some
    /// of its jobs come back from quarantine.
    sources: BTreeMap<CampaignId, (SourceEdition, Arc<Vec<Record>>)>,
    /// Inputs of each campaign at the last pass, if that pass added no job.
    complete: BTreeMap<CampaignId, Inputs>,
}

/// The inputs that the derived jobs of a campaign depend on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Inputs {
    jobs: i64,
    revision: i64,
    source: SourceEdition,
}

impl Inputs {
    fn of_campaign(campaign: &Derived) -> Self {
        Self { jobs: campaign.jobs, revision: campaign.revision, source: campaign.source_edition }
    }
}

/// Returns the pause after a pass that took `cost`, so that passes over a campaign of any size use
/// at most a fifth of a core.
pub(super) fn pause_after(cost: Duration) -> Duration {
    PAUSE.max(cost * PAUSE_PER_COST)
}

/// Adds derived jobs as outcomes arrive.
pub(crate) async fn run(shared: Arc<Shared>) {
    let mut settled = shared.settled.subscribe();
    let mut passes = Passes::default();
    loop {
        let ended_before_pass = *settled.borrow_and_update();
        let began = Instant::now();
        if let Err(error) = pass(&shared, &mut passes).await {
            tracing::error!("failed to {}", error.with_cause());
            tokio::time::sleep(PAUSE_AFTER_FAILURE).await;
            continue;
        }
        shared.settled.mark_processed(ended_before_pass);
        tokio::time::sleep(pause_after(began.elapsed())).await;
        // Never closes: the sender belongs to the same queue.
        let _ = settled.changed().await;
    }
}

/// Adds to every derived campaign the jobs that follow from the current outcomes.
async fn pass(shared: &Shared, passes: &mut Passes) -> Result<(), StoreError> {
    let mut view = shared.store.read().await?;
    let mut additions = Vec::new();
    let campaigns = derivations::all(&mut view).await?;
    let is_source = |id: &CampaignId| campaigns.iter().any(|campaign| campaign.source == *id);
    passes.sources.retain(|id, _| is_source(id));
    let is_derived = |id: &CampaignId| campaigns.iter().any(|campaign| campaign.campaign == *id);
    passes.complete.retain(|id, _| is_derived(id));
    for campaign in campaigns {
        let inputs = Inputs::of_campaign(&campaign);
        // Transitions and known radii are final only when every rollout of the source that will
        // ever have an outcome has one.
        if campaign.unsettled > 0 || passes.complete.get(&campaign.campaign) == Some(&inputs) {
            continue;
        }
        let source = source_records(&mut view, &campaign, &mut passes.sources).await?;
        let jobs = derived_jobs(&mut view, &campaign, source).await?;
        match jobs.is_empty() {
            true => drop(passes.complete.insert(campaign.campaign, inputs)),
            false => additions.push((campaign, jobs)),
        }
    }
    drop(view);
    for (campaign, jobs) in additions {
        add(shared, &campaign, &jobs).await?;
    }
    Ok(())
}

/// Adds derived jobs to a campaign, unless the campaign was deleted, cancelled or otherwise changed
/// since they were computed; the next pass then computes them for its new state.
async fn add(shared: &Shared, campaign: &Derived, jobs: &[NewJob]) -> Result<(), StoreError> {
    let mut context = Context::begin(shared, vec![Step::Derive]).await?;
    if !derivations::is_unchanged(&mut context.tx, campaign).await? {
        return Ok(());
    }
    let id = campaign.campaign;
    campaigns::append_jobs(&mut context.tx, id, jobs).await?;
    let name = context.campaign(id).await?.name.clone();
    context.cache.clear_campaigns();
    context.commit().await?;
    tracing::info!(campaign = %name, jobs = jobs.len(), "added derived rollouts");
    shared.work.notify_waiters();
    Ok(())
}

/// A derived rollout: its row and its replicate.
type Rollout = (ManifestRow, u32);

/// Computes the jobs that derive from the known outcomes.
async fn derived_jobs(
    tx: &mut SqliteConnection,
    campaign: &Derived,
    source: Arc<Vec<Record>>,
) -> Result<Vec<NewJob>, StoreError> {
    let spec = specification(&campaign.spec)?;
    let own_records = Arc::new(records(tx, campaign.campaign).await?);
    let rollouts = match spec.rollouts {
        Rollouts::Explanation(explanation) => {
            subsets(tx, campaign, [source, own_records], explanation).await?
        }
        Rollouts::Thresholds(thresholds) => {
            radii(tx, campaign, [source, own_records], thresholds).await?
        }
        Rollouts::Design(_)
        | Rollouts::Manifest(_)
        | Rollouts::Variants(_)
        | Rollouts::SuiteFile(_) => Vec::new(),
    };
    let jobs = (campaign.jobs..).zip(rollouts);
    let jobs = jobs.map(|(place, (row, replicate))| {
        NewJob::new(&row.under(&spec.execution), replicate, place)
    });
    let jobs: Result<_, _> = jobs.collect();
    jobs.map_err(undecodable).doing("write a derived rollout's row")
}

pub(super) fn specification(text: &str) -> Result<CampaignSpec, StoreError> {
    let spec = CampaignSpec::from_json(text).map_err(undecodable);
    spec.doing("read a campaign's specification")
}

/// Computes the rollouts under subsets of axes that are to explain the source's transitions.
async fn subsets(
    tx: &mut SqliteConnection,
    campaign: &Derived,
    [source, own_records]: [Arc<Vec<Record>>; 2],
    explanation: Explanation,
) -> Result<Vec<Rollout>, StoreError> {
    let additions =
        on_blocking_thread(move || explanation::additions(&source, &own_records, &explanation))
            .await;
    let ids: BTreeSet<String> =
        additions.iter().map(|rollouts| rollouts.simultaneous.to_string()).collect();
    let ids: Vec<String> = ids.into_iter().collect();
    let rows = derivations::rows(tx, campaign.source, &ids).await?;
    let rows: Result<Vec<ManifestRow>, _> =
        rows.iter().map(|row| serde_json::from_str(row)).collect();
    let rows = rows.map_err(undecodable).doing("read the rollouts to explain")?;
    let rows: BTreeMap<_, _> = rows.iter().map(|row| (row.id, row)).collect();
    let mut rollouts = Vec::new();
    for Addition { simultaneous, axes, replicates } in additions {
        let row = rows.get(&simultaneous).copied();
        let row = row.ok_or(sqlx::Error::RowNotFound).doing("find a rollout to explain")?;
        let row = match axes == row.axes() {
            true => row.clone(),
            false => row.only(axes).map_err(undecodable).doing("restrict a row to some axes")?,
        };
        rollouts.extend(replicates.map(|replicate| (row.clone(), replicate)));
    }
    Ok(rollouts)
}

/// Computes the rollouts at further radii that are to locate thresholds.
async fn radii(
    tx: &mut SqliteConnection,
    campaign: &Derived,
    [source, own_records]: [Arc<Vec<Record>>; 2],
    thresholds: Thresholds,
) -> Result<Vec<Rollout>, StoreError> {
    let spec = campaigns::spec(tx, campaign.source).await?;
    let Rollouts::Design(design) = specification(&spec)?.rollouts else {
        return Ok(Vec::new());
    };
    let rollouts = on_blocking_thread(move || {
        let plan = Measurement::of(&source, &own_records, &thresholds).plan();
        let rollout = |(ray, level): (Ray, Level)| {
            let row = design.row_at(ray.task, ray.condition, level, ray.config);
            // Only replicate 0 decides whether a configuration succeeds at a radius.
            row.map(|row| (row, 0))
        };
        plan.into_iter().map(rollout).collect::<Result<_, _>>()
    });
    let rollouts = rollouts.await.map_err(undecodable);
    rollouts.doing("derive rows at other radii")
}

/// Returns the records of the source of a derived campaign. All rollouts of the source are settled,
/// so the records are cached; they are read again if rollouts have come back from quarantine.
async fn source_records(
    tx: &mut SqliteConnection,
    campaign: &Derived,
    sources: &mut BTreeMap<CampaignId, (SourceEdition, Arc<Vec<Record>>)>,
) -> Result<Arc<Vec<Record>>, StoreError> {
    let edition = campaign.source_edition;
    if let Some((cached, records)) = sources.get(&campaign.source)
        && *cached == edition
    {
        return Ok(records.clone());
    }
    let records = Arc::new(read_source(tx, campaign).await?);
    sources.insert(campaign.source, (edition, records.clone()));
    Ok(records)
}

/// Reads the records of a source; if the source stopped early, only those of the configurations
/// that its results use.
async fn read_source(
    tx: &mut SqliteConnection,
    campaign: &Derived,
) -> Result<Vec<Record>, StoreError> {
    let all = records(tx, campaign.source).await?;
    let counted = match stops::early_stop(tx, campaign.source).await? {
        Some(EarlyStop { stop, used: Some(_), .. }) => CampaignLook::counted_when_met(&all, &stop),
        _ => None,
    };
    Ok(counted.unwrap_or(all))
}

/// Returns the records of a campaign's rollouts.
pub(super) async fn records(
    tx: &mut SqliteConnection,
    campaign: CampaignId,
) -> Result<Vec<Record>, StoreError> {
    let rows = derivations::outcomes(tx, campaign).await?;
    let parse = move || rows.iter().map(OutcomeRow::record).collect();
    let records: Result<_, UnknownName> = on_blocking_thread(parse).await;
    let records = records.map_err(undecodable);
    records.doing("read a campaign's outcomes")
}

/// Runs a computation on a blocking thread, not on one that answers calls: a computation over a
/// whole campaign takes tens of milliseconds or more.
pub(super) async fn on_blocking_thread<T: Send + 'static>(
    computation: impl FnOnce() -> T + Send + 'static,
) -> T {
    match tokio::task::spawn_blocking(computation).await {
        Ok(computed) => computed,
        Err(panicked) => resume_unwind(panicked.into_panic()),
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use rand_chacha::ChaCha8Rng;
    use rand_chacha::rand_core::SeedableRng;
    use serde_json::json;

    use super::*;
    use crate::clock::SystemClock;
    use crate::expand::NewCampaign;
    use crate::ids::CampaignName;
    use crate::queue::Queue;
    use crate::store::Store;
    use crate::timing::Timing;

    fn new_campaign(name: &str, rollouts: &serde_json::Value) -> NewCampaign {
        let mut spec = json!({
            "name": name,
            "policy": {"name": "expert", "endpoint": "http://127.0.0.1:50051"},
        });
        let fields = spec.as_object_mut().expect("an object");
        fields.extend(rollouts.as_object().expect("an object").clone());
        NewCampaign::from_json(&spec.to_string()).expect("a campaign")
    }

    /// Regression: between a pass and the addition of its jobs, a campaign was deleted and created
    /// again under the same number.
    #[tokio::test(flavor = "multi_thread")]
    async fn derived_jobs_of_a_deleted_campaign_are_added_to_no_other() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let store = Store::open(folder.path()).await.expect("a store");
        let (clock, rng) = (Arc::new(SystemClock::start()), ChaCha8Rng::seed_from_u64(1));
        let queue = Queue::start(store, clock, rng, Timing::default()).await;
        let queue = queue.expect("a queue");
        let source = new_campaign(
            "source",
            &json!({"tasks": ["libero_object/0"], "axes": ["camera", "sensor"],
                    "levels": ["L1"], "configs": [0], "nominal": "eval"}),
        );
        queue.create_campaign(&source).await.expect("created");
        let explaining = new_campaign("explaining", &json!({"explains": {"campaign": "source"}}));
        queue.create_campaign(&explaining).await.expect("created");
        let derived = async || {
            let mut view = queue.store().read().await.expect("a view");
            let mut all = derivations::all(&mut view).await.expect("campaigns");
            all.pop().expect("a derived campaign")
        };
        let before = derived().await;
        let name = CampaignName::parse("explaining").expect("a name");
        queue.delete_campaign(&name).await.expect("deleted");
        queue.create_campaign(&explaining).await.expect("created again");
        let after = derived().await;
        assert!(after.campaign > before.campaign, "no campaign number is used twice");

        let added = add(&queue.shared, &before, &source.jobs).await;
        added.expect("no job is added");
        assert_eq!(derived().await.jobs, 0);
        add(&queue.shared, &after, &source.jobs).await.expect("added");
        let jobs = i64::try_from(source.jobs.len()).expect("few");
        assert_eq!(derived().await.jobs, jobs);
        // Adds the same jobs again, as if a concurrent pass had added them first.
        add(&queue.shared, &after, &source.jobs).await.expect("no job is added");
        assert_eq!(derived().await.jobs, jobs);
    }
}
