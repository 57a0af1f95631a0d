//! Runs every parser and handler on nearly valid inputs: the seed inputs, and random mutations of
//! them. A fuzzer finds more faults (`fuzz/README.md`), but these tests run everywhere.
//! `ROLLOUT_HOSTILE_SEEDS=1000-1099` repeats the mutations with each of these random seeds.

use std::ops::RangeInclusive;
use std::panic;
use std::sync::Once;
use std::sync::atomic::{AtomicUsize, Ordering};

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};
use tests::untrusted_input::{TARGETS, Target};

/// Number of inputs of a target that opens a database for each input.
const DATABASE_INPUTS: usize = 150;
/// Number of inputs of every other target.
const INPUTS: usize = 2_000;
/// Largest number of changes to one input.
const MAX_CHANGES: usize = 8;
/// Ranges that are removed, doubled or replaced are shorter than this, bytes.
const MAX_RANGE_BYTES: usize = 64;
/// Byte strings that are inserted: limits of number types, and tokens of the formats.
const INSERTIONS: [&[u8]; 16] = [
    b"\x00",
    b"\xff",
    b"\x7f",
    b"\xff\xff\xff\xff",
    b"\xff\xff\xff\xff\xff\xff\xff\xff\xff\x01",
    b"-1",
    b"1e999",
    b"NaN",
    b"18446744073709551616",
    b"null",
    b"[[[[[[[[",
    b"\"",
    b"\n",
    b"../",
    b"\xc3\xa4",
    b"=",
];

#[test]
fn the_seeds_are_accepted() {
    for target in TARGETS {
        for (number, seed) in (target.seeds)().iter().enumerate() {
            assert!((target.run)(seed), "seed {number} of {}", target.name);
        }
    }
}

#[test]
fn mutated_files_do_not_crash_their_parsers() {
    let services = ["rpc", "rpc_policy"];
    let targets = TARGETS.into_iter();
    for target in targets.filter(|target| !services.contains(&target.name)) {
        check_mutations(target, INPUTS);
    }
}

#[test]
fn mutated_messages_do_not_crash_the_coordinator_and_refused_messages_change_nothing() {
    check_mutations(tests::untrusted_input::named("rpc"), DATABASE_INPUTS);
}

#[test]
fn mutated_messages_do_not_crash_the_gateway() {
    check_mutations(tests::untrusted_input::named("rpc_policy"), INPUTS);
}

/// Runs a target on mutated inputs. An input that makes the target fail is stored in a file, which
/// the fuzz target of the same name can run.
fn check_mutations(target: Target, inputs: usize) {
    static PANICS: AtomicUsize = AtomicUsize::new(0);
    static COUNTING: Once = Once::new();
    // A panic in a task normally ends only that task; here it is counted as a failure.
    COUNTING.call_once(|| {
        let default_hook = panic::take_hook();
        panic::set_hook(Box::new(move |panic| {
            PANICS.fetch_add(1, Ordering::SeqCst);
            default_hook(panic);
        }));
    });
    let seeds = (target.seeds)();
    for seed in rng_seeds() {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        for number in 0..inputs {
            let input = mutated(&seeds, &mut rng);
            let survived = panic::catch_unwind(|| (target.run)(&input)).is_ok();
            if survived && PANICS.load(Ordering::SeqCst) == 0 {
                continue;
            }
            let name = format!("{}-{seed}-{number}", target.name);
            let file = std::env::temp_dir().join(&name);
            std::fs::write(&file, &input).expect("written");
            panic!("input {name} makes the target fail; it is stored in {}", file.display());
        }
    }
}

/// Seeds of the generator: the range in `ROLLOUT_HOSTILE_SEEDS`, or a single default.
fn rng_seeds() -> RangeInclusive<u64> {
    let Ok(range) = std::env::var("ROLLOUT_HOSTILE_SEEDS") else {
        return 5..=5;
    };
    let (first, last) = range.split_once('-').expect("FIRST-LAST");
    first.parse().expect("a number")..=last.parse().expect("a number")
}

/// Returns a seed, or two joined seeds, with a few changes.
fn mutated(seeds: &[Vec<u8>], rng: &mut ChaCha8Rng) -> Vec<u8> {
    let mut input = seeds[below(rng, seeds.len())].clone();
    if below(rng, 4) == 0 {
        input.extend(&seeds[below(rng, seeds.len())]);
    }
    for _ in 0..=below(rng, MAX_CHANGES) {
        let at = below(rng, input.len() + 1);
        let end = (at + below(rng, MAX_RANGE_BYTES)).min(input.len());
        match below(rng, 6) {
            0 if at < input.len() => input[at] ^= 1 << below(rng, 8),
            1 if at < input.len() => input[at] = below(rng, 256) as u8,
            2 => drop(input.drain(at..end)),
            3 => {
                let copy = input[at..end].to_vec();
                input.splice(at..at, copy);
            }
            4 => input.truncate(at),
            _ => drop(input.splice(at..end, INSERTIONS[below(rng, INSERTIONS.len())].to_vec())),
        }
    }
    input
}

fn below(rng: &mut ChaCha8Rng, bound: usize) -> usize {
    rng.next_u32() as usize % bound
}
