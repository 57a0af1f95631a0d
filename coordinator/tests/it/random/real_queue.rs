//! The same events on the queue with its SQLite store.

use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use coordinator::campaign::Change;
use coordinator::clock::{ManualClock, UnixMillis};
use coordinator::digests::AxisDigests;
use coordinator::expand::NewCampaign;
use coordinator::ids::{CampaignName, LeaseRef, WorkerId};
use coordinator::invariants::check;
use coordinator::queue::{
    ClaimRequest, CommitReport, CommitVerdict, Queue, QueueError, Retry, Timing,
};
use coordinator::store::Store;
use coordinator::store::motions::Motion;
use coordinator::store::results::{Digests, Outcome, Provenance};
use coordinator::store::workers::WorkerInfo;
use proptest::prelude::*;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use serde_json::json;

use super::{Event, WORKERS, event};
use crate::harness::{open_database, sha, small_spec, with};

proptest! {
    // Each case writes a database, with every commit synced to the disk.
    #![proptest_config(ProptestConfig { cases: 16, ..ProptestConfig::default() })]

    #[test]
    fn every_job_of_the_real_queue_ends_exactly_once(
        events in prop::collection::vec(event(), 20..50)
    ) {
        let runtime = tokio::runtime::Runtime::new().expect("a runtime");
        runtime.block_on(on_the_real_queue(&events));
    }
}

async fn on_the_real_queue(events: &[Event]) {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let clock = Arc::new(ManualClock::at(UnixMillis(1_700_000_000_000)));
    let mut queue = start(folder.path(), &clock).await;
    // Four rollouts that realise no perturbation, so that reports need no row.
    let words = json!({"axes": ["language"], "levels": ["L1", "L2", "L3"]});
    let spec = with(small_spec("random"), words);
    let campaign = NewCampaign::from_json(&spec.to_string());
    let created = queue.create_campaign(&campaign.expect("a campaign")).await;
    assert!(created.expect("created").jobs_total > 1);
    for worker in 0..WORKERS {
        queue
            .register(&worker_info(worker))
            .await
            .expect("registered");
    }
    let mut granted: Vec<LeaseRef> = Vec::new();
    let mut accepted = 0;
    for event in events {
        if let Event::Restart = event {
            queue.close().await.expect("closes");
            drop(queue);
            queue = start(folder.path(), &clock).await;
            continue;
        }
        accepted += happen(&queue, &clock, &mut granted, event).await;
        assert_eq!(check(folder.path()).await.expect("a database"), []);
    }
    accepted += finish(&queue, &clock).await;
    check_books(folder.path(), accepted).await;
    queue.close().await.expect("closes");
}

async fn start(folder: &Path, clock: &Arc<ManualClock>) -> Arc<Queue> {
    let store = Store::open(folder).await.expect("a store");
    let rng = ChaCha8Rng::seed_from_u64(5);
    let queue = Queue::start(store, clock.clone(), rng, Timing::default()).await;
    queue.expect("a queue")
}

fn campaign() -> CampaignName {
    CampaignName::parse("random").expect("a name")
}

/// Lets one event happen; returns how many results were accepted in it.
async fn happen(
    queue: &Queue,
    clock: &ManualClock,
    granted: &mut Vec<LeaseRef>,
    event: &Event,
) -> usize {
    let newest_first = granted.iter().rev().cycle();
    let lease = |number: usize| {
        newest_first
            .clone()
            .nth(number % granted.len().max(1))
            .cloned()
    };
    match event {
        Event::Claim { worker, .. } => granted.extend(claim(queue, *worker).await),
        Event::Heartbeat {
            lease: number,
            steps,
        } => {
            if let Some(lease) = lease(*number) {
                let beat = queue
                    .heartbeat(&lease.worker, &[(lease.clone(), *steps)])
                    .await;
                beat.expect("an answer");
            }
        }
        Event::Commit {
            lease: number,
            success,
        } => {
            if let Some(lease) = lease(*number) {
                let reply = queue
                    .commit(&report(lease, *success))
                    .await
                    .expect("a verdict");
                return usize::from(reply.verdict == CommitVerdict::Accepted);
            }
        }
        Event::Release {
            lease: number,
            reason,
        } => {
            if let Some(lease) = lease(*number) {
                queue
                    .release(&lease, *reason, "it happened")
                    .await
                    .expect("a verdict");
            }
        }
        Event::Pass { secs } => {
            clock.advance(Duration::from_secs(*secs));
            queue.sweep().await.expect("a sweep");
        }
        Event::Operate { change } => {
            let changed = queue.change_campaign(&campaign(), *change).await;
            assert!(matches!(changed, Ok(_) | Err(QueueError::Cancelled { .. })));
        }
        Event::Retry { .. } => {
            let retried = queue.retry_jobs(&campaign(), &Retry::All).await;
            assert!(matches!(retried, Ok(_) | Err(QueueError::Cancelled { .. })));
        }
        Event::Restart => {}
    }
    0
}

async fn finish(queue: &Queue, clock: &ManualClock) -> usize {
    let mut accepted = 0;
    // A cancelled campaign stays as it is.
    let _ = queue.change_campaign(&campaign(), Change::Resume).await;
    for round in 0..60 {
        // A fresh name: the random workers may have been told to stop.
        let worker = 100 + round;
        queue
            .register(&worker_info(worker))
            .await
            .expect("registered");
        while let Some(lease) = claim(queue, worker).await {
            let reply = queue.commit(&report(lease, true)).await.expect("a verdict");
            assert_eq!(reply.verdict, CommitVerdict::Accepted);
            accepted += 1;
        }
        clock.advance(Duration::from_secs(10));
        queue.sweep().await.expect("a sweep");
    }
    accepted
}

/// Every job ended, unless the campaign was cancelled, and every accepted
/// result is there; the invariants say the rest.
async fn check_books(folder: &Path, accepted: usize) {
    assert_eq!(check(folder).await.expect("a database"), []);
    let pool = open_database(folder).await;
    let count = async |sql: &'static str| -> i64 {
        sqlx::query_scalar(sql)
            .fetch_one(&pool)
            .await
            .expect("a count")
    };
    let open = "SELECT count(*) FROM job j JOIN campaign c ON c.id = j.campaign_id
        WHERE j.state IN ('queued', 'leased') AND c.state <> 'cancelled'";
    assert_eq!(count(open).await, 0, "every job ends");
    assert_eq!(count("SELECT count(*) FROM result").await, accepted as i64);
    pool.close().await;
}

async fn claim(queue: &Queue, worker: usize) -> Option<LeaseRef> {
    let request = ClaimRequest {
        worker: worker_info(worker).id,
        max_jobs: 1,
        warm_task: None,
    };
    // A worker that was told to stop is refused; it then claims nothing.
    let claimed = queue
        .claim(&request, Duration::ZERO)
        .await
        .unwrap_or_default();
    let job = claimed.jobs.into_iter().next()?;
    Some(LeaseRef {
        worker: request.worker,
        job: job.job,
        attempt: job.attempt,
    })
}

fn worker_info(number: usize) -> WorkerInfo {
    WorkerInfo {
        id: WorkerId(format!("w{number}")),
        host: "bench".to_owned(),
        slots: 1,
        asset_pack: "primitives".to_owned(),
        asset_pack_digest: sha("primitives"),
        mujoco_version: "3.3.7".to_owned(),
        renderer: "llvmpipe".to_owned(),
        program_version: "0.1.0".to_owned(),
    }
}

fn report(lease: LeaseRef, success: bool) -> CommitReport {
    CommitReport {
        motion: Motion::default(),
        lease,
        outcome: Outcome {
            success,
            steps: 9,
            wall_secs: 1.0,
            ik_residual_mm: None,
            ik_residual_deg: None,
            ik_clamped_joints: None,
            clipped_actions: 0,
            policy_queries: 1,
        },
        provenance: Provenance {
            host: "bench".to_owned(),
            renderer: "llvmpipe".to_owned(),
            fingerprint: sha("bits"),
            mujoco_version: "3.3.7".to_owned(),
            asset_pack: "primitives".to_owned(),
            asset_pack_digest: sha("primitives"),
            realisation: "matched".to_owned(),
            policy_name: "expert".to_owned(),
            policy_checkpoint: String::new(),
            policy_checkpoint_digest: String::new(),
            policy_privileged: true,
            policy_canonical_only: false,
            batch_mode: String::new(),
            program_version: "0.1.0".to_owned(),
        },
        digests: Digests {
            scene: sha("scene"),
            init_state: sha("state"),
            perturbation: AxisDigests::default(),
            first_frame: String::new(),
        },
    }
}
