//! Errors of requests to the queue.

use benchmark::attempt::AttemptId;
use sqlx::SqliteConnection;

use crate::ids::{CampaignName, JobName, WorkerId};
use crate::store::{StoreError, campaigns};

/// A request that cannot be met.
#[derive(Clone, Debug, thiserror::Error)]
pub enum QueueError {
    #[error("serve worker `{worker}`: it is not registered with this coordinator; register first")]
    UnknownWorker { worker: WorkerId },
    #[error("lease to worker `{worker}`: {reason}")]
    WorkerStopped { worker: WorkerId, reason: String },
    #[error(
        "find attempt {attempt}: this coordinator granted no such lease, or deleted its campaign"
    )]
    UnknownAttempt { attempt: AttemptId },
    #[error(
        "find campaign `{campaign}`: this coordinator has no such campaign; `coordinator campaign status` lists its campaigns"
    )]
    UnknownCampaign { campaign: CampaignName },
    #[error("find campaign `{campaign}`: it was renamed and is called `{now}`")]
    Renamed { campaign: CampaignName, now: CampaignName },
    #[error("rename campaign `{campaign}`: another one is called `{taken}`; choose another name")]
    NameTaken { campaign: CampaignName, taken: CampaignName },
    #[error(
        "change the policy of campaign `{campaign}`: it has results of policy `{policy}`, {results} so far; create another campaign for another policy"
    )]
    PolicyMeasured { campaign: CampaignName, policy: String, results: u64 },
    #[error("change campaign `{campaign}`: {problem}")]
    Unspecified { campaign: CampaignName, problem: String },
    #[error(
        "create campaign `{campaign}`: it exists with another specification (they differ in {differs}); choose another name"
    )]
    CampaignDiffers { campaign: CampaignName, differs: String },
    #[error("change campaign `{campaign}`: it is cancelled, which is final; create another")]
    Cancelled { campaign: CampaignName },
    #[error(
        "change campaign `{campaign}`: it stopped early because its stop rule was met, which is \
         final; create another without `stop` to run the remaining rollouts"
    )]
    Stopped { campaign: CampaignName },
    #[error(
        "delete campaign `{campaign}`: {leased} of its rollouts are being run; cancel it first, or pause it and wait"
    )]
    CampaignInUse { campaign: CampaignName, leased: u64 },
    #[error(
        "delete campaign `{campaign}`: campaign `{derived}` is derived from it; delete that one first"
    )]
    HasDerived { campaign: CampaignName, derived: CampaignName },
    #[error(
        "find `{job}`: campaign `{campaign}` has no such rollout; `coordinator jobs {campaign}` lists its rollouts"
    )]
    UnknownRollout { campaign: CampaignName, job: JobName },
    #[error("retry `{job}`: it is {state}; only a quarantined rollout can be retried")]
    NotQuarantined { job: JobName, state: String },
    #[error(
        "skip `{job}`: it is {state}; only a rollout that waits or is being run can be skipped"
    )]
    NotSkippable { job: JobName, state: String },
    #[error("make a backup: another backup is being made; try again when it is done")]
    BackupInHand,
    #[error("lease jobs: the coordinator is shutting down")]
    ShuttingDown,
    #[error(transparent)]
    Store(#[from] StoreError),
}

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
