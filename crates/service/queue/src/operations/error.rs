//! Why a request is not met.

use libero_ctrl::NotMeasurable;
use rollout_types::AttemptId;
use sqlx::SqliteConnection;

use crate::ids::{CampaignName, JobName, WorkerId};
use crate::store::{StoreError, campaigns};

/// A request that cannot be met.
#[derive(Clone, Debug, thiserror::Error)]
pub enum QueueError {
    /// The worker never announced itself here.
    #[error("serve worker `{worker}`: it is not registered with this coordinator; register first")]
    UnknownWorker {
        /// The worker.
        worker: WorkerId,
    },
    /// The worker may lease no more.
    #[error("lease to worker `{worker}`: {reason}")]
    WorkerStopped {
        /// The worker.
        worker: WorkerId,
        /// Why.
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
        /// The name that was asked for.
        campaign: CampaignName,
    },
    /// The campaign that last had the name has another one.
    #[error("find campaign `{campaign}`: it was renamed and is called `{now}`")]
    Renamed {
        /// The former name.
        campaign: CampaignName,
        /// The present name.
        now: CampaignName,
    },
    /// A campaign was to be called as another one is.
    #[error("rename campaign `{campaign}`: another one is called `{taken}`; choose another name")]
    NameTaken {
        /// The campaign that was to be renamed.
        campaign: CampaignName,
        /// The name.
        taken: CampaignName,
    },
    /// A campaign with results was to name another policy.
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
    /// A change would make no specification.
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
    /// A cancelled campaign was to go on.
    #[error("change campaign `{campaign}`: it is cancelled, which is final; create another")]
    Cancelled {
        /// The campaign.
        campaign: CampaignName,
    },
    /// A campaign that ended early was to go on.
    #[error(
        "change campaign `{campaign}`: it stopped early, as its rule says, which is final; create another without `stop` to run the rest"
    )]
    Stopped {
        /// The campaign.
        campaign: CampaignName,
    },
    /// A campaign with leased rollouts was to be deleted.
    #[error(
        "delete campaign `{campaign}`: {leased} of its rollouts are being run; cancel it first, or pause it and wait"
    )]
    CampaignInUse {
        /// The campaign.
        campaign: CampaignName,
        /// Number of its leased rollouts.
        leased: u64,
    },
    /// A campaign was to be deleted that another one follows from.
    #[error(
        "delete campaign `{campaign}`: campaign `{derived}` follows from it; delete that one first"
    )]
    GoneOnWith {
        /// The campaign that was to be deleted.
        campaign: CampaignName,
        /// The other one.
        derived: CampaignName,
    },
    /// Another campaign was to follow from one of the reference's realisation.
    #[error(
        "go on with campaign `{campaign}`: its realisation is reference, in which an axis is another perturbation in each condition; name a campaign with matched"
    )]
    Unmatched {
        /// The campaign.
        campaign: CampaignName,
    },
    /// A campaign was to be gone on with and another policy.
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
    /// Thresholds were to be measured of a campaign that has none.
    #[error("measure the thresholds of campaign `{campaign}`: {problem}")]
    NoThresholds {
        /// The campaign.
        campaign: CampaignName,
        /// Why not. Part of the message, because callers are sent nothing else.
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
    /// A job that is not in quarantine was to be retried.
    #[error("retry `{job}`: it is {state}; only a quarantined rollout can be retried")]
    NotQuarantined {
        /// The job.
        job: JobName,
        /// Its state.
        state: String,
    },
    /// A job that is over was to be skipped.
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

/// Why no campaign has a name.
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
