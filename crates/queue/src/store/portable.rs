//! Statements that write a campaign as lines of JSON, one per job, and store such lines.

use std::collections::{BTreeMap, HashMap};

use benchmark::ManifestRow;
use benchmark::attempt::{AttemptId, Measurement, Motion, Pin, Provenance};
use serde::{Deserialize, Serialize};
use sqlx::SqliteConnection;

use super::results::{self, NewResult};
use super::{Doing, StoreError, artifacts, campaigns, jobs, json, provenance, stops, undecodable};
use crate::clock::UnixMillis;
use crate::expand::{NewCampaign, NewJob};
use crate::ids::{AttemptNumber, CampaignId, JobId, NameError, WorkerId};
use crate::rules::campaign::CampaignState;

/// Error text stored with an attempt that was in progress when its campaign was copied.
const MOVED: &str = "the campaign was copied while this attempt ran";

/// The state of a campaign beyond its specification, which has all else.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Head {
    pub(crate) priority: i32,
    pub(crate) created_ms: UnixMillis,
    pub(crate) state: CampaignState,
    /// Instant and pin of the first result.
    pub(crate) pinned: Option<(UnixMillis, Pin)>,
    /// Configurations after which the campaign stopped early.
    pub(crate) used: Option<u32>,
}

/// A job with its attempts and their outcomes.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Line {
    pub(crate) row: ManifestRow,
    pub(crate) replicate: u32,
    is_quarantined: bool,
    attempt: u32,
    charged_attempts: u32,
    forgiven_attempt: u32,
    losses: u32,
    stale_reports: u32,
    last_error: Option<String>,
    failures: Vec<Failure>,
    result: Option<Committed>,
    divergences: Vec<Divergence>,
}

/// An attempt without a result.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Failure {
    attempt_id: AttemptId,
    attempt: u32,
    worker: String,
    failed_ms: UnixMillis,
    reason: String,
    charged: u32,
    error: String,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Committed {
    attempt_id: AttemptId,
    attempt: u32,
    worker: String,
    committed_ms: UnixMillis,
    measurement: Measurement,
    /// As [`Motion`] packs them, hex.
    path: String,
    actions: String,
}

/// Another outcome of a committed rollout.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Divergence {
    attempt: u32,
    worker: String,
    reported_ms: UnixMillis,
    measurement: Measurement,
}

impl Line {
    /// Returns the error of a worker's id that no coordinator would have accepted, if there is one.
    pub(crate) fn invalid_worker(&self) -> Option<NameError> {
        let of_failures = self.failures.iter().map(|failure| &failure.worker);
        let of_results = self.result.iter().map(|result| &result.worker);
        let of_others = self.divergences.iter().map(|divergence| &divergence.worker);
        let mut workers = of_failures.chain(of_results).chain(of_others);
        workers.find_map(|worker| WorkerId::parse(worker).err())
    }
}

/// Films by attempt: file names and sizes, bytes.
pub(crate) type Films = BTreeMap<AttemptId, (String, u64)>;

pub(crate) async fn jobs(
    tx: &mut SqliteConnection,
    campaign: CampaignId,
) -> Result<Vec<JobId>, StoreError> {
    sqlx::query_scalar("SELECT id FROM job WHERE campaign_id = ? ORDER BY unit_order")
        .bind(campaign)
        .fetch_all(tx)
        .await
        .doing("list the jobs of the campaign to copy")
}

/// Returns the [`Line`]s of some jobs. Leases end without a charge: their jobs wait again.
pub(crate) async fn lines(
    tx: &mut SqliteConnection,
    jobs: &[JobId],
) -> Result<Vec<String>, StoreError> {
    sqlx::query_scalar(
        "SELECT json_object('row', json(j.manifest_row), 'replicate', j.replicate,
             'is_quarantined', json(iif(j.state = 'quarantined', 'true', 'false')),
             'attempt', j.attempt, 'charged_attempts', j.charged_attempts,
             'forgiven_attempt', j.forgiven_attempt, 'losses', j.losses,
             'stale_reports', j.stale_reports, 'last_error', j.last_error,
             'failures', json((SELECT json_group_array(json_object('attempt_id', attempt_id,
                     'attempt', attempt, 'worker', worker_id, 'failed_ms', failed_ms,
                     'reason', reason, 'charged', charged, 'error', error))
                 FROM (SELECT attempt_id, attempt, worker_id, failed_ms, reason, charged, error
                     FROM failure WHERE job_id = j.id
                     UNION ALL SELECT j.attempt_id, j.attempt, j.lease_owner, j.leased_ms,
                         'draining', 0, ?2 WHERE j.state = 'leased'
                     ORDER BY attempt))),
             'result', json((SELECT json_object('attempt_id', r.attempt_id, 'attempt', r.attempt,
                     'worker', r.worker_id, 'committed_ms', r.committed_ms, 'measurement',
                     json_object('result', json(r.outcome), 'provenance', json(v.origin)),
                     'path', hex(m.path), 'actions', hex(m.actions))
                 FROM result r JOIN provenance v ON v.id = r.provenance_id
                 LEFT JOIN motion m ON m.job_id = r.job_id WHERE r.job_id = j.id)),
             'divergences', json((SELECT json_group_array(json_object('attempt', attempt,
                     'worker', worker_id, 'reported_ms', reported_ms, 'measurement',
                     json_object('result', json(outcome), 'provenance', json(origin))))
                 FROM (SELECT d.attempt, d.worker_id, d.reported_ms, d.outcome, v.origin
                     FROM divergence d JOIN provenance v ON v.id = d.provenance_id
                     WHERE d.job_id = j.id ORDER BY d.id))))
         FROM json_each(?1) w CROSS JOIN job j ON j.id = w.value ORDER BY w.key",
    )
    .bind(json(jobs))
    .bind(MOVED)
    .fetch_all(tx)
    .await
    .doing("read the jobs of a campaign")
}

/// Returns the file names of a campaign's films, each ending with its attempt, with their paths below
/// the data folder and sizes, by name.
pub(crate) async fn films(
    tx: &mut SqliteConnection,
    campaign: CampaignId,
) -> Result<Vec<(String, String, i64)>, StoreError> {
    sqlx::query_as(
        "SELECT replace(j.rollout_id, '/', '_') || '.r' || j.replicate || '.'
             || a.attempt_id || '.mp4', a.path, a.size_bytes
         FROM result r JOIN artifact a ON a.attempt_id = r.attempt_id
         JOIN job j ON j.id = r.job_id WHERE r.campaign_id = ? ORDER BY 1",
    )
    .bind(campaign)
    .fetch_all(tx)
    .await
    .doing("list a campaign's videos")
}

/// Stores a campaign without its jobs, stop and state.
pub(crate) async fn begin(
    tx: &mut SqliteConnection,
    new: &NewCampaign,
    head: &Head,
    folder: &str,
    now: UnixMillis,
) -> Result<CampaignId, StoreError> {
    let id = campaigns::insert_without_jobs(tx, new, folder, now).await?;
    campaigns::set_priority(tx, id, head.priority).await?;
    if let Some((instant, pin)) = &head.pinned {
        campaigns::pin(tx, id, pin, *instant).await?;
    }
    Ok(id)
}

/// Stores the early stop and the state of a campaign, which require that all jobs are stored.
pub(crate) async fn end(
    tx: &mut SqliteConnection,
    id: CampaignId,
    new: &NewCampaign,
    head: &Head,
) -> Result<(), StoreError> {
    if let Some(configurations) = new.stoppable_configurations {
        stops::insert(tx, id, configurations).await?;
    }
    let mut state = head.state;
    if let (CampaignState::Stopped { since }, Some(used)) = (state, head.used) {
        stops::stop(tx, id, used as usize, since).await?;
        state = CampaignState::Running { since };
    }
    campaigns::set_state(tx, id, state).await?;
    sqlx::query("UPDATE campaign SET created_ms = ? WHERE id = ?")
        .bind(head.created_ms)
        .bind(id)
        .execute(tx)
        .await
        .doing("store the creation of a campaign")
        .map(drop)
}

/// Stores jobs with their attempts, after those that the campaign has. Their numbers are higher
/// than those of all jobs that ever existed in this database. An attempt keeps its id, unless this
/// database has that id, and thus the original campaign as well.
pub(crate) async fn insert(
    tx: &mut SqliteConnection,
    campaign: CampaignId,
    lines: &[Line],
    (folder, films): (&str, &Films),
) -> Result<(), StoreError> {
    let first: i64 = sqlx::query_scalar("SELECT jobs FROM campaign WHERE id = ?")
        .bind(campaign)
        .fetch_one(&mut *tx)
        .await
        .doing("count a campaign's jobs")?;
    let new = (first..).zip(lines);
    let new = new.map(|(place, line)| NewJob::new(&line.row, line.replicate, place));
    let new = new.collect::<Result<Vec<NewJob>, _>>().map_err(undecodable);
    campaigns::append_jobs(tx, campaign, &new.doing("write manifest rows")?).await?;
    let last: i64 = sqlx::query_scalar("SELECT seq FROM sqlite_sequence WHERE name = 'job'")
        .fetch_one(&mut *tx)
        .await
        .doing("read the last job's number")?;
    let renamed = renamed(tx, lines).await?;
    let attempt_id = |id: AttemptId| renamed.get(&id).copied().unwrap_or(id);
    let mut origins: HashMap<&Provenance, _> = HashMap::new();
    let mut committed = Vec::new();
    for (number, line) in (last + 1 - lines.len() as i64..).zip(lines) {
        let job = JobId(number);
        let measurements = line.result.iter().map(|result| &result.measurement);
        let others = line.divergences.iter().map(|divergence| &divergence.measurement);
        for measurement in measurements.chain(others) {
            let origin = &measurement.provenance;
            if !origins.contains_key(origin) {
                origins.insert(origin, provenance::find_or_insert(tx, origin).await?);
            }
        }
        if let Some(result) = &line.result {
            insert_worker(tx, result).await?;
        }
        let result = line.result.as_ref();
        insert_history(tx, job, line, result.map(|result| attempt_id(result.attempt_id))).await?;
        for failure in &line.failures {
            insert_failure(tx, job, failure, attempt_id(failure.attempt_id)).await?;
        }
        if let Some(result) = result {
            let (attempt, worker) = (attempt_id(result.attempt_id), result.worker.clone());
            let unhex = |hex| hex::decode(hex).map_err(undecodable);
            let motion = Motion {
                path: unhex(&result.path).doing("read a robot's path")?,
                actions: unhex(&result.actions).doing("read a robot's actions")?,
            };
            let new = NewResult {
                attempt,
                job,
                number: AttemptNumber(result.attempt),
                worker: WorkerId(worker),
                campaign,
                result: &result.measurement.result,
                origin: origins[&result.measurement.provenance],
                motion: &motion,
            };
            results::insert(tx, &[new], result.committed_ms).await?;
            committed.push(attempt);
        }
        for other in &line.divergences {
            let Divergence { attempt, worker, reported_ms, measurement } = other;
            let attempt = (AttemptNumber(*attempt), &WorkerId(worker.clone()));
            let (result, origin) = (&measurement.result, origins[&measurement.provenance]);
            results::insert_divergence(tx, job, attempt, result, origin, *reported_ms).await?;
        }
    }
    jobs::mark_committed(tx, &committed).await?;
    for result in lines.iter().filter_map(|line| line.result.as_ref()) {
        if let Some((name, bytes)) = films.get(&result.attempt_id) {
            let (attempt, path) = (attempt_id(result.attempt_id), format!("{folder}/{name}"));
            artifacts::record(tx, attempt, &path, *bytes, result.committed_ms).await?;
        }
    }
    Ok(())
}

/// Returns new ids for the attempts whose ids this database has.
async fn renamed(
    tx: &mut SqliteConnection,
    lines: &[Line],
) -> Result<BTreeMap<AttemptId, AttemptId>, StoreError> {
    let results = lines.iter().filter_map(|line| Some(line.result.as_ref()?.attempt_id));
    let failures = lines.iter().flat_map(|line| &line.failures);
    let ids: Vec<AttemptId> = results.chain(failures.map(|failure| failure.attempt_id)).collect();
    let taken: Vec<(String, String)> = sqlx::query_as(
        "SELECT value, lower(hex(randomblob(16))) FROM json_each(?)
         WHERE EXISTS (SELECT 1 FROM result WHERE attempt_id = value)
             OR EXISTS (SELECT 1 FROM failure WHERE attempt_id = value)
             OR EXISTS (SELECT 1 FROM job WHERE state = 'leased' AND attempt_id = value)",
    )
    .bind(json(ids))
    .fetch_all(tx)
    .await
    .doing("find the attempts that this database has")?;
    let renamed = taken.into_iter().map(|(old, new)| Ok((old.parse()?, new.parse()?)));
    let renamed: Result<_, benchmark::attempt::AttemptIdError> = renamed.collect();
    renamed.map_err(undecodable).doing("read attempt ids")
}

/// Stores the worker of a result as signed off, unless it is known: it does not work for this
/// coordinator.
async fn insert_worker(tx: &mut SqliteConnection, result: &Committed) -> Result<(), StoreError> {
    let Provenance { host, pin, program_version, .. } = &result.measurement.provenance;
    sqlx::query(
        "INSERT INTO worker (id, host, slots, asset_pack, asset_pack_digest, mujoco_version,
             renderer, look, program_version, registered_ms, last_seen_ms, signed_off_ms)
         VALUES (?1, ?2, 1, ?3, ?4, ?5, ?6, ?7, ?8, ?9, ?9, ?9) ON CONFLICT DO NOTHING",
    )
    .bind(&result.worker)
    .bind(host)
    .bind(&pin.asset_pack)
    .bind(&pin.asset_pack_digest)
    .bind(&pin.mujoco_version)
    .bind(&pin.renderer)
    .bind(pin.look.name())
    .bind(program_version)
    .bind(result.committed_ms)
    .execute(tx)
    .await
    .doing("store the worker of a result")
    .map(drop)
}

/// Stores what a job has been through. A job with a result is leased until that is stored, as the
/// schema requires.
async fn insert_history(
    tx: &mut SqliteConnection,
    job: JobId,
    line: &Line,
    attempt: Option<AttemptId>,
) -> Result<(), StoreError> {
    let state = match (&line.result, line.is_quarantined) {
        (Some(_), _) => "leased",
        (None, true) => "quarantined",
        (None, false) => "queued",
    };
    let result = line.result.as_ref();
    sqlx::query(
        "UPDATE job SET state = ?2, attempt = ?3, charged_attempts = ?4, forgiven_attempt = ?5,
             losses = ?6, stale_reports = ?7, last_error = ?8,
             not_before_ms = iif(?2 = 'queued', 0, NULL), attempt_id = ?9, lease_owner = ?10,
             leased_ms = ?11, lease_expires_ms = ?11, ceiling_ms = ?11,
             control_steps = iif(?2 = 'leased', 0, NULL), claim_id = iif(?2 = 'leased', '', NULL),
             acknowledged = iif(?2 = 'leased', 1, NULL)
         WHERE id = ?1",
    )
    .bind(job)
    .bind(state)
    .bind(line.attempt)
    .bind(line.charged_attempts)
    .bind(line.forgiven_attempt)
    .bind(line.losses)
    .bind(line.stale_reports)
    .bind(&line.last_error)
    .bind(attempt.map(|attempt| attempt.to_string()))
    .bind(result.map(|result| &result.worker))
    .bind(result.map(|result| result.committed_ms))
    .execute(tx)
    .await
    .doing("store what a job has been through")
    .map(drop)
}

/// Stores an attempt without a result. It cannot be resumed, since a worker that reconnects reports
/// its result to the original coordinator.
async fn insert_failure(
    tx: &mut SqliteConnection,
    job: JobId,
    failure: &Failure,
    attempt: AttemptId,
) -> Result<(), StoreError> {
    sqlx::query(
        "INSERT INTO failure (attempt_id, job_id, attempt, worker_id, failed_ms, reason, charged,
             error)
         VALUES (?, ?, ?, ?, ?, ?, ?, ?)",
    )
    .bind(attempt.to_string())
    .bind(job)
    .bind(failure.attempt)
    .bind(&failure.worker)
    .bind(failure.failed_ms)
    .bind(&failure.reason)
    .bind(failure.charged)
    .bind(&failure.error)
    .execute(tx)
    .await
    .doing("store an attempt without a result")
    .map(drop)
}
