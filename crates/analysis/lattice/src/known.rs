//! Known outcomes of one configuration's rollouts under subsets of the axes.

use std::collections::BTreeMap;

use libero_ctrl::{Axis, AxisSet};
use paired::{Matched, Outcome};

use crate::evidence::{Evidence, Tally, Verdict};

/// The rollouts of one configuration at one level, by the subset of axes that
/// they perturb. The empty set is the nominal rollout, the full set the
/// simultaneous one.
#[derive(Clone, Debug, PartialEq)]
pub struct Known {
    full: AxisSet,
    evidence: Evidence,
    tallies: BTreeMap<AxisSet, Tally>,
}

/// Error in the axes of a campaign or an outcome.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum KnownError {
    /// The campaign has fewer than two axes.
    #[error("explain axes {0}: two axes at least can act together")]
    TooFewAxes(AxisSet),
    /// The subset has an axis that the campaign lacks.
    #[error("explain axes {full}: {set} is no subset of them")]
    OtherAxes {
        /// The subset.
        set: AxisSet,
        /// The campaign's axes.
        full: AxisSet,
    },
}

impl Known {
    /// Creates an empty record of a configuration in a campaign with the axes `full`.
    ///
    /// # Errors
    /// If there are fewer than two axes.
    pub fn new(full: AxisSet, evidence: Evidence) -> Result<Self, KnownError> {
        match full.len() < 2 {
            true => Err(KnownError::TooFewAxes(full)),
            false => Ok(Self {
                full,
                evidence,
                tallies: BTreeMap::new(),
            }),
        }
    }

    /// Collects the outcomes of a configuration in one replicate: under each axis alone,
    /// under all axes, and nominally. A nominal rollout without an outcome is skipped,
    /// because no decision waits for it.
    ///
    /// # Errors
    /// If there are fewer than two axes.
    pub fn of_campaign(matched: &Matched, evidence: Evidence) -> Result<Self, KnownError> {
        let full: AxisSet = matched.alone.keys().copied().collect();
        let mut known = Self::new(full, evidence)?;
        known.add_replicate(matched)?;
        Ok(known)
    }

    /// Adds another replicate of the same configuration.
    ///
    /// # Errors
    /// If it has other axes.
    pub fn add_replicate(&mut self, matched: &Matched) -> Result<(), KnownError> {
        for (&axis, &outcome) in &matched.alone {
            self.record(AxisSet::of(axis), outcome)?;
        }
        self.record(self.full, matched.simultaneous)?;
        match matched.nominal {
            Outcome::Missing => Ok(()),
            nominal => self.record(AxisSet::EMPTY, nominal),
        }
    }

    /// Adds one rollout, with [`Outcome::Missing`] if it was requested and has no result.
    ///
    /// # Errors
    /// If `set` has an axis that the campaign lacks.
    pub fn record(&mut self, set: AxisSet, outcome: Outcome) -> Result<(), KnownError> {
        let full = self.full;
        if !set.is_subset(full) {
            return Err(KnownError::OtherAxes { set, full });
        }
        self.tallies.entry(set).or_default().add(outcome);
        Ok(())
    }

    /// Returns all axes of the campaign.
    pub const fn full(&self) -> AxisSet {
        self.full
    }

    /// Returns the rule for verdicts.
    pub const fn evidence(&self) -> Evidence {
        self.evidence
    }

    /// Returns the tally of the rollouts under a subset.
    pub fn tally(&self, set: AxisSet) -> Tally {
        self.tallies.get(&set).copied().unwrap_or_default()
    }

    /// Returns the verdict of the rollouts under a subset.
    pub fn verdict(&self, set: AxisSet) -> Verdict {
        self.evidence.verdict(&self.tally(set))
    }

    /// Returns the subsets with a requested rollout and their tallies, in order.
    pub fn tallies(&self) -> impl Iterator<Item = (AxisSet, Tally)> {
        self.tallies.iter().map(|(&set, &tally)| (set, tally))
    }

    /// Returns each axis of the campaign alone.
    pub(crate) fn singles(&self) -> impl Iterator<Item = AxisSet> + use<> {
        self.full.axes().map(AxisSet::of as fn(Axis) -> AxisSet)
    }

    /// Returns true if every campaign runs this subset: no axis, one axis, or all axes.
    pub(crate) fn is_of_campaign(&self, set: AxisSet) -> bool {
        set.len() < 2 || set == self.full
    }

    /// Returns the number of requested rollouts under subsets that an ordinary campaign does
    /// not run.
    pub fn further_rollouts(&self) -> u32 {
        let further = self.tallies().filter(|(set, _)| !self.is_of_campaign(*set));
        further.map(|(_, tally)| tally.asked()).sum()
    }
}
