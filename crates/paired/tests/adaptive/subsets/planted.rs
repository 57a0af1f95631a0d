//! Configurations whose outcomes follow a planted rule, so that the findings of a search can be
//! compared with the truth. The example `planted` includes this file, too.

use std::collections::BTreeMap;

use benchmark::{Axis, AxisSet};
use paired::Outcome;
use paired::adaptive::Decision;
use paired::adaptive::subsets::{Evidence, Explanation, Lattice, Request, Strategy, explain, next};
use rand_chacha::ChaCha12Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Kind {
    Pair,
    /// A triple fails, and none of its pairs does.
    Triple,
    /// Two pairs without a common axis fail.
    DisjointPairs,
    /// A pair fails, and so does a triple that does not contain the pair.
    PairOrTriple,
    /// An axis fails alone unless one of its one or two compensating axes is present.
    Compensation,
    /// Two axes fail alone, each unless one of its one or two compensating axes is present. The two
    /// failing axes together fail unless both are compensated.
    TwoCompensations,
    /// A pair fails unless a third axis is present; another pair or triple always fails.
    MaskedPair,
    /// A triple fails unless a fourth axis is present; another pair or triple always fails.
    MaskedTriple,
    /// Every outcome is a coin flip, except nominally, under single axes and under all axes
    /// together.
    CoinFlips,
}

impl Kind {
    /// The kinds whose outcomes are monotone.
    pub(crate) const MONOTONE: [Self; 5] =
        [Self::Pair, Self::Triple, Self::DisjointPairs, Self::PairOrTriple, Self::Compensation];

    /// The kinds whose outcomes are not monotone.
    pub(crate) const NON_MONOTONE: [Self; 4] =
        [Self::TwoCompensations, Self::MaskedPair, Self::MaskedTriple, Self::CoinFlips];

    /// The monotone kinds and [`Self::MaskedPair`].
    pub(crate) const MIXTURE: [Self; 6] = [
        Self::Pair,
        Self::Triple,
        Self::DisjointPairs,
        Self::PairOrTriple,
        Self::Compensation,
        Self::MaskedPair,
    ];
}

/// Success, true or false, under each of the 64 subsets.
#[derive(Clone, Debug)]
pub(crate) struct Rule(BTreeMap<AxisSet, bool>);

impl Rule {
    pub(crate) fn draw(kind: Kind, rng: &mut ChaCha12Rng) -> Self {
        loop {
            let axes = shuffled(rng);
            let set = |axes: &[Axis]| axes.iter().copied().collect::<AxisSet>();
            let fails = |culprits: &[AxisSet]| {
                Self::from_success(|perturbed| {
                    !culprits.iter().any(|culprit| culprit.is_subset(perturbed))
                })
            };
            // A pair or triple that always fails; it may have axes in common with the masked set.
            let unmasked = set(&shuffled(rng)[..2 + random_below(2, rng)]);
            let masked = |culprit: AxisSet, mask: AxisSet| {
                Self::from_success(|perturbed| {
                    let is_harmless = !culprit.is_subset(perturbed) || mask.is_subset(perturbed);
                    is_harmless && !unmasked.is_subset(perturbed)
                })
            };
            let rule = match kind {
                Kind::Pair => fails(&[set(&axes[..2])]),
                Kind::Triple => fails(&[set(&axes[..3])]),
                Kind::DisjointPairs => fails(&[set(&axes[..2]), set(&axes[2..4])]),
                Kind::PairOrTriple => fails(&[set(&axes[..2]), set(&shuffled(rng)[..3])]),
                Kind::Compensation | Kind::TwoCompensations => {
                    let failing = if kind == Kind::Compensation { 1 } else { 2 };
                    let helpers: Vec<AxisSet> = (0..failing)
                        .map(|i| set(&axes[2 + 2 * i..3 + 2 * i + random_below(2, rng)]))
                        .collect();
                    Self::from_success(|perturbed| {
                        let mut pairs = axes.iter().zip(&helpers);
                        pairs.all(|(&axis, helpers)| {
                            !perturbed.contains(axis)
                                || helpers.axes().any(|axis| perturbed.contains(axis))
                        })
                    })
                }
                Kind::MaskedPair => masked(set(&axes[..2]), set(&axes[2..3])),
                Kind::MaskedTriple => masked(set(&axes[..3]), set(&axes[3..4])),
                Kind::CoinFlips => {
                    let mut coins = BTreeMap::new();
                    for perturbed in AxisSet::ALL.subsets() {
                        let coin = random_below(2, rng) == 0;
                        coins.insert(
                            perturbed,
                            (perturbed.len() < 2 || coin) && perturbed != AxisSet::ALL,
                        );
                    }
                    Self(coins)
                }
            };
            // A planted set that contains another planted set is not minimal: draws again until
            // both sets of the rule are minimal.
            let sizes: Vec<usize> =
                rule.truth().iter().flat_map(|(_, sets)| sets).map(|set| set.len()).collect();
            let are_minimal = match kind {
                Kind::PairOrTriple => sizes == [2, 3],
                Kind::MaskedPair => sizes.len() == 2,
                Kind::MaskedTriple => sizes.len() == 2 && sizes.contains(&3),
                _ => true,
            };
            if are_minimal {
                return rule;
            }
        }
    }

    fn from_success(success: impl Fn(AxisSet) -> bool) -> Self {
        let subsets = AxisSet::ALL.subsets().into_iter();
        Self(subsets.map(|set| (set, success(set))).collect())
    }

    /// Returns true if a subset succeeds.
    pub(crate) fn succeeds(&self, set: AxisSet) -> bool {
        self.0[&set]
    }

    /// Returns the minimal subsets from each start, computed from all 64 outcomes.
    pub(crate) fn truth(&self) -> Vec<(AxisSet, Vec<AxisSet>)> {
        let simultaneous = self.succeeds(AxisSet::ALL);
        let singles = Axis::ALL.map(AxisSet::of);
        let starts = match simultaneous {
            true => singles.into_iter().filter(|single| !self.succeeds(*single)).collect(),
            false => vec![AxisSet::EMPTY],
        };
        let of_start = |start: AxisSet| {
            let mut minimal: Vec<AxisSet> = Vec::new();
            for (&set, &success) in &self.0 {
                let flips = start.is_proper_subset(set) && success == simultaneous;
                if flips && !minimal.iter().any(|smaller| smaller.is_subset(set)) {
                    minimal.push(set);
                }
            }
            (start, minimal)
        };
        starts.into_iter().map(of_start).collect()
    }
}

#[derive(Debug)]
pub(crate) struct SearchResult {
    /// Number of subsets that were run beyond those of a campaign.
    pub(crate) subsets: usize,
    pub(crate) rollouts: u32,
    pub(crate) batches: usize,
    /// The explanation, if there is one.
    pub(crate) explanation: Option<Explanation>,
}

impl SearchResult {
    /// Returns true if exactly the planted minimal subsets were found.
    pub(crate) fn is_exact(&self, rule: &Rule) -> bool {
        let answers = self.explanation.iter().flat_map(|explanation| &explanation.answers);
        let by_start = answers.map(|answer| {
            let minimal = answer.minimal.iter().map(|minimal| minimal.set);
            (answer.start, minimal.collect::<Vec<_>>())
        });
        by_start.collect::<Vec<_>>() == rule.truth()
    }
}

/// Runs a search to its end. `outcome` returns the outcome of one rollout under a subset.
pub(crate) fn search(
    strategy: Strategy,
    evidence: Evidence,
    mut outcome: impl FnMut(AxisSet) -> Outcome,
) -> SearchResult {
    let mut lattice = source(AxisSet::ALL, evidence, &mut outcome);
    let batches = run(&mut lattice, strategy, outcome);
    let further = lattice.tallies().filter(|(set, _)| !is_of_source(*set, AxisSet::ALL));
    SearchResult {
        subsets: further.count(),
        rollouts: lattice.outcomes().requested(),
        batches,
        explanation: explain(&lattice).ok(),
    }
}

/// Returns true if `set` has no axis, one axis or all of the axes `full`: every campaign with these
/// axes, as the source of a search, runs these subsets.
pub(crate) fn is_of_source(set: AxisSet, full: AxisSet) -> bool {
    set.len() < 2 || set == full
}

/// Returns a configuration's lattice with the outcomes of the subsets that every campaign runs.
pub(crate) fn source(
    full: AxisSet,
    evidence: Evidence,
    mut outcome: impl FnMut(AxisSet) -> Outcome,
) -> Lattice {
    let mut lattice = Lattice::new(full, evidence).expect("two axes at least");
    for set in full.subsets() {
        if is_of_source(set, full) {
            lattice.record_source(set, outcome(set)).expect("a subset");
        }
    }
    lattice
}

/// Runs the requested rollouts until none is left. Returns the number of batches.
pub(crate) fn run(
    lattice: &mut Lattice,
    strategy: Strategy,
    mut outcome: impl FnMut(AxisSet) -> Outcome,
) -> usize {
    let mut batches = 0;
    while let Decision::Run(batch) = next(lattice, strategy) {
        batches += 1;
        for Request { set, rollouts } in batch {
            for _ in 0..rollouts {
                lattice.record(set, outcome(set)).expect("a subset");
            }
        }
    }
    batches
}

pub(crate) fn search_rule(rule: &Rule, strategy: Strategy) -> SearchResult {
    search(strategy, Evidence::Once, |set| Outcome::from(rule.succeeds(set)))
}

/// Runs a search over a rule that each rollout contradicts with probability `noise`.
pub(crate) fn search_noisy(
    rule: &Rule,
    strategy: Strategy,
    evidence: Evidence,
    noise: f64,
    rng: &mut ChaCha12Rng,
) -> SearchResult {
    search(strategy, evidence, |set| {
        let opposite = (rng.next_u32() as f64) < noise * 2_f64.powi(32);
        Outcome::from(rule.succeeds(set) != opposite)
    })
}

pub(crate) fn seeded(seed: u64) -> ChaCha12Rng {
    ChaCha12Rng::seed_from_u64(seed)
}

fn random_below(bound: usize, rng: &mut ChaCha12Rng) -> usize {
    ((u64::from(rng.next_u32()) * bound as u64) >> 32) as usize
}

fn shuffled(rng: &mut ChaCha12Rng) -> [Axis; 6] {
    let mut axes = Axis::ALL;
    for i in (1..axes.len()).rev() {
        axes.swap(i, random_below(i + 1, rng));
    }
    axes
}
