//! Conditions of several axes, from the command line to table and page.

use proto::coordinator::commit_response::Verdict;

use crate::assertions::assert_contains;
use crate::harness::rollout_id;
use crate::page::http;
use crate::process::{Serve, text};

#[rustfmt::skip]
const CREATE: [&str; 16] = [
    "campaign", "create", "--name", "pairs", "--policy", "p",
    "--endpoint", "http://127.0.0.1:50051", "--tasks", "libero_object", "--levels", "L1",
    "--configs", "0", "--axes", "camera,robot,sensor",
];

#[tokio::test(flavor = "multi_thread")]
async fn a_pair_that_fails_while_its_axes_alone_succeed_is_reported() {
    let (_folder, serve) = Serve::anew();
    let created = serve.command(&[&CREATE[..], &["--subsets", "pairs"]].concat());
    let output = text(&created.stdout);
    assert!(output.contains("80 rollouts"), "{output}");

    let mut worker = serve.worker("w").await;
    loop {
        let leases = worker.claim(16).await;
        if leases.is_empty() {
            break;
        }
        for lease in leases {
            let id = rollout_id(&lease);
            let fails = id.contains("camera+robot") || id.contains("simultaneous");
            assert_eq!(worker.commit(&lease, !fails).await, Verdict::Accepted);
        }
    }

    let report = serve.command(&["report", "pairs", "--full"]);
    let table = text(&report.stdout);
    let words = table.split_whitespace().collect::<Vec<_>>().join(" ");
    let lines =
        ["camera+robot 0.0 0/10", "camera+sensor 100.0 10/10", "robot+sensor 100.0 10/10", "b 10"];
    assert_contains(&words, &lines);
    let rows = http(&serve.url, "GET /campaigns/pairs").await.text();
    assert!(rows.contains("camera+robot"), "{rows}");
    let configuration = "GET /campaigns/pairs/configurations/object/t0/simultaneous/L1/c00";
    let cards = http(&serve.url, configuration).await.text();
    assert!(cards.contains("camera+robot"), "{cards}");
}
