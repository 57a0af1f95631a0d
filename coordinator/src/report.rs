//! Reading a campaign as it stands, for a report: what is committed, missing
//! and set aside, and how it was made. What is said about it is the crate
//! `report`'s business. The same results give the same subject, however many
//! attempts they took.

use paired::{Outcome, Record};
use protocol::{CampaignSpec, SpecError, UnknownName};
use report::{Origin, SetAside, Subject, rollout_name};

use crate::ids::CampaignName;
use crate::queue::{Queue, QueueError};
use crate::store::results::{self, Provenance, RecordRow};
use crate::store::{StoreError, campaigns};

/// A campaign that cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum ReportError {
    /// The campaign or the database.
    #[error(transparent)]
    Queue(#[from] QueueError),
    /// The stored specification does not read back.
    #[error("read the stored specification of campaign `{campaign}`")]
    Spec {
        /// Whose.
        campaign: CampaignName,
        /// What is wrong with it.
        source: SpecError,
    },
    /// A stored rollout id or realisation does not read back.
    #[error("read a stored name")]
    Name(#[from] UnknownName),
    /// The subject cannot be written as JSON.
    #[error("write a campaign's results as JSON")]
    Json(#[from] serde_json::Error),
}

/// A campaign as it stands. Results of another realisation mode than the
/// campaign's, which a commit refuses, are missing from it and counted in
/// `left_out`: two modes perturb differently and are never pooled.
///
/// # Errors
/// When there is no such campaign, or the database fails.
pub async fn subject(queue: &Queue, name: &CampaignName) -> Result<Subject, ReportError> {
    let in_store = |error: StoreError| ReportError::Queue(error.into());
    let mut tx = queue.store().read().await.map_err(in_store)?;
    let row = campaigns::by_name(&mut tx, name).await.map_err(in_store)?;
    let row = row.ok_or_else(|| QueueError::UnknownCampaign {
        campaign: name.clone(),
    })?;
    let spec = CampaignSpec::from_json(&row.spec).map_err(|source| ReportError::Spec {
        campaign: name.clone(),
        source,
    })?;
    let rows = results::records(&mut tx, row.id).await.map_err(in_store)?;
    let aside = results::quarantined(&mut tx, row.id).await;
    let divergent = results::divergent(&mut tx, row.id).await;
    let provenances = results::provenances(&mut tx, row.id).await;
    let fingerprints = results::fingerprints(&mut tx, row.id).await;
    let is_foreign = |record: &&RecordRow| record.is_of_other_mode(&row.realisation);
    let left_out = rows.iter().filter(is_foreign).count() as u64;
    let records = rows
        .iter()
        .map(|record| read_record(record, &row.realisation));
    let mut provenances: Vec<report::Provenance> = provenances
        .map_err(in_store)?
        .into_iter()
        .map(report::Provenance::from)
        .collect();
    // By their content: which came first depends on the workers.
    provenances.sort();
    Ok(Subject {
        policy: row.policy,
        origin: Origin::Campaign {
            name: row.name.as_str().to_owned(),
            endpoint: row.endpoint,
            design: spec.version().to_string(),
        },
        realisation: Some(row.realisation.parse()?),
        records: records.collect::<Result<_, _>>()?,
        errors: aside
            .map_err(in_store)?
            .into_iter()
            .map(|job| SetAside {
                rollout: rollout_name(&job.rollout_id, job.replicate),
                last_error: job.last_error,
            })
            .collect(),
        divergent: divergent
            .map_err(in_store)?
            .iter()
            .map(|(id, replicate)| rollout_name(id, *replicate))
            .collect(),
        left_out,
        provenances,
        fingerprints: fingerprints.map_err(in_store)?,
        published_nominal: None,
        reported_nominal: None,
    })
}

/// A campaign as it stands, as JSON.
///
/// # Errors
/// As [`subject`].
pub async fn subject_json(queue: &Queue, name: &CampaignName) -> Result<Vec<u8>, ReportError> {
    Ok(serde_json::to_vec(&subject(queue, name).await?)?)
}

fn read_record(row: &RecordRow, realisation: &str) -> Result<Record, UnknownName> {
    Ok(Record {
        id: row.rollout_id.parse()?,
        init_id: row.init_id,
        replicate: row.replicate,
        outcome: match row.success {
            Some(_) if row.is_of_other_mode(realisation) => Outcome::Missing,
            Some(success) => Outcome::from(success),
            None if row.is_quarantined => Outcome::Quarantined,
            None => Outcome::Missing,
        },
    })
}

impl RecordRow {
    fn is_of_other_mode(&self, realisation: &str) -> bool {
        let own = self.realisation.as_deref();
        own.is_some_and(|own| own != realisation)
    }
}

impl From<Provenance> for report::Provenance {
    fn from(stored: Provenance) -> Self {
        Self {
            host: stored.host,
            renderer: stored.renderer,
            fingerprint: stored.fingerprint,
            mujoco_version: stored.mujoco_version,
            asset_pack: stored.asset_pack,
            asset_pack_digest: stored.asset_pack_digest,
            realisation: stored.realisation,
            policy_name: stored.policy_name,
            policy_checkpoint: stored.policy_checkpoint,
            policy_checkpoint_digest: stored.policy_checkpoint_digest,
            policy_privileged: stored.policy_privileged,
            policy_canonical_only: stored.policy_canonical_only,
            batch_mode: stored.batch_mode,
            program_version: stored.program_version,
        }
    }
}
