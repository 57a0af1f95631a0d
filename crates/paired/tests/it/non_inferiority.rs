//! The test of non-inferiority decides rightly about simulated policies of known rates.

use std::collections::BTreeMap;

use benchmark::{Condition, Design, RolloutId};
use paired::{NonInferiority, Outcome, Verdict};
use rand_chacha::ChaCha12Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

const MARGIN: f64 = 0.02;

/// A uniform number of [0, 1).
fn uniform(rng: &mut ChaCha12Rng) -> f64 {
    rng.next_u64() as f64 / 2.0_f64.powi(64)
}

/// Plays two policies, of which the second succeeds less often by `loss` in each rollout; the first
/// at rates of 0.94 to 1. Returns the answer and the rollouts that it took.
fn play(ids: &[RolloutId], seed: u64, loss: f64) -> (Verdict, u64) {
    let mut rng = ChaCha12Rng::seed_from_u64(seed);
    let (mut reference, mut outcomes) = (Vec::new(), BTreeMap::new());
    for &id in ids {
        let rate = 0.94 + 0.06 * uniform(&mut rng);
        let old = f64::from(u8::from(uniform(&mut rng) < rate));
        reference.push((id, [old, old]));
        outcomes.insert(id, Outcome::from(uniform(&mut rng) < rate - loss));
    }
    NonInferiority::new(reference, &[Condition::Nominal], seed).verdict(&outcomes, MARGIN)
}

#[test]
fn a_lower_rate_is_found_and_an_equal_one_is_not() {
    let rows = Design::v0_1().expand().expect("rows");
    let ids = rows.iter().map(|row| row.id).filter(|id| id.condition() == Condition::Nominal);
    let ids: Vec<RolloutId> = ids.collect();
    for (loss, runs, right, at_least, others) in [
        (0.06, 100, Verdict::Worse, 95, 0),
        (0.0, 1_000, Verdict::NotWorse, 700, 0),
        // At the margin, wrong answers in either direction are rare.
        (MARGIN, 400, Verdict::Undecided, 380, 20),
    ] {
        let answers: Vec<_> = (0..runs).map(|seed| play(&ids, seed, loss)).collect();
        let count = |verdict| answers.iter().filter(|of| of.0 == verdict).count();
        let mean = answers.iter().map(|of| of.1).sum::<u64>() / runs;
        let counts = [Verdict::NotWorse, Verdict::Undecided, Verdict::Worse].map(count);
        println!("loss {loss}: not worse, undecided, worse {counts:?}, {mean} rollouts");
        assert!(count(right) >= at_least, "{loss}: {counts:?}");
        let is_wrong = |of: &&(Verdict, u64)| ![right, Verdict::Undecided].contains(&of.0);
        let wrong = answers.iter().filter(is_wrong).count();
        assert!(wrong <= others, "{loss}: {counts:?}");
    }
}
