//! Videos, which are made and sent after the results of their rollouts.

use std::time::Duration;

use benchmark::ManifestRow;
use proto::coordinator::Lease;
use proto::coordinator::commit_response::Verdict;
use proto::coordinator::release_request::Reason;

use crate::scripted_coordinator::{ScriptedCoordinator, WorkerMessage};
use crate::scripted_policy::ScriptedPolicy;
use crate::worker_process::{WorkerProcess, attempt_id, lease, signal};

/// Returns the lease of a filmed rollout of at most 160 control steps.
fn filmed(job: i64, policy: &str) -> Lease {
    let mut lease = lease(job, "still", policy);
    lease.manifest_row = lease.manifest_row.replace("\"max_steps\":24", "\"max_steps\":160");
    lease.record_video = true;
    lease
}

#[tokio::test(flavor = "multi_thread")]
async fn a_video_of_a_failure_arrives_after_its_result() {
    let coordinator = ScriptedCoordinator::start().await;
    let policy = ScriptedPolicy::start().await;
    let mut filmed = lease(1, "still", &policy.url());
    filmed.record_video = true;
    filmed.record_failures_only = true;
    coordinator.lease(filmed);
    let _worker = WorkerProcess::start(&coordinator.url());
    let result = coordinator.message(1).await.commit().result;
    assert!(!result.success);
    let WorkerMessage::Video { attempt, bytes } = coordinator.message(2).await else {
        panic!("{:?}", coordinator.messages());
    };
    assert_eq!((attempt, &bytes[4..8]), (attempt_id(1), &b"ftyp"[..]));
}

#[tokio::test(flavor = "multi_thread")]
async fn heartbeats_report_filming_and_never_count_it_as_steps() {
    let coordinator = ScriptedCoordinator::start().await;
    let policy = ScriptedPolicy::start().await;
    let filmed = filmed(1, &policy.url());
    let row: ManifestRow = serde_json::from_str(&filmed.manifest_row).expect("a row");
    coordinator.lease(filmed);
    let _worker = WorkerProcess::start(&coordinator.url());
    coordinator.message(1).await.commit();
    coordinator.wait_for_filming(1).await;
    coordinator.message(2).await;
    coordinator.wait_for_filming(0).await;
    let heartbeats = coordinator.heartbeats();
    let steps = heartbeats.iter().flat_map(|heartbeat| &heartbeat.progress);
    let most = steps.map(|progress| progress.control_steps).max();
    assert!((1..=row.settle_steps + row.max_steps).contains(&most.expect("progress")));
    assert!(heartbeats.iter().all(|heartbeat| heartbeat.filming <= 1));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_coordinator_that_cannot_store_videos_gets_every_result() {
    let coordinator = ScriptedCoordinator::start().await;
    let policy = ScriptedPolicy::start().await;
    coordinator.refuse_artifacts();
    for job in 1..=2 {
        let mut filmed = lease(job, "still", &policy.url());
        filmed.record_video = true;
        coordinator.lease(filmed);
    }
    let worker = WorkerProcess::start(&coordinator.url());
    for (number, job) in [(1, 1), (2, 2)] {
        let commit = coordinator.message(number).await.commit();
        assert_eq!(commit.attempt_id, attempt_id(job));
    }
    // On average, four refusals are two tries for each video; the worker makes up to seven.
    coordinator.wait_for_refused_artifacts(4).await;
    coordinator.wait_for_claims(3).await;
    let log = worker.terminated();
    assert!(!log.contains("cannot be reached"), "{log}");
    assert_eq!(coordinator.messages().len(), 3);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_video_of_a_refused_result_is_not_sent() {
    let coordinator = ScriptedCoordinator::start().await;
    let policy = ScriptedPolicy::start().await;
    coordinator.answer_commits(Verdict::Stale);
    coordinator.lease(filmed(1, &policy.url()));
    coordinator.lease(lease(2, "still", &policy.url()));
    let worker = WorkerProcess::start(&coordinator.url());
    coordinator.message(1).await.commit();
    let commit = coordinator.message(2).await.commit();
    assert_eq!(commit.attempt_id, attempt_id(2));
    let log = worker.terminated();
    assert!(log.contains("finish the video: it was abandoned"), "{log}");
    assert_eq!(coordinator.messages().len(), 3);
}

/// To the parent process, the kill looks like a crash of the encoder at the worst moment.
#[tokio::test(flavor = "multi_thread")]
async fn a_slot_that_dies_before_its_result_is_committed_is_not_charged() {
    let mut coordinator = ScriptedCoordinator::start().await;
    let policy = ScriptedPolicy::start().await;
    let mut slow = filmed(1, &policy.url());
    slow.policy = "slow".to_owned();
    slow.manifest_row = slow.manifest_row.replace("\"max_steps\":160", "\"max_steps\":24");
    coordinator.lease(slow);
    let worker = WorkerProcess::start(&coordinator.url());
    coordinator.wait_for_progress(1, 10).await;
    coordinator.stop();
    // The rollout and its video end during the outage.
    tokio::time::sleep(Duration::from_secs(3)).await;
    for slot in worker.slots() {
        signal(slot, "KILL");
    }
    coordinator.restart().await;
    let commit = coordinator.message(1).await.commit();
    assert_eq!(commit.attempt_id, attempt_id(1));
    let messages = coordinator.messages();
    let is_crash = |message: &WorkerMessage| match message {
        WorkerMessage::Released(release) => release.reason() == Reason::SlotCrashed,
        _ => false,
    };
    assert!(!messages.iter().any(is_crash), "{messages:?}");
}
