//! Selects the subsets of one configuration to run next.
//!
//! A decision is a function of what is known of the configuration, of nothing
//! else. So it may be made at any time and as often as one likes: what was asked
//! for is known as pending, and is not asked for again.

use std::collections::BTreeSet;

use libero_ctrl::AxisSet;
use serde::{Deserialize, Serialize};

use crate::evidence::Verdict;
use crate::explain::{MinimalSubset, Search, transition};
use crate::known::Known;
use crate::order::{maximal, minimal};

/// Strategy of the search for minimal subsets. Each strategy runs in batches; a batch is chosen
/// when all outcomes of the one before are known.
///
/// All three name only subsets that were seen to flip the outcome. They differ in
/// which they can miss:
///
/// | | minimal pairs | larger minimal subsets |
/// | --- | --- | --- |
/// | [`Adaptive`](Self::Adaptive) | all, established | all, if outcomes are monotone |
/// | [`TopDown`](Self::TopDown) | all, if outcomes are monotone | all, if outcomes are monotone |
/// | [`Exhaustive`](Self::Exhaustive) | all, established | all, established |
///
/// Outcomes are *monotone* if every superset of a subset that flips the outcome
/// flips it too. What `Adaptive` and `TopDown` name with at most three axes is
/// established whether or not outcomes are monotone; of a larger subset at least
/// those were run that lack one of its axes. What they can miss is a subset that
/// flips the outcome and has a superset that does not: of rules in which a triple
/// fails unless a fourth axis is present, and another pair or triple fails always,
/// both recover every minimal subset in half of the cases (the example `planted`
/// measures cost and recovery of all strategies). Quarantine and undecided replicates
/// leave gaps in all of this, which [`MinimalSubset::open`] shows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Strategy {
    /// All pairs, then like `TopDown`.
    #[default]
    Adaptive,
    /// The fewest rollouts. A subset is *settled* if it contains one that flips
    /// the outcome or is contained in one that does not: if outcomes are monotone,
    /// its own is clear. Of the subsets that are not settled, either the smallest
    /// are run or the largest, whichever are fewer.
    ///
    /// The search begins with all axes but one, six times. If outcomes are
    /// monotone and there is one minimal subset, it consists of the axes without
    /// which the outcome does not flip, and is run next. Once all is settled, the
    /// minimal subsets that were found are verified.
    ///
    /// Sources: A. Zeller and R. Hildebrandt, Simplifying and isolating
    /// failure-inducing input, IEEE Transactions on Software Engineering 28 (2002),
    /// 183–200 (leaving out one part at a time); D. Gunopulos, R. Khardon, H.
    /// Mannila, S. Saluja, H. Toivonen and R. S. Sharma, Discovering all most
    /// specific sentences, ACM Transactions on Database Systems 28 (2003), 140–174
    /// (the two borders that settle a monotone function).
    TopDown,
    /// The whole lattice above every start, at once.
    Exhaustive,
}

impl Strategy {
    /// All strategies.
    pub const ALL: [Self; 3] = [Self::Adaptive, Self::TopDown, Self::Exhaustive];

    /// Name in tables: `adaptive`, `top-down`, `exhaustive`.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Adaptive => "adaptive",
            Self::TopDown => "top-down",
            Self::Exhaustive => "exhaustive",
        }
    }
}

/// Rollouts of one subset.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Request {
    /// The axes to perturb.
    pub set: AxisSet,
    /// Number of replicates beyond those that were asked for.
    pub rollouts: u32,
}

/// Next step for a configuration.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Decision {
    /// Run this batch; it is not empty.
    Run(Vec<Request>),
    /// Wait for rollouts that were asked for.
    Wait,
    /// There is no transition to be explained, or nothing more to be run.
    Done,
}

/// Decides what to run for one configuration.
///
/// With replicates ([`Evidence::Repeated`](crate::Evidence::Repeated)), a
/// configuration is pursued as long as the majorities of its rollouts form a
/// transition. First the subsets that were run get as many replicates as decide
/// them, then further subsets are run.
pub fn next(known: &Known, strategy: Strategy) -> Decision {
    let asked = || known.tallies().map(|(set, _)| set);
    if asked().any(|set| known.verdict(set) == Verdict::Pending) {
        return Decision::Wait;
    }
    if transition(known, |set| known.tally(set).majority()).is_err() {
        return Decision::Done;
    }
    let short = asked().filter(|set| !set.is_empty());
    let short = short.filter_map(|set| match known.verdict(set) {
        Verdict::Short { more } => Some(Request {
            set,
            rollouts: more,
        }),
        _ => None,
    });
    let replicates: Vec<Request> = short.collect();
    if !replicates.is_empty() {
        return Decision::Run(replicates);
    }
    let Ok(transition) = transition(known, |set| known.verdict(set).success()) else {
        return Decision::Done;
    };
    let searches = Search::of(known, transition);
    let wanted = searches
        .iter()
        .flat_map(|search| wanted(search, known, strategy));
    let wanted: BTreeSet<AxisSet> = wanted.collect();
    match wanted.is_empty() {
        true => Decision::Done,
        false => Decision::Run(wanted.into_iter().map(|set| first(known, set)).collect()),
    }
}

fn first(known: &Known, set: AxisSet) -> Request {
    Request {
        set,
        rollouts: known.evidence().first(),
    }
}

/// Chooses a batch from the subsets that were not run; an empty one if it has
/// nothing left to do.
type Step = fn(&Search, &[AxisSet]) -> Vec<AxisSet>;

/// The next batch of one search: that of the first step with something to do.
fn wanted(search: &Search, known: &Known, strategy: Strategy) -> Vec<AxisSet> {
    let open = search.open.iter().copied();
    let not_run: Vec<AxisSet> = open
        .filter(|set| known.verdict(*set) == Verdict::NotRun)
        .collect();
    let steps: &[Step] = match strategy {
        Strategy::Adaptive => &[pairs, border, verification],
        Strategy::TopDown => &[border, verification],
        Strategy::Exhaustive => &[|_, not_run| not_run.to_vec()],
    };
    let batches = steps.iter().map(|step| step(search, &not_run));
    batches
        .into_iter()
        .find(|batch| !batch.is_empty())
        .unwrap_or_default()
}

fn pairs(_: &Search, not_run: &[AxisSet]) -> Vec<AxisSet> {
    not_run
        .iter()
        .copied()
        .filter(|set| set.len() == 2)
        .collect()
}

/// The smallest or the largest of the subsets that are not settled.
fn border(search: &Search, not_run: &[AxisSet]) -> Vec<AxisSet> {
    let is_settled = |set: &AxisSet| {
        search
            .flipping
            .iter()
            .any(|flipping| flipping.is_subset(*set))
            || search
                .unflipped
                .iter()
                .any(|unflipped| set.is_subset(*unflipped))
    };
    let unsettled = not_run.iter().copied().filter(|set| !is_settled(set));
    let unsettled: Vec<AxisSet> = unsettled.collect();
    let (smallest, largest) = (minimal(&unsettled), maximal(&unsettled));
    match smallest.len() < largest.len() {
        true => smallest,
        false => largest,
    }
}

/// Axes up to which all subsets of a minimal subset are run.
const VERIFIED_AXES: usize = 3;

/// The subsets that have to be run to verify the minimal subsets found: all of
/// a small one, those that lack one axis of a large one.
fn verification(search: &Search, not_run: &[AxisSet]) -> Vec<AxisSet> {
    let of_one = |MinimalSubset { set, open, .. }: MinimalSubset| {
        let small = set.len() <= VERIFIED_AXES;
        let needed = move |open: &AxisSet| small || open.len() + 1 == set.len();
        open.into_iter().filter(needed)
    };
    let needed: Vec<AxisSet> = search.minimal().into_iter().flat_map(of_one).collect();
    not_run
        .iter()
        .copied()
        .filter(|set| needed.contains(set))
        .collect()
}
