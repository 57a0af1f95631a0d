//! Invalid input: messages name the fault, its place and the remedy.

use std::process::Command;

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
        ("assets --sources /nonexistent", "/nonexistent/robosuite"),
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
