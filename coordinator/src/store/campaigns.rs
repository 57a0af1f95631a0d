//! Statements on `campaign` and `campaign_task`: creating, pinning, moving,
//! counting, deleting.

use protocol::Realisation;
use sqlx::{QueryBuilder, Sqlite, SqliteConnection};

use super::{Doing, StoreError, policies, undecodable};
use crate::campaign::CampaignState;
use crate::clock::UnixMillis;
use crate::expand::{NewCampaign, NewJob};
use crate::ids::{CampaignId, CampaignName, PolicyId};
use crate::outage::PolicyHealth;
use crate::store::policies::{HealthColumns, HealthRow};
use crate::store::workers::Pin;

/// Jobs inserted by one statement: SQLite binds at most 32,766 values.
const JOBS_PER_INSERT: usize = 1_000;

/// A campaign as it is stored.
#[derive(Clone, Debug, sqlx::FromRow)]
pub(crate) struct CampaignRow {
    pub(crate) id: CampaignId,
    pub(crate) name: CampaignName,
    pub(crate) spec: String,
    pub(crate) spec_digest: String,
    pub(crate) policy: String,
    pub(crate) endpoint: String,
    pub(crate) realisation: String,
    pub(crate) state: String,
    pub(crate) state_since_ms: UnixMillis,
    pub(crate) pinned_ms: Option<UnixMillis>,
    pub(crate) asset_pack: Option<String>,
    pub(crate) asset_pack_digest: Option<String>,
    pub(crate) mujoco_version: Option<String>,
    pub(crate) renderer: Option<String>,
}

/// How a campaign's jobs are spread over the states.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// Wait.
    pub queued: u64,
    /// Are being run.
    pub leased: u64,
    /// Have a result.
    pub committed: u64,
    /// Were set aside.
    pub quarantined: u64,
    /// Of the committed, those that reached their goal.
    pub succeeded: u64,
}

/// The columns of [`CampaignRow`].
macro_rules! campaign_columns {
    () => {
        "c.id, c.name, c.spec, c.spec_digest, p.name AS policy, p.endpoint,
         c.realisation, c.state, c.state_since_ms, c.pinned_ms, c.asset_pack, c.asset_pack_digest,
         c.mujoco_version, c.renderer"
    };
}

impl CampaignRow {
    /// What the campaign is pinned to, once its first job was leased.
    pub(crate) fn pin(&self) -> Option<Pin> {
        Some(Pin {
            asset_pack: self.asset_pack.clone()?,
            asset_pack_digest: self.asset_pack_digest.clone()?,
            mujoco_version: self.mujoco_version.clone()?,
            renderer: self.renderer.clone().unwrap_or_default(),
        })
    }

    /// Where its perturbations' random elements come from.
    pub(crate) fn mode(&self) -> Result<Realisation, StoreError> {
        let mode = self.realisation.parse().map_err(undecodable);
        mode.doing("read a campaign's realisation mode")
    }
}

impl CampaignRow {
    /// Where it stands with its operator; the CHECK constraints promise that
    /// this works.
    pub(crate) fn state(&self) -> Result<CampaignState, StoreError> {
        CampaignState::from_name(&self.state, self.state_since_ms).ok_or_else(|| StoreError {
            doing: "read a campaign's state",
            source: sqlx::Error::Decode(format!("campaign state `{}`", self.state).into()),
        })
    }
}

impl Counts {
    /// All jobs.
    pub fn total(&self) -> u64 {
        self.queued + self.leased + self.committed + self.quarantined
    }
}

/// Stores a campaign and all its jobs.
pub(crate) async fn insert(
    tx: &mut SqliteConnection,
    campaign: &NewCampaign,
    now: UnixMillis,
) -> Result<(), StoreError> {
    let policy =
        policies::find_or_insert(tx, &campaign.policy_endpoint, &campaign.policy, now).await?;
    let id: CampaignId = sqlx::query_scalar(
        "INSERT INTO campaign (name, spec, spec_digest, policy_id, realisation, record,
             jobs, created_ms, state_since_ms)
         VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?8) RETURNING id",
    )
    .bind(&campaign.name)
    .bind(&campaign.spec)
    .bind(&campaign.spec_digest)
    .bind(policy)
    .bind(&campaign.realisation)
    .bind(campaign.record)
    .bind(campaign.jobs.len() as i64)
    .bind(now)
    .fetch_one(&mut *tx)
    .await
    .doing("store a campaign")?;
    for task in campaign.tasks() {
        sqlx::query("INSERT INTO campaign_task (campaign_id, task) VALUES (?, ?)")
            .bind(id)
            .bind(task)
            .execute(&mut *tx)
            .await
            .doing("store a campaign's tasks")?;
    }
    for jobs in campaign.jobs.chunks(JOBS_PER_INSERT) {
        insert_jobs(tx, id, jobs).await?;
    }
    Ok(())
}

async fn insert_jobs(
    tx: &mut SqliteConnection,
    campaign: CampaignId,
    jobs: &[NewJob],
) -> Result<(), StoreError> {
    let mut insert: QueryBuilder<Sqlite> = QueryBuilder::new(
        "INSERT INTO job (campaign_id, rollout_id, replicate, task, init_id, unit_order,
             manifest_row, policy_seed) ",
    );
    insert.push_values(jobs, |mut row, job| {
        row.push_bind(campaign)
            .push_bind(&job.rollout_id)
            .push_bind(job.replicate)
            .push_bind(&job.task)
            .push_bind(job.init_id)
            .push_bind(job.unit_order)
            .push_bind(&job.manifest_row)
            .push_bind(job.policy_seed.cast_signed());
    });
    insert.build().execute(tx).await.doing("store jobs")?;
    Ok(())
}

/// A campaign by its name.
pub(crate) async fn by_name(
    tx: &mut SqliteConnection,
    name: &CampaignName,
) -> Result<Option<CampaignRow>, StoreError> {
    sqlx::query_as(concat!(
        "SELECT ",
        campaign_columns!(),
        " FROM campaign c JOIN policy p ON p.id = c.policy_id WHERE c.name = ?"
    ))
    .bind(name)
    .fetch_optional(tx)
    .await
    .doing("look up a campaign")
}

/// A campaign by its row number.
pub(crate) async fn by_id(
    tx: &mut SqliteConnection,
    id: CampaignId,
) -> Result<CampaignRow, StoreError> {
    sqlx::query_as(concat!(
        "SELECT ",
        campaign_columns!(),
        " FROM campaign c JOIN policy p ON p.id = c.policy_id WHERE c.id = ?"
    ))
    .bind(id)
    .fetch_one(tx)
    .await
    .doing("look up a campaign")
}

/// A campaign by its row number, with its policy and that policy's health.
pub(crate) async fn with_health(
    tx: &mut SqliteConnection,
    id: CampaignId,
) -> Result<(CampaignRow, PolicyId, PolicyHealth), StoreError> {
    #[derive(sqlx::FromRow)]
    struct Row {
        #[sqlx(flatten)]
        campaign: CampaignRow,
        policy_id: PolicyId,
        policy_state: String,
        #[sqlx(flatten)]
        health: HealthColumns,
    }
    let row: Row = sqlx::query_as(concat!(
        "SELECT ",
        campaign_columns!(),
        ", c.policy_id, p.state AS policy_state, p.outages, p.available_ms, p.resume_ms,
             p.pause_reason, p.probe_job_id, p.probe_attempt
          FROM campaign c JOIN policy p ON p.id = c.policy_id WHERE c.id = ?"
    ))
    .bind(id)
    .fetch_one(tx)
    .await
    .doing("look up a campaign")?;
    let health = row.health.into_health(&row.policy_state)?;
    Ok((row.campaign, row.policy_id, health))
}

/// All campaigns, oldest first.
pub(crate) async fn all(tx: &mut SqliteConnection) -> Result<Vec<CampaignRow>, StoreError> {
    sqlx::query_as(concat!(
        "SELECT ",
        campaign_columns!(),
        " FROM campaign c JOIN policy p ON p.id = c.policy_id ORDER BY c.id"
    ))
    .fetch_all(tx)
    .await
    .doing("list campaigns")
}

/// The campaigns of which jobs wait, oldest first.
pub(crate) async fn waiting(tx: &mut SqliteConnection) -> Result<Vec<CampaignRow>, StoreError> {
    sqlx::query_as(concat!(
        "SELECT ",
        campaign_columns!(),
        " FROM campaign c JOIN policy p ON p.id = c.policy_id
          WHERE c.state <> 'cancelled' AND EXISTS
              (SELECT 1 FROM job j WHERE j.campaign_id = c.id AND j.state = 'queued')
          ORDER BY c.id"
    ))
    .fetch_all(tx)
    .await
    .doing("list campaigns with waiting jobs")
}

/// Pins a campaign to what its first worker runs on; what it is pinned to
/// stays as it is.
pub(crate) async fn pin(
    tx: &mut SqliteConnection,
    id: CampaignId,
    pin: &Pin,
    now: UnixMillis,
) -> Result<(), StoreError> {
    sqlx::query(
        "UPDATE campaign SET pinned_ms = coalesce(pinned_ms, ?),
             asset_pack = coalesce(asset_pack, ?),
             asset_pack_digest = coalesce(asset_pack_digest, ?),
             mujoco_version = coalesce(mujoco_version, ?), renderer = ?
         WHERE id = ? AND renderer IS NULL",
    )
    .bind(now)
    .bind(&pin.asset_pack)
    .bind(&pin.asset_pack_digest)
    .bind(&pin.mujoco_version)
    .bind(&pin.renderer)
    .bind(id)
    .execute(tx)
    .await
    .doing("pin a campaign")?;
    Ok(())
}

/// Stores where a campaign stands with its operator.
pub(crate) async fn set_state(
    tx: &mut SqliteConnection,
    id: CampaignId,
    state: CampaignState,
) -> Result<(), StoreError> {
    sqlx::query("UPDATE campaign SET state = ?, state_since_ms = ? WHERE id = ?")
        .bind(state.name())
        .bind(state.since())
        .bind(id)
        .execute(tx)
        .await
        .doing("store a campaign's state")?;
    Ok(())
}

/// Removes a campaign with its jobs and their results.
pub(crate) async fn delete(tx: &mut SqliteConnection, id: CampaignId) -> Result<(), StoreError> {
    // Jobs first: each row of `campaign_task` would look for its own.
    for statement in [
        "DELETE FROM job WHERE campaign_id = ?",
        "DELETE FROM campaign WHERE id = ?",
    ] {
        sqlx::query(statement)
            .bind(id)
            .execute(&mut *tx)
            .await
            .doing("delete a campaign")?;
    }
    Ok(())
}

/// How a campaign's jobs are spread over the states. Each count walks one
/// partial index, none the table.
pub(crate) async fn counts(
    tx: &mut SqliteConnection,
    id: CampaignId,
) -> Result<Counts, StoreError> {
    let (queued, leased, committed, quarantined, succeeded): (i64, i64, i64, i64, i64) =
        sqlx::query_as(
            "SELECT
                 (SELECT count(*) FROM job WHERE campaign_id = ?1 AND state = 'queued'),
                 (SELECT count(*) FROM job WHERE campaign_id = ?1 AND state = 'leased'),
                 (SELECT count(*) FROM job WHERE campaign_id = ?1 AND state = 'committed'),
                 (SELECT count(*) FROM job WHERE campaign_id = ?1 AND state = 'quarantined'),
                 (SELECT count(*) FROM result WHERE campaign_id = ?1 AND success = 1)",
        )
        .bind(id)
        .fetch_one(tx)
        .await
        .doing("count a campaign's jobs")?;
    Ok(Counts {
        queued: queued.unsigned_abs(),
        leased: leased.unsigned_abs(),
        committed: committed.unsigned_abs(),
        quarantined: quarantined.unsigned_abs(),
        succeeded: succeeded.unsigned_abs(),
    })
}

/// Results of a campaign committed since `since`.
pub(crate) async fn committed_since(
    tx: &mut SqliteConnection,
    id: CampaignId,
    since: UnixMillis,
) -> Result<u64, StoreError> {
    let count: i64 = sqlx::query_scalar(
        "SELECT count(*) FROM result WHERE campaign_id = ? AND committed_ms >= ?",
    )
    .bind(id)
    .bind(since)
    .fetch_one(tx)
    .await
    .doing("count recent results")?;
    Ok(count.unsigned_abs())
}

/// Health of a campaign's policy.
pub(crate) async fn policy_health(
    tx: &mut SqliteConnection,
    id: CampaignId,
) -> Result<crate::outage::PolicyHealth, StoreError> {
    let row: HealthRow = sqlx::query_as(
        "SELECT p.state, p.outages, p.available_ms, p.resume_ms, p.pause_reason, p.probe_job_id,
             p.probe_attempt
         FROM campaign c JOIN policy p ON p.id = c.policy_id WHERE c.id = ?",
    )
    .bind(id)
    .fetch_one(tx)
    .await
    .doing("read the health of a campaign's policy")?;
    row.into_health()
}
