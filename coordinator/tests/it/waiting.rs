//! Derived campaigns are not finished while further rollouts may be derived.

use std::time::{Duration, Instant};

use libero_ctrl::{AxisSet, Condition, RolloutId};
use paired::Outcome;
use serde_json::{Value, json};

use crate::assertions::assert_contains;
use crate::derived::{PATIENCE, run_all};
use crate::harness::{Worker, rollout_id};
use crate::page::http;
use crate::process::{Serve, succeed, succeed_in_json, text};

/// Returns the planted outcome: three axes together cause a failure, but no two of them, so that
/// the search takes two rounds.
fn outcome(id: &RolloutId) -> Outcome {
    let axes = id.condition().axes(AxisSet::ALL);
    let fatal: AxisSet = "camera+robot+sensor".parse().expect("a set");
    Outcome::from(id.condition() == Condition::Clean || !fatal.is_subset(axes))
}

fn create(serve: &Serve, name: &str) {
    #[rustfmt::skip]
    succeed(serve.command(&[
        "campaign", "create", "--name", name, "--policy", "p",
        "--endpoint", "http://127.0.0.1:50051", "--tasks", "libero_object/0", "--axes", "all",
        "--levels", "L2", "--configs", "0",
    ]));
}

fn explain(serve: &Serve, name: &str) -> Value {
    succeed_in_json(serve.command(&["explain", name, "--create", "--json"]))
}

fn status(serve: &Serve, name: &str) -> Value {
    let output = serve.command(&["campaign", "status", name, "--json"]);
    let list: Value = serde_json::from_slice(&output.stdout).expect("JSON");
    list["campaigns"][0].clone()
}

/// Runs one rollout, if a rollout is waiting.
async fn run_one(worker: &mut Worker) {
    for lease in worker.claim(1).await {
        let id = rollout_id(&lease).parse().expect("an id");
        worker.commit(&lease, outcome(&id) == Outcome::Success).await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn an_explaining_campaign_names_its_source_and_finishes_after_it() {
    let (_folder, serve) = Serve::anew();
    create(&serve, "first");
    explain(&serve, "first");
    let mut worker = serve.worker("w").await;
    for _ in 0..3 {
        run_one(&mut worker).await;
    }
    let waiting = status(&serve, "first-explained");
    assert_eq!(waiting["follows_from"], "first");
    assert_eq!(status(&serve, "first")["follows_from"], Value::Null);
    assert_eq!(waiting["rollouts"]["total"], 0);
    assert_eq!(waiting["is_finished"], false);
    let waiting_words = "campaign `first`, which has 5 rollouts left";
    let reason = waiting["waiting_reason"].as_str().expect("a reason");
    assert!(reason.contains(waiting_words), "{reason}");
    let output = serve.command(&["campaign", "status", "first-explained"]);
    let status_text = text(&output.stdout);
    assert_contains(status_text, &["waits for first", waiting_words]);
    for address in ["/", "/campaigns/first-explained"] {
        let page = http(&serve.url, &format!("GET {address}")).await.text();
        assert!(page.contains("waits for campaign first"), "{address}");
        assert!(page.contains(waiting_words), "{address}");
    }

    // Once the status reports the campaign as finished, everything is explained.
    let began = Instant::now();
    while status(&serve, "first-explained")["is_finished"] == false {
        assert!(began.elapsed() < PATIENCE);
        run_one(&mut worker).await;
    }
    let findings = explain(&serve, "first");
    assert_eq!(findings["complete"], true);
    assert_eq!(findings["transitions"], 1);
    // All 15 pairs of the six axes were run, and then triples.
    let rollouts = findings["rollouts"].as_u64().expect("a count");
    assert!(rollouts > 15, "{rollouts}");
    let finished = status(&serve, "first-explained");
    assert_eq!(finished["waiting_reason"], Value::Null);
    assert_eq!(finished["rollouts"]["total"], rollouts);
}

#[tokio::test(flavor = "multi_thread")]
async fn campaigns_that_are_cancelled_or_without_transitions_derive_no_rollouts() {
    let (_folder, serve) = Serve::anew();
    create(&serve, "cancelled");
    explain(&serve, "cancelled");
    let cancelled = serve.command(&["campaign", "cancel", "cancelled"]);
    assert!(cancelled.status.success(), "{}", text(&cancelled.stderr));
    let finished = status(&serve, "cancelled-explained");
    assert_eq!(finished["is_finished"], true);
    assert_eq!(finished["state"], "finished");
    let waiting_reason = finished["waiting_reason"].as_str().expect("a reason");
    assert!(
        waiting_reason.contains("which was cancelled with 8 rollouts left"),
        "{waiting_reason}"
    );

    create(&serve, "steady");
    explain(&serve, "steady");
    assert_eq!(status(&serve, "steady-explained")["is_finished"], false);
    let mut worker = serve.worker("w").await;
    run_all(&mut worker, |_| Outcome::Success).await;
    let began = Instant::now();
    while status(&serve, "steady-explained")["is_finished"] == false {
        assert!(began.elapsed() < PATIENCE);
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    let finished = status(&serve, "steady-explained");
    assert_eq!(finished["rollouts"]["total"], 0);
    assert_eq!(finished["waiting_reason"], json!(null));
}
