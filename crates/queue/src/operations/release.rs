//! End of an attempt without a result; `commit` handles attempts with a result.

use std::time::Duration;

use benchmark::attempt::AttemptId;

use super::context::Context;
use super::error::QueueError;
use crate::rules::lease::{AfterFailure, FailureReason, JobState, LOSSES_UNTIL_ALONE, Party};
use crate::rules::outage::Contact;
use crate::store::StoreError;
use crate::store::jobs::{self, NamedAttempt};

/// Verdict on a job whose attempt ended without a result.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ReleaseVerdict {
    Requeued,
    Quarantined,
    /// Ignored, because the attempt no longer holds the lease.
    Stale,
}

/// An attempt that ended without a result, as a worker reports it.
#[derive(Clone, Debug)]
pub(crate) struct Release {
    pub(crate) attempt: AttemptId,
    pub(crate) reason: FailureReason,
    pub(crate) error: String,
    /// Queries that the policy had answered, if it had described itself to the attempt and was lost
    /// later.
    pub(crate) answered: Option<u32>,
}

/// Answer to the report of an attempt that ended without a result.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ReleaseReply {
    pub verdict: ReleaseVerdict,
    /// Time until both the job and its policy may be tried again; zero if the job was quarantined
    /// or the attempt is stale.
    pub backoff: Duration,
    /// Reason why this worker must stop leasing; `None` if it may continue.
    pub stop_leasing: Option<String>,
}

impl Context<'_> {
    /// Ends a lease without a result.
    pub(super) async fn release(
        &mut self,
        release: &Release,
    ) -> Result<Result<ReleaseReply, QueueError>, StoreError> {
        let id = release.attempt;
        let mut named = jobs::attempts_by_id(&mut self.tx, &[id]).await?;
        let Some(attempt) = named.get_mut(&id) else {
            return Ok(Err(QueueError::UnknownAttempt { attempt: id }));
        };
        // The lease of a worker that was cut off is resumed before it ends. Otherwise a heartbeat
        // sent before the release could resume the lease later, and the following heartbeats, which
        // omit the attempt, would charge the machine.
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
            .end_attempt((&attempt.job, lease), attempt.initial_state.campaign, failure)
            .await?;
        let stop_leasing = match release.reason.blames() {
            Some(Party::Machine) => self.strike(&lease.owner, &release.error).await?,
            _ => None,
        };
        let (verdict, backoff) = match ended.next_step {
            AfterFailure::Requeue { not_before } => {
                let backoff = not_before.since(self.now).max(ended.policy_wait);
                (ReleaseVerdict::Requeued, backoff)
            }
            AfterFailure::Quarantine => (ReleaseVerdict::Quarantined, Duration::ZERO),
        };
        Ok(Ok(ReleaseReply { verdict, backoff, stop_leasing }))
    }

    /// Returns true if an attempt that cannot reach its policy had reached it earlier and lost it.
    async fn was_lost(
        &mut self,
        attempt: &NamedAttempt,
        release: &Release,
    ) -> Result<bool, StoreError> {
        let mut contact = Contact { answered: release.answered, is_back: false, is_last: false };
        // If the policy answered no query, two further facts decide; they are read only then.
        if release.answered == Some(0) {
            let campaign = self.campaign(attempt.initial_state.campaign).await?;
            let job = attempt.job.id;
            let last = jobs::last_without_policy(&mut self.tx, job).await?;
            contact.is_back = last.is_some_and(|last| campaign.health.available_since > last);
            let (policy, losses) = (campaign.policy_id, LOSSES_UNTIL_ALONE);
            contact.is_last = !jobs::has_other_waiting(&mut self.tx, policy, job, losses).await?;
        }
        Ok(contact.was_lost())
    }
}
