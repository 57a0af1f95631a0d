//! Statements on `motion`: how robots moved, and which rollouts are left to be
//! filmed from what they were told.

use sqlx::{QueryBuilder, Sqlite, SqliteConnection};

use super::results::NewResult;
use super::workers::Pin;
use super::{Doing, StoreError, in_few_statements};
use crate::ids::{Attempt, CampaignId, CampaignName, JobId, WorkerId};

/// How the robot of a rollout moved.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Motion {
    /// Where its end-effector was, at rest and after every control step: x, y,
    /// z in the world frame, tenths of a millimetre, 16 bits each, little
    /// endian.
    pub path: Vec<u8>,
    /// What it was told: seven 32-bit floats a control step, little endian;
    /// empty unless the campaign keeps it.
    pub actions: Vec<u8>,
}

/// A committed rollout that can be filmed.
#[derive(Clone, Debug, sqlx::FromRow)]
pub(crate) struct FilmRow {
    pub(crate) job_id: JobId,
    pub(crate) attempt: Attempt,
    pub(crate) worker_id: WorkerId,
    pub(crate) campaign: CampaignName,
    pub(crate) replicate: u32,
    pub(crate) manifest_row: String,
    pub(crate) realisation: String,
    pub(crate) actions: Vec<u8>,
    pub(crate) success: bool,
}

/// A rollout of a campaign that records transitions.
#[derive(Clone, Debug, sqlx::FromRow)]
pub(crate) struct FilmableRow {
    pub(crate) job_id: JobId,
    pub(crate) rollout_id: String,
    pub(crate) replicate: u32,
    pub(crate) init_id: u16,
    /// None while it is not committed.
    pub(crate) success: Option<bool>,
    /// Whether it has actions to be filmed from, and no video yet.
    pub(crate) is_wanting: bool,
}

/// Stores how robots moved, right after their results.
pub(crate) async fn insert(
    tx: &mut SqliteConnection,
    results: &[NewResult<'_>],
) -> Result<(), StoreError> {
    for chunk in in_few_statements(results) {
        let mut statement =
            QueryBuilder::<Sqlite>::new("INSERT INTO motion (job_id, path, actions) ");
        statement.push_values(chunk, |mut row, result| {
            row.push_bind(result.lease.job)
                .push_bind(&result.motion.path)
                .push_bind(&result.motion.actions);
        });
        let done = statement.build().persistent(true).execute(&mut *tx).await;
        done.doing("store how robots moved")?;
    }
    Ok(())
}

/// Campaigns that record transitions with this asset pack and simulator.
pub(crate) async fn filmed_campaigns(
    tx: &mut SqliteConnection,
    pin: &Pin,
) -> Result<Vec<CampaignId>, StoreError> {
    sqlx::query_scalar(
        "SELECT id FROM campaign
         WHERE record = 'transitions' AND asset_pack_digest = ? AND mujoco_version = ?
         ORDER BY id",
    )
    .bind(&pin.asset_pack_digest)
    .bind(&pin.mujoco_version)
    .fetch_all(tx)
    .await
    .doing("look for campaigns that are filmed")
}

/// All rollouts of a campaign, as far as filming goes.
pub(crate) async fn filmable(
    tx: &mut SqliteConnection,
    campaign: CampaignId,
) -> Result<Vec<FilmableRow>, StoreError> {
    sqlx::query_as(
        "SELECT j.id AS job_id, j.rollout_id, j.replicate, j.init_id, r.success,
             coalesce(length(m.actions), 0) > 0
                 AND NOT EXISTS (SELECT 1 FROM artifact a
                     WHERE a.job_id = j.id AND a.kind = 'video') AS is_wanting
         FROM job j LEFT JOIN result r ON r.job_id = j.id LEFT JOIN motion m ON m.job_id = j.id
         WHERE j.campaign_id = ? ORDER BY j.unit_order",
    )
    .bind(campaign)
    .fetch_all(tx)
    .await
    .doing("look for rollouts to film")
}

/// A committed rollout with everything that filming it takes.
pub(crate) async fn film(tx: &mut SqliteConnection, job: JobId) -> Result<FilmRow, StoreError> {
    sqlx::query_as(
        "SELECT j.id AS job_id, r.attempt, r.worker_id, c.name AS campaign, j.replicate,
             j.manifest_row, c.realisation, m.actions, r.success
         FROM job j JOIN campaign c ON c.id = j.campaign_id
         JOIN result r ON r.job_id = j.id JOIN motion m ON m.job_id = j.id
         WHERE j.id = ?",
    )
    .bind(job)
    .fetch_one(tx)
    .await
    .doing("read a rollout to film")
}
