//! Explanations of failures by axes: planted rules of failure are found again, even if the process
//! is killed at any point.

use std::collections::BTreeSet;

use benchmark::{AxisSet, RolloutId};
use paired::Outcome;
use queue::invariants;
use serde_json::{Value, json};

use crate::json::{documented, keys};
use crate::process::{Serve, fail, fits_a_terminal, succeed, text};
use crate::search::{
    assert_kills_change_nothing, assert_rows, complete_findings, run_all, searched,
};

fn set(text: &str) -> AxisSet {
    text.parse().expect("a set of axes")
}

/// Returns the planted outcome of a rollout. The task's index within its suite determines the axes
/// that cause a failure.
pub(crate) fn outcome(id: &RolloutId) -> Outcome {
    let axes = id.condition().axes(AxisSet::ALL);
    let has = |text| set(text).is_subset(axes);
    let fails = match id.task().index() {
        0 | 1 => has("camera+robot"),
        2 => has("camera+lighting+sensor"),
        3 => has("robot+language") || has("camera+sensor"),
        // The robot axis alone causes a failure, and the camera axis compensates for it.
        4 => has("robot") && !has("camera"),
        // Lighting and actuation cause a failure unless sensor is added. All axes together cause a
        // failure, too.
        5 => has("lighting+actuation") && !has("lighting+actuation+sensor") || axes == AxisSet::ALL,
        _ => false,
    };
    Outcome::from(!fails)
}

/// Expected findings, task by task: the start of the search, and the minimal subsets.
const EXPECTED: [(&str, &str, &[&str]); 6] = [
    ("object/t0", "none", &["camera+robot"]),
    ("object/t1", "none", &["camera+robot"]),
    ("object/t2", "none", &["camera+lighting+sensor"]),
    ("object/t3", "none", &["camera+sensor", "robot+language"]),
    ("object/t4", "robot", &["camera+robot"]),
    ("object/t5", "none", &["lighting+actuation"]),
];

fn create(serve: &Serve) {
    create_with(serve, &[]);
}

pub(crate) fn create_with(serve: &Serve, flags: &[&str]) {
    #[rustfmt::skip]
    let arguments = [
        "campaign", "create", "--name", "first", "--policy", "p",
        "--endpoint", "http://127.0.0.1:50051", "--tasks", "libero_object", "--axes", "all",
        "--levels", "L2", "--configs", "0",
    ];
    succeed(serve.command(&[&arguments[..], flags].concat()));
}

pub(crate) async fn explained(serve: &Serve, arguments: &[&str]) -> Value {
    complete_findings(serve, "explain", arguments, outcome).await
}

#[tokio::test(flavor = "multi_thread")]
async fn planted_rules_are_found_again() {
    let (folder, serve) = Serve::anew();
    create(&serve);
    // The explanation can be requested before the campaign is finished.
    let findings_json = explained(&serve, &[]).await;
    assert_eq!(findings_json["transitions"], 6);
    assert_eq!(findings_json["explained"], 6);
    let configurations = findings_json["configurations"].as_array().expect("a list");
    for (configuration, (task, start, minimal)) in configurations.iter().zip(EXPECTED) {
        let name = configuration["configuration"].as_str().expect("a name");
        assert!(name.starts_with(task), "{name}");
        let answer = &configuration["explanation"]["answers"][0];
        assert_eq!(answer["start"], start, "{name}");
        let sets = answer["minimal"].as_array().expect("a list").iter();
        let sets: Vec<&Value> = sets.map(|subset| &subset["set"]).collect();
        assert_eq!(sets, minimal, "{name}");
        let open = answer["minimal"][0]["open"].as_array();
        assert_eq!(open.map(Vec::len), Some(0), "{name} is established");
    }
    // Less than a third of the subsets were run: of each transition's axes, 57 subsets have two or
    // more axes.
    let rollouts = findings_json["rollouts"].as_u64().expect("a number");
    assert!(rollouts < 6 * 57 / 3, "{rollouts} rollouts");
    assert_rows(&serve, "first-explained", (98, "4ec77bbacbfe2c29"));

    // Running all subsets shows further findings.
    let whole = ["--exhaustive", "--name", "whole"];
    let all = explained(&serve, &whole).await;
    let mut printed = BTreeSet::new();
    keys(&all, "", &mut printed);
    assert_eq!(printed, documented("explain"));
    let non_monotone = &all["configurations"][5]["explanation"]["answers"][0]["non_monotone"];
    let pair = json!({
        "minimal": "lighting+actuation", "superset": "lighting+sensor+actuation",
    });
    assert_eq!(non_monotone, &json!([pair]));
    assert_rows(&serve, "whole", (310, "eef3f9f36fe0d3a1"));
    let _ = explained(&serve, &["--repeats", "12", "--name", "repeated"]).await;
    assert_rows(&serve, "repeated", (1512, "a8b6f5dbcd308788"));

    // Running the same search again adds no rollout; the text has the same findings.
    assert_eq!(explained(&serve, &[]).await, findings_json);
    let output = serve.command(&["explain", "first"]);
    let words = text(&output.stdout);
    fits_a_terminal(words);
    let words = words.split_whitespace().collect::<Vec<_>>().join(" ");
    for line in [
        "first-explained explains first: 6 of 6 transitions explained",
        "camera+robot 2 2 ",
        "robot with camera",
        "largest unchanged subsets: ",
    ] {
        assert!(words.contains(line), "{line}: {words}");
    }
    let violations = invariants::check(folder.path()).await.expect("a database");
    assert_eq!(violations, []);
}

/// Regression: `explain` without `--create` created a campaign whose rollouts took slots.
#[tokio::test(flavor = "multi_thread")]
async fn explain_without_create_changes_nothing_and_names_the_flag() {
    let (_folder, serve) = Serve::anew();
    create(&serve);
    let mut worker = serve.worker("w").await;
    run_all(&mut worker, outcome).await;
    for command in ["explain", "thresholds"] {
        for flags in [&[][..], &["--dry-run"], &["--dry-run", "--budget", "100"]] {
            let output = &succeed(serve.command(&[&[command, "first"], flags].concat()));
            assert!(
                output.contains(&format!(
                    "campaign first-{}",
                    ["explained", "thresholds"][usize::from(command != "explain")]
                )),
                "{output}"
            );
            assert!(output.contains("takes at most "), "{output}");
            assert!(
                output.contains(&format!("`coordinator {command} first --create` creates")),
                "{output}"
            );
        }
        let refused = |flags: &[&str], words: &str| {
            let output = serve.command(&[&[command, "first"], flags].concat());
            let error = text(&output.stderr);
            assert!(!output.status.success() && error.contains(words), "{error}");
        };
        refused(&["--json"], "--create` creates it");
        refused(&["--budget", "100"], "--create|--dry-run");
    }
    let output = serve.command(&["explain", "first"]);
    // Six transitions with six axes: 56 subsets each.
    let words = text(&output.stdout);
    assert!(words.contains("at most 336 rollouts for 6 transitions"), "{words}");
    let campaigns = serve.command(&["campaign", "status", "--json"]);
    let campaigns: Value = serde_json::from_slice(&campaigns.stdout).expect("JSON");
    assert_eq!(campaigns["campaigns"].as_array().map(Vec::len), Some(1));
}

#[tokio::test(flavor = "multi_thread")]
async fn invalid_explanations_and_deletion_of_their_source_are_refused() {
    let (folder, serve) = Serve::anew();
    create(&serve);
    let refused = |arguments: &[&str], words: &str| {
        let output = serve.command(arguments);
        let error = text(&output.stderr);
        assert!(!output.status.success(), "{arguments:?}");
        assert!(error.contains(words), "{arguments:?}: {error}");
    };
    refused(&["explain", "second"], "no such campaign");
    refused(&["explain", "first", "--budget", "0"], "--budget");
    #[rustfmt::skip]
    succeed(serve.command(&[
        "campaign", "create", "--name", "alone", "--policy", "p",
        "--endpoint", "http://127.0.0.1:50051", "--tasks", "libero_object/0", "--axes", "camera",
    ]));
    refused(&["explain", "alone"], "an interaction needs at least two axes");
    refused(&["campaign", "status", "alone-explained"], "no such campaign");
    let mut worker = serve.worker("w").await;
    searched(&serve, &mut worker, &["explain", "first"], outcome).await;
    refused(&["explain", "first", "--create", "--budget", "20"], "they differ in `purpose`");
    let delete = ["campaign", "delete", "first", "--confirm", "first"];
    refused(&delete, "campaign `first-explained` is derived from it");

    succeed(serve.command(&["campaign", "set", "first", "--name", "final"]));
    succeed(serve.command(&["explain", "final", "--name", "first-explained"]));

    let spec = json!({
        "name": "other", "rows": [], "purpose": {"explanation": {"campaign": "final"}},
        "policy": {"name": "q", "endpoint": "http://127.0.0.1:50051"},
    });
    let file = folder.path().join("spec.json");
    std::fs::write(&file, spec.to_string()).expect("written");
    let file = file.to_string_lossy();
    refused(
        &["campaign", "create", "--spec", &file],
        "`final` measures policy `p` at http://127.0.0.1:50051",
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn an_explanation_stays_within_its_budget_and_completes_started_transitions() {
    let (_folder, serve) = Serve::anew();
    create(&serve);
    let mut worker = serve.worker("w").await;
    run_all(&mut worker, outcome).await;
    let findings_json = explained(&serve, &["--budget", "60", "--seed", "3"]).await;
    assert_rows(&serve, "first-explained", (60, "6a093cef0c747f1b"));
    let explained = findings_json["explained"].as_u64().expect("a number");
    assert!((1..6).contains(&explained), "{explained}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_kill_around_any_transaction_leaves_the_same_explanation() {
    assert_kills_change_nothing(create, "explain", outcome).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_search_waits_for_its_source_and_needs_one_that_can_finish() {
    let (_folder, serve) = Serve::anew();
    create(&serve);
    let mut worker = serve.worker("w").await;
    let search = searched(&serve, &mut worker, &["explain", "first"], |_| Outcome::Success);
    assert_eq!(search.await["rollouts"], 0, "there are no transitions");
    let status = serve.command(&["campaign", "status", "first-explained"]);
    let status = text(&status.stdout);
    assert!(
        status.contains("no rollouts yet") && status.contains("follows from first"),
        "{status}"
    );

    succeed(serve.command(&["campaign", "set", "first", "--name", "steady"]));
    create(&serve);
    succeed(serve.command(&["campaign", "cancel", "first"]));
    let error = fail(serve.command(&["explain", "first", "--create", "--name", "never"]), 1);
    assert!(error.contains("campaign first was cancelled with 80 rollouts left"), "{error}");
}
