//! Statements on `provenance`: where results came from, as far as many of them
//! share it.

use attempt::{Pin, Provenance};
use sqlx::SqliteConnection;

use super::{Doing, StoreError};

/// Row number of an origin that is stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq, sqlx::Type)]
#[sqlx(transparent)]
pub(crate) struct ProvenanceId(i64);

/// The columns of [`ProvenanceRow`], of table `v`.
macro_rules! provenance_columns {
    () => {
        "v.host, v.renderer, v.fingerprint, v.mujoco_version, v.asset_pack, v.asset_pack_digest,
         v.realisation, v.policy_name, v.policy_checkpoint, v.policy_checkpoint_digest,
         v.policy_privileged, v.policy_canonical_only, v.batch_mode, v.program_version"
    };
}
pub(crate) use provenance_columns;

/// A [`Provenance`] as it is stored.
#[derive(Clone, Debug, sqlx::FromRow)]
pub(crate) struct ProvenanceRow {
    host: String,
    renderer: String,
    fingerprint: String,
    mujoco_version: String,
    asset_pack: String,
    asset_pack_digest: String,
    realisation: String,
    policy_name: String,
    policy_checkpoint: String,
    policy_checkpoint_digest: String,
    policy_privileged: bool,
    policy_canonical_only: bool,
    batch_mode: String,
    program_version: String,
}

impl From<ProvenanceRow> for Provenance {
    fn from(row: ProvenanceRow) -> Provenance {
        Provenance {
            host: row.host,
            pin: Pin {
                asset_pack: row.asset_pack,
                asset_pack_digest: row.asset_pack_digest,
                mujoco_version: row.mujoco_version,
                renderer: row.renderer,
            },
            fingerprint: row.fingerprint,
            realisation: row.realisation,
            policy_name: row.policy_name,
            policy_checkpoint: row.policy_checkpoint,
            policy_checkpoint_digest: row.policy_checkpoint_digest,
            policy_privileged: row.policy_privileged,
            policy_canonical_only: row.policy_canonical_only,
            batch_mode: row.batch_mode,
            program_version: row.program_version,
        }
    }
}

/// The row number of an origin, which is stored if it is new.
pub(crate) async fn find_or_insert(
    tx: &mut SqliteConnection,
    of: &Provenance,
) -> Result<ProvenanceId, StoreError> {
    // Updated to itself: only a row that was written is returned.
    sqlx::query_scalar(
        "INSERT INTO provenance (host, renderer, fingerprint, mujoco_version, asset_pack,
             asset_pack_digest, realisation, policy_name, policy_checkpoint,
             policy_checkpoint_digest, policy_privileged, policy_canonical_only, batch_mode,
             program_version)
         VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)
         ON CONFLICT DO UPDATE SET host = excluded.host RETURNING id",
    )
    .bind(&of.host)
    .bind(&of.pin.renderer)
    .bind(&of.fingerprint)
    .bind(&of.pin.mujoco_version)
    .bind(&of.pin.asset_pack)
    .bind(&of.pin.asset_pack_digest)
    .bind(&of.realisation)
    .bind(&of.policy_name)
    .bind(&of.policy_checkpoint)
    .bind(&of.policy_checkpoint_digest)
    .bind(of.policy_privileged)
    .bind(of.policy_canonical_only)
    .bind(&of.batch_mode)
    .bind(&of.program_version)
    .fetch_one(tx)
    .await
    .doing("store where a result came from")
}
