//! Merge of two halves of one campaign that two coordinators ran.

use std::collections::BTreeMap;
use std::path::Path;

use libero_ctrl::{CampaignSpec, Suite};

use super::error::QueueError;
use super::portable::{Portable, PortableError, copy_into, source_of};
use crate::expand::differing_fields;
use crate::ids::{CampaignName, JobName};
use crate::rules::lease::OutcomeKey;
use crate::rules::merge::{self, Contradiction, KeptHalf, Standing};
use crate::rules::pairing::{self, Demand, Sibling};
use crate::store::halves::{self, Rollout, Schema, Stored};
use crate::store::{DATABASE_FILE, Doing, StoreError, portable, undecodable};

/// Maximum number of contradictions that an error describes; further ones are only counted.
const MAX_EXAMPLES: usize = 20;

/// Numbers of rollouts in a merged campaign.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Merged {
    /// Rollouts with an outcome in the first half only.
    pub first: u64,
    /// Rollouts with an outcome in the second half only.
    pub second: u64,
    /// Rollouts with the same outcome in both halves.
    pub both: u64,
    pub quarantined: u64,
    /// Rollouts still to be run.
    pub open: u64,
}

/// Two campaigns that cannot be merged.
#[derive(Debug, thiserror::Error)]
pub enum MergeError {
    #[error(
        "merge `{campaign}`: its rollouts are derived from the outcomes of another campaign; merge that campaign, and derive from it again"
    )]
    Derived { campaign: CampaignName },
    #[error(
        "merge `{first}` and `{second}`: their specifications differ in {differs}; only halves of one design can be merged"
    )]
    Specification { first: CampaignName, second: CampaignName, differs: String },
    #[error(
        "merge the halves: rollout `{rollout}` has a different manifest row in each; only halves of one \
         design, expanded by one version of the program, can be merged"
    )]
    Rollout { rollout: JobName },
    /// The halves have different pins: asset packs, simulators or renderers.
    #[error("merge the halves: the first is pinned to {first} and the second to {second}")]
    Pin { first: String, second: String },
    #[error("merge the halves: in {suite} they measured different policies, whose {difference}")]
    Policy { suite: Suite, difference: String },
    #[error(
        "merge the halves: {count} of their rollouts contradict each other\n{examples}\ncompare the origins of these outcomes, and merge only halves that were run in the same way"
    )]
    Contradictions {
        count: usize,
        /// The first contradictions, one a line, with both outcomes and their origins.
        examples: String,
    },
    /// The queue failed, for example because a stored specification cannot be parsed.
    #[error(transparent)]
    Queue(#[from] QueueError),
    #[error(transparent)]
    Portable(#[from] PortableError),
}

impl From<StoreError> for MergeError {
    fn from(error: StoreError) -> MergeError {
        MergeError::Portable(error.into())
    }
}

/// Merges two halves of one campaign into an empty folder, which becomes a data folder. Videos are
/// not copied. The merged campaign takes its name, policy endpoint, priority and state from the
/// first half, or the name from `name` if it is given.
///
/// # Errors
/// If the campaigns are not halves of one campaign, if they contradict each other, or if a database
/// fails.
pub async fn merge(
    first: &Portable,
    second: &Portable,
    into: &Path,
    name: Option<&CampaignName>,
) -> Result<(Portable, Merged), MergeError> {
    check_same_design(first, second)?;
    let database = first.folder().join(DATABASE_FILE);
    let target = first.copy_target(name)?;
    let whole = copy_into(&database, &first.campaign, &target, into).await?;
    let mut attached = whole.store.attach(&second.folder().join(DATABASE_FILE)).await?;
    let mut tx = attached.write(Vec::new()).await?;
    let halves = (whole.campaign.id, second.campaign.id);
    if let Some((rollout_id, replicate)) = halves::differing_rollout(&mut tx, halves).await? {
        let rollout = JobName { rollout_id, replicate };
        return Err(MergeError::Rollout { rollout });
    }
    let first_records = halves::records(&mut tx, Schema::Main, halves.0).await?;
    let second_records = halves::records(&mut tx, Schema::Source, halves.1).await?;
    let first_results = halves::results(&mut tx, Schema::Main, halves.0).await?;
    let second_results = halves::results(&mut tx, Schema::Source, halves.1).await?;
    check_same_policy(&first_results, &second_results)?;
    let kept = match merge::merge(&first_records, &second_records) {
        Ok(kept) => kept,
        Err(found) => return Err(contradictions(&found, &first_results, &second_results)),
    };
    check_consistency(whole.campaign.mode()?, &first_results, &second_results)?;
    let of_second = kept.iter().filter(|(_, kept)| **kept == KeptHalf::Second);
    let of_second: Vec<Rollout> = of_second.map(|(rollout, _)| rollout.clone()).collect();
    portable::replace(&mut tx, halves, &of_second).await?;
    halves::copy_pin(&mut tx, halves).await?;
    portable::erase_history(&mut tx).await?;
    tx.commit().await?;
    drop(attached);
    whole.store.compact().await?;
    let mut merged = Merged::default();
    for (rollout, in_first) in &first_records {
        let in_second = second_records.get(rollout).copied().unwrap_or_default();
        let standings = [in_first.standing, in_second.standing];
        let is_committed = |standing| matches!(standing, Standing::Committed(_));
        let is_quarantined = standings.contains(&Standing::Quarantined);
        match (is_committed(standings[0]), is_committed(standings[1])) {
            (true, true) => merged.both += 1,
            (true, false) => merged.first += 1,
            (false, true) => merged.second += 1,
            (false, false) if is_quarantined => merged.quarantined += 1,
            (false, false) => merged.open += 1,
        }
    }
    let whole = Portable::from_store(whole.store).await?;
    Ok((whole, merged))
}

/// Checks that neither half is a derived campaign, and that both have one design and, if both are
/// pinned, one pin. Name and endpoint may differ, since each half had its
/// own coordinator.
fn check_same_design(first: &Portable, second: &Portable) -> Result<(), MergeError> {
    for half in [first, second] {
        if source_of(&half.spec)?.is_some() {
            return Err(MergeError::Derived { campaign: half.campaign.name.clone() });
        }
    }
    let design = |half: &Portable| -> Result<String, StoreError> {
        let spec = CampaignSpec::from_json(&half.spec).map_err(undecodable);
        let mut spec = spec.doing("read a campaign's specification")?;
        spec.name.clear();
        spec.policy.endpoint.clear();
        let text = serde_json::to_string(&spec).map_err(undecodable);
        text.doing("write a campaign's specification")
    };
    let differs = differing_fields(&design(first)?, &design(second)?);
    if !differs.is_empty() {
        return Err(MergeError::Specification {
            first: first.campaign.name.clone(),
            second: second.campaign.name.clone(),
            differs,
        });
    }
    if let (Some(first), Some(second)) = (&first.campaign.pin, &second.campaign.pin)
        && first != second
    {
        return Err(MergeError::Pin { first: first.to_string(), second: second.to_string() });
    }
    Ok(())
}

fn check_same_policy(first: &[Stored], second: &[Stored]) -> Result<(), MergeError> {
    let mut measured = BTreeMap::new();
    for stored in first {
        let suite = stored.manifest_row.id.task().suite();
        measured.entry(suite).or_insert(stored.origin());
    }
    for stored in second {
        let suite = stored.manifest_row.id.task().suite();
        let first_origin = measured.get(&suite);
        let difference = first_origin.and_then(|first| stored.origin().policy_difference(first));
        if let Some(difference) = difference {
            return Err(MergeError::Policy { suite, difference });
        }
    }
    Ok(())
}

/// Checks that every result of the second half is consistent with those of the first.
fn check_consistency(
    realisation: libero_ctrl::Realisation,
    first: &[Stored],
    second: &[Stored],
) -> Result<(), MergeError> {
    let mut states: BTreeMap<(&str, i64), Vec<Sibling>> = BTreeMap::new();
    for stored in first {
        let siblings = states.entry((&stored.task, stored.init_id)).or_default();
        let sibling = sibling(stored);
        if !siblings.iter().any(|other| other.stands_for(&sibling)) {
            siblings.push(sibling);
        }
    }
    let mut differing = Vec::new();
    for stored in second {
        let Some(siblings) = states.get(&(stored.task.as_str(), stored.init_id)) else {
            continue;
        };
        let demand = Demand { realisation, row: &stored.manifest_row };
        if let Some(difference) = pairing::difference(&demand, siblings, &sibling(stored)) {
            let name = name(stored);
            differing.push(format!("`{name}` of the second half: its {difference}"));
        }
    }
    match differing.is_empty() {
        true => Ok(()),
        false => Err(contradictions_error(&differing)),
    }
}

fn sibling(stored: &Stored) -> Sibling {
    Sibling {
        rollout: stored.manifest_row.id,
        worker: stored.worker_id.clone(),
        digests: stored.digests.clone(),
        realised: stored.realised.clone(),
        origin: stored.origin().clone(),
    }
}

fn contradictions(
    found: &[Contradiction<Rollout>],
    first: &[Stored],
    second: &[Stored],
) -> MergeError {
    let describe = |half: &[Stored], (id, replicate): &Rollout, outcome: OutcomeKey| {
        let stored =
            half.iter().find(|stored| (&stored.rollout_id, stored.replicate) == (id, *replicate));
        let word = match outcome.success {
            true => "success",
            false => "failure",
        };
        let origin = stored.map_or_else(String::new, |stored| {
            let origin = stored.origin();
            format!(
                " (worker `{}` {} on {}, policy {} {}, fingerprint {})",
                stored.worker_id,
                origin.program_version,
                origin.host,
                origin.policy_name,
                short(&origin.policy_checkpoint_digest),
                short(&origin.fingerprint),
            )
        });
        format!("{word} after {} steps{origin}", outcome.steps)
    };
    let texts = found.iter().map(|contradiction| {
        let rollout = &contradiction.rollout;
        let name = JobName { rollout_id: rollout.0.clone(), replicate: rollout.1 };
        format!(
            "`{name}`: {} in the first, {} in the second",
            describe(first, rollout, contradiction.first),
            describe(second, rollout, contradiction.second)
        )
    });
    contradictions_error(&texts.collect::<Vec<_>>())
}

fn contradictions_error(texts: &[String]) -> MergeError {
    let mut examples = texts[..texts.len().min(MAX_EXAMPLES)].join("\n");
    if texts.len() > MAX_EXAMPLES {
        examples.push_str("\n…");
    }
    MergeError::Contradictions { count: texts.len(), examples }
}

fn name(stored: &Stored) -> JobName {
    JobName { rollout_id: stored.rollout_id.clone(), replicate: stored.replicate }
}

/// Shortens a digest to 12 digits, which suffice to tell two digests apart; returns "unknown" for
/// an empty digest.
fn short(digest: &str) -> &str {
    match crate::ids::shortened(digest, 12) {
        "" => "unknown",
        short => short,
    }
}
