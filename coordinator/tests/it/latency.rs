//! The latency axis, from a campaign's creation to its thresholds.

use std::time::{Duration, Instant};

use benchmark::{RolloutId, delay_at};
use paired::Outcome;
use proto::coordinator::commit_response::Verdict;
use serde_json::{Value, json};

use crate::harness::rollout_id;
use crate::page::http;
use crate::process::{Serve, succeed, succeed_in_json, text};
use crate::search::{PATIENCE, run_all, searched};

/// Longest delay at which the policy still succeeds, control steps.
const MAX_DELAY: u16 = 3;

fn outcome(id: &RolloutId) -> Outcome {
    let is_late = id.condition().sets_execution();
    Outcome::from(!is_late || delay_at(id.level()).is_some_and(|delay| delay <= MAX_DELAY))
}

fn json_of(serve: &Serve, arguments: &[&str]) -> Value {
    succeed_in_json(serve.command(&[arguments, &["--json"]].concat()))
}

#[rustfmt::skip]
const CREATE: [&str; 16] = [
    "campaign", "create", "--name", "late", "--policy", "p",
    "--endpoint", "http://127.0.0.1:50051", "--tasks", "libero_object/0-1", "--levels", "L1,L3",
    "--configs", "0-1", "--axes", "camera,robot,latency",
];

#[tokio::test(flavor = "multi_thread")]
async fn latency_is_a_separate_condition() {
    let (_folder, serve) = Serve::anew();
    let refused = serve.command(&[&CREATE[..], &["--execution", "hold:2"]].concat());
    assert_eq!(refused.status.code(), Some(2));
    let message = text(&refused.stderr);
    assert!(message.contains("axis `latency` with `execution` hold:2"), "{message}");
    succeed(serve.command(&CREATE));

    // The result of a worker that does not delay the answers is refused.
    let mut worker = serve.worker("w").await;
    let mut is_refused_once = false;
    for lease in worker.claim(64).await {
        let id: RolloutId = rollout_id(&lease).parse().expect("an id");
        if !is_refused_once && id.condition().sets_execution() {
            is_refused_once = true;
            let report = worker.report_altered(&lease, true, |of| {
                let settings = &mut of.provenance.policy_settings;
                settings.remove("execution model").expect("an execution model");
            });
            let (verdict, detail) = worker.commit_request(report).await;
            assert_eq!(verdict, Verdict::Unpaired, "{detail}");
            assert!(detail.contains("runs under execution model `overlap:"), "{detail}");
            continue;
        }
        let success = outcome(&id) == Outcome::Success;
        assert_eq!(worker.commit(&lease, success).await, Verdict::Accepted);
    }
    assert!(is_refused_once);
    let began = Instant::now();
    while !text(&serve.command(&["campaign", "status", "late"]).stdout).contains("finished") {
        run_all(&mut worker, outcome).await;
        assert!(began.elapsed() < PATIENCE, "the refused rollout was not committed");
        tokio::time::sleep(Duration::from_millis(100)).await;
    }

    let exported = serve.command(&["export", "late", "--format", "jsonl"]);
    let rows = text(&exported.stdout).lines();
    let rows = rows.map(|line| serde_json::from_str::<Value>(line).expect("JSON"));
    let latency_rows: Vec<Value> = rows.filter(|row| !row["execution"].is_null()).collect();
    assert_eq!(latency_rows.len(), 2 * 2 * 2);
    for row in latency_rows {
        let expected = if row["level"] == "L1" { "overlap:1" } else { "overlap:4" };
        assert_eq!((&row["axis"], &row["execution"]), (&json!("latency"), &json!(expected)));
    }

    // The report counts the successes under latency, but leaves them out of the paired measures.
    let report = json_of(&serve, &["report", "late"]);
    let cells = report["reports"][0]["cells"].as_array().expect("cells");
    for (cell, successes) in cells.iter().zip([4, 0]) {
        let count = json!({"successes": successes, "n": 4});
        assert_eq!(cell["alone"]["latency"]["count"], count, "{cell}");
        assert_eq!((&cell["paired"]["n"], &cell["paired"]["s_conj"]), (&json!(4), &json!(1.0)));
    }
    let notes = report["reports"][0]["notes"].to_string();
    assert!(!notes.contains("execution model"), "{notes}");
    let full = serve.command(&["report", "late", "--full"]);
    let head = text(&full.stdout).lines().find(|line| line.contains("latency"));
    let words: Vec<&str> = head.expect("a column").split_whitespace().collect();
    assert_eq!(words, ["level", "nominal", "camera", "robot", "latency", "simultaneous"]);
    let page = http(&serve.url, "GET /campaigns/late").await.text();
    assert!(page.contains("latency"), "{page}");
    let configuration =
        http(&serve.url, "GET /campaigns/late/configurations/object/t0/latency/L3/c00").await;
    let configuration = configuration.text();
    assert!(configuration.contains("overlap:4"), "{configuration}");
}

#[tokio::test(flavor = "multi_thread")]
async fn the_latency_threshold_is_found_in_whole_control_steps() {
    let (_folder, serve) = Serve::anew();
    serve.run(&CREATE, 0, &[]);
    let mut worker = serve.worker("w").await;
    let thresholds = ["thresholds", "late", "--axes", "latency"];
    let findings = searched(&serve, &mut worker, &thresholds, outcome).await;
    assert_eq!((&findings["looked_for"], &findings["found"]), (&json!(4), &json!(4)));
    for threshold in findings["thresholds"].as_array().expect("a list") {
        assert_eq!(threshold["condition"], "latency");
        let bracket = [&threshold["succeeds_at"], &threshold["fails_at"]];
        assert_eq!(bracket, [&json!(6.0), &json!(8.0)], "delays of 3 and 4 control steps");
    }
    let output = serve.command(&["thresholds", "late"]);
    let words: Vec<&str> = text(&output.stdout).split_whitespace().collect();
    let words = words.join(" ");
    let expected = "half of the configurations succeed with a delay of 3 control steps, 150 ms";
    assert!(words.contains(expected), "{words}");
}
