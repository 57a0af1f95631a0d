//! Statements on `worker`: registration, liveness, and the pins of workers.

use std::collections::{BTreeMap, BTreeSet};

use benchmark::attempt::Pin;
use sqlx::SqliteConnection;
use sqlx::types::Json;

use super::{Doing, StoreError, json};
use crate::clock::UnixMillis;
use crate::ids::WorkerId;
use crate::rules::lease::Strike;

/// Most slots or cores of a worker; bounded so that sums over workers do not overflow.
pub const MAX_SLOTS: u32 = 1 << 16;

#[derive(Clone, Debug, PartialEq, Eq)]
pub struct WorkerInfo {
    pub id: WorkerId,
    /// Name of the machine.
    pub host: String,
    /// Id of the machine, if the worker reports it: equal for all workers on one machine, and
    /// stable across restarts.
    pub machine: Option<String>,
    /// Rollouts that run concurrently.
    pub slots: u32,
    /// Cores that the slots share, if the worker reports them.
    pub cores: Option<u32>,
    /// Asset pack, simulator and renderer.
    pub pin: Pin,
    pub program_version: String,
}

/// State of a worker in the coordinator.
#[derive(Clone, Debug, PartialEq, Eq, sqlx_macros::FromRow)]
pub(crate) struct Standing {
    pub(crate) id: WorkerId,
    /// Machine of the worker; the worker's own id if it does not name its machine.
    pub(crate) machine: String,
    /// Asset pack, simulator and renderer.
    #[sqlx(json)]
    pub(crate) pin: Pin,
    /// Instant of the worker's last call.
    pub(crate) last_seen_ms: UnixMillis,
    pub(crate) charged_in_a_row: u32,
    /// Reason why the worker must stop leasing; `None` if it may lease.
    pub(crate) stopped_reason: Option<String>,
}

/// SQL for the [`Pin`] of a worker or a campaign, as JSON.
macro_rules! pin {
    ($table:literal) => {
        concat!(
            "json_object('asset_pack', ",
            $table,
            ".asset_pack, 'asset_pack_digest', ",
            $table,
            ".asset_pack_digest, 'mujoco_version', ",
            $table,
            ".mujoco_version, 'renderer', ",
            $table,
            ".renderer, 'look', ",
            $table,
            ".look)"
        )
    };
}
pub(crate) use pin;

/// Serialises worker ids for `json_each`, each only once, since several slots of a worker may call
/// together.
fn distinct_ids(ids: &[&WorkerId]) -> String {
    json(ids.iter().map(|id| &id.0).collect::<BTreeSet<_>>())
}

/// Returns the number of failures in a row of the worker that registered last on a machine, not
/// counting the worker `except`.
pub(crate) async fn last_failures_on_machine(
    tx: &mut SqliteConnection,
    machine: &str,
    except: &WorkerId,
) -> Result<u32, StoreError> {
    let last = sqlx::query_scalar(
        "SELECT charged_in_a_row FROM worker WHERE machine = ? AND id <> ?
         ORDER BY registered_ms DESC, rowid DESC LIMIT 1",
    )
    .bind(machine)
    .bind(except)
    .fetch_optional(tx)
    .await
    .doing("find the last worker of a machine")?;
    Ok(last.unwrap_or(0))
}

/// Stores a worker that registers, with the number of failures in a row that it inherits.
pub(crate) async fn upsert(
    tx: &mut SqliteConnection,
    worker: &WorkerInfo,
    in_a_row: u32,
    now: UnixMillis,
) -> Result<(), StoreError> {
    sqlx::query(
        "INSERT INTO worker (id, host, slots, asset_pack, asset_pack_digest, mujoco_version,
             renderer, program_version, registered_ms, last_seen_ms, cores, machine,
             charged_in_a_row, look)
         VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9, ?9, ?10, ?11, ?12, ?13)
         ON CONFLICT (id) DO UPDATE SET host = ?2, slots = ?3, asset_pack = ?4,
             asset_pack_digest = ?5, mujoco_version = ?6, renderer = ?7,
             program_version = ?8, registered_ms = ?9, last_seen_ms = ?9, cores = ?10,
             machine = ?11, charged_in_a_row = ?12, look = ?13, stopped_reason = NULL, signed_off_ms = NULL",
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
    .bind(&worker.machine)
    .bind(in_a_row)
    .bind(worker.pin.look.name())
    .execute(tx)
    .await
    .doing("register a worker")
    .map(drop)
}

pub(crate) async fn standings(
    tx: &mut SqliteConnection,
    ids: &[&WorkerId],
) -> Result<BTreeMap<WorkerId, Standing>, StoreError> {
    let standings: Vec<Standing> = sqlx::query_as(concat!(
        "SELECT id, coalesce(machine, id) AS machine, last_seen_ms, charged_in_a_row,
             stopped_reason, ",
        pin!("worker"),
        " AS pin FROM worker WHERE id IN (SELECT value FROM json_each(?))",
    ))
    .bind(distinct_ids(ids))
    .fetch_all(tx)
    .await
    .doing("find workers")?;
    let by_id = |standing: Standing| (standing.id.clone(), standing);
    Ok(standings.into_iter().map(by_id).collect())
}

pub(crate) async fn record_calls(
    tx: &mut SqliteConnection,
    ids: &[&WorkerId],
    now: UnixMillis,
) -> Result<(), StoreError> {
    sqlx::query(
        "UPDATE worker SET last_seen_ms = ?1
         WHERE id IN (SELECT value FROM json_each(?2)) AND last_seen_ms < ?1",
    )
    .bind(now)
    .bind(distinct_ids(ids))
    .execute(tx)
    .await
    .doing("record calls of workers")
    .map(drop)
}

pub(crate) async fn record_heartbeats(
    tx: &mut SqliteConnection,
    ids: &[&WorkerId],
    now: UnixMillis,
) -> Result<(), StoreError> {
    sqlx::query(
        "UPDATE worker SET last_seen_ms = max(last_seen_ms, ?1), heartbeat_ms = ?1
         WHERE id IN (SELECT value FROM json_each(?2))",
    )
    .bind(now)
    .bind(distinct_ids(ids))
    .execute(tx)
    .await
    .doing("record heartbeats of workers")
    .map(drop)
}

/// Stores a worker's number of failures in a row, and the reason why the worker must stop leasing.
/// A reason that is already stored is kept in any case.
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

/// Records that results of workers were committed: the workers are alive, and their numbers of
/// failures in a row are reset.
pub(crate) async fn record_successes(
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
    .bind(distinct_ids(ids))
    .execute(tx)
    .await
    .doing("clear workers' failures")
    .map(drop)
}

/// Records that a worker shut down cleanly; returns false if the worker is unknown.
pub(crate) async fn sign_off(
    tx: &mut SqliteConnection,
    id: &WorkerId,
    now: UnixMillis,
) -> Result<bool, StoreError> {
    let recorded = sqlx::query("UPDATE worker SET signed_off_ms = ? WHERE id = ?")
        .bind(now)
        .bind(id)
        .execute(tx)
        .await
        .doing("record that a worker signed off")?;
    Ok(recorded.rows_affected() > 0)
}

/// A live worker that may lease.
#[derive(Clone, Debug)]
pub(crate) struct Live {
    pub(crate) id: WorkerId,
    /// Asset pack, simulator and renderer.
    pub(crate) pin: Pin,
    /// Machine of the worker; the worker's own id if it does not name its machine.
    pub(crate) machine: String,
}

/// Returns the workers that have called since `since`, have not signed off, and may lease.
pub(crate) async fn live(
    tx: &mut SqliteConnection,
    since: UnixMillis,
) -> Result<Vec<Live>, StoreError> {
    let live: Vec<(WorkerId, Json<Pin>, String)> = sqlx::query_as(concat!(
        "SELECT id, ",
        pin!("worker"),
        ", coalesce(machine, id) FROM worker WHERE last_seen_ms >= ? AND stopped_reason IS NULL
             AND signed_off_ms IS NULL",
    ))
    .bind(since)
    .fetch_all(tx)
    .await
    .doing("count live workers")?;
    let live = live.into_iter();
    Ok(live.map(|(id, Json(pin), machine)| Live { id, pin, machine }).collect())
}
