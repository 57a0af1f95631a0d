//! A rollout recorded and replayed through real processes.

use std::process::{Command, Output};

use tests::programs::{Process, program};

fn gateway(arguments: &[&str]) -> Process {
    let mut command = Command::new(program("policy-gateway"));
    Process::serve(command.args(arguments).args(["--listen", "127.0.0.1:0"]))
}

/// Runs one rollout against an endpoint. Returns the worker's output, and success and steps of the
/// result; `None` in their place if there is no result.
fn roll_out(id: &str, endpoint: &str) -> (Output, Option<serde_json::Value>) {
    let folder = tempfile::tempdir().unwrap();
    #[rustfmt::skip]
    let output = Command::new(program("worker"))
        .args([
            "rollout", "--id", id, "--assets", "primitives", "--policy", "expert", "--endpoint",
            endpoint, "--no-video", "--output",
        ])
        .arg(folder.path())
        .output()
        .unwrap();
    let result = std::fs::read_to_string(folder.path().join("result.json")).ok();
    let outcome = result.map(|result| {
        let result: serde_json::Value = serde_json::from_str(&result).unwrap();
        let field = |name: &str| result.pointer(name).cloned().expect(name);
        serde_json::json!([field("/finished/outcome/success"), field("/finished/outcome/steps")])
    });
    (output, outcome)
}

#[test]
fn a_recorded_rollout_replays_identically_without_its_server() {
    let id = "object/t0/camera/L1/c00";
    let folder = tempfile::tempdir().unwrap();
    let recorded = folder.path().join("recorded");
    let recorded = recorded.to_str().unwrap();
    let first = {
        let server = gateway(&["--route", "expert=builtin:expert"]);
        let upstream = server.url.replacen("http://", "grpc://", 1);
        #[rustfmt::skip]
        let mut recorder = gateway(&[
            "record", "--upstream", &upstream, "--output", recorded, "--policy", "expert",
        ]);
        let (_, outcome) = roll_out(id, &recorder.url);
        recorder.signal("-TERM");
        recorder.wait();
        outcome.expect("a result")
    };
    assert!(first[1].as_u64().is_some_and(|steps| steps > 0), "{first}");

    let replay = gateway(&["--route", &format!("expert=replay:{recorded}")]);
    let (_, again) = roll_out(id, &replay.url);
    assert_eq!(again, Some(first));

    let (unrecorded, outcome) = roll_out("object/t0/camera/L1/c01", &replay.url);
    let errors = String::from_utf8_lossy(&unrecorded.stderr);
    assert!(!unrecorded.status.success() && outcome.is_none(), "{errors}");
    assert!(errors.contains("record that rollout first"), "{errors}");
}
