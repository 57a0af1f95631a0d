//! What may happen to one job: the states, who may move it, and how an attempt
//! that brought no result is charged. Pure: no store, no clock, no generator of
//! its own. Not responsible for which job is leased next (`plan`) nor for a
//! policy's outages (`outage`).

use std::time::Duration;

use rand_chacha::rand_core::Rng;

use crate::clock::UnixMillis;
use crate::ids::{Attempt, JobId, LeaseRef, WorkerId};

/// Charged attempts after which a job is set aside.
pub const MAX_CHARGED_ATTEMPTS: u32 = 3;
/// Workers on which a job must have failed before it is set aside, if that many
/// are alive: one broken machine must not condemn a rollout.
pub const MIN_WORKERS_TO_QUARANTINE: u32 = 2;
/// Charged failures in a row after which a worker leases no more.
pub const MAX_WORKER_FAILURES_IN_A_ROW: u32 = 5;
/// Shortest back-off.
pub const MIN_BACKOFF: Duration = Duration::from_secs(1);
/// Longest back-off.
pub const MAX_BACKOFF: Duration = Duration::from_secs(60);

/// One rollout × replicate, as far as leasing goes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Job {
    /// Which one.
    pub id: JobId,
    /// Leases granted so far: the fencing token of the newest.
    pub attempt: Attempt,
    /// Attempts that ended in a failure of the rollout or its worker.
    pub charged_attempts: u32,
    /// Where it stands.
    pub state: JobState,
}

/// Where a job stands. The store's CHECK constraints say the same.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum JobState {
    /// Waits to be leased, not before an instant.
    Queued {
        /// End of its back-off.
        not_before: UnixMillis,
    },
    /// A worker has it.
    Leased {
        /// Who.
        owner: WorkerId,
        /// Since when.
        granted: UnixMillis,
        /// Until when, unless a heartbeat renews it.
        expires: UnixMillis,
    },
    /// Its result is stored. Final.
    Committed,
    /// Set aside after too many charged attempts.
    Quarantined,
}

/// The part of an outcome that two reports of one rollout must share. Wall time
/// is no part of it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct OutcomeKey {
    /// Whether the goal was reached.
    pub success: bool,
    /// The policy's control steps.
    pub steps: u32,
}

/// What becomes of a reported outcome, before its siblings are looked at.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CommitJudgement {
    /// The reporter holds the lease: store it.
    Accept,
    /// Stored already, with this outcome: fine.
    Duplicate,
    /// Stored already, with another outcome: keep it apart.
    Divergent,
    /// The lease is gone: refuse and count.
    Stale,
}

/// Why an attempt brought no result.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum FailureReason {
    /// The simulator failed (divergence, missing asset, native error).
    SimulatorError,
    /// The slot's process died.
    SlotCrashed,
    /// The slot's progress stood still.
    SlotStuck,
    /// The policy answered nonsense.
    PolicyMisbehaved,
    /// The lease ran out: its worker fell silent.
    LeaseLost,
    /// The result disagreed with its configuration's siblings.
    Unpaired,
    /// The policy cannot be reached or is overloaded.
    PolicyUnavailable,
    /// The worker drains.
    Draining,
    /// The campaign was cancelled.
    Cancelled,
}

/// What a failed attempt's job does next.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AfterFailure {
    /// Back in the queue, not before an instant.
    Requeue {
        /// End of its back-off.
        not_before: UnixMillis,
    },
    /// Set aside.
    Quarantine,
}

/// What speaks for and against setting a failed job aside.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Suspicion {
    /// Distinct workers with a charged failure of this job, this one included.
    pub failed_on_workers: u32,
    /// Workers alive now that could run it.
    pub able_workers: u32,
}

/// A worker's run of bad luck after one more charged failure.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Strike {
    /// Charged failures in a row.
    pub in_a_row: u32,
    /// Whether it may lease no more.
    pub stop: bool,
}

impl Job {
    /// Whether this very attempt holds the lease. An expired lease is held
    /// until it is taken away: the attempt is what fences, not the clock.
    pub fn is_held_by(&self, lease: &LeaseRef) -> bool {
        self.id == lease.job
            && self.attempt == lease.attempt
            && matches!(&self.state, JobState::Leased { owner, .. } if *owner == lease.worker)
    }

    /// What becomes of an outcome reported under `lease`. `was_granted` says
    /// whether this worker ever held this attempt, `stored` is the committed
    /// outcome, if there is one.
    pub fn judge_commit(
        &self,
        lease: &LeaseRef,
        was_granted: bool,
        reported: OutcomeKey,
        stored: Option<OutcomeKey>,
    ) -> CommitJudgement {
        match stored {
            None if self.is_held_by(lease) => CommitJudgement::Accept,
            None => CommitJudgement::Stale,
            // Who never ran it cannot confirm or contradict it.
            Some(_) if !was_granted => CommitJudgement::Stale,
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
        let workers_needed = MIN_WORKERS_TO_QUARANTINE.min(suspicion.able_workers);
        if charged >= MAX_CHARGED_ATTEMPTS && suspicion.failed_on_workers >= workers_needed {
            AfterFailure::Quarantine
        } else {
            AfterFailure::Requeue {
                not_before: now.plus(backoff(charged, rng)),
            }
        }
    }
}

impl FailureReason {
    /// Whether the attempt counts against the job and its worker. What the
    /// policy's server or an operator caused does not.
    pub fn is_charged(self) -> bool {
        !matches!(
            self,
            FailureReason::PolicyUnavailable | FailureReason::Draining | FailureReason::Cancelled
        )
    }

    /// Its name in the store and in reports.
    pub fn as_str(self) -> &'static str {
        match self {
            FailureReason::SimulatorError => "simulator_error",
            FailureReason::SlotCrashed => "slot_crashed",
            FailureReason::SlotStuck => "slot_stuck",
            FailureReason::PolicyMisbehaved => "policy_misbehaved",
            FailureReason::LeaseLost => "lease_lost",
            FailureReason::Unpaired => "unpaired",
            FailureReason::PolicyUnavailable => "policy_unavailable",
            FailureReason::Draining => "draining",
            FailureReason::Cancelled => "cancelled",
        }
    }
}

/// Whether an operator may requeue a job: what was set aside, and nothing else.
/// Its failures up to now are forgiven then, its attempts are not forgotten.
pub fn may_retry(state: &JobState) -> bool {
    *state == JobState::Quarantined
}

/// Counts one more charged failure of a worker that had `in_a_row` before it.
pub fn strike(in_a_row: u32) -> Strike {
    let in_a_row = in_a_row.saturating_add(1);
    Strike {
        in_a_row,
        stop: in_a_row >= MAX_WORKER_FAILURES_IN_A_ROW,
    }
}

/// Back-off after the `failures`-th failure in a row: doubles from
/// [`MIN_BACKOFF`] to [`MAX_BACKOFF`], then a random share of up to half is
/// taken off, so that what failed together does not come back together.
pub fn backoff(failures: u32, rng: &mut impl Rng) -> Duration {
    let doublings = failures.saturating_sub(1).min(16);
    let full = MIN_BACKOFF.saturating_mul(1 << doublings).min(MAX_BACKOFF);
    let share = f64::from(rng.next_u32()) / f64::from(u32::MAX);
    full.mul_f64(1.0 - share / 2.0).max(MIN_BACKOFF)
}
