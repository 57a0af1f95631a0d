//! Statements that compare the first half of a campaign with the second half, which is attached as
//! the schema `source`.

use std::collections::BTreeMap;
use std::sync::Arc;

use libero_ctrl::ManifestRow;
use rollout_types::{Digests, Provenance, Realised};
use sqlx::types::Json;
use sqlx::{AssertSqlSafe, SqliteConnection};

use super::provenance::provenance;
use super::results::digests;
use super::{Doing, StoreError};
use crate::ids::{CampaignId, WorkerId};
use crate::rules::lease::OutcomeKey;
use crate::rules::merge::{RolloutRecord, Standing};

/// Schema of the database that holds a half.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Schema {
    /// Main database, which holds the first half.
    Main,
    /// Attached database, which holds the second half.
    Source,
}

/// A rollout and replicate.
pub(crate) type Rollout = (String, u32);

/// The parts of a committed result that siblings are compared by.
#[derive(Clone, Debug, sqlx_macros::FromRow)]
pub(crate) struct Stored {
    pub(crate) rollout_id: String,
    pub(crate) replicate: u32,
    /// Task, such as "libero_goal/3".
    pub(crate) task: String,
    pub(crate) init_id: i64,
    #[sqlx(json)]
    pub(crate) manifest_row: ManifestRow,
    pub(crate) worker_id: WorkerId,
    #[sqlx(json)]
    pub(crate) digests: Digests,
    #[sqlx(json)]
    pub(crate) realised: Realised,
    provenance: Json<Arc<Provenance>>,
}

impl Stored {
    pub(crate) fn origin(&self) -> &Arc<Provenance> {
        &self.provenance.0
    }
}

impl Schema {
    fn name(self) -> &'static str {
        match self {
            Schema::Main => "main",
            Schema::Source => "source",
        }
    }
}

/// Returns the state of each rollout in one half.
pub(crate) async fn records(
    tx: &mut SqliteConnection,
    schema: Schema,
    campaign: CampaignId,
) -> Result<BTreeMap<Rollout, RolloutRecord>, StoreError> {
    type Row = (String, u32, String, u32, u32, Option<bool>, Option<u32>, u32, bool);
    let half = schema.name();
    let rows: Vec<Row> = sqlx::query_as(AssertSqlSafe(format!(
        "SELECT j.rollout_id, j.replicate, j.state, j.charged_attempts, j.attempt, r.success,
             r.steps, (SELECT count(*) FROM {half}.divergence d WHERE d.job_id = j.id),
             EXISTS (SELECT 1 FROM {half}.artifact a WHERE a.attempt_id = r.attempt_id)
         FROM {half}.job j LEFT JOIN {half}.result r ON r.job_id = j.id WHERE j.campaign_id = ?"
    )))
    .bind(campaign)
    .fetch_all(tx)
    .await
    .doing("read the records of a campaign's rollouts")?;
    let records = rows.into_iter().map(|row| {
        let (rollout, replicate, state, charged_attempts, attempts, success, steps, ..) = row;
        let outcome = success.zip(steps);
        let standing = match outcome.map(|(success, steps)| OutcomeKey { success, steps }) {
            Some(outcome) => Standing::Committed(outcome),
            None if state == "quarantined" => Standing::Quarantined,
            None => Standing::Open,
        };
        let record = RolloutRecord {
            standing,
            divergences: row.7,
            is_filmed: row.8,
            charged_attempts,
            attempts,
        };
        ((rollout, replicate), record)
    });
    Ok(records.collect())
}

/// Returns a rollout that only one half has, or whose manifest row, seed or place differs between
/// the halves.
pub(crate) async fn differing_rollout(
    tx: &mut SqliteConnection,
    (main, source): (CampaignId, CampaignId),
) -> Result<Option<Rollout>, StoreError> {
    sqlx::query_as(
        "SELECT coalesce(a.rollout_id, b.rollout_id), coalesce(a.replicate, b.replicate)
         FROM (SELECT * FROM main.job WHERE campaign_id = ?1) a
         FULL JOIN (SELECT * FROM source.job WHERE campaign_id = ?2) b
             ON a.rollout_id = b.rollout_id AND a.replicate = b.replicate
         WHERE a.manifest_row IS NOT b.manifest_row OR a.policy_seed IS NOT b.policy_seed
             OR a.unit_order IS NOT b.unit_order LIMIT 1",
    )
    .bind(main)
    .bind(source)
    .fetch_optional(tx)
    .await
    .doing("compare the rollouts of the halves")
}

/// Returns the results of one half, by rollout.
pub(crate) async fn results(
    tx: &mut SqliteConnection,
    schema: Schema,
    campaign: CampaignId,
) -> Result<Vec<Stored>, StoreError> {
    let half = schema.name();
    sqlx::query_as(AssertSqlSafe(format!(
        "SELECT j.rollout_id, j.replicate, j.task, j.init_id, j.manifest_row, r.worker_id, {},
             r.realised, {}
         FROM {half}.job j JOIN {half}.result r ON r.job_id = j.id
         JOIN {half}.provenance v ON v.id = r.provenance_id
         WHERE j.campaign_id = ? ORDER BY j.rollout_id, j.replicate",
        digests!(),
        provenance!(),
    )))
    .bind(campaign)
    .fetch_all(tx)
    .await
    .doing("read the results of a half")
}

/// Copies the second half's pin to the first half if the first half has no results.
pub(crate) async fn copy_pin(
    tx: &mut SqliteConnection,
    (main, source): (CampaignId, CampaignId),
) -> Result<(), StoreError> {
    sqlx::query(
        "UPDATE main.campaign SET (pinned_ms, asset_pack, asset_pack_digest, mujoco_version,
             renderer, look) = (SELECT pinned_ms, asset_pack, asset_pack_digest, mujoco_version,
             renderer, look FROM source.campaign WHERE id = ?2)
         WHERE id = ?1 AND pinned_ms IS NULL",
    )
    .bind(main)
    .bind(source)
    .execute(tx)
    .await
    .doing("pin a campaign")
    .map(drop)
}
