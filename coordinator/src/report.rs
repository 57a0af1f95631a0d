//! Reading a campaign as it stands, for a report: what is committed, missing
//! and quarantined, and how it was made. What is said about it is the crate
//! `report`'s business. The same results give the same subject, however many
//! attempts they took.

use libero_ctrl::{CampaignSpec, Directions, ManifestRow, RolloutId, Rollouts, UnknownName};
use paired::{Outcome, Record};
use queue::read::{Campaign, RecordRow, SetupRow, View};
use report::{
    BeyondRange, Derived, EarlyStop, Origin, Purpose, Quarantined, Setups, Subject, counted,
    rollout_name,
};
use sha2::{Digest, Sha256};

use crate::reading::ReadError;

/// A campaign as it stands. Results of another realisation mode than the
/// campaign's, which a commit refuses, are missing from it and counted in
/// `left_out`: two modes perturb differently and are never pooled.
///
/// # Errors
/// When the database fails.
pub async fn subject(view: &mut View, campaign: &Campaign) -> Result<Subject, ReadError> {
    let spec = view.spec(campaign).await?;
    let spec = CampaignSpec::from_json(&spec).map_err(|source| ReadError::Spec {
        campaign: campaign.name.clone(),
        source,
    })?;
    let own = campaign.realisation.as_str();
    let rows = view.records(campaign.id).await?;
    let records: Result<Vec<Record>, _> = rows.iter().map(|row| read_record(row, own)).collect();
    let mut provenances = view.provenances(campaign.id).await?;
    // By their content: which came first depends on the workers.
    provenances.sort();
    let quarantined = view
        .quarantine(Some(campaign.id), u32::MAX)
        .await?
        .into_iter();
    let divergent = view.divergent(campaign.id).await?;
    Ok(Subject {
        policy: campaign.policy.clone(),
        origin: Origin::Campaign {
            name: campaign.name.as_str().to_owned(),
            endpoint: campaign.endpoint.clone(),
            design: spec.version().to_string(),
        },
        realisation: Some(own.parse()?),
        records: records?,
        errors: quarantined
            .map(|job| Quarantined {
                rollout: rollout_name(&job.rollout_id, job.replicate),
                last_error: job.last_error,
            })
            .collect(),
        divergent: divergent
            .iter()
            .map(|(id, replicate)| rollout_name(id, *replicate))
            .collect(),
        left_out: rows.iter().filter(|row| is_of_other_mode(row, own)).count() as u64,
        provenances,
        beyond: Some(beyond_range(view, campaign).await?),
        fingerprints: view.fingerprints(campaign.id).await?,
        published_nominal: None,
        published_by_suite: Vec::new(),
        reported_nominal: None,
        directions: match &spec.rollouts {
            Rollouts::Design(design) => design.directions,
            _ => Directions::default(),
        },
        setups: Setups::default(),
        derived: derived(view, campaign, spec.rollouts).await?,
        early_stop: early_stop(view, campaign).await?,
    })
}

/// Returns the purpose of a campaign that follows from another, and the records of that one.
async fn derived(
    view: &mut View,
    campaign: &Campaign,
    rollouts: Rollouts,
) -> Result<Option<Derived>, ReadError> {
    let purpose = match rollouts {
        Rollouts::Explanation(explanation) => Purpose::Explanation(explanation),
        Rollouts::Thresholds(thresholds) => Purpose::Thresholds(thresholds),
        Rollouts::Design(_) | Rollouts::Manifest(_) => return Ok(None),
    };
    let Some(source) = view.source(campaign.id).await? else {
        return Ok(None);
    };
    let own = source.realisation.as_str();
    let rows = view.records(source.id).await?;
    let records: Result<Vec<Record>, _> = rows.iter().map(|row| read_record(row, own)).collect();
    let early_stop = early_stop(view, &source).await?;
    Ok(Some(Derived {
        purpose,
        records: counted(&records?, early_stop.as_ref()).into_owned(),
    }))
}

/// Returns the rule by which a campaign may end early, and whether it did.
async fn early_stop(view: &mut View, campaign: &Campaign) -> Result<Option<EarlyStop>, ReadError> {
    let early = view.early_stop(campaign).await?;
    Ok(early.map(|early| EarlyStop {
        stop: early.stop,
        has_stopped: early.used.is_some(),
    }))
}

async fn beyond_range(view: &mut View, campaign: &Campaign) -> Result<BeyondRange, ReadError> {
    let (actions, of_actions, rollouts) = view.beyond_range(campaign.id).await?;
    Ok(BeyondRange {
        actions: actions.unsigned_abs(),
        of_actions: of_actions.unsigned_abs(),
        rollouts: rollouts.unsigned_abs(),
    })
}

/// Returns the setups of the campaign's rollouts, by which they are told from those of the same
/// names in another campaign.
///
/// # Errors
/// If the database fails.
pub async fn setups(view: &mut View, campaign: &Campaign) -> Result<Setups, ReadError> {
    let mut setups = Setups::default();
    for row in view.setups(campaign.id).await? {
        let SetupRow {
            rollout_id,
            manifest_row,
            scene_digest,
            init_state_digest,
        } = row;
        let unreadable = |rollout_id: String| {
            |error: serde_json::Error| ReadError::Row {
                rollout_id,
                source: error.into(),
            }
        };
        let row: ManifestRow =
            serde_json::from_str(&manifest_row).map_err(unreadable(rollout_id))?;
        let state = RolloutId::clean(row.id.task(), row.init_id);
        if let (Some(scene), Some(state_bytes)) = (scene_digest, init_state_digest) {
            setups.scenes.insert(state, digest(&[&scene, &state_bytes]));
        }
        // Neither the state's place in the design nor the name of a paraphrase
        // is met by the policy.
        let met = ManifestRow {
            init_slot: 0,
            variant_id: None,
            ..row
        };
        let id = met.id;
        let met = serde_json::to_string(&met).map_err(unreadable(id.to_string()))?;
        setups.rollouts.insert(id, digest(&[&met]));
    }
    Ok(setups)
}

/// As many digits of a SHA-256 as tell a campaign's rollouts apart.
fn digest(texts: &[&str]) -> String {
    let digest = Sha256::digest(texts.concat());
    digest[..8]
        .iter()
        .map(|byte| format!("{byte:02x}"))
        .collect()
}

fn read_record(row: &RecordRow, own: &str) -> Result<Record, UnknownName> {
    Ok(Record {
        id: row.rollout_id.parse()?,
        init_id: row.init_id,
        replicate: row.replicate,
        outcome: match row.success {
            Some(_) if is_of_other_mode(row, own) => Outcome::Missing,
            Some(success) => Outcome::from(success),
            None if row.is_quarantined => Outcome::Quarantined,
            None => Outcome::Missing,
        },
    })
}

fn is_of_other_mode(row: &RecordRow, own: &str) -> bool {
    row.realisation.as_ref().is_some_and(|mode| mode != own)
}
