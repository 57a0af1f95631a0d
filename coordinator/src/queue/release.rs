//! How an attempt ends that brought no result (with one: `commit`).

use std::time::Duration;

use sqlx::SqliteConnection;

use super::writer::Operation;
use super::{Queue, QueueError};
use crate::clock::UnixMillis;
use crate::ids::{CampaignId, JobId, LeaseRef, PolicyId, WorkerId};
use crate::lease::{
    AfterFailure, FailureReason, Job, JobState, MAX_WORKER_FAILURES_IN_A_ROW, Strike, Suspicion,
    strike,
};
use crate::outage::{Allowance, PolicyHealth, PolicyState};
use crate::store::{StoreError, campaigns, jobs, policies, workers};

/// What became of a job whose attempt ended without a result.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ReleaseVerdict {
    /// Back in the queue.
    Requeued,
    /// Set aside.
    Quarantined,
    /// The lease was gone: nothing changed.
    Stale,
}

/// An attempt that ended without an outcome, as a worker reports it.
#[derive(Clone, Debug)]
pub(super) struct Release {
    /// Under which lease.
    pub(super) lease: LeaseRef,
    /// Why.
    pub(super) reason: FailureReason,
    /// In words.
    pub(super) error: String,
}

/// The answer to a release.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ReleaseReply {
    /// What became of the job.
    pub verdict: ReleaseVerdict,
    /// Until it, or its policy, may be tried again.
    pub backoff: Duration,
    /// Why this worker must lease no more, if it must.
    pub stop_leasing: Option<String>,
}

impl Queue {
    /// Ends a lease without an outcome.
    ///
    /// # Errors
    /// When the job is unknown or the database fails.
    pub async fn release(
        &self,
        lease: &LeaseRef,
        reason: FailureReason,
        error: &str,
    ) -> Result<ReleaseReply, QueueError> {
        let release = Release {
            lease: lease.clone(),
            reason,
            error: error.to_owned(),
        };
        let reply = self
            .ask(|pending| Operation::Release(release, pending))
            .await?;
        if reply.verdict != ReleaseVerdict::Stale {
            tracing::info!(job = %lease.job, worker = %lease.worker, verdict = ?reply.verdict,
                "released ({}): {error}", reason.as_str());
        }
        Ok(reply)
    }

    pub(super) async fn release_in(
        &self,
        tx: &mut SqliteConnection,
        release: &Release,
    ) -> Result<ReleaseReply, QueueError> {
        let now = self.now();
        let lease = &release.lease;
        // First what may be refused: others' operations are in the transaction,
        // and what was written by then stays.
        let (job, campaign) = self.job(tx, lease.job).await?;
        workers::seen(tx, &[&lease.worker], now).await?;
        if !job.is_held_by(lease) {
            return Ok(ReleaseReply {
                verdict: ReleaseVerdict::Stale,
                backoff: Duration::ZERO,
                stop_leasing: None,
            });
        }
        let failure = (release.reason, release.error.as_str());
        Ok(self
            .end_attempt(tx, &job, campaign, lease, failure, now)
            .await?)
    }

    /// For and against setting a job aside that just failed on `worker`.
    pub(super) async fn suspicion(
        &self,
        tx: &mut SqliteConnection,
        job: JobId,
        campaign: CampaignId,
        worker: &WorkerId,
        now: UnixMillis,
    ) -> Result<Suspicion, StoreError> {
        let pin = campaigns::by_id(tx, campaign).await?.pin();
        Ok(Suspicion {
            failed_on_workers: jobs::failed_on_workers(tx, job, worker).await?,
            able_workers: self.able_workers(tx, pin.as_ref(), now).await?,
        })
    }

    /// Stores a worker's run of failures. Returns why it must stop, if it must.
    pub(super) async fn strike(
        &self,
        tx: &mut SqliteConnection,
        worker: &WorkerId,
        strike: Strike,
        last_error: &str,
    ) -> Result<Option<String>, StoreError> {
        let stop = strike.stop.then(|| {
            format!(
                "it has failed {} times in a row (the limit is {MAX_WORKER_FAILURES_IN_A_ROW}), \
                 the last time with: {last_error}; look at its machine, then start it again",
                strike.in_a_row
            )
        });
        workers::set_strike(tx, worker, strike, stop.as_deref()).await?;
        if let Some(reason) = &stop {
            tracing::error!(%worker, "this worker leases no more: {reason}");
        }
        Ok(stop)
    }

    /// A lease ended for a reason that says nothing about its policy.
    pub(super) async fn lease_told_nothing_of_its_policy(
        &self,
        tx: &mut SqliteConnection,
        lease: &LeaseRef,
        now: UnixMillis,
    ) -> Result<(), StoreError> {
        let policy = policies::of_job(tx, lease.job).await?;
        let before = policies::health(tx, policy).await?;
        let after = before.after_other_failure((lease.job, lease.attempt), now);
        self.set_health(tx, policy, (&before, &after), now).await
    }

    /// Stores a policy's health if it changed, and wakes waiting claims if its
    /// jobs may be leased now. Who is woken waits for this transaction's end:
    /// there is one writer.
    pub(super) async fn set_health(
        &self,
        tx: &mut SqliteConnection,
        policy: PolicyId,
        (before, after): (&PolicyHealth, &PolicyHealth),
        now: UnixMillis,
    ) -> Result<(), StoreError> {
        if after == before {
            return Ok(());
        }
        if after.allowance(now) != Allowance::Nothing {
            self.work.notify_waiters();
        }
        policies::set_health(tx, policy, after).await
    }

    pub(super) async fn job(
        &self,
        tx: &mut SqliteConnection,
        job: JobId,
    ) -> Result<(Job, CampaignId), QueueError> {
        jobs::load(tx, job)
            .await?
            .ok_or(QueueError::UnknownJob { job })
    }

    /// Ends a held attempt: requeues the job or sets it aside, counts the
    /// worker's failure, and tells the policy's health.
    pub(super) async fn end_attempt(
        &self,
        tx: &mut SqliteConnection,
        job: &Job,
        campaign: CampaignId,
        lease: &LeaseRef,
        (reason, error): (FailureReason, &str),
        now: UnixMillis,
    ) -> Result<ReleaseReply, StoreError> {
        let suspicion = self
            .suspicion(tx, job.id, campaign, &lease.worker, now)
            .await?;
        let then = self.decide(|rng| job.after_failure(reason, suspicion, now, rng));
        jobs::fail(tx, lease, reason, error, then, now).await?;
        let mut stop_leasing = None;
        if !reason.is_charged() {
            // It may be leased again at once.
            self.work.notify_waiters();
        } else {
            let standings = workers::standings(tx, &[&lease.worker]).await?;
            let in_a_row = standings
                .get(&lease.worker)
                .map_or(0, |s| s.charged_in_a_row);
            stop_leasing = self
                .strike(tx, &lease.worker, strike(in_a_row), error)
                .await?;
        }
        let policy_backoff = match reason {
            FailureReason::PolicyUnavailable => self.outage(tx, job, lease, error, now).await?,
            _ => {
                self.lease_told_nothing_of_its_policy(tx, lease, now)
                    .await?;
                Duration::ZERO
            }
        };
        Ok(match then {
            AfterFailure::Requeue { not_before } => ReleaseReply {
                verdict: ReleaseVerdict::Requeued,
                backoff: not_before.since(now).max(policy_backoff),
                stop_leasing,
            },
            AfterFailure::Quarantine => {
                tracing::error!(job = %job.id, "set aside after its last attempt: {error}");
                ReleaseReply {
                    verdict: ReleaseVerdict::Quarantined,
                    backoff: Duration::ZERO,
                    stop_leasing,
                }
            }
        })
    }

    /// A leased job could not reach its policy. Returns how long the policy's
    /// jobs wait.
    async fn outage(
        &self,
        tx: &mut SqliteConnection,
        job: &Job,
        lease: &LeaseRef,
        error: &str,
        now: UnixMillis,
    ) -> Result<Duration, StoreError> {
        let JobState::Leased { granted, .. } = job.state else {
            return Ok(Duration::ZERO);
        };
        let policy = policies::of_job(tx, lease.job).await?;
        let before = policies::health(tx, policy).await?;
        let attempt = (lease.job, lease.attempt);
        let after = self.decide(|rng| before.after_outage(attempt, granted, error, now, rng));
        if after != before {
            tracing::warn!("a policy is down, its jobs wait: {error}");
        }
        self.set_health(tx, policy, (&before, &after), now).await?;
        Ok(match after.state {
            PolicyState::Paused { resume, .. } => resume.since(now),
            PolicyState::Available | PolicyState::Probing { .. } => Duration::ZERO,
        })
    }
}
