//! Early stops: a campaign stops at the configuration at which the statistics of its outcomes meet
//! its rule, even if the process is killed at any point.

use std::collections::BTreeSet;
use std::time::{Duration, Instant};

use benchmark::{CampaignSpec, ManifestRow, RolloutId};
use paired::{CampaignLook, Outcome, Record, Records};
use proto::coordinator::Lease;
use proto::coordinator::commit_response::Verdict;
use queue::expand::NewCampaign;
use queue::{Side, Step};
use serde_json::{Value, json};

use crate::harness::{Worker, assert_sound, rollout_id};
use crate::page::http;
use crate::process::{Serve, fits_a_terminal, succeed, succeed_in_json, text};
use crate::search::{PATIENCE, kill_at_failpoint, searched};

/// Time for which a test observes that a campaign does not stop.
const OBSERVATION_TIME: Duration = Duration::from_millis(400);
const RULE: &str = "width(S_sim) < 0.7 and R_c excludes 1";

/// One suite under three axes at two levels: 40 configurations with nine rollouts each.
fn spec(name: &str) -> Value {
    json!({
        "name": name,
        "policy": {"name": "p", "endpoint": "http://127.0.0.1:50051"},
        "tasks": ["libero_object"], "axes": ["camera", "robot", "sensor"], "levels": ["L1", "L2"],
        "configs": [0, 1, 2, 3], "nominal": "eval",
        "stop": {"rule": RULE, "seed": 7},
    })
}

/// Returns the planted outcome of a rollout: some tasks fail under the robot axis alone, others
/// under all axes together.
fn succeeds(id: &RolloutId) -> bool {
    let condition = id.condition().to_string();
    match id.task().index() {
        0 | 1 => condition != "robot",
        2..5 => condition != "simultaneous",
        _ => true,
    }
}

fn planted_outcome(id: &RolloutId) -> Outcome {
    Outcome::from(succeeds(id))
}

/// A campaign with planted outcomes: its rollouts in the order of their leases, and the numbers of
/// rollouts and of configurations after which it must stop.
struct Planted {
    ids: Vec<RolloutId>,
    rollouts: usize,
    configurations: usize,
}

fn planted(spec: &Value) -> Planted {
    let spec = CampaignSpec::from_json(&spec.to_string()).expect("a specification");
    let campaign = NewCampaign::from_spec(&spec).expect("a campaign");
    let rows = campaign.jobs.iter().map(|job| {
        let row: ManifestRow = serde_json::from_str(&job.manifest_row).expect("a row");
        (row.id, row.init_id)
    });
    let rows: Vec<(RolloutId, u16)> = rows.collect();
    let records = rows.iter().map(|&(id, init_id)| Record {
        id,
        init_id,
        replicate: 0,
        outcome: Outcome::from(succeeds(&id)),
    });
    let records = Records::new(&records.collect::<Vec<_>>()).expect("no rollout twice");
    let stop = spec.stop.expect("a rule");
    let stop_point = CampaignLook::when_met(&records, &stop).expect("the rule is met");
    let used = stop_point.used.len();
    assert!(
        (5..stop_point.units - 5).contains(&used),
        "a stop after {used} configurations is too near an end of the campaign for a test"
    );
    Planted {
        ids: rows.iter().map(|(id, _)| *id).collect(),
        // Two levels of four conditions each, and the nominal rollout.
        rollouts: used * 9,
        configurations: used,
    }
}

fn id(lease: &Lease) -> RolloutId {
    rollout_id(lease).parse().expect("an id")
}

/// Runs `rollouts` rollouts; returns their ids.
async fn run(worker: &mut Worker, rollouts: usize) -> Vec<RolloutId> {
    let mut ids = Vec::new();
    for _ in 0..rollouts {
        let lease = worker.claim_one().await;
        let id = id(&lease);
        let committed = worker.commit(&lease, succeeds(&id)).await;
        assert_eq!(committed, Verdict::Accepted);
        ids.push(id);
    }
    ids
}

fn printed(serve: &Serve, arguments: &[&str]) -> Value {
    succeed_in_json(serve.command(arguments))
}

fn status(serve: &Serve, name: &str) -> Value {
    printed(serve, &["campaign", "status", name, "--json"])["campaigns"][0].clone()
}

/// Waits until a campaign has stopped, and returns its status.
async fn stopped(serve: &Serve, name: &str) -> Value {
    let began = Instant::now();
    loop {
        let status = status(serve, name);
        if status["state"] == "stopped" {
            return status;
        }
        assert!(began.elapsed() < PATIENCE, "{status}");
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_campaign_stops_where_its_rule_is_met_and_reports_the_savings() {
    let (folder, serve) = Serve::anew();
    let planted = planted(&spec("early"));
    serve.create(&spec("early"));
    let mut worker = serve.worker("w").await;
    let begun = run(&mut worker, planted.rollouts - 1).await;
    assert_eq!(begun, planted.ids[..begun.len()], "in the drawn order");
    // Another seed draws the same rollouts in another order.
    let mut another = spec("early");
    another["stop"]["seed"] = json!(8);
    let another = self::planted(&another).ids;
    assert_ne!(another, planted.ids);
    let sorted = |ids: &[RolloutId]| ids.iter().copied().collect::<BTreeSet<_>>();
    assert_eq!(sorted(&another), sorted(&planted.ids));
    tokio::time::sleep(OBSERVATION_TIME).await;
    let running = status(&serve, "early");
    assert_eq!(running["state"], "running");
    assert_eq!(running["early_stop"]["used"], Value::Null);
    // Before the stop, the report has the confidence sequences so far.
    let report = printed(&serve, &["report", "early", "--json"]);
    let sequential = &report["reports"][0]["sequential"];
    assert_eq!(sequential["has_stopped"], false);
    assert_eq!(sequential["used"], planted.configurations - 1);

    // Claims the last rollout that counts, and two rollouts after it.
    let leases = worker.claim(3).await;
    assert_eq!(worker.commit(&leases[2], true).await, Verdict::Accepted);
    let last = succeeds(&id(&leases[0]));
    assert_eq!(worker.commit(&leases[0], last).await, Verdict::Accepted);
    let status = stopped(&serve, "early").await;
    let all = planted.ids.len();
    let saved = all - planted.rollouts - 1;
    assert_eq!(status["is_finished"], true);
    assert_eq!(status["early_stop"]["used"], planted.configurations);
    assert_eq!(status["early_stop"]["configurations"], 40);
    assert_eq!(status["early_stop"]["saved"], saved);
    assert_eq!(status["rollouts"]["leased"], 0);
    // Attempts in progress are revoked, and nothing more is leased.
    assert_eq!(worker.commit(&leases[1], true).await, Verdict::Stale);
    assert!(worker.claim(1).await.is_empty());

    let used = planted.configurations;
    let percent = saved * 100 / all;
    let words = format!(
        "stopped early after {used} of 40 configurations: {RULE}; saved {saved} rollouts \
         ({percent} %)"
    );
    let output = serve.command(&["campaign", "status", "early"]);
    assert!(text(&output.stdout).contains(&words), "{}", text(&output.stdout));
    let page = folder.path().join("report.html");
    let page_name = page.to_string_lossy();
    let output = serve.command(&["report", "early", "--full", "--html", &page_name]);
    let output = text(&output.stdout).to_owned();
    let flat = output.split_whitespace().collect::<Vec<_>>().join(" ");
    assert!(flat.contains(&words), "{output}");
    assert!(flat.contains("are not valid"), "{output}");
    assert!(flat.contains("hold together at all looks"), "{output}");
    fits_a_terminal(&output);
    let page = std::fs::read_to_string(page).expect("a page");
    assert!(page.contains("Confidence sequences") && page.contains("Stopped early after"));

    let metrics = http(&serve.url, "GET /metrics").await.text();
    for (state, jobs) in [("queued", 0), ("not_run", saved)] {
        let line = format!("rollout_jobs{{campaign=\"early\",state=\"{state}\"}} {jobs}\n");
        assert!(metrics.contains(&line), "{line}");
    }
    let page = http(&serve.url, "GET /campaigns/early").await.text();
    let words = words.replace('<', "&lt;");
    assert!(page.contains(&words), "the campaign's page lacks the early stop");

    // Figures cover the same configurations as the intervals.
    let report = printed(&serve, &["report", "early", "--json"]);
    for level in ["L1", "L2"] {
        assert_eq!(report["paired"]["p"][level]["n"], used, "{level}");
    }
    let sequential = &report["reports"][0]["sequential"];
    assert_eq!(sequential["has_stopped"], true);
    assert_eq!(sequential["saved"], saved);
    let [low, high] = [0, 1].map(|end| &sequential["levels"]["L2"]["S_sim"][end]);
    let width = high.as_f64().zip(low.as_f64()).map(|(high, low)| high - low);
    assert!(width.is_some_and(|width| width < 0.7), "{width:?}");
    assert_sound(folder.path()).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stopped_campaign_is_final_and_derived_campaigns_use_counted_results() {
    let (folder, serve) = Serve::anew();
    let planted = planted(&spec("early"));
    serve.create(&spec("early"));
    let mut worker = serve.worker("w").await;
    run(&mut worker, planted.rollouts - 1).await;
    // Commits all rollouts of the next configuration, which does not count, and then the last
    // rollout that counts.
    let leases = worker.claim(10).await;
    let later_configuration = id(&leases[9]);
    for lease in leases.iter().rev() {
        let committed = worker.commit(lease, succeeds(&id(lease))).await;
        assert_eq!(committed, Verdict::Accepted);
    }
    stopped(&serve, "early").await;
    for arguments in [
        &["campaign", "resume", "early"][..],
        &["campaign", "pause", "early"],
        &["campaign", "cancel", "early"],
        &["campaign", "set", "early", "--endpoint", "http://127.0.0.1:1"],
        &["jobs", "early", "--retry"],
    ] {
        let output = serve.command(arguments);
        let error = text(&output.stderr);
        assert!(!output.status.success(), "{arguments:?}");
        assert!(error.contains("it stopped early"), "{arguments:?}: {error}");
    }
    serve.create(&spec("early"));
    assert_eq!(status(&serve, "early")["state"], "stopped");

    // The transitions and thresholds of the configurations that count are all explained and
    // measured, although some rollouts will never have an outcome.
    let explained = searched(&serve, &mut worker, &["explain", "early"], planted_outcome).await;
    assert_eq!(explained["explained"], explained["transitions"]);
    let report = printed(&serve, &["report", "early", "--json"]);
    let emergent = |level: &str| report["paired"]["p"][level]["b"].as_u64().expect("a count");
    let compensated = |level: &str| report["paired"]["p"][level]["c"].as_u64().expect("a count");
    let changed: u64 = ["L1", "L2"].map(|level| emergent(level) + compensated(level)).iter().sum();
    assert!(changed > 0);
    assert_eq!(explained["transitions"], changed);
    #[rustfmt::skip]
    let measured = searched(&serve, &mut worker, &[
        "thresholds", "early", "--axes", "simultaneous", "--max-radius", "8", "--tolerance", "4",
    ], planted_outcome).await;
    assert_eq!(measured["looked_for"], planted.configurations);
    assert_eq!(measured["found"], planted.configurations);
    let is_of_later_configuration = |threshold: &Value| {
        let number = later_configuration.config().map(Value::from);
        threshold["task"] == json!(later_configuration.task())
            && Some(&threshold["config"]) == number.as_ref()
    };
    let thresholds = measured["thresholds"].as_array().expect("thresholds");
    assert!(
        !thresholds.iter().any(is_of_later_configuration),
        "{later_configuration} does not count"
    );
    for name in ["early-thresholds", "early-explained", "early"] {
        succeed(serve.command(&["campaign", "delete", name, "--confirm", name]));
    }
    assert_sound(folder.path()).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_kill_around_any_transaction_leaves_the_same_stop_and_report() {
    let planted = planted(&spec("early"));
    let undisturbed = tempfile::tempdir().expect("a temporary folder");
    let serve = Serve::start(undisturbed.path());
    serve.create(&spec("early"));
    run(&mut serve.worker("w").await, planted.rollouts).await;
    let expected = stopped(&serve, "early").await["early_stop"].clone();
    let report = ["report", "early", "--json"];
    let expected_report = serve.command(&report).stdout;
    drop(serve);

    // Consecutive processes: each continues where the previous one was killed, and runs the
    // rollouts before the stop.
    let folder = tempfile::tempdir().expect("a temporary folder");
    let file = undisturbed.path().join("early.json");
    std::fs::write(&file, spec("early").to_string()).expect("written");
    let create = ["campaign", "create", "--spec", file.to_str().expect("UTF-8")];
    let outcome = |id: &RolloutId| match planted.ids[..planted.rollouts].contains(id) {
        true => Outcome::from(succeeds(id)),
        false => Outcome::Missing,
    };
    for (side, step, occurrence) in [
        (Side::Before, Step::CreateCampaign, 1),
        (Side::After, Step::CreateCampaign, 1),
        (Side::Before, Step::Claim, 5),
        (Side::After, Step::Claim, 5),
        (Side::Before, Step::Commit, 9),
        (Side::After, Step::Commit, 9),
        (Side::Before, Step::Stop, 1),
        (Side::After, Step::Stop, 1),
    ] {
        let point = format!("{side:?}:{step:?}:{occurrence}");
        kill_at_failpoint(folder.path(), &point, &create, outcome).await;
        assert_sound(folder.path()).await;
    }
    let serve = Serve::start(folder.path());
    assert_eq!(stopped(&serve, "early").await["early_stop"], expected);
    let final_report = serve.command(&report).stdout;
    assert!(final_report == expected_report, "{}", text(&final_report));
}
