//! Execution model of a campaign, in each form in which it can be specified.

use proto::coordinator::commit_response::Verdict;
use proto::policy::policy_server::{Policy, PolicyServer};
use proto::policy::{
    DescribeRequest, DescribeResponse, InferRequest, InferResponse, ResetRequest, ResetResponse,
};
use serde_json::{Value, json};
use tokio::net::TcpListener;
use tokio::task::JoinSet;
use tonic::transport::Server;
use tonic::transport::server::TcpIncoming;
use tonic::{Request, Response, Status};

use crate::assertions::assert_contains;
use crate::process::{CREATE, Serve, coordinator, fail, succeed, text};

/// Execution model `overlap` with delays of 3 control steps (weight 812) and 4 (weight 188).
const MODEL: &str = "overlap:3*812+4*188";

fn parse_json(printed: &[u8]) -> Value {
    serde_json::from_str(text(printed)).expect("JSON")
}

#[tokio::test(flavor = "multi_thread")]
async fn results_reports_and_tables_carry_the_execution_model() {
    let (folder, serve) = Serve::anew();
    let late = [&CREATE[..], &["--execution", MODEL]].concat();
    succeed(serve.command(&late));
    let waits = [&CREATE[..2], &["--name", "waits"], &CREATE[4..]].concat();
    serve.run(&waits, 0, &[]);
    let mut worker = serve.worker("a").await;
    for lease in worker.claim(64).await {
        assert_eq!(worker.commit(&lease, true).await, Verdict::Accepted);
    }

    for (name, model) in [("demo", MODEL), ("waits", "wait")] {
        let exported = serve.command(&["export", name, "--format", "jsonl"]);
        let lines = text(&exported.stdout).lines();
        assert_eq!(lines.clone().count(), 14);
        for line in lines {
            let row: Value = serde_json::from_str(line).expect("JSON");
            // The reference's own rows have no such column.
            let expected = (model != "wait").then(|| json!(model));
            assert_eq!(row.get("execution"), expected.as_ref(), "{line}");
        }
        let report = serve.command(&["report", name, "--json"]);
        assert_eq!(parse_json(&report.stdout)["reports"][0]["execution"], model);
        let report = serve.command(&["report", name, "--full"]);
        let words = text(&report.stdout).split_whitespace().collect::<Vec<_>>().join(" ");
        assert!(words.contains(&format!("execution {model} ")), "{words}");
    }

    let rows = folder.path().join("rollouts.jsonl");
    let (path, from) = (rows.to_string_lossy(), folder.path().to_string_lossy());
    succeed(serve.command(&["export", "demo", "--format", "jsonl", "--output", &path]));
    let read = coordinator(&["report", &from, "--json"]);
    assert_eq!(parse_json(&read.stdout)["reports"][0]["execution"], MODEL);
}

#[test]
fn a_dry_run_and_a_manifest_carry_the_execution_model() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = |name: &str| folder.path().join(name).to_string_lossy().into_owned();
    let late = [&CREATE[..], &["--execution", MODEL]].concat();
    // A dry run needs no coordinator.
    let nowhere = ["--connect", "http://127.0.0.1:9"];
    let run = |more: &[&str]| succeed(coordinator(&[&late[..], more, &nowhere].concat()));
    let message = run(&["--dry-run"]);
    let line = format!("execution model {MODEL}: an answer takes effect after 150 to 200 ms");
    assert!(message.contains(&line), "{message}");
    let message = parse_json(run(&["--dry-run", "--json"]).as_bytes());
    assert_eq!(message["execution"], MODEL);
    let waits = coordinator(&[&CREATE[..], &["--dry-run", "--json"], &nowhere].concat());
    assert_eq!(parse_json(&waits.stdout)["execution"], "wait");

    let (spec, rows) = (path("late.json"), path("late.jsonl"));
    std::fs::write(&spec, run(&["--print-spec"])).expect("written");
    succeed(coordinator(&["manifest", "--spec", &spec, "--output", &rows]));
    let written = std::fs::read_to_string(&rows).expect("written");
    let column = format!(r#""execution":"{MODEL}""#);
    assert!(written.lines().all(|line| line.contains(&column)));

    // A campaign of the manifest runs under the manifest's execution model; any other is refused.
    let imported = |more: &[&str]| {
        let flags = [&CREATE[..8], &["--rows", &rows, "--print-spec"], more];
        coordinator(&flags.concat())
    };
    let imported_spec = imported(&[]);
    assert_eq!(parse_json(&imported_spec.stdout)["execution"], MODEL);
    let message = &fail(imported(&["--execution", "hold:2"]), 2);
    assert!(message.contains("`execution` is hold:2"), "{message}");
}

/// A policy that only describes itself, with answers of ten actions.
struct DescribeOnly;

type Answer<T> = Result<Response<T>, Status>;

#[tonic::async_trait]
impl Policy for DescribeOnly {
    async fn describe(&self, request: Request<DescribeRequest>) -> Answer<DescribeResponse> {
        let DescribeRequest { policy, suite, .. } = request.into_inner();
        assert_eq!(suite, "libero_object");
        if policy != "expert" {
            return Err(Status::not_found(format!("this server serves no policy {policy:?}")));
        }
        Ok(Response::new(DescribeResponse {
            protocol_version: proto::PROTOCOL_VERSION,
            name: policy,
            horizon: 10,
            execute: 5,
            ..DescribeResponse::default()
        }))
    }

    async fn reset(&self, _: Request<ResetRequest>) -> Answer<ResetResponse> {
        Err(Status::unimplemented("the test only describes"))
    }

    async fn infer(&self, _: Request<InferRequest>) -> Answer<InferResponse> {
        Err(Status::unimplemented("the test only describes"))
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn delays_as_long_as_the_policys_answers_are_refused_at_creation() {
    let listener = TcpListener::bind("127.0.0.1:0").await.expect("a free port");
    let endpoint = format!("http://{}", listener.local_addr().expect("an address"));
    let policy = Server::builder().add_service(PolicyServer::new(DescribeOnly));
    let mut serving = JoinSet::new();
    serving.spawn(policy.serve_with_incoming(TcpIncoming::from(listener)));
    let (_folder, serve) = Serve::anew();
    let create = |name: &str, model: &str, more: &[&str]| {
        let named = ["campaign", "create", "--name", name];
        let policy = ["--policy", "expert", "--endpoint", &endpoint];
        let rollouts = ["--tasks", "libero_object/0", "--execution", model];
        serve.command(&[&named[..], &policy, &rollouts, more].concat())
    };
    for more in [&[][..], &["--dry-run"]] {
        let message = &fail(create("late", "overlap:10", more), 2);
        assert_contains(
            message,
            &[
                "create campaign late of policy `expert` at http://127.0.0.1:",
                "`overlap:10` drops at least 10 actions of each answer",
                "Choose a delay below 10, `hold:10`",
            ],
        );
    }
    // So is a policy that the endpoint does not serve, unless it is not asked.
    let named = ["campaign", "create", "--name", "typo", "--policy", "exprt"];
    let rollouts = ["--endpoint", &endpoint, "--tasks", "libero_object/0"];
    let message = &fail(serve.command(&[&named[..], &rollouts].concat()), 2);
    assert_contains(message, &["this server serves no policy \"exprt\"", "--no-probe"]);
    let unasked = [&named[..], &rollouts, &["--no-probe"]].concat();
    serve.run(&unasked, 0, &[]);
    // The latency axis is checked too: r20 is ten steps late.
    let axis = ["--axes", "camera,latency", "--levels", "r20"];
    let named = ["campaign", "create", "--name", "axis", "--policy", "expert"];
    let rollouts = ["--endpoint", &endpoint, "--tasks", "libero_object/0"];
    let refused = serve.command(&[&named[..], &rollouts, &axis].concat());
    let message = text(&refused.stderr);
    assert!(message.contains("`overlap:10` drops at least 10"), "{message}");
    // The first model drops every action of some answers only. `hold` drops no action, since the
    // arm holds still while an answer is under way.
    for (name, model) in [("some", "overlap:9*1+12*9"), ("all", "hold:10")] {
        let message = &succeed(create(name, model, &[]));
        assert!(!message.contains("is unknown"), "{message}");
    }
    serving.shutdown().await;
    let waiting = ["--endpoint", &endpoint, "--tasks", "libero_object/1"];
    let waiting = serve.command(
        &[&["campaign", "create", "--name", "early", "--policy", "expert"][..], &waiting].concat(),
    );
    assert!(waiting.status.success());
    let message = text(&waiting.stderr);
    assert!(message.contains("does not answer yet (nothing listens there"), "{message}");
    let created = create("unknown", "overlap:10", &[]);
    assert!(created.status.success(), "{}", text(&created.stderr));
    let message = text(&created.stdout).split_whitespace().collect::<Vec<_>>().join(" ");
    assert_contains(
        &message,
        &[
            "the length of the answers of policy",
            "rollouts fail if overlap:10 drops every action of an answer",
        ],
    );
    let message = &succeed(serve.command(&[&named[..], &rollouts, &axis].concat()));
    let words: Vec<&str> = message.split_whitespace().collect();
    let part = "the arm holds still in rollouts in which overlap:10 drops every action";
    assert!(words.join(" ").contains(part), "{message}");
    let listed = serve.command(&["campaign", "status"]);
    assert!(!text(&listed.stdout).contains("late"), "{}", text(&listed.stdout));
}
