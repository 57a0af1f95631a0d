//! Runs the random events on the queue with its SQLite store.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use benchmark::attempt::{
    AttemptId, Digests, GoalProgress, Measurement, Motion, Pin, Provenance, RolloutResult,
};
use futures_util::future::join_all;
use proptest::prelude::*;
use queue::clock::{ManualClock, UnixMillis};
use queue::expand::NewCampaign;
use queue::ids::{CampaignName, WorkerId};
use queue::invariants::check;
use queue::rules::campaign::Change;
use queue::{
    ClaimRequest, CommitReport, CommitVerdict, Queue, QueueError, Retry, Store, Timing, WorkerInfo,
};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use serde_json::json;

use super::{Event, WORKERS, event};
use crate::harness::{open_database, sha, small_spec, with};

/// Claims and granted leases known to the workers, newest last.
#[derive(Clone, Default)]
struct WorkerState {
    claims: Vec<(ClaimRequest, Option<AttemptId>)>,
    granted: Vec<(WorkerId, AttemptId)>,
}

/// Effect of an event on [`WorkerState`].
enum Effect {
    Claimed(ClaimRequest, Option<AttemptId>),
    Accepted,
    Nothing,
}

proptest! {
    // Each case writes a database, with every commit synced to the disk.
    #![proptest_config(ProptestConfig { cases: 16, ..ProptestConfig::default() })]

    #[test]
    fn every_job_of_the_real_queue_ends_exactly_once(
        events in prop::collection::vec(event(), 20..50)
    ) {
        let runtime = tokio::runtime::Runtime::new().expect("a runtime");
        runtime.block_on(run_on_real_queue(&events));
    }
}

async fn run_on_real_queue(events: &[Event]) {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let clock = Arc::new(ManualClock::at(UnixMillis(1_700_000_000_000)));
    let mut queue = start(folder.path(), &clock).await;
    // The language axis has no realised values, so that the workers' reports of results do not
    // depend on the manifest row.
    let changes = json!({
        "tasks": ["libero_object/0", "libero_object/1"],
        "axes": ["language"],
        "levels": ["L1", "L2"],
    });
    let spec = with(small_spec("random"), changes);
    let campaign = NewCampaign::from_json(&spec.to_string());
    let created = queue.create_campaign(&campaign.expect("a campaign")).await;
    assert!(created.expect("created").jobs_total > 1);
    for worker in 0..WORKERS {
        queue.register(&worker_info(worker)).await.expect("registered");
    }
    let mut state = WorkerState::default();
    let mut accepted = 0;
    for event in events {
        if let Event::Restart = event {
            queue.close().await.expect("closes");
            drop(queue);
            queue = start(folder.path(), &clock).await;
            continue;
        }
        let events = match event {
            Event::Together(events) => events.as_slice(),
            event => std::slice::from_ref(event),
        };
        let numbered = events.iter().zip(state.claims.len()..);
        let effects = numbered.map(|(event, number)| apply(&queue, &clock, &state, event, number));
        for effect in join_all(effects).await {
            match effect {
                Effect::Claimed(claim, attempt) => {
                    let worker = claim.worker.clone();
                    state.granted.extend(attempt.map(|attempt| (worker, attempt)));
                    state.claims.push((claim, attempt));
                }
                Effect::Accepted => accepted += 1,
                Effect::Nothing => {}
            }
        }
        assert_eq!(check(folder.path()).await.expect("a database"), []);
    }
    accepted += finish(&queue, &clock).await;
    check_results(folder.path(), accepted).await;
    queue.close().await.expect("closes");
}

async fn start(folder: &Path, clock: &Arc<ManualClock>) -> Arc<Queue> {
    let store = Store::open(folder).await.expect("a store");
    // No two starts may draw the same attempt ids.
    static STARTS: AtomicU64 = AtomicU64::new(0);
    let rng = ChaCha8Rng::seed_from_u64(STARTS.fetch_add(1, Ordering::Relaxed));
    let queue = Queue::start(store, clock.clone(), rng, Timing::default()).await;
    queue.expect("a queue")
}

fn campaign() -> CampaignName {
    CampaignName::parse("random").expect("a name")
}

/// Executes one event; `number` distinguishes the id of its claim from those of concurrent events.
/// A later claim of the same worker may get the same number; it then repeats the earlier claim.
async fn apply(
    queue: &Queue,
    clock: &ManualClock,
    state: &WorkerState,
    event: &Event,
    number: usize,
) -> Effect {
    let granted = |number: usize| {
        let mut newest_first = state.granted.iter().rev().cycle();
        let skipped = number % state.granted.len().max(1);
        newest_first.nth(skipped).cloned()
    };
    match event {
        Event::Claim { worker, warm, .. } => {
            let request = claim_of(*worker, number, *warm);
            let attempt = claim(queue, &request).await;
            return Effect::Claimed(request, attempt);
        }
        Event::ClaimAgain { claim: number } => {
            let mut newest_first = state.claims.iter().rev().cycle();
            let repeated = newest_first.nth(number % state.claims.len().max(1));
            if let Some((request, first_attempt)) = repeated.cloned() {
                let attempt = claim(queue, &request).await;
                if attempt.is_none() || attempt == first_attempt {
                    return Effect::Nothing;
                }
                return Effect::Claimed(request, attempt);
            }
        }
        Event::Heartbeat { lease, steps } => {
            if let Some((worker, attempt)) = granted(*lease) {
                let beat = queue.heartbeat(&worker, &[(attempt, *steps)]).await;
                beat.expect("an answer");
            }
        }
        Event::Commit { lease, success } => {
            if let Some((_, attempt)) = granted(*lease) {
                let reply = queue.commit(&report(attempt, *success)).await;
                if reply.expect("a verdict").verdict == CommitVerdict::Accepted {
                    return Effect::Accepted;
                }
            }
        }
        Event::Release { lease, reason } => {
            if let Some((_, attempt)) = granted(*lease) {
                let released = queue.release(attempt, *reason, "simulated failure").await;
                released.expect("a verdict");
            }
        }
        Event::Pass { secs } => {
            clock.advance(Duration::from_secs(*secs));
            queue.sweep().await.expect("a sweep");
        }
        Event::Operate { change } => {
            let changed = queue.change_campaign(&campaign(), *change).await;
            let is_allowed = matches!(changed, Ok(_) | Err(QueueError::Cancelled { .. }));
            assert!(is_allowed, "{changed:?}");
        }
        Event::Retry { .. } => {
            let retried = queue.retry_jobs(&campaign(), &Retry::All).await;
            assert!(matches!(retried, Ok(_) | Err(QueueError::Cancelled { .. })));
        }
        Event::Restart | Event::Together(_) => {}
    }
    Effect::Nothing
}

async fn finish(queue: &Queue, clock: &ManualClock) -> usize {
    let mut accepted = 0;
    // A cancelled campaign cannot be resumed.
    let _ = queue.change_campaign(&campaign(), Change::Resume).await;
    for round in 0..60 {
        // A new worker id, since the random workers may have been stopped.
        let worker = 100 + round;
        queue.register(&worker_info(worker)).await.expect("registered");
        for number in 0.. {
            let request = claim_of(worker, number, None);
            let Some(attempt) = claim(queue, &request).await else {
                break;
            };
            let reply = queue.commit(&report(attempt, true)).await.expect("a verdict");
            assert_eq!(reply.verdict, CommitVerdict::Accepted);
            accepted += 1;
        }
        clock.advance(Duration::from_secs(10));
        queue.sweep().await.expect("a sweep");
    }
    accepted
}

/// Asserts that every invariant holds, that every job has ended unless the campaign was cancelled,
/// and that every accepted result is stored.
async fn check_results(folder: &Path, accepted: usize) {
    assert_eq!(check(folder).await.expect("a database"), []);
    let pool = open_database(folder).await;
    let count = async |sql: &'static str| -> i64 {
        sqlx::query_scalar(sql).fetch_one(&pool).await.expect("a count")
    };
    let open = "SELECT count(*) FROM job j JOIN campaign c ON c.id = j.campaign_id
        WHERE j.state IN ('queued', 'leased') AND c.state <> 'cancelled'";
    assert_eq!(count(open).await, 0, "every job ends");
    assert_eq!(count("SELECT count(*) FROM result").await, accepted as i64);
    pool.close().await;
}

fn claim_of(worker: usize, number: usize, warm: Option<usize>) -> ClaimRequest {
    ClaimRequest {
        worker: worker_info(worker).id,
        claim: format!("{worker:016x}{number:016x}"),
        warm_task: warm.map(|task| format!("libero_object/{task}")),
        means: Default::default(),
    }
}

async fn claim(queue: &Queue, request: &ClaimRequest) -> Option<AttemptId> {
    // A stopped worker is refused and then claims nothing.
    let claimed = queue.claim(request, Duration::ZERO).await;
    claimed.ok()?.job.map(|job| job.attempt)
}

fn pin() -> Pin {
    Pin {
        asset_pack: "primitives".to_owned(),
        asset_pack_digest: sha("primitives"),
        mujoco_version: "3.3.7".to_owned(),
        renderer: "llvmpipe".to_owned(),
        look: benchmark::Look::default(),
    }
}

fn worker_info(number: usize) -> WorkerInfo {
    WorkerInfo {
        id: WorkerId(format!("w{number}")),
        host: "bench".to_owned(),
        slots: 1,
        machine: None,
        cores: None,
        pin: pin(),
        program_version: "0.1.0".to_owned(),
    }
}

fn report(attempt: AttemptId, success: bool) -> CommitReport {
    CommitReport {
        attempt,
        motion: Motion::default(),
        measurement: Measurement {
            result: RolloutResult {
                success,
                steps: 9,
                wall_secs: 1.0,
                policy_queries: 1,
                goal: GoalProgress {
                    predicates: 1,
                    at_end: success.into(),
                    at_most: success.into(),
                },
                digests: Digests {
                    scene: sha("scene"),
                    init_state: sha("state"),
                    first_frame: String::new(),
                },
                ..RolloutResult::default()
            },
            provenance: Provenance {
                host: "bench".to_owned(),
                pin: pin(),
                fingerprint: sha("bits"),
                realisation: "matched".to_owned(),
                policy_name: "expert".to_owned(),
                policy_privileged: true,
                program_version: "0.1.0".to_owned(),
                ..Provenance::default()
            },
        },
    }
}
