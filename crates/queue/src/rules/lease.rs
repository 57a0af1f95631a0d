//! What may happen to one job: its states, what moves it between them, and how an
//! attempt without a result is charged. Not responsible for which job is leased
//! next (`choice`) nor for a policy's outages (`outage`).

use std::time::Duration;

use attempt::{AttemptId, Waits};
use rand_chacha::rand_core::Rng;
use serde::Deserialize;

use crate::clock::UnixMillis;
use crate::ids::{AttemptNumber, JobId, WorkerId};

/// Charged attempts after which a job is quarantined.
pub const MAX_CHARGED_ATTEMPTS: u32 = 3;
/// Workers on which a job must have failed before it is quarantined, if that
/// many are alive: one broken machine must not put a rollout into quarantine.
pub const MIN_WORKERS_TO_QUARANTINE: u32 = 2;
/// Failures of its machine in a row after which a worker leases no more.
pub const MAX_WORKER_FAILURES_IN_A_ROW: u32 = 5;

/// One rollout × replicate, as far as leasing goes.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
pub struct Job {
    /// Which one.
    pub id: JobId,
    /// Leases granted so far.
    pub attempt: AttemptNumber,
    /// Attempts that ended in a failure of policy, machine or simulator.
    pub charged_attempts: u32,
    /// Where it stands.
    pub state: JobState,
}

/// Where a job stands. The store's CHECK constraints say the same.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(tag = "is", rename_all = "snake_case")]
pub enum JobState {
    /// Waits to be leased, not before an instant.
    Queued {
        /// End of its back-off.
        not_before: UnixMillis,
    },
    /// A worker holds its lease.
    Leased(Lease),
    /// Its result is stored. Final.
    Committed,
    /// Taken out after too many charged attempts, until an operator retries it.
    Quarantined,
}

/// A lease: one attempt at one job, by one worker.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
pub struct Lease {
    /// The attempt's name.
    pub attempt: AttemptId,
    /// Its worker.
    pub owner: WorkerId,
    /// Since when.
    pub granted: UnixMillis,
    /// Until when, unless a heartbeat renews it.
    pub expires: UnixMillis,
    /// Past this instant no heartbeat renews it.
    pub ceiling: UnixMillis,
    /// Whether a heartbeat of its worker has named it.
    pub is_acknowledged: bool,
}

/// The part of a result that two reports of one rollout must share. Wall time is
/// no part of it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
pub struct OutcomeKey {
    /// Whether the goal was reached.
    pub success: bool,
    /// The policy's control steps.
    pub steps: u32,
}

/// What becomes of a reported result, before its siblings are looked at.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CommitJudgement {
    /// The attempt holds the lease: store it.
    Accept,
    /// Stored already, with this outcome: fine.
    Duplicate,
    /// Stored already, with another outcome: keep it apart.
    Divergent,
    /// The lease is gone: refuse and count.
    Stale,
}

/// Whom a failure counts against.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Party {
    /// The policy: it pauses after a run of them.
    Policy,
    /// The worker's machine: it leases no more after a run of them.
    Machine,
    /// The simulator, which fails in the same way wherever it runs.
    Simulator,
}

/// Why an attempt brought no result.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum FailureReason {
    /// The simulator failed: the physics diverged, or a scene is inconsistent.
    SimulatorError,
    /// The worker's machine failed: a file, memory, graphics.
    MachineError,
    /// The slot's process died.
    SlotCrashed,
    /// The slot's progress stopped.
    SlotStuck,
    /// The policy's answer broke its protocol.
    PolicyMisbehaved,
    /// The lease expired: its worker's heartbeats stopped.
    LeaseLost,
    /// The attempt reached its ceiling.
    Overdue,
    /// The result disagreed with its configuration's siblings.
    Unpaired,
    /// The policy cannot be reached or is overloaded.
    PolicyUnavailable,
    /// The worker drains.
    Draining,
    /// The campaign was cancelled.
    Cancelled,
    /// Another worker's result pinned the campaign to what this one does not run
    /// on.
    Unsuited,
    /// The lease expired before a heartbeat named it: the answer to its claim was
    /// lost.
    NeverAcknowledged,
}

/// What a failed attempt's job does next.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AfterFailure {
    /// Back in the queue, not before an instant.
    Requeue {
        /// End of its back-off.
        not_before: UnixMillis,
    },
    /// Into quarantine.
    Quarantine,
}

/// What decides whether a failed job is quarantined.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Suspicion {
    /// Distinct workers with a charged failure of this job, this one included.
    pub failed_on_workers: u32,
    /// Workers alive now that could run it.
    pub able_workers: u32,
}

/// The failures in a row of a worker's machine, after one more.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Strike {
    /// How many.
    pub in_a_row: u32,
    /// Whether it may lease no more.
    pub stop: bool,
}

impl Job {
    /// Its lease, if this very attempt holds it. An expired lease is held until
    /// it is taken away: the attempt is what fences, not the clock.
    pub fn lease_of(&self, attempt: AttemptId) -> Option<&Lease> {
        match &self.state {
            JobState::Leased(lease) if lease.attempt == attempt => Some(lease),
            _ => None,
        }
    }

    /// What becomes of an outcome that `attempt`, one of this job's, reports.
    /// `stored` is the committed outcome, if there is one.
    pub fn judge_commit(
        &self,
        attempt: AttemptId,
        reported: OutcomeKey,
        stored: Option<OutcomeKey>,
    ) -> CommitJudgement {
        match stored {
            None if self.lease_of(attempt).is_some() => CommitJudgement::Accept,
            None => CommitJudgement::Stale,
            Some(stored) if stored == reported => CommitJudgement::Duplicate,
            Some(_) => CommitJudgement::Divergent,
        }
    }

    /// What this leased job does after its attempt failed.
    pub fn after_failure(
        &self,
        reason: FailureReason,
        suspicion: Suspicion,
        now: UnixMillis,
        rng: &mut impl Rng,
    ) -> AfterFailure {
        if !reason.is_charged() {
            return AfterFailure::Requeue { not_before: now };
        }
        let charged = self.charged_attempts + 1;
        let workers_needed = match reason.blames() {
            Some(Party::Policy) => 1,
            _ => MIN_WORKERS_TO_QUARANTINE.min(suspicion.able_workers),
        };
        if charged >= MAX_CHARGED_ATTEMPTS && suspicion.failed_on_workers >= workers_needed {
            return AfterFailure::Quarantine;
        }
        let wait = Waits::USUAL.after(charged, rng.next_u32());
        AfterFailure::Requeue {
            not_before: now.plus(wait.max(Waits::USUAL.first)),
        }
    }
}

impl Lease {
    /// Why this lease has expired at `now`.
    pub fn why_expired(&self, now: UnixMillis) -> FailureReason {
        if !self.is_acknowledged {
            FailureReason::NeverAcknowledged
        } else if now >= self.ceiling {
            FailureReason::Overdue
        } else {
            FailureReason::LeaseLost
        }
    }
}

impl FailureReason {
    /// Whom it counts against: one party only. None for what the network, an
    /// operator, or a policy that cannot be reached caused.
    pub fn blames(self) -> Option<Party> {
        match self {
            FailureReason::PolicyMisbehaved => Some(Party::Policy),
            FailureReason::SimulatorError => Some(Party::Simulator),
            FailureReason::MachineError
            | FailureReason::SlotCrashed
            | FailureReason::SlotStuck
            | FailureReason::LeaseLost
            | FailureReason::Overdue
            | FailureReason::Unpaired => Some(Party::Machine),
            FailureReason::PolicyUnavailable
            | FailureReason::Draining
            | FailureReason::Cancelled
            | FailureReason::Unsuited
            | FailureReason::NeverAcknowledged => None,
        }
    }

    /// Whether the attempt is one of those after which its job is quarantined.
    pub fn is_charged(self) -> bool {
        self.blames().is_some()
    }

    /// Its name in the store and in reports.
    pub fn as_str(self) -> &'static str {
        match self {
            FailureReason::SimulatorError => "simulator_error",
            FailureReason::MachineError => "machine_error",
            FailureReason::SlotCrashed => "slot_crashed",
            FailureReason::SlotStuck => "slot_stuck",
            FailureReason::PolicyMisbehaved => "policy_misbehaved",
            FailureReason::LeaseLost => "lease_lost",
            FailureReason::Overdue => "overdue",
            FailureReason::Unpaired => "unpaired",
            FailureReason::PolicyUnavailable => "policy_unavailable",
            FailureReason::Draining => "draining",
            FailureReason::Cancelled => "cancelled",
            FailureReason::Unsuited => "unsuited",
            FailureReason::NeverAcknowledged => "never_acknowledged",
        }
    }
}

/// Counts one more failure of a worker's machine that had `in_a_row` before it.
pub fn strike(in_a_row: u32) -> Strike {
    let in_a_row = in_a_row.saturating_add(1);
    Strike {
        in_a_row,
        stop: in_a_row >= MAX_WORKER_FAILURES_IN_A_ROW,
    }
}

/// Whether a coordinator that last looked for expired leases so long ago was
/// suspended: then every lease gets its full time again, and no worker is
/// charged.
pub fn was_asleep(since_last_sweep: Duration, lease: Duration) -> bool {
    since_last_sweep >= lease / 2
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lease(is_acknowledged: bool) -> Lease {
        Lease {
            attempt: AttemptId::from_random([1; 16]),
            owner: WorkerId("w".to_owned()),
            granted: UnixMillis(0),
            expires: UnixMillis(10),
            ceiling: UnixMillis(100),
            is_acknowledged,
        }
    }

    #[test]
    fn a_lease_expires_for_a_reason_and_only_silence_and_the_ceiling_are_charged() {
        let check = |lease: Lease, now, expected: FailureReason, is_charged| {
            let reason = lease.why_expired(UnixMillis(now));
            assert_eq!((reason, reason.is_charged()), (expected, is_charged));
        };
        check(lease(false), 10, FailureReason::NeverAcknowledged, false);
        check(lease(false), 100, FailureReason::NeverAcknowledged, false);
        check(lease(true), 10, FailureReason::LeaseLost, true);
        check(lease(true), 100, FailureReason::Overdue, true);
    }

    #[test]
    fn the_fifth_failure_in_a_row_of_its_machine_stops_a_worker() {
        let stops: Vec<bool> = (0..5).map(|in_a_row| strike(in_a_row).stop).collect();
        assert_eq!(stops, [false, false, false, false, true]);
    }

    #[test]
    fn a_coordinator_that_missed_half_a_lease_was_asleep() {
        let lease = Duration::from_secs(30);
        assert!(!was_asleep(Duration::from_secs(14), lease));
        assert!(was_asleep(Duration::from_secs(15), lease));
    }
}
