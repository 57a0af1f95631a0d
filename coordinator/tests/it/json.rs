//! Output of `--json` has exactly the keys that docs/JSON.md documents, in every state of a
//! campaign.

use std::collections::BTreeSet;

use proto::coordinator::commit_response::Verdict;
use proto::coordinator::release_request::Reason;
use serde_json::{Value, json};

pub(crate) use crate::json_keys::{documented, keys};
use crate::process::{CREATE, Serve, fits_a_terminal, succeed, text};

struct Printed(Value);

impl Printed {
    fn run(serve: &Serve, arguments: &[&str]) -> Printed {
        let output = serve.command(&[arguments, &["--json"]].concat());
        assert!(output.status.success(), "{}", text(&output.stderr));
        Printed(serde_json::from_str(text(&output.stdout)).expect("JSON"))
    }

    fn keys(&self) -> BTreeSet<String> {
        let mut found = BTreeSet::new();
        keys(&self.0, "", &mut found);
        found
    }

    /// Asserts that all keys are documented; some may be missing, since `null` has no keys.
    fn assert_keys_are_documented(&self, command: &str) {
        let printed_keys = self.keys();
        assert!(printed_keys.is_subset(&documented(command)), "{printed_keys:?}");
    }

    fn assert_keys(&self, command: &str) {
        assert_eq!(self.keys(), documented(command), "{command}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn json_output_has_the_documented_keys() {
    let (_folder, serve) = Serve::with_demo();
    let early = ["--name", "early", "--stop", "I excludes 0", "--priority", "-1"];
    let early = [&CREATE[..2], &early, &CREATE[4..]].concat();
    succeed(serve.command(&early));
    let mut worker = serve.worker("a").await;
    let leases = worker.claim(3).await;
    worker.release(&leases[0], Reason::SlotCrashed).await;
    assert_eq!(worker.commit(&leases[1], true).await, Verdict::Accepted);
    assert_eq!(worker.commit(&leases[2], false).await, Verdict::Accepted);
    worker.claim(1).await;

    let printed = Printed::run(&serve, &["campaign", "status"]);
    printed.assert_keys("campaign status");
    let campaign = &printed.0["campaigns"][0];
    assert_eq!(campaign["name"], "demo");
    assert_eq!(campaign["state"], "running");
    assert_eq!(campaign["rollouts"]["total"], 14);
    assert_eq!(campaign["rollouts"]["failed"], 1);
    assert_eq!(campaign["policy_outage"], Value::Null);
    let created = campaign["created_at"].as_str().expect("an instant");
    let example = "2026-11-21T15:36:09.123Z";
    assert_eq!((created.len(), &created[10..11]), (example.len(), "T"));
    assert!(created.ends_with('Z'));
    let early_status = Printed::run(&serve, &["campaign", "status", "early"]);
    early_status.assert_keys("campaign status");

    let jobs = Printed::run(&serve, &["jobs", "demo"]);
    jobs.assert_keys("jobs NAME");
    assert_eq!(jobs.0["is_truncated"], false);
    let jobs = jobs.0["jobs"].as_array().expect("a list").clone();
    assert_eq!(jobs.len(), 14);
    let states: BTreeSet<&str> = jobs.iter().filter_map(|job| job["state"].as_str()).collect();
    assert_eq!(states, BTreeSet::from(["committed", "leased", "queued"]));
    for job in &jobs {
        let is_leased = job["state"] == "leased";
        assert_eq!(job["worker_id"].is_string(), is_leased, "{job}");
        assert_eq!(job["lease_left_secs"].is_number(), is_leased, "{job}");
        assert_eq!(job["outcome"].is_string(), job["state"] == "committed");
    }
    let truncated = Printed::run(&serve, &["jobs", "demo", "--limit", "2"]);
    truncated.assert_keys("jobs NAME");
    assert_eq!(truncated.0["is_truncated"], true);
    assert_eq!(truncated.0["jobs"].as_array().map(Vec::len), Some(2));

    // The keys of all jobs together: no single job has both a result and failures.
    let mut shown = BTreeSet::new();
    for job in &jobs {
        let id = job["rollout_id"].as_str().expect("an id");
        keys(&Printed::run(&serve, &["jobs", "demo", id]).0, "", &mut shown);
    }
    assert_eq!(shown, documented("jobs NAME ROLLOUT"));

    let dry = [&CREATE[..], &["--dry-run"]].concat();
    let dry = Printed::run(&serve, &dry);
    dry.assert_keys("campaign create --dry-run");
    assert_eq!(dry.0["forecast"]["results"], 2);
    assert_eq!(dry.0["no_forecast"], Value::Null);

    // What only the text shows: films under way, and when a paused policy is tried again.
    worker.report_filming(1).await;
    let workers = Printed::run(&serve, &["workers"]);
    workers.assert_keys("workers");
    assert_eq!(workers.0["workers"][0]["worker_id"], "a");
    assert_eq!(workers.0["workers"][0]["is_alive"], true);
    let lease = worker.claim_one().await;
    worker.release(&lease, Reason::PolicyUnavailable).await;
    let outage = Printed::run(&serve, &["campaign", "status"]);
    outage.assert_keys("campaign status");
    assert!(outage.0["campaigns"][0]["policy_outage"].is_string());
}

#[tokio::test(flavor = "multi_thread")]
async fn rollouts_are_listed_by_outcome_task_condition_and_level() {
    let (_folder, serve) = Serve::anew();
    let create = [&CREATE[..], &["--axes", "camera,sensor"]].concat();
    serve.run(&create, 0, &[]);
    let mut worker = serve.worker("a").await;
    for (index, lease) in worker.claim(5).await.iter().enumerate() {
        let verdict = worker.commit(lease, index % 2 == 0).await;
        assert_eq!(verdict, Verdict::Accepted);
    }
    let ids = |filters: &[&str]| -> Vec<String> {
        let printed = Printed::run(&serve, &[&["jobs", "demo"][..], filters].concat());
        let jobs = printed.0["jobs"].as_array().expect("a list").iter();
        jobs.map(|job| job["rollout_id"].as_str().expect("an id").to_owned()).collect()
    };
    assert_eq!(ids(&[]).len(), 8);
    assert_eq!(ids(&["--outcome", "success"]).len(), 3);
    assert_eq!(ids(&["--outcome", "failure"]).len(), 2);
    assert_eq!(ids(&["--state", "queued", "--outcome", "failure"]).len(), 0);
    assert_eq!(ids(&["--task", "libero_object/1"]).len(), 4);
    assert_eq!(ids(&["--task", "libero_object"]).len(), 8);
    assert_eq!(ids(&["--task", "libero_goal"]).len(), 0);
    assert_eq!(ids(&["--level", "L1"]).len(), 6);
    assert_eq!(ids(&["--level", "L0"]).len(), 2);
    assert_eq!(ids(&["--level", "L2"]).len(), 0);
    let camera_ids = ids(&["--condition", "camera", "--task", "libero_object/0"]);
    assert_eq!(camera_ids, ["object/t0/camera/L1/c00"]);
    for (name, published) in [("nominal", "clean"), ("simultaneous", "combination")] {
        let listed = ids(&["--condition", name]);
        assert_eq!(listed.len(), 2);
        assert!(listed.iter().all(|rollout| rollout.contains(name)), "{listed:?}");
        assert_eq!(listed, ids(&["--condition", published]));
    }
    for (flag, value) in [
        ("--outcome", "won"),
        ("--task", "libero_object/77"),
        ("--condition", "camrea"),
        ("--level", "L9"),
    ] {
        let refused = serve.command(&["jobs", "demo", flag, value]);
        assert_eq!(refused.status.code(), Some(2), "{flag} {value}");
        assert!(text(&refused.stderr).contains(value), "{flag} {value}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn placebo_rollouts_are_planned_counted_and_listed_as_l0() {
    let (_folder, serve) = Serve::anew();
    let create: Vec<&str> = "campaign create --name floor --policy expert --tasks libero_object \
         --endpoint http://127.0.0.1:50051 --axes camera,language --levels L0,L1 --configs 0,3 \
         --placebo-configs 3"
        .split_whitespace()
        .collect();
    let dry = [&create[..], &["--dry-run"]].concat();
    let json = Printed::run(&serve, &dry);
    json.assert_keys_are_documented("campaign create --dry-run");
    // Each task has two nominal rollouts, three conditions of two configurations at L1, and three
    // conditions of one configuration at L0.
    assert_eq!(json.0["rollouts"], 10 * (2 + 2 * 3 + 3));
    assert_eq!(json.0["placebo_rollouts"], 30);
    let level = &json.0["planning"][0];
    assert_eq!((&level["level"], &level["configurations"]), (&json!("L1"), &json!(20)));
    assert_eq!((&level["assumed_level"], &level["i"]), (&json!("L1"), &Value::Null));
    let words = serve.command(&dry);
    let words = text(&words.stdout);
    assert!(words.contains("including 30 rollouts at the placebo level L0"), "{words}");
    assert!(
        words.contains("L1, 20 configurations of 10 tasks: a difference of two policies"),
        "{words}"
    );
    fits_a_terminal(words);
    serve.run(&create, 0, &[]);
    let ids = |filters: &[&str]| -> Vec<String> {
        let printed = Printed::run(&serve, &[&["jobs", "floor"][..], filters].concat());
        let jobs = printed.0["jobs"].as_array().expect("a list").iter();
        jobs.map(|job| job["rollout_id"].as_str().expect("an id").to_owned()).collect()
    };
    assert_eq!(ids(&["--level", "L0"]).len(), 20 + 30);
    let placebo = ids(&["--level", "L0", "--condition", "language"]);
    assert_eq!(placebo.len(), 10);
    assert_eq!(placebo[0], "object/t0/language/L0/c03");
    let shown = Printed::run(&serve, &["jobs", "floor", &placebo[0]]);
    assert_eq!(shown.0["manifest_row"]["placebo_radius"], 0.02);
    assert_eq!(shown.0["manifest_row"]["variant_id"], "t0/L0/canonical");
}
