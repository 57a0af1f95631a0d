//! Rollouts without an outcome, and the party at fault.

use std::time::Duration;

use proto::coordinator::release_request::Reason;

use crate::scripted_coordinator::{ScriptedCoordinator, WorkerMessage};
use crate::scripted_policy::ScriptedPolicy;
use crate::worker_process::{WorkerProcess, attempt_id, lease, signal, wait_for_the_end_of};

/// Runs one rollout per policy and asserts that each is released for `reason`, with the expected
/// words.
async fn check(
    coordinator: ScriptedCoordinator,
    endpoint: &str,
    reason: Reason,
    expected: &[(&str, &str)],
) {
    for (job, (policy, _)) in (1..).zip(expected) {
        coordinator.lease(lease(job, policy, endpoint));
    }
    let _worker = WorkerProcess::start(&coordinator.url());
    for (number, (policy, words)) in (1..).zip(expected) {
        let release = coordinator.message(number).await.release(reason);
        let error = release.error;
        assert!(error.contains(words), "{policy}: {error}");
        assert!(error.contains(&format!("`{policy}`")), "{policy}: {error}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn answers_that_no_robot_can_execute_are_the_policys_fault() {
    let policy = ScriptedPolicy::start().await;
    let coordinator = ScriptedCoordinator::start().await;
    check(
        coordinator,
        &policy.url(),
        Reason::PolicyMisbehaved,
        &[
            (
                "nan",
                "gave an invalid answer to query 1: component 2 of action 1 is NaN; \
                 `policy-gateway check`",
            ),
            ("narrow", "its actions are 6 numbers wide, not 7"),
            ("ragged", "it answered 13 numbers, which is not a multiple of 7"),
            ("empty", "it answered no action"),
            ("generous", "it answered 9 actions, but its description declares at most 8"),
            ("broken", "failed at query 0: CUDA error: device-side assert triggered"),
            ("refusing", "failed at Reset: this instruction is not one of 40"),
        ],
    )
    .await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_unavailable_policy_charges_no_rollout() {
    let policy = ScriptedPolicy::start().await;
    // An answer may take at most half of the progress timeout.
    let coordinator = ScriptedCoordinator::with_progress_timeout(Duration::from_secs(8)).await;
    check(
        coordinator,
        &policy.url(),
        Reason::PolicyUnavailable,
        &[
            ("silent", "no answer within 4 s"),
            ("overloaded", "the queue is full"),
            ("unknown", "no such policy here"),
            ("of-another-version", "it uses policy protocol version 2"),
            ("hungry", "9 executed actions per query, but a horizon of 8"),
            ("foreign", "camera `front` beside agentview and robot0_eye_in_hand"),
        ],
    )
    .await;
}

/// Regression: a policy that died at Reset was never reported as lost, so that a rollout whose
/// Reset kills the policy was tried for ever.
#[tokio::test(flavor = "multi_thread")]
async fn an_attempt_loses_its_policy_at_whatever_call_follows_the_description() {
    let policy = ScriptedPolicy::start().await;
    let coordinator = ScriptedCoordinator::start().await;
    let expected = [
        ("dying-at-reset", Some(0)),
        ("dying-at-query", Some(2)),
        ("dying-at-reset", Some(0)),
        ("unknown", None),
        ("overloaded", None),
    ];
    for (job, (name, _)) in (1..).zip(expected) {
        coordinator.lease(lease(job, name, &policy.url()));
    }
    let _worker = WorkerProcess::start(&coordinator.url());
    for (number, (name, answered)) in (1..).zip(expected) {
        let release = coordinator.message(number).await.release(Reason::PolicyUnavailable);
        assert_eq!(release.answered_queries, answered, "{name}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn an_endpoint_where_nobody_listens_is_named() {
    let coordinator = ScriptedCoordinator::start().await;
    let nobody = "http://127.0.0.1:9";
    check(coordinator, nobody, Reason::PolicyUnavailable, &[("any", nobody)]).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_slot_that_dies_costs_its_rollout_and_is_replaced() {
    let policy = ScriptedPolicy::start().await;
    let coordinator = ScriptedCoordinator::start().await;
    coordinator.lease(lease(1, "slow", &policy.url()));
    let worker = WorkerProcess::start(&coordinator.url());
    coordinator.wait_for_progress(1, 10).await;
    for slot in worker.slots() {
        signal(slot, "KILL");
    }
    let release = coordinator.message(1).await.release(Reason::SlotCrashed);
    assert!(release.error.contains("killed by SIGKILL"), "{}", release.error);
    coordinator.lease(lease(2, "still", &policy.url()));
    let commit = coordinator.message(2).await.commit();
    assert_eq!(commit.attempt_id, attempt_id(2));
    // The dead slot's session would count against the policy's capacity; a slot ends its own.
    let received = policy.received.lock().expect("unpoisoned");
    let opened: Vec<_> = received.resets.iter().map(|reset| &reset.session).collect();
    assert_eq!(received.ended.iter().collect::<Vec<_>>(), opened);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_slot_without_progress_is_killed_and_replaced() {
    let policy = ScriptedPolicy::start().await;
    let coordinator = ScriptedCoordinator::with_progress_timeout(Duration::from_secs(8)).await;
    coordinator.lease(lease(1, "slow", &policy.url()));
    let worker = WorkerProcess::start(&coordinator.url());
    coordinator.wait_for_progress(1, 10).await;
    let slots = worker.slots();
    for &slot in &slots {
        signal(slot, "STOP");
    }
    let release = coordinator.message(1).await.release(Reason::SlotStuck);
    assert!(
        release.error.contains("made no progress on ") && release.error.contains(" for 8 s"),
        "{}",
        release.error
    );
    for slot in slots {
        wait_for_the_end_of(slot);
    }
    coordinator.wait_for_claims(2).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_lost_lease_abandons_the_rollout_without_a_report() {
    let policy = ScriptedPolicy::start().await;
    let coordinator = ScriptedCoordinator::start().await;
    coordinator.lease(lease(1, "slow", &policy.url()));
    let worker = WorkerProcess::start(&coordinator.url());
    coordinator.wait_for_progress(1, 10).await;
    let slots = worker.slots();
    coordinator.lose_lease(1);
    coordinator.lease(lease(2, "still", &policy.url()));
    let commit = coordinator.message(1).await.commit();
    assert_eq!(commit.attempt_id, attempt_id(2));
    assert_eq!(worker.slots(), slots, "the slot's process is not replaced");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_worker_stopped_by_the_coordinator_fails_with_the_reason() {
    let coordinator = ScriptedCoordinator::start().await;
    coordinator.stop_leasing("it has failed 5 times in a row");
    coordinator.lease(lease(1, "any", "http://127.0.0.1:9"));
    let worker = WorkerProcess::start(&coordinator.url());
    let (status, log) = worker.wait();
    assert_eq!(status.code(), Some(1));
    assert!(log.contains("it has failed 5 times in a row"), "{log}");
    assert!(matches!(coordinator.messages()[..], [_, WorkerMessage::Released(_)]));
}
