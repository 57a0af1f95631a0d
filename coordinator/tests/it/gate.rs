//! `coordinator gate` decides by its exit code, and continues where it was.

use std::collections::BTreeSet;
use std::time::Instant;

use benchmark::RolloutId;
use paired::Outcome;
use proto::coordinator::commit_response::Verdict;
use serde_json::Value;

use crate::harness::{Worker, rollout_id};
use crate::json_keys::{documented, keys};
use crate::process::{Serve, coordinator, succeed, text};
use crate::search::{PATIENCE, run_all};

/// Outcome of a policy's rollout.
type Planted = fn(&str, &RolloutId) -> Outcome;

/// Runs a gate to its end, with a worker that runs its rollouts. Returns the exit code and the answer.
async fn gate(
    serve: &Serve,
    worker: &mut Worker,
    arguments: &[&str],
    planted: Planted,
) -> (i32, Value) {
    let arguments = [&["gate", "--json", "--connect", &serve.url], arguments].concat();
    let arguments: Vec<String> = arguments.into_iter().map(str::to_owned).collect();
    let gate = tokio::task::spawn_blocking(move || {
        coordinator(&arguments.iter().map(String::as_str).collect::<Vec<_>>())
    });
    let began = Instant::now();
    while !gate.is_finished() {
        for lease in worker.claim(64).await {
            let id = rollout_id(&lease).parse().expect("an id");
            let success = planted(&lease.policy, &id) == Outcome::Success;
            // A decided gate cancels what still runs.
            let verdict = worker.commit(&lease, success).await;
            assert!(matches!(verdict, Verdict::Accepted | Verdict::Stale), "{verdict:?}");
        }
        assert!(began.elapsed() < PATIENCE, "the gate does not end");
        tokio::time::sleep(std::time::Duration::from_millis(50)).await;
    }
    let output = gate.await.expect("runs");
    let answer: Result<Value, _> = serde_json::from_str(text(&output.stdout));
    let answer = answer.unwrap_or_else(|_| Value::from(text(&output.stderr)));
    (output.status.code().expect("a code"), answer)
}

fn succeeds(_: &str, _: &RolloutId) -> Outcome {
    Outcome::Success
}

/// A policy that fails under simultaneous perturbation only.
fn is_fragile(_: &str, id: &RolloutId) -> Outcome {
    Outcome::from(id.config().is_none())
}

/// Checkpoints of which the third and later ones never succeed.
fn is_spoilt(policy: &str, _: &RolloutId) -> Outcome {
    Outcome::from(policy < "step-3")
}

#[tokio::test(flavor = "multi_thread")]
async fn the_exit_code_is_the_decision_and_the_same_command_continues() {
    let (_folder, serve) = Serve::anew();
    #[rustfmt::skip]
    let create = [
        "campaign", "create", "--name", "first", "--policy", "p",
        "--endpoint", "http://127.0.0.1:50051", "--tasks", "libero_object", "--axes", "camera,sensor",
        "--levels", "L2", "--nominal", "all", "--no-probe",
    ];
    succeed(serve.command(&create));
    let nominal = ["--policy", "q", "--against", "first"];
    let mut worker = serve.worker("w").await;
    // The other campaign is not finished.
    assert_eq!(gate(&serve, &mut worker, &nominal, succeeds).await.0, 3);
    run_all(&mut worker, |_| Outcome::Success).await;

    let few = [&nominal[..], &["--budget", "40"]].concat();
    let (code, answer) = gate(&serve, &mut worker, &few, is_fragile).await;
    assert_eq!((code, &answer["decisions"][0]["rollouts"]), (2, &Value::from(40)), "{answer}");
    let (code, answer) = gate(&serve, &mut worker, &nominal, is_fragile).await;
    let mut found = BTreeSet::new();
    keys(&answer, "", &mut found);
    assert_eq!(found, documented("gate"));
    let decision = &answer["decisions"][0];
    assert_eq!((code, &decision["verdict"]), (0, &Value::from("not_worse")), "{answer}");
    assert!(decision["rollouts"].as_u64().is_some_and(|rollouts| rollouts < 500), "{answer}");
    assert_eq!(gate(&serve, &mut worker, &nominal, is_fragile).await, (code, answer));

    let both = ["--policy", "q", "--against", "first", "--name", "both"];
    let both = [&both[..], &["--conditions", "nominal,simultaneous"]].concat();
    let (code, answer) = gate(&serve, &mut worker, &both, is_fragile).await;
    let conditions = &answer["decisions"][0]["conditions"];
    assert_eq!((code, &conditions[1]["verdict"]), (1, &Value::from("worse")), "{answer}");
    let steps = ["--policy", "step-1,step-2,step-3,step-4", "--against", "first", "--margin", "20"];
    let (code, answer) = gate(&serve, &mut worker, &steps, is_spoilt).await;
    assert_eq!((code, &answer["first_worse"]), (1, &Value::from("step-3")), "{answer}");
    let published = ["--policy", "q", "--against", "published:pi05", "--name", "paper"];
    let published = [&published[..], &["--endpoint", "http://127.0.0.1:50051"]].concat();
    assert_eq!(gate(&serve, &mut worker, &published, is_fragile).await.0, 0);
    for (wrong, reason) in [
        (["--against", "published:nobody"], "it measured π0.5, OpenVLA-OFT"),
        (["--against", "absent"], "absent"),
        (["--againts", "first"], "unexpected argument"),
    ] {
        let output = serve.command(&[&["gate", "--policy", "q"], &wrong[..]].concat());
        assert_eq!(output.status.code(), Some(3), "{reason}");
        assert!(text(&output.stderr).contains(reason), "{}", text(&output.stderr));
    }
}
