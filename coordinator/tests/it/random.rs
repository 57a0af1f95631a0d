//! Random sequences of events. Whatever happens, attempts only rise, a stale
//! attempt never commits, a paused campaign leases nothing, a cancelled one
//! holds nothing, and every job of another ends with exactly one result or one
//! quarantine. Duplicates and late reports come about by themselves: leases are
//! named whether or not they are still held.
//!
//! A failing sequence is printed, shrunk. Its seed is the line `cc …` that is
//! written into `proptest-regressions` beside this file; the next run, here or
//! wherever the file is copied to, replays it first.

mod pure_core;
mod real_queue;

use coordinator::campaign::Change;
use coordinator::lease::FailureReason;
use proptest::prelude::*;

/// Workers that events speak of.
const WORKERS: usize = 3;
/// Jobs that events speak of.
const JOBS: usize = 4;

/// Something that happens. Jobs, workers and past leases are named by numbers
/// that are taken modulo what there is.
#[derive(Clone, Debug)]
enum Event {
    Claim { worker: usize, job: usize },
    Heartbeat { lease: usize, steps: u32 },
    Commit { lease: usize, success: bool },
    Release { lease: usize, reason: FailureReason },
    Pass { secs: u64 },
    Operate { change: Change },
    Retry { job: usize },
    Restart,
}

fn event() -> impl Strategy<Value = Event> {
    let reason = prop::sample::select(vec![
        FailureReason::SimulatorError,
        FailureReason::SlotCrashed,
        FailureReason::SlotStuck,
        FailureReason::PolicyMisbehaved,
        FailureReason::Unpaired,
        FailureReason::PolicyUnavailable,
        FailureReason::Draining,
    ]);
    let lease = 0..32_usize;
    prop_oneof![
        40 => (0..WORKERS, 0..JOBS).prop_map(|(worker, job)| Event::Claim { worker, job }),
        20 => (lease.clone(), 0..40_u32).prop_map(|(lease, steps)| Event::Heartbeat { lease, steps }),
        20 => (lease.clone(), any::<bool>()).prop_map(|(lease, success)| Event::Commit { lease, success }),
        30 => (lease, reason).prop_map(|(lease, reason)| Event::Release { lease, reason }),
        30 => (1..14_u64).prop_map(|secs| Event::Pass { secs }),
        5 => Just(Event::Operate { change: Change::Pause }),
        8 => Just(Event::Operate { change: Change::Resume }),
        1 => Just(Event::Operate { change: Change::Cancel }),
        6 => (0..JOBS).prop_map(|job| Event::Retry { job }),
        4 => Just(Event::Restart),
    ]
}
