//! What an operator does beside creating campaigns: pausing, resuming,
//! cancelling and deleting them, looking at jobs and workers, taking jobs out of
//! quarantine.

use std::io::ErrorKind;

use sqlx::SqliteConnection;

use super::{Queue, QueueError};
use crate::artifacts;
use crate::campaign::{CampaignState, CancelledIsFinal, Change};
use crate::clock::UnixMillis;
use crate::ids::{CampaignName, JobId, LeaseRef};
use crate::lease::{AfterFailure, FailureReason, may_retry};
use crate::store::backup::Backup;
use crate::store::campaigns::{CampaignRow, Counts};
use crate::store::failpoint::Step;
use crate::store::listing::{self, JobDetails, JobLine, WorkerLine};
use crate::store::{StoreError, campaigns, jobs, removals};

/// Most jobs that one look at a campaign shows.
pub const MAX_JOBS_LISTED: u32 = 1_000;
/// Most workers that one look shows: those heard of last.
pub const MAX_WORKERS_LISTED: u32 = 1_000;
/// Most jobs that are named to be taken out of quarantine at once; all of a
/// campaign's may be, too.
pub const MAX_JOBS_RETRIED: usize = 1_000;

/// A job by the names that people use.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct JobName {
    /// Which rollout.
    pub rollout_id: String,
    /// Which replicate of it.
    pub replicate: u32,
}

/// Which jobs to take out of quarantine.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Retry {
    /// All of the campaign's.
    All,
    /// These; each must be there.
    Named(Vec<JobName>),
}

/// Which jobs to look at.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct JobFilter<'a> {
    /// "queued", "leased", "committed" or "quarantined"; all without it.
    pub state: Option<&'a str>,
    /// Those after this one.
    pub after: JobId,
    /// At most so many; bounded by [`MAX_JOBS_LISTED`].
    pub limit: u32,
}

/// A worker, and whether it counts as alive.
#[derive(Clone, Debug)]
pub struct WorkerStatus {
    /// What is stored of it.
    pub line: WorkerLine,
    /// Seconds since it was last heard of.
    pub silent_secs: f64,
    /// Heard of lately.
    pub is_alive: bool,
}

/// A copy of the database on its way out; the next one may be made when it is
/// dropped.
#[derive(Debug)]
pub struct BackupInHand {
    backup: Backup,
    _turn: tokio::sync::OwnedMutexGuard<()>,
}

impl BackupInHand {
    /// The file.
    pub fn path(&self) -> &std::path::Path {
        self.backup.path()
    }
}

impl Queue {
    /// Pauses, resumes or cancels a campaign. Cancelling takes its leases back,
    /// charged to nobody; their workers hear of it with their next heartbeat.
    ///
    /// # Errors
    /// When there is no such campaign, it is cancelled already, or the database
    /// fails.
    pub async fn change_campaign(
        &self,
        name: &CampaignName,
        change: Change,
    ) -> Result<CampaignState, QueueError> {
        let now = self.now();
        let mut tx = self.store.write(Step::ChangeCampaign).await?;
        let row = self.campaign(&mut tx, name).await?;
        let before = row.state()?;
        let after = before.after(change, now);
        let after = after.map_err(|CancelledIsFinal| QueueError::Cancelled {
            campaign: name.clone(),
        })?;
        if after == before {
            return Ok(after);
        }
        campaigns::set_state(&mut tx, row.id, after).await?;
        if let CampaignState::Cancelled { .. } = after {
            for lease in jobs::leased(&mut tx, row.id).await? {
                self.take_back(&mut tx, &lease, now).await?;
            }
        }
        tx.commit().await?;
        tracing::info!(campaign = %name, "the campaign is {}", after.name());
        self.work.notify_waiters();
        Ok(after)
    }

    /// Deletes a campaign with its jobs, results and files.
    ///
    /// # Errors
    /// When there is no such campaign, some of its rollouts are leased, or the
    /// database fails. Files that cannot be removed now are removed at the next
    /// start.
    pub async fn delete_campaign(&self, name: &CampaignName) -> Result<Counts, QueueError> {
        let folder = artifacts::campaign_folder(name);
        let _alone = self.campaigns.lock().await;
        let mut tx = self.store.write(Step::DeleteCampaign).await?;
        let row = self.campaign(&mut tx, name).await?;
        let counts = campaigns::counts(&mut tx, row.id).await?;
        if counts.leased > 0 {
            return Err(QueueError::CampaignInUse {
                campaign: name.clone(),
                leased: counts.leased,
            });
        }
        campaigns::delete(&mut tx, row.id).await?;
        // Another campaign may get its number.
        self.known.lock().await.forget();
        removals::note(&mut tx, &folder).await?;
        tx.commit().await?;
        tracing::warn!(campaign = %name, jobs = counts.total(), results = counts.committed,
            "the campaign was deleted");
        self.finish_removal(&folder).await?;
        Ok(counts)
    }

    /// Up to [`MAX_JOBS_LISTED`] jobs of a campaign, in paired-unit order.
    ///
    /// # Errors
    /// When there is no such campaign or the database fails.
    pub async fn list_jobs(
        &self,
        campaign: &CampaignName,
        filter: JobFilter<'_>,
    ) -> Result<Vec<JobLine>, QueueError> {
        let mut view = self.store.read().await?;
        let row = self.campaign(&mut view, campaign).await?;
        let limit = filter.limit.clamp(1, MAX_JOBS_LISTED);
        Ok(listing::jobs(&mut view, row.id, filter.state, filter.after, limit).await?)
    }

    /// Everything about one job.
    ///
    /// # Errors
    /// When there is no such campaign or job, or the database fails.
    pub async fn job_details(
        &self,
        campaign: &CampaignName,
        job: &JobName,
    ) -> Result<JobDetails, QueueError> {
        let mut view = self.store.read().await?;
        let row = self.campaign(&mut view, campaign).await?;
        let line = self.line(&mut view, &row, job).await?;
        Ok(listing::details(&mut view, line).await?)
    }

    /// Takes jobs out of quarantine; all of those that are named, or none.
    /// Returns how many.
    ///
    /// # Errors
    /// When the campaign or a job is unknown, the campaign is cancelled, a job
    /// is not in quarantine, or the database fails.
    pub async fn retry_jobs(
        &self,
        campaign: &CampaignName,
        retry: &Retry,
    ) -> Result<u64, QueueError> {
        let now = self.now();
        let mut tx = self.store.write(Step::RetryJobs).await?;
        let row = self.campaign(&mut tx, campaign).await?;
        if let CampaignState::Cancelled { .. } = row.state()? {
            return Err(QueueError::Cancelled {
                campaign: campaign.clone(),
            });
        }
        let chosen = match retry {
            Retry::All => jobs::quarantined(&mut tx, row.id).await?,
            Retry::Named(names) => {
                let mut chosen = Vec::with_capacity(names.len());
                for name in names {
                    chosen.push(self.set_aside(&mut tx, &row, name).await?);
                }
                chosen
            }
        };
        for job in &chosen {
            jobs::retry(&mut tx, *job, now).await?;
        }
        tx.commit().await?;
        tracing::info!(%campaign, jobs = chosen.len(), "taken out of quarantine");
        self.work.notify_waiters();
        Ok(chosen.len() as u64)
    }

    /// Up to [`MAX_WORKERS_LISTED`] workers, those heard of last first.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn list_workers(&self) -> Result<Vec<WorkerStatus>, QueueError> {
        let now = self.now();
        let mut view = self.store.read().await?;
        let lines = listing::workers(&mut view, MAX_WORKERS_LISTED).await?;
        let status = |line: WorkerLine| {
            let silent = now.since(line.last_seen_ms);
            WorkerStatus {
                silent_secs: silent.as_secs_f64(),
                is_alive: silent <= self.timing.worker_alive,
                line,
            }
        };
        Ok(lines.into_iter().map(status).collect())
    }

    /// Copies the database as it is now, while it is used.
    ///
    /// # Errors
    /// When another copy is being made, the disk is full, or the database
    /// fails.
    pub async fn backup(&self) -> Result<BackupInHand, QueueError> {
        let turn = self.backing_up.clone().try_lock_owned();
        let turn = turn.map_err(|_| QueueError::BackupInHand)?;
        Ok(BackupInHand {
            backup: self.store.backup().await?,
            _turn: turn,
        })
    }

    /// Removes the files of campaigns that were deleted by a process that died
    /// before it removed them.
    pub(super) async fn finish_removals(&self) -> Result<(), StoreError> {
        let mut view = self.store.read().await?;
        let pending = removals::pending(&mut view).await?;
        drop(view);
        for folder in pending {
            self.finish_removal(&folder).await?;
        }
        Ok(())
    }

    /// Removes a deleted campaign's folder. One that stays is told of, and
    /// tried again at the next start.
    async fn finish_removal(&self, folder: &str) -> Result<(), StoreError> {
        let path = self.store.folder().join(folder);
        match tokio::fs::remove_dir_all(&path).await {
            Err(error) if error.kind() != ErrorKind::NotFound => {
                tracing::error!(
                    "failed to remove {}: {error}; the next start tries again",
                    path.display()
                );
                return Ok(());
            }
            _ => {}
        }
        let mut tx = self.store.write(Step::FinishRemoval).await?;
        removals::done(&mut tx, folder).await?;
        tx.commit().await
    }

    pub(super) async fn campaign(
        &self,
        tx: &mut SqliteConnection,
        name: &CampaignName,
    ) -> Result<CampaignRow, QueueError> {
        let row = campaigns::by_name(tx, name).await?;
        row.ok_or_else(|| QueueError::UnknownCampaign {
            campaign: name.clone(),
        })
    }

    async fn take_back(
        &self,
        tx: &mut SqliteConnection,
        lease: &LeaseRef,
        now: UnixMillis,
    ) -> Result<(), StoreError> {
        let then = AfterFailure::Requeue { not_before: now };
        let reason = FailureReason::Cancelled;
        jobs::fail(tx, lease, reason, "the campaign was cancelled", then, now).await?;
        self.lease_told_nothing_of_its_policy(tx, lease, now).await
    }

    async fn line(
        &self,
        tx: &mut SqliteConnection,
        campaign: &CampaignRow,
        job: &JobName,
    ) -> Result<JobLine, QueueError> {
        let line = listing::job(tx, campaign.id, &job.rollout_id, job.replicate).await?;
        line.ok_or_else(|| QueueError::UnknownRollout {
            campaign: campaign.name.clone(),
            job: job.clone(),
        })
    }

    /// A job that is named to be retried, if it may be.
    async fn set_aside(
        &self,
        tx: &mut SqliteConnection,
        campaign: &CampaignRow,
        name: &JobName,
    ) -> Result<JobId, QueueError> {
        let line = self.line(tx, campaign, name).await?;
        let (job, _) = self.job(tx, line.id).await?;
        if !may_retry(&job.state) {
            return Err(QueueError::NotSetAside {
                job: name.clone(),
                state: line.state,
            });
        }
        Ok(line.id)
    }
}

impl std::fmt::Display for JobName {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self.replicate {
            0 => f.write_str(&self.rollout_id),
            replicate => write!(f, "{}#r{replicate}", self.rollout_id),
        }
    }
}
