//! Lifecycle of one job: its states, their transitions, and the charging of attempts without a
//! result. `choice` decides which job is leased next; `outage` handles outages of policies.

use std::collections::BTreeSet;
use std::time::Duration;

use benchmark::attempt::{AttemptId, Waits};
use rand_chacha::rand_core::Rng;
use serde::Deserialize;

use crate::clock::UnixMillis;
use crate::ids::{AttemptNumber, JobId, WorkerId};

/// Charged attempts after which a job is quarantined. The schema's index `job_failing` uses the same
/// number.
pub const MAX_CHARGED_ATTEMPTS: u32 = 3;
/// Machines on which a job must have failed before it is quarantined, unless no able machine is
/// left that has not failed at it: one broken machine must not put a rollout into quarantine.
/// Failures of the policy need one machine. Workers that do not report their machine count as one
/// machine each.
pub const MIN_MACHINES_TO_QUARANTINE: usize = 2;
/// Machine failures in a row after which a worker stops leasing.
pub const MAX_WORKER_FAILURES_IN_A_ROW: u32 = 5;
/// From this number on, each attempt of a job that is cut off with its worker (whose heartbeats
/// stopped) is followed by a back-off, so that other jobs get the remaining workers.
pub const SILENCES_UNTIL_BACKOFF: u32 = 3;
/// Attempts of one job that were cut off with their worker after which the job is quarantined, if
/// they ran on enough machines ([`MIN_MACHINES_TO_QUARANTINE`]). The job then probably crashes its
/// workers: so many network failures, each as long as a lease, are unlikely to hit one job.
pub const MAX_SILENCES: u32 = 10;
/// From this number on, each attempt of a job that loses its policy is followed by a back-off, so
/// that other jobs run while the policy is available.
pub const LOSSES_UNTIL_BACKOFF: u32 = 2;
/// Attempts of one job that lost their policy after which the job runs only as the policy's single
/// lease, and only when no other job of the policy waits. The schema's index `job_alone` uses the
/// same number.
pub const LOSSES_UNTIL_ALONE: u32 = 4;
/// Attempts of one job that lost their policy after which the job is quarantined, since it crashes
/// its policy: in the last two of these attempts, the job was the policy's single lease.
pub const MAX_LOSSES: u32 = 6;

/// Lease state of a job: one rollout × replicate.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
pub struct Job {
    pub id: JobId,
    /// Leases granted so far.
    pub attempt: AttemptNumber,
    /// Attempts that ended in a charged failure of policy, machine or simulator.
    pub charged_attempts: u32,
    /// Attempts that lost their policy.
    pub losses: u32,
    pub state: JobState,
}

/// Lease state of a job. Must match the store's CHECK constraints.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(tag = "is", rename_all = "snake_case")]
pub enum JobState {
    /// Waits to be leased.
    Queued {
        /// End of the job's back-off, the earliest instant of the next lease.
        not_before: UnixMillis,
    },
    Leased(Lease),
    /// The result is stored. Final.
    Committed,
    /// Too many attempts failed, or an operator skipped the job; not leased until an operator
    /// retries it.
    Quarantined,
}

#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
pub struct Lease {
    pub attempt: AttemptId,
    pub owner: WorkerId,
    pub granted: UnixMillis,
    /// Instant of expiry unless a heartbeat renews the lease.
    pub expires: UnixMillis,
    /// Instant after which heartbeats no longer renew the lease.
    pub ceiling: UnixMillis,
    /// True once a heartbeat of the worker has named the lease.
    pub is_acknowledged: bool,
}

/// The part of a result on which two reports of one rollout must agree. Excludes wall time.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
pub struct OutcomeKey {
    /// True if the goal was reached.
    pub success: bool,
    /// The policy's control steps.
    pub steps: u32,
}

/// Judgement on a reported result, before the comparison with its siblings.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CommitJudgement {
    /// The attempt holds the lease: the result can be stored.
    Accept,
    /// The same outcome is already stored.
    Duplicate,
    /// Another outcome is already stored: this one is recorded separately.
    Divergent,
    /// The attempt no longer holds the lease: the result is refused and counted.
    Stale,
}

/// The party that a failure is charged to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Party {
    /// The policy, which is paused after several failures in a row.
    Policy,
    /// The worker's machine, which stops leasing after several failures in a row.
    Machine,
    /// The simulator, which fails in the same way on every machine.
    Simulator,
}

/// Reason why an attempt ended without a result.
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
    /// The policy's answer violated the protocol.
    PolicyMisbehaved,
    /// The lease expired because the worker's heartbeats omitted it.
    LeaseLost,
    /// The attempt reached its ceiling.
    Overdue,
    /// The result disagreed with its configuration's siblings, its campaign or its manifest row.
    Unpaired,
    /// The policy cannot be reached or is overloaded, or another policy answers in its place.
    PolicyUnavailable,
    /// The worker did not run the job, because it was shutting down, its slot was not usable, or it
    /// lacked files; or the campaign was copied while the attempt ran.
    Draining,
    /// The campaign was cancelled, was given another policy, or stopped early.
    Cancelled,
    /// Another worker's result pinned the campaign to another asset pack, simulator or renderer, or
    /// the stored results of the siblings cannot be read.
    Unsuited,
    /// The lease expired before a heartbeat named it: the answer to the claim was lost.
    NeverAcknowledged,
    /// The lease expired and the worker's heartbeats stopped: the network was cut, or the worker or
    /// its machine is gone.
    WorkerSilent,
    /// The policy answered in this attempt and then became unreachable.
    PolicyLost,
    /// Last of too many attempts that lost their policy.
    TakesPolicyDown,
    /// Last of too many attempts that were cut off with their worker.
    TakesWorkerDown,
    /// An operator skipped the rollout.
    Skipped,
}

/// Next step of a failed attempt's job.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AfterFailure {
    Requeue { not_before: UnixMillis },
    Quarantine,
}

/// Evidence against a job: its attempts since an operator last took it out of quarantine, including
/// the attempt that ends now.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Suspicion {
    /// Machines with a charged failure.
    pub failed_on: BTreeSet<String>,
    /// Machines with an attempt that was cut off with its worker.
    pub silent_on: BTreeSet<String>,
    /// Machines with a live worker that could run the job.
    pub able: BTreeSet<String>,
    /// Attempts that were cut off with their worker.
    pub silences: u32,
}

/// A lease that was cut off with its worker, which may reconnect with the result.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
pub struct CutOff {
    /// Number of the attempt within its job.
    pub number: AttemptNumber,
    /// The lease; its `expires` is the instant at which the attempt ended.
    pub lease: Lease,
}

/// Number of a machine's failures in a row, including the latest failure.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Strike {
    pub in_a_row: u32,
    /// True if the worker must stop leasing.
    pub stop: bool,
}

impl Job {
    /// Returns the job's lease if `attempt` holds it. An expired lease counts as held until the
    /// sweep ends it: reports are fenced by the attempt, not by the clock.
    pub fn lease_of(&self, attempt: AttemptId) -> Option<&Lease> {
        match &self.state {
            JobState::Leased(lease) if lease.attempt == attempt => Some(lease),
            _ => None,
        }
    }

    /// Judges an outcome reported by `attempt`, an attempt of this job. `stored` is the committed
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

    /// Returns the lease of `cut_off` if its reconnected worker may resume it: the job was not
    /// leased again in the meantime, and the attempt's ceiling is not reached.
    pub fn resumable<'a>(&self, cut_off: &'a CutOff, now: UnixMillis) -> Option<&'a Lease> {
        let waits = matches!(self.state, JobState::Queued { .. });
        let is_newest = self.attempt == cut_off.number;
        (waits && is_newest && now < cut_off.lease.ceiling).then_some(&cut_off.lease)
    }

    pub fn after_failure(
        &self,
        reason: FailureReason,
        suspicion: &Suspicion,
        now: UnixMillis,
        rng: &mut impl Rng,
    ) -> AfterFailure {
        // `failures` is the number of failures that determines the back-off of a job that is not
        // quarantined; 0 for no back-off.
        let (is_quarantined, failures) = match reason {
            FailureReason::Skipped => return AfterFailure::Quarantine,
            FailureReason::PolicyLost => {
                let losses = self.losses + 1;
                (losses >= MAX_LOSSES, (losses + 1).saturating_sub(LOSSES_UNTIL_BACKOFF))
            }
            FailureReason::WorkerSilent => {
                let silences = suspicion.silences;
                (
                    silences >= MAX_SILENCES && suspicion.is_confirmed_by(&suspicion.silent_on),
                    (silences + 1).saturating_sub(SILENCES_UNTIL_BACKOFF),
                )
            }
            _ if !reason.is_charged() => (false, 0),
            _ => {
                let charged = self.charged_attempts + 1;
                let is_confirmed = reason.blames() == Some(Party::Policy)
                    || suspicion.is_confirmed_by(&suspicion.failed_on);
                (charged >= MAX_CHARGED_ATTEMPTS && is_confirmed, charged)
            }
        };
        match (is_quarantined, failures) {
            (true, _) => AfterFailure::Quarantine,
            (false, 0) => AfterFailure::Requeue { not_before: now },
            (false, failures) => {
                let wait = Waits::USUAL.after(failures, rng.next_u32());
                AfterFailure::Requeue { not_before: now.plus(wait.max(Waits::USUAL.first)) }
            }
        }
    }
}

impl Suspicion {
    /// Returns true if failures on these machines are evidence against the job rather than against
    /// a machine: there are enough of them, or no able machine is left without a failure. The sets
    /// are compared, not their sizes: a broken machine is often not able any more.
    fn is_confirmed_by(&self, machines: &BTreeSet<String>) -> bool {
        machines.len() >= MIN_MACHINES_TO_QUARANTINE || self.able.is_subset(machines)
    }
}

impl Lease {
    /// Returns the reason why this lease expired. `lease_duration` is the duration of a lease
    /// without a heartbeat; `last_heartbeat` is the instant of the worker's last heartbeat, even if
    /// that heartbeat did not name this attempt.
    ///
    /// If the worker's heartbeats stopped, all its leases expired together and nothing is known
    /// about the rollout: the network may be cut. If its heartbeats continued but omitted the
    /// attempt, the worker has forgotten the attempt. A heartbeat in the second half of the lease
    /// counts as continuing, since heartbeats may be late and overtake one another. At the
    /// attempt's ceiling, any heartbeat within one lease shows that the worker is alive.
    pub fn expiry_reason(
        &self,
        last_heartbeat: Option<UnixMillis>,
        lease_duration: Duration,
    ) -> FailureReason {
        let is_silent_for = |span| last_heartbeat.is_none_or(|at| at <= self.expires.minus(span));
        let is_overdue = self.expires >= self.ceiling;
        if !self.is_acknowledged {
            FailureReason::NeverAcknowledged
        } else if is_silent_for(if is_overdue { lease_duration } else { lease_duration / 2 }) {
            FailureReason::WorkerSilent
        } else if is_overdue {
            FailureReason::Overdue
        } else {
            FailureReason::LeaseLost
        }
    }
}

impl FailureReason {
    /// Returns the party that the failure is charged to; `None` if it is charged to nobody, such as
    /// after a network failure, an operator's order or the loss of a policy.
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

    /// Returns true if the attempt counts towards the limit after which its job is quarantined.
    pub fn is_charged(self) -> bool {
        self.blames().is_some()
    }

    /// Returns true if the attempt had reached its policy and lost it.
    pub fn is_loss(self) -> bool {
        matches!(self, FailureReason::PolicyLost | FailureReason::TakesPolicyDown)
    }

    /// Returns true if the attempt's worker may reconnect with its result.
    pub fn may_be_resumed(self) -> bool {
        matches!(self, FailureReason::WorkerSilent | FailureReason::NeverAcknowledged)
    }

    /// Returns the reason to store with an attempt whose job continues with `next_step`. A lost
    /// policy or a silent worker that leads to a quarantine gets a reason of its own.
    #[must_use]
    pub fn stored_reason(self, next_step: AfterFailure) -> FailureReason {
        match (self, next_step) {
            (FailureReason::PolicyLost, AfterFailure::Quarantine) => FailureReason::TakesPolicyDown,
            (FailureReason::WorkerSilent, AfterFailure::Quarantine) => {
                FailureReason::TakesWorkerDown
            }
            (reason, _) => reason,
        }
    }

    /// Returns the error text to store with an attempt. The text gives the number of attempts if
    /// too many of them lost their policy or their worker.
    pub fn stored_error(self, error: &str, losses: u32, silences: u32) -> String {
        match self {
            FailureReason::TakesPolicyDown => format!(
                "this rollout takes its policy down: {losses} attempts reached the policy and \
                 lost it, the last {} while no other rollout queried it; the last error was: \
                 {error}",
                MAX_LOSSES - LOSSES_UNTIL_ALONE
            ),
            FailureReason::TakesWorkerDown => format!(
                "this rollout takes its workers down: {silences} attempts ended because their \
                 worker stopped sending heartbeats and did not reconnect; the last error was: \
                 {error}"
            ),
            _ => error.to_owned(),
        }
    }

    /// Returns the name of the reason in the store and in reports.
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

/// Returns the number of failures in a row that a new worker starts with on a machine whose last
/// worker had `in_a_row`. A broken machine stays broken when its worker restarts, so the new worker
/// is stopped by its first failure if the last worker was stopped. A committed result resets the
/// count.
pub fn inherited_failures(in_a_row: u32) -> u32 {
    in_a_row.min(MAX_WORKER_FAILURES_IN_A_ROW - 1)
}

/// Counts one more failure of a worker's machine that had `in_a_row` before it.
pub fn strike(in_a_row: u32) -> Strike {
    let in_a_row = in_a_row.saturating_add(1);
    Strike { in_a_row, stop: in_a_row >= MAX_WORKER_FAILURES_IN_A_ROW }
}

/// Returns true if so much time has passed since the last sweep that the coordinator must have been
/// suspended. Every lease is then restarted, and no worker is charged.
pub fn was_suspended(since_last_sweep: Duration, lease: Duration) -> bool {
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
    fn an_expired_lease_is_charged_only_if_its_worker_still_sends_heartbeats() {
        const LEASE_DURATION: Duration = Duration::from_millis(40);
        let check = |lease: Lease, last_heartbeat, expected: FailureReason, is_charged| {
            let reason = lease.expiry_reason(last_heartbeat, LEASE_DURATION);
            assert_eq!((reason, reason.is_charged()), (expected, is_charged));
        };
        let late = |is_acknowledged| Lease { expires: UnixMillis(60), ..lease(is_acknowledged) };
        let at_its_ceiling = || Lease { expires: UnixMillis(100), ..lease(true) };
        let at = |millis| Some(UnixMillis(millis));
        check(late(false), at(59), FailureReason::NeverAcknowledged, false);
        check(late(false), None, FailureReason::NeverAcknowledged, false);
        // A heartbeat at 20 renewed the lease until 60. A worker whose last heartbeat was sent in
        // the first half of that time is silent; a later heartbeat has omitted the lease.
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
    fn a_reconnected_worker_resumes_its_lease_until_its_job_is_leased_again_or_its_ceiling() {
        let cut_off = CutOff { number: AttemptNumber(2), lease: lease(true) };
        let not_before = UnixMillis(50);
        let waiting = job(2, JobState::Queued { not_before });
        assert_eq!(waiting.resumable(&cut_off, UnixMillis(99)), Some(&cut_off.lease));
        assert_eq!(waiting.resumable(&cut_off, UnixMillis(100)), None, "the ceiling is reached");
        let leased_again = job(3, JobState::Queued { not_before });
        assert_eq!(leased_again.resumable(&cut_off, UnixMillis(50)), None);
        for state in [JobState::Leased(lease(true)), JobState::Committed, JobState::Quarantined] {
            assert_eq!(job(2, state).resumable(&cut_off, UnixMillis(50)), None);
        }
    }

    /// Returns the next step of a job after `count` attempts that ended for this reason, on these
    /// machines.
    fn after(reason: FailureReason, count: u32, on: &[&str], able: &[&str]) -> AfterFailure {
        let set = |names: &[&str]| names.iter().map(|name| (*name).to_owned()).collect();
        let suspicion =
            Suspicion { failed_on: set(on), silent_on: set(on), able: set(able), silences: count };
        let mut job = job(count, JobState::Leased(lease(true)));
        job.charged_attempts = count - 1;
        job.after_failure(reason, &suspicion, UnixMillis(0), &mut ChaCha8Rng::seed_from_u64(1))
    }

    #[test]
    fn a_job_that_repeatedly_loses_its_policy_backs_off_and_is_finally_quarantined() {
        let lost = |count| after(FailureReason::PolicyLost, count, &["a"], &["a", "b"]);
        let at_once = AfterFailure::Requeue { not_before: UnixMillis(0) };
        assert_eq!(lost(1), at_once);
        for count in LOSSES_UNTIL_BACKOFF..MAX_LOSSES {
            assert!(matches!(lost(count), AfterFailure::Requeue { .. }));
            assert_ne!(lost(count), at_once, "{count}");
        }
        assert_eq!(lost(MAX_LOSSES), AfterFailure::Quarantine);
        let stored = FailureReason::PolicyLost.stored_reason(AfterFailure::Quarantine);
        assert_eq!(stored, FailureReason::TakesPolicyDown);
        assert_eq!(stored.blames(), None);
    }

    #[test]
    fn only_after_its_third_silence_does_a_job_back_off() {
        let silent = |count| after(FailureReason::WorkerSilent, count, &["a"], &["a", "b"]);
        let at_once = AfterFailure::Requeue { not_before: UnixMillis(0) };
        assert_eq!(silent(1), at_once);
        assert_ne!(silent(SILENCES_UNTIL_BACKOFF), at_once);
    }

    /// Regression: sizes were compared, so that a broken machine, which was not able any more, met
    /// the requirement of one able machine that had not tried the job.
    #[test]
    fn no_able_machine_is_left_untried_when_a_job_is_quarantined() {
        for (reason, count) in [
            (FailureReason::WorkerSilent, MAX_SILENCES),
            (FailureReason::SlotCrashed, MAX_CHARGED_ATTEMPTS),
        ] {
            let is_quarantined = |count, on: &[&str], able: &[&str]| {
                after(reason, count, on, able) == AfterFailure::Quarantine
            };
            assert!(!is_quarantined(count, &["broken"], &["broken", "sound"]));
            assert!(!is_quarantined(count, &["broken"], &["sound"]), "{reason:?}");
            assert!(is_quarantined(count, &["broken"], &["broken"]));
            assert!(is_quarantined(count, &["broken"], &[]));
            assert!(is_quarantined(count, &["broken", "other"], &["sound"]));
            assert!(!is_quarantined(count - 1, &["broken", "other"], &[]));
        }
    }

    #[test]
    fn a_worker_that_is_started_again_on_a_broken_machine_has_one_failure_left() {
        assert_eq!(inherited_failures(0), 0);
        assert_eq!(inherited_failures(3), 3);
        let next = strike(inherited_failures(MAX_WORKER_FAILURES_IN_A_ROW));
        assert!(next.stop);
    }

    #[test]
    fn the_fifth_failure_in_a_row_of_its_machine_stops_a_worker() {
        let stops: Vec<bool> = (0..5).map(|in_a_row| strike(in_a_row).stop).collect();
        assert_eq!(stops, [false, false, false, false, true]);
    }

    #[test]
    fn a_gap_of_half_a_lease_between_sweeps_means_suspension() {
        let lease = Duration::from_secs(30);
        assert!(!was_suspended(Duration::from_secs(14), lease));
        assert!(was_suspended(Duration::from_secs(15), lease));
    }
}
