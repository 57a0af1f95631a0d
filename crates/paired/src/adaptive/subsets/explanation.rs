//! Explains a transition by the minimal subsets of axes that cause it.
//!
//! # Terms
//! An *emergent failure* is a configuration in which every axis alone succeeds
//! and all axes together fail. Its explanation is the axes needed to make it
//! fail. The search *starts* from the nominal rollout, the empty set, and a subset
//! *flips* the outcome if it fails.
//!
//! A *compensated success* is a configuration in which some axis alone fails and all axes
//! together succeed. Its explanation is, for each axis that fails alone, the
//! further axes needed to make it succeed. The search starts from the failing axis
//! and considers the subsets that contain it; a subset flips the outcome if it
//! succeeds.
//!
//! A *minimal* subset flips the outcome, while none of its proper subsets that
//! were run and contain the start does. Every one of its axes is therefore needed,
//! as far as the outcomes show. It is *established* if every proper subset that contains
//! the start has a verdict; [`MinimalSubset::open`] lists those without. Outcomes are never
//! inferred.
//!
//! Outcomes need not be monotone: camera and robot may fail while camera, robot and
//! sensor succeed. Such a pair of subsets is reported as [`NonMonotone`].

use crate::Transition;
use benchmark::AxisSet;
use serde::{Deserialize, Serialize};

use super::evidence::Verdict;
use super::lattice::Lattice;
use super::order::{between, maximal, minimal};

/// One transition, explained as far as its rollouts allow.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Explanation {
    pub transition: Transition,
    /// One answer for an emergent failure; for a compensated success, one for each axis
    /// that fails alone.
    pub answers: Vec<Answer>,
}

/// Minimal subsets found from one start.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Answer {
    /// The set from which the search starts: empty for an emergent failure, the
    /// failing axis for a compensated success.
    pub start: AxisSet,
    /// The minimal subsets that flip the outcome, in order. There is at least
    /// one, because the full set flips it.
    pub minimal: Vec<MinimalSubset>,
    /// For each minimal subset, its smallest supersets that do not flip the
    /// outcome.
    pub non_monotone: Vec<NonMonotone>,
    /// The largest subsets that do not flip the outcome: all of their proper supersets that
    /// were run flip it. Subsets with most axes come first.
    pub largest_unflipped: Vec<AxisSet>,
}

/// A subset that flips the outcome, while none of its proper subsets that were
/// run and contain the start does.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct MinimalSubset {
    /// The axes, including those of the start.
    pub set: AxisSet,
    /// Subsets strictly between the start and `set` that have no verdict; any of them might flip
    /// the outcome.
    pub open: Vec<AxisSet>,
    /// Largest proper subsets of `set` that were run and do not flip the outcome, or the
    /// start if there are none. Comparison with them shows the contribution of each axis.
    pub below: Vec<AxisSet>,
}

impl MinimalSubset {
    /// Returns true if the subset is certainly minimal, because all subsets strictly between the
    /// start and `set` have a verdict.
    pub const fn is_established(&self) -> bool {
        self.open.is_empty()
    }
}

/// A subset that flips the outcome and one of its supersets that does not.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct NonMonotone {
    /// The minimal subset that flips the outcome.
    pub minimal: AxisSet,
    /// The superset that does not flip the outcome.
    pub superset: AxisSet,
}

/// Reason why there is nothing to explain.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Unexplained {
    #[error("the rollout of an axis alone or the simultaneous one has no outcome")]
    Incomplete,
    #[error("simultaneous perturbation changes nothing: the rollout {}", .0.name())]
    Unchanged(Transition),
    #[error("the nominal rollout fails already")]
    NominalFails,
    #[error("the repeats have not confirmed the transition yet")]
    AwaitsRepeats,
    #[error("the repeats do not confirm the transition")]
    NotConfirmed,
}

/// Finds the minimal subsets that explain a configuration's transition.
pub fn explain(lattice: &Lattice) -> Result<Explanation, Unexplained> {
    let transition = selected(lattice)?;
    confirm(lattice)?;
    let searches = Search::for_transition(lattice, transition);
    let answers = searches.iter().map(|search| search.answer()).collect();
    Ok(Explanation { transition, answers })
}

/// Returns the transition that the outcomes of the explained campaign form. With repeats, this
/// transition only selects the configuration for a test: see [`Repeats`](super::Repeats). The
/// nominal rollout counts by the majority of its replicates, because no further replicate of it is
/// ever run.
pub fn selected(lattice: &Lattice) -> Result<Transition, Unexplained> {
    let mut conjunction = true;
    for single in lattice.singles() {
        conjunction &= lattice.selected(single).ok_or(Unexplained::Incomplete)?;
    }
    let simultaneous = lattice.selected(lattice.full()).ok_or(Unexplained::Incomplete)?;
    let nominal = lattice.selecting(AxisSet::EMPTY).majority();
    match Transition::between(conjunction, simultaneous) {
        Transition::Emergent if nominal == Some(false) => Err(Unexplained::NominalFails),
        transition @ (Transition::Emergent | Transition::Compensated) => Ok(transition),
        transition => Err(Unexplained::Unchanged(transition)),
    }
}

/// Checks that the verdicts of each axis alone and of all axes together equal the selecting
/// outcomes. Without repeats, a decided verdict always equals the selecting outcome, since both are
/// of the same rollout.
pub(crate) fn confirm(lattice: &Lattice) -> Result<(), Unexplained> {
    let mut is_waiting = false;
    for set in lattice.singles().chain([lattice.full()]) {
        let (selected, verdict) = (lattice.selected(set), lattice.verdict(set));
        let agrees = |success: Option<bool>| success.is_some() && success == selected;
        let tally = lattice.tally(set);
        match verdict {
            _ if agrees(verdict.success()) => {}
            Verdict::NotRun | Verdict::Pending => is_waiting = true,
            Verdict::Short { .. } if tally.count().n == 0 || agrees(tally.majority()) => {
                is_waiting = true;
            }
            _ => return Err(Unexplained::NotConfirmed),
        }
    }
    if is_waiting { Err(Unexplained::AwaitsRepeats) } else { Ok(()) }
}

/// The subsets between one start and the full set, grouped by verdict.
#[derive(Debug)]
pub(crate) struct Search {
    start: AxisSet,
    /// Subsets that flip the outcome, the full set among them.
    pub(crate) flipping: Vec<AxisSet>,
    /// Subsets that were run and do not flip the outcome, without the start.
    pub(crate) unflipped: Vec<AxisSet>,
    /// Subsets without a verdict.
    pub(crate) open: Vec<AxisSet>,
}

impl Search {
    pub(crate) fn for_transition(lattice: &Lattice, transition: Transition) -> Vec<Self> {
        let fails = |single: &AxisSet| lattice.verdict(*single).success() == Some(false);
        match transition {
            Transition::Compensated => {
                let failing = lattice.singles().filter(fails);
                failing.map(|start| Self::new(lattice, start, true)).collect()
            }
            _ => vec![Self::new(lattice, AxisSet::EMPTY, false)],
        }
    }

    fn new(lattice: &Lattice, start: AxisSet, flips_to: bool) -> Self {
        let mut search =
            Self { start, flipping: Vec::new(), unflipped: Vec::new(), open: Vec::new() };
        let full = lattice.full();
        for set in between(start, full).into_iter().chain([full]) {
            let group = match lattice.verdict(set).success() {
                Some(success) if success == flips_to => &mut search.flipping,
                Some(_) => &mut search.unflipped,
                None => &mut search.open,
            };
            group.push(set);
        }
        search
    }

    pub(crate) fn minimal(&self) -> Vec<MinimalSubset> {
        let open_below = |set: AxisSet| {
            let open = self.open.iter().copied();
            open.filter(|open| open.is_subset(set)).collect()
        };
        let largest_below = |set: AxisSet| {
            let unflipped = self.unflipped.iter().copied();
            let below: Vec<AxisSet> =
                unflipped.filter(|subset| subset.is_proper_subset(set)).collect();
            if below.is_empty() { vec![self.start] } else { maximal(&below) }
        };
        let minimal = minimal(&self.flipping).into_iter();
        minimal
            .map(|set| MinimalSubset { set, open: open_below(set), below: largest_below(set) })
            .collect()
    }

    fn answer(&self) -> Answer {
        let minimal_subsets = self.minimal();
        let supersets = |minimal: AxisSet| {
            let unflipped = self.unflipped.iter().copied();
            let above: Vec<AxisSet> = unflipped.filter(|set| minimal.is_subset(*set)).collect();
            let smallest = super::order::minimal(&above).into_iter();
            smallest.map(move |superset| NonMonotone { minimal, superset })
        };
        let mut largest = maximal(&self.unflipped);
        if self.unflipped.is_empty() {
            largest.push(self.start);
        }
        largest.sort_by_key(|set| (std::cmp::Reverse(set.len()), *set));
        Answer {
            start: self.start,
            non_monotone: minimal_subsets
                .iter()
                .flat_map(|minimal| supersets(minimal.set))
                .collect(),
            minimal: minimal_subsets,
            largest_unflipped: largest,
        }
    }
}
