//! Statements on `result`, `motion` and `divergence`: results and the siblings that they are
//! compared with.

use std::ops::Deref;
use std::sync::Arc;

use benchmark::attempt::{AttemptId, Motion, Provenance, RolloutResult};
use sqlx::error::BoxDynError;
use sqlx::sqlite::{SqliteTypeInfo, SqliteValueRef};
use sqlx::types::Json;
use sqlx::{Decode, QueryBuilder, Sqlite, SqliteConnection, Type};

use super::jobs::InitialState;
use super::provenance::ProvenanceId;
use super::{Doing, StoreError, insert_batches, undecodable};
use crate::clock::UnixMillis;
use crate::ids::{AttemptNumber, CampaignId, JobId, WorkerId};
use crate::rules::pairing::Sibling;

#[derive(Clone, Debug)]
pub(crate) struct NewResult<'a> {
    pub(crate) attempt: AttemptId,
    pub(crate) job: JobId,
    pub(crate) number: AttemptNumber,
    pub(crate) worker: WorkerId,
    pub(crate) campaign: CampaignId,
    pub(crate) result: &'a RolloutResult,
    pub(crate) origin: ProvenanceId,
    pub(crate) motion: &'a Motion,
}

/// A result, as decoded from its JSON.
#[derive(Clone, Debug)]
pub struct StoredResult(pub RolloutResult);

impl Deref for StoredResult {
    type Target = RolloutResult;

    fn deref(&self) -> &RolloutResult {
        &self.0
    }
}

impl Type<Sqlite> for StoredResult {
    fn type_info() -> SqliteTypeInfo {
        <str as Type<Sqlite>>::type_info()
    }
}

impl<'r> Decode<'r, Sqlite> for StoredResult {
    fn decode(value: SqliteValueRef<'r>) -> Result<Self, BoxDynError> {
        Ok(StoredResult(RolloutResult::from_json(<&str as Decode<Sqlite>>::decode(value)?)?))
    }
}

/// Stores results. The caller marks their jobs as committed later in the same transaction.
pub(crate) async fn insert(
    tx: &mut SqliteConnection,
    results: &[NewResult<'_>],
    now: UnixMillis,
) -> Result<(), StoreError> {
    for chunk in insert_batches(results) {
        let mut statement = QueryBuilder::<Sqlite>::new(
            "INSERT INTO result (job_id, campaign_id, attempt_id, attempt, worker_id,
                 committed_ms, provenance_id, outcome) ",
        );
        statement.push_values(chunk, |mut row, new| {
            row.push_bind(new.job)
                .push_bind(new.campaign)
                .push_bind(new.attempt.to_string())
                .push_bind(new.number)
                .push_bind(&new.worker)
                .push_bind(now)
                .push_bind(new.origin)
                .push_bind(Json(new.result));
        });
        let done = statement.build().persistent(true).execute(&mut *tx).await;
        done.doing("store results")?;
        let mut statement =
            QueryBuilder::<Sqlite>::new("INSERT INTO motion (job_id, path, actions) ");
        statement.push_values(chunk, |mut row, new| {
            row.push_bind(new.job).push_bind(&new.motion.path).push_bind(&new.motion.actions);
        });
        let done = statement.build().persistent(true).execute(&mut *tx).await;
        done.doing("store robot motions")?;
    }
    Ok(())
}

/// Records a result that contradicts the committed one. Repeated reports are stored once.
pub(crate) async fn insert_divergence(
    tx: &mut SqliteConnection,
    job: JobId,
    (number, worker): (AttemptNumber, &WorkerId),
    result: &RolloutResult,
    origin: ProvenanceId,
    now: UnixMillis,
) -> Result<(), StoreError> {
    sqlx::query(
        "INSERT OR IGNORE INTO divergence (job_id, attempt, worker_id, reported_ms, provenance_id,
             outcome)
         VALUES (?, ?, ?, ?, ?, ?)",
    )
    .bind(job)
    .bind(number)
    .bind(worker)
    .bind(now)
    .bind(origin)
    .bind(Json(result))
    .execute(tx)
    .await
    .doing("store a divergent outcome")
    .map(drop)
}

/// Returns the committed rollouts of an initial state, in the campaign and in its source. Of
/// replicates with equal renderer, fingerprint and policy, returns only the first with a first
/// frame, and the first without.
pub(crate) async fn siblings(
    tx: &mut SqliteConnection,
    state: &InitialState,
) -> Result<Vec<Sibling>, StoreError> {
    // With a single min(), SQLite takes the other columns from the same row.
    type Row = (i64, String, WorkerId, StoredResult, Json<Provenance>);
    let rows: Vec<Row> = sqlx::query_as(
        "SELECT min(j.id), j.rollout_id, r.worker_id, r.outcome, v.origin FROM job j
         JOIN result r ON r.job_id = j.id
         JOIN provenance v ON v.id = r.provenance_id
         WHERE j.campaign_id IN
                 (SELECT ?1 UNION SELECT s.id FROM campaign c JOIN campaign s ON s.name = c.source
                     WHERE c.id = ?1)
             AND j.task = ?2 AND j.init_id = ?3 AND j.state = 'committed'
         GROUP BY j.rollout_id, r.outcome ->> '$.digests.first_frame' = '', v.renderer,
             v.fingerprint, v.policy_name, v.policy_checkpoint, v.policy_checkpoint_digest
         ORDER BY 1",
    )
    .bind(state.campaign)
    .bind(&state.task)
    .bind(state.init_id)
    .fetch_all(tx)
    .await
    .doing("find a configuration's siblings")?;
    let sibling = |(_, rollout, worker, StoredResult(result), origin): Row| {
        Ok(Sibling {
            rollout: rollout.parse().map_err(undecodable)?,
            worker,
            digests: result.digests,
            realised: result.realised,
            origin: Arc::new(origin.0),
        })
    };
    let siblings: Result<_, sqlx::Error> = rows.into_iter().map(sibling).collect();
    siblings.doing("read a configuration's siblings")
}
