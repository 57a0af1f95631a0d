//! Random sequences of events. Whatever happens, attempts only rise, a stale
//! attempt never commits, and every job ends with exactly one result or one
//! quarantine. A failing sequence is printed, shrunk, with its seed.

mod pure_core;
mod real_queue;

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
        4 => (0..WORKERS, 0..JOBS).prop_map(|(worker, job)| Event::Claim { worker, job }),
        2 => (lease.clone(), 0..40_u32).prop_map(|(lease, steps)| Event::Heartbeat { lease, steps }),
        2 => (lease.clone(), any::<bool>()).prop_map(|(lease, success)| Event::Commit { lease, success }),
        3 => (lease, reason).prop_map(|(lease, reason)| Event::Release { lease, reason }),
        3 => (1..14_u64).prop_map(|secs| Event::Pass { secs }),
    ]
}
