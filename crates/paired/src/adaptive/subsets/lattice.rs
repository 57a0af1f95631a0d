//! Outcomes of one configuration under subsets of the axes.

use crate::{DuplicateRecord, Matched, Outcome};
use benchmark::{Axis, AxisSet};

use super::evidence::{Evidence, Looks, Role, Verdict};
use crate::adaptive::outcomes::{Outcomes, Tally};

/// The rollouts of one configuration at one level, by the subset of axes that
/// they perturb. The empty set is the nominal rollout, the full set the
/// simultaneous one.
///
/// For a deterministic policy all rollouts are evidence. With repeats, the outcomes of the
/// explained campaign select the configuration and are not evidence for its transition.
#[derive(Clone, Debug, PartialEq)]
pub struct Lattice {
    full: AxisSet,
    evidence: Evidence,
    outcomes: Outcomes<AxisSet>,
}

/// Reason why the configurations of a campaign cannot be explained.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum LatticeError {
    #[error("explain axes {0}: an interaction needs at least two axes")]
    TooFewAxes(AxisSet),
    #[error("explain axes {full}: {set} is not a subset of them")]
    OtherAxes { set: AxisSet, full: AxisSet },
    #[error("explain {}: replicate {} is recorded twice; keep one record", .0.id, .0.replicate)]
    Duplicate(DuplicateRecord),
    #[error(
        "explain with {repeats} repeats: too few to decide about subsets of {axes} axes with an \
         overall error of 5 %; allow {fewest} or more"
    )]
    TooFewRepeats {
        /// Number of the campaign's axes.
        axes: usize,
        /// Largest number of replicates of a subset.
        repeats: u32,
        /// Fewest replicates with which each subset can be decided.
        fewest: u32,
    },
}

impl Lattice {
    /// Creates a configuration's lattice, without outcomes, in a campaign with the axes `full`.
    pub fn new(full: AxisSet, evidence: Evidence) -> Result<Self, LatticeError> {
        match full.len() < 2 {
            true => Err(LatticeError::TooFewAxes(full)),
            false => Ok(Self { full, evidence, outcomes: Outcomes::default() }),
        }
    }

    /// Adds the outcomes of one replicate of the explained campaign: under each axis alone, under
    /// all axes, and nominally. A missing nominal rollout is skipped, because no decision waits for
    /// it.
    pub fn add_replicate(&mut self, matched: &Matched) -> Result<(), LatticeError> {
        for (axis, outcome) in matched.combined() {
            self.record_source(AxisSet::of(axis), outcome)?;
        }
        self.record_source(self.full, matched.simultaneous)?;
        match matched.nominal {
            Outcome::Missing => Ok(()),
            nominal => self.record_source(AxisSet::EMPTY, nominal),
        }
    }

    /// Adds one rollout of the explained campaign. For a deterministic policy its outcome is
    /// evidence; with repeats the outcome only selects the configuration.
    pub fn record_source(&mut self, set: AxisSet, outcome: Outcome) -> Result<(), LatticeError> {
        self.check(set)?;
        self.outcomes.record_source(set, outcome);
        Ok(())
    }

    /// Adds one rollout as evidence, with [`Outcome::Missing`] if it was requested and has no
    /// result.
    pub fn record(&mut self, set: AxisSet, outcome: Outcome) -> Result<(), LatticeError> {
        self.check(set)?;
        self.outcomes.record(set, outcome);
        Ok(())
    }

    fn check(&self, set: AxisSet) -> Result<(), LatticeError> {
        let full = self.full;
        if set.is_subset(full) { Ok(()) } else { Err(LatticeError::OtherAxes { set, full }) }
    }

    /// Returns all axes of the campaign.
    pub const fn full(&self) -> AxisSet {
        self.full
    }

    pub const fn evidence(&self) -> Evidence {
        self.evidence
    }

    pub const fn outcomes(&self) -> &Outcomes<AxisSet> {
        &self.outcomes
    }

    pub fn tally(&self, set: AxisSet) -> Tally {
        match self.evidence {
            Evidence::Once => self.outcomes.both(set),
            Evidence::Repeated(_) => self.outcomes.requests(set),
        }
    }

    /// Returns the tally of the outcomes by which the configuration was selected.
    pub fn selecting(&self, set: AxisSet) -> Tally {
        match self.evidence {
            Evidence::Once => self.outcomes.both(set),
            Evidence::Repeated(_) => self.outcomes.source(set),
        }
    }

    /// Returns the verdict of the evidence under a subset. With repeats, the nominal rollout,
    /// which is never repeated, counts by the majority of the selecting outcomes.
    pub fn verdict(&self, set: AxisSet) -> Verdict {
        if set.is_empty() && self.evidence != Evidence::Once {
            let nominal = self.selecting(set);
            return match nominal.majority() {
                Some(true) => Verdict::Success,
                Some(false) => Verdict::Failure,
                None if nominal.requested() == 0 => Verdict::NotRun,
                None => Verdict::Undecided,
            };
        }
        self.evidence.verdict(&self.tally(set), self.role(set))
    }

    /// Returns the success under a subset according to the outcomes that selected the
    /// configuration; `None` if they are missing, quarantined or tied.
    pub(crate) fn selected(&self, set: AxisSet) -> Option<bool> {
        match self.evidence {
            Evidence::Once => self.verdict(set).success(),
            Evidence::Repeated(_) => self.selecting(set).majority(),
        }
    }

    /// Returns true if a requested rollout, or one by which the configuration may be selected,
    /// has no result yet. Nothing waits for nominal rollouts.
    pub(crate) fn is_waiting(&self) -> bool {
        let mut sets = self.sets().filter(|set| !set.is_empty());
        sets.any(|set| {
            self.verdict(set) == Verdict::Pending
                || self.evidence != Evidence::Once && self.selecting(set).pending > 0
        })
    }

    /// Returns the looks at the rollouts under a subset; `None` if one result decides.
    pub(crate) fn looks(&self, set: AxisSet) -> Option<Looks> {
        match self.evidence {
            Evidence::Once => None,
            Evidence::Repeated(repeats) => Some(repeats.looks(self.role(set))),
        }
    }

    pub(crate) fn role(&self, set: AxisSet) -> Role {
        if self.is_of_campaign(set) { Role::Transition } else { Role::further(self.full.len()) }
    }

    /// Returns the subsets with evidence or a requested rollout and their tallies, in order.
    pub fn tallies(&self) -> impl Iterator<Item = (AxisSet, Tally)> {
        let tallies = self.sets().map(|set| (set, self.tally(set)));
        tallies.filter(|(_, tally)| tally.requested() > 0)
    }

    /// Returns the subsets with a requested rollout in either campaign, in order.
    pub(crate) fn sets(&self) -> impl Iterator<Item = AxisSet> {
        self.outcomes.points()
    }

    /// Returns each axis of the campaign alone.
    pub(crate) fn singles(&self) -> impl Iterator<Item = AxisSet> + use<> {
        self.full.axes().map(AxisSet::of as fn(Axis) -> AxisSet)
    }

    /// Returns true if an ordinary campaign runs this subset: no axis, one axis, or all axes.
    pub(crate) fn is_of_campaign(&self, set: AxisSet) -> bool {
        set.len() < 2 || set == self.full
    }

    /// Returns the number of requested rollouts under subsets that an ordinary campaign does
    /// not run.
    pub fn further_rollouts(&self) -> u32 {
        let further = self.tallies().filter(|(set, _)| !self.is_of_campaign(*set));
        further.map(|(_, tally)| tally.requested()).sum()
    }
}
