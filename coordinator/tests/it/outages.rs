//! A policy that is down pauses its own jobs only, and they resume by
//! themselves.

use proto::coordinator::ChangeCampaignRequest;
use proto::coordinator::change_campaign_request::Change;
use proto::coordinator::commit_response::Verdict;
use proto::coordinator::release_request::Reason;
use serde_json::json;

use crate::harness::{Bench, small_spec, with};

/// Past the first back-off of an outage (1 s), and of the one after (2 s).
const PAST_FIRST_SECS: u64 = 2;

fn spec_of(name: &str, policy: &str) -> serde_json::Value {
    let policy = json!({"name": policy, "endpoint": "http://127.0.0.1:50051"});
    with(
        small_spec(name),
        json!({"policy": policy, "configs": [0, 1]}),
    )
}

async fn two_campaigns() -> Bench {
    let bench = Bench::start().await;
    bench
        .create_with_priority(&spec_of("first", "fragile"), 1)
        .await
        .expect("created");
    bench
        .create(&spec_of("second", "sound"))
        .await
        .expect("created");
    bench
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
    assert!(status.policy_paused);
    assert_eq!(status.policy_pause_reason, "the bench said so");
    assert_eq!(
        bench
            .count("SELECT outages FROM policy WHERE name = 'fragile'")
            .await,
        1
    );
    assert_eq!(
        bench.count("SELECT max(charged_attempts) FROM job").await,
        0
    );

    let others = worker.claim(64).await;
    assert_eq!(others.len(), 8);
    assert!(others.iter().all(|lease| lease.policy == "sound"));
    let idle = worker.claim_response("").await.idle_reason;
    assert!(
        idle.contains("`fragile`") && idle.contains("the bench said so"),
        "{idle}"
    );
}

/// There was no way to say that the policy is back.
#[tokio::test]
async fn an_operator_who_resumes_a_campaign_has_its_policy_tried_at_once() {
    let bench = two_campaigns().await;
    let mut worker = bench.worker("a").await;
    let lease = worker.claim_one().await;
    worker.release(&lease, Reason::PolicyUnavailable).await;
    let status = bench.status("first").await;
    assert!(status.policy_retry_secs > Some(0.0), "{status:?}");
    let others = worker.claim(64).await;
    assert!(others.iter().all(|lease| lease.policy == "sound"));
    let resume = ChangeCampaignRequest {
        campaign: "first".to_owned(),
        change: Change::Resume.into(),
    };
    let resumed = bench.operator().await.change_campaign(resume).await;
    resumed.expect("resumed");
    assert_eq!(bench.status("first").await.policy_retry_secs, Some(0.0));
    assert_eq!(worker.claim_one().await.policy, "fragile");
    let status = bench.status("first").await;
    assert_eq!(
        status.policy_retry_secs, None,
        "one rollout is out to try it"
    );
}

#[tokio::test]
async fn a_pause_lets_one_probe_through_and_its_first_answer_resumes_the_rest() {
    let bench = two_campaigns().await;
    let mut worker = bench.worker("a").await;
    let lease = worker.claim_one().await;
    worker.release(&lease, Reason::PolicyUnavailable).await;
    bench.pass(PAST_FIRST_SECS).await;
    let leases = worker.claim(4).await;
    let fragile: Vec<_> = leases
        .iter()
        .filter(|lease| lease.policy == "fragile")
        .collect();
    assert_eq!(fragile.len(), 1, "one probe");
    let probe = fragile[0].clone();
    assert!(
        worker
            .claim(64)
            .await
            .iter()
            .all(|lease| lease.policy == "sound")
    );

    // Ten settling steps need no policy; the eleventh does.
    worker.heartbeat(&[&probe], 10).await;
    assert!(bench.status("first").await.policy_paused);
    worker.heartbeat(&[&probe], 11).await;
    assert!(!bench.status("first").await.policy_paused);
    let rest = worker.claim(64).await;
    assert_eq!(rest.len(), 7);
    assert_eq!(worker.commit(&probe, true).await, Verdict::Accepted);
    assert_eq!(bench.count("SELECT max(outages) FROM policy").await, 0);
}

#[tokio::test]
async fn a_probe_that_fails_waits_longer_and_one_that_crashes_is_replaced() {
    let bench = two_campaigns().await;
    let mut worker = bench.worker("a").await;
    let lease = worker.claim_one().await;
    let first = worker.release(&lease, Reason::PolicyUnavailable).await;
    bench.pass(PAST_FIRST_SECS).await;
    let mut probe = worker.claim(1).await.remove(0);
    assert_eq!(probe.policy, "fragile");
    for _ in 0..5 {
        worker.release(&probe, Reason::PolicyUnavailable).await;
        bench.pass(70).await;
        probe = worker.claim(1).await.remove(0);
    }
    let last = worker.release(&probe, Reason::PolicyUnavailable).await;
    assert!(
        last.backoff_secs > 4.0 * first.backoff_secs,
        "{}",
        last.backoff_secs
    );
    assert!(last.backoff_secs <= 60.0, "{}", last.backoff_secs);

    bench.pass(70).await;
    let probe = worker.claim(1).await.remove(0);
    assert_eq!(probe.policy, "fragile");
    worker.release(&probe, Reason::SlotCrashed).await;
    let next = worker.claim(1).await.remove(0);
    assert_eq!(
        next.policy, "fragile",
        "the crash said nothing about the policy"
    );
    assert_ne!(next.job_id, probe.job_id);
}

#[tokio::test]
async fn what_was_leased_before_the_policy_came_back_is_no_new_outage() {
    let bench = two_campaigns().await;
    let mut worker = bench.worker("a").await;
    let leases = worker.claim(2).await;
    worker.release(&leases[0], Reason::PolicyUnavailable).await;
    bench.pass(PAST_FIRST_SECS).await;
    let probe = worker.claim(1).await.remove(0);
    worker.heartbeat(&[&probe, &leases[1]], 11).await;
    assert!(!bench.status("first").await.policy_paused);
    worker.release(&leases[1], Reason::PolicyUnavailable).await;
    assert!(!bench.status("first").await.policy_paused, "old news");
}

#[tokio::test]
async fn a_pause_survives_a_restart_and_still_ends_by_itself() {
    let bench = two_campaigns().await;
    let mut worker = bench.worker("a").await;
    let lease = worker.claim_one().await;
    worker.release(&lease, Reason::PolicyUnavailable).await;
    let bench = bench.restart().await;
    assert!(bench.status("first").await.policy_paused);
    let mut worker = bench.worker("a").await;
    bench.pass(PAST_FIRST_SECS).await;
    let probe = worker.claim(1).await.remove(0);
    assert_eq!(probe.policy, "fragile");
    assert_eq!(worker.commit(&probe, true).await, Verdict::Accepted);
    assert!(!bench.status("first").await.policy_paused);
}
