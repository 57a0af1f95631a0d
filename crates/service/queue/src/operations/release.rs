//! How an attempt ends that brought no result (with one: `commit`).

use std::time::Duration;

use rollout_types::AttemptId;

use super::context::Context;
use super::error::QueueError;
use crate::rules::lease::{AfterFailure, FailureReason, JobState, LOSSES_UNTIL_ALONE, Party};
use crate::rules::outage::Contact;
use crate::store::StoreError;
use crate::store::jobs::{self, NamedAttempt};

/// Verdict on a job whose attempt ended without a result.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ReleaseVerdict {
    /// Back in the queue.
    Requeued,
    /// In quarantine.
    Quarantined,
    /// The lease was gone: nothing changed.
    Stale,
}

/// An attempt that ended without a result, as a worker reports it.
#[derive(Clone, Debug)]
pub(crate) struct Release {
    pub(crate) attempt: AttemptId,
    /// Why.
    pub(crate) reason: FailureReason,
    /// In words.
    pub(crate) error: String,
    /// Of a policy that was there at the attempt's first query and cannot be reached any
    /// more: the queries that it had answered.
    pub(crate) answered: Option<u32>,
}

/// The answer to a release.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ReleaseReply {
    /// Verdict on the job.
    pub verdict: ReleaseVerdict,
    /// Until it, or its policy, may be tried again.
    pub backoff: Duration,
    /// Why this worker must lease no more, if it must.
    pub stop_leasing: Option<String>,
}

impl Context<'_> {
    /// Ends a lease without a result.
    pub(super) async fn release(
        &mut self,
        release: &Release,
    ) -> Result<Result<ReleaseReply, QueueError>, StoreError> {
        let id = release.attempt;
        let mut named = jobs::named(&mut self.tx, &[id]).await?;
        let Some(attempt) = named.get_mut(&id) else {
            return Ok(Err(QueueError::UnknownAttempt { attempt: id }));
        };
        // Otherwise a heartbeat that was sent before could take up a lease whose worker has given
        // it back, and the next ones, which leave it out, would charge the machine.
        if let Some(lease) = self.resume(attempt).await? {
            attempt.job.state = JobState::Leased(lease);
        }
        let attempt = &*attempt;
        let Some(lease) = attempt.job.lease_of(id) else {
            return Ok(Ok(ReleaseReply {
                verdict: ReleaseVerdict::Stale,
                backoff: Duration::ZERO,
                stop_leasing: None,
            }));
        };
        let is_outage = release.reason == FailureReason::PolicyUnavailable;
        let reason = match is_outage && self.was_lost(attempt, release).await? {
            true => FailureReason::PolicyLost,
            false => release.reason,
        };
        let failure = (reason, release.error.as_str());
        let ended = self
            .end_attempt((&attempt.job, lease), attempt.of.campaign, failure)
            .await?;
        let stop_leasing = match release.reason.blames() {
            Some(Party::Machine) => self.strike(&lease.owner, &release.error).await?,
            _ => None,
        };
        let (verdict, backoff) = match ended.then {
            AfterFailure::Requeue { not_before } => {
                let backoff = not_before.since(self.now).max(ended.policy_wait);
                (ReleaseVerdict::Requeued, backoff)
            }
            AfterFailure::Quarantine => (ReleaseVerdict::Quarantined, Duration::ZERO),
        };
        Ok(Ok(ReleaseReply {
            verdict,
            backoff,
            stop_leasing,
        }))
    }

    /// Whether an attempt that cannot reach its policy had it and lost it.
    async fn was_lost(
        &mut self,
        attempt: &NamedAttempt,
        release: &Release,
    ) -> Result<bool, StoreError> {
        let mut contact = Contact {
            answered: release.answered,
            is_back: false,
            is_last: false,
        };
        // The rest is looked up only where it matters.
        if release.answered == Some(0) {
            let campaign = self.campaign(attempt.of.campaign).await?;
            let job = attempt.job.id;
            let last = jobs::last_without_policy(&mut self.tx, job).await?;
            contact.is_back = last.is_some_and(|last| campaign.health.available_since > last);
            let (policy, losses) = (campaign.policy_id, LOSSES_UNTIL_ALONE);
            contact.is_last = !jobs::others_wait(&mut self.tx, policy, job, losses).await?;
        }
        Ok(contact.was_lost())
    }
}
