//! Leases of a worker: claiming and acknowledging them.

use std::time::{Duration, Instant};

use crate::scripted_coordinator::ScriptedCoordinator;
use crate::scripted_policy::ScriptedPolicy;
use crate::worker_process::{WorkerProcess, attempt_id, lease};

#[tokio::test(flavor = "multi_thread")]
async fn a_claim_whose_answer_is_lost_is_repeated_with_the_same_id() {
    let coordinator = ScriptedCoordinator::start().await;
    let policy = ScriptedPolicy::start().await;
    coordinator.lose_an_answer_to_a_claim();
    for job in 1..=2 {
        coordinator.lease(lease(job, "still", &policy.url()));
    }
    let _worker = WorkerProcess::start(&coordinator.url());
    for (number, job) in [(1, 1), (2, 2)] {
        let commit = coordinator.message(number).await.commit();
        assert_eq!(commit.attempt_id, attempt_id(job));
    }
    let claims = coordinator.claims().into_iter();
    let ids: Vec<String> = claims.map(|claim| claim.claim_id).collect();
    assert_eq!(ids[0], ids[1], "the repeated claim has the same id");
    assert_ne!(ids[1], ids[2], "the next claim has a new id");
    assert!(ids.iter().all(|id| id.len() == 32), "{ids:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_lease_is_acknowledged_long_before_the_next_heartbeat_is_due() {
    let (heartbeat, progress_timeout) = (Duration::from_secs(50), Duration::from_secs(600));
    let coordinator = ScriptedCoordinator::with_times(heartbeat, progress_timeout).await;
    let policy = ScriptedPolicy::start().await;
    let _worker = WorkerProcess::start(&coordinator.url());
    coordinator.wait_for_claims(1).await;
    // After a second, the heartbeat that follows the registration has been sent.
    tokio::time::sleep(Duration::from_secs(1)).await;
    let leased_at = Instant::now();
    coordinator.lease(lease(1, "silent", &policy.url()));
    coordinator.wait_for_progress(1, 0).await;
    let waited = leased_at.elapsed();
    assert!(waited < Duration::from_secs(5), "{waited:?}");
}
