//! What the coordinator does by itself, decided purely: leases that ran out,
//! and which task a worker is given next. `plan(state, now)` returns decisions;
//! the queue executes them. Not responsible for what workers report (`lease`,
//! `outage`).

use std::collections::BTreeMap;
use std::time::Duration;

use rand_chacha::rand_core::Rng;

use crate::clock::UnixMillis;
use crate::ids::{LeaseRef, WorkerId};
use crate::lease::{AfterFailure, FailureReason, Job, Strike, Suspicion, strike};

/// What the sweep looks at.
#[derive(Clone, Debug)]
pub struct SweepState {
    /// When the sweep last ran.
    pub last_sweep: UnixMillis,
    /// How long a lease lasts.
    pub lease: Duration,
    /// Leases whose time is over.
    pub expired: Vec<ExpiredLease>,
}

/// A lease whose time is over.
#[derive(Clone, Debug)]
pub struct ExpiredLease {
    /// Its job.
    pub job: Job,
    /// Its holder and attempt.
    pub lease: LeaseRef,
    /// Control steps that the last heartbeat reported.
    pub control_steps: u32,
    /// Charged failures in a row that its holder had before this one.
    pub owner_failures_in_a_row: u32,
    /// For and against setting the job aside.
    pub suspicion: Suspicion,
}

/// What the sweep does.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Decision {
    /// The coordinator itself slept: every lease gets its full time again,
    /// rather than all workers the blame.
    ExtendLeases {
        /// New expiry.
        until: UnixMillis,
    },
    /// An attempt is over without a result.
    Fail {
        /// Which.
        lease: LeaseRef,
        /// Why.
        reason: FailureReason,
        /// In words.
        error: String,
        /// What its job does next.
        then: AfterFailure,
    },
    /// A worker's run of failures grew.
    Strike {
        /// Whose.
        worker: WorkerId,
        /// To what.
        strike: Strike,
    },
}

/// A task of one campaign of which jobs wait, as a claim sees it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct WaitingTask {
    /// "libero_goal/3".
    pub task: String,
    /// Place of its next job in paired-unit order.
    pub first_unit: i64,
    /// Leases of other workers on it now.
    pub held_by_others: u32,
}

/// Decides what becomes of leases that ran out.
///
/// A worker that falls silent loses all its slots' leases at once; that is one
/// strike against it, however many slots it has.
pub fn plan(state: &SweepState, now: UnixMillis, rng: &mut impl Rng) -> Vec<Decision> {
    if now.since(state.last_sweep) >= state.lease / 2 {
        return vec![Decision::ExtendLeases {
            until: now.plus(state.lease),
        }];
    }
    let mut decisions = Vec::new();
    let mut strikes = BTreeMap::new();
    for expired in &state.expired {
        let reason = FailureReason::LeaseLost;
        decisions.push(Decision::Fail {
            lease: expired.lease.clone(),
            reason,
            error: format!(
                "worker `{}` fell silent after control step {}",
                expired.lease.worker, expired.control_steps
            ),
            then: expired
                .job
                .after_failure(reason, expired.suspicion, now, rng),
        });
        strikes.insert(&expired.lease.worker, expired.owner_failures_in_a_row);
    }
    decisions.extend(
        strikes
            .into_iter()
            .map(|(worker, in_a_row)| Decision::Strike {
                worker: worker.clone(),
                strike: strike(in_a_row),
            }),
    );
    decisions
}

/// Picks the task of a campaign that a claim is served from: the one whose
/// scene the slot holds compiled; else the one that the fewest others work on;
/// among equals the one whose next job comes first in paired-unit order.
pub fn choose_task<'a>(
    waiting: &'a [WaitingTask],
    warm_task: Option<&str>,
) -> Option<&'a WaitingTask> {
    waiting.iter().min_by_key(|candidate| {
        (
            warm_task != Some(candidate.task.as_str()),
            candidate.held_by_others,
            candidate.first_unit,
        )
    })
}

#[cfg(test)]
mod tests {
    use rand_chacha::ChaCha8Rng;
    use rand_chacha::rand_core::SeedableRng;

    use super::*;
    use crate::ids::{Attempt, JobId};
    use crate::lease::JobState;

    fn waiting(task: &str, first_unit: i64, held_by_others: u32) -> WaitingTask {
        WaitingTask {
            task: task.to_owned(),
            first_unit,
            held_by_others,
        }
    }

    fn check(tasks: &[WaitingTask], warm: Option<&str>, expected: Option<&str>) {
        let chosen = choose_task(tasks, warm).map(|t| t.task.as_str());
        assert_eq!(chosen, expected);
    }

    #[test]
    fn a_claim_prefers_warmth_then_solitude_then_paired_unit_order() {
        let tasks = [
            waiting("libero_goal/0", 0, 2),
            waiting("libero_goal/1", 9, 1),
            waiting("libero_goal/2", 5, 1),
        ];
        check(&tasks, Some("libero_goal/0"), Some("libero_goal/0"));
        check(&tasks, Some("libero_goal/3"), Some("libero_goal/2"));
        check(&tasks, None, Some("libero_goal/2"));
        check(&tasks[..1], None, Some("libero_goal/0"));
        check(&[], None, None);
    }

    fn expired(job: i64, worker: &str, in_a_row: u32) -> ExpiredLease {
        let owner = WorkerId(worker.to_owned());
        ExpiredLease {
            job: Job {
                id: JobId(job),
                attempt: Attempt(1),
                charged_attempts: 0,
                state: JobState::Leased {
                    owner: owner.clone(),
                    granted: UnixMillis(0),
                    expires: UnixMillis(10),
                },
            },
            lease: LeaseRef {
                worker: owner,
                job: JobId(job),
                attempt: Attempt(1),
            },
            control_steps: 7,
            owner_failures_in_a_row: in_a_row,
            suspicion: Suspicion {
                failed_on_workers: 1,
                able_workers: 1,
            },
        }
    }

    #[test]
    fn a_silent_worker_is_struck_once_however_many_leases_it_loses() {
        let state = SweepState {
            last_sweep: UnixMillis(0),
            lease: Duration::from_secs(30),
            expired: vec![expired(1, "a", 0), expired(2, "a", 0), expired(3, "b", 4)],
        };
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let decisions = plan(&state, UnixMillis(1_000), &mut rng);
        let strikes: Vec<_> = decisions
            .iter()
            .filter_map(|decision| match decision {
                Decision::Strike { worker, strike } => Some((worker.0.as_str(), *strike)),
                _ => None,
            })
            .collect();
        let once = Strike {
            in_a_row: 1,
            stop: false,
        };
        let fifth = Strike {
            in_a_row: 5,
            stop: true,
        };
        assert_eq!(strikes, [("a", once), ("b", fifth)]);
        assert_eq!(decisions.len(), 5);
    }

    #[test]
    fn a_coordinator_that_slept_extends_leases_instead_of_blaming_workers() {
        let state = SweepState {
            last_sweep: UnixMillis(0),
            lease: Duration::from_secs(30),
            expired: vec![expired(1, "a", 0)],
        };
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let until = UnixMillis(60_000);
        assert_eq!(
            plan(&state, UnixMillis(30_000), &mut rng),
            [Decision::ExtendLeases { until }]
        );
    }
}
