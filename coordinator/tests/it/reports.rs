//! What the report says, and that it says the same whatever went wrong on the
//! way.

use proto::coordinator as wire;
use proto::coordinator::commit_response::Verdict;
use proto::coordinator::release_request::Reason;
use serde_json::{Value, json};
use tonic::Code;

use crate::harness::{Bench, Worker, rollout_id, small_spec, with};

fn spec() -> Value {
    let tasks = json!(["libero_object/0", "libero_object/1"]);
    with(
        small_spec("told"),
        json!({"tasks": tasks, "configs": [0, 1]}),
    )
}

/// A deterministic policy: fails under the combination of task 0, else succeeds.
fn outcome(lease: &wire::Lease) -> bool {
    !rollout_id(lease).starts_with("object/t0/combination")
}

async fn run_all(bench: &Bench, worker: &mut Worker) {
    for _ in 0..20 {
        for lease in worker.claim(64).await {
            let success = outcome(&lease);
            assert_eq!(worker.commit(&lease, success).await, Verdict::Accepted);
        }
        bench.pass(10).await;
    }
}

async fn report(bench: &Bench) -> wire::ReportResponse {
    let request = wire::ReportRequest {
        campaign: "told".to_owned(),
    };
    let report = bench.operator().await.report(request).await;
    report.expect("a report").into_inner()
}

#[tokio::test]
async fn a_report_is_the_same_with_and_without_faults() {
    let calm = Bench::start().await;
    calm.create(&spec()).await.expect("created");
    let mut worker = calm.worker("a").await;
    run_all(&calm, &mut worker).await;

    let rough = Bench::start().await;
    rough.create(&spec()).await.expect("created");
    let (mut a, mut b) = (rough.worker("x").await, rough.worker("y").await);
    let lost = a.claim(2).await;
    let leases = b.claim(4).await;
    b.release(&leases[0], Reason::SlotCrashed).await;
    b.release(&leases[1], Reason::PolicyUnavailable).await;
    b.release(&leases[2], Reason::Draining).await;
    rough.pass(60).await;
    let rough = rough.restart().await;
    let mut worker = rough.worker("z").await;
    run_all(&rough, &mut worker).await;
    // The first worker comes back late with the outcome that others found.
    let mut late = rough.worker("x").await;
    let success = outcome(&lost[0]);
    assert_eq!(late.commit(&lost[0], success).await, Verdict::Duplicate);

    let (calm, rough) = (report(&calm).await, report(&rough).await);
    assert_eq!(calm.table, rough.table);
    assert_eq!(calm.json, rough.json);
}

#[tokio::test]
async fn a_finished_campaign_has_its_paired_measures() {
    let bench = Bench::start().await;
    bench.create(&spec()).await.expect("created");
    let mut worker = bench.worker("a").await;
    run_all(&bench, &mut worker).await;
    let report = report(&bench).await;
    let json: Value = serde_json::from_str(&report.json).expect("JSON");
    assert_eq!(json["campaign"], "told");
    assert_eq!(json["realisation"], "matched");
    let paired = &json["cells"][0]["paired"];
    assert_eq!(
        (&paired["n"], &paired["b"], &paired["c"]),
        (&json!(4), &json!(2), &json!(0))
    );
    assert_eq!(paired["i"], json!(-0.5));
    assert_eq!(json["nominal"][0]["count"], json!({"successes": 4, "n": 4}));
    let head = "campaign told\npolicy expert at http://127.0.0.1:50051\n";
    assert!(report.table.starts_with(head), "{}", report.table);
    let widest = report.table.lines().map(|line| line.chars().count()).max();
    assert!(widest <= Some(80), "{}", report.table);
    assert!(
        report.table.contains("say nothing about LIBERO"),
        "{}",
        report.table
    );
    assert!(!report.table.contains("no result yet"), "{}", report.table);
}

#[tokio::test]
async fn a_half_finished_campaign_says_what_is_missing() {
    let bench = Bench::start().await;
    bench.create(&spec()).await.expect("created");
    let empty = report(&bench).await.table;
    assert!(
        empty.contains("16 of 16 rollouts have no result yet"),
        "{empty}"
    );
    let mut worker = bench.worker("a").await;
    for lease in worker.claim(4).await {
        worker.commit(&lease, outcome(&lease)).await;
    }
    let table = report(&bench).await.table;
    assert!(
        table.contains("12 of 16 rollouts have no result yet"),
        "{table}"
    );
    assert!(table.contains("incomplete L1"), "{table}");
}

#[tokio::test]
async fn what_was_set_aside_is_named_with_its_error_and_in_no_rate() {
    let bench = Bench::start().await;
    bench.create(&spec()).await.expect("created");
    let mut alone = bench.worker("alone").await;
    let bad = loop {
        let lease = alone.claim_one().await;
        if rollout_id(&lease) == "object/t1/sensor/L1/c01" {
            break lease;
        }
        alone.commit(&lease, outcome(&lease)).await;
    };
    let mut lease = bad;
    for _ in 0..2 {
        alone.release(&lease, Reason::SimulatorError).await;
        bench.pass(60).await;
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
    assert!(
        report
            .table
            .contains("object/t1/sensor/L1/c01: the bench said so"),
        "{}",
        report.table
    );
    let json: Value = serde_json::from_str(&report.json).expect("JSON");
    assert_eq!(json["quarantined"], json!(["object/t1/sensor/L1/c01"]));
    assert_eq!(json["errors"][0]["last_error"], "the bench said so");
    assert_eq!(json["cells"][0]["paired"]["n"], 3);
    assert_eq!(
        json["cells"][0]["alone"]["sensor"]["count"],
        json!({"successes": 3, "n": 3})
    );
}

#[tokio::test]
async fn a_privileged_policy_and_mixed_origins_are_said_at_the_top() {
    let bench = Bench::start().await;
    bench.create(&spec()).await.expect("created");
    let mut worker = bench.worker_on("a", "libero").await;
    let leases = worker.claim(2).await;
    for (lease, version) in leases.iter().zip(["0.1.0", "0.2.0"]) {
        let mut report = worker.report(lease, true);
        let provenance = report.provenance.as_mut().expect("one");
        provenance.policy_privileged = true;
        provenance.program_version = version.to_owned();
        provenance.policy_checkpoint = format!("step {version}");
        assert_eq!(worker.commit_request(report).await.0, Verdict::Accepted);
    }
    let table = report(&bench).await.table;
    let words = table.split_whitespace().collect::<Vec<_>>().join(" ");
    for warning in [
        "policy `expert` is privileged",
        "more than one program version are mixed",
        "0.1.0; 0.2.0",
        "more than one policy checkpoint are mixed",
    ] {
        assert!(words.contains(warning), "{table}");
    }
    assert!(!words.contains("say nothing about LIBERO"), "{table}");
}

/// No commit lets this happen: the database is altered past the coordinator.
#[tokio::test]
async fn a_report_refuses_to_pool_realisation_modes() {
    let bench = Bench::start().await;
    bench.create(&spec()).await.expect("created");
    let mut worker = bench.worker("a").await;
    let lease = worker.claim_one().await;
    assert_eq!(worker.commit(&lease, true).await, Verdict::Accepted);
    let table = report(&bench).await.table;
    assert!(table.contains("realisation matched"), "{table}");

    let pool = bench.database().await;
    let alter = "UPDATE provenance SET realisation = 'reference'";
    sqlx::query(alter).execute(&pool).await.expect("altered");
    pool.close().await;
    let request = wire::ReportRequest {
        campaign: "told".to_owned(),
    };
    let refused = bench.operator().await.report(request).await;
    let refused = refused.expect_err("two modes");
    assert_eq!(refused.code(), Code::FailedPrecondition);
    for word in [
        "`told`",
        "mode matched",
        "mode reference",
        "campaign of its own",
    ] {
        assert!(refused.message().contains(word), "{refused}");
    }
}
