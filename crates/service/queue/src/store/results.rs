//! Statements on `result`, `motion` and `divergence`: results and the siblings that they are
//! compared with.

use std::sync::Arc;

use rollout_types::{AttemptId, Digests, Motion, Provenance, Realised, RolloutResult};
use sqlx::types::Json;
use sqlx::{QueryBuilder, Sqlite, SqliteConnection};

use super::jobs::InitialState;
use super::provenance::{ProvenanceId, provenance};
use super::{Doing, StoreError, insert_batches, json, undecodable};
use crate::clock::UnixMillis;
use crate::ids::{AttemptNumber, CampaignId, JobId, WorkerId};
use crate::rules::pairing::Sibling;

/// A result to be stored.
#[derive(Clone, Debug)]
pub(crate) struct NewResult<'a> {
    pub(crate) attempt: AttemptId,
    pub(crate) job: JobId,
    pub(crate) number: AttemptNumber,
    pub(crate) worker: WorkerId,
    pub(crate) campaign: CampaignId,
    pub(crate) result: &'a RolloutResult,
    pub(crate) origin: ProvenanceId,
    pub(crate) digests: &'a Digests,
    pub(crate) realised: &'a Realised,
    pub(crate) motion: &'a Motion,
}

/// SQL for the [`Digests`] of a result `r`, as JSON.
macro_rules! digests {
    () => {
        "json_object('scene', r.scene_digest, 'init_state', r.init_state_digest,
             'first_frame', r.first_frame_digest) AS digests"
    };
}
pub(crate) use digests;

/// Stores results. The caller marks their jobs as committed later in the same transaction.
pub(crate) async fn insert(
    tx: &mut SqliteConnection,
    results: &[NewResult<'_>],
    now: UnixMillis,
) -> Result<(), StoreError> {
    for chunk in insert_batches(results) {
        let mut statement = QueryBuilder::<Sqlite>::new(
            "INSERT INTO result (job_id, campaign_id, attempt_id, attempt, worker_id,
                 committed_ms, success, steps, wall_secs, ik_residual_mm, ik_residual_deg,
                 ik_clamped_joints, clipped_actions, policy_queries, provenance_id, scene_digest,
                 init_state_digest, first_frame_digest, realised, physics_secs, drawing_secs,
                 policy_secs, goal_predicates, goal_at_end, goal_at_most, prompt) ",
        );
        statement.push_values(chunk, |mut row, new| {
            let (result, digests, ik) = (new.result, new.digests, new.result.ik);
            row.push_bind(new.job)
                .push_bind(new.campaign)
                .push_bind(new.attempt.to_string())
                .push_bind(new.number)
                .push_bind(&new.worker)
                .push_bind(now)
                .push_bind(result.success)
                .push_bind(result.steps)
                .push_bind(result.wall_secs)
                .push_bind(ik.map(|ik| ik.residual_mm))
                .push_bind(ik.map(|ik| ik.residual_deg))
                .push_bind(ik.map(|ik| ik.clamped_joints))
                .push_bind(result.clipped_actions)
                .push_bind(result.policy_queries)
                .push_bind(new.origin)
                .push_bind(&digests.scene)
                .push_bind(&digests.init_state)
                .push_bind(&digests.first_frame)
                .push_bind(json(new.realised))
                .push_bind(result.parts.physics_secs)
                .push_bind(result.parts.drawing_secs)
                .push_bind(result.parts.policy_secs)
                .push_bind(result.goal.predicates)
                .push_bind(result.goal.at_end)
                .push_bind(result.goal.at_most)
                .push_bind(result.prompt.as_deref());
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
        "INSERT OR IGNORE INTO divergence (job_id, attempt, worker_id, reported_ms, success,
             steps, wall_secs, provenance_id)
         VALUES (?, ?, ?, ?, ?, ?, ?, ?)",
    )
    .bind(job)
    .bind(number)
    .bind(worker)
    .bind(now)
    .bind(result.success)
    .bind(result.steps)
    .bind(result.wall_secs)
    .bind(origin)
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
    type Row = (i64, String, WorkerId, Json<Digests>, Json<Realised>, Json<Provenance>);
    let rows: Vec<Row> = sqlx::query_as(concat!(
        "SELECT min(j.id), j.rollout_id, r.worker_id, ",
        digests!(),
        ", r.realised, ",
        provenance!(),
        " FROM job j
         JOIN result r ON r.job_id = j.id
         JOIN provenance v ON v.id = r.provenance_id
         WHERE j.campaign_id IN
                 (SELECT ?1 UNION SELECT s.id FROM campaign c JOIN campaign s ON s.name = c.source
                     WHERE c.id = ?1)
             AND j.task = ?2 AND j.init_id = ?3 AND j.state = 'committed'
         GROUP BY j.rollout_id, r.first_frame_digest = '', v.renderer, v.fingerprint,
             v.policy_name, v.policy_checkpoint, v.policy_checkpoint_digest
         ORDER BY 1",
    ))
    .bind(state.campaign)
    .bind(&state.task)
    .bind(state.init_id)
    .fetch_all(tx)
    .await
    .doing("find a configuration's siblings")?;
    let sibling = |(_, rollout, worker, digests, realised, origin): Row| {
        Ok(Sibling {
            rollout: rollout.parse().map_err(undecodable)?,
            worker,
            digests: digests.0,
            realised: realised.0,
            origin: Arc::new(origin.0),
        })
    };
    let siblings: Result<_, sqlx::Error> = rows.into_iter().map(sibling).collect();
    siblings.doing("read a configuration's siblings")
}
