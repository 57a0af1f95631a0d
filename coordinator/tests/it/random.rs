//! Random sequences of events. In any sequence, attempt numbers only rise, a stale attempt never
//! commits, a paused campaign leases nothing, a cancelled campaign holds no lease, and every job of
//! a campaign that is not cancelled ends with exactly one result or in quarantine. Duplicates and
//! late reports occur without events of their own, since an event may name a lease that is no
//! longer held.
//!
//! A failing sequence is printed after shrinking. Its seed is stored as a line `cc …` in
//! `coordinator/tests/proptest-regressions`; the next run replays this sequence first.

mod pure_core;
mod real_queue;

use proptest::prelude::*;
use queue::rules::campaign::Change;
use queue::rules::lease::FailureReason;

const WORKERS: usize = 3;
const JOBS: usize = 4;
/// Number of tasks whose scenes slots may hold.
const TASKS: usize = 2;

/// An event. Jobs, workers and past leases are given by numbers, which are taken modulo the number
/// of those that exist.
#[derive(Clone, Debug)]
enum Event {
    /// A claim with a new id, by a slot that holds no scene or the scene of a task.
    Claim {
        worker: usize,
        job: usize,
        warm: Option<usize>,
    },
    /// A repeated claim, as if its answer had been lost.
    ClaimAgain {
        claim: usize,
    },
    Heartbeat {
        lease: usize,
        steps: u32,
    },
    Commit {
        lease: usize,
        success: bool,
    },
    Release {
        lease: usize,
        reason: FailureReason,
    },
    Pass {
        secs: u64,
    },
    Operate {
        change: Change,
    },
    Retry {
        job: usize,
    },
    Restart,
    /// Concurrent requests: none waits for the answer to another.
    Together(Vec<Event>),
}

fn event() -> impl Strategy<Value = Event> {
    let reason = prop::sample::select(vec![
        FailureReason::SimulatorError,
        FailureReason::SlotCrashed,
        FailureReason::SlotStuck,
        FailureReason::PolicyMisbehaved,
        FailureReason::Unpaired,
        FailureReason::PolicyUnavailable,
        FailureReason::PolicyLost,
        FailureReason::Draining,
    ]);
    let lease = 0..32_usize;
    let warm = prop::option::of(0..TASKS);
    let claim = (0..WORKERS, 0..JOBS, warm).prop_map(|(worker, job, warm)| Event::Claim {
        worker,
        job,
        warm,
    });
    let again = lease.clone().prop_map(|claim| Event::ClaimAgain { claim });
    let heartbeat =
        (lease.clone(), 0..40_u32).prop_map(|(lease, steps)| Event::Heartbeat { lease, steps });
    let commit = (lease.clone(), any::<bool>())
        .prop_map(|(lease, success)| Event::Commit { lease, success });
    let release = (lease, reason).prop_map(|(lease, reason)| Event::Release { lease, reason });
    let worker_event = prop_oneof![
        40 => claim,
        8 => again,
        20 => heartbeat,
        20 => commit,
        30 => release,
    ];
    let together = prop::collection::vec(worker_event.clone(), 2..8).prop_map(Event::Together);
    prop_oneof![
        118 => worker_event,
        25 => together,
        30 => (1..14_u64).prop_map(|secs| Event::Pass { secs }),
        5 => Just(Event::Operate { change: Change::Pause }),
        8 => Just(Event::Operate { change: Change::Resume }),
        1 => Just(Event::Operate { change: Change::Cancel }),
        6 => (0..JOBS).prop_map(|job| Event::Retry { job }),
        4 => Just(Event::Restart),
    ]
}
