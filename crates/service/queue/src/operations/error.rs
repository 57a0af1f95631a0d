//! Errors of requests to the queue.

use libero_ctrl::NotMeasurable;
use rollout_types::AttemptId;
use sqlx::SqliteConnection;

use crate::ids::{CampaignName, JobName, WorkerId};
use crate::store::{StoreError, campaigns};

/// A request that cannot be met.
#[derive(Clone, Debug, thiserror::Error)]
pub enum QueueError {
    /// The worker is not registered.
    #[error("serve worker `{worker}`: it is not registered with this coordinator; register first")]
    UnknownWorker {
        /// The worker.
        worker: WorkerId,
    },
    /// The worker may not lease any more.
    #[error("lease to worker `{worker}`: {reason}")]
    WorkerStopped {
        /// The worker.
        worker: WorkerId,
        /// Reason why it was stopped.
        reason: String,
    },
    /// There is no such attempt.
    #[error(
        "find attempt {attempt}: this coordinator granted no such lease, or deleted its campaign"
    )]
    UnknownAttempt {
        /// The attempt.
        attempt: AttemptId,
    },
    /// There is no such campaign.
    #[error(
        "find campaign `{campaign}`: this coordinator has no such campaign; `coordinator campaign list` shows what it has"
    )]
    UnknownCampaign {
        /// The name that was requested.
        campaign: CampaignName,
    },
    /// The campaign that last had this name was renamed.
    #[error("find campaign `{campaign}`: it was renamed and is called `{now}`")]
    Renamed {
        /// The former name.
        campaign: CampaignName,
        /// The present name.
        now: CampaignName,
    },
    /// The new name of a campaign is taken.
    #[error("rename campaign `{campaign}`: another one is called `{taken}`; choose another name")]
    NameTaken {
        /// The campaign that was to be renamed.
        campaign: CampaignName,
        /// The name that is taken.
        taken: CampaignName,
    },
    /// The policy of a campaign with results cannot be changed.
    #[error(
        "change the policy of campaign `{campaign}`: it has results of policy `{policy}`, {results} so far; create another campaign for another policy"
    )]
    PolicyMeasured {
        /// The campaign.
        campaign: CampaignName,
        /// Policy of its results.
        policy: String,
        /// Number of its results.
        results: u64,
    },
    /// The change would make the specification invalid.
    #[error("change campaign `{campaign}`: {problem}")]
    Unspecified {
        /// The campaign.
        campaign: CampaignName,
        /// The fault, and its remedy.
        problem: String,
    },
    /// Another specification has the name.
    #[error(
        "create campaign `{campaign}`: it exists with another specification (they differ in {differs}); choose another name"
    )]
    CampaignDiffers {
        /// The campaign.
        campaign: CampaignName,
        /// The fields that differ.
        differs: String,
    },
    /// A cancelled campaign cannot be changed.
    #[error("change campaign `{campaign}`: it is cancelled, which is final; create another")]
    Cancelled {
        /// The campaign.
        campaign: CampaignName,
    },
    /// A campaign that stopped early cannot be changed.
    #[error(
        "change campaign `{campaign}`: it stopped early, as its rule says, which is final; create another without `stop` to run the rest"
    )]
    Stopped {
        /// The campaign.
        campaign: CampaignName,
    },
    /// A campaign with leased rollouts cannot be deleted.
    #[error(
        "delete campaign `{campaign}`: {leased} of its rollouts are being run; cancel it first, or pause it and wait"
    )]
    CampaignInUse {
        /// The campaign.
        campaign: CampaignName,
        /// Number of its leased rollouts.
        leased: u64,
    },
    /// A campaign that another one derives from cannot be deleted.
    #[error(
        "delete campaign `{campaign}`: campaign `{derived}` follows from it; delete that one first"
    )]
    GoneOnWith {
        /// The campaign that was to be deleted.
        campaign: CampaignName,
        /// The campaign that derives from it.
        derived: CampaignName,
    },
    /// A campaign with the realisation `reference` cannot be derived from.
    #[error(
        "go on with campaign `{campaign}`: its realisation is reference, in which an axis is another perturbation in each condition; name a campaign with matched"
    )]
    Unmatched {
        /// The campaign.
        campaign: CampaignName,
    },
    /// A derived campaign must measure the policy of its source.
    #[error(
        "go on with campaign `{campaign}`: it measures policy `{policy}` at {endpoint}; name the same one"
    )]
    OtherPolicy {
        /// The campaign.
        campaign: CampaignName,
        /// The policy that it measures.
        policy: String,
        /// Endpoint of that policy.
        endpoint: String,
    },
    /// The campaign has no thresholds to measure.
    #[error("measure the thresholds of campaign `{campaign}`: {problem}")]
    NoThresholds {
        /// The campaign.
        campaign: CampaignName,
        /// Reason. Part of the message, because callers are sent nothing else.
        problem: NotMeasurable,
    },
    /// There is no such rollout in the campaign.
    #[error(
        "find `{job}`: campaign `{campaign}` has no such rollout; `coordinator jobs list {campaign}` shows what it has"
    )]
    UnknownRollout {
        /// The campaign.
        campaign: CampaignName,
        /// The rollout and its replicate.
        job: JobName,
    },
    /// Only quarantined jobs can be retried.
    #[error("retry `{job}`: it is {state}; only a quarantined rollout can be retried")]
    NotQuarantined {
        /// The job.
        job: JobName,
        /// Its state.
        state: String,
    },
    /// Only jobs that wait or are leased can be skipped.
    #[error(
        "skip `{job}`: it is {state}; only a rollout that waits or is being run can be skipped"
    )]
    NotSkippable {
        /// The job.
        job: JobName,
        /// Its state.
        state: String,
    },
    /// A backup is being made.
    #[error("make a backup: another one is being made; try again when it is done")]
    BackupInHand,
    /// The coordinator is shutting down.
    #[error("lease jobs: the coordinator is shutting down")]
    ShuttingDown,
    /// The database failed.
    #[error(transparent)]
    Store(#[from] StoreError),
}

/// Returns the error for a campaign name that is not found: unknown or renamed.
pub(crate) async fn unknown_campaign(
    tx: &mut SqliteConnection,
    name: &CampaignName,
) -> Result<QueueError, StoreError> {
    let campaign = name.clone();
    Ok(match campaigns::renamed(tx, name).await? {
        Some(now) => QueueError::Renamed { campaign, now },
        None => QueueError::UnknownCampaign { campaign },
    })
}
