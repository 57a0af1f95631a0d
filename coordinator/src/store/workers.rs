//! Statements on `worker`: who is there, with which assets and simulator.

use std::collections::{BTreeMap, BTreeSet};

use sqlx::SqliteConnection;

use super::{Doing, StoreError, json};
use crate::clock::UnixMillis;
use crate::ids::WorkerId;
use crate::lease::Strike;

/// A worker as it announced itself.
#[derive(Clone, Debug, PartialEq, Eq, sqlx::FromRow)]
pub struct WorkerInfo {
    /// Its id.
    pub id: WorkerId,
    /// The machine it runs on.
    pub host: String,
    /// Rollouts that it runs side by side.
    pub slots: u32,
    /// Name of its asset pack.
    pub asset_pack: String,
    /// Digest of its asset pack.
    pub asset_pack_digest: String,
    /// Version of its simulator.
    pub mujoco_version: String,
    /// What draws its frames, by its own name.
    pub renderer: String,
    /// Version of its program.
    pub program_version: String,
}

/// What a worker runs on: a campaign is pinned to one of these.
#[derive(Clone, Debug, PartialEq, Eq, Hash, sqlx::FromRow)]
pub struct Pin {
    /// Name of the asset pack.
    pub asset_pack: String,
    /// Digest of the asset pack.
    pub asset_pack_digest: String,
    /// Version of the simulator.
    pub mujoco_version: String,
    /// What draws, by its own name. Of a campaign that schema 1 pinned, empty
    /// until a lease decides it.
    pub renderer: String,
}

impl Pin {
    /// Whether a campaign that is pinned to this takes results of a worker that
    /// runs on the other.
    pub(crate) fn takes(&self, worker: &Pin) -> bool {
        self.asset_pack_digest == worker.asset_pack_digest
            && self.mujoco_version == worker.mujoco_version
            && (self.renderer.is_empty() || self.renderer == worker.renderer)
    }
}

/// A worker's standing with the coordinator.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Standing {
    /// What it runs on.
    pub pin: Pin,
    /// When it was last heard of.
    pub last_seen: UnixMillis,
    /// Charged failures in a row.
    pub charged_in_a_row: u32,
    /// Why it may lease no more, if so.
    pub stopped_reason: Option<String>,
}

/// Stores a worker that announces itself; one that does so again starts with a
/// clean record.
pub(crate) async fn upsert(
    tx: &mut SqliteConnection,
    worker: &WorkerInfo,
    now: UnixMillis,
) -> Result<(), StoreError> {
    sqlx::query(
        "INSERT INTO worker (id, host, slots, asset_pack, asset_pack_digest, mujoco_version,
             renderer, program_version, registered_ms, last_seen_ms)
         VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9, ?9)
         ON CONFLICT (id) DO UPDATE SET host = ?2, slots = ?3, asset_pack = ?4,
             asset_pack_digest = ?5, mujoco_version = ?6, renderer = ?7,
             program_version = ?8, registered_ms = ?9, last_seen_ms = ?9,
             charged_in_a_row = 0, stopped_reason = NULL",
    )
    .bind(&worker.id)
    .bind(&worker.host)
    .bind(worker.slots)
    .bind(&worker.asset_pack)
    .bind(&worker.asset_pack_digest)
    .bind(&worker.mujoco_version)
    .bind(&worker.renderer)
    .bind(&worker.program_version)
    .bind(now)
    .execute(tx)
    .await
    .doing("register a worker")?;
    Ok(())
}

/// The standing of those workers that ever announced themselves.
pub(crate) async fn standings(
    tx: &mut SqliteConnection,
    ids: &[&WorkerId],
) -> Result<BTreeMap<WorkerId, Standing>, StoreError> {
    #[derive(sqlx::FromRow)]
    struct Row {
        id: WorkerId,
        #[sqlx(flatten)]
        pin: Pin,
        last_seen_ms: UnixMillis,
        charged_in_a_row: u32,
        stopped_reason: Option<String>,
    }
    let rows: Vec<Row> = sqlx::query_as(
        "SELECT id, asset_pack, asset_pack_digest, mujoco_version, renderer, last_seen_ms,
             charged_in_a_row, stopped_reason
         FROM worker WHERE id IN (SELECT value FROM json_each(?))",
    )
    .bind(json(ids.iter().map(|id| &id.0).collect::<BTreeSet<_>>()))
    .fetch_all(tx)
    .await
    .doing("look up workers")?;
    let standing = |row: Row| {
        let standing = Standing {
            pin: row.pin,
            last_seen: row.last_seen_ms,
            charged_in_a_row: row.charged_in_a_row,
            stopped_reason: row.stopped_reason,
        };
        (row.id, standing)
    };
    Ok(rows.into_iter().map(standing).collect())
}

/// Notes that workers were heard of. Answers how many of them are known.
pub(crate) async fn seen(
    tx: &mut SqliteConnection,
    ids: &[&WorkerId],
    now: UnixMillis,
) -> Result<u64, StoreError> {
    let done = sqlx::query(
        "UPDATE worker SET last_seen_ms = max(last_seen_ms, ?)
         WHERE id IN (SELECT value FROM json_each(?))",
    )
    .bind(now)
    .bind(json(ids.iter().map(|id| &id.0).collect::<BTreeSet<_>>()))
    .execute(tx)
    .await
    .doing("note that workers were heard of")?;
    Ok(done.rows_affected())
}

/// Stores a worker's run of failures, and why it must stop if it must.
pub(crate) async fn set_strike(
    tx: &mut SqliteConnection,
    id: &WorkerId,
    strike: Strike,
    stopped_reason: Option<&str>,
) -> Result<(), StoreError> {
    sqlx::query(
        "UPDATE worker SET charged_in_a_row = ?, stopped_reason = coalesce(stopped_reason, ?)
         WHERE id = ?",
    )
    .bind(strike.in_a_row)
    .bind(stopped_reason)
    .bind(id)
    .execute(tx)
    .await
    .doing("count a worker's failure")?;
    Ok(())
}

/// Workers reported rollouts that were committed: they are there, and their
/// runs of failures are over.
pub(crate) async fn succeeded(
    tx: &mut SqliteConnection,
    ids: &[&WorkerId],
    now: UnixMillis,
) -> Result<(), StoreError> {
    sqlx::query(
        "UPDATE worker SET charged_in_a_row = 0, last_seen_ms = max(last_seen_ms, ?1)
         WHERE id IN (SELECT value FROM json_each(?2))
             AND (charged_in_a_row > 0 OR last_seen_ms < ?1)",
    )
    .bind(now)
    .bind(json(ids.iter().map(|id| &id.0).collect::<BTreeSet<_>>()))
    .execute(tx)
    .await
    .doing("clear workers' failures")?;
    Ok(())
}

/// Workers heard of since `since` that may lease, with what they run on.
pub(crate) async fn live_pins(
    tx: &mut SqliteConnection,
    since: UnixMillis,
) -> Result<Vec<Pin>, StoreError> {
    sqlx::query_as(
        "SELECT asset_pack, asset_pack_digest, mujoco_version, renderer FROM worker
         WHERE last_seen_ms >= ? AND stopped_reason IS NULL ORDER BY id",
    )
    .bind(since)
    .fetch_all(tx)
    .await
    .doing("count live workers")
}

/// Whether at least `enough` workers heard of since `since` may lease and run on
/// `pin`, or on anything if there is none yet; counts no further.
pub(crate) async fn able(
    tx: &mut SqliteConnection,
    pin: Option<&Pin>,
    since: UnixMillis,
    enough: u32,
) -> Result<u32, StoreError> {
    sqlx::query_scalar(
        "SELECT count(*) FROM
             (SELECT 1 FROM worker WHERE last_seen_ms >= ?1 AND stopped_reason IS NULL
                  AND (?2 IS NULL OR (asset_pack_digest = ?2 AND mujoco_version = ?3
                      AND ?4 IN ('', renderer))) LIMIT ?5)",
    )
    .bind(since)
    .bind(pin.map(|pin| &pin.asset_pack_digest))
    .bind(pin.map(|pin| &pin.mujoco_version))
    .bind(pin.map(|pin| &pin.renderer))
    .bind(enough)
    .fetch_one(tx)
    .await
    .doing("look for able workers")
}
