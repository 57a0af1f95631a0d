//! Charging of failures: to the policy, the machine or the simulator, and to only one of them.

use proto::coordinator::commit_response::Verdict;
use proto::coordinator::release_request::Reason;
use proto::coordinator::release_response::Verdict as Released;
use queue::rules::outage::MAX_MISBEHAVED_IN_A_ROW;
use serde_json::json;

use crate::harness::{Bench, Worker, small_spec, with};

/// Time after which every back-off is over, seconds. A worker without a call for that long is not
/// alive.
const PAST_BACKOFF_SECS: u64 = 61;

async fn create(bench: &Bench, name: &str, policy: &str) {
    let policy = json!({"name": policy, "endpoint": "http://127.0.0.1:50051"});
    let changes = json!({"policy": policy, "configs": [0, 1, 2]});
    let spec = with(small_spec(name), changes);
    assert_eq!(bench.create(&spec).await.expect("created").jobs_total, 12);
}

/// Waits until every back-off is over, while these workers stay alive.
async fn past_backoff<const N: usize>(bench: &Bench, alive: [&mut Worker; N]) {
    bench.advance(PAST_BACKOFF_SECS).await;
    for worker in alive {
        worker.heartbeat(&[], 0).await;
    }
}

async fn report_misbehaviour(worker: &mut Worker, lease: &proto::coordinator::Lease) -> Released {
    let released = worker.release(lease, Reason::PolicyMisbehaved).await;
    assert_eq!(released.stop_leasing, "", "the worker is not stopped");
    released.verdict()
}

#[tokio::test]
async fn invalid_answers_pause_the_policy_and_stop_no_worker() {
    let bench = Bench::start().await;
    create(&bench, "first", "misbehaving").await;
    create(&bench, "second", "sound").await;
    let mut worker = bench.worker("a").await;
    for number in 1..=MAX_MISBEHAVED_IN_A_ROW {
        assert!(bench.status("first").await.policy_outage.is_none(), "{number}");
        let leases = worker.claim(2).await;
        let lease = leases.iter().find(|lease| lease.policy == "misbehaving");
        report_misbehaviour(&mut worker, lease.expect("the older campaign's job")).await;
        for lease in leases.iter().filter(|lease| lease.policy == "sound") {
            assert_eq!(worker.commit(lease, true).await, Verdict::Accepted);
        }
    }
    let status = bench.status("first").await;
    assert!(status.policy_outage.is_some());
    assert_eq!(status.policy_outage.as_deref(), Some("simulated failure"));
    let failing_workers = "SELECT count(*) FROM worker WHERE charged_in_a_row > 0";
    assert_eq!(bench.count(failing_workers).await, 0);
    while let Some(lease) = worker.claim(1).await.pop() {
        if lease.policy == "sound" {
            assert_eq!(worker.commit(&lease, true).await, Verdict::Accepted);
        }
    }
    assert_eq!(bench.status("second").await.rollouts.committed, 12);
}

#[tokio::test]
async fn rollouts_of_a_misbehaving_policy_are_quarantined_with_its_error() {
    let bench = Bench::start().await;
    create(&bench, "first", "misbehaving").await;
    // The worker on the other machine need not try the rollouts: it would get the same answers.
    let (mut worker, mut other) = (bench.worker("a").await, bench.worker("b").await);
    while bench.status("first").await.rollouts.quarantined < 2 {
        past_backoff(&bench, [&mut other]).await;
        let lease = worker.claim_one().await;
        report_misbehaviour(&mut worker, &lease).await;
    }
    let quarantined = "SELECT count(*) FROM job
        WHERE state = 'quarantined' AND last_error = 'simulated failure'";
    assert_eq!(bench.count(quarantined).await, 2);
    // The policy is corrected: its next probe is answered, and its other jobs are leased again.
    bench.advance(PAST_BACKOFF_SECS).await;
    let probe = worker.claim_one().await;
    assert!(worker.claim(1).await.is_empty(), "only one probe is leased");
    assert_eq!(worker.commit(&probe, true).await, Verdict::Accepted);
    let misbehaved = "SELECT max(misbehaved) + max(outages) FROM policy";
    assert_eq!(bench.count(misbehaved).await, 0, "the counts are reset");
    bench.advance(PAST_BACKOFF_SECS).await;
    assert_eq!(worker.claim(64).await.len(), 9);
}

#[tokio::test]
async fn only_failures_charged_to_its_machine_stop_a_worker() {
    for (reason, stops_worker) in [
        (Reason::SimulatorError, false),
        (Reason::PolicyMisbehaved, false),
        (Reason::PolicyUnavailable, false),
        (Reason::MachineError, true),
        (Reason::SlotCrashed, true),
        (Reason::SlotStuck, true),
    ] {
        let bench = Bench::start().await;
        create(&bench, "first", "any").await;
        let mut worker = bench.worker("a").await;
        let mut stop_reason = String::new();
        for _ in 0..5 {
            bench.advance(PAST_BACKOFF_SECS).await;
            let lease = worker.claim_one().await;
            stop_reason = worker.release(&lease, reason).await.stop_leasing;
        }
        assert_eq!(!stop_reason.is_empty(), stops_worker, "{reason:?}: {stop_reason}");
        let misbehaved = bench.count("SELECT max(misbehaved) FROM policy").await;
        assert_eq!(misbehaved > 0, reason == Reason::PolicyMisbehaved);
    }
}

/// Regression: a restarted worker has a new id, so that one machine was counted as
/// several.
#[tokio::test]
async fn restarted_workers_of_one_machine_count_as_one_machine() {
    let bench = Bench::start().await;
    create(&bench, "first", "any").await;
    let mut sound = bench.worker_on_machine("sound", "s").await;
    let mut job = None;
    for start in 0..4 {
        let mut worker = bench.worker_on_machine("broken", &format!("b{start}")).await;
        past_backoff(&bench, [&mut worker, &mut sound]).await;
        let leases = worker.claim(12).await;
        let is_job =
            |lease: &&proto::coordinator::Lease| Some(lease.job_id) == job || job.is_none();
        let lease = leases.iter().find(is_job);
        if start == 3 {
            assert!(lease.is_none(), "the job is left to the other machine");
            continue;
        }
        let lease = lease.expect("the job");
        job = Some(lease.job_id);
        let released = worker.release(lease, Reason::SlotCrashed).await;
        assert_eq!(released.verdict(), Released::Requeued);
        for other in leases.iter().filter(|other| other.job_id != lease.job_id) {
            worker.release(other, Reason::Draining).await;
        }
    }
    past_backoff(&bench, [&mut sound]).await;
    let leases = sound.claim(12).await;
    let lease = leases.iter().find(|lease| Some(lease.job_id) == job);
    let committed = sound.commit(lease.expect("the job"), true).await;
    assert_eq!(committed, Verdict::Accepted);
}

/// Regression: the failure that stopped a worker left one able machine, so that the worker's next
/// failure quarantined a rollout, although only the broken machine had tried it.
#[tokio::test]
async fn a_stopped_workers_last_failures_quarantine_no_rollout() {
    let bench = Bench::start().await;
    create(&bench, "first", "any").await;
    let mut sound = bench.worker_on_machine("sound", "s").await;
    for start in 0..3 {
        let mut worker = bench.worker_on_machine("broken", &format!("b{start}")).await;
        past_backoff(&bench, [&mut worker, &mut sound]).await;
        let leases = worker.claim(3).await;
        assert_eq!(leases.len(), 3);
        let mut released = None;
        for lease in &leases {
            let answer = worker.release(lease, Reason::SlotCrashed).await;
            assert_eq!(answer.verdict(), Released::Requeued, "only one machine has failed");
            released = Some(answer);
        }
        let is_stopped = released.is_some_and(|last| !last.stop_leasing.is_empty());
        assert_eq!(is_stopped, start > 0);
    }
    past_backoff(&bench, [&mut sound]).await;
    assert_eq!(sound.claim(64).await.len(), 12, "the sound machine tries all of them");
}

/// Regression: a claim read the first waiting rollouts of its task, and those that avoided its
/// machine hid all others. Checks a campaign that is leased task by task, and one with a stop rule,
/// which is leased in a random order.
#[tokio::test]
async fn rollouts_that_avoid_a_machine_hide_no_others_from_it() {
    let stop = json!({"rule": "width(I) < 0.001", "seed": 7});
    for changes in [json!({}), json!({ "stop": stop })] {
        let bench = Bench::start().await;
        let spec = with(small_spec("first"), json!({"configs": [0, 1, 2, 3, 4, 5]}));
        let created = bench.create(&with(spec, changes)).await;
        assert_eq!(created.expect("created").jobs_total, 24);
        let mut diverging = bench.worker_on_machine("diverging", "d").await;
        let mut sound = bench.worker_on_machine("sound", "s").await;
        for _ in 0..3 {
            past_backoff(&bench, [&mut diverging, &mut sound]).await;
            for lease in diverging.claim(12).await {
                diverging.release(&lease, Reason::SimulatorError).await;
            }
        }
        past_backoff(&bench, [&mut diverging, &mut sound]).await;
        assert_eq!(diverging.claim(64).await.len(), 12, "the rollouts without a failure");
        let idle = diverging.claim_response("").await.idle_reason;
        assert!(idle.contains("`first` have failed on this machine"), "{idle}");
        assert_eq!(sound.claim(64).await.len(), 12);
    }
}

/// Claims without a job, from a worker that lacks the files of the only task.
async fn claim_without_files(worker: &mut Worker) -> String {
    let mut request = worker.claim_request(0.0, "");
    request.lacking_tasks = vec!["libero_object/0".to_owned()];
    let answer = worker.service.claim(request).await.expect("an answer").into_inner();
    assert_eq!(answer.lease, None);
    answer.idle_reason
}

/// Regression: a rollout was left for ever to a machine that lacked the files of its task.
#[tokio::test]
async fn a_machine_without_the_files_of_a_task_is_not_able_to_run_it() {
    let bench = Bench::start().await;
    create(&bench, "first", "any").await;
    let mut partial = bench.worker_on_machine("partial", "p").await;
    let mut complete = bench.worker_on_machine("complete", "c").await;
    claim_without_files(&mut partial).await;
    for attempt in 1..=3 {
        past_backoff(&bench, [&mut partial, &mut complete]).await;
        let lease = complete.claim_one().await;
        let released = complete.release(&lease, Reason::SlotCrashed).await;
        let expected = if attempt < 3 { Released::Requeued } else { Released::Quarantined };
        assert_eq!(released.verdict(), expected, "{attempt}");
    }
}

/// A coordinator that has just started does not know yet which files workers lack: it leaves the
/// rollout to the other machine until that machine's next claim.
#[tokio::test]
async fn after_a_restart_a_machine_is_able_until_its_claim_says_otherwise() {
    let bench = Bench::start().await;
    create(&bench, "first", "any").await;
    claim_without_files(&mut bench.worker_on_machine("partial", "p").await).await;
    let bench = bench.restart().await;
    let mut partial = bench.worker_on_machine("partial", "p").await;
    let mut complete = bench.worker_on_machine("complete", "c").await;
    let mut job = None;
    for _ in 0..3 {
        past_backoff(&bench, [&mut partial, &mut complete]).await;
        let lease = complete.claim_one().await;
        job = Some(lease.job_id);
        let released = complete.release(&lease, Reason::SimulatorError).await;
        assert_eq!(released.verdict(), Released::Requeued);
    }
    past_backoff(&bench, [&mut partial, &mut complete]).await;
    assert_ne!(Some(complete.claim_one().await.job_id), job, "it is left to the other machine");
    claim_without_files(&mut partial).await;
    let lease = complete.claim_one().await;
    assert_eq!(Some(lease.job_id), job, "no other machine can run it");
    let released = complete.release(&lease, Reason::SimulatorError).await;
    assert_eq!(released.verdict(), Released::Quarantined);
}

/// Regression: the status gave no reason, since workers were compared by what they are pinned to.
#[tokio::test]
async fn a_campaign_whose_files_every_live_worker_lacks_says_so() {
    let bench = Bench::start().await;
    create(&bench, "first", "any").await;
    let mut partial = bench.worker_on_machine("partial", "p").await;
    let files = "assets that this worker lacks, for task libero_object/0";
    let idle = claim_without_files(&mut partial).await;
    assert!(idle.contains(files), "{idle}");
    let reason = bench.status("first").await.waiting_reason.expect("a reason");
    let expected = files.replace("this worker", "every live worker");
    assert_eq!(reason, format!("no worker suits: the campaign needs {expected}"));
    let _complete = bench.worker_on_machine("complete", "c").await;
    assert_eq!(bench.status("first").await.waiting_reason, None);
}

#[tokio::test]
async fn a_restarted_worker_on_a_broken_machine_stops_at_its_first_failure() {
    let bench = Bench::start().await;
    create(&bench, "first", "any").await;
    let fail = async |worker: &mut Worker| {
        past_backoff(&bench, [worker]).await;
        let lease = worker.claim_one().await;
        let released = worker.release(&lease, Reason::MachineError).await;
        !released.stop_leasing.is_empty()
    };
    let mut first = bench.worker_on_machine("broken", "first").await;
    for failures in 1..=5 {
        assert_eq!(fail(&mut first).await, failures == 5);
    }
    let mut second = bench.worker_on_machine("broken", "second").await;
    assert!(fail(&mut second).await);
    // Other machines are not affected, nor is a worker that does not name its machine.
    let mut other = bench.worker_on_machine("sound", "other").await;
    let mut nameless = bench.worker("nameless").await;
    assert!(!fail(&mut other).await && !fail(&mut nameless).await);
    // The machine is repaired.
    let mut third = bench.worker_on_machine("broken", "third").await;
    let lease = third.claim_one().await;
    assert_eq!(third.commit(&lease, true).await, Verdict::Accepted);
    let mut fourth = bench.worker_on_machine("broken", "fourth").await;
    assert!(!fail(&mut fourth).await);
}
