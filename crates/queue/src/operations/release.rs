//! How an attempt ends that brought no result (with one: `commit`).

use std::time::Duration;

use attempt::AttemptId;

use super::context::Context;
use super::error::QueueError;
use crate::rules::lease::{AfterFailure, FailureReason, Party};
use crate::store::{StoreError, jobs};

/// What became of a job whose attempt ended without a result.
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
    /// Which.
    pub(crate) attempt: AttemptId,
    /// Why.
    pub(crate) reason: FailureReason,
    /// In words.
    pub(crate) error: String,
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

impl Context<'_> {
    /// Ends a lease without a result.
    pub(super) async fn release(
        &mut self,
        release: &Release,
    ) -> Result<Result<ReleaseReply, QueueError>, StoreError> {
        let id = release.attempt;
        let named = jobs::named(&mut self.tx, &[id]).await?;
        let Some(attempt) = named.get(&id) else {
            return Ok(Err(QueueError::UnknownAttempt { attempt: id }));
        };
        let Some(lease) = attempt.job.lease_of(id) else {
            return Ok(Ok(ReleaseReply {
                verdict: ReleaseVerdict::Stale,
                backoff: Duration::ZERO,
                stop_leasing: None,
            }));
        };
        let failure = (release.reason, release.error.as_str());
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
}
