//! Statements on `result`, `provenance` and `divergence`: what came out, and
//! where it came from.

use protocol::RolloutId;
use report::Fingerprints;
use sqlx::{QueryBuilder, Sqlite, SqliteConnection};

use super::motions::Motion;
use super::{Doing, StoreError, in_few_statements, undecodable};
use crate::clock::UnixMillis;
use crate::digests::{AxisDigests, AxisDigestsError};
use crate::ids::{CampaignId, LeaseRef, WorkerId};

/// What a rollout came to.
#[derive(Clone, Debug, PartialEq)]
pub struct Outcome {
    /// Whether the goal was reached.
    pub success: bool,
    /// The policy's control steps: the one that reached the goal, or the budget.
    pub steps: u32,
    /// Duration of the rollout.
    pub wall_secs: f64,
    /// Robot axis only: residual of the inverse kinematics, mm.
    pub ik_residual_mm: Option<f64>,
    /// Robot axis only: residual of the inverse kinematics, degrees.
    pub ik_residual_deg: Option<f64>,
    /// Robot axis only: joints at their limits.
    pub ik_clamped_joints: Option<u32>,
    /// Actions clipped into [−1, 1] at the policy boundary.
    pub clipped_actions: u32,
    /// Times that the policy was asked.
    pub policy_queries: u32,
}

/// Where a result came from, as far as many results share it.
#[derive(Clone, Debug, PartialEq, Eq, Hash, sqlx::FromRow)]
pub struct Provenance {
    /// Machine.
    pub host: String,
    /// What draws, by its own name; empty in results of schema 1 for which no
    /// frame was drawn.
    pub renderer: String,
    /// Fingerprint of the slot; empty in results of schema 1.
    pub fingerprint: String,
    /// Version of the simulator.
    pub mujoco_version: String,
    /// Name of the asset pack.
    pub asset_pack: String,
    /// Digest of the asset pack.
    pub asset_pack_digest: String,
    /// "matched" or "reference".
    pub realisation: String,
    /// What the policy calls itself.
    pub policy_name: String,
    /// Its checkpoint.
    pub policy_checkpoint: String,
    /// Digest of its checkpoint.
    pub policy_checkpoint_digest: String,
    /// Whether it saw privileged simulator state.
    pub policy_privileged: bool,
    /// Whether it was told the canonical instruction whatever the condition.
    pub policy_canonical_only: bool,
    /// How its queries were batched.
    pub batch_mode: String,
    /// Version of the worker's program.
    pub program_version: String,
}

/// Row number of an origin that is stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq, sqlx::Type)]
#[sqlx(transparent)]
pub(crate) struct ProvenanceId(i64);

/// What makes two rollouts comparable, SHA-256 in hex.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Digests {
    /// Of the composed MJCF.
    pub scene: String,
    /// Of the initial state's bytes.
    pub init_state: String,
    /// Of the perturbation as realised, axis by axis.
    pub perturbation: AxisDigests,
    /// Of the first frames that the policy saw; empty where it looks at none.
    pub first_frame: String,
}

/// What matched rollouts share: one campaign, one scene, one initial state.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct InitialState {
    pub(crate) campaign: CampaignId,
    /// "libero_goal/3".
    pub(crate) task: String,
    pub(crate) init_id: i64,
}

/// An outcome on its way into the database.
#[derive(Clone, Copy, Debug)]
pub(crate) struct NewResult<'a> {
    /// The lease that it ends.
    pub(crate) lease: &'a LeaseRef,
    pub(crate) campaign: CampaignId,
    pub(crate) outcome: &'a Outcome,
    pub(crate) origin: ProvenanceId,
    pub(crate) digests: &'a Digests,
    pub(crate) motion: &'a Motion,
}

/// A committed rollout of the same initial state, to be compared with.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Sibling {
    pub(crate) rollout: RolloutId,
    pub(crate) worker: WorkerId,
    pub(crate) scene: String,
    pub(crate) init_state: String,
    pub(crate) perturbation: AxisDigests,
    pub(crate) first_frame: String,
    pub(crate) renderer: String,
    pub(crate) policy_name: String,
    pub(crate) policy_checkpoint: String,
    pub(crate) policy_checkpoint_digest: String,
}

/// A [`Sibling`] as it is stored.
#[derive(sqlx::FromRow)]
struct SiblingRow {
    rollout_id: String,
    worker_id: WorkerId,
    scene_digest: String,
    init_state_digest: String,
    perturbation_digests: String,
    first_frame_digest: String,
    renderer: String,
    policy_name: String,
    policy_checkpoint: String,
    policy_checkpoint_digest: String,
}

/// A committed rollout as reports and exports read it.
#[derive(Clone, Debug, sqlx::FromRow)]
pub(crate) struct ResultRow {
    pub(crate) rollout_id: String,
    pub(crate) replicate: u32,
    pub(crate) manifest_row: String,
    pub(crate) success: bool,
    pub(crate) steps: u32,
    pub(crate) wall_secs: f64,
    pub(crate) ik_residual_mm: Option<f64>,
}

/// A job as reports count it.
#[derive(Clone, Debug, sqlx::FromRow)]
pub(crate) struct RecordRow {
    pub(crate) rollout_id: String,
    pub(crate) replicate: u32,
    pub(crate) init_id: u16,
    pub(crate) is_quarantined: bool,
    pub(crate) success: Option<bool>,
    pub(crate) realisation: Option<String>,
}

/// A job that was set aside.
#[derive(Clone, Debug, sqlx::FromRow)]
pub(crate) struct QuarantineRow {
    pub(crate) rollout_id: String,
    pub(crate) replicate: u32,
    pub(crate) last_error: String,
}

/// Stores outcomes; their jobs are marked as committed right after, in the same
/// transaction.
pub(crate) async fn insert(
    tx: &mut SqliteConnection,
    results: &[NewResult<'_>],
    now: UnixMillis,
) -> Result<(), StoreError> {
    for chunk in in_few_statements(results) {
        insert_chunk(tx, chunk, now).await?;
    }
    Ok(())
}

async fn insert_chunk(
    tx: &mut SqliteConnection,
    results: &[NewResult<'_>],
    now: UnixMillis,
) -> Result<(), StoreError> {
    let mut statement = QueryBuilder::<Sqlite>::new(
        "INSERT INTO result (job_id, campaign_id, attempt, worker_id, committed_ms, success,
             steps, wall_secs, ik_residual_mm, ik_residual_deg, ik_clamped_joints,
             clipped_actions, policy_queries, provenance_id, scene_digest, init_state_digest,
             perturbation_digests, first_frame_digest) ",
    );
    statement.push_values(results, |mut row, result| {
        let (lease, outcome, digests) = (result.lease, result.outcome, result.digests);
        row.push_bind(lease.job)
            .push_bind(result.campaign)
            .push_bind(lease.attempt)
            .push_bind(&lease.worker)
            .push_bind(now)
            .push_bind(outcome.success)
            .push_bind(outcome.steps)
            .push_bind(outcome.wall_secs)
            .push_bind(outcome.ik_residual_mm)
            .push_bind(outcome.ik_residual_deg)
            .push_bind(outcome.ik_clamped_joints)
            .push_bind(outcome.clipped_actions)
            .push_bind(outcome.policy_queries)
            .push_bind(result.origin)
            .push_bind(&digests.scene)
            .push_bind(&digests.init_state)
            .push_bind(digests.perturbation.to_string())
            .push_bind(&digests.first_frame);
    });
    let done = statement.build().persistent(true).execute(tx).await;
    done.doing("store results")?;
    Ok(())
}

/// Keeps an outcome that contradicts the committed one. The same report twice
/// is kept once.
pub(crate) async fn insert_divergence(
    tx: &mut SqliteConnection,
    lease: &LeaseRef,
    outcome: &Outcome,
    provenance: &Provenance,
    now: UnixMillis,
) -> Result<(), StoreError> {
    let provenance = provenance_id(tx, provenance).await?;
    sqlx::query(
        "INSERT OR IGNORE INTO divergence (job_id, attempt, worker_id, reported_ms, success,
             steps, wall_secs, provenance_id)
         VALUES (?, ?, ?, ?, ?, ?, ?, ?)",
    )
    .bind(lease.job)
    .bind(lease.attempt)
    .bind(&lease.worker)
    .bind(now)
    .bind(outcome.success)
    .bind(outcome.steps)
    .bind(outcome.wall_secs)
    .bind(provenance)
    .execute(tx)
    .await
    .doing("keep a divergent outcome")?;
    Ok(())
}

/// The committed rollouts of an initial state. Replicates that drew with one
/// renderer for one policy agree, so that the first speaks for the others.
pub(crate) async fn siblings(
    tx: &mut SqliteConnection,
    of: &InitialState,
) -> Result<Vec<Sibling>, StoreError> {
    // With a lone min(), SQLite takes the other columns from that very row.
    let rows: Result<Vec<SiblingRow>, sqlx::Error> = sqlx::query_as(
        "SELECT min(s.id), s.rollout_id, r.worker_id, r.scene_digest, r.init_state_digest,
             r.perturbation_digests, r.first_frame_digest, v.renderer, v.policy_name,
             v.policy_checkpoint, v.policy_checkpoint_digest
         FROM job s
         JOIN result r ON r.job_id = s.id
         JOIN provenance v ON v.id = r.provenance_id
         WHERE s.campaign_id = ? AND s.task = ? AND s.init_id = ? AND s.state = 'committed'
         GROUP BY s.rollout_id, r.first_frame_digest = '', v.renderer, v.policy_name, v.policy_checkpoint, v.policy_checkpoint_digest
         ORDER BY 1",
    )
    .bind(of.campaign)
    .bind(&of.task)
    .bind(of.init_id)
    .fetch_all(tx)
    .await;
    let siblings = rows.and_then(|rows| rows.into_iter().map(Sibling::try_from).collect());
    siblings.doing("look for a configuration's siblings")
}

impl Sibling {
    /// A rollout that is being committed, as those that come later see it.
    pub(crate) fn new(
        rollout: RolloutId,
        worker: &WorkerId,
        provenance: &Provenance,
        digests: &Digests,
    ) -> Sibling {
        Sibling {
            rollout,
            worker: worker.clone(),
            scene: digests.scene.clone(),
            init_state: digests.init_state.clone(),
            perturbation: digests.perturbation.clone(),
            first_frame: digests.first_frame.clone(),
            renderer: provenance.renderer.clone(),
            policy_name: provenance.policy_name.clone(),
            policy_checkpoint: provenance.policy_checkpoint.clone(),
            policy_checkpoint_digest: provenance.policy_checkpoint_digest.clone(),
        }
    }

    /// Whether the other is a replicate that nothing more can be compared with.
    pub(crate) fn speaks_for(&self, other: &Sibling) -> bool {
        self.rollout == other.rollout
            && self.first_frame.is_empty() == other.first_frame.is_empty()
            && self.renderer == other.renderer
            && self.policy_name == other.policy_name
            && self.policy_checkpoint == other.policy_checkpoint
            && self.policy_checkpoint_digest == other.policy_checkpoint_digest
    }
}

impl TryFrom<SiblingRow> for Sibling {
    type Error = sqlx::Error;

    fn try_from(row: SiblingRow) -> Result<Sibling, sqlx::Error> {
        let perturbation = row.perturbation_digests.parse();
        Ok(Sibling {
            rollout: row.rollout_id.parse().map_err(undecodable)?,
            worker: row.worker_id,
            scene: row.scene_digest,
            init_state: row.init_state_digest,
            perturbation: perturbation.map_err(|error: AxisDigestsError| undecodable(error))?,
            first_frame: row.first_frame_digest,
            renderer: row.renderer,
            policy_name: row.policy_name,
            policy_checkpoint: row.policy_checkpoint,
            policy_checkpoint_digest: row.policy_checkpoint_digest,
        })
    }
}

/// Up to `limit` committed rollouts after one, by rollout id, then replicate.
pub(crate) async fn page(
    tx: &mut SqliteConnection,
    campaign: CampaignId,
    after: Option<(&str, u32)>,
    limit: u32,
) -> Result<Vec<ResultRow>, StoreError> {
    let (rollout_id, replicate) = after.map_or(("", -1), |(id, k)| (id, i64::from(k)));
    sqlx::query_as(
        "SELECT j.rollout_id, j.replicate, j.manifest_row, r.success, r.steps, r.wall_secs,
             r.ik_residual_mm
         FROM job j JOIN result r ON r.job_id = j.id
         WHERE j.campaign_id = ? AND (j.rollout_id, j.replicate) > (?, ?)
         ORDER BY j.rollout_id, j.replicate LIMIT ?",
    )
    .bind(campaign)
    .bind(rollout_id)
    .bind(replicate)
    .bind(limit)
    .fetch_all(tx)
    .await
    .doing("read results")
}

/// All jobs of a campaign with what is known of them, by rollout id, then
/// replicate.
pub(crate) async fn records(
    tx: &mut SqliteConnection,
    campaign: CampaignId,
) -> Result<Vec<RecordRow>, StoreError> {
    sqlx::query_as(
        "SELECT j.rollout_id, j.replicate, j.init_id, j.state = 'quarantined' AS is_quarantined,
             r.success, v.realisation
         FROM job j LEFT JOIN result r ON r.job_id = j.id
         LEFT JOIN provenance v ON v.id = r.provenance_id
         WHERE j.campaign_id = ? ORDER BY j.rollout_id, j.replicate",
    )
    .bind(campaign)
    .fetch_all(tx)
    .await
    .doing("read what is known of a campaign")
}

/// The jobs that were set aside, by rollout id, then replicate.
pub(crate) async fn quarantined(
    tx: &mut SqliteConnection,
    campaign: CampaignId,
) -> Result<Vec<QuarantineRow>, StoreError> {
    sqlx::query_as(
        "SELECT rollout_id, replicate, last_error FROM job
         WHERE campaign_id = ? AND state = 'quarantined' ORDER BY rollout_id, replicate",
    )
    .bind(campaign)
    .fetch_all(tx)
    .await
    .doing("read the quarantine")
}

/// The distinct provenances of a campaign's results.
pub(crate) async fn provenances(
    tx: &mut SqliteConnection,
    campaign: CampaignId,
) -> Result<Vec<Provenance>, StoreError> {
    sqlx::query_as(
        "SELECT host, renderer, fingerprint, mujoco_version, asset_pack, asset_pack_digest, realisation,
             policy_name, policy_checkpoint, policy_checkpoint_digest, policy_privileged,
             policy_canonical_only, batch_mode, program_version
         FROM provenance
         WHERE id IN (SELECT provenance_id FROM result WHERE campaign_id = ?)
         ORDER BY id",
    )
    .bind(campaign)
    .fetch_all(tx)
    .await
    .doing("read where results came from")
}

/// Results of each fingerprint in a campaign, and the tasks and initial states
/// that have several; none while there is one. Walks the results' index, and the
/// committed jobs only if there is something to tell.
pub(crate) async fn fingerprints(
    tx: &mut SqliteConnection,
    campaign: CampaignId,
) -> Result<Option<Fingerprints>, StoreError> {
    let results: Vec<(String, i64)> = sqlx::query_as(
        "SELECT v.fingerprint, sum(o.results) FROM
             (SELECT provenance_id, count(*) AS results FROM result WHERE campaign_id = ?
              GROUP BY provenance_id) o
         JOIN provenance v ON v.id = o.provenance_id
         WHERE v.fingerprint <> '' GROUP BY v.fingerprint",
    )
    .bind(campaign)
    .fetch_all(&mut *tx)
    .await
    .doing("count the results of each fingerprint")?;
    if results.len() < 2 {
        return Ok(None);
    }
    let mixed: Vec<(String, i64)> = sqlx::query_as(
        "SELECT j.task, j.init_id FROM job j
         JOIN result r ON r.job_id = j.id
         JOIN provenance v ON v.id = r.provenance_id
         WHERE j.campaign_id = ? AND j.state = 'committed' AND v.fingerprint <> ''
         GROUP BY j.task, j.init_id HAVING count(DISTINCT v.fingerprint) > 1
         ORDER BY j.task, j.init_id",
    )
    .bind(campaign)
    .fetch_all(tx)
    .await
    .doing("look for configurations of several fingerprints")?;
    let results = results.into_iter();
    let name = |(task, init_id)| format!("{task} from state {init_id}");
    Ok(Some(Fingerprints {
        results: results
            .map(|(fingerprint, results)| (fingerprint, results.unsigned_abs()))
            .collect(),
        mixed: mixed.into_iter().map(name).collect(),
    }))
}

/// Rollouts of a campaign that were reported again with another outcome.
pub(crate) async fn divergent(
    tx: &mut SqliteConnection,
    campaign: CampaignId,
) -> Result<Vec<(String, u32)>, StoreError> {
    sqlx::query_as(
        "SELECT DISTINCT j.rollout_id, j.replicate FROM divergence d JOIN job j ON j.id = d.job_id
         WHERE j.campaign_id = ? ORDER BY j.rollout_id, j.replicate",
    )
    .bind(campaign)
    .fetch_all(tx)
    .await
    .doing("read divergent outcomes")
}

/// The row number of an origin, which is stored if it is new.
pub(crate) async fn provenance_id(
    tx: &mut SqliteConnection,
    provenance: &Provenance,
) -> Result<ProvenanceId, StoreError> {
    let p = provenance;
    let texts = [
        &p.host,
        &p.renderer,
        &p.fingerprint,
        &p.mujoco_version,
        &p.asset_pack,
        &p.asset_pack_digest,
        &p.realisation,
        &p.policy_name,
        &p.policy_checkpoint,
        &p.policy_checkpoint_digest,
        &p.batch_mode,
        &p.program_version,
    ];
    let mut insert = sqlx::query_scalar(
        "INSERT INTO provenance (host, renderer, fingerprint, mujoco_version, asset_pack,
             asset_pack_digest, realisation, policy_name, policy_checkpoint,
             policy_checkpoint_digest, batch_mode, program_version, policy_privileged,
             policy_canonical_only)
         VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?) RETURNING id",
    );
    let mut select = sqlx::query_scalar(
        "SELECT id FROM provenance WHERE host = ? AND renderer = ? AND fingerprint = ?
             AND mujoco_version = ? AND asset_pack = ? AND asset_pack_digest = ? AND realisation = ?
             AND policy_name = ? AND policy_checkpoint = ? AND policy_checkpoint_digest = ?
             AND batch_mode = ? AND program_version = ? AND policy_privileged = ?
             AND policy_canonical_only = ?",
    );
    for text in texts {
        insert = insert.bind(text);
        select = select.bind(text);
    }
    let known: Option<ProvenanceId> = select
        .bind(p.policy_privileged)
        .bind(p.policy_canonical_only)
        .fetch_optional(&mut *tx)
        .await
        .doing("look up where a result came from")?;
    if let Some(id) = known {
        return Ok(id);
    }
    insert
        .bind(p.policy_privileged)
        .bind(p.policy_canonical_only)
        .fetch_one(tx)
        .await
        .doing("store where a result came from")
}
