//! A rollout recorded and replayed through real processes.

use std::path::Path;
use std::process::{Command, Output};

use tests::programs::{Campaigns, Process, program};

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

#[test]
fn a_capsule_repeats_a_rollout_without_policy_and_coordinator() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("f.capsule");
    let path = file.to_str().unwrap();
    let id = "object/t0/simultaneous/L2/c00";
    {
        let campaigns = Campaigns::start(&folder.path().join("data"));
        #[rustfmt::skip]
        campaigns.succeed(&[
            "campaign", "create", "--name", "stored", "--policy", "expert", "--endpoint",
            &campaigns.gateway.url, "--tasks", "libero_object/0", "--axes", "camera,robot,actuation",
            "--levels", "L2", "--configs", "0", "--execution", "hold:2", "--record", "transitions",
        ]);
        let early = campaigns.call(&["jobs", "stored", id, "--capsule", path]);
        assert_eq!(early.status.code(), Some(1));
        let _worker = Process::worker(&campaigns.coordinator.url, 1, "primitives");
        campaigns.wait_for_commits("stored", None);
        campaigns.succeed(&["jobs", "stored", id, "--capsule", path]);
    }
    let repeat = || {
        let output = folder.path().join("repeated");
        let mut worker = Command::new(program("worker"));
        worker.args(["rollout", "--assets", "primitives", "--no-video", "--capsule", path]);
        worker.arg("--output").arg(output).output().unwrap()
    };
    let repeated = repeat();
    let printed = String::from_utf8_lossy(&repeated.stdout);
    assert!(repeated.status.success(), "{repeated:?}");
    assert!(printed.contains("the same outcome, scene, initial state and path"), "{printed}");

    let mut capsule: serde_json::Value =
        serde_json::from_slice(&std::fs::read(&file).unwrap()).unwrap();
    for number in capsule["actions"][20].as_array_mut().unwrap() {
        *number = serde_json::json!(0.5);
    }
    capsule["measurement"]["provenance"]["mujoco_version"] = serde_json::json!("3.2.0");
    std::fs::write(&file, capsule.to_string()).unwrap();
    let altered = repeat();
    let errors = String::from_utf8_lossy(&altered.stderr);
    assert_eq!(altered.status.code(), Some(1), "{errors}");
    for words in
        ["MuJoCo 3.3.7, in the capsule 3.2.0", "another path of the robot from control step"]
    {
        assert!(errors.contains(words), "{words}: {errors}");
    }
}

#[test]
fn a_capsule_receives_what_searches_found() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("f.capsule");
    let path = file.to_str().unwrap();
    let output = folder.path().join("output");
    let campaigns = Campaigns::with_student(&folder.path().join("data"), "builtin:student-boxes");
    #[rustfmt::skip]
    campaigns.succeed(&[
        "campaign", "create", "--name", "first", "--policy", "student", "--endpoint",
        &campaigns.gateway.url, "--tasks", "libero_object/2", "--axes", "all", "--levels", "L2",
        "--configs", "0", "--record", "transitions",
    ]);
    let _worker = Process::worker(&campaigns.coordinator.url, 2, "primitives");
    campaigns.wait_for_commits("first", None);
    campaigns.succeed(&["explain", "first", "--create"]);
    campaigns.succeed(&["jobs", "first", "object/t2/simultaneous/L2/c00", "--capsule", path]);
    let worker = |arguments: &[&str]| {
        let mut worker = Command::new(program("worker"));
        worker.args(arguments).args(["--assets", "primitives", "--no-video", "--capsule", path]);
        worker.arg("--output").arg(&output).output().unwrap()
    };
    let endpoint = &campaigns.gateway.url;
    let rescued = worker(&["rescue", "--endpoint", endpoint, "--policy", "student"]);
    assert!(rescued.status.success(), "{rescued:?}");
    let read = |file: &Path| -> serde_json::Value {
        serde_json::from_slice(&std::fs::read(file).unwrap()).unwrap()
    };
    let (capsule, rescue) = (read(&file), read(&output.join("rescue.json")));
    assert!(rescue["saved_until"].is_u64(), "{rescue}");
    assert_eq!(capsule["saved_until"], rescue["saved_until"]);
    let minimal: Vec<&str> =
        capsule["minimal_axes"].as_array().unwrap().iter().filter_map(|set| set.as_str()).collect();
    let printed = worker(&["rollout"]);
    let printed = String::from_utf8_lossy(&printed.stdout);
    let sets = format!("smallest sets of axes with this outcome: {}", minimal.join(", "));
    let step = format!("saved if its perturbations end at step {}, and", rescue["saved_until"]);
    assert!(!minimal.is_empty() && printed.contains(&sets), "{sets}: {printed}");
    assert!(printed.contains(&step), "{step}: {printed}");

    let other = worker(&["rescue", "--endpoint", endpoint, "--policy", "noop"]);
    let errors = String::from_utf8_lossy(&other.stderr);
    assert!(errors.contains("acts otherwise than in the capsule"), "{errors}");

    let twice = std::fs::read_to_string(&file).unwrap().repeat(2);
    std::fs::write(&file, &twice).unwrap();
    let several = worker(&["rescue", "--endpoint", endpoint, "--policy", "student"]);
    let errors = String::from_utf8_lossy(&several.stderr);
    assert!(errors.contains("it holds 2 rollouts"), "{errors}");
    assert_eq!(std::fs::read_to_string(&file).unwrap(), twice);
}
