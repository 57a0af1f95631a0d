//! Statements on `provenance`: the part of an origin that many results share.

use libero_ctrl::Suite;
use rollout_types::Provenance;
use sqlx::SqliteConnection;
use sqlx::types::Json;

use super::{Doing, StoreError};
use crate::ids::CampaignId;

/// Row number of a stored origin.
#[derive(Clone, Copy, Debug, PartialEq, Eq, sqlx_macros::Type)]
#[sqlx(transparent)]
pub(crate) struct ProvenanceId(i64);

/// A [`Provenance`] of table `v`, as JSON.
macro_rules! provenance {
    () => {
        "json_object('host', v.host, 'renderer', v.renderer, 'fingerprint', v.fingerprint,
             'mujoco_version', v.mujoco_version, 'asset_pack', v.asset_pack,
             'asset_pack_digest', v.asset_pack_digest, 'look', v.look, 'realisation', v.realisation,
             'policy_name', v.policy_name, 'policy_checkpoint', v.policy_checkpoint,
             'policy_checkpoint_digest', v.policy_checkpoint_digest,
             'policy_privileged', json(iif(v.policy_privileged, 'true', 'false')),
             'policy_canonical_only', json(iif(v.policy_canonical_only, 'true', 'false')),
             'policy_settings', json(v.policy_settings), 'batch_mode', v.batch_mode, 'program_version', v.program_version) AS provenance"
    };
}
pub(crate) use provenance;

/// Returns the provenance of a result in a suite, of a campaign or of its source campaign.
pub(crate) async fn of_suite(
    tx: &mut SqliteConnection,
    campaign: CampaignId,
    suite: Suite,
) -> Result<Option<Provenance>, StoreError> {
    let found: Option<Json<Provenance>> = sqlx::query_scalar(concat!(
        "SELECT ",
        provenance!(),
        " FROM result r
         JOIN provenance v ON v.id = r.provenance_id
         JOIN job j ON j.id = r.job_id
         WHERE r.campaign_id IN
                 (SELECT ?1 UNION SELECT s.id FROM campaign c JOIN campaign s ON s.name = c.source
                     WHERE c.id = ?1)
             AND j.task GLOB ?2 || '/*'
         LIMIT 1",
    ))
    .bind(campaign)
    .bind(suite.name())
    .fetch_optional(tx)
    .await
    .doing("find the policy that was measured in a suite")?;
    Ok(found.map(|Json(origin)| origin))
}

/// Returns the row number of an origin, storing the origin if it is new.
pub(crate) async fn find_or_insert(
    tx: &mut SqliteConnection,
    origin: &Provenance,
) -> Result<ProvenanceId, StoreError> {
    // The no-op update makes RETURNING return an existing row too.
    sqlx::query_scalar(
        "INSERT INTO provenance (host, renderer, fingerprint, mujoco_version, asset_pack,
             asset_pack_digest, realisation, policy_name, policy_checkpoint,
             policy_checkpoint_digest, policy_privileged, policy_canonical_only, policy_settings,
             batch_mode, program_version, look)
         VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)
         ON CONFLICT DO UPDATE SET host = excluded.host RETURNING id",
    )
    .bind(&origin.host)
    .bind(&origin.pin.renderer)
    .bind(&origin.fingerprint)
    .bind(&origin.pin.mujoco_version)
    .bind(&origin.pin.asset_pack)
    .bind(&origin.pin.asset_pack_digest)
    .bind(&origin.realisation)
    .bind(&origin.policy_name)
    .bind(&origin.policy_checkpoint)
    .bind(&origin.policy_checkpoint_digest)
    .bind(origin.policy_privileged)
    .bind(origin.policy_canonical_only)
    .bind(Json(&origin.policy_settings))
    .bind(&origin.batch_mode)
    .bind(&origin.program_version)
    .bind(origin.pin.look.name())
    .fetch_one(tx)
    .await
    .doing("store the provenance of a result")
}
