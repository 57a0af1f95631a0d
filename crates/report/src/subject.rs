//! Subject of a report: one policy's outcomes and their provenance.

use std::borrow::Cow;
use std::collections::{BTreeMap, BTreeSet};

use benchmark::attempt::{Fingerprints, Provenance};
use benchmark::{
    Directions, Execution, Explanation, Look, Purpose, Realisation, RolloutId, Stop, Suite,
    Thresholds,
};
use paired::{CampaignLook, Count, Progress, Record};
use serde::{Deserialize, Serialize};

use crate::simulated::SimulatedTask;

/// Outcomes of one policy, with their provenance.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Subject {
    pub policy: String,
    pub origin: Origin,
    /// Source of the perturbations' random elements, if known.
    pub realisation: Option<Realisation>,
    /// Look of outcomes that come without provenances, if known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub look: Option<Look>,
    /// Behaviour of the robot while a response of its policy was pending.
    pub execution: Execution,
    /// Every planned rollout of a campaign, with or without an outcome, or every row of a file.
    pub records: Vec<Record>,
    /// The last errors of the quarantined rollouts.
    pub errors: Vec<Quarantined>,
    /// Rollouts that ran twice with different results.
    pub divergent: Vec<String>,
    /// Number of results with a realisation mode other than `realisation`. They are in no
    /// figure and count as missing in `records`.
    pub left_out: u64,
    /// Distinct provenances of the outcomes: assets, simulator, policy and program.
    pub provenances: Vec<Provenance>,
    /// Counts of the policy's actions outside [-1, 1], if known.
    pub beyond: Option<BeyondRange>,
    /// Fingerprints of the outcomes, if there is more than one.
    pub fingerprints: Option<Fingerprints>,
    /// The published nominal success rate, a fraction.
    pub published_nominal: Option<f64>,
    /// Published nominal success rates of single suites, fractions.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub published_by_suite: Vec<(Suite, f64)>,
    /// Nominal successes reported by another source.
    pub reported_nominal: Option<Count>,
    /// Assignment of perturbation directions to configurations.
    pub directions: Directions,
    /// Radius of the placebo level, if the campaign has such a level and its radius is known.
    pub placebo_radius: Option<f64>,
    /// Progress of the rollouts with an outcome, as far as known.
    pub progress: Vec<Progress>,
    /// Digests of the rollouts' setups; empty if unknown.
    pub setups: Setups,
    /// Purpose and source of the campaign, if it is derived from another.
    pub derived: Option<Derived>,
    /// Protocol of a campaign of LIBERO's family, or `NAME@DIGEST` of a suite file; `None` for any
    /// other campaign.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub protocol: Option<String>,
    /// Early-stop rule of the campaign and its state; `None` if the campaign has no such rule.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub early_stop: Option<EarlyStop>,
    /// Tasks of other simulators, by their index in rollout ids; empty for LIBERO.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub simulated: BTreeMap<u8, SimulatedTask>,
}

impl Subject {
    /// Returns the looks of the outcomes; empty if unknown.
    pub(crate) fn looks(&self) -> BTreeSet<Look> {
        let recorded = self.provenances.iter().map(|provenance| provenance.pin.look);
        recorded.chain(self.look).collect()
    }
}

/// Purpose of a campaign that is derived from another campaign, the *source*, and the rollouts
/// of the source.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Derived {
    /// Purpose; it names the source.
    pub purpose: Purpose,
    /// Rollouts of the source, with or without an outcome; if the source stopped early, only the
    /// rollouts from which its figures are computed.
    pub records: Vec<Record>,
}

/// Size of a derived campaign, before it is created.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Prospect {
    /// Number of transitions to explain or of thresholds to measure, from the outcomes so far.
    pub sought: u64,
    /// Upper bound of the number of rollouts, by suite.
    pub most_rollouts: BTreeMap<Suite, u64>,
}

impl Prospect {
    /// Returns the upper bound over all suites.
    pub fn rollouts(&self) -> u64 {
        self.most_rollouts.values().sum()
    }

    /// Caps the rollouts at a budget, shared among the suites in proportion.
    pub(crate) fn bound(&mut self, budget: u64) {
        let all = self.rollouts();
        if all > budget {
            for rollouts in self.most_rollouts.values_mut() {
                *rollouts = *rollouts * budget / all;
            }
        }
    }
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct EarlyStop {
    /// The rule, with the seed and strata of the drawn order.
    pub stop: Stop,
    pub has_stopped: bool,
}

/// Digests of the setups of a subject's rollouts. Rollouts with the same id can differ between
/// two subjects. Digests can only be compared for equality.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Setups {
    /// Digest of perturbation, instruction and step budget, by rollout.
    pub rollouts: BTreeMap<RolloutId, String>,
    /// Digest of scene and initial state, by the nominal rollout from that state, for states
    /// with at least one result.
    pub scenes: BTreeMap<RolloutId, String>,
}

/// Counts of executed actions with a component outside [-1, 1].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct BeyondRange {
    pub actions: u64,
    pub of_actions: u64,
    /// Rollouts with at least one action beyond the range.
    pub rollouts: u64,
}

/// Source of outcomes.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Origin {
    Campaign {
        name: String,
        endpoint: String,
        design: String,
    },
    /// A file of result rows.
    File {
        /// Name of the folder or file, without its parent folders.
        name: String,
        /// SHA-256 of the file.
        digest: String,
        /// Description by the authors of the results; may be empty.
        source: String,
    },
}

/// A quarantined rollout and its last error.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Quarantined {
    /// `ID` or `ID#rK`.
    pub rollout: String,
    pub last_error: String,
}

/// Name of a rollout of a replicate: `ID` or `ID#rK`.
pub fn rollout_name(rollout_id: &str, replicate: u32) -> String {
    match replicate {
        0 => rollout_id.to_owned(),
        k => format!("{rollout_id}#r{k}"),
    }
}

pub(crate) use terminal::counted as pluralise;

/// Returns the form of a verb that agrees with a count: `has` for 1, else `have`.
pub(crate) fn agree(count: u64, singular: &'static str, plural: &'static str) -> &'static str {
    match count {
        1 => singular,
        _ => plural,
    }
}

/// Returns the records from which the figures are computed: all of them or, if the campaign
/// stopped early, those of the configurations from which its intervals are computed.
pub fn counted<'a>(records: &'a [Record], early_stop: Option<&EarlyStop>) -> Cow<'a, [Record]> {
    let stopped = early_stop.filter(|stop| stop.has_stopped);
    let counted = stopped.and_then(|early| CampaignLook::counted_when_met(records, &early.stop));
    counted.map_or(Cow::Borrowed(records), Cow::Owned)
}

impl Subject {
    /// Returns the explanation and the explained campaign's rollouts; `None` if this campaign
    /// explains no other.
    pub(crate) fn explains(&self) -> Option<(&Explanation, &[Record])> {
        let Derived { purpose, records } = self.derived.as_ref()?;
        match purpose {
            Purpose::Explanation(explanation) => Some((explanation, records)),
            Purpose::Thresholds(_) => None,
        }
    }

    /// Returns the settings of the measurement and the measured campaign's rollouts; `None` if
    /// this campaign measures no thresholds.
    pub(crate) fn measures(&self) -> Option<(&Thresholds, &[Record])> {
        let Derived { purpose, records } = self.derived.as_ref()?;
        match purpose {
            Purpose::Thresholds(thresholds) => Some((thresholds, records)),
            Purpose::Explanation(_) => None,
        }
    }

    /// Returns true if the campaign stopped early, so that no further rollout will run.
    pub fn has_stopped(&self) -> bool {
        let early = self.early_stop.as_ref();
        early.is_some_and(|early| early.has_stopped)
    }

    /// Returns the records from which the figures are computed; see [`counted`].
    pub fn counted(&self) -> Cow<'_, [Record]> {
        counted(&self.records, self.early_stop.as_ref())
    }

    /// Returns the name of the campaign or file.
    pub fn origin_name(&self) -> &str {
        match &self.origin {
            Origin::Campaign { name, .. } | Origin::File { name, .. } => name,
        }
    }
}
