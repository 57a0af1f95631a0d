//! Subject of a report: one policy's outcomes, and everything known about how they were
//! made.

use std::borrow::Cow;
use std::collections::BTreeMap;

use libero_ctrl::{Directions, Explanation, Realisation, RolloutId, Stop, Suite, Thresholds};
use paired::{CampaignLook, Count, Record};
use rollout_types::{Fingerprints, Provenance};
use serde::{Deserialize, Serialize};

/// One policy's outcomes under one set of circumstances.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Subject {
    /// Name of the policy.
    pub policy: String,
    /// Source of its outcomes.
    pub origin: Origin,
    /// Source of the perturbations' random elements, if known.
    pub realisation: Option<Realisation>,
    /// Every rollout that was meant to run, with or without an outcome.
    pub records: Vec<Record>,
    /// The last errors of the quarantined rollouts.
    pub errors: Vec<Quarantined>,
    /// Rollouts that ran twice and came out differently.
    pub divergent: Vec<String>,
    /// Results of another realisation than `realisation`: in no figure, and
    /// missing among the records.
    pub left_out: u64,
    /// The distinct circumstances under which the outcomes were made.
    pub provenances: Vec<Provenance>,
    /// Actions beyond the range that the policy answered, if known.
    #[serde(default)]
    pub beyond: Option<BeyondRange>,
    /// Mix of fingerprints among the outcomes, if they have more than one.
    #[serde(default)]
    pub fingerprints: Option<Fingerprints>,
    /// The published nominal success rate, a fraction.
    pub published_nominal: Option<f64>,
    /// Nominal success rates published of single suites, fractions.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub published_by_suite: Vec<(Suite, f64)>,
    /// Nominal successes as published elsewhere.
    pub reported_nominal: Option<Count>,
    /// Assignment of its directions to configurations.
    #[serde(default)]
    pub directions: Directions,
    /// Digests of the rollouts' circumstances; empty where they are not known.
    #[serde(default)]
    pub setups: Setups,
    /// Purpose, if it follows from another campaign.
    #[serde(default)]
    pub derived: Option<Derived>,
    /// Early stop of its campaign, possible or done; none of one that runs to its end.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub early_stop: Option<EarlyStop>,
}

/// Purpose of a campaign that follows from another one, and that campaign's rollouts.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Derived {
    /// Purpose, with the campaign that it follows from.
    pub purpose: Purpose,
    /// That campaign's rollouts, with or without an outcome; of one that stopped early,
    /// those that count.
    pub records: Vec<Record>,
}

/// Size of a campaign that follows from another, before it is created.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Prospect {
    /// Transitions to explain or thresholds to measure, as far as the outcomes show them.
    pub subjects: u64,
    /// The most rollouts that these take, whatever their outcomes are.
    pub most_rollouts: BTreeMap<Suite, u64>,
}

impl Prospect {
    /// The most rollouts in all.
    pub fn rollouts(&self) -> u64 {
        self.most_rollouts.values().sum()
    }

    /// Spends a budget, each suite its share of it.
    pub(crate) fn bound(&mut self, budget: u64) {
        let all = self.rollouts();
        if all > budget {
            for rollouts in self.most_rollouts.values_mut() {
                *rollouts = *rollouts * budget / all;
            }
        }
    }
}

/// Purpose of campaigns that follow from others.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Purpose {
    /// Find the minimal subsets of axes that change an outcome.
    Explanation(Explanation),
    /// Find the radius at which success turns to failure.
    Thresholds(Thresholds),
}

/// Early stop of a campaign.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct EarlyStop {
    /// The rule, and what its order is drawn from.
    pub stop: Stop,
    /// True if it stopped early.
    pub has_stopped: bool,
}

/// Digests of the circumstances of a subject's rollouts, beyond their names: a rollout of
/// one name can differ between two subjects. Digests can only be compared for equality.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Setups {
    /// Digest of perturbation, instruction and step budget, by rollout.
    pub rollouts: BTreeMap<RolloutId, String>,
    /// Digest of scene and initial state, by the nominal rollout from that state, where
    /// any result tells.
    pub scenes: BTreeMap<RolloutId, String>,
}

/// Actions with a number outside [-1, 1], of all that were executed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct BeyondRange {
    /// Actions beyond the range.
    pub actions: u64,
    /// All actions.
    pub of_actions: u64,
    /// Rollouts with at least one of them.
    pub rollouts: u64,
}

/// Source of outcomes.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Origin {
    /// A campaign of a coordinator.
    Campaign {
        /// Name of the campaign.
        name: String,
        /// Endpoint of its policy.
        endpoint: String,
        /// Version of its design.
        design: String,
    },
    /// A file of result rows.
    File {
        /// The folder's or the file's own name, without what is above it.
        name: String,
        /// SHA-256 of the file.
        digest: String,
        /// Description by its makers; empty where they give none.
        source: String,
    },
}

/// A quarantined rollout and its last error.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Quarantined {
    /// `ID` or `ID#rK`.
    pub rollout: String,
    /// The last error, whole.
    pub last_error: String,
}

/// Name of a rollout of a replicate: `ID` or `ID#rK`.
pub fn rollout_name(rollout_id: &str, replicate: u32) -> String {
    match replicate {
        0 => rollout_id.to_owned(),
        k => format!("{rollout_id}#r{k}"),
    }
}

/// A number of things: `1 rollout`, `2 rollouts`.
pub(crate) fn things(count: u64, thing: &str) -> String {
    match count {
        1 => format!("1 {thing}"),
        count => format!("{count} {thing}s"),
    }
}

/// The records that figures are of: of a campaign that stopped early, those of the
/// configurations that its intervals rest on.
pub fn counted<'a>(records: &'a [Record], early_stop: Option<&EarlyStop>) -> Cow<'a, [Record]> {
    let stopped = early_stop.filter(|it| it.has_stopped);
    let counted = stopped.and_then(|early| CampaignLook::counted_when_met(records, &early.stop));
    counted.map_or(Cow::Borrowed(records), Cow::Owned)
}

impl Subject {
    /// Returns the explanation and the explained campaign's rollouts, if it explains
    /// another campaign.
    pub(crate) fn explains(&self) -> Option<(&Explanation, &[Record])> {
        let Derived { purpose, records } = self.derived.as_ref()?;
        match purpose {
            Purpose::Explanation(explanation) => Some((explanation, records)),
            Purpose::Thresholds(_) => None,
        }
    }

    /// Returns the measurement and the measured campaign's rollouts, if it measures
    /// another campaign's thresholds.
    pub(crate) fn measures(&self) -> Option<(&Thresholds, &[Record])> {
        let Derived { purpose, records } = self.derived.as_ref()?;
        match purpose {
            Purpose::Thresholds(thresholds) => Some((thresholds, records)),
            Purpose::Explanation(_) => None,
        }
    }

    /// Returns true if its campaign stopped early: rollouts without an outcome get none.
    pub fn has_stopped(&self) -> bool {
        let early = self.early_stop.as_ref();
        early.is_some_and(|early| early.has_stopped)
    }

    /// The records that figures are of.
    pub fn counted(&self) -> Cow<'_, [Record]> {
        counted(&self.records, self.early_stop.as_ref())
    }

    /// The campaign's or the file's name.
    pub fn origin_name(&self) -> &str {
        match &self.origin {
            Origin::Campaign { name, .. } | Origin::File { name, .. } => name,
        }
    }
}
