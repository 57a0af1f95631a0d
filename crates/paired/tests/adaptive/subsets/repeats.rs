//! Error rate of repeats for policies whose outcomes are coin flips: at most 5 % of lattices lead
//! to any false claim, although a lattice has 63 non-empty subsets and was selected by its
//! outcomes.

use benchmark::AxisSet;
use paired::Outcome;
use paired::adaptive::subsets::{Evidence, Lattice, Repeats, Strategy, explain, selected};
use rand_chacha::ChaCha12Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

use super::planted::{run, source};

const LATTICES: usize = 1000;

/// Success probability under a subset of the axes.
type Coins = fn(AxisSet) -> f64;

fn toss(p: f64, rng: &mut ChaCha12Rng) -> Outcome {
    Outcome::from(f64::from(rng.next_u32()) < p * 2_f64.powi(32))
}

fn select(coins: Coins, rng: &mut ChaCha12Rng) -> Lattice {
    let evidence = Evidence::Repeated(Repeats::default());
    loop {
        let lattice = source(AxisSet::ALL, evidence, |set| toss(coins(set), rng));
        if selected(&lattice).is_ok() {
            return lattice;
        }
    }
}

fn search(coins: Coins, strategy: Strategy, rng: &mut ChaCha12Rng) -> Lattice {
    let mut lattice = select(coins, rng);
    run(&mut lattice, strategy, |set| toss(coins(set), rng));
    lattice
}

/// Returns the numbers of claims and of false claims about a lattice. Every claim about a fair coin
/// is false.
fn claims(coins: Coins, lattice: &Lattice) -> [usize; 2] {
    if explain(lattice).is_err() {
        return [0, 0];
    }
    let sets = AxisSet::ALL.subsets().into_iter().filter(|set| !set.is_empty());
    let mut claims = [0, 0];
    for set in sets {
        if let Some(success) = lattice.verdict(set).success() {
            let p = coins(set);
            let is_true = if success { p > 0.5 } else { p < 0.5 };
            claims[0] += 1;
            claims[1] += usize::from(!is_true);
        }
    }
    claims
}

/// Returns the number of lattices with a claim, and the number of lattices with a false claim.
fn lattices_with_claims(coins: Coins, strategy: Strategy, seed: u64) -> [usize; 2] {
    let mut rng = ChaCha12Rng::seed_from_u64(seed);
    let mut counts = [0, 0];
    for _ in 0..LATTICES {
        let lattice = search(coins, strategy, &mut rng);
        for (count, claims) in counts.iter_mut().zip(claims(coins, &lattice)) {
            *count += usize::from(claims > 0);
        }
    }
    counts
}

#[test]
fn at_most_five_percent_of_lattices_of_coin_flips_lead_to_a_false_claim() {
    let cases: [(&str, Coins); 5] = [
        ("fair coins", |_| 0.5),
        ("coins of 95 %", |_| 0.95),
        ("a fair coin under all axes", |set| if set == AxisSet::ALL { 0.5 } else { 1.0 }),
        ("a fair coin under one axis", |set| {
            if set == "camera".parse().expect("a set") { 0.5 } else { 1.0 }
        }),
        ("a fair coin under every further subset", |set| match set.len() {
            6 => 0.0,
            0 | 1 => 1.0,
            _ => 0.5,
        }),
    ];
    for (name, coins) in cases {
        for strategy in [Strategy::Adaptive, Strategy::Exhaustive] {
            let [_, wrong] = lattices_with_claims(coins, strategy, 3);
            println!("{name}, {strategy:?}: {wrong} of {LATTICES}");
            assert!(wrong * 20 <= LATTICES, "{name} {strategy:?}: {wrong} of {LATTICES}");
        }
    }
}

/// The bound on false claims must not be met by claiming nothing.
#[test]
fn a_real_transition_is_claimed_with_its_minimal_pair() {
    let coins: Coins = |set| {
        let pair: AxisSet = "camera+robot".parse().expect("a set");
        if pair.is_subset(set) { 0.05 } else { 0.95 }
    };
    let mut rng = ChaCha12Rng::seed_from_u64(4);
    let is_claimed = |_: &usize| {
        let lattice = search(coins, Strategy::Adaptive, &mut rng);
        let answers =
            explain(&lattice).map_or_else(|_| Vec::new(), |explanation| explanation.answers);
        let minimal = answers.iter().flat_map(|answer| &answer.minimal);
        minimal.map(|minimal| minimal.set.name()).eq(["camera+robot"])
    };
    let count = (0..200).filter(is_claimed).count();
    // Fewer than 200, because some transitions form by chance and are not confirmed by the repeats.
    assert!(count >= 170, "{count} of 200");
}
