//! Statements on `worker`: which are alive, with which assets and simulator.

use std::collections::{BTreeMap, BTreeSet};

use attempt::Pin;
use sqlx::SqliteConnection;
use sqlx::types::Json;

use super::{Doing, StoreError, json};
use crate::clock::UnixMillis;
use crate::ids::WorkerId;
use crate::rules::lease::Strike;

/// A worker as it announced itself.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct WorkerInfo {
    /// Its id.
    pub id: WorkerId,
    /// The machine it runs on.
    pub host: String,
    /// Rollouts that it runs side by side.
    pub slots: u32,
    /// Cores that they share, if it says so.
    pub cores: Option<u32>,
    /// What it runs on.
    pub pin: Pin,
    /// Version of its program.
    pub program_version: String,
}

/// A worker's standing with the coordinator.
#[derive(Clone, Debug, PartialEq, Eq, sqlx::FromRow)]
pub(crate) struct Standing {
    pub(crate) id: WorkerId,
    /// What it runs on.
    #[sqlx(json)]
    pub(crate) pin: Pin,
    /// When it last called.
    pub(crate) last_seen_ms: UnixMillis,
    /// Charged failures in a row.
    pub(crate) charged_in_a_row: u32,
    /// Why it may lease no more, if so.
    pub(crate) stopped_reason: Option<String>,
}

/// The [`Pin`] of a worker or a campaign, as JSON.
macro_rules! pin {
    ($of:literal) => {
        concat!(
            "json_object('asset_pack', ",
            $of,
            ".asset_pack, 'asset_pack_digest', ",
            $of,
            ".asset_pack_digest, 'mujoco_version', ",
            $of,
            ".mujoco_version, 'renderer', coalesce(",
            $of,
            ".renderer, ''))"
        )
    };
}
pub(crate) use pin;

/// Ids for `json_each`. A worker that asks with several slots is one worker.
fn each_once(ids: &[&WorkerId]) -> String {
    json(ids.iter().map(|id| &id.0).collect::<BTreeSet<_>>())
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
             renderer, program_version, registered_ms, last_seen_ms, cores)
         VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9, ?9, ?10)
         ON CONFLICT (id) DO UPDATE SET host = ?2, slots = ?3, asset_pack = ?4,
             asset_pack_digest = ?5, mujoco_version = ?6, renderer = ?7,
             program_version = ?8, registered_ms = ?9, last_seen_ms = ?9, cores = ?10,
             charged_in_a_row = 0, stopped_reason = NULL, signed_off_ms = NULL",
    )
    .bind(&worker.id)
    .bind(&worker.host)
    .bind(worker.slots)
    .bind(&worker.pin.asset_pack)
    .bind(&worker.pin.asset_pack_digest)
    .bind(&worker.pin.mujoco_version)
    .bind(&worker.pin.renderer)
    .bind(&worker.program_version)
    .bind(now)
    .bind(worker.cores)
    .execute(tx)
    .await
    .doing("register a worker")
    .map(drop)
}

/// The standing of those workers that ever announced themselves.
pub(crate) async fn standings(
    tx: &mut SqliteConnection,
    ids: &[&WorkerId],
) -> Result<BTreeMap<WorkerId, Standing>, StoreError> {
    let standings: Vec<Standing> = sqlx::query_as(concat!(
        "SELECT id, last_seen_ms, charged_in_a_row, stopped_reason, ",
        pin!("worker"),
        " AS pin FROM worker WHERE id IN (SELECT value FROM json_each(?))",
    ))
    .bind(each_once(ids))
    .fetch_all(tx)
    .await
    .doing("look up workers")?;
    let by_id = |standing: Standing| (standing.id.clone(), standing);
    Ok(standings.into_iter().map(by_id).collect())
}

/// Notes that workers called.
pub(crate) async fn seen(
    tx: &mut SqliteConnection,
    ids: &[&WorkerId],
    now: UnixMillis,
) -> Result<(), StoreError> {
    sqlx::query(
        "UPDATE worker SET last_seen_ms = ?1
         WHERE id IN (SELECT value FROM json_each(?2)) AND last_seen_ms < ?1",
    )
    .bind(now)
    .bind(each_once(ids))
    .execute(tx)
    .await
    .doing("note that workers were heard of")
    .map(drop)
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
    .doing("count a worker's failure")
    .map(drop)
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
    .bind(each_once(ids))
    .execute(tx)
    .await
    .doing("clear workers' failures")
    .map(drop)
}

/// Notes that a worker ended in good order; says whether it is known.
pub(crate) async fn sign_off(
    tx: &mut SqliteConnection,
    id: &WorkerId,
    now: UnixMillis,
) -> Result<bool, StoreError> {
    let noted = sqlx::query("UPDATE worker SET signed_off_ms = ? WHERE id = ?")
        .bind(now)
        .bind(id)
        .execute(tx)
        .await
        .doing("note that a worker ended")?;
    Ok(noted.rows_affected() > 0)
}

/// What workers run on that have called since `since`, have not said good-bye
/// and may lease.
pub(crate) async fn live_pins(
    tx: &mut SqliteConnection,
    since: UnixMillis,
) -> Result<Vec<Pin>, StoreError> {
    let pins: Vec<Json<Pin>> = sqlx::query_scalar(concat!(
        "SELECT ",
        pin!("worker"),
        " FROM worker WHERE last_seen_ms >= ? AND stopped_reason IS NULL
             AND signed_off_ms IS NULL",
    ))
    .bind(since)
    .fetch_all(tx)
    .await
    .doing("count live workers")?;
    Ok(pins.into_iter().map(|Json(pin)| pin).collect())
}
