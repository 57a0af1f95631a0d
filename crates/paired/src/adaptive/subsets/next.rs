//! Selects the subsets of one configuration to run next.

use std::collections::BTreeSet;

use benchmark::AxisSet;

use super::evidence::Verdict;
use super::explanation::{MinimalSubset, Search, Unexplained, confirm, selected};
use super::lattice::Lattice;
use super::order::{maximal, minimal};
use crate::adaptive::decision::Decision;

/// Strategy of the search for minimal subsets. Each strategy runs in batches; a batch is chosen
/// when all outcomes of the previous one are known. Both report only subsets that were observed to
/// flip the outcome. Subsets whose rollouts are quarantined or undecided are listed in
/// [`MinimalSubset::open`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Strategy {
    /// Finds and establishes all minimal pairs, and all larger minimal subsets if outcomes are
    /// *monotone*: every superset of a subset that flips the outcome flips it too. Minimal subsets
    /// of at most three axes are established even if outcomes are not; for a larger one, at least
    /// the subsets that lack one of its axes were run.
    ///
    /// Runs all pairs first. A subset is *settled* if it contains one that flips the outcome or is
    /// contained in one that does not, so that monotone outcomes determine the subset's outcome.
    /// Each further batch runs either the smallest or the largest unsettled subsets, whichever are
    /// fewer. When all subsets are settled, the minimal subsets found are verified. A subset that
    /// flips the outcome and has a superset that does not can be missed: of rules in which a triple
    /// fails unless a fourth axis is present, and another pair or triple always fails, every
    /// minimal subset is recovered in half of the cases (the example `planted`).
    ///
    /// Source: D. Gunopulos, R. Khardon, H. Mannila, S. Saluja, H. Toivonen and R. S. Sharma,
    /// Discovering all most specific sentences, ACM Transactions on Database Systems 28 (2003),
    /// 140–174 (the two borders that settle a monotone function).
    #[default]
    Adaptive,
    /// Runs the whole lattice above every start in one batch.
    Exhaustive,
}

impl Strategy {
    pub const ALL: [Self; 2] = [Self::Adaptive, Self::Exhaustive];
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Request {
    pub set: AxisSet,
    /// Number of replicates beyond those already requested.
    pub rollouts: u32,
}

/// Decides which subsets of one configuration to run, from its outcomes alone.
///
/// With replicates ([`Evidence::Repeated`](super::Evidence::Repeated)), each axis alone and
/// all axes are repeated until they are decided, as long as the majorities of the repeats
/// show the transition for which the configuration was selected. Further subsets are run
/// only once the transition is confirmed.
pub fn next(lattice: &Lattice, strategy: Strategy) -> Decision<Request> {
    if lattice.is_waiting() {
        return Decision::Wait;
    }
    let Ok(transition) = selected(lattice) else {
        return Decision::Done;
    };
    let of_transition = lattice.singles().chain([lattice.full()]);
    match confirm(lattice) {
        Ok(()) => {}
        Err(Unexplained::AwaitsRepeats) => {
            return Decision::Run(undecided_requests(lattice, of_transition));
        }
        Err(_) => return Decision::Done,
    }
    let further = lattice.sets().filter(|set| !lattice.is_of_campaign(*set));
    let replicates = undecided_requests(lattice, further);
    if !replicates.is_empty() {
        return Decision::Run(replicates);
    }
    let searches = Search::for_transition(lattice, transition);
    let sets = searches.iter().flat_map(|search| next_batch(search, lattice, strategy));
    let sets: BTreeSet<AxisSet> = sets.collect();
    Decision::run(sets.into_iter().map(|set| first_request(lattice, set)).collect())
}

fn undecided_requests(lattice: &Lattice, sets: impl Iterator<Item = AxisSet>) -> Vec<Request> {
    let requests = sets.filter_map(|set| match lattice.verdict(set) {
        Verdict::NotRun => Some(first_request(lattice, set)),
        Verdict::Short { more } => Some(Request { set, rollouts: more }),
        _ => None,
    });
    requests.collect()
}

fn first_request(lattice: &Lattice, set: AxisSet) -> Request {
    Request { set, rollouts: lattice.evidence().first_batch(lattice.role(set)) }
}

/// Step of a strategy: chooses a batch from the subsets that were not run; empty if the step
/// is complete.
type Step = fn(&Search, &[AxisSet]) -> Vec<AxisSet>;

/// Returns the next batch of one search: the first non-empty batch of the strategy's steps.
fn next_batch(search: &Search, lattice: &Lattice, strategy: Strategy) -> Vec<AxisSet> {
    let open = search.open.iter().copied();
    let not_run: Vec<AxisSet> =
        open.filter(|set| lattice.verdict(*set) == Verdict::NotRun).collect();
    let steps: &[Step] = match strategy {
        Strategy::Adaptive => &[pairs, border, verification],
        Strategy::Exhaustive => &[|_, not_run| not_run.to_vec()],
    };
    let batches = steps.iter().map(|step| step(search, &not_run));
    batches.into_iter().find(|batch| !batch.is_empty()).unwrap_or_default()
}

fn pairs(_: &Search, not_run: &[AxisSet]) -> Vec<AxisSet> {
    not_run.iter().copied().filter(|set| set.len() == 2).collect()
}

/// Returns the smallest or the largest unsettled subsets, whichever are fewer.
fn border(search: &Search, not_run: &[AxisSet]) -> Vec<AxisSet> {
    let is_settled = |set: &AxisSet| {
        search.flipping.iter().any(|flipping| flipping.is_subset(*set))
            || search.unflipped.iter().any(|unflipped| set.is_subset(*unflipped))
    };
    let unsettled = not_run.iter().copied().filter(|set| !is_settled(set));
    let unsettled: Vec<AxisSet> = unsettled.collect();
    let (smallest, largest) = (minimal(&unsettled), maximal(&unsettled));
    if smallest.len() < largest.len() { smallest } else { largest }
}

/// Largest size of a minimal subset that is verified by running all of its subsets.
const VERIFIED_AXES: usize = 3;

/// Returns the subsets that verify the minimal subsets found: all subsets of a small one, and
/// those that lack one axis of a large one.
fn verification(search: &Search, not_run: &[AxisSet]) -> Vec<AxisSet> {
    let needed_for = |MinimalSubset { set, open, .. }: MinimalSubset| {
        let is_small = set.len() <= VERIFIED_AXES;
        let needed = move |open: &AxisSet| is_small || open.len() + 1 == set.len();
        open.into_iter().filter(needed)
    };
    let needed: Vec<AxisSet> = search.minimal().into_iter().flat_map(needed_for).collect();
    not_run.iter().copied().filter(|set| needed.contains(set)).collect()
}
