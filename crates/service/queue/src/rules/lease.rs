//! Life of one job: its states, the transitions between them, and how an attempt without a result
//! is charged. Not responsible for which job is leased next (`choice`) nor for a policy's outages
//! (`outage`).

use std::time::Duration;

use rand_chacha::rand_core::Rng;
use rollout_types::{AttemptId, Waits};
use serde::Deserialize;

use crate::clock::UnixMillis;
use crate::ids::{AttemptNumber, JobId, WorkerId};

/// Charged attempts after which a job is quarantined.
pub const MAX_CHARGED_ATTEMPTS: u32 = 3;
/// Machines on which a job must have failed before it is quarantined, if workers on
/// that many are alive: one broken machine must not put a rollout into quarantine.
/// Workers that do not say on which machine they run count as one machine each.
pub const MIN_MACHINES_TO_QUARANTINE: u32 = 2;
/// Failures of its machine in a row after which a worker leases no more.
pub const MAX_WORKER_FAILURES_IN_A_ROW: u32 = 5;
/// Attempts of one job that were cut off with their worker before the job waits for
/// a back-off each time, so that others get their turn on the workers that are left.
pub const SILENCES_UNTIL_BACKOFF: u32 = 3;
/// Attempts of one job that were cut off with their worker before the job is
/// quarantined: it takes its workers down. A network that is cut so often while this
/// very job runs, and each time until the job's worker is gone for good, is not one
/// to wait for.
pub const MAX_SILENCES: u32 = 10;
/// Attempts of one job that lost their policy before the job waits for a back-off
/// each time, so that others get their turn while the policy is there.
pub const LOSSES_UNTIL_BACKOFF: u32 = 2;
/// Attempts of one job that lost their policy before the job is run alone only: with
/// no other lease of that policy, and when no other job of it waits.
/// The index `job_alone` of the schema has this number, too.
pub const LOSSES_UNTIL_ALONE: u32 = 4;
/// Attempts of one job that lost their policy, the last of them alone with it, before
/// the job is quarantined: it takes its policy down.
pub const MAX_LOSSES: u32 = 6;

/// One rollout × replicate, as far as leasing goes.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
pub struct Job {
    /// Id of the job.
    pub id: JobId,
    /// Leases granted so far.
    pub attempt: AttemptNumber,
    /// Attempts that ended in a failure of policy, machine or simulator.
    pub charged_attempts: u32,
    /// Attempts that lost their policy.
    pub losses: u32,
    /// Lease state.
    pub state: JobState,
}

/// Lease state of a job. The store's CHECK constraints say the same.
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

/// Judgement on a reported result, before its siblings are looked at.
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
    /// The lease expired: its worker's heartbeats came and left it out.
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
    /// The lease expired and no heartbeat of its worker came any more: the network was
    /// cut, or the worker or its whole machine is gone.
    WorkerSilent,
    /// The policy had answered in this attempt and cannot be reached any more.
    PolicyLost,
    /// The last of too many attempts that lost their policy.
    TakesPolicyDown,
    /// The last of too many attempts that were cut off with their worker.
    TakesWorkerDown,
    /// An operator skipped the rollout.
    Skipped,
}

/// Next step of a failed attempt's job.
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

/// Evidence against a job from its attempts so far, the one that ends now included. Counted since
/// the job was last taken out of quarantine by hand.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Suspicion {
    /// Distinct machines with a charged failure.
    pub failed_on_machines: u32,
    /// Distinct machines with an attempt that was cut off with its worker.
    pub silent_on_machines: u32,
    /// Machines with a worker alive now that could run it.
    pub able_machines: u32,
    /// Attempts that were cut off with their worker.
    pub silences: u32,
}

/// A lease that was cut off with its worker, which may still come back with the result.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
pub struct CutOff {
    /// Number of the attempt within its job.
    pub number: AttemptNumber,
    /// The lease as it was granted; its `expires` is past.
    pub lease: Lease,
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

    /// Judges an outcome that `attempt`, one of this job's, reports. `stored` is the committed
    /// outcome, if there is one.
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

    /// The lease that a worker which comes back resumes: its job was leased to nobody
    /// since, and the attempt's ceiling is not reached.
    pub fn resumes<'a>(&self, cut_off: &'a CutOff, now: UnixMillis) -> Option<&'a Lease> {
        let waits = matches!(self.state, JobState::Queued { .. });
        let is_newest = self.attempt == cut_off.number;
        (waits && is_newest && now < cut_off.lease.ceiling).then_some(&cut_off.lease)
    }

    /// Returns the next step of this leased job after its attempt failed.
    pub fn after_failure(
        &self,
        reason: FailureReason,
        suspicion: Suspicion,
        now: UnixMillis,
        rng: &mut impl Rng,
    ) -> AfterFailure {
        let machines = MIN_MACHINES_TO_QUARANTINE.min(suspicion.able_machines);
        // Whether it is quarantined, and its place in the row of back-offs.
        let (is_over, wait) = match reason {
            FailureReason::Skipped => return AfterFailure::Quarantine,
            FailureReason::PolicyLost => {
                let losses = self.losses + 1;
                (
                    losses >= MAX_LOSSES,
                    (losses + 1).saturating_sub(LOSSES_UNTIL_BACKOFF),
                )
            }
            FailureReason::WorkerSilent => {
                let silences = suspicion.silences;
                let is_over = silences >= MAX_SILENCES && suspicion.silent_on_machines >= machines;
                (
                    is_over,
                    (silences + 1).saturating_sub(SILENCES_UNTIL_BACKOFF),
                )
            }
            _ if !reason.is_charged() => (false, 0),
            _ => {
                let charged = self.charged_attempts + 1;
                let needed = match reason.blames() {
                    Some(Party::Policy) => 1,
                    _ => machines,
                };
                let is_over =
                    charged >= MAX_CHARGED_ATTEMPTS && suspicion.failed_on_machines >= needed;
                (is_over, charged)
            }
        };
        match (is_over, wait) {
            (true, _) => AfterFailure::Quarantine,
            (false, 0) => AfterFailure::Requeue { not_before: now },
            (false, failures) => {
                let wait = Waits::USUAL.after(failures, rng.next_u32());
                AfterFailure::Requeue {
                    not_before: now.plus(wait.max(Waits::USUAL.first)),
                }
            }
        }
    }
}

impl Lease {
    /// Why this lease, which lasts `lasts` without a heartbeat, has expired.
    /// `last_heartbeat` is its worker's, whether or not it named this attempt.
    ///
    /// A worker whose heartbeats stopped took all its leases with it, and nothing is
    /// known of the rollout: the network may be cut. One that goes on sending heartbeats
    /// and leaves the attempt out has forgotten it. That is told by the second half of the
    /// lease, since a heartbeat may be late and be overtaken by another. At the ceiling
    /// of the attempt every heartbeat within a lease says that the worker is there.
    pub fn why_expired(
        &self,
        last_heartbeat: Option<UnixMillis>,
        lasts: Duration,
    ) -> FailureReason {
        let is_silent_for = |span| last_heartbeat.is_none_or(|at| at <= self.expires.minus(span));
        let is_overdue = self.expires >= self.ceiling;
        if !self.is_acknowledged {
            FailureReason::NeverAcknowledged
        } else if is_silent_for(if is_overdue { lasts } else { lasts / 2 }) {
            FailureReason::WorkerSilent
        } else if is_overdue {
            FailureReason::Overdue
        } else {
            FailureReason::LeaseLost
        }
    }
}

impl FailureReason {
    /// Whom it counts against: one party only. None for what the network, an
    /// operator, a policy that cannot be reached, or the rollout itself caused.
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
            | FailureReason::NeverAcknowledged
            | FailureReason::WorkerSilent
            | FailureReason::PolicyLost
            | FailureReason::TakesPolicyDown
            | FailureReason::TakesWorkerDown
            | FailureReason::Skipped => None,
        }
    }

    /// Whether the attempt is one of those after which its job is quarantined.
    pub fn is_charged(self) -> bool {
        self.blames().is_some()
    }

    /// Whether the attempt had its policy and lost it.
    pub fn is_loss(self) -> bool {
        matches!(
            self,
            FailureReason::PolicyLost | FailureReason::TakesPolicyDown
        )
    }

    /// Whether the attempt's worker may come back with its result.
    pub fn may_be_resumed(self) -> bool {
        matches!(
            self,
            FailureReason::WorkerSilent | FailureReason::NeverAcknowledged
        )
    }

    /// The reason that is stored with an attempt after which its job does `then`.
    #[must_use]
    pub fn before(self, then: AfterFailure) -> FailureReason {
        match (self, then) {
            (FailureReason::PolicyLost, AfterFailure::Quarantine) => FailureReason::TakesPolicyDown,
            (FailureReason::WorkerSilent, AfterFailure::Quarantine) => {
                FailureReason::TakesWorkerDown
            }
            (reason, _) => reason,
        }
    }

    /// The error that is stored with an attempt, which says so where it is the last of too
    /// many.
    pub fn explained(self, error: &str, losses: u32, silences: u32) -> String {
        match self {
            FailureReason::TakesPolicyDown => format!(
                "this rollout takes its policy down: {losses} attempts had the policy and lost \
                 it, the last {} while no other rollout asked it; the last error was: {error}",
                MAX_LOSSES - LOSSES_UNTIL_ALONE
            ),
            FailureReason::TakesWorkerDown => format!(
                "this rollout takes its workers down: {silences} attempts ended because their \
                 worker fell silent and never came back; the last error was: {error}"
            ),
            _ => error.to_owned(),
        }
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
            FailureReason::WorkerSilent => "worker_silent",
            FailureReason::PolicyLost => "policy_lost",
            FailureReason::TakesPolicyDown => "takes_policy_down",
            FailureReason::TakesWorkerDown => "takes_worker_down",
            FailureReason::Skipped => "skipped",
        }
    }
}

/// The failures in a row that a worker begins with on a machine whose last worker had
/// `in_a_row`: a machine that is broken stays so when its worker is started again, and
/// one more failure stops that one. A result that is committed clears them.
pub fn inherited(in_a_row: u32) -> u32 {
    in_a_row.min(MAX_WORKER_FAILURES_IN_A_ROW - 1)
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
    use rand_chacha::ChaCha8Rng;
    use rand_chacha::rand_core::SeedableRng;

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
    fn a_lease_expires_for_a_reason_and_only_a_worker_that_still_calls_is_charged() {
        const LASTS: Duration = Duration::from_millis(40);
        let check = |lease: Lease, heard, expected: FailureReason, is_charged| {
            let reason = lease.why_expired(heard, LASTS);
            assert_eq!((reason, reason.is_charged()), (expected, is_charged));
        };
        let late = |is_acknowledged| Lease {
            expires: UnixMillis(60),
            ..lease(is_acknowledged)
        };
        let at_its_ceiling = || Lease {
            expires: UnixMillis(100),
            ..lease(true)
        };
        let at = |millis| Some(UnixMillis(millis));
        check(late(false), at(59), FailureReason::NeverAcknowledged, false);
        check(late(false), None, FailureReason::NeverAcknowledged, false);
        // The last heartbeat renewed it, or an older one came after that.
        check(late(true), at(20), FailureReason::WorkerSilent, false);
        check(late(true), at(40), FailureReason::WorkerSilent, false);
        check(late(true), at(41), FailureReason::LeaseLost, true);
        check(at_its_ceiling(), at(61), FailureReason::Overdue, true);
        check(at_its_ceiling(), at(60), FailureReason::WorkerSilent, false);
    }

    fn job(attempt: u32, state: JobState) -> Job {
        Job {
            id: JobId(1),
            attempt: AttemptNumber(attempt),
            charged_attempts: 0,
            losses: attempt - 1,
            state,
        }
    }

    #[test]
    fn a_worker_that_comes_back_is_heard_until_its_job_is_leased_again_or_its_ceiling() {
        let cut_off = CutOff {
            number: AttemptNumber(2),
            lease: lease(true),
        };
        let not_before = UnixMillis(50);
        let waits = job(2, JobState::Queued { not_before });
        assert_eq!(
            waits.resumes(&cut_off, UnixMillis(99)),
            Some(&cut_off.lease)
        );
        assert_eq!(
            waits.resumes(&cut_off, UnixMillis(100)),
            None,
            "its ceiling"
        );
        let was_leased_since = job(3, JobState::Queued { not_before });
        assert_eq!(was_leased_since.resumes(&cut_off, UnixMillis(50)), None);
        for state in [
            JobState::Leased(lease(true)),
            JobState::Committed,
            JobState::Quarantined,
        ] {
            assert_eq!(job(2, state).resumes(&cut_off, UnixMillis(50)), None);
        }
    }

    /// Returns the next step of a job after its `count`th attempt that ended like this.
    fn after(reason: FailureReason, count: u32, machines: u32) -> AfterFailure {
        let suspicion = Suspicion {
            failed_on_machines: 0,
            silent_on_machines: machines,
            able_machines: 2,
            silences: count,
        };
        let job = job(count, JobState::Leased(lease(true)));
        job.after_failure(
            reason,
            suspicion,
            UnixMillis(0),
            &mut ChaCha8Rng::seed_from_u64(1),
        )
    }

    #[test]
    fn a_job_that_loses_its_policy_again_and_again_steps_back_and_is_quarantined_in_the_end() {
        let lost = |count| after(FailureReason::PolicyLost, count, 0);
        let at_once = AfterFailure::Requeue {
            not_before: UnixMillis(0),
        };
        assert_eq!(lost(1), at_once);
        for count in LOSSES_UNTIL_BACKOFF..MAX_LOSSES {
            assert!(matches!(lost(count), AfterFailure::Requeue { .. }));
            assert_ne!(lost(count), at_once, "{count}");
        }
        assert_eq!(lost(MAX_LOSSES), AfterFailure::Quarantine);
        let stored = FailureReason::PolicyLost.before(AfterFailure::Quarantine);
        assert_eq!(stored, FailureReason::TakesPolicyDown);
        assert_eq!(stored.blames(), None);
    }

    #[test]
    fn a_job_that_takes_workers_down_is_quarantined_once_it_did_so_on_two_machines() {
        let silent = |count, machines| after(FailureReason::WorkerSilent, count, machines);
        let at_once = AfterFailure::Requeue {
            not_before: UnixMillis(0),
        };
        assert_eq!(silent(1, 1), at_once);
        assert_ne!(silent(SILENCES_UNTIL_BACKOFF, 1), at_once);
        assert!(matches!(
            silent(MAX_SILENCES, 1),
            AfterFailure::Requeue { .. }
        ));
        assert_eq!(silent(MAX_SILENCES, 2), AfterFailure::Quarantine);
    }

    #[test]
    fn a_worker_that_is_started_again_on_a_broken_machine_has_one_failure_left() {
        assert_eq!(inherited(0), 0);
        assert_eq!(inherited(3), 3);
        let next = strike(inherited(MAX_WORKER_FAILURES_IN_A_ROW));
        assert!(next.stop);
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
