//! Planted thresholds are found again, even if the process is killed at any point.

use std::collections::BTreeSet;

use benchmark::{Condition, RolloutId};
use paired::Outcome;
use queue::invariants;
use serde_json::{Value, json};

use crate::json::{documented, keys};
use crate::page::http;
use crate::process::{Serve, fits_a_terminal, succeed, text};
use crate::search::{
    assert_kills_change_nothing, assert_rows, complete_findings, findings, searched,
};

/// Returns the planted threshold: the smallest radius at which the rollout's task fails under its
/// condition.
fn failure_radius(id: &RolloutId) -> f64 {
    let task = f64::from(id.task().index());
    match (id.condition(), id.task().index()) {
        // Fails even nominally.
        (_, 9) => 0.0,
        // Fails at no radius that is run.
        (Condition::Single(benchmark::Axis::Robot), 0) => 50.0,
        (Condition::Simultaneous, _) => 0.7 + task / 2.0,
        _ => 1.3 + task,
    }
}

fn outcome(id: &RolloutId) -> Outcome {
    let (radius, from) = (id.level().radius(), failure_radius(id));
    // Under the robot axis, the second task recovers at a larger radius.
    let robot = Condition::Single(benchmark::Axis::Robot);
    let recovers = id.condition() == robot && id.task().index() == 1 && radius == 8.0;
    match id.condition() {
        Condition::Nominal => Outcome::from(from > 0.0),
        _ => Outcome::from(radius < from || recovers),
    }
}

#[rustfmt::skip]
const CREATE: [&str; 14] = [
    "campaign", "create", "--name", "first", "--policy", "p",
    "--endpoint", "http://127.0.0.1:50051", "--tasks", "libero_object", "--levels", "L2",
    "--configs", "0",
];

fn create(serve: &Serve) {
    succeed(serve.command(&[&CREATE[..], &["--axes", "camera,robot"]].concat()));
}

/// Runs all derived rollouts and returns the complete findings.
async fn measured(serve: &Serve, arguments: &[&str]) -> Value {
    complete_findings(serve, "thresholds", arguments, outcome).await
}

fn list<'a>(value: &'a Value, key: &str) -> &'a [Value] {
    value[key].as_array().expect("a list")
}

#[tokio::test(flavor = "multi_thread")]
async fn planted_thresholds_are_found_again() {
    let (folder, serve) = Serve::anew();
    create(&serve);
    // Thresholds can be requested before the campaign is finished.
    let findings_json = measured(&serve, &[]).await;
    let mut printed = BTreeSet::new();
    keys(&findings_json, "", &mut printed);
    assert_eq!(printed, documented("thresholds"));
    assert_eq!([&findings_json["looked_for"], &findings_json["found"]], [30, 30]);
    for threshold in list(&findings_json, "thresholds") {
        let number = |key: &str| threshold[key].as_f64();
        let [condition, task] = ["condition", "task"].map(|key| threshold[key].as_str());
        let (condition, task) = (condition.expect("a name"), task.expect("a name"));
        let suite = task.replace("libero_object/", "object/t");
        let id = format!("{suite}/{condition}/L2/c00").parse().expect("an id");
        let from = failure_radius(&id);
        let is_robot = condition == "robot";
        let recovers = is_robot && task == "libero_object/1";
        assert_eq!(!list(threshold, "recovers_at").is_empty(), recovers, "{id}");
        let kind = threshold["threshold"].as_str().expect("a kind");
        match kind {
            "nominal_fails" => assert_eq!((from, number("fails_at")), (0.0, Some(0.0))),
            "beyond" => assert_eq!((from, number("succeeds_at")), (50.0, Some(16.0))),
            _ => {
                assert_eq!(kind, "between", "{id}");
                let [low, high] =
                    ["succeeds_at", "fails_at"].map(|key| number(key).expect("a radius"));
                assert!(low < from && from <= high, "{id}: {low} to {high} for {from}");
                assert!(high - low <= 0.5, "{id}: {low} to {high}");
            }
        }
    }
    for curve in list(&findings_json, "curves") {
        assert_eq!([&curve["n"], &curve["nominal_fails"]], [10, 1]);
        assert_eq!(curve["points"][0]["survival"], json!(0.9));
        let half = &curve["half_success"];
        let radius = half["radius"].as_f64().expect("half of them fail");
        // Mean of the fifth and sixth of ten thresholds, one of which is 0.
        let median = match curve["condition"].as_str() {
            Some("simultaneous") => 2.45,
            Some("camera") => 4.8,
            _ => 5.8,
        };
        assert!((radius - median).abs() <= 0.75, "{curve}");
        assert!(half["ci95"].is_array(), "{half}");
    }
    // Neither the campaign's own rollouts nor those of a task that fails nominally were run again.
    let jobs = serve.command(&["jobs", "first-thresholds", "--json"]);
    let jobs: Value = serde_json::from_slice(&jobs.stdout).expect("JSON");
    let ids = list(&jobs, "jobs").iter();
    let ids: BTreeSet<&str> = ids.map(|job| job["rollout_id"].as_str().expect("an id")).collect();
    assert_eq!(ids.len(), list(&jobs, "jobs").len());
    assert!(ids.iter().all(|id| !id.contains("/L2/") && !id.contains("t9")));
    assert!(ids.contains("object/t0/camera/L1/c00"), "{ids:?}");

    // Text and figures show the same findings.
    assert_rows(&serve, "first-thresholds", (151, "585103afb9b9429a"));
    assert_eq!(findings(&serve, "thresholds", &[]), findings_json);
    let figures = folder.path().join("figures");
    let figures = figures.to_string_lossy();
    let output = serve.command(&["thresholds", "first", "--figures", &figures]);
    let words = text(&output.stdout);
    fits_a_terminal(words);
    let words = words.split_whitespace().collect::<Vec<_>>().join(" ");
    for line in [
        "first-thresholds measures thresholds of first: 30 of 30 found in ",
        "condition n 0 L1 L2 L3 16 camera 10 90.0",
        "libero_object/1 robot c00 0, 2, 8 2.5, ",
    ] {
        assert!(words.contains(line), "{line}: {words}");
    }
    for name in ["camera", "robot", "simultaneous"] {
        let figure = folder.path().join(format!("figures/survival-{name}.svg"));
        let figure = std::fs::read_to_string(figure).expect("written");
        assert!(figure.contains("still succeed, by radius"), "{figure}");
    }
    // The report of the campaign shows its findings.
    let path = folder.path().join("thresholds.csv");
    let csv = path.to_string_lossy();
    let report = serve.command(&["report", "first-thresholds", "--table", &csv]);
    assert!(text(&report.stdout).contains(text(&output.stdout).trim()), "{report:?}");
    let csv = std::fs::read_to_string(&path).expect("written");
    assert_eq!(csv.lines().count(), 1 + 30, "{csv}");
    assert!(csv.contains("robot,libero_object,0,0,beyond,16,,false,true"), "{csv}");
    let page = http(&serve.url, "GET /campaigns/first-thresholds").await;
    let page = page.text();
    for words in ["<h2>Thresholds</h2>", "30 of 30 found in ", "libero_object/1", "class=\"curve\""]
    {
        assert!(page.contains(words), "{words}");
    }
    // At L1 this task fails under both axes only, but a derived campaign cannot be explained.
    let transition = "/campaigns/first-thresholds/configurations/object/t2/simultaneous/L1/c00";
    let page = http(&serve.url, &format!("GET {transition}")).await;
    assert_eq!(page.code, 200, "{transition}");
    assert!(!page.text().contains("coordinator explain"), "{transition}");
    for more in [&["--create"][..], &["--dry-run"], &[]] {
        let refused = serve.command(&[&["explain", "first-thresholds"], more].concat());
        let error = text(&refused.stderr);
        assert!(error.contains("is itself derived from `first`"), "{error}");
    }
    let violations = invariants::check(folder.path()).await.expect("a database");
    assert_eq!(violations, []);
}

#[tokio::test(flavor = "multi_thread")]
async fn language_is_measured_at_its_own_levels_only() {
    let (_folder, serve) = Serve::anew();
    #[rustfmt::skip]
    succeed(serve.command(&[
        "campaign", "create", "--name", "first", "--policy", "p", "--nominal", "eval",
        "--endpoint", "http://127.0.0.1:50051", "--tasks", "libero_object/4",
        "--levels", "L2", "--configs", "0", "--axes", "camera,language",
    ]));
    let findings_json =
        measured(&serve, &["--axes", "language,simultaneous", "--tolerance", "0.1"]).await;
    assert_eq!(findings_json["rollouts"], 4);
    let jobs = serve.command(&["jobs", "first-thresholds"]);
    for level in ["L1", "L3"] {
        for condition in ["language", "simultaneous"] {
            let id = format!("object/t4/{condition}/{level}/c00");
            assert!(text(&jobs.stdout).contains(&id), "{id}");
        }
    }
    let words = serve.command(&["thresholds", "first"]);
    let words = text(&words.stdout);
    assert!(words.contains("there are wordings at L1, L2 and L3"), "{words}");
}

#[tokio::test(flavor = "multi_thread")]
async fn unmeasurable_thresholds_are_refused_before_creation() {
    let (_folder, serve) = Serve::anew();
    create(&serve);
    let refused = |arguments: &[&str], words: &str| {
        let output = serve.command(arguments);
        let error = text(&output.stderr);
        assert!(!output.status.success(), "{arguments:?}");
        assert!(error.contains(words), "{arguments:?}: {error}");
        let status = serve.command(&["campaign", "status", "first-thresholds"]);
        assert!(!status.status.success(), "{arguments:?}");
    };
    let first = |flags: &[&'static str]| [&["thresholds", "first", "--create"][..], flags].concat();
    refused(&["thresholds", "second"], "no such campaign");
    refused(&first(&["--tolerance", "0"]), "write a radius, 0.01 to 100");
    refused(&first(&["--max-radius", "far"]), "write a radius, 2 to 100");
    for wrong in ["camrea", "nominal", ""] {
        refused(&first(&["--axes", wrong]), "write axes such as camera,robot");
    }
    let missing_condition =
        "it does not run the condition sensor; its conditions are camera, robot, simultaneous";
    refused(&first(&["--axes", "sensor"]), missing_condition);
    refused(&first(&["--budget", "20"]), "may take 24 rollouts");
    #[rustfmt::skip]
    let without_nominal = [&CREATE[..3], &["bare"], &CREATE[4..], &[
        "--axes", "camera", "--nominal", "none",
    ]].concat();
    succeed(serve.command(&without_nominal));
    refused(&["thresholds", "bare", "--create"], "it has no nominal rollouts");

    let mut worker = serve.worker("w").await;
    searched(&serve, &mut worker, &["thresholds", "first"], outcome).await;
    let delete = ["campaign", "delete", "first", "--confirm", "first"];
    let deleted = serve.command(&delete);
    let error = text(&deleted.stderr);
    assert!(error.contains("`first-thresholds` is derived from it"), "{error}");
    let output = serve.command(&first(&["--tolerance", "2"]));
    let error = text(&output.stderr);
    assert!(error.contains("they differ in `purpose`"), "{error}");
    succeed(serve.command(&["campaign", "set", "first", "--name", "final"]));
    succeed(serve.command(&["thresholds", "final", "--name", "first-thresholds"]));
    let output_for_derived = serve.command(&["thresholds", "first-thresholds", "--create"]);
    let error = text(&output_for_derived.stderr);
    assert!(error.contains("is itself derived from `final`"), "{error}");
}

#[tokio::test(flavor = "multi_thread")]
async fn thresholds_stay_within_their_budget() {
    let (_folder, serve) = Serve::anew();
    create(&serve);
    let findings_json = measured(&serve, &["--budget", "100", "--seed", "3"]).await;
    assert_rows(&serve, "first-thresholds", (69, "0893cb4530e0f68a"));
    // Four configurations, each with three conditions and at most 24 rollouts.
    assert_eq!([&findings_json["found"], &findings_json["beyond_budget"]], [12, 18]);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_kill_around_any_transaction_leaves_the_same_thresholds() {
    assert_kills_change_nothing(create, "thresholds", outcome).await;
}
