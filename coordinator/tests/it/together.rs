//! Batching: calls that arrive during a transaction share the next transaction, and each call is
//! answered as if it had arrived alone.

use std::collections::BTreeSet;
use std::time::Duration;

use proto::coordinator as wire;
use proto::coordinator::commit_response::Verdict;
use proto::coordinator::release_request::Reason;
use serde_json::json;
use tokio::task::JoinSet;

use crate::harness::{Bench, Worker, assert_sound, sha, small_spec, with};

/// Time in which all requests arrive, while nothing can be written.
const ARRIVAL: Duration = Duration::from_millis(300);

/// Sends all requests while the database is locked, so that they wait for one transaction. Answers
/// are in the order of the requests.
async fn send_in_one_batch<T: Send + 'static>(
    bench: &Bench,
    requests: Vec<impl Future<Output = T> + Send + 'static>,
) -> Vec<T> {
    let database = bench.database().await;
    let lock = database.begin_with("BEGIN IMMEDIATE").await.expect("a write lock");
    let mut answers = JoinSet::new();
    for (index, request) in requests.into_iter().enumerate() {
        answers.spawn(async move { (index, request.await) });
    }
    tokio::time::sleep(ARRIVAL).await;
    lock.rollback().await.expect("rolled back");
    database.close().await;
    let mut answers = answers.join_all().await;
    answers.sort_by_key(|(index, _)| *index);
    answers.into_iter().map(|(_, answer)| answer).collect()
}

/// Returns twelve leases of one task: three configurations with four rollouts each.
async fn twelve_leases() -> (Bench, Worker, Vec<wire::Lease>) {
    let spec = with(small_spec("together"), json!({"configs": [0, 1, 2]}));
    let bench = Bench::with(&spec).await;
    let mut worker = bench.worker("a").await;
    let leases = worker.claim(12).await;
    assert_eq!(leases.len(), 12);
    (bench, worker, leases)
}

#[tokio::test(flavor = "multi_thread")]
async fn batched_reports_each_get_their_own_verdict() {
    let (bench, mut worker, leases) = twelve_leases().await;
    assert_eq!(worker.commit(&leases[0], true).await, Verdict::Accepted);
    let accepted: Vec<_> = [1, 2, 4, 5, 6, 7, 8]
        .iter()
        .map(|index| &leases[*index])
        .map(|lease| (worker.report(lease, true), Verdict::Accepted))
        .collect();
    let unpaired =
        worker.report_altered(&leases[3], true, |of| of.result.digests.scene = sha("moved"));
    worker.release(&leases[9], Reason::Draining).await;
    let stale = worker.report(&leases[9], true);
    let duplicate = worker.report(&leases[0], true);
    let divergent = worker.report(&leases[0], false);
    let not_accepted = [
        (duplicate, Verdict::Duplicate),
        (divergent, Verdict::Divergent),
        (unpaired, Verdict::Unpaired),
        (stale, Verdict::Stale),
    ];
    let mixed: Vec<_> = accepted.into_iter().chain(not_accepted).collect();
    let requests = mixed.iter().map(|(report, _)| {
        let (mut worker, report) = (worker.clone(), report.clone());
        async move { worker.commit_request(report).await.0 }
    });
    let verdicts = send_in_one_batch(&bench, requests.collect()).await;
    let expected: Vec<Verdict> = mixed.iter().map(|(_, verdict)| *verdict).collect();
    assert_eq!(verdicts, expected);
    assert_eq!(bench.status("together").await.rollouts.committed, 8);
    let divergences = "SELECT count(*) FROM divergence";
    assert_eq!(bench.count(divergences).await, 1);
    assert_sound(bench.stop().await.path()).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn one_of_two_batched_reports_of_a_rollout_is_stored() {
    let (bench, worker, leases) = twelve_leases().await;
    let twice = leases[..6].iter().chain(&leases[..6]);
    let requests = twice.map(|lease| {
        let (mut worker, report) = (worker.clone(), worker.report(lease, true));
        async move { worker.commit_request(report).await.0 }
    });
    let verdicts = send_in_one_batch(&bench, requests.collect()).await;
    for (first, second) in verdicts[..6].iter().zip(&verdicts[6..]) {
        let pair = BTreeSet::from([first.as_str_name(), second.as_str_name()]);
        let expected = [Verdict::Accepted, Verdict::Duplicate];
        assert_eq!(pair, expected.iter().map(Verdict::as_str_name).collect());
    }
    assert_sound(bench.stop().await.path()).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn contradictory_siblings_in_one_batch_are_not_both_stored() {
    let (bench, worker, leases) = twelve_leases().await;
    let same_state = [&leases[0], &leases[1]];
    let requests = same_state.iter().enumerate().map(|(index, lease)| {
        let scene = sha(&format!("scene {index}"));
        let report = worker.report_altered(lease, true, |of| of.result.digests.scene = scene);
        let mut worker = worker.clone();
        async move { worker.commit_request(report).await.0 }
    });
    let mut verdicts = send_in_one_batch(&bench, requests.collect()).await;
    verdicts.sort_by_key(|verdict| i32::from(*verdict));
    assert_eq!(verdicts, [Verdict::Accepted, Verdict::Unpaired]);
    assert_sound(bench.stop().await.path()).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn batched_claims_are_served_in_order_of_arrival() {
    let (bench, mut first, leases) = twelve_leases().await;
    // One result pins the campaign; the other leases are released.
    assert_eq!(first.commit(&leases[0], true).await, Verdict::Accepted);
    for lease in &leases[1..] {
        first.release(lease, Reason::Draining).await;
    }
    let mut requests = Vec::new();
    for number in 0..13_u32 {
        let mut worker = bench.worker(&format!("w{number}")).await;
        // Every fourth worker holds no scene. Two workers find no job.
        let warm = ["libero_object/0", ""][usize::from(number % 4 == 3)];
        requests.push(async move { worker.claim_response(warm).await.lease });
    }
    let granted = send_in_one_batch(&bench, requests).await;
    let mut jobs: Vec<i64> = granted.iter().flatten().map(|lease| lease.job_id).collect();
    jobs.sort_unstable();
    let expected: Vec<i64> = leases[1..].iter().map(|lease| lease.job_id).collect();
    assert_eq!(jobs, expected, "every remaining job is leased exactly once");
    assert!(granted.iter().flatten().all(|lease| lease.attempt == 2));
    assert_sound(bench.stop().await.path()).await;
}
