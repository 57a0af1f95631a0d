//! Content of the report, which does not depend on the faults that occur while a campaign runs.

use benchmark::attempt::Measurement;
use proto::coordinator as wire;
use proto::coordinator::commit_response::Verdict;
use proto::coordinator::release_request::Reason;
use report::Document;
use serde_json::{Value, json};

use crate::harness::{Bench, Worker, rollout_id, small_spec, with};
use crate::process::{Serve, coordinator, fits_a_terminal, succeed, succeed_in_json, text};

/// The published outcomes of OpenVLA-OFT.
const EXAMPLE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../examples/openvla_oft");

fn spec() -> Value {
    let tasks = json!(["libero_object/0", "libero_object/1"]);
    with(small_spec("reported"), json!({"tasks": tasks, "configs": [0, 1]}))
}

/// Returns the outcome of a deterministic policy, which fails only simultaneously in task 0.
fn outcome(lease: &wire::Lease) -> bool {
    !rollout_id(lease).starts_with("object/t0/simultaneous")
}

async fn run_all(bench: &Bench, worker: &mut Worker) {
    for _ in 0..20 {
        for lease in worker.claim(64).await {
            let success = outcome(&lease);
            assert_eq!(worker.commit(&lease, success).await, Verdict::Accepted);
        }
        bench.advance(10).await;
    }
}

struct Report {
    json: Value,
    table: String,
}

async fn report(bench: &Bench) -> Report {
    let request = wire::ReportRequest { campaign: "reported".to_owned() };
    let parts = bench.operator().await.report(request).await;
    let mut parts = parts.expect("a report").into_inner();
    let mut json = Vec::new();
    while let Some(part) = parts.message().await.expect("a part") {
        json.extend(part.json);
    }
    let subject = serde_json::from_slice(&json).expect("a subject");
    let document = Document::new(vec![subject]).expect("no duplicates");
    Report {
        json: serde_json::from_str(&document.json().expect("written")).expect("JSON"),
        table: document.text(),
    }
}

#[tokio::test]
async fn a_report_is_the_same_with_and_without_faults() {
    let undisturbed = Bench::start().await;
    undisturbed.create(&spec()).await.expect("created");
    let mut worker = undisturbed.worker("a").await;
    run_all(&undisturbed, &mut worker).await;

    let disturbed = Bench::start().await;
    disturbed.create(&spec()).await.expect("created");
    let (mut a, mut b) = (disturbed.worker("x").await, disturbed.worker("y").await);
    let lost_leases = a.claim(2).await;
    let leases = b.claim(4).await;
    b.release(&leases[0], Reason::SlotCrashed).await;
    b.release(&leases[1], Reason::PolicyUnavailable).await;
    b.release(&leases[2], Reason::Draining).await;
    disturbed.advance(60).await;
    let disturbed = disturbed.restart().await;
    let mut worker = disturbed.worker("z").await;
    run_all(&disturbed, &mut worker).await;
    // The first worker reports late, with the same outcome as the worker that ran the rollout
    // again.
    let mut late = disturbed.worker("x").await;
    let success = outcome(&lost_leases[0]);
    assert_eq!(late.commit(&lost_leases[0], success).await, Verdict::Duplicate);

    let (undisturbed, disturbed) = (report(&undisturbed).await, report(&disturbed).await);
    assert_eq!(undisturbed.table, disturbed.table);
    assert_eq!(undisturbed.json, disturbed.json);
}

#[tokio::test]
async fn a_finished_campaign_has_its_paired_measures() {
    let bench = Bench::start().await;
    bench.create(&spec()).await.expect("created");
    let mut worker = bench.worker("a").await;
    run_all(&bench, &mut worker).await;
    let report = report(&bench).await;
    let json = &report.json["reports"][0];
    assert_eq!(json["origin"]["campaign"]["name"], "reported");
    assert_eq!(json["realisation"], "matched");
    let paired = &report.json["paired"]["expert"]["L1"];
    assert_eq!(paired, &json["cells"][0]["paired"]);
    assert_eq!((&paired["n"], &paired["b"], &paired["c"]), (&json!(4), &json!(2), &json!(0)));
    assert_eq!(paired["i"], json!(-0.5));
    assert_eq!(json["nominal"]["count"], json!({"successes": 4, "n": 4}));
    let head = "campaign reported, policy expert at http://127.0.0.1:50051\n";
    assert!(report.table.starts_with(head), "{}", report.table);
    let widest = report.table.lines().map(|line| line.chars().count()).max();
    assert!(widest <= Some(80), "{}", report.table);
    assert!(report.table.contains("say nothing about LIBERO"), "{}", report.table);
    assert!(!report.table.contains("no result yet"), "{}", report.table);
}

#[tokio::test]
async fn the_report_of_an_unfinished_campaign_names_missing_rollouts() {
    let bench = Bench::start().await;
    bench.create(&spec()).await.expect("created");
    let empty = report(&bench).await.table;
    assert!(empty.contains("16 of 16 rollouts have no result yet"), "{empty}");
    let mut worker = bench.worker("a").await;
    for lease in worker.claim(4).await {
        worker.commit(&lease, outcome(&lease)).await;
    }
    let table = report(&bench).await.table;
    assert!(table.contains("12 of 16 rollouts have no result yet"), "{table}");
    assert!(table.contains(" missing"), "{table}");
}

#[tokio::test]
async fn quarantined_rollouts_are_listed_with_errors_and_in_no_rate() {
    let bench = Bench::start().await;
    bench.create(&spec()).await.expect("created");
    let mut alone = bench.worker("alone").await;
    let first_lease = loop {
        let lease = alone.claim_one().await;
        if rollout_id(&lease) == "object/t1/sensor/L1/c01" {
            break lease;
        }
        alone.commit(&lease, outcome(&lease)).await;
    };
    let mut lease = first_lease;
    for _ in 0..2 {
        alone.release(&lease, Reason::SimulatorError).await;
        bench.advance(60).await;
        lease = loop {
            let lease = alone.claim_one().await;
            if rollout_id(&lease) == "object/t1/sensor/L1/c01" {
                break lease;
            }
            alone.commit(&lease, outcome(&lease)).await;
        };
    }
    alone.release(&lease, Reason::SimulatorError).await;
    run_all(&bench, &mut alone).await;
    let report = report(&bench).await;
    let row = "object/t1/sensor/L1/c01  simulated failure";
    assert!(report.table.contains(row), "{}", report.table);
    let json = &report.json["reports"][0];
    assert_eq!(json["quarantined"], json!(["object/t1/sensor/L1/c01"]));
    assert_eq!(json["errors"][0]["last_error"], "simulated failure");
    assert_eq!(json["cells"][0]["paired"]["n"], 3);
    let bounds = &json["cells"][0]["bounds"];
    assert_eq!((&bounds["n"], &bounds["affected"]), (&json!(4), &json!(1)));
    assert_eq!(json["cells"][0]["alone"]["sensor"]["count"], json!({"successes": 3, "n": 3}));
}

#[tokio::test]
async fn the_report_warns_of_a_privileged_policy_and_mixed_origins() {
    let bench = Bench::start().await;
    bench.create(&spec()).await.expect("created");
    let mut worker = bench.worker_of_pack("a", "libero").await;
    let leases = worker.claim(2).await;
    for (lease, version) in leases.iter().zip(["0.1.0", "0.2.0"]) {
        let report = worker.report_altered(lease, true, |Measurement { provenance, .. }| {
            provenance.policy_privileged = true;
            provenance.policy_canonical_only = true;
            provenance.program_version = version.to_owned();
            provenance.policy_checkpoint.clear();
        });
        assert_eq!(worker.commit_request(report).await.0, Verdict::Accepted);
    }
    let table = report(&bench).await.table;
    let words = table.split_whitespace().collect::<Vec<_>>().join(" ");
    for warning in [
        "policy `expert` is privileged",
        "policy `expert` always gets the canonical instruction: its language axis is an identity",
        "more than one program version are mixed",
        "0.1.0; 0.2.0",
        "policy `expert` names no checkpoint",
    ] {
        assert!(words.contains(warning), "{table}");
    }
    assert!(!words.contains("say nothing about LIBERO"), "{table}");
}

/// No commit can lead to this state, so the database is altered directly.
#[tokio::test]
async fn the_report_leaves_out_other_realisation_modes_with_a_warning() {
    let bench = Bench::start().await;
    bench.create(&spec()).await.expect("created");
    let mut worker = bench.worker("a").await;
    run_all(&bench, &mut worker).await;
    let table = report(&bench).await.table;
    let words = table.split_whitespace().collect::<Vec<_>>().join(" ");
    assert!(words.contains("realisation matched"), "{table}");

    let pool = bench.database().await;
    for alter in [
        "INSERT INTO provenance (id, origin)
         SELECT 99, json_set(origin, '$.mujoco_version', '3.9.9', '$.realisation', 'reference')
         FROM provenance",
        "UPDATE result SET provenance_id = 99 WHERE job_id =
             (SELECT id FROM job WHERE rollout_id = 'object/t0/simultaneous/L1/c01')",
    ] {
        sqlx::query(alter).execute(&pool).await.expect("altered");
    }
    pool.close().await;
    let report = report(&bench).await;
    assert_eq!(report.json["paired"]["expert"]["L1"]["n"], 3);
    let words: Vec<&str> = report.table.split_whitespace().collect();
    let words = words.join(" ");
    for warning in [
        "realisation modes are mixed: 1 results are of another mode than `matched`",
        "results of more than one MuJoCo version are mixed",
        "1 of 16 rollouts have no result yet",
    ] {
        assert!(words.contains(warning), "{}", report.table);
    }
}

#[test]
fn result_files_are_reported_without_a_coordinator_in_every_form() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = |name: &str| folder.path().join(name).to_string_lossy().into_owned();
    let (html, figures, csv) = (path("report.html"), path("figures"), path("table.csv"));
    let (parquet, latex) = (path("table.parquet"), path("table.tex"));
    #[rustfmt::skip]
    let json = succeed_in_json(coordinator(&[
        "report", EXAMPLE, "--json", "--html", &html, "--figures", &figures,
        "--table", &csv, "--table", &parquet, "--table", &latex,
    ]));
    let l2 = &json["paired"]["OpenVLA-OFT"]["L2"];
    assert_eq!((&l2["b"], &l2["c"]), (&json!(54), &json!(55)));
    let read = |path: &str| std::fs::read(path).expect("written");
    assert!(text(&read(&html)).contains("<title>Robustness of OpenVLA-OFT</title>"));
    assert_eq!(text(&read(&csv)).lines().count(), 1 + 1200);
    assert!(read(&parquet).starts_with(b"PAR1"));
    let written = std::fs::read_dir(&figures).expect("a folder");
    let names = written.map(|entry| entry.expect("an entry").path());
    let is_svg = |path: &std::path::PathBuf| path.extension() == Some("svg".as_ref());
    let (svg, pdf): (Vec<_>, Vec<_>) = names.partition(is_svg);
    assert_eq!(svg.len(), 1 + 3 * 3);
    for path in pdf {
        assert!(std::fs::read(path).expect("read").starts_with(b"%PDF"));
    }
    assert!(text(&read(&latex)).contains("L2 simultaneous & 64.0 & 62.0 & 50.0 & 55.0 & 57.8"));

    let output = coordinator(&["report", EXAMPLE]);
    let table = text(&output.stdout);
    assert!(table.contains("Reproduction gate: -0.4 points"), "{table}");
    fits_a_terminal(table);
}

/// Regression: 500 rollouts of one suite could never decide a gate that needs 2,000.
#[test]
fn a_rate_published_for_one_suite_has_its_own_gate() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let row = |task: u32, state: u32| {
        let success = state != 0;
        format!(
            "{{\"rollout_id\": \"goal/t{task}/nominal/i{state:02}\", \"success\": {success}}}\n"
        )
    };
    let rows: String =
        (0..10).flat_map(|task| (0..50).map(move |state| row(task, state))).collect();
    std::fs::write(folder.path().join("rollouts.jsonl"), rows).expect("written");
    let from = folder.path().to_string_lossy().into_owned();
    let name = folder.path().file_name().expect("a name").to_string_lossy().into_owned();
    let verdict = |published: &str| {
        let published = published.replace("POLICY", &name);
        let output = coordinator(&["report", &from, "--published", &published]);
        assert!(output.status.success(), "{}", text(&output.stderr));
        text(&output.stdout).split_whitespace().collect::<Vec<_>>().join(" ")
    };
    let verdict_text = verdict("libero_goal:POLICY=97");
    assert!(
        verdict_text.contains("gate of libero_goal: +1.0 points from the published 97.0 %"),
        "{verdict_text}"
    );
    assert!(verdict_text.contains("tolerance 5: passed"), "{verdict_text}");
    let verdict_text = verdict("libero_goal:POLICY=80");
    assert!(verdict_text.contains("failed: robustness"), "{verdict_text}");
    let verdict_text = verdict("POLICY=97");
    assert!(verdict_text.contains("undecided: 500 of 2000 nominal rollouts"), "{verdict_text}");
    assert!(verdict_text.contains("SUITE:POLICY=PERCENT"), "{verdict_text}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_campaign_and_published_results_are_reported_side_by_side() {
    let (_folder, serve) = Serve::anew();
    succeed(serve.command(&[
        "campaign",
        "create",
        "--name",
        "own",
        "--policy",
        "expert",
        "--endpoint",
        "http://127.0.0.1:50051",
        "--tasks",
        "libero_object/0-1",
        "--configs",
        "0",
        "--levels",
        "L1",
    ]));
    let mut worker = serve.worker("a").await;
    while let [lease] = worker.claim(1).await.as_slice() {
        assert_eq!(worker.commit(lease, true).await, Verdict::Accepted);
    }
    let json = succeed_in_json(serve.command(&["report", "own", EXAMPLE, "--json"]));
    assert_eq!(json["paired"]["expert"]["L1"]["n"], 2);
    assert_eq!(json["paired"]["OpenVLA-OFT"]["L3"]["b"], 66);
    let warning = json["warnings"][0].as_str().expect("a warning");
    assert!(warning.contains("different realisation modes"), "{warning}");
}
