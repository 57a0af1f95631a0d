//! Statements on `motion`: rollouts still to be filmed, and their inputs.

use benchmark::attempt::{AttemptId, Pin};
use sqlx::SqliteConnection;
use sqlx::types::Text;

use super::{Doing, StoreError};
use crate::ids::{CampaignId, CampaignName, JobId};
use crate::store::outcomes::OutcomeRow;

#[derive(Clone, Debug, PartialEq, Eq, sqlx_macros::FromRow)]
pub struct Film {
    /// Attempt whose outcome the video belongs to.
    #[sqlx(rename = "attempt_id")]
    pub attempt: Text<AttemptId>,
    pub campaign: CampaignName,
    pub replicate: u32,
    /// Manifest row, JSON.
    pub manifest_row: String,
    pub realisation: String,
    /// The actions of every control step, as [`benchmark::attempt::Motion`] packs them.
    pub actions: Vec<u8>,
    /// Outcome that the video must reproduce.
    pub success: bool,
}

/// A rollout of a campaign whose rollouts may be filmed after they were committed.
#[derive(Clone, Debug, sqlx_macros::FromRow)]
pub(crate) struct FilmableRow {
    pub(crate) job_id: JobId,
    #[sqlx(flatten)]
    pub(crate) job: OutcomeRow,
    /// True if the rollout has stored actions and no video yet.
    pub(crate) lacks_video: bool,
}

/// A campaign that records transitions. While its revision and its source's are unchanged, the set
/// of rollouts to film does not grow.
#[derive(Clone, Debug, PartialEq, Eq, sqlx_macros::FromRow)]
pub(crate) struct FilmedCampaign {
    pub(crate) campaign: CampaignId,
    pub(crate) name: CampaignName,
    pub(crate) revision: i64,
    pub(crate) source: Option<CampaignId>,
    pub(crate) source_revision: Option<i64>,
}

/// Returns the campaigns that record transitions and are pinned to this asset pack, simulator and look,
/// oldest first.
pub(crate) async fn filmed_campaigns(
    tx: &mut SqliteConnection,
    pin: &Pin,
) -> Result<Vec<FilmedCampaign>, StoreError> {
    sqlx::query_as(
        "SELECT c.id AS campaign, c.name, own.revision, s.id AS source,
             its.revision AS source_revision
         FROM campaign c JOIN tally own ON own.campaign_id = c.id
         LEFT JOIN campaign s ON s.name = c.source
         LEFT JOIN tally its ON its.campaign_id = s.id
         WHERE c.id NOT IN (SELECT campaign_id FROM passage) AND c.record = 'transitions'
             AND c.asset_pack_digest = ? AND c.mujoco_version = ? AND c.look = ?
         ORDER BY c.id",
    )
    .bind(&pin.asset_pack_digest)
    .bind(&pin.mujoco_version)
    .bind(pin.look.name())
    .fetch_all(tx)
    .await
    .doing("find campaigns that record transitions")
}

pub(crate) async fn filmable(
    tx: &mut SqliteConnection,
    campaign: CampaignId,
) -> Result<Vec<FilmableRow>, StoreError> {
    sqlx::query_as(
        "SELECT j.id AS job_id, j.rollout_id, j.replicate, j.init_id,
             j.state = 'quarantined' AS is_quarantined, r.success,
             coalesce(length(m.actions), 0) > 0
                 AND NOT EXISTS (SELECT 1 FROM artifact a
                     WHERE a.attempt_id = r.attempt_id AND a.kind = 'video') AS lacks_video
         FROM job j LEFT JOIN result r ON r.job_id = j.id LEFT JOIN motion m ON m.job_id = j.id
         WHERE j.campaign_id = ? ORDER BY j.unit_order",
    )
    .bind(campaign)
    .fetch_all(tx)
    .await
    .doing("find rollouts to film")
}

pub(crate) async fn film(tx: &mut SqliteConnection, job: JobId) -> Result<Film, StoreError> {
    sqlx::query_as(
        "SELECT r.attempt_id, c.name AS campaign, j.replicate, j.manifest_row, c.realisation,
             m.actions, r.success
         FROM job j JOIN campaign c ON c.id = j.campaign_id
         JOIN result r ON r.job_id = j.id JOIN motion m ON m.job_id = j.id
         WHERE j.id = ?",
    )
    .bind(job)
    .fetch_one(tx)
    .await
    .doing("read a rollout to film")
}
