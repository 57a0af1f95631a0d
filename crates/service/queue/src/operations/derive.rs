//! Campaigns that follow from others: as outcomes come, the jobs that follow from them
//! are added.
//!
//! The jobs that follow are a pure function of the outcomes, and jobs are only ever added. So they
//! are computed anew whenever something was settled and at every start, and whatever was cut off
//! on the way is made up for. A campaign whose outcomes, and whose source's, are those of the last
//! look is left alone: a finished one costs a row.

use std::collections::{BTreeMap, BTreeSet};
use std::panic::resume_unwind;
use std::sync::Arc;
use std::time::{Duration, Instant};

use libero_ctrl::{CampaignSpec, Explanation, ManifestRow, Rollouts, Thresholds};
use paired::{CampaignLook, Outcome, Record};
use sqlx::SqliteConnection;

use super::context::Context;
use super::shared::Shared;
use crate::expand::NewJob;
use crate::ids::CampaignId;
use crate::rules::explanation::{self, Wanted};
use crate::rules::thresholds;
use crate::store::campaigns;
use crate::store::derivations::{self, Derived, OutcomeRow, SourceEdition};
use crate::store::failpoint::Step;
use crate::store::stops::{self, EarlyStop};
use crate::store::{Doing, StoreError, undecodable};

/// Between two looks: outcomes that come together are looked at together.
const PAUSE: Duration = Duration::from_millis(100);
/// A look that took long is followed by a pause of so many times as long.
const PAUSE_PER_COST: u32 = 4;
/// After a look that failed; the disk may be full.
const PAUSE_AFTER_FAILURE: Duration = Duration::from_secs(5);

/// Results of earlier looks.
#[derive(Default)]
struct Known {
    /// The records of the sources that are through: they are read once, since a source stays
    /// as it is unless some of its jobs come back from quarantine.
    sources: BTreeMap<CampaignId, (SourceEdition, Arc<Vec<Record>>)>,
    /// State of each campaign when nothing more followed for it.
    complete: BTreeMap<CampaignId, Looked>,
}

/// All that the jobs that follow for a campaign depend on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Looked {
    jobs: i64,
    revision: i64,
    source: SourceEdition,
}

impl Looked {
    fn at(campaign: &Derived) -> Self {
        Self {
            jobs: campaign.jobs,
            revision: campaign.revision,
            source: campaign.source_edition,
        }
    }
}

/// How long to wait after a look that took so long: looks at a campaign of any size take a
/// fifth of a core at most.
pub(super) fn pause_after(cost: Duration) -> Duration {
    PAUSE.max(cost * PAUSE_PER_COST)
}

/// Adds what follows from outcomes, as they come.
pub(crate) async fn run(shared: Arc<Shared>) {
    let mut settled = shared.settled.subscribe();
    let mut known = Known::default();
    loop {
        let ended = *settled.borrow_and_update();
        let began = Instant::now();
        if let Err(error) = look(&shared, &mut known).await {
            tracing::error!("failed to {}", error.with_cause());
            tokio::time::sleep(PAUSE_AFTER_FAILURE).await;
            continue;
        }
        shared.settled.look_ended(ended);
        tokio::time::sleep(pause_after(began.elapsed())).await;
        // The sender is kept by the same queue.
        let _ = settled.changed().await;
    }
}

/// Adds to every campaign that follows from another what follows from the outcomes that
/// there are.
async fn look(shared: &Shared, known: &mut Known) -> Result<(), StoreError> {
    let mut view = shared.store.read().await?;
    let mut found = Vec::new();
    let campaigns = derivations::all(&mut view).await?;
    let is_source = |id: &CampaignId| campaigns.iter().any(|it| it.source == *id);
    known.sources.retain(|id, _| is_source(id));
    let is_here = |id: &CampaignId| campaigns.iter().any(|it| it.campaign == *id);
    known.complete.retain(|id, _| is_here(id));
    for campaign in campaigns {
        let looked = Looked::at(&campaign);
        // Transitions and known radii are final only when all rollouts of the source that ever
        // will have an outcome have one.
        if campaign.unsettled > 0 || known.complete.get(&campaign.campaign) == Some(&looked) {
            continue;
        }
        let source = source_records(&mut view, &campaign, &mut known.sources).await?;
        let jobs = following(&mut view, &campaign, source).await?;
        match jobs.is_empty() {
            true => drop(known.complete.insert(campaign.campaign, looked)),
            false => found.push((campaign, jobs)),
        }
    }
    drop(view);
    for (campaign, jobs) in found {
        add(shared, &campaign, &jobs).await?;
    }
    Ok(())
}

/// Adds the jobs that follow for a campaign, unless it is no longer as it was when they
/// were found: it may have been deleted or cancelled since. What follows for it as it is
/// now is found by the next look.
async fn add(shared: &Shared, campaign: &Derived, jobs: &[NewJob]) -> Result<(), StoreError> {
    let mut context = Context::begin(shared, vec![Step::Derive]).await?;
    if !derivations::is_as_it_was(&mut context.tx, campaign).await? {
        return Ok(());
    }
    let id = campaign.campaign;
    derivations::append(&mut context.tx, id, jobs).await?;
    let name = context.campaign(id).await?.name.clone();
    context.cache.forget_campaigns();
    context.commit().await?;
    tracing::info!(campaign = %name, jobs = jobs.len(), "further rollouts follow");
    shared.work.notify_waiters();
    Ok(())
}

/// A rollout that follows: its row, and which replicate.
type Rollout = (ManifestRow, u32);

/// The jobs that follow from what is known.
async fn following(
    tx: &mut SqliteConnection,
    campaign: &Derived,
    source: Arc<Vec<Record>>,
) -> Result<Vec<NewJob>, StoreError> {
    let rollouts = match specification(&campaign.spec)?.rollouts {
        Rollouts::Explanation(explanation) => subsets(tx, campaign, source, explanation).await?,
        Rollouts::Thresholds(thresholds) => radii(tx, campaign, source, thresholds).await?,
        Rollouts::Design(_) | Rollouts::Manifest(_) => Vec::new(),
    };
    let jobs = (campaign.jobs..).zip(rollouts);
    let jobs = jobs.map(|(place, (row, replicate))| NewJob::new(&row, replicate, place));
    let jobs: Result<_, _> = jobs.collect();
    jobs.map_err(undecodable).doing("write a rollout's row")
}

pub(super) fn specification(text: &str) -> Result<CampaignSpec, StoreError> {
    let spec = CampaignSpec::from_json(text).map_err(undecodable);
    spec.doing("read the specification of what follows from outcomes")
}

/// The subsets of axes that explain a transition.
async fn subsets(
    tx: &mut SqliteConnection,
    campaign: &Derived,
    source: Arc<Vec<Record>>,
    explanation: Explanation,
) -> Result<Vec<Rollout>, StoreError> {
    let own = records(tx, campaign.campaign).await?;
    let wanted = aside(move || explanation::wanted(&source, &own, &explanation)).await;
    let ids: BTreeSet<String> = wanted
        .iter()
        .map(|it| it.simultaneous.to_string())
        .collect();
    let ids: Vec<String> = ids.into_iter().collect();
    let rows = derivations::rows(tx, campaign.source, &ids).await?;
    let rows: Result<Vec<ManifestRow>, _> =
        rows.iter().map(|row| serde_json::from_str(row)).collect();
    let rows = rows
        .map_err(undecodable)
        .doing("read the rollouts to explain")?;
    let rows: BTreeMap<_, _> = rows.iter().map(|row| (row.id, row)).collect();
    let mut rollouts = Vec::new();
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
        rollouts.extend(replicates.map(|replicate| (row.clone(), replicate)));
    }
    Ok(rollouts)
}

/// The radii at which thresholds are looked for.
async fn radii(
    tx: &mut SqliteConnection,
    campaign: &Derived,
    source: Arc<Vec<Record>>,
    thresholds: Thresholds,
) -> Result<Vec<Rollout>, StoreError> {
    let spec = campaigns::spec(tx, campaign.source).await?;
    let Rollouts::Design(design) = specification(&spec)?.rollouts else {
        return Ok(Vec::new());
    };
    let own = records(tx, campaign.campaign).await?;
    let rows = aside(move || thresholds::wanted(&design, &source, &own, &thresholds)).await;
    let rows = rows
        .map_err(undecodable)
        .doing("perturb at another radius")?;
    Ok(rows.into_iter().map(|row| (row, 0)).collect())
}

/// Returns the records of a campaign's source, all of whose rollouts are settled: from an earlier
/// look, unless some have come back from quarantine since.
async fn source_records(
    tx: &mut SqliteConnection,
    campaign: &Derived,
    sources: &mut BTreeMap<CampaignId, (SourceEdition, Arc<Vec<Record>>)>,
) -> Result<Arc<Vec<Record>>, StoreError> {
    let edition = campaign.source_edition;
    if let Some((of, records)) = sources.get(&campaign.source)
        && *of == edition
    {
        return Ok(records.clone());
    }
    let records = Arc::new(read_source(tx, campaign).await?);
    sources.insert(campaign.source, (edition, records.clone()));
    Ok(records)
}

/// Of a source that stopped early, what its figures are of.
async fn read_source(
    tx: &mut SqliteConnection,
    campaign: &Derived,
) -> Result<Vec<Record>, StoreError> {
    let all = records(tx, campaign.source).await?;
    let counted = match stops::of(tx, campaign.source).await? {
        Some(EarlyStop {
            stop,
            used: Some(_),
            ..
        }) => CampaignLook::counted_when_met(&all, &stop),
        _ => None,
    };
    Ok(counted.unwrap_or(all))
}

/// Returns the records of a campaign's rollouts.
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
    let rows = derivations::outcomes(tx, campaign).await?;
    let read = move || rows.into_iter().map(record).collect();
    let records: Result<_, sqlx::Error> = aside(read).await;
    records.doing("read the outcomes that a campaign follows from")
}

/// Computes beside the threads that answer calls: what is about all of a campaign takes tens
/// of milliseconds and more.
pub(super) async fn aside<T: Send + 'static>(
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

    fn spec(name: &str, rollouts: &serde_json::Value) -> NewCampaign {
        let mut spec = json!({
            "name": name,
            "policy": {"name": "expert", "endpoint": "http://127.0.0.1:50051"},
        });
        let fields = spec.as_object_mut().expect("an object");
        fields.extend(rollouts.as_object().expect("an object").clone());
        NewCampaign::from_json(&spec.to_string()).expect("a campaign")
    }

    /// Finding B9: a look found the jobs of a campaign, which was deleted and created anew
    /// under the same number before they were added.
    #[tokio::test(flavor = "multi_thread")]
    async fn jobs_that_follow_for_a_deleted_campaign_land_in_no_other() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let store = Store::open(folder.path()).await.expect("a store");
        let (clock, rng) = (Arc::new(SystemClock::start()), ChaCha8Rng::seed_from_u64(1));
        let queue = Queue::start(store, clock, rng, Timing::default()).await;
        let queue = queue.expect("a queue");
        let source = spec(
            "source",
            &json!({"tasks": ["libero_object/0"], "axes": ["camera", "sensor"],
                    "levels": ["L1"], "configs": [0], "nominal": "eval"}),
        );
        queue.create_campaign(&source).await.expect("created");
        let why = spec("why", &json!({"explains": {"campaign": "source"}}));
        queue.create_campaign(&why).await.expect("created");
        let derived = async || {
            let mut view = queue.store().read().await.expect("a view");
            let mut all = derivations::all(&mut view).await.expect("campaigns");
            all.pop().expect("one follows")
        };
        let before = derived().await;
        let name = CampaignName::parse("why").expect("a name");
        queue.delete_campaign(&name).await.expect("deleted");
        queue.create_campaign(&why).await.expect("created again");
        let after = derived().await;
        assert!(after.campaign > before.campaign, "no number is given twice");

        let added = add(&queue.shared, &before, &source.jobs).await;
        added.expect("nothing to do");
        assert_eq!(derived().await.jobs, 0);
        add(&queue.shared, &after, &source.jobs)
            .await
            .expect("added");
        let jobs = i64::try_from(source.jobs.len()).expect("few");
        assert_eq!(derived().await.jobs, jobs);
        // The same look once more, as if another had been faster.
        add(&queue.shared, &after, &source.jobs)
            .await
            .expect("nothing to do");
        assert_eq!(derived().await.jobs, jobs);
    }
}
