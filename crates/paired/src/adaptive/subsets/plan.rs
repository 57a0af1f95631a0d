//! Planning: spends a budget of rollouts on many configurations.

use std::collections::BTreeMap;

use benchmark::RolloutId;

use super::lattice::Lattice;
use super::next::{Request, Strategy, next};
use crate::adaptive::decision::Decision;
use crate::adaptive::source::rank;

/// Settings for explaining a random sample of transitions within a budget.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sample {
    /// Total number of rollouts to spend beyond those of the explained campaign.
    pub budget: u32,
    /// Seed of the random order in which configurations are started.
    pub seed: u64,
    pub strategy: Strategy,
}

/// Decides which subsets to run next for all configurations, each identified by its
/// simultaneous rollout.
///
/// Configurations are started in a random order that depends on the seed and
/// their ids alone. A configuration is started only if the budget covers its whole
/// lattice in addition to the largest possible cost of the configurations in progress, so that
/// every started configuration can be finished. When no configuration is in progress and the budget
/// no longer covers a whole lattice, one configuration at a time is started nevertheless, and the
/// last may remain unfinished.
///
/// Spending is counted from the requested rollouts: pass every configuration of the sample each
/// time, including explained ones.
pub fn plan<'a>(
    configurations: &'a BTreeMap<RolloutId, Lattice>,
    sample: &Sample,
) -> Vec<(&'a RolloutId, Vec<Request>)> {
    let mut spent = 0;
    let candidate = |(name, lattice): (&'a RolloutId, &'a Lattice)| {
        let requested = lattice.outcomes().requested();
        spent += requested;
        (requested == 0, rank(name, sample.seed), name, lattice)
    };
    let mut candidates: Vec<_> = configurations.iter().map(candidate).collect();
    // Configurations in progress come first; a new one starts only if it can be
    // finished, or if it is the first.
    candidates.sort_by_key(|&(is_new, rank, name, _)| (is_new, rank, name));
    let mut budget_left = sample.budget.saturating_sub(spent);
    let mut is_first = true;
    let mut batches = Vec::new();
    for (is_new, _, name, lattice) in candidates {
        let batch = match next(lattice, sample.strategy) {
            Decision::Run(batch) => batch,
            Decision::Wait if !is_new => Vec::new(),
            Decision::Wait | Decision::Done => continue,
        };
        let reserve = lattice.most_further_rollouts();
        if reserve > budget_left && !is_first {
            break;
        }
        let batch = truncated(budget_left, batch);
        if !batch.is_empty() {
            batches.push((name, batch));
        }
        budget_left = budget_left.saturating_sub(reserve);
        is_first = false;
    }
    batches
}

fn truncated(mut budget: u32, batch: Vec<Request>) -> Vec<Request> {
    let cut = |request: Request| {
        let rollouts = request.rollouts.min(budget);
        budget -= rollouts;
        (rollouts > 0).then_some(Request { rollouts, ..request })
    };
    batch.into_iter().map_while(cut).collect()
}

impl Lattice {
    pub fn most_further_rollouts(&self) -> u32 {
        let sets = self.full().subsets().into_iter().filter(|set| !set.is_empty());
        sets.map(|set| self.evidence().remaining(&self.tally(set), self.role(set))).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Outcome;
    use benchmark::{AxisSet, Condition, Level, TaskRef};

    use crate::adaptive::subsets::evidence::Evidence;

    /// Returns configurations with the outcomes of an ordinary campaign, of which only the full set
    /// fails. Every other set with camera and lighting would fail as well.
    fn transitions(count: usize) -> BTreeMap<RolloutId, Lattice> {
        let id = |task| RolloutId::perturbed(task, Condition::Simultaneous, Level::L2, 3);
        let ids = TaskRef::all().map(|task| id(task).expect("a perturbed level"));
        let lattice_of = |id| {
            let mut lattice = Lattice::new(AxisSet::ALL, Evidence::Once).expect("six axes");
            let campaign = lattice.singles().chain([AxisSet::EMPTY, AxisSet::ALL]);
            for set in campaign.collect::<Vec<_>>() {
                let result = lattice.record_source(set, outcome(set));
                result.expect("a subset");
            }
            (id, lattice)
        };
        ids.take(count).map(lattice_of).collect()
    }

    fn outcome(set: AxisSet) -> Outcome {
        let pair: AxisSet = "camera+lighting".parse().expect("a set");
        Outcome::from(!pair.is_subset(set))
    }

    fn sample(budget: u32, seed: u64) -> Sample {
        Sample { budget, seed, strategy: Strategy::Adaptive }
    }

    /// Runs planned batches until none is left, and returns the largest number of
    /// configurations in progress at once.
    fn spend(lattices: &mut BTreeMap<RolloutId, Lattice>, sample: &Sample) -> usize {
        let mut widest = 0;
        loop {
            let batches: Vec<_> =
                plan(lattices, sample).into_iter().map(|(name, batch)| (*name, batch)).collect();
            if batches.is_empty() {
                return widest;
            }
            widest = widest.max(batches.len());
            for (name, batch) in batches {
                let lattice = lattices.get_mut(&name).expect("a planned configuration");
                for Request { set, rollouts } in batch {
                    for _ in 0..rollouts {
                        lattice.record(set, outcome(set)).expect("a subset");
                    }
                }
            }
        }
    }

    fn finished(lattices: &BTreeMap<RolloutId, Lattice>) -> Vec<RolloutId> {
        let done = |lattice: &Lattice| next(lattice, Strategy::Adaptive) == Decision::Done;
        let done = lattices.iter().filter(|(_, lattice)| done(lattice));
        done.map(|(name, _)| *name).collect()
    }

    #[test]
    fn started_configurations_are_finished_within_the_budget() {
        // One explanation takes 17 rollouts: 15 pairs, and the two largest subsets that do not
        // contain the failing pair.
        for budget in [0, 1, 16, 17, 40, 100, 300, 1000] {
            let mut lattices = transitions(30);
            let widest = spend(&mut lattices, &sample(budget, 7));
            let spent: u32 = lattices.values().map(Lattice::further_rollouts).sum();
            assert_eq!(spent, budget.min(30 * 17));
            let expected = (budget / 17).min(30) as usize;
            assert_eq!(finished(&lattices).len(), expected, "budget {budget}");
            assert!(budget < 300 || widest >= 5, "configurations run concurrently");
        }
    }

    #[test]
    fn a_larger_budget_and_further_configurations_keep_started_configurations() {
        let mut small = transitions(30);
        spend(&mut small, &sample(170, 7));
        let mut large = transitions(30);
        spend(&mut large, &sample(340, 7));
        let (small_done, large_done) = (finished(&small), finished(&large));
        assert!(small_done.iter().all(|name| large_done.contains(name)));
        for (name, lattice) in transitions(40) {
            small.entry(name).or_insert(lattice);
        }
        spend(&mut small, &sample(340, 7));
        let extended = finished(&small);
        assert_eq!(extended.len(), 20);
        assert!(small_done.iter().all(|name| extended.contains(name)));
    }

    #[test]
    fn configurations_in_progress_are_finished_before_new_ones_start() {
        for seed in 0..10 {
            let sample = sample(60, seed);
            let mut lattices = transitions(1);
            let (name, batch) = plan(&lattices, &sample).remove(0);
            let name = *name;
            for Request { set, .. } in batch {
                let lattice = lattices.get_mut(&name).expect("a planned configuration");
                lattice.record(set, outcome(set)).expect("a subset");
            }
            for (later, lattice) in transitions(30) {
                lattices.entry(later).or_insert(lattice);
            }
            let planned = plan(&lattices, &sample);
            assert_eq!(planned.len(), 1, "45 rollouts are left, and 41 reserved");
            assert_eq!(planned[0].0, &name, "seed {seed}");
        }
    }

    #[test]
    fn another_seed_picks_other_configurations() {
        let picked = |seed| {
            let mut lattices = transitions(30);
            spend(&mut lattices, &sample(170, seed));
            finished(&lattices)
        };
        assert_eq!(picked(1), picked(1));
        assert_ne!(picked(1), picked(2));
    }

    #[test]
    fn pending_rollouts_reserve_the_budget() {
        let mut lattices = transitions(30);
        let sample = sample(120, 7);
        let first: Vec<_> =
            plan(&lattices, &sample).into_iter().map(|(name, batch)| (*name, batch)).collect();
        for (name, batch) in &first {
            for request in batch {
                let lattice = lattices.get_mut(name).expect("a planned configuration");
                lattice.record(request.set, Outcome::Missing).expect("a subset");
            }
        }
        assert_eq!(first.len(), 2, "of 120 rollouts, 56 are reserved for each");
        assert_eq!(plan(&lattices, &sample), []);
    }
}
