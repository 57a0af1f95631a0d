//! The number of slots that suits a machine, by `worker bench` and `--slots auto`.

use std::thread::{available_parallelism, sleep};
use std::time::Duration;

use crate::scripted_coordinator::{ScriptedCoordinator, WorkerMessage};
use crate::worker_process::{WorkerProcess, ready, run, wait_for_the_end_of};

/// A graphics device that does not exist.
const NO_RENDERER: [&str; 2] = ["--renderer", "gl:99"];

#[test]
fn bench_adds_up_slots_and_recommends_a_number() {
    if !ready("bench_adds_up_slots_and_recommends_a_number") {
        return;
    }
    let measured = "bench --assets primitives --slots 2,1 --secs 0.3 --execute 4";
    let ran = run(&measured.split(' ').collect::<Vec<_>>());
    let stderr = String::from_utf8_lossy(&ran.stderr);
    assert!(ran.status.success(), "{stderr}");
    let table = String::from_utf8(ran.stdout).expect("UTF-8");
    println!("{table}");
    assert!(table.lines().all(|line| line.chars().count() <= 80), "{table}");
    // Columns: slots, steps/s, frames/s, slowest–fastest, MiB of a slot, PSS, MiB more.
    let row = |slots: &str| -> Vec<f64> {
        let row = table.lines().map(|line| line.split_whitespace().collect());
        let mut row = row.filter(|row: &Vec<&str>| {
            // The line about the processor may begin with the same number.
            row.len() == 7 && row[0] == slots && row[1].parse::<f64>().is_ok()
        });
        let row = row.next().expect("a row of seven columns");
        row.iter()
            .flat_map(|column| column.split('–'))
            .map(|number| number.parse().expect("a number"))
            .collect()
    };
    for slots in ["1", "2"] {
        let row = row(slots);
        let [count, steps, frames, slowest, fastest, resident, pss, own] = row[..] else {
            panic!("{row:?}")
        };
        assert!(steps > 0.0 && frames > 0.0, "{row:?}");
        assert!(slowest <= fastest && fastest <= steps, "{row:?}");
        // Each number is rounded to a tenth.
        assert!(steps <= count * fastest + 0.2, "{row:?}");
        assert!(0.0 < own && own <= pss && pss <= resident, "{row:?}");
    }
    let last = table.lines().last().expect("a line");
    assert!(
        ["--slots 1,", "--slots 2,"]
            .iter()
            .any(|number| last.starts_with("recommended: ") && last.contains(number)),
        "{last}"
    );
}

#[test]
fn bench_tries_more_slots_for_a_slow_policy() {
    if !ready("bench_tries_more_slots_for_a_slow_policy") {
        return;
    }
    let measured = "bench --assets primitives --secs 1 --execute 20 --policy-secs 0.3";
    let ran = run(&measured.split(' ').collect::<Vec<_>>());
    let stderr = String::from_utf8_lossy(&ran.stderr);
    assert!(ran.status.success(), "{stderr}");
    let table = String::from_utf8(ran.stdout).expect("UTF-8");
    println!("{table}");
    assert!(table.contains("The policy answers after 0.3 s"), "{table}");
    let rows = table.lines().filter_map(|line| {
        let mut columns = line.split_whitespace();
        let slots: usize = columns.next()?.parse().ok()?;
        columns.next()?.parse::<f64>().ok().map(|rate| (slots, rate))
    });
    let rows: Vec<(usize, f64)> = rows.collect();
    let alone = rows.first().expect("a row").1;
    // At most twenty steps follow every answer.
    assert!(alone <= 67.0, "{table}");
    // A single slot keeps no core busy, so more slots than twice the cores are tried, unless memory
    // is too small.
    let cores = available_parallelism().expect("a number of cores").get();
    let tried = table.lines().filter_map(|line| line.split_whitespace().next()?.parse().ok());
    let most: usize = tried
        // The line about the memory begins with a larger number, of MiB.
        .filter(|slots| *slots < 10_000)
        .max()
        .expect("a number");
    assert!(most > 2 * cores, "{most} on {cores}: {table}");
}

#[test]
fn a_slot_that_cannot_be_measured_is_named_with_its_reason() {
    if !ready("a_slot_that_cannot_be_measured_is_named_with_its_reason") {
        return;
    }
    let bench = ["bench", "--assets", "primitives", "--slots", "1"];
    let ran = run(&[&bench[..], &NO_RENDERER].concat());
    let stderr = String::from_utf8_lossy(&ran.stderr);
    assert_eq!(ran.status.code(), Some(1), "{stderr}");
    for words in ["EGL", "slot 0: its process exited with code 1"] {
        assert!(stderr.contains(words), "{stderr}");
    }
}

#[test]
fn measured_slots_end_with_their_parent() {
    if !ready("measured_slots_end_with_their_parent") {
        return;
    }
    let bench = "bench --assets primitives --slots 1 --secs 600";
    let mut bench = WorkerProcess::start_as(&bench.split(' ').collect::<Vec<_>>());
    bench.wait_for_line("slots");
    // The slots start to count as soon as this line is printed.
    sleep(Duration::from_millis(300));
    let slots = bench.slots();
    assert_eq!(slots.len(), 1);
    bench.signal("KILL");
    wait_for_the_end_of(slots[0]);
}

/// Regression: 100,000 slots were started one after the other; the worker reached 5,000 processes,
/// and did not respond to SIGTERM for eleven minutes.
#[test]
fn more_slots_than_the_machine_can_hold_are_refused_before_any_is_started() {
    if !ready("more_slots_than_the_machine_can_hold_are_refused_before_any_is_started") {
        return;
    }
    let worker = WorkerProcess::start_with("http://127.0.0.1:9", &["--slots", "100000"]);
    let (status, log) = worker.wait();
    assert_eq!(status.code(), Some(1), "{log}");
    assert!(log.contains("failed to start 100000 slots: "), "{log}");
    assert!(log.contains("`--slots auto` chooses"), "{log}");
    assert!(!log.contains("[slot "), "{log}");
}

#[tokio::test(flavor = "multi_thread")]
async fn automatic_slots_are_registered_and_explained() {
    if !ready("automatic_slots_are_registered_and_explained") {
        return;
    }
    let coordinator = ScriptedCoordinator::start().await;
    let worker = WorkerProcess::start_with(&coordinator.url(), &["--slots", "auto"]);
    let WorkerMessage::Registered(registered) = coordinator.message(0).await else {
        panic!("a worker registers first");
    };
    let cores = available_parallelism().expect("some cores").get();
    let slots = registered.slots;
    assert!((1..=cores).contains(&(slots as usize)), "{slots} slots");
    let log = worker.terminated();
    // On a busy machine, one slot may be chosen.
    let plural = if slots == 1 { "" } else { "s" };
    for words in [
        format!("--slots auto: {slots}, the fewest that reach 95 %"),
        format!("{cores} cores"),
        format!("{slots} slot{plural}, assets primitives"),
    ] {
        assert!(log.contains(&words), "{words}: {log}");
    }
}

#[test]
fn a_failed_measurement_suggests_a_fixed_number_of_slots() {
    if !ready("a_failed_measurement_suggests_a_fixed_number_of_slots") {
        return;
    }
    let auto = "--connect http://127.0.0.1:9 --assets primitives --slots auto";
    let auto: Vec<&str> = auto.split(' ').collect();
    let ran = run(&[&auto[..], &NO_RENDERER].concat());
    let stderr = String::from_utf8_lossy(&ran.stderr);
    assert_eq!(ran.status.code(), Some(1), "{stderr}");
    for words in ["`--slots N`", "slot 0", "exited with code 1"] {
        assert!(stderr.contains(words), "{words}: {stderr}");
    }
}
