//! Results of a campaign for reports and exports.

use benchmark::attempt::{Digests, Fingerprints, Provenance};
use futures_util::TryStreamExt;
use sqlx::types::Json;

use super::View;
use crate::clock::UnixMillis;
use crate::ids::CampaignId;
use crate::store::outcomes::OutcomeRow;
use crate::store::results::StoredResult;
use crate::store::{Doing, StoreError};

/// State that a campaign's report depends on: equal editions have equal reports.
#[derive(Clone, Debug, PartialEq, Eq, sqlx_macros::FromRow)]
pub struct Edition {
    id: CampaignId,
    // Identifies the campaign, together with `id`.
    created_ms: UnixMillis,
    committed: i64,
    quarantined: i64,
    divergent: i64,
    // Number of jobs, to which clients may add.
    jobs: i64,
    // True if the campaign stopped early, so that not all of its results count.
    has_stopped: bool,
}

#[derive(Clone, Debug, sqlx_macros::FromRow)]
pub struct ExportedRow {
    pub rollout_id: String,
    pub replicate: u32,
    /// Manifest row, JSON.
    pub manifest_row: String,
    pub outcome: StoredResult,
}

/// A job for reports.
#[derive(Clone, Debug, sqlx_macros::FromRow)]
pub struct RecordRow {
    #[sqlx(flatten)]
    pub job: OutcomeRow,
    /// Name of the realisation, once the job is committed.
    pub realisation: Option<String>,
    /// Result, once the job is committed.
    pub outcome: Option<StoredResult>,
}

/// Manifest row and scene of a rollout.
#[derive(Clone, Debug, sqlx_macros::FromRow)]
pub struct SetupRow {
    pub rollout_id: String,
    /// Manifest row, JSON.
    pub manifest_row: String,
    /// Digests of the result, once the job is committed.
    #[sqlx(json(nullable))]
    pub digests: Option<Digests>,
}

impl Edition {
    pub fn is_of_same_campaign(&self, other: &Edition) -> bool {
        (self.id, self.created_ms) == (other.id, other.created_ms)
    }
}

impl View {
    /// Returns the state that a campaign's report depends on. The counts are read from the
    /// campaign's tally, except for the divergent rollouts, which are few and counted anew.
    pub async fn edition(&mut self, campaign: CampaignId) -> Result<Edition, StoreError> {
        sqlx::query_as(
            "SELECT id, created_ms, t.committed, t.quarantined,
                 (SELECT count(DISTINCT d.job_id) FROM divergence d JOIN job j ON j.id = d.job_id
                  WHERE j.campaign_id = ?1) AS divergent,
                 jobs,
                 EXISTS (SELECT 1 FROM stop WHERE campaign_id = ?1 AND stopped_ms IS NOT NULL)
                     AS has_stopped
             FROM campaign JOIN tally t ON t.campaign_id = id WHERE id = ?1",
        )
        .bind(campaign)
        .fetch_one(self.tx())
        .await
        .doing("check whether a campaign's results changed")
    }

    /// Returns up to `limit` committed rollouts in the order of rollout id and replicate, starting
    /// after the rollout and replicate `after`.
    pub async fn exported(
        &mut self,
        campaign: CampaignId,
        after: Option<(&str, u32)>,
        limit: u32,
    ) -> Result<Vec<ExportedRow>, StoreError> {
        let (rollout_id, replicate) = after.map_or(("", -1), |(id, k)| (id, i64::from(k)));
        sqlx::query_as(
            "SELECT j.rollout_id, j.replicate, j.manifest_row, r.outcome
             FROM job j JOIN result r ON r.job_id = j.id
             WHERE j.campaign_id = ? AND (j.rollout_id, j.replicate) > (?, ?)
             ORDER BY j.rollout_id, j.replicate LIMIT ?",
        )
        .bind(campaign)
        .bind(rollout_id)
        .bind(replicate)
        .bind(limit)
        .fetch_all(self.tx())
        .await
        .doing("read results")
    }

    /// Reads all jobs of a campaign with their results, by rollout id, then replicate. Each result
    /// is dropped when `read` has returned: those of a large campaign would fill the memory.
    pub async fn records<T>(
        &mut self,
        campaign: CampaignId,
        read: impl FnMut(RecordRow) -> T,
    ) -> Result<Vec<T>, StoreError> {
        sqlx::query_as(
            "SELECT j.rollout_id, j.replicate, j.init_id, j.state = 'quarantined' AS is_quarantined,
                 r.success, v.realisation, r.outcome
             FROM job j LEFT JOIN result r ON r.job_id = j.id
             LEFT JOIN provenance v ON v.id = r.provenance_id
             WHERE j.campaign_id = ? ORDER BY j.rollout_id, j.replicate",
        )
        .bind(campaign)
        .fetch(self.tx())
        .map_ok(read)
        .try_collect()
        .await
        .doing("read the records of a campaign's rollouts")
    }

    /// Returns the setups of a campaign's rollouts in the first replicate; the other replicates
    /// have equal setups.
    pub async fn setups(&mut self, campaign: CampaignId) -> Result<Vec<SetupRow>, StoreError> {
        sqlx::query_as(
            "SELECT j.rollout_id, j.manifest_row, r.outcome -> 'digests' AS digests
             FROM job j LEFT JOIN result r ON r.job_id = j.id
             WHERE j.campaign_id = ? AND j.replicate = 0",
        )
        .bind(campaign)
        .fetch_all(self.tx())
        .await
        .doing("read the manifest rows of a campaign")
    }

    /// Returns the policy seeds of a campaign, by rollout, then replicate.
    pub async fn policy_seeds(
        &mut self,
        campaign: CampaignId,
    ) -> Result<Vec<(String, u64)>, StoreError> {
        let rows: Vec<(String, i64)> = sqlx::query_as(
            "SELECT rollout_id, policy_seed FROM job WHERE campaign_id = ?
             ORDER BY rollout_id, replicate",
        )
        .bind(campaign)
        .fetch_all(self.tx())
        .await
        .doing("read a campaign's seeds")?;
        let seed = |(rollout, seed): (String, i64)| (rollout, seed.cast_unsigned());
        Ok(rows.into_iter().map(seed).collect())
    }

    pub async fn provenances(
        &mut self,
        campaign: CampaignId,
    ) -> Result<Vec<Provenance>, StoreError> {
        let rows: Vec<Json<Provenance>> = sqlx::query_scalar(
            "SELECT origin FROM provenance
             WHERE id IN (SELECT provenance_id FROM result WHERE campaign_id = ?) ORDER BY id",
        )
        .bind(campaign)
        .fetch_all(self.tx())
        .await
        .doing("read the provenance of results")?;
        Ok(rows.into_iter().map(|Json(row)| row).collect())
    }

    /// Returns the number of results of each fingerprint in a campaign, and the tasks and initial
    /// states that have several fingerprints; `None` unless the campaign has several fingerprints.
    /// Reads the committed jobs only in that case; the fingerprints are counted from tallies.
    pub async fn fingerprints(
        &mut self,
        campaign: CampaignId,
    ) -> Result<Option<Fingerprints>, StoreError> {
        let results: Vec<(String, i64)> = sqlx::query_as(
            "SELECT v.fingerprint, sum(o.results) FROM origin_tally o
             JOIN provenance v ON v.id = o.provenance_id
             WHERE o.campaign_id = ? AND o.results > 0
             GROUP BY v.fingerprint",
        )
        .bind(campaign)
        .fetch_all(self.tx())
        .await
        .doing("count the results of each fingerprint")?;
        if results.len() < 2 {
            return Ok(None);
        }
        let mixed: Vec<String> = sqlx::query_scalar(
            "SELECT format('%s from state %d', j.task, j.init_id) FROM job j
             JOIN result r ON r.job_id = j.id
             JOIN provenance v ON v.id = r.provenance_id
             WHERE j.campaign_id = ? AND j.state = 'committed'
             GROUP BY j.task, j.init_id HAVING count(DISTINCT v.fingerprint) > 1
             ORDER BY j.task, j.init_id",
        )
        .bind(campaign)
        .fetch_all(self.tx())
        .await
        .doing("find configurations with several fingerprints")?;
        let results = results.into_iter();
        Ok(Some(Fingerprints {
            results: results
                .map(|(fingerprint, count)| (fingerprint, count.unsigned_abs()))
                .collect(),
            mixed,
        }))
    }

    /// Returns the rollouts of a campaign that were reported again with another outcome.
    pub async fn divergent(
        &mut self,
        campaign: CampaignId,
    ) -> Result<Vec<(String, u32)>, StoreError> {
        sqlx::query_as(
            "SELECT DISTINCT j.rollout_id, j.replicate
             FROM divergence d JOIN job j ON j.id = d.job_id
             WHERE j.campaign_id = ? ORDER BY j.rollout_id, j.replicate",
        )
        .bind(campaign)
        .fetch_all(self.tx())
        .await
        .doing("read divergent outcomes")
    }
}
