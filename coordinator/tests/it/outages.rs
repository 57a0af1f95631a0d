//! An unavailable policy pauses only its own jobs, and they resume automatically.

use std::collections::BTreeSet;

use proto::coordinator::change_campaign_request::Change;
use proto::coordinator::commit_response::Verdict;
use proto::coordinator::release_request::Reason;
use proto::coordinator::{JobName, Lease, ReleaseResponse, RetryJobsRequest, SkipJobsRequest};
use queue::clock::Clock;
use queue::ids::CampaignName;
use serde_json::json;

use crate::harness::{Bench, Worker, assert_sound, rollout_id, small_spec, value, with};
use crate::page::http;

/// Time after which the first back-off of an outage, 1 s, is over.
const PAST_FIRST_SECS: u64 = 2;

fn spec_of(name: &str, policy: &str) -> serde_json::Value {
    let policy = json!({"name": policy, "endpoint": "http://127.0.0.1:50051"});
    with(small_spec(name), json!({"policy": policy, "configs": [0, 1]}))
}

async fn two_campaigns() -> Bench {
    let bench = Bench::start().await;
    bench.create_with_priority(&spec_of("first", "fragile"), 1).await.expect("created");
    bench.create(&spec_of("second", "sound")).await.expect("created");
    bench
}

/// Like [`two_campaigns`], after a worker has reported that the first policy is unavailable.
async fn outage() -> (Bench, Worker, ReleaseResponse) {
    let bench = two_campaigns().await;
    let (mut worker, lease) = bench.worker_with_lease("a").await;
    let released = worker.release(&lease, Reason::PolicyUnavailable).await;
    (bench, worker, released)
}

#[tokio::test]
async fn an_outage_pauses_the_jobs_of_its_policy_only() {
    let bench = two_campaigns().await;
    let mut worker = bench.worker("a").await;
    let leases = worker.claim(3).await;
    for lease in &leases {
        assert_eq!(lease.policy, "fragile");
        let released = worker.release(lease, Reason::PolicyUnavailable).await;
        assert!(released.backoff_secs >= 1.0, "{}", released.backoff_secs);
        assert_eq!(released.stop_leasing, "");
    }
    let status = bench.status("first").await;
    assert!(status.policy_outage.is_some());
    assert_eq!(status.policy_outage.as_deref(), Some("simulated failure"));
    assert_eq!(bench.count("SELECT outages FROM policy WHERE name = 'fragile'").await, 1);
    assert_eq!(bench.count("SELECT max(charged_attempts) FROM job").await, 0);

    let sound_leases = worker.claim(64).await;
    assert_eq!(sound_leases.len(), 8);
    assert!(sound_leases.iter().all(|lease| lease.policy == "sound"));
    let idle = worker.claim_response("").await.idle_reason;
    assert!(idle.contains("`fragile`") && idle.contains("simulated failure"), "{idle}");
}

/// Regression: an operator could not report that the policy is available again.
#[tokio::test]
async fn resuming_a_campaign_retries_its_policy_at_once() {
    let (bench, mut worker, _) = outage().await;
    let status = bench.status("first").await;
    assert!(status.policy_retry_secs > Some(0.0), "{status:?}");
    let sound_leases = worker.claim(64).await;
    assert!(sound_leases.iter().all(|lease| lease.policy == "sound"));
    let resumed = bench.change("first", Change::Resume).await;
    resumed.expect("resumed");
    assert_eq!(bench.status("first").await.policy_retry_secs, Some(0.0));
    assert_eq!(worker.claim_one().await.policy, "fragile");
    let status = bench.status("first").await;
    assert_eq!(status.policy_retry_secs, None, "a probe holds a lease");
}

#[tokio::test]
async fn a_paused_policy_gets_one_probe_whose_first_answer_resumes_its_other_jobs() {
    let (bench, mut worker, _) = outage().await;
    bench.advance(PAST_FIRST_SECS).await;
    let leases = worker.claim(4).await;
    let fragile: Vec<_> = leases.iter().filter(|lease| lease.policy == "fragile").collect();
    assert_eq!(fragile.len(), 1, "only one probe is leased");
    let probe = fragile[0].clone();
    assert!(worker.claim(64).await.iter().all(|lease| lease.policy == "sound"));

    // The ten settling steps need no policy; the eleventh step does.
    worker.heartbeat(&[&probe], 10).await;
    assert!(bench.status("first").await.policy_outage.is_some());
    worker.heartbeat(&[&probe], 11).await;
    assert!(bench.status("first").await.policy_outage.is_none());
    let resumed = worker.claim(64).await;
    assert_eq!(resumed.len(), 7);
    assert_eq!(worker.commit(&probe, true).await, Verdict::Accepted);
    assert_eq!(bench.count("SELECT max(outages) FROM policy").await, 0);
}

#[tokio::test]
async fn a_failed_probe_doubles_the_pause_and_a_crashed_probe_is_replaced() {
    let (bench, mut worker, released) = outage().await;
    bench.advance(PAST_FIRST_SECS).await;
    let mut probe = worker.claim(1).await.remove(0);
    assert_eq!(probe.policy, "fragile");
    for _ in 0..5 {
        worker.release(&probe, Reason::PolicyUnavailable).await;
        bench.advance(70).await;
        probe = worker.claim(1).await.remove(0);
    }
    let last = worker.release(&probe, Reason::PolicyUnavailable).await;
    assert!(last.backoff_secs > 4.0 * released.backoff_secs, "{}", last.backoff_secs);
    let now_ms = bench.clock.now().0;
    let paused = "SELECT max(resume_ms) FROM policy WHERE name = 'fragile'";
    let paused_secs = (bench.count(paused).await - now_ms) as f64 / 1e3;
    assert!((30.0..=60.0).contains(&paused_secs), "{paused_secs}");
    // The job waits 10 s longer than the policy's pause, so that another rollout probes the policy.
    let extra_secs = last.backoff_secs - paused_secs;
    assert!((9.9..=10.1).contains(&extra_secs), "{extra_secs}");

    bench.advance(70).await;
    let probe = worker.claim(1).await.remove(0);
    assert_eq!(probe.policy, "fragile");
    worker.release(&probe, Reason::SlotCrashed).await;
    let next = worker.claim(1).await.remove(0);
    assert_eq!(next.policy, "fragile", "a crash is no evidence about the policy");
    assert_ne!(next.job_id, probe.job_id);
}

#[tokio::test]
async fn leases_from_before_the_recovery_report_no_new_outage() {
    let bench = two_campaigns().await;
    let mut worker = bench.worker("a").await;
    let leases = worker.claim(2).await;
    worker.release(&leases[0], Reason::PolicyUnavailable).await;
    bench.advance(PAST_FIRST_SECS).await;
    let probe = worker.claim(1).await.remove(0);
    worker.heartbeat(&[&probe, &leases[1]], 11).await;
    assert!(bench.status("first").await.policy_outage.is_none());
    worker.release(&leases[1], Reason::PolicyUnavailable).await;
    assert!(
        bench.status("first").await.policy_outage.is_none(),
        "the lease is older than the recovery"
    );
}

#[tokio::test]
async fn a_policy_pause_survives_a_restart_and_ends_automatically() {
    let (bench, _, _) = outage().await;
    let bench = bench.restart().await;
    assert!(bench.status("first").await.policy_outage.is_some());
    let mut worker = bench.worker("a").await;
    bench.advance(PAST_FIRST_SECS).await;
    let probe = worker.claim(1).await.remove(0);
    assert_eq!(probe.policy, "fragile");
    assert_eq!(worker.commit(&probe, true).await, Verdict::Accepted);
    assert!(bench.status("first").await.policy_outage.is_none());
}

/// Runs a campaign of eight rollouts on two slots. One rollout crashes the policy after
/// `answered_queries` queries, and every other rollout in progress loses the policy with it.
async fn run_with_killer(answered_queries: u32) -> Bench {
    let spec = spec_of("first", "fragile");
    let bench = Bench::with(&spec).await;
    let mut worker = bench.worker("a").await;
    let is_killer = |lease: &Lease| rollout_id(lease).ends_with("sensor/L1/c00");
    for _ in 0..200 {
        bench.advance(3).await;
        worker.heartbeat(&[], 0).await;
        let mut leases = worker.claim(2).await;
        // The policy crashes before the other rollouts finish.
        leases.sort_by_key(|lease| !is_killer(lease));
        let has_killer = leases.iter().any(is_killer);
        for lease in &leases {
            match (has_killer, is_killer(lease)) {
                (true, true) => worker.lose_policy(lease, answered_queries).await.backoff_secs,
                (true, false) => worker.lose_policy(lease, 5).await.backoff_secs,
                (false, _) => {
                    assert_eq!(worker.commit(lease, true).await, Verdict::Accepted);
                    0.0
                }
            };
        }
        let status = bench.status("first").await;
        if status.rollouts.committed + status.rollouts.quarantined == status.rollouts.total() {
            break;
        }
    }
    bench
}

/// Regression: the rollout that crashed the policy was requeued and became the next probe, again
/// and again.
#[tokio::test]
async fn a_rollout_that_takes_its_policy_down_is_quarantined_and_others_complete() {
    for answered_queries in [3, 0] {
        let bench = run_with_killer(answered_queries).await;
        let status = bench.status("first").await;
        assert_eq!((status.rollouts.committed, status.rollouts.quarantined), (7, 1));
        assert!(bench.status("first").await.policy_outage.is_none() || status.rollouts.queued == 0);
        let query = "SELECT count(*) FROM job j JOIN failure f ON f.job_id = j.id
                AND f.attempt = j.attempt
            WHERE j.state = 'quarantined' AND j.rollout_id LIKE '%sensor/L1/c00'
                AND j.charged_attempts = 0 AND f.reason = 'takes_policy_down'
                AND f.error LIKE '%takes its policy down%simulated failure'";
        assert_eq!(bench.count(query).await, 1);
        assert_eq!(bench.count("SELECT count(*) FROM failure WHERE charged").await, 0);
        assert_sound(bench.stop().await.path()).await;
    }
}

#[tokio::test]
async fn a_long_outage_quarantines_nothing_and_is_probed_by_one_rollout_at_a_time() {
    let bench = Bench::with(&spec_of("first", "fragile")).await;
    let mut worker = bench.worker("a").await;
    // All rollouts had reached the policy when it went down.
    for lease in worker.claim(8).await {
        worker.lose_policy(&lease, 4).await;
    }
    let mut probes = BTreeSet::new();
    for _ in 0..30 {
        // Longer than the longest back-off of a policy, 60 s.
        bench.advance(65).await;
        worker.heartbeat(&[], 0).await;
        let probe = worker.claim_one().await;
        assert!(worker.claim(1).await.is_empty(), "one probe at a time");
        worker.release(&probe, Reason::PolicyUnavailable).await;
        probes.insert(probe.job_id);
    }
    assert!(probes.len() >= 2, "{probes:?}");
    let status = bench.status("first").await;
    assert_eq!((status.rollouts.queued, status.rollouts.quarantined), (8, 0));
    assert_eq!(bench.count("SELECT max(losses) FROM job").await, 1);
}

#[tokio::test]
async fn a_sole_rollout_is_not_quarantined_by_repeated_policy_outages() {
    let bench = Bench::start().await;
    let spec = with(
        spec_of("one", "fragile"),
        json!({"axes": ["camera"], "nominal": "none", "configs": [0]}),
    );
    assert_eq!(bench.create(&spec).await.expect("created").jobs_total, 1);
    let mut worker = bench.worker("a").await;
    for _ in 0..30 {
        // Longer than any back-off.
        bench.advance(130).await;
        worker.heartbeat(&[], 0).await;
        let probe = worker.claim_one().await;
        worker.release(&probe, Reason::PolicyUnavailable).await;
    }
    assert_eq!(bench.status("one").await.rollouts.quarantined, 0);
    bench.advance(130).await;
    worker.heartbeat(&[], 0).await;
    let probe = worker.claim_one().await;
    assert_eq!(worker.commit(&probe, true).await, Verdict::Accepted);
}

/// Regression: the log had the skip of a running rollout as an error after its last attempt.
#[tokio::test]
async fn a_skip_of_a_running_rollout_is_not_logged_as_an_error() {
    let bench = Bench::with(&small_spec("some")).await;
    let lease = bench.worker("a").await.claim_one().await;
    let log = tempfile::NamedTempFile::new().expect("a file");
    let subscriber = tracing_subscriber::fmt()
        .with_ansi(false)
        .with_writer(log.reopen().expect("opens"))
        .finish();
    let logging = tracing::subscriber::set_default(subscriber);
    let name = CampaignName::parse("some").expect("a name");
    let job = queue::ids::JobName { rollout_id: rollout_id(&lease), replicate: 0 };
    let skipped = bench.queue.skip_jobs(&name, &[job]).await;
    drop(logging);
    assert_eq!(skipped.expect("skipped"), 1);
    let logged = std::fs::read_to_string(log.path()).expect("a log");
    let mut lines = logged.lines();
    let line = lines.find(|line| line.contains("an operator skipped this rollout"));
    let line = line.expect("a line about the job");
    assert!(line.contains(" INFO ") && !line.contains("attempt"), "{line}");
}

#[tokio::test]
async fn queued_and_running_rollouts_can_be_skipped_and_retried() {
    let bench = Bench::with(&small_spec("some")).await;
    let mut worker = bench.worker("a").await;
    let leases = worker.claim(2).await;
    assert_eq!(worker.commit(&leases[0], true).await, Verdict::Accepted);
    let name = |rollout_id: String| JobName { rollout_id, replicate: 0 };
    let id = |condition: &str| format!("object/t0/{condition}/L1/c00");
    let mut operator = bench.operator().await;
    let mut skip = async |rollouts: &[String]| {
        let request = SkipJobsRequest {
            campaign: "some".to_owned(),
            jobs: rollouts.iter().cloned().map(name).collect(),
        };
        value::<u64>(operator.skip_jobs(request).await)
    };
    let running = rollout_id(&leases[1]);
    let refused = skip(&[running.clone(), rollout_id(&leases[0])]).await;
    let refused = refused.expect_err("a committed rollout");
    assert!(refused.message().contains("it is committed"), "{refused}");
    assert_eq!(bench.status("some").await.rollouts.leased, 1, "neither or both are skipped");
    assert_eq!(
        skip(&[running.clone(), id("simultaneous"), running]).await.expect("skipped"),
        2,
        "a job that is named twice counts once"
    );
    assert_eq!(bench.status("some").await.rollouts.quarantined, 2);
    let card = "GET /campaigns/some/configurations/object/t0/simultaneous/L1/c00";
    let page = http(&bench.url, card).await.text();
    assert!(page.contains("skipped by an operator"), "{page}");
    assert_eq!(bench.count("SELECT sum(charged_attempts) FROM job").await, 0);
    let lost_leases = worker.heartbeat(&[&leases[1]], 5).await;
    assert_eq!(lost_leases, std::slice::from_ref(&leases[1].attempt_id));
    let last = worker.claim(4).await;
    assert_eq!(last.len(), 1, "the skipped jobs are not leased");
    assert_eq!(worker.commit(&last[0], true).await, Verdict::Accepted);
    let request = RetryJobsRequest { campaign: "some".to_owned(), jobs: Vec::new(), all: true };
    let retried = operator.retry_jobs(request).await.expect("retried");
    assert_eq!(retried.into_inner().json, "2");
    assert_eq!(worker.claim(4).await.len(), 2);
    assert_sound(bench.stop().await.path()).await;
}
