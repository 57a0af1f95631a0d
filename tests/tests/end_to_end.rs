//! Whole campaigns through real processes: coordinator, gateway, workers with
//! their slots, policies, and MuJoCo.

use std::process::Command;

use tests::programs::{Campaigns, Process, program};

const TASKS: &str = "libero_object/0,libero_spatial/0";
/// Five metric axes, alone and simultaneous, and the nominal rollout.
const CONDITIONS: usize = 7;

#[test]
fn the_same_campaign_twice_gives_the_same_outcomes_and_step_counts() {
    let data = tempfile::tempdir().unwrap();
    let campaigns = Campaigns::start(data.path());
    let _worker = Process::worker(&campaigns.coordinator.url, 2, "primitives");
    for name in ["first", "second"] {
        campaigns.create(name, "expert", TASKS, "0-1");
        campaigns.wait_for_commits(name, None);
    }
    let first = campaigns.outcomes("first");
    assert_eq!(first.len(), 2 * 2 * CONDITIONS);
    assert_eq!(first, campaigns.outcomes("second"));
    assert!(first.iter().any(|row| row.contains("\"success\":true")), "the expert never succeeds");

    let report = campaigns.succeed(&["report", "first", "--full"]);
    for word in ["camera", "actuation", "R_e", "R_c", "primitives", "privileged"] {
        assert!(report.contains(word), "no `{word}` in the report:\n{report}");
    }
    assert!(report.lines().all(|line| line.chars().count() <= 80), "{report}");
}

#[test]
fn a_python_policy_answers_from_pixels_through_the_gateway() {
    let Some(python) = std::env::var_os("ROLLOUT_PYTHON") else {
        eprintln!(
            "SKIPPED a_python_policy_answers_from_pixels_through_the_gateway: \
             `cargo xtask test` sets ROLLOUT_PYTHON"
        );
        return;
    };
    let mut policy = Command::new(python);
    policy.args(["-u", "-m", "rollout_policies.examples.colour_servo"]);
    let policy = Process::serve(policy.args(["--listen", "127.0.0.1:0"]));
    roll_out("servo", &policy);
}

#[test]
fn a_typescript_policy_conforms_and_answers_through_the_gateway() {
    let Some(server) = std::env::var_os("ROLLOUT_TYPESCRIPT_POLICY") else {
        eprintln!(
            "SKIPPED a_typescript_policy_conforms_and_answers_through_the_gateway: \
             `cargo xtask test` builds the server and sets ROLLOUT_TYPESCRIPT_POLICY where npm is \
             installed"
        );
        return;
    };
    let policy = Process::serve(Command::new("node").arg(server).arg("127.0.0.1:0"));
    let check = Command::new(program("policy-gateway"))
        .args(["check", &grpc_url(&policy)])
        .output()
        .unwrap();
    let verdicts = String::from_utf8_lossy(&check.stdout);
    assert!(check.status.success(), "{verdicts}");
    roll_out("wander", &policy);
}

fn grpc_url(policy: &Process) -> String {
    policy.url.replacen("http://", "grpc://", 1)
}

/// Runs one rollout with a policy server behind a gateway.
fn roll_out(name: &str, policy: &Process) {
    let mut gateway = Command::new(program("policy-gateway"));
    gateway.args(["--listen", "127.0.0.1:0", "--route", &format!("{name}={}", grpc_url(policy))]);
    let gateway = Process::serve(&mut gateway);
    let output = tempfile::tempdir().unwrap();
    let status = Command::new(program("worker"))
        .args(["rollout", "--id", "spatial/t0/sensor/L1/c00", "--assets", "primitives"])
        .args(["--policy", name, "--endpoint", &gateway.url, "--no-video", "--output"])
        .arg(output.path())
        .status()
        .unwrap();
    assert!(status.success());
    let result = std::fs::read_to_string(output.path().join("result.json")).unwrap();
    assert!(result.contains("first_frame"), "{result}");
}
