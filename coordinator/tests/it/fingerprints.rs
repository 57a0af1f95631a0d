//! A campaign whose results have several fingerprints shows this in its status, its report and on
//! its page.

use std::time::{Duration, Instant};

use proto::coordinator as wire;
use proto::coordinator::commit_response::Verdict;
use serde_json::json;

use crate::assertions::assert_contains;
use crate::harness::{Bench, Worker, report_json, sha, small_spec, with};
use crate::page::http;

/// Longest wait for the newest results on a page, which shows slightly older ones.
const PATIENCE: Duration = Duration::from_secs(60);

async fn fingerprint_texts(bench: &Bench) -> [String; 2] {
    let json = report_json(&mut bench.operator().await, "mixed").await;
    let subject = serde_json::from_slice(&json).expect("a subject");
    let document = report::Document::new(vec![subject]).expect("no duplicates");
    let report = document.text();
    let report: Vec<&str> = report.split_whitespace().collect();
    [bench.status("mixed").await.mixed_fingerprints.unwrap_or_default(), report.join(" ")]
}

/// Asserts that status and report contain all `parts`, and waits until the page contains them.
async fn check(bench: &Bench, parts: &[&str]) {
    for text in fingerprint_texts(bench).await {
        let text = text.to_lowercase();
        assert_contains(&text, parts);
    }
    let began = Instant::now();
    loop {
        let page = http(&bench.url, "GET /campaigns/mixed").await.text();
        let page = page.to_lowercase();
        let missing = parts.iter().find(|part| !page.contains(**part));
        match missing {
            None => return,
            Some(part) => assert!(began.elapsed() < PATIENCE, "{part} is not in {page}"),
        }
        tokio::time::sleep(Duration::from_millis(200)).await;
    }
}

async fn commit(worker: &mut Worker, lease: &wire::Lease) {
    assert_eq!(worker.commit(lease, true).await, Verdict::Accepted);
}

#[tokio::test(flavor = "multi_thread")]
async fn mixed_fingerprints_are_shown_in_status_report_and_page() {
    let bench = Bench::start().await;
    let tasks: Vec<String> = (0..7).map(|task| format!("libero_object/{task}")).collect();
    let spec = with(small_spec("mixed"), json!({"tasks": tasks}));
    bench.create(&spec).await.expect("created");
    let mut first = bench.worker("a").await;
    let mut second = bench.worker("b").await;
    second.fingerprint = "other bits".to_owned();
    let (first_digest, second_digest) = (sha("bits"), sha("other bits"));
    let warning = "fingerprints, so that the machines' arithmetic or frames differ";

    // All four rollouts of each task share one initial state.
    let mut leases = Vec::new();
    for task in &tasks {
        leases.push(first.claim_warm(4, task).await);
    }
    commit(&mut first, &leases[0][0]).await;
    commit(&mut first, &leases[0][1]).await;
    let page = http(&bench.url, "GET /campaigns/mixed").await.text();
    let [status, report] = fingerprint_texts(&bench).await;
    assert_eq!(status, "");
    assert!(!page.contains(warning) && !report.contains(warning));

    // All leases belong to the first worker. Its slots may have different fingerprints, so that
    // results of both fingerprints are accepted.
    let report_as = |worker: &Worker, lease: &wire::Lease| wire::CommitRequest {
        attempt_id: lease.attempt_id.clone(),
        ..worker.report(lease, true)
    };
    let request = report_as(&second, &leases[1][0]);
    let (verdict, _) = second.clone().commit_request(request).await;
    assert_eq!(verdict, Verdict::Accepted);
    let counts = |first_count: u32, second_count: u32| {
        let mut counts = [(&first_digest, first_count), (&second_digest, second_count)];
        counts.sort();
        let counts = counts.map(|(digest, count)| format!("{count} of {}", &digest[..12]));
        counts.join(", ")
    };
    let words = ["2 fingerprints", &counts(2, 1), "no configuration mixes them"];
    check(&bench, &words).await;

    for leases in &leases[1..] {
        let request = report_as(&second, &leases[1]);
        assert_eq!(second.commit_request(request).await.0, Verdict::Accepted);
        let request = report_as(&first, &leases[2]);
        assert_eq!(second.commit_request(request).await.0, Verdict::Accepted);
    }
    let named = "6 configurations mix them: libero_object/1 from state";
    check(&bench, &[&counts(8, 7), named, "and 1 more"]).await;
    assert_eq!(bench.status("mixed").await.rollouts.committed, 15);
}
