//! Rollouts of a configuration for comparison.

use benchmark::attempt::{AttemptId, Motion, Provenance};
use sqlx::types::Text;

use super::View;
use crate::clock::UnixMillis;
use crate::ids::{AttemptNumber, CampaignId, JobId, WorkerId};
use crate::store::results::StoredResult;
use crate::store::{Doing, StoreError, json};

/// One rollout of a configuration with the state of its job.
#[derive(Clone, Debug, sqlx_macros::FromRow)]
pub struct RolloutLine {
    pub id: JobId,
    pub rollout_id: String,
    /// "queued", "leased", "committed" or "quarantined".
    pub state: String,
    /// Leases granted so far.
    pub attempt: AttemptNumber,
    pub charged_attempts: u32,
    /// Manifest row, JSON.
    pub manifest_row: String,
    pub policy_seed: i64,
    /// The worker that holds the job's lease; `None` unless the job is leased.
    pub lease_owner: Option<WorkerId>,
    /// The policy's control steps that the worker last reported; 0 while the scene settles, `None`
    /// unless the job is leased.
    pub control_steps: Option<u32>,
    /// Reports that were refused because their attempt no longer held the lease.
    pub stale_reports: u32,
}

/// Result of a rollout with its measurements and provenance.
#[derive(Clone, Debug, sqlx_macros::FromRow)]
pub struct ResultLine {
    pub job_id: JobId,
    #[sqlx(rename = "attempt_id")]
    pub attempt: Text<AttemptId>,
    /// Number of the attempt within its job.
    #[sqlx(rename = "attempt")]
    pub number: AttemptNumber,
    /// Worker that ran the attempt.
    pub worker_id: WorkerId,
    pub committed_ms: UnixMillis,
    pub outcome: StoredResult,
    /// Reports of an outcome that differs from the committed one.
    pub divergences: u32,
    /// Path of the rollout's video below the data folder.
    pub video: Option<String>,
    /// Size of the video, bytes.
    pub video_bytes: Option<i64>,
    /// Origin of the result: machine, assets, policy and program.
    #[sqlx(json)]
    pub provenance: Provenance,
}

impl View {
    pub async fn rollouts(
        &mut self,
        campaign: CampaignId,
        ids: &[String],
        replicate: u32,
    ) -> Result<Vec<RolloutLine>, StoreError> {
        sqlx::query_as(concat!(
            "SELECT id, rollout_id, state, attempt, charged_attempts, manifest_row, policy_seed,
                 lease_owner, ",
            policy_steps!(),
            ", stale_reports
             FROM job WHERE campaign_id = ? AND replicate = ?
                 AND rollout_id IN (SELECT value FROM json_each(?))",
        ))
        .bind(campaign)
        .bind(replicate)
        .bind(json(ids))
        .fetch_all(self.tx())
        .await
        .doing("read a configuration's rollouts")
    }

    pub async fn replicates(
        &mut self,
        campaign: CampaignId,
        rollout_id: &str,
    ) -> Result<Vec<u32>, StoreError> {
        sqlx::query_scalar(
            "SELECT replicate FROM job WHERE campaign_id = ? AND rollout_id = ? ORDER BY replicate",
        )
        .bind(campaign)
        .bind(rollout_id)
        .fetch_all(self.tx())
        .await
        .doing("read a rollout's replicates")
    }

    /// Returns a campaign's rollout ids in replicate 0 that start with a prefix and are longer than
    /// the prefix.
    pub async fn rollout_ids_with_prefix(
        &mut self,
        campaign: CampaignId,
        prefix: &str,
    ) -> Result<Vec<String>, StoreError> {
        sqlx::query_scalar(
            "SELECT rollout_id FROM job WHERE campaign_id = ?1 AND rollout_id > ?2
                 AND rollout_id < ?2 || '~' AND replicate = 0",
        )
        .bind(campaign)
        .bind(prefix)
        .fetch_all(self.tx())
        .await
        .doing("read a configuration's neighbours")
    }

    pub async fn results(&mut self, jobs: &[JobId]) -> Result<Vec<ResultLine>, StoreError> {
        sqlx::query_as(
            "SELECT r.job_id, r.attempt_id, r.attempt, r.worker_id, r.committed_ms, r.outcome,
                 (SELECT count(*) FROM divergence d WHERE d.job_id = r.job_id) AS divergences,
                 a.path AS video, a.size_bytes AS video_bytes, v.origin AS provenance
             FROM result r JOIN provenance v ON v.id = r.provenance_id
             LEFT JOIN artifact a ON a.attempt_id = r.attempt_id AND a.kind = 'video'
             WHERE r.job_id IN (SELECT value FROM json_each(?))",
        )
        .bind(json(jobs))
        .fetch_all(self.tx())
        .await
        .doing("read a configuration's results")
    }

    /// Returns the robots' paths in some committed jobs; the actions are not read and stay empty.
    pub async fn paths(&mut self, jobs: &[JobId]) -> Result<Vec<(JobId, Motion)>, StoreError> {
        let rows: Vec<(JobId, Vec<u8>)> = sqlx::query_as(
            "SELECT job_id, path FROM motion WHERE job_id IN (SELECT value FROM json_each(?))",
        )
        .bind(json(jobs))
        .fetch_all(self.tx())
        .await
        .doing("read the robot motions of a configuration")?;
        let motion = |(job, path)| {
            let actions = Vec::new();
            (job, Motion { path, actions })
        };
        Ok(rows.into_iter().map(motion).collect())
    }

    /// Returns the path of a rollout's video, below the data folder.
    pub async fn video(
        &mut self,
        campaign: CampaignId,
        rollout_id: &str,
        replicate: u32,
    ) -> Result<Option<String>, StoreError> {
        sqlx::query_scalar(
            "SELECT a.path FROM job j JOIN result r ON r.job_id = j.id
             JOIN artifact a ON a.attempt_id = r.attempt_id AND a.kind = 'video'
             WHERE j.campaign_id = ? AND j.rollout_id = ? AND j.replicate = ?",
        )
        .bind(campaign)
        .bind(rollout_id)
        .bind(replicate)
        .fetch_optional(self.tx())
        .await
        .doing("find a video")
    }
}
