//! Slots that are other programs: the test determines their messages, their output and their exit.

use std::path::Path;

use crate::scripted_coordinator::{ScriptedCoordinator, WorkerMessage};
use crate::worker_process::{WorkerProcess, attempt_id, lease};

/// Writes a program that takes the place of a slot; returns its path.
fn slot_program(folder: &Path, script: &str) -> String {
    let program = folder.join("slot-program");
    std::fs::write(&program, format!("#!/bin/sh\n{script}")).expect("written");
    let mode = std::os::unix::fs::PermissionsExt::from_mode(0o755);
    std::fs::set_permissions(&program, mode).expect("its own file");
    program.to_str().expect("UTF-8").to_owned()
}

/// Shell code of a slot: it reports that it is ready, and has functions that read commands, extract
/// their attempts and send events. A slot's standard input is a socket, so that output to `&0` goes
/// to the parent.
const SHELL_SLOT: &str = r#"
send_line() { printf '%s\n' "$1" >&0; }
send_line '{"ready": {"renderer": "shell", "fingerprint": "ff"}}'
next_attempt() {
    read -r command || exit 0
    attempt=$(printf '%s' "$command" | sed 's/.*"attempt":"\([0-9a-f]*\)".*/\1/')
}
send_event() { send_line '{"rollout": {"attempt": "'"$attempt"'", "event": '"$1"'}}'; }
result() {
    printf '{"finished": {"result": {"success": true, "steps": %s, "wall_secs": 1.0,
        "ik": null, "clipped_actions": 0, "policy_queries": 1,
        "parts": {"physics_secs": 0.5, "drawing_secs": 0.25, "policy_secs": 0.25},
        "goal": {"predicates": 1, "at_end": 1, "at_most": 1}, "realised": {},
        "digests": {"scene": "DIGEST", "init_state": "DIGEST", "first_frame": ""}},
        "provenance": {"host": "", "asset_pack": "", "asset_pack_digest": "", "mujoco_version": "",
        "renderer": "shell", "look": "mujoco-3.3.2", "fingerprint": "DIGEST",
        "realisation": "matched", "policy_name": "p", "policy_checkpoint": "",
        "policy_checkpoint_digest": "", "policy_privileged": false, "policy_canonical_only": false,
        "policy_settings": {}, "batch_mode": "single", "program_version": ""},
        "motion": {"path": [], "actions": []},
        "is_filmed_next": %s}}' "$1" "$2" | tr -d '\n' | sed "s/DIGEST/$(printf '%064d' 0)/g"
}
"#;

async fn worker_with(script: &str, folder: &Path) -> (WorkerProcess, ScriptedCoordinator) {
    let coordinator = ScriptedCoordinator::start().await;
    for job in 1..=2 {
        let mut lease = lease(job, "none", "http://127.0.0.1:9");
        lease.record_video = true;
        coordinator.lease(lease);
    }
    let program = slot_program(folder, &format!("{SHELL_SLOT}{script}"));
    let arguments = ["--slot-program", program.as_str()];
    let worker = WorkerProcess::start_with(&coordinator.url(), &arguments);
    (worker, coordinator)
}

#[tokio::test(flavor = "multi_thread")]
async fn library_output_amid_events_loses_no_event() {
    let folder = tempfile::tempdir().expect("a folder");
    let script = "while :; do
        next_attempt
        printf 'WARNING: half a line'
        send_event '{\"progress\": 10}'
        printf '{\"rollout\": '
        send_event \"$(result 21 false)\"
    done";
    let (worker, coordinator) = worker_with(script, folder.path()).await;
    for job in 1..=2 {
        let commit = coordinator.message(job as usize).await.commit();
        assert_eq!(commit.attempt_id, attempt_id(job));
        assert_eq!(commit.result.steps, 21);
    }
    let log = worker.terminated();
    assert!(log.contains("[slot 0] WARNING: half a line"), "{log}");
}

/// Simulates a crash of the video encoder in every rollout.
#[tokio::test(flavor = "multi_thread")]
async fn a_crash_while_filming_leaves_the_result_committed_and_charges_nobody() {
    let folder = tempfile::tempdir().expect("a folder");
    let script = "next_attempt; send_event \"$(result 21 true)\"; kill -SEGV $$";
    let (worker, coordinator) = worker_with(script, folder.path()).await;
    for job in 1..=2 {
        let commit = coordinator.message(job as usize).await.commit();
        assert_eq!(commit.attempt_id, attempt_id(job));
    }
    coordinator.wait_for_claims(3).await;
    let log = worker.terminated();
    assert!(log.contains("SIGSEGV"), "{log}");
    assert_eq!(coordinator.messages().len(), 3, "no release");
}

#[tokio::test(flavor = "multi_thread")]
async fn messages_about_another_attempt_are_ignored() {
    let folder = tempfile::tempdir().expect("a folder");
    let script = "while :; do
        next_attempt
        own_attempt=$attempt
        attempt=$(printf '%032d' 99)
        send_event \"$(result 99 false)\"
        attempt=$own_attempt
        send_event \"$(result 21 false)\"
    done";
    let (_worker, coordinator) = worker_with(script, folder.path()).await;
    for job in 1..=2 {
        let commit = coordinator.message(job as usize).await.commit();
        let steps = commit.result.steps;
        assert_eq!((commit.attempt_id, steps), (attempt_id(job), 21));
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn slots_with_different_renderers_stop_the_worker() {
    let coordinator = ScriptedCoordinator::start().await;
    let folder = tempfile::tempdir().expect("a folder");
    let script = format!(
        "mkdir {}/first 2> /dev/null && name=one || {{ name=another; sleep 1; }}
         echo '{{\"ready\": {{\"renderer\": \"'$name'\", \"fingerprint\": \"{}\"}}}}' >&0
         cat > /dev/null\n",
        folder.path().display(),
        "f".repeat(64),
    );
    let program = slot_program(folder.path(), &script);
    let arguments = ["--slots", "2", "--slot-program", &program];
    let worker = WorkerProcess::start_with(&coordinator.url(), &arguments);
    let WorkerMessage::Registered(registered) = coordinator.message(0).await else {
        panic!("a worker registers first");
    };
    assert_eq!(registered.renderer, "one");
    let (status, log) = worker.wait();
    assert_eq!(status.code(), Some(1));
    for words in
        ["its renderer is `another`", "is registered with `one`", "one worker for each renderer"]
    {
        assert!(log.contains(words), "{log}");
    }
    assert_eq!(coordinator.messages().len(), 1);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_slot_that_crashes_again_and_again_stops_the_worker_with_the_reason() {
    let coordinator = ScriptedCoordinator::start().await;
    let folder = tempfile::tempdir().expect("a folder");
    let program = slot_program(folder.path(), "echo libEGL is missing >&2\nexit 3\n");
    let worker = WorkerProcess::start_with(&coordinator.url(), &["--slot-program", &program]);
    let (status, log) = worker.wait();
    assert_eq!(status.code(), Some(1));
    for words in ["ended 5 times in a row", "exited with code 3", "libEGL is missing"] {
        assert!(log.contains(words), "{log}");
    }
    let messages = coordinator.messages();
    assert!(messages.is_empty(), "registered without a renderer: {messages:?}");
}
