//! The number of slots that suits a machine.

use std::thread::available_parallelism;

use crate::scripted_coordinator::{ScriptedCoordinator, WorkerMessage};
use crate::worker_process::WorkerProcess;

/// Regression: 100,000 slots were started one after the other; the worker reached 5,000 processes,
/// and did not respond to SIGTERM for eleven minutes.
#[test]
fn more_slots_than_the_machine_can_hold_are_refused_before_any_is_started() {
    let worker = WorkerProcess::start_with("http://127.0.0.1:9", &["--slots", "100000"]);
    let (status, log) = worker.wait();
    assert_eq!(status.code(), Some(1), "{log}");
    assert!(log.contains("failed to start 100000 slots: "), "{log}");
    assert!(log.contains("`--slots auto` chooses"), "{log}");
    assert!(!log.contains("[slot "), "{log}");
}

#[tokio::test(flavor = "multi_thread")]
async fn automatic_slots_are_registered_and_explained() {
    let coordinator = ScriptedCoordinator::start().await;
    let worker = WorkerProcess::start_with(&coordinator.url(), &["--slots", "auto"]);
    let WorkerMessage::Registered(registered) = coordinator.message(0).await else {
        panic!("a worker registers first");
    };
    let cores = available_parallelism().expect("some cores").get();
    let slots = registered.slots;
    assert!((1..=cores).contains(&(slots as usize)), "{slots} slots");
    let log = worker.terminated();
    // In little memory, one slot may be chosen.
    let plural = if slots == 1 { "" } else { "s" };
    for words in
        [format!("--slots auto: {slots}, "), format!("{slots} slot{plural}, assets primitives")]
    {
        assert!(log.contains(&words), "{words}: {log}");
    }
}
