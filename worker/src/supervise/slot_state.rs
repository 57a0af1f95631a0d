//! What a slot is doing, and what is to be done about it: pure. Executing the
//! decisions is the supervisor's business.
//!
//! A slot is a process and a piece of work, and both have their own lives: work
//! whose process died is still delivered, and a process without work waits for
//! some.

use std::time::Duration;

use tokio::time::Instant;

use crate::backoff::Backoff;
use crate::ids::LeaseKey;
use crate::message::FailureKind;

/// Longest time that a slot's process may take to be ready: it hashes an asset
/// pack and loads libraries.
pub(crate) const START_DEADLINE: Duration = Duration::from_secs(120);
/// Longest time that a process may take to let go of a rollout before it is
/// killed. It looks for the order at every control step.
pub(crate) const ABANDON_DEADLINE: Duration = Duration::from_secs(5);
/// Starts of a slot's process that may fail one after the other, without a
/// rollout in between, before the worker gives up.
pub(crate) const MAX_FAILED_STARTS: u32 = 5;

/// Whether the worker takes on work.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Mode {
    /// It does.
    Serving,
    /// It finishes what it has.
    Draining,
    /// It has let go of everything and only delivers, until then at the latest.
    Abandoning {
        /// When it goes, delivered or not.
        until: Instant,
    },
}

/// The process of a slot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum ProcessState {
    /// There is none.
    Down {
        /// When the next may be started.
        until: Instant,
    },
    /// It is not ready yet.
    Starting {
        /// When it is killed if it still is not.
        deadline: Instant,
    },
    /// It takes orders.
    Up,
    /// It was killed and has not ended yet.
    Dying,
}

/// The work of a slot.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Work {
    /// None.
    Nothing,
    /// The coordinator is being asked for a job.
    Claiming,
    /// A rollout is being simulated.
    Running {
        /// Under which lease.
        lease: LeaseKey,
        /// Control steps done.
        control_steps: u32,
        /// When the last of them was reported.
        moved_at: Instant,
    },
    /// The process was killed under a rollout that stood still.
    Stuck {
        /// Under which lease.
        lease: LeaseKey,
        /// Control steps done.
        control_steps: u32,
    },
    /// The lease was lost; the process was told to let go.
    Abandoning {
        /// When it is killed if it has not.
        deadline: Instant,
    },
    /// The coordinator is being told how the rollout ended.
    Delivering {
        /// Under which lease.
        lease: LeaseKey,
        /// Control steps done.
        control_steps: u32,
    },
}

/// One slot.
#[derive(Clone, Debug)]
pub(crate) struct SlotState {
    pub(crate) process: ProcessState,
    pub(crate) work: Work,
    restarts: Backoff,
}

/// What is to be done about a slot now.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Decision {
    /// Start its process.
    Start,
    /// Ask the coordinator for a job.
    Claim,
    /// Kill its process, for this reason.
    Kill(Kill),
}

/// Why a process is killed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Kill {
    /// It never became ready.
    NotReady,
    /// Its rollout stands still.
    Stuck,
    /// It did not let go of its rollout.
    HoldsOn,
}

impl SlotState {
    /// A slot whose first process may start at once.
    pub(crate) fn new(now: Instant, seed: u64) -> Self {
        Self {
            process: ProcessState::Down { until: now },
            work: Work::Nothing,
            restarts: Backoff::new(seed),
        }
    }

    /// What time asks for. The caller does it and writes down that it did.
    pub(crate) fn decide(
        &self,
        mode: Mode,
        progress_timeout: Duration,
        now: Instant,
    ) -> Option<Decision> {
        let serving = mode == Mode::Serving;
        match (&self.process, &self.work) {
            (ProcessState::Down { until }, Work::Nothing) if serving && now >= *until => {
                Some(Decision::Start)
            }
            (ProcessState::Starting { deadline }, _) if now >= *deadline => {
                Some(Decision::Kill(Kill::NotReady))
            }
            (ProcessState::Up, Work::Nothing) if serving => Some(Decision::Claim),
            (ProcessState::Up, Work::Running { moved_at, .. })
                if now.duration_since(*moved_at) >= progress_timeout =>
            {
                Some(Decision::Kill(Kill::Stuck))
            }
            (ProcessState::Up, Work::Abandoning { deadline }) if now >= *deadline => {
                Some(Decision::Kill(Kill::HoldsOn))
            }
            _ => None,
        }
    }

    /// Nothing is left to wait for, in a worker that takes on no more work.
    pub(crate) fn is_done(&self) -> bool {
        self.work == Work::Nothing
    }

    /// The lease that a heartbeat renews, and the progress that it carries.
    pub(crate) fn progress(&self) -> Option<(LeaseKey, u32)> {
        match self.work {
            Work::Running {
                lease,
                control_steps,
                ..
            }
            | Work::Stuck {
                lease,
                control_steps,
            }
            | Work::Delivering {
                lease,
                control_steps,
            } => Some((lease, control_steps)),
            Work::Nothing | Work::Claiming | Work::Abandoning { .. } => None,
        }
    }

    /// The process says that it takes orders.
    pub(crate) fn became_ready(&mut self) {
        if matches!(self.process, ProcessState::Starting { .. }) {
            self.process = ProcessState::Up;
        }
    }

    /// The process reported progress.
    pub(crate) fn advanced(&mut self, steps: u32, now: Instant) {
        if let Work::Running {
            control_steps,
            moved_at,
            ..
        } = &mut self.work
            && steps > *control_steps
        {
            *control_steps = steps;
            *moved_at = now;
        }
    }

    /// The process was killed.
    pub(crate) fn killed(&mut self, why: Kill) {
        self.process = ProcessState::Dying;
        if let (
            Kill::Stuck,
            &Work::Running {
                lease,
                control_steps,
                ..
            },
        ) = (why, &self.work)
        {
            self.work = Work::Stuck {
                lease,
                control_steps,
            };
        }
    }

    /// The process has ended. Returns the lease of the rollout that went with
    /// it and whose fault that was; it is to be delivered.
    pub(crate) fn ended(&mut self, now: Instant) -> Option<(LeaseKey, FailureKind)> {
        self.process = ProcessState::Down {
            until: now + self.restarts.next_wait(),
        };
        let (lease, control_steps, kind) = match self.work {
            Work::Running {
                lease,
                control_steps,
                ..
            } => (lease, control_steps, FailureKind::SlotCrashed),
            Work::Stuck {
                lease,
                control_steps,
            } => (lease, control_steps, FailureKind::SlotStuck),
            Work::Abandoning { .. } => {
                self.work = Work::Nothing;
                return None;
            }
            Work::Nothing | Work::Claiming | Work::Delivering { .. } => return None,
        };
        self.work = Work::Delivering {
            lease,
            control_steps,
        };
        Some((lease, kind))
    }

    /// The process reported the end of its rollout. Returns whether somebody
    /// still wants to know; then it is to be delivered.
    pub(crate) fn rollout_ended(&mut self) -> bool {
        self.restarts.reset();
        match self.work {
            Work::Running {
                lease,
                control_steps,
                ..
            } => {
                self.work = Work::Delivering {
                    lease,
                    control_steps,
                };
                true
            }
            Work::Abandoning { .. } => {
                self.work = Work::Nothing;
                false
            }
            // A report that crossed the kill of its process: the slot is about
            // to end, and its rollout is delivered as stuck.
            Work::Stuck { .. } | Work::Nothing | Work::Claiming | Work::Delivering { .. } => false,
        }
    }

    /// Whether the slot's process never survives its start.
    pub(crate) fn cannot_start(&self) -> bool {
        self.restarts.failures() >= MAX_FAILED_STARTS
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::ids::{Attempt, JobId};

    const TIMEOUT: Duration = Duration::from_secs(180);

    fn lease() -> LeaseKey {
        LeaseKey {
            job: JobId(1),
            attempt: Attempt(1),
        }
    }

    fn running(now: Instant) -> SlotState {
        let mut slot = SlotState::new(now, 1);
        slot.process = ProcessState::Up;
        slot.work = Work::Running {
            lease: lease(),
            control_steps: 0,
            moved_at: now,
        };
        slot
    }

    fn secs(secs: u64) -> Duration {
        Duration::from_secs(secs)
    }

    #[test]
    fn a_rollout_that_stands_still_is_killed_and_reported_as_stuck() {
        let now = Instant::now();
        let mut slot = running(now);
        slot.advanced(10, now + secs(100));
        let decide = |slot: &SlotState, at| slot.decide(Mode::Serving, TIMEOUT, now + secs(at));
        assert_eq!(decide(&slot, 279), None);
        // Saying the same again is no progress.
        slot.advanced(10, now + secs(200));
        assert_eq!(decide(&slot, 280), Some(Decision::Kill(Kill::Stuck)));
        slot.killed(Kill::Stuck);
        assert_eq!(decide(&slot, 281), None);
        let ended = slot.ended(now + secs(281));
        assert_eq!(ended, Some((lease(), FailureKind::SlotStuck)));
        assert_eq!(slot.progress(), Some((lease(), 10)));
    }

    #[test]
    fn a_crash_costs_the_rollout_in_hand_and_nothing_else() {
        let now = Instant::now();
        let mut slot = running(now);
        assert_eq!(slot.ended(now), Some((lease(), FailureKind::SlotCrashed)));
        // Until that is delivered, nothing is started or claimed.
        assert_eq!(slot.decide(Mode::Serving, TIMEOUT, now + secs(60)), None);
        slot.work = Work::Nothing;
        assert_eq!(slot.decide(Mode::Serving, TIMEOUT, now), None);
        let later = now + secs(1);
        assert_eq!(
            slot.decide(Mode::Serving, TIMEOUT, later),
            Some(Decision::Start)
        );
        assert_eq!(slot.ended(later), None);
    }

    #[test]
    fn a_rollout_whose_lease_is_lost_is_let_go_without_a_report() {
        let now = Instant::now();
        let mut slot = running(now);
        slot.work = Work::Abandoning {
            deadline: now + ABANDON_DEADLINE,
        };
        assert_eq!(slot.progress(), None);
        let late = slot.decide(Mode::Serving, TIMEOUT, now + ABANDON_DEADLINE);
        assert_eq!(late, Some(Decision::Kill(Kill::HoldsOn)));
        assert!(!slot.rollout_ended());
        assert!(slot.is_done());
    }

    #[test]
    fn a_process_that_never_becomes_ready_is_given_up_in_the_end() {
        let now = Instant::now();
        let mut slot = SlotState::new(now, 1);
        for _ in 0..MAX_FAILED_STARTS {
            assert!(!slot.cannot_start());
            let deadline = now + START_DEADLINE;
            slot.process = ProcessState::Starting { deadline };
            let late = slot.decide(Mode::Serving, TIMEOUT, deadline);
            assert_eq!(late, Some(Decision::Kill(Kill::NotReady)));
            slot.killed(Kill::NotReady);
            assert_eq!(slot.ended(now), None);
        }
        assert!(slot.cannot_start());
    }

    proptest! {
        /// Whatever happens in whatever order: a draining worker neither starts
        /// nor claims, and no lease is forgotten before it is delivered.
        #[test]
        fn a_draining_worker_takes_on_nothing_and_forgets_no_lease(
            events in proptest::collection::vec(0..6_u8, 0..40)
        ) {
            let start = Instant::now();
            let mut slot = running(start);
            let mut delivered = false;
            for (at, event) in events.into_iter().enumerate() {
                let now = start + secs(30 * at as u64);
                match event {
                    0 => slot.became_ready(),
                    1 => slot.advanced(at as u32, now),
                    2 => delivered |= slot.ended(now).is_some(),
                    3 => delivered |= slot.rollout_ended(),
                    _ => match slot.decide(Mode::Draining, TIMEOUT, now) {
                        Some(Decision::Kill(why)) => slot.killed(why),
                        Some(decision) => prop_assert!(false, "{decision:?}"),
                        None => {}
                    },
                }
                prop_assert_eq!(slot.progress().map(|(lease, _)| lease), Some(lease()));
                let delivering = matches!(slot.work, Work::Delivering { .. });
                prop_assert_eq!(delivered, delivering);
            }
        }
    }
}
