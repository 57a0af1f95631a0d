//! Reads a campaign's committed, missing and quarantined rollouts and their provenance as input of
//! a report, which the `report` crate computes. The same results give the same subject, however
//! many attempts they took.

use std::collections::{BTreeMap, BTreeSet};

use benchmark::attempt::Digests;
use benchmark::{
    CampaignSpec, Directions, Execution, Level, ManifestRow, Purpose, RolloutId, Rollouts,
    UnknownName,
};
use paired::{Outcome, Progress, Record};
use queue::read::{Campaign, RecordRow, SetupRow, View};
use report::{
    BeyondRange, Derived, EarlyStop, Origin, Quarantined, Setups, SimulatedTask, Subject, counted,
    rollout_name,
};
use sha2::{Digest, Sha256};

use crate::reading::ReadError;

/// Reads the current results of a campaign. A result of a realisation mode other than the
/// campaign's is treated as missing and counted in `left_out`: the modes perturb differently and
/// must not be pooled. The queue refuses to commit such results.
pub(crate) async fn read(view: &mut View, campaign: &Campaign) -> Result<Subject, ReadError> {
    let spec = view.current_spec(campaign).await?;
    let spec = CampaignSpec::from_json(&spec)
        .map_err(|source| ReadError::Spec { campaign: campaign.name.clone(), source })?;
    let realisation = campaign.realisation.as_str();
    let (mut progress, mut left_out, mut beyond) = (Vec::new(), 0, BeyondRange::default());
    let (mut simulated, repeating) = simulated_tasks(&spec);
    let mut begun: BTreeMap<(u8, u16), Vec<String>> = BTreeMap::new();
    let records = view.records(campaign.id, |row| {
        let record = read_record(&row, realisation)?;
        left_out += u64::from(is_of_other_mode(&row, realisation));
        if let Some(result) = &row.outcome
            && repeating.contains(&record.id)
        {
            let of_seed = begun.entry((record.id.task().index(), record.init_id)).or_default();
            of_seed.push(result.digests.init_state.clone());
        }
        if let Some(result) = row.outcome {
            beyond.actions += u64::from(result.clipped_actions);
            beyond.of_actions += u64::from(result.steps);
            beyond.rollouts += u64::from(result.clipped_actions > 0);
            if record.outcome.success().is_some() {
                let Record { id, replicate, .. } = record;
                let (steps, goal) = (Some(result.steps), Some(result.goal));
                progress.push(Progress { id, replicate, steps, goal });
            }
        }
        Ok::<_, UnknownName>(record)
    });
    let records = records.await?.into_iter().collect::<Result<Vec<Record>, _>>()?;
    for ((task, _), digests) in begun.into_iter().filter(|(_, digests)| digests.len() > 1) {
        let task = simulated.entry(task).or_default();
        task.seeds += 1;
        task.unrepeated += u64::from(digests.iter().any(|digest| *digest != digests[0]));
    }
    let design = match &spec.rollouts {
        Rollouts::Design(design) => Some(design),
        _ => None,
    };
    let placebo = design.filter(|design| design.levels.contains(&Level::L0));
    let mut provenances = view.provenances(campaign.id).await?;
    // Sorted by content, since their order of arrival depends on the workers.
    provenances.sort();
    let quarantined = view.quarantine(Some(campaign.id), u32::MAX).await?.into_iter();
    let divergent = view.divergent(campaign.id).await?;
    Ok(Subject {
        policy: campaign.policy.clone(),
        origin: Origin::Campaign {
            name: campaign.name.as_str().to_owned(),
            endpoint: campaign.endpoint.clone(),
            design: spec.version().to_string(),
        },
        realisation: Some(realisation.parse()?),
        look: None,
        execution: spec.execution.clone(),
        progress,
        placebo_radius: placebo.map(|design| design.placebo.radius.radius()),
        directions: design.map_or_else(Directions::default, |design| design.directions),
        records,
        errors: quarantined
            .map(|job| Quarantined {
                rollout: rollout_name(&job.rollout_id, job.replicate),
                last_error: job.last_error,
            })
            .collect(),
        divergent: divergent.iter().map(|(id, replicate)| rollout_name(id, *replicate)).collect(),
        left_out,
        provenances,
        beyond: Some(beyond),
        fingerprints: view.fingerprints(campaign.id).await?,
        published_nominal: None,
        published_by_suite: Vec::new(),
        reported_nominal: None,
        setups: Setups::default(),
        protocol: spec.rollouts.protocol().map(str::to_owned),
        derived: derived(view, campaign, spec.purpose).await?,
        early_stop: early_stop(view, campaign).await?,
        simulated,
    })
}

/// Returns the tasks of other simulators, and those of their rollouts that begin with the same
/// observation if the simulator repeats its resets.
fn simulated_tasks(spec: &CampaignSpec) -> (BTreeMap<u8, SimulatedTask>, BTreeSet<RolloutId>) {
    let (mut tasks, mut repeating) = (BTreeMap::new(), BTreeSet::new());
    let Rollouts::Rows(rows) = &spec.rollouts else { return (tasks, repeating) };
    for row in rows {
        let Some(of) = &row.simulator else { continue };
        let name = format!("{}/{}", of.name, of.task);
        let task = SimulatedTask { name, ..SimulatedTask::default() };
        tasks.insert(row.id.task().index(), task);
        if of.perturb.is_empty() {
            repeating.insert(row.id);
        }
    }
    (tasks, repeating)
}

/// Returns the purpose of a derived campaign and the records of its source; `None` for other
/// campaigns, and if the source was deleted.
async fn derived(
    view: &mut View,
    campaign: &Campaign,
    purpose: Option<Purpose>,
) -> Result<Option<Derived>, ReadError> {
    let Some(purpose) = purpose else { return Ok(None) };
    let Some(source) = view.source(campaign.id).await? else {
        return Ok(None);
    };
    let realisation = source.realisation.as_str();
    let records = view.records(source.id, |row| read_record(&row, realisation)).await?;
    let records: Result<Vec<Record>, _> = records.into_iter().collect();
    let early_stop = early_stop(view, &source).await?;
    Ok(Some(Derived { purpose, records: counted(&records?, early_stop.as_ref()).into_owned() }))
}

/// Returns a campaign's stop rule and whether the campaign has stopped early; `None` if it has no
/// rule.
async fn early_stop(view: &mut View, campaign: &Campaign) -> Result<Option<EarlyStop>, ReadError> {
    let early = view.early_stop(campaign).await?;
    Ok(early.map(|early| EarlyStop { stop: early.stop, has_stopped: early.used.is_some() }))
}

/// Returns digests of the setups of a campaign's rollouts. Rollouts of the same id in two campaigns
/// are comparable if their digests are equal.
pub(crate) async fn setups(view: &mut View, campaign: &Campaign) -> Result<Setups, ReadError> {
    let mut setups = Setups::default();
    for row in view.setups(campaign.id).await? {
        let SetupRow { rollout_id, manifest_row, digests } = row;
        let unreadable = |rollout_id: String| {
            |error: serde_json::Error| ReadError::Row { rollout_id, source: error.into() }
        };
        let row: ManifestRow =
            serde_json::from_str(&manifest_row).map_err(unreadable(rollout_id))?;
        // Rollouts of one initial state share its scene, which is found by their nominal rollout; a
        // rollout of a suite that is run without axes has none.
        let state = match row.id.variant() {
            Some(name) if name.benchmark().is_none() => row.id,
            _ => RolloutId::nominal(row.id.task(), row.init_id),
        };
        if let Some(Digests { scene, mut init_state, .. }) = digests {
            // Another simulator need not repeat an initial state, which the report says.
            if row.simulator.is_some() {
                init_state.clear();
            }
            setups.scenes.insert(state, digest(&[&scene, &init_state]));
        }
        // Left out: the place of the initial state in the design (`init_slot`); the paraphrase's name
        // (`variant_id`), since the policy observes only its text; and the execution model, which a
        // report compares separately.
        let observed =
            ManifestRow { init_slot: 0, variant_id: None, execution: Execution::Wait, ..row };
        let id = observed.id;
        let observed = serde_json::to_string(&observed).map_err(unreadable(id.to_string()))?;
        setups.rollouts.insert(id, digest(&[&observed]));
    }
    Ok(setups)
}

/// Returns 16 hex digits of a SHA-256, enough to distinguish the rollouts of a campaign.
fn digest(texts: &[&str]) -> String {
    hex::encode(&Sha256::digest(texts.concat())[..8])
}

fn read_record(row: &RecordRow, realisation: &str) -> Result<Record, UnknownName> {
    let mut record = row.job.record()?;
    if is_of_other_mode(row, realisation) {
        record.outcome = Outcome::Missing;
    }
    Ok(record)
}

fn is_of_other_mode(row: &RecordRow, realisation: &str) -> bool {
    row.realisation.as_ref().is_some_and(|mode| mode != realisation)
}
