//! Invalid input: messages name the fault, its place and the remedy.

use std::process::Command;

use crate::worker_process::run;

fn check(arguments: &[&str], exit_code: i32, expected: &[&str]) {
    let ran = run(arguments);
    let stderr = String::from_utf8_lossy(&ran.stderr);
    assert_eq!(ran.status.code(), Some(exit_code), "{arguments:?}: {stderr}");
    for words in expected {
        assert!(stderr.contains(words), "{arguments:?}: {stderr}");
    }
}

#[test]
fn missing_sources_are_reported_with_the_remedy() {
    let arguments = ["--connect", "http://127.0.0.1:9", "--assets", "primitives"];
    let sources = ["--sources", "/nonexistent"];
    let expected = ["/nonexistent/robosuite", "cargo xtask setup"];
    check(&[arguments, [sources[0], sources[1], "--slots", "2"]].concat(), 1, &expected);
}

/// Options of the command line exclude a subcommand; `ROLLOUT_SOURCES` must not count as one.
#[test]
fn the_environment_names_the_sources_in_every_mode() {
    for mode in [
        "--connect http://127.0.0.1:9 --assets primitives",
        "preview --suite libero_goal --task 0 --assets primitives --output unwritten",
        "slot --assets primitives",
    ] {
        let ran = Command::new(env!("CARGO_BIN_EXE_worker"))
            .args(mode.split(' '))
            .env("ROLLOUT_SOURCES", "/nonexistent")
            .output()
            .expect("runs");
        let stderr = String::from_utf8_lossy(&ran.stderr);
        assert_eq!(ran.status.code(), Some(1), "{mode}: {stderr}");
        assert!(stderr.contains("/nonexistent/robosuite"), "{mode}: {stderr}");
    }
}

/// Slots inherit `COORDINATOR_URL` from their worker but do not use it.
#[test]
fn only_commands_that_call_a_coordinator_check_its_variable() {
    for (mode, problem) in [
        ("--assets primitives --sources /nonexistent", "COORDINATOR_URL"),
        ("film --assets primitives --sources /nonexistent", "COORDINATOR_URL"),
        ("slot --assets primitives --sources /nonexistent", "/nonexistent/robosuite"),
        ("assets list --sources /nonexistent", "/nonexistent/robosuite"),
        (
            "--connect http://127.0.0.1:9 --assets primitives --sources /nonexistent",
            "/nonexistent/robosuite",
        ),
    ] {
        for address in ["", "nowhere:7411"] {
            let ran = Command::new(env!("CARGO_BIN_EXE_worker"))
                .args(mode.split(' '))
                .env("COORDINATOR_URL", address)
                .output()
                .expect("runs");
            let stderr = String::from_utf8_lossy(&ran.stderr);
            assert!(!ran.status.success() && stderr.contains(problem), "{mode}: {stderr}");
        }
    }
}

#[test]
fn a_missing_pack_is_named() {
    let arguments = ["--connect", "http://127.0.0.1:9", "--assets", "no/such/pack"];
    check(&arguments, 1, &["no/such/pack", "`primitives`"]);
}

#[test]
fn invalid_command_lines_exit_with_2() {
    let check = |arguments: &[&str], expected: &str| check(arguments, 2, &[expected]);
    check(&[], "--connect");
    for slots in ["0", "many"] {
        check(&["--connect", "http://127.0.0.1:9", "--slots", slots], "--slots");
    }
    check(&["--connect", "localhost:7411", "--assets", "primitives"], "http://HOST:PORT");
    check(
        &["--connect", "http://127.0.0.1:9", "--assets", "primitives", "--renderer", "gl:card"],
        "`gl:N` for the N-th device",
    );
    check(
        &[
            "rollout",
            "--id",
            "spatial/t0/camra/L2/c00",
            "--endpoint",
            "grpc://h:1",
            "--assets",
            "primitives",
            "--output",
            "out",
        ],
        "camera, lighting",
    );
}
