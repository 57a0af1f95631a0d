//! Random order in which a campaign runs its units.

use std::collections::BTreeMap;

use benchmark::TaskRef;
use rand_chacha::ChaCha12Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

/// A configuration: its task and its number.
pub type Unit = (TaskRef, u16);

/// Units of a population, such as configurations, in the order in which they run: in rounds,
/// each with one unit of every stratum that has units left.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Order<U> {
    rounds: Vec<Vec<Drawn<U>>>,
    sizes: Vec<usize>,
}

/// A unit of an [`Order`].
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Drawn<U> {
    /// Index of the unit's stratum.
    pub stratum: usize,
    pub unit: U,
}

impl<U: Ord> Order<U> {
    /// Draws an order. Within a stratum and within a round, every order is equally likely.
    /// The order depends on the seed and the set of units only; duplicates and the sequence
    /// of `units` do not matter.
    ///
    /// `stratum` returns the stratum of a unit: the task for a stratified
    /// order, a constant for simple random sampling.
    ///
    /// The seed must be recorded with the campaign and chosen before any outcome is known.
    pub fn new<S: Ord>(
        seed: u64,
        units: impl IntoIterator<Item = U>,
        stratum: impl Fn(&U) -> S,
    ) -> Self {
        let mut strata: BTreeMap<S, Vec<U>> = BTreeMap::new();
        for unit in units {
            strata.entry(stratum(&unit)).or_default().push(unit);
        }
        let mut rng = ChaCha12Rng::seed_from_u64(seed);
        let mut sizes = Vec::with_capacity(strata.len());
        let mut rounds: Vec<Vec<Drawn<U>>> = Vec::new();
        for (stratum, mut units) in strata.into_values().enumerate() {
            units.sort();
            units.dedup();
            shuffle(&mut rng, &mut units);
            sizes.push(units.len());
            rounds.resize_with(rounds.len().max(units.len()), Vec::new);
            for (round, unit) in rounds.iter_mut().zip(units) {
                round.push(Drawn { stratum, unit });
            }
        }
        for round in &mut rounds {
            shuffle(&mut rng, round);
        }
        Self { rounds, sizes }
    }

    pub fn rounds(&self) -> &[Vec<Drawn<U>>] {
        &self.rounds
    }

    pub fn units(&self) -> impl Iterator<Item = &U> {
        self.rounds.iter().flatten().map(|drawn| &drawn.unit)
    }

    pub(crate) fn sizes(&self) -> &[usize] {
        &self.sizes
    }
}

/// Shuffles items; every order is equally likely. Source: R. Durstenfeld, Algorithm
/// 235, Communications of the ACM 7 (1964), 420.
fn shuffle<T>(rng: &mut impl Rng, items: &mut [T]) {
    for last in (1..items.len()).rev() {
        items.swap(last, random_below(rng, last as u64 + 1) as usize);
    }
}

/// Draws a uniform integer in 0..n. Source: D. Lemire, Fast random integer generation
/// in an interval, ACM Transactions on Modeling and Computer Simulation 29 (2019).
fn random_below(rng: &mut impl Rng, n: u64) -> u64 {
    // Rejects draws whose lower half is below this threshold; they would bias some integers.
    let surplus = n.wrapping_neg() % n;
    loop {
        let product = u128::from(rng.next_u64()) * u128::from(n);
        if product as u64 >= surplus {
            return (product >> 64) as u64;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    type Unit = (u8, u16);

    fn order_of_sizes(seed: u64, sizes: &[u16]) -> Order<Unit> {
        let units = sizes.iter().enumerate();
        let units = units.flat_map(|(task, &size)| (0..size).map(move |i| (task as u8, i)));
        Order::new(seed, units, |&(task, _)| task)
    }

    proptest! {
        #[test]
        fn a_round_has_one_unit_of_every_stratum_with_units_left(
            seed: u64, sizes in proptest::collection::vec(1_u16..6, 1..6),
        ) {
            let order = order_of_sizes(seed, &sizes);
            for (round, drawn) in order.rounds().iter().enumerate() {
                let mut strata: Vec<usize> = drawn.iter().map(|drawn| drawn.stratum).collect();
                strata.sort_unstable();
                let remaining = (0..sizes.len()).filter(|&task| usize::from(sizes[task]) > round);
                prop_assert_eq!(strata, remaining.collect::<Vec<_>>());
            }
            let mut units: Vec<Unit> = order.units().copied().collect();
            units.sort_unstable();
            units.dedup();
            prop_assert_eq!(units.len(), usize::from(sizes.iter().sum::<u16>()));
        }

        #[test]
        fn the_drawn_order_does_not_depend_on_the_sequence_of_the_input(seed: u64) {
            let units = [(0_u8, 0_u16), (0, 1), (1, 0), (1, 1), (2, 0)];
            let order = Order::new(seed, units, |&(task, _)| task);
            let twice_and_reversed = units.into_iter().rev().chain(units);
            prop_assert_eq!(Order::new(seed, twice_and_reversed, |&(task, _)| task), order);
        }
    }

    /// Returns the statistic of Pearson's test of whether all of the `cells` possible orders are
    /// equally likely.
    fn chi_squared(counts: &BTreeMap<Vec<Unit>, u32>, cells: usize) -> f64 {
        let total: u32 = counts.values().sum();
        let expected = f64::from(total) / cells as f64;
        let unseen = (cells - counts.len()) as f64 * expected;
        let seen = counts.values();
        seen.map(|&n| (f64::from(n) - expected).powi(2) / expected).sum::<f64>() + unseen
    }

    #[test]
    fn every_order_is_equally_likely() {
        let mut counts: BTreeMap<Vec<Unit>, u32> = BTreeMap::new();
        for seed in 0..23_040 {
            let order = order_of_sizes(seed, &[3, 2]);
            *counts.entry(order.units().copied().collect()).or_default() += 1;
        }
        // 3!·2! orders within strata, 2!·2! within the two rounds of two.
        assert_eq!(counts.len(), 48);
        // 47 degrees of freedom: exceeded with a probability of 10⁻⁶.
        let statistic = chi_squared(&counts, 48);
        assert!(statistic < 109.0, "{statistic}");
    }

    #[test]
    fn the_order_of_a_seed_never_changes() {
        let order = order_of_sizes(7, &[3, 2]);
        let units: Vec<Unit> = order.units().copied().collect();
        assert_eq!(units, [(0, 1), (1, 1), (1, 0), (0, 2), (0, 0)]);
    }
}
