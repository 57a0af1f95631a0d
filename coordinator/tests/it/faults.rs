//! Crashes, lost leases, late reports, quarantine.

use proto::coordinator::commit_response::Verdict;
use proto::coordinator::release_request::Reason;
use proto::coordinator::release_response::Verdict as Released;
use proto::coordinator::{AlterCampaignRequest, Lease, ReleaseRequest};
use queue::Timing;
use queue::rules::lease::MAX_SILENCES;
use serde_json::{Value, json};
use tonic::Code;

use crate::assertions::{assert_contains, assert_refused};
use crate::harness::{Bench, Worker, small_spec, with};

/// Time after which every back-off is over, seconds.
const PAST_BACKOFF_SECS: u64 = 70;

async fn one_job() -> Bench {
    let bench = Bench::start().await;
    let spec = with(small_spec("one"), json!({"axes": ["camera"], "nominal": "none"}));
    assert_eq!(bench.create(&spec).await.expect("created").jobs_total, 1);
    bench
}

/// Claims the only job with a worker and reports a crash; returns the verdict.
async fn fail_on(bench: &Bench, worker: &mut Worker) -> Released {
    bench.advance(PAST_BACKOFF_SECS).await;
    let lease = worker.claim_one().await;
    worker.release(&lease, Reason::SlotCrashed).await.verdict()
}

#[tokio::test]
async fn late_result_from_an_old_attempt_is_refused() {
    let bench = one_job().await;
    let (mut slow, mut quick) = (bench.worker("slow").await, bench.worker("quick").await);
    let old = slow.claim_one().await;
    bench.advance(40).await;
    let new = quick.claim_one().await;
    assert_eq!((new.job_id, new.attempt), (old.job_id, old.attempt + 1));

    assert_eq!(slow.commit(&old, true).await, Verdict::Stale);
    assert_eq!(bench.count("SELECT count(*) FROM result").await, 0);
    assert_eq!(bench.count("SELECT stale_reports FROM job").await, 1);
    assert_eq!(quick.commit(&new, false).await, Verdict::Accepted);
    assert_eq!(bench.status("one").await.rollouts.succeeded, 0);
}

/// Regression: a network outage longer than a lease charged every lease.
#[tokio::test]
async fn a_disconnected_worker_is_not_charged_and_continues_when_it_returns() {
    let bench = Bench::with(&small_spec("cut")).await;
    let mut worker = bench.worker("a").await;
    let leases = worker.claim(4).await;
    let held: Vec<&Lease> = leases.iter().collect();
    worker.heartbeat(&held, 12).await;
    bench.advance(40).await;
    let status = bench.status("cut").await;
    assert_eq!((status.rollouts.leased, status.rollouts.queued), (0, 4));
    let query = "SELECT count(*) FROM failure WHERE reason = 'worker_silent' AND charged = 0
                AND error LIKE '%sent no heartbeat after control step 12%'";
    assert_eq!(bench.count(query).await, 4);
    // One lease has a result to report; the others continue.
    assert_eq!(worker.commit(&leases[0], true).await, Verdict::Accepted);
    assert_eq!(worker.commit(&leases[0], true).await, Verdict::Duplicate);
    assert_eq!(worker.heartbeat(&held[1..], 20).await, [""; 0]);
    assert_eq!(bench.status("cut").await.rollouts.leased, 3);
    worker.commit_all(&leases[1..], true).await;
    assert_eq!(bench.count("SELECT count(*) FROM failure").await, 0);
    assert_eq!(bench.count("SELECT max(attempt) FROM job").await, 1);
    assert_eq!(bench.count("SELECT max(charged_in_a_row) FROM worker").await, 0);
}

/// Regression: a heartbeat sent before the release resumed the lease.
#[tokio::test]
async fn a_late_heartbeat_does_not_resume_a_released_attempt() {
    let bench = one_job().await;
    let (mut worker, lease) = bench.worker_with_lease("a").await;
    worker.heartbeat(&[&lease], 0).await;
    bench.advance(40).await;
    let released = worker.release(&lease, Reason::Draining).await;
    assert_eq!(released.verdict(), Released::Requeued);
    let lost = worker.heartbeat(&[&lease], 0).await;
    assert_eq!(lost, [lease.attempt_id.as_str()]);
    for _ in 0..6 {
        bench.advance(10).await;
        worker.heartbeat(&[], 0).await;
    }
    let query = "SELECT count(*) FROM failure WHERE reason = 'draining' AND charged = 0";
    assert_eq!(bench.count(query).await, 1);
    assert_eq!(bench.count("SELECT count(*) FROM failure").await, 1);
}

#[tokio::test]
async fn network_outages_quarantine_nothing_and_stop_no_worker() {
    let bench = Bench::with(&small_spec("cut")).await;
    // More outages than would quarantine a rollout or stop a worker if they were charged.
    for _ in 0..6 {
        let mut worker = bench.worker("a").await;
        bench.advance(PAST_BACKOFF_SECS).await;
        assert_eq!(worker.claim(4).await.len(), 4);
        bench.advance(40).await;
    }
    let status = bench.status("cut").await;
    assert_eq!((status.rollouts.queued, status.rollouts.quarantined), (4, 0));
    assert_eq!(bench.count("SELECT count(*) FROM failure WHERE charged").await, 0);
    let stopped = "SELECT count(*) FROM worker WHERE stopped_reason IS NOT NULL";
    assert_eq!(bench.count(stopped).await, 0);
}

#[tokio::test]
async fn a_rollout_that_takes_its_workers_down_is_quarantined_without_a_charge() {
    let bench = one_job().await;
    for number in 0..MAX_SILENCES {
        let mut worker = bench.worker(&format!("w{number}")).await;
        bench.advance(PAST_BACKOFF_SECS).await;
        worker.claim_one().await;
        bench.advance(40).await;
    }
    assert_eq!(bench.status("one").await.rollouts.quarantined, 1);
    let query = "SELECT count(*) FROM failure WHERE reason = 'takes_worker_down' AND charged = 0";
    assert_eq!(bench.count(query).await, 1);
    assert_eq!(bench.count("SELECT charged_attempts FROM job").await, 0);
}

#[tokio::test]
async fn a_returning_worker_is_refused_after_its_attempts_ceiling() {
    let bench = one_job().await;
    let mut slow = bench.worker("slow").await;
    let old = slow.claim_one().await;
    bench.advance(3_600).await;
    assert_eq!(slow.commit(&old, true).await, Verdict::Stale);
    assert_eq!(bench.status("one").await.rollouts.queued, 1);
}

#[tokio::test]
async fn a_returning_worker_is_refused_after_its_endpoint_changed() {
    let bench = one_job().await;
    let (mut worker, lease) = bench.worker_with_lease("a").await;
    bench.advance(40).await;
    let request = AlterCampaignRequest {
        campaign: "one".to_owned(),
        policy_endpoint: Some("http://127.0.0.1:50052".to_owned()),
        ..AlterCampaignRequest::default()
    };
    let altered = bench.operator().await.alter_campaign(request).await;
    altered.expect("altered");
    assert_eq!(worker.commit(&lease, true).await, Verdict::Stale);
    let lost_leases = worker.heartbeat(&[&lease], 30).await;
    assert_eq!(lost_leases, std::slice::from_ref(&lease.attempt_id));
}

#[tokio::test]
async fn another_outcome_of_a_committed_rollout_is_recorded_as_a_divergence() {
    let bench = one_job().await;
    let (mut slow, mut quick) = (bench.worker("slow").await, bench.worker("quick").await);
    let old = slow.claim_one().await;
    bench.advance(40).await;
    let new = quick.claim_one().await;
    assert_eq!(quick.commit(&new, true).await, Verdict::Accepted);
    assert_eq!(quick.commit(&new, true).await, Verdict::Duplicate);
    assert_eq!(bench.count("SELECT count(*) FROM result").await, 1);
    assert_eq!(bench.count("SELECT count(*) FROM divergence").await, 0);
    // The worker has lost its lease, but it ran the rollout, so its result is evidence.
    let (verdict, detail) = slow.commit_request(slow.report(&old, false)).await;
    assert_eq!(verdict, Verdict::Divergent);
    assert_contains(&detail, &["success after 120 steps", "failure after 280 steps"]);
    assert_eq!(slow.commit(&old, false).await, Verdict::Divergent);
    assert_eq!(slow.commit(&old, true).await, Verdict::Duplicate);
    assert_eq!(bench.count("SELECT count(*) FROM divergence").await, 1);
    assert_eq!(bench.status("one").await.rollouts.succeeded, 1, "the first outcome is kept");
}

#[tokio::test]
async fn reports_without_a_lease_are_refused() {
    let bench = one_job().await;
    let (mut holder, mut other) = (bench.worker("holder").await, bench.worker("other").await);
    let lease = holder.claim_one().await;
    let unknown = Lease { attempt_id: "1".repeat(32), ..lease.clone() };
    assert_refused(other.try_commit(&unknown, true).await, Code::NotFound, &[]);
    let release =
        ReleaseRequest { attempt_id: unknown.attempt_id.clone(), ..ReleaseRequest::default() };
    assert_refused(other.service.release(release).await, Code::InvalidArgument, &[]);
    // A worker cannot renew the lease of another worker.
    let lost_leases = other.heartbeat(&[&lease], 5).await;
    assert_eq!(lost_leases, std::slice::from_ref(&lease.attempt_id));
    assert_eq!(holder.commit(&lease, true).await, Verdict::Accepted);
    assert_eq!(bench.count("SELECT count(*) FROM divergence").await, 0);
}

#[tokio::test]
async fn an_attempt_missing_from_heartbeats_expires_and_is_charged() {
    let bench = one_job().await;
    let (mut worker, lease) = bench.worker_with_lease("a").await;
    assert!(worker.heartbeat(&[&lease], 12).await.is_empty());
    bench.advance(20).await;
    worker.heartbeat(&[], 0).await;
    bench.advance(9).await;
    assert_eq!(bench.status("one").await.rollouts.leased, 1);
    bench.advance(2).await;
    let status = bench.status("one").await;
    assert_eq!((status.rollouts.leased, status.rollouts.queued), (0, 1));
    assert_eq!(bench.count("SELECT charged_attempts FROM job").await, 1);
    let query = "SELECT count(*) FROM failure WHERE reason = 'lease_lost' AND charged = 1
                AND error LIKE '%have omitted this attempt since control step 12%'";
    assert_eq!(bench.count(query).await, 1);
    let lost_leases = worker.heartbeat(&[&lease], 30).await;
    assert_eq!(lost_leases, std::slice::from_ref(&lease.attempt_id));
}

/// Regression: a stuck worker that still sent heartbeats kept its job forever.
#[tokio::test]
async fn no_heartbeat_extends_a_lease_past_the_ceiling_of_its_attempt() {
    let bench = one_job().await;
    let (mut worker, lease) = bench.worker_with_lease("a").await;
    let row: Value = serde_json::from_str(&lease.manifest_row).expect("a row");
    let steps = row["max_steps"].as_u64().expect("a number")
        + row["num_steps_wait"].as_u64().expect("a number");
    let per_step = Timing::default().ceiling_per_step.as_secs();
    let (mut held_secs, mut lost_leases) = (0, Vec::new());
    while lost_leases.is_empty() && held_secs <= steps * per_step {
        bench.advance(20).await;
        held_secs += 20;
        lost_leases = worker.heartbeat(&[&lease], 7).await;
    }
    assert_eq!(lost_leases, std::slice::from_ref(&lease.attempt_id));
    assert!(held_secs + 20 > steps * per_step, "after {held_secs} s");
    let failure = "SELECT count(*) FROM failure WHERE reason = 'overdue' AND charged = 1";
    assert_eq!(bench.count(failure).await, 1);
    assert_eq!(worker.commit(&lease, true).await, Verdict::Stale);
}

#[tokio::test]
async fn a_failed_job_is_not_leased_before_its_back_off_is_over() {
    let bench = one_job().await;
    let (mut worker, lease) = bench.worker_with_lease("a").await;
    let released = worker.release(&lease, Reason::SimulatorError).await;
    assert_eq!(released.verdict(), Released::Requeued);
    assert!(released.backoff_secs >= 1.0, "{}", released.backoff_secs);
    assert!(worker.claim(1).await.is_empty());
    bench.advance(2).await;
    assert_eq!(worker.claim_one().await.attempt, 2);
}

#[tokio::test]
async fn a_job_is_quarantined_after_three_charged_attempts_on_two_workers() {
    let bench = one_job().await;
    let (mut a, mut b) = (bench.worker("a").await, bench.worker("b").await);
    assert_eq!(fail_on(&bench, &mut a).await, Released::Requeued);
    assert_eq!(fail_on(&bench, &mut a).await, Released::Requeued);
    b.heartbeat(&[], 0).await;
    assert_eq!(fail_on(&bench, &mut b).await, Released::Quarantined);
    bench.advance(PAST_BACKOFF_SECS).await;
    assert!(a.claim(1).await.is_empty());
    let status = bench.status("one").await;
    assert_eq!((status.rollouts.quarantined, status.rollouts.queued), (1, 0));
    let query = "SELECT count(*) FROM job WHERE last_error = 'simulated failure'";
    assert_eq!(bench.count(query).await, 1);
}

#[tokio::test]
async fn one_broken_machine_quarantines_no_rollout_while_another_is_alive() {
    let bench = one_job().await;
    let (mut broken, mut sound) = (bench.worker("broken").await, bench.worker("sound").await);
    for _ in 0..3 {
        bench.advance(PAST_BACKOFF_SECS).await;
        sound.heartbeat(&[], 0).await;
        let lease = broken.claim_one().await;
        let released = broken.release(&lease, Reason::SlotCrashed).await;
        assert_eq!(released.verdict(), Released::Requeued);
    }
    bench.advance(PAST_BACKOFF_SECS).await;
    sound.heartbeat(&[], 0).await;
    assert!(broken.claim(1).await.is_empty(), "the job is left to the other worker");
    let lease = sound.claim_one().await;
    assert_eq!(sound.commit(&lease, true).await, Verdict::Accepted);
}

#[tokio::test]
async fn draining_is_never_charged() {
    let bench = one_job().await;
    let mut worker = bench.worker("a").await;
    for attempt in 1..=8 {
        let lease = worker.claim_one().await;
        assert_eq!(lease.attempt, attempt);
        let released = worker.release(&lease, Reason::Draining).await;
        assert_eq!(released.verdict(), Released::Requeued);
        assert_eq!(released.stop_leasing, "");
    }
    assert_eq!(bench.count("SELECT charged_attempts FROM job").await, 0);
}

#[tokio::test]
async fn five_consecutive_failures_stop_a_worker() {
    let spec = with(small_spec("many"), json!({"configs": [0, 1, 2]}));
    let bench = Bench::with(&spec).await;
    let mut worker = bench.worker("a").await;
    let leases = worker.claim(10).await;
    for lease in &leases[..4] {
        let released = worker.release(lease, Reason::SlotCrashed).await;
        assert_eq!(released.stop_leasing, "");
    }
    // One success resets the count.
    assert_eq!(worker.commit(&leases[4], true).await, Verdict::Accepted);
    for lease in &leases[5..9] {
        let released = worker.release(lease, Reason::MachineError).await;
        assert_eq!(released.stop_leasing, "");
    }
    let released = worker.release(&leases[9], Reason::MachineError).await;
    assert_contains(&released.stop_leasing, &["5 times in a row", "simulated failure"]);
    assert_refused(worker.try_claim(0.0, "").await, Code::FailedPrecondition, &["in a row"]);
    assert_eq!(bench.status("many").await.live_workers, 0);
}

#[tokio::test]
async fn leases_missing_from_heartbeats_count_as_one_failure_of_their_worker() {
    let spec = with(small_spec("many"), json!({"configs": [0, 1, 2]}));
    let bench = Bench::with(&spec).await;
    let mut worker = bench.worker("a").await;
    assert_eq!(worker.claim(8).await.len(), 8);
    bench.advance(20).await;
    worker.heartbeat(&[], 0).await;
    bench.advance(20).await;
    assert_eq!(bench.count("SELECT charged_in_a_row FROM worker").await, 1);
    bench.advance(60).await;
    assert_eq!(worker.claim(8).await.len(), 8, "the worker still leases");
}

#[tokio::test]
async fn leases_get_their_full_duration_after_a_restart() {
    let bench = one_job().await;
    let lease = bench.worker("a").await.claim_one().await;
    bench.clock.advance(std::time::Duration::from_secs(3_600));
    let bench = bench.restart().await;
    bench.advance(20).await;
    let mut worker = bench.worker("a").await;
    assert!(worker.heartbeat(&[&lease], 40).await.is_empty());
    assert_eq!(worker.commit(&lease, true).await, Verdict::Accepted);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_report_refused_by_the_database_affects_no_other_report() {
    let bench = Bench::with(&small_spec("shared")).await;
    let mut worker = bench.worker("a").await;
    let leases = worker.claim(4).await;
    let pool = bench.database().await;
    let refuse = format!(
        "CREATE TRIGGER refuse BEFORE INSERT ON result WHEN NEW.job_id = {}
         BEGIN SELECT RAISE (ABORT, 'on purpose'); END",
        leases[1].job_id
    );
    let created = sqlx::raw_sql(sqlx::AssertSqlSafe(refuse)).execute(&pool).await;
    created.expect("a trigger");
    // While this transaction is open, the reports wait, and then share the next transaction.
    let mut writing = pool.begin_with("BEGIN IMMEDIATE").await.expect("a transaction");
    let mut reports = tokio::task::JoinSet::new();
    for (number, lease) in leases.iter().enumerate() {
        let mut worker = worker.clone();
        let report = worker.report(lease, true);
        reports.spawn(async move { (number, worker.service.commit(report).await) });
    }
    tokio::time::sleep(std::time::Duration::from_millis(300)).await;
    sqlx::query("UPDATE campaign SET name = name").execute(&mut *writing).await.expect("done");
    writing.commit().await.expect("ended");
    for (number, answer) in reports.join_all().await {
        match (number, answer) {
            (1, answer) => assert_eq!(answer.expect_err("refused").code(), Code::Unavailable),
            (_, answer) => {
                let verdict = answer.expect("an answer").into_inner().verdict();
                assert_eq!(verdict, Verdict::Accepted);
            }
        }
    }
    pool.close().await;
    assert_eq!(bench.status("shared").await.rollouts.committed, 3);
    assert_eq!(bench.status("shared").await.rollouts.leased, 1);
}
