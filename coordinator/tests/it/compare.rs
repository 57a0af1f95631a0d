//! Comparison of two policies on the command line and on the page.

use benchmark::{Axis, Condition, Directions, Level};
use proto::coordinator as wire;
use proto::coordinator::commit_response::Verdict;
use serde_json::{Value, json};

use crate::harness::{Bench, Worker, rollout_id, small_spec, with};
use crate::page::http;
use crate::process::{Serve, coordinator, fits_a_terminal, succeed, succeed_in_json, text};

/// The published outcomes of OpenVLA-OFT.
const EXAMPLE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../examples/openvla_oft");

/// Runs all jobs: the policy `strong` always succeeds, any other policy fails under simultaneous
/// perturbation only.
async fn run_all(worker: &mut Worker) {
    loop {
        let leases: Vec<wire::Lease> = worker.claim(64).await;
        if leases.is_empty() {
            break;
        }
        for lease in leases {
            let success = lease.policy == "strong" || !rollout_id(&lease).contains("simultaneous");
            assert_eq!(worker.commit(&lease, success).await, Verdict::Accepted);
        }
    }
}

fn create(serve: &Serve, name: &str, policy: &str, more: &[&str]) {
    #[rustfmt::skip]
    let arguments = [
        "campaign", "create", "--name", name, "--policy", policy,
        "--endpoint", "http://127.0.0.1:50051", "--tasks", "libero_object", "--levels", "L1",
    ];
    succeed(serve.command(&[&arguments, more].concat()));
}

#[tokio::test(flavor = "multi_thread")]
async fn two_campaigns_are_compared_over_the_rollouts_that_both_have() {
    let (_folder, serve) = Serve::anew();
    create(&serve, "a", "strong", &["--axes", "camera,sensor", "--configs", "0,1"]);
    create(&serve, "b", "weak", &["--axes", "camera,sensor", "--configs", "0"]);
    run_all(&mut serve.worker("w").await).await;

    let table = &succeed(serve.command(&["compare", "a", "b"]));
    let words = table.split_whitespace().collect::<Vec<_>>().join(" ");
    for row in [
        "A strong at http://127.0.0.1:50051, campaign a",
        "B weak at http://127.0.0.1:50051, campaign b",
        // A succeeds on all of ten tasks, B on none. The p value is that of 2 of 1,024 sign flips,
        // multiplied by four conditions.
        "simultaneous 10 100.0 0.0 +100.0 no spread 10 0 0.008",
        "nominal 10 100.0 100.0 0.0 no spread 0 0 1.000",
        "left out: 40 rollouts that only A has, 0 rollouts that only B has",
        "above 0, A succeeds more often",
    ] {
        assert!(words.contains(row), "no `{row}` in\n{table}");
    }
    fits_a_terminal(table);

    let output = serve.command(&["compare", "b", "a", "--json"]);
    let json: Value = serde_json::from_slice(&output.stdout).expect("JSON");
    assert_eq!(json["a"]["origin"]["campaign"]["name"], "b");
    let last = json["cells"].as_array().and_then(|cells| cells.last());
    let last = last.expect("a cell");
    assert_eq!(last["condition"], "simultaneous");
    assert_eq!(last["difference"]["difference"], json!(-1.0));
    assert_eq!(last["difference"]["no_interval"], "no_spread");
    assert_eq!((&json["only_in_a"], &json["only_in_b"]), (&json!(0), &json!(40)));
    assert_eq!(json["unpaired"], json!({}));
}

#[tokio::test(flavor = "multi_thread")]
async fn compare_takes_a_and_b_in_command_line_order() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let serve = Serve::start(&folder.path().join("data"));
    create(&serve, "a", "strong", &["--configs", "0"]);
    run_all(&mut serve.worker("w").await).await;
    let rows = folder.path().join("rollouts.jsonl");
    let rows = rows.to_string_lossy();
    succeed(serve.command(&["export", "a", "--format", "jsonl", "--output", &rows]));

    let file = folder.path().to_string_lossy();
    for (arguments, is_file_first) in
        [(["compare", &file, "a", "--json"], true), (["compare", "a", &file, "--json"], false)]
    {
        let json = succeed_in_json(serve.command(&arguments));
        assert_eq!(json["a"]["origin"]["file"].is_object(), is_file_first, "{json}");
        let warning = json["warnings"][0].as_str().expect("a warning");
        assert!(warning.contains("asset pack, MuJoCo version, renderer"), "{warning}");
        let compared = json["cells"].as_array().expect("cells").iter();
        let compared: u64 = compared.filter_map(|cell| cell["difference"]["n"].as_u64()).sum();
        assert_eq!(compared, 10 * 7, "five axes, simultaneous, nominal");
    }

    // The published outcomes have another realisation mode.
    let output = serve.command(&["compare", "a", EXAMPLE]);
    let error = text(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{error}");
    assert!(error.contains("different realisation modes"), "{error}");
    assert!(text(&output.stdout).is_empty());
}

#[test]
fn every_pair_of_several_policies_is_compared() {
    let three = ["compare", EXAMPLE, EXAMPLE, EXAMPLE];
    assert!(succeed(coordinator(&three)).contains("A - B of every pair"));
    let json = succeed_in_json(coordinator(&[&three[..], &["--json"]].concat()));
    assert_eq!(json.as_array().map(Vec::len), Some(3));
}

async fn compared(bench: &Bench, names: [&str; 2]) -> report::Comparison {
    let mut subjects = Vec::new();
    for name in names {
        let request = wire::ReportRequest { campaign: name.to_owned() };
        let parts = bench.operator().await.report(request).await;
        let mut parts = parts.expect("a report").into_inner();
        let mut bytes = Vec::new();
        while let Some(part) = parts.message().await.expect("a part") {
            bytes.extend(part.json);
        }
        subjects.push(serde_json::from_slice(&bytes).expect("a subject"));
    }
    let document = report::Document::new(subjects).expect("no duplicates");
    let [a, b] = document.analyses.as_slice() else {
        panic!("there are two subjects");
    };
    let setups = [&a.subject.setups, &b.subject.setups];
    report::Comparison::of([a, b], setups).expect("comparable")
}

/// Configuration 10 is drawn from the design's seed: rollouts of two designs with the same ids have
/// different perturbations and initial states.
#[tokio::test]
async fn rollouts_of_different_designs_with_equal_ids_are_not_paired() {
    let bench = Bench::start().await;
    for (name, seed) in [("a", 0), ("b", 1), ("c", 0)] {
        let changes = json!({"configs": [0, 10], "design_seed": seed, "nominal": "none"});
        let spec = with(small_spec(name), changes);
        bench.create(&spec).await.expect("created");
    }
    let statistics = compared(&bench, ["a", "b"]).await.statistics;
    let unpaired: Vec<String> =
        statistics.unpaired.values().flatten().map(|id| id.to_string()).collect();
    assert_eq!(unpaired.len(), 3, "{unpaired:?}");
    assert!(unpaired.iter().all(|id| id.ends_with("c10")), "{unpaired:?}");
    assert_eq!(statistics.shared(), 3, "configuration 0 is the same in both");
    let same_seed = compared(&bench, ["a", "c"]).await.statistics;
    assert_eq!((same_seed.shared(), same_seed.unpaired.len()), (6, 0));
}

/// The harness's successes take 120 steps and hold both predicates of the goal; its failures take
/// 280 steps and hold at most one predicate at a time.
#[tokio::test]
async fn a_comparison_includes_progress_and_design() {
    let bench = Bench::start().await;
    let policy = json!({"name": "strong", "endpoint": "http://127.0.0.1:50051"});
    let changes = json!({"levels": ["L0", "L1"], "directions": "own"});
    for (name, more) in [("a", json!({"policy": policy})), ("b", json!({"placebo_radius": 0.05}))] {
        let spec = with(with(small_spec(name), changes.clone()), more);
        bench.create(&spec).await.expect("created");
    }
    run_all(&mut bench.worker("w").await).await;
    let comparison = compared(&bench, ["a", "b"]).await;
    assert_eq!(comparison.statistics.directions, Directions::Own);
    let warnings = &comparison.warnings;
    let has_warning = warnings.iter().any(|text| text.contains("placebo levels"));
    assert!(has_warning, "{warnings:?}");
    let differences = |condition| {
        let mut cells = comparison.statistics.cells.iter();
        let cell = cells.find(|cell| (cell.level, cell.condition) == (Level::L1, condition));
        let progress = cell.expect("a cell").progress.expect("progress");
        let values = [progress.goal, progress.steps];
        values.map(|value| value.map(|row| row.difference.value))
    };
    assert_eq!(differences(Condition::Simultaneous), [Some(0.5), Some(-160.0)]);
    assert_eq!(differences(Condition::Single(Axis::Camera)), [Some(0.0), Some(0.0)]);
}

#[tokio::test(flavor = "multi_thread")]
async fn two_campaigns_are_compared_on_the_page() {
    let bench = Bench::start().await;
    let first = with(
        small_spec("first"),
        json!({"policy": {"name": "strong", "endpoint": "http://127.0.0.1:50051"}}),
    );
    bench.create(&first).await.expect("created");
    let list = http(&bench.url, "GET /").await.text();
    assert!(!list.contains("action=\"/compare\""), "a single campaign has no comparison form");
    bench.create(&small_spec("second")).await.expect("created");
    let mut worker = bench.worker("w").await;
    run_all(&mut worker).await;

    // Requests a different address, since a page is cached for a second.
    let list = http(&bench.url, "GET /?later").await.text();
    assert!(list.contains("action=\"/compare\""), "{list}");
    let form = http(&bench.url, "GET /compare").await;
    assert!(form.text().contains("<option value=\"first\""), "{}", form.text());
    let answer = http(&bench.url, "GET /compare?a=first&b=second").await.text();
    for words in [
        "first against second",
        "strong − expert",
        "L1 simultaneous",
        "+100.0",
        "too few tasks",
        "Partial progress",
    ] {
        assert!(answer.contains(words), "no `{words}` in\n{answer}");
    }
    let missing = http(&bench.url, "GET /compare?a=first&b=third").await;
    assert!(missing.text().contains("There is no such campaign"));
    // Campaigns that cannot be compared also give a page, not an error.
    let other = with(small_spec("other"), json!({"realisation": "reference"}));
    bench.create(&other).await.expect("created");
    let refused = http(&bench.url, "GET /compare?a=first&b=other").await.text();
    for words in ["These campaigns cannot be compared", "different realisation modes"] {
        assert!(refused.contains(words), "no `{words}` in\n{refused}");
    }
}
