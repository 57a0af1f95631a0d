//! Campaigns that end early: where the statistics say on the same outcomes, whatever
//! dies on the way.

use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use paired::{CampaignLook, Outcome, Record, Records};
use proto::coordinator::Lease;
use proto::coordinator::commit_response::Verdict;
use protocol::{CampaignSpec, ManifestRow, RolloutId};
use queue::expand::NewCampaign;
use queue::{FAILPOINT_VARIABLE, Side, Step, invariants};
use serde_json::{Value, json};

use crate::harness::{Worker, rollout_id};
use crate::process::{Serve, coordinator, text};

/// How long the coordinator may take to stop a campaign.
const PATIENCE: Duration = Duration::from_secs(60);
/// How long it is watched not to stop one.
const A_WHILE: Duration = Duration::from_millis(400);
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

/// What is planted: some tasks fail under robot alone, others under all axes together.
fn succeeds(id: &RolloutId) -> bool {
    let condition = id.condition().to_string();
    match id.task().index() {
        0 | 1 => condition != "robot",
        2..5 => condition != "combination",
        _ => true,
    }
}

/// A planted campaign: its rollouts in the order in which they are to be leased, and
/// after how many of them and of its configurations it is to stop.
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
    let look = CampaignLook::when_met(&records, &stop).expect("the rule is met");
    let used = look.used.len();
    assert!((5..look.units - 5).contains(&used), "{used} is no test");
    Planted {
        ids: rows.iter().map(|(id, _)| *id).collect(),
        // Two levels of four conditions, and the nominal rollout.
        rollouts: used * 9,
        configurations: used,
    }
}

fn create(serve: &Serve, folder: &Path, spec: &Value) {
    let file = folder.join(format!("{}.json", spec["name"].as_str().expect("a name")));
    std::fs::write(&file, spec.to_string()).expect("written");
    let file = file.to_string_lossy();
    let created = serve.command(&["campaign", "create", "--spec", &file]);
    assert!(created.status.success(), "{}", text(&created.stderr));
}

fn id(lease: &Lease) -> RolloutId {
    rollout_id(lease).parse().expect("an id")
}

/// Runs so many rollouts. Returns their ids.
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
    let output = serve.command(arguments);
    assert!(output.status.success(), "{}", text(&output.stderr));
    serde_json::from_slice(&output.stdout).expect("JSON")
}

fn status(serve: &Serve, name: &str) -> Value {
    printed(serve, &["campaign", "status", name, "--json"])["campaigns"][0].clone()
}

/// Waits until a campaign has stopped, and returns how it stands.
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
async fn a_campaign_stops_where_its_outcomes_say_and_says_what_that_saved() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let serve = Serve::start(folder.path());
    let planted = planted(&spec("early"));
    create(&serve, folder.path(), &spec("early"));
    let mut worker = serve.worker("w").await;
    let begun = run(&mut worker, planted.rollouts - 1).await;
    assert_eq!(begun, planted.ids[..begun.len()], "in the drawn order");
    tokio::time::sleep(A_WHILE).await;
    let running = status(&serve, "early");
    assert_eq!(running["state"], "running");
    assert_eq!(running["early_stop"]["used"], Value::Null);
    // Until then, the report has intervals for every look.
    let report = printed(&serve, &["report", "early", "--json"]);
    let sequential = &report["reports"][0]["sequential"];
    assert_eq!(sequential["has_stopped"], false);
    assert_eq!(sequential["used"], planted.configurations - 1);

    // The last rollout that counts, and two beyond it.
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
    // What was in flight is taken back, and nothing more is leased.
    assert_eq!(worker.commit(&leases[1], true).await, Verdict::Stale);
    assert!(worker.claim(1).await.is_empty());

    let used = planted.configurations;
    let percent = saved * 100 / all;
    let words = format!(
        "stopped early after {used} of 40 configurations: {RULE}; saved {saved} rollouts \
         ({percent} %)"
    );
    let said = serve.command(&["campaign", "status", "early"]);
    assert!(
        text(&said.stdout).contains(&words),
        "{}",
        text(&said.stdout)
    );
    let page = folder.path().join("report.html");
    let page_name = page.to_string_lossy();
    let said = serve.command(&["report", "early", "--html", &page_name]);
    let said = text(&said.stdout).to_owned();
    let flat = said.split_whitespace().collect::<Vec<_>>().join(" ");
    assert!(flat.contains(&words), "{said}");
    assert!(flat.contains("are not valid"), "{said}");
    assert!(flat.contains("hold together at all looks"), "{said}");
    assert!(
        said.lines().all(|line| line.chars().count() <= 80),
        "{said}"
    );
    let page = std::fs::read_to_string(page).expect("a page");
    assert!(page.contains("Confidence sequences") && page.contains("Stopped early after"));

    // Figures are of the configurations that the intervals rest on.
    let report = printed(&serve, &["report", "early", "--json"]);
    for level in ["L1", "L2"] {
        assert_eq!(report["paired"]["p"][level]["n"], used, "{level}");
    }
    let sequential = &report["reports"][0]["sequential"];
    assert_eq!(sequential["has_stopped"], true);
    assert_eq!(sequential["saved"], saved);
    let [low, high] = [0, 1].map(|end| &sequential["levels"]["L2"]["S_sim"][end]);
    let width = high
        .as_f64()
        .zip(low.as_f64())
        .map(|(high, low)| high - low);
    assert!(width.is_some_and(|width| width < 0.7), "{width:?}");
    let violations = invariants::check(folder.path()).await.expect("a database");
    assert_eq!(violations, []);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stopped_campaign_stays_as_it_is_and_can_be_explained() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let serve = Serve::start(folder.path());
    let planted = planted(&spec("early"));
    create(&serve, folder.path(), &spec("early"));
    let mut worker = serve.worker("w").await;
    run(&mut worker, planted.rollouts).await;
    stopped(&serve, "early").await;
    for arguments in [
        &["campaign", "resume", "early"][..],
        &["campaign", "pause", "early"],
        &["campaign", "cancel", "early"],
        &["campaign", "set-endpoint", "early", "http://127.0.0.1:1"],
        &["jobs", "retry", "early", "--all"],
    ] {
        let output = serve.command(arguments);
        let error = text(&output.stderr);
        assert!(!output.status.success(), "{arguments:?}");
        assert!(error.contains("it stopped early"), "{arguments:?}: {error}");
    }
    create(&serve, folder.path(), &spec("early"));
    assert_eq!(status(&serve, "early")["state"], "stopped");

    // What it has is explained, though some of its rollouts will never have an outcome.
    let began = Instant::now();
    let explained = loop {
        let explained = printed(&serve, &["explain", "early", "--json"]);
        if explained["complete"] == true && explained["rollouts"].as_u64() > Some(0) {
            break explained;
        }
        assert!(began.elapsed() < PATIENCE, "{explained}");
        for lease in worker.claim(64).await {
            let committed = worker.commit(&lease, succeeds(&id(&lease))).await;
            assert_eq!(committed, Verdict::Accepted);
        }
        tokio::time::sleep(Duration::from_millis(50)).await;
    };
    assert_eq!(explained["explained"], explained["transitions"]);
    let deleted = [
        "campaign",
        "delete",
        "early-explained",
        "--confirm",
        "early-explained",
    ];
    assert!(serve.command(&deleted).status.success());
    let deleted = ["campaign", "delete", "early", "--confirm", "early"];
    assert!(serve.command(&deleted).status.success());
    let violations = invariants::check(folder.path()).await.expect("a database");
    assert_eq!(violations, []);
}

#[test]
fn a_rule_that_cannot_end_a_campaign_is_refused_before_anything_is_created() {
    let create = |arguments: &[&str], words: &str| {
        #[rustfmt::skip]
        let campaign = [
            "campaign", "create", "--name", "x", "--policy", "p",
            "--endpoint", "http://127.0.0.1:1", "--tasks", "libero_object",
            "--connect", "http://127.0.0.1:1",
        ];
        let output = coordinator(&[&campaign[..], arguments].concat());
        let error = text(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {error}");
        assert!(error.contains(words), "{arguments:?}: {error}");
    };
    let rule = ["--stop", "I excludes 0"];
    create(&["--stop", "soon"], "valid are width(M) < X");
    create(&["--stop", "difference excludes 0"], "valid are S_sim, R_e");
    create(
        &[&rule[..], &["--axes", "camera"]].concat(),
        "two axes or more",
    );
    create(
        &[&rule[..], &["--replicates", "2"]].concat(),
        "with 2 `replicates`",
    );
    create(&["--stop-seed", "7"], "--stop");
}

/// Serves a folder until it dies at the point, while a worker runs what is to be run.
async fn die_at(folder: &Path, point: &str, planted: &Planted) {
    let child = Command::new(env!("CARGO_BIN_EXE_coordinator"))
        .args(["serve", "--listen", "127.0.0.1:0", "--lease-secs", "3"])
        .arg("--data")
        .arg(folder)
        .env(FAILPOINT_VARIABLE, point)
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .expect("starts");
    let mut serve = Serve::of(child);
    let began = Instant::now();
    let Ok(mut worker) = serve.try_worker("dying").await else {
        return;
    };
    while serve.ended().is_none() {
        assert!(began.elapsed() < PATIENCE, "{point} was never reached");
        run_what_counts(&mut worker, planted).await;
    }
}

/// Claims once, and runs what it gets if that is to be run before the stop.
async fn run_what_counts(worker: &mut Worker, planted: &Planted) {
    let Ok(claim) = worker.try_claim(0.05, "").await else {
        return;
    };
    if let Some(lease) = claim.lease {
        let id = id(&lease);
        if planted.ids[..planted.rollouts].contains(&id) {
            let _ = worker.try_commit(&lease, succeeds(&id)).await;
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_death_around_any_transaction_leaves_the_same_state_and_the_same_report() {
    let planted = planted(&spec("early"));
    let undisturbed = tempfile::tempdir().expect("a temporary folder");
    let serve = Serve::start(undisturbed.path());
    create(&serve, undisturbed.path(), &spec("early"));
    run(&mut serve.worker("w").await, planted.rollouts).await;
    let expected = stopped(&serve, "early").await["early_stop"].clone();
    let report = ["report", "early", "--json"];
    let expected_report = serve.command(&report).stdout;
    drop(serve);

    // One life after the other: each goes on where the one before it died.
    let folder = tempfile::tempdir().expect("a temporary folder");
    let serve = Serve::start(folder.path());
    create(&serve, folder.path(), &spec("early"));
    run(&mut serve.worker("w").await, planted.rollouts - 5).await;
    drop(serve);
    for (side, step) in [
        (Side::Before, Step::Claim),
        (Side::Before, Step::Commit),
        (Side::After, Step::Commit),
        (Side::After, Step::Claim),
        (Side::Before, Step::Stop),
        (Side::After, Step::Stop),
    ] {
        die_at(folder.path(), &format!("{side:?}:{step:?}"), &planted).await;
        let violations = invariants::check(folder.path()).await.expect("a database");
        assert_eq!(violations, [], "{side:?} {step:?}");
    }
    let serve = Serve::start(folder.path());
    assert_eq!(stopped(&serve, "early").await["early_stop"], expected);
    let found = serve.command(&report).stdout;
    assert!(found == expected_report, "{}", text(&found));
}

/// A campaign that has no rule to end by, but the order: its rule is never met.
fn drawn(name: &str, seed: u64) -> Value {
    let mut spec = spec(name);
    spec["levels"] = json!(["L1"]);
    spec["stop"] = json!({"rule": "width(I) < 0.001", "seed": seed});
    spec
}

#[tokio::test(flavor = "multi_thread")]
async fn campaigns_of_one_order_are_compared_at_any_look() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let serve = Serve::start(folder.path());
    let mut worker = serve.worker("w").await;
    // A configuration has five rollouts, of which four are perturbed.
    for (name, configurations) in [("weak", 20), ("strong", 25)] {
        create(&serve, folder.path(), &drawn(name, 7));
        for lease in worker.claim(5 * configurations).await {
            let perturbed = id(&lease).config().is_some();
            let success = name == "strong" || !perturbed;
            assert_eq!(worker.commit(&lease, success).await, Verdict::Accepted);
        }
        assert!(serve.command(&["campaign", "pause", name]).status.success());
    }
    let rule = "difference excludes 0";
    #[rustfmt::skip]
    let found = printed(&serve, &[
        "compare", "strong", "weak", "--sequential", "--stop", rule, "--json",
    ]);
    let sequential = &found["sequential"];
    assert_eq!(sequential["rule"], rule);
    let cells = sequential["cells"].as_array().expect("cells");
    assert_eq!(cells.len(), 4);
    for cell in cells {
        assert_eq!(
            (&cell["used"], &cell["configurations"]),
            (&json!(20), &json!(40))
        );
        // The twenty that were seen differ by one each; of the others, little is known.
        assert!(cell["difference"][0].as_f64() > Some(0.0), "{cell}");
        assert_eq!(cell["difference"][1], 1.0);
        let after = cell["met_after"].as_u64().expect("it is met");
        assert!((2..20).contains(&after), "{cell}");
    }
    // It is there without being asked for, and in words.
    let found = serve.command(&["compare", "strong", "weak"]);
    let words = text(&found.stdout);
    assert!(
        words.contains("20 of 40") && words.contains("seed 7"),
        "{words}"
    );
    assert!(
        words.lines().all(|line| line.chars().count() <= 80),
        "{words}"
    );

    create(&serve, folder.path(), &drawn("elsewhere", 8));
    let mut undrawn = drawn("undrawn", 0);
    undrawn["stop"] = Value::Null;
    create(&serve, folder.path(), &undrawn);
    let mut fewer = drawn("fewer", 7);
    fewer["configs"] = json!([0]);
    create(&serve, folder.path(), &fewer);
    for (other, remedy) in [
        ("elsewhere", "the same `--stop-seed`"),
        ("undrawn", "create both campaigns with `--stop`"),
        ("fewer", "the same tasks and configurations"),
    ] {
        let refused = serve.command(&["compare", "weak", other, "--sequential"]);
        let error = text(&refused.stderr);
        assert_eq!(refused.status.code(), Some(2), "{other}: {error}");
        assert!(error.contains(remedy), "{error}");
        let plain = printed(&serve, &["compare", "weak", other, "--json"]);
        assert!(plain.get("sequential").is_none(), "{other}");
    }
    let refused = serve.command(&["compare", "weak", "strong", "--stop", "I excludes 0"]);
    assert!(text(&refused.stderr).contains("valid are difference"));
}
