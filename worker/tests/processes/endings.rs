//! Shutdown of a worker.

use std::time::Duration;

use proto::coordinator::release_request::Reason;

use crate::scripted_coordinator::ScriptedCoordinator;
use crate::scripted_policy::ScriptedPolicy;
use crate::worker_process::{WorkerProcess, lease, signal, wait_for_the_end_of};

/// Starts a worker with a rollout of some seconds, and waits until the rollout is under way.
async fn busy_worker() -> (WorkerProcess, ScriptedCoordinator, ScriptedPolicy) {
    busy_worker_with(&[]).await
}

async fn busy_worker_with(
    arguments: &[&str],
) -> (WorkerProcess, ScriptedCoordinator, ScriptedPolicy) {
    let policy = ScriptedPolicy::start().await;
    let coordinator = ScriptedCoordinator::start().await;
    let mut long = lease(1, "slow", &policy.url());
    long.manifest_row = long.manifest_row.replace("\"max_steps\":24", "\"max_steps\":80");
    coordinator.lease(long);
    let worker = WorkerProcess::start_with(&coordinator.url(), arguments);
    coordinator.wait_for_progress(1, 10).await;
    (worker, coordinator, policy)
}

#[tokio::test(flavor = "multi_thread")]
async fn a_drain_finishes_the_running_rollout_and_starts_no_other() {
    let (worker, coordinator, policy) = busy_worker().await;
    coordinator.lease(lease(2, "still", &policy.url()));
    // A service manager often sends a signal to all processes of a service.
    for slot in worker.slots() {
        signal(slot, "TERM");
    }
    worker.signal("TERM");
    let result = coordinator.message(1).await.commit().result;
    assert_eq!(result.steps, 80);
    let log = worker.ended();
    // Log lines name their campaign, since one worker may serve several.
    assert!(log.contains(" test: object/t0/nominal/i03"), "{log}");
    assert_eq!((coordinator.messages().len(), coordinator.claims().len()), (2, 1));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_second_request_to_end_gives_the_rollout_back() {
    let (worker, coordinator, _policy) = busy_worker().await;
    worker.signal("INT");
    tokio::time::sleep(Duration::from_secs(1)).await;
    worker.signal("INT");
    coordinator.message(1).await.release(Reason::Draining);
    worker.ended();
    assert_eq!(coordinator.messages().len(), 2);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_drain_that_takes_too_long_gives_the_rollout_back() {
    let (worker, coordinator, _policy) = busy_worker_with(&["--drain-secs", "0"]).await;
    worker.signal("TERM");
    coordinator.message(1).await.release(Reason::Draining);
    let log = worker.ended();
    assert!(log.contains("not finished within 0 s"), "{log}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_worker_without_work_for_long_enough_ends_and_a_busy_one_does_not() {
    let idle = ["--idle-secs", "1"];
    let (worker, coordinator, _policy) = busy_worker_with(&idle).await;
    let result = coordinator.message(1).await.commit().result;
    assert_eq!(result.steps, 80);
    let log = worker.ended();
    assert!(log.contains("no work for 1 s"), "{log}");
    assert_eq!(coordinator.signed_off().len(), 1, "the worker signed off once");
}

/// Regression: a worker that was shutting down leased once more and gave the job back, which pinned
/// a new campaign to its assets.
#[tokio::test(flavor = "multi_thread")]
async fn a_draining_worker_withdraws_its_claim() {
    let coordinator = ScriptedCoordinator::start().await;
    let worker = WorkerProcess::start(&coordinator.url());
    coordinator.wait_for_claims(1).await;
    worker.signal("TERM");
    coordinator.wait_for_withdrawn_claim().await;
    worker.ended();
    assert_eq!(coordinator.claims().len(), 1);
    assert_eq!(coordinator.messages().len(), 1, "the worker sent only its registration");
}

#[tokio::test(flavor = "multi_thread")]
async fn an_idle_worker_ends_at_once_and_leaves_no_process() {
    let coordinator = ScriptedCoordinator::start().await;
    let worker = WorkerProcess::start(&coordinator.url());
    coordinator.wait_for_claims(1).await;
    let slots = worker.slots();
    assert_eq!(coordinator.signed_off(), [""; 0]);
    worker.terminated();
    slots.into_iter().for_each(wait_for_the_end_of);
    let claimed = &coordinator.claims()[0];
    assert_eq!(coordinator.signed_off(), std::slice::from_ref(&claimed.worker_id));
}

#[tokio::test(flavor = "multi_thread")]
async fn slots_end_with_a_worker_that_is_killed() {
    let (worker, _coordinator, _policy) = busy_worker().await;
    let slots = worker.slots();
    assert_eq!(slots.len(), 1);
    worker.signal("KILL");
    slots.into_iter().for_each(wait_for_the_end_of);
}

/// Rollout ids do not name the campaign, so log lines must name it.
#[tokio::test(flavor = "multi_thread")]
async fn rollouts_of_two_campaigns_have_one_log_line_each() {
    let policy = ScriptedPolicy::start().await;
    let coordinator = ScriptedCoordinator::start().await;
    for (job, campaign) in [(1, "first"), (2, "second")] {
        let mut campaign_lease = lease(job, "still", &policy.url());
        campaign.clone_into(&mut campaign_lease.campaign);
        coordinator.lease(campaign_lease);
    }
    let worker = WorkerProcess::start_with(&coordinator.url(), &["--idle-secs", "1"]);
    for number in [1, 2] {
        coordinator.message(number).await.commit();
    }
    let log = worker.ended();
    for campaign in ["first", "second"] {
        let ended = format!(" {campaign}: object/t0/nominal/i03");
        let lines = log.lines();
        let lines = lines.filter(|line| line.contains(&ended) && line.contains(" steps in "));
        assert_eq!(lines.count(), 1, "{campaign}: {log}");
    }
}
