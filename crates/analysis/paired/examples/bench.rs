//! Benchmark of the statistics of a whole evaluation: six policies with 10,400
//! random outcomes each, all intervals. Run by `cargo xtask bench report`.

use std::num::NonZero;
use std::thread::available_parallelism;
use std::time::Instant;

use libero_ctrl::{Axis, Condition, INIT_STATES_PER_TASK, Level, RolloutId, TaskRef};
use paired::{Options, Outcome, Record, report};
use rand_chacha::ChaCha12Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};
use serde_json::json;

const POLICIES: u64 = 6;
/// Configurations of each task, condition and level.
const CONFIGS: u16 = 10;
/// Number of timed repetitions; the median and the extremes are over these.
const REPETITIONS: usize = 9;

/// Returns the ids and initial states of LIBERO-CTRL v0.1.
fn design() -> Vec<(RolloutId, u16)> {
    let mut ids = Vec::new();
    for task in TaskRef::all() {
        ids.extend((0..INIT_STATES_PER_TASK).map(|init| (RolloutId::clean(task, init), init)));
        let singles = Axis::ALL.map(Condition::Single);
        for condition in singles.into_iter().chain([Condition::Combination]) {
            for level in Level::PERTURBED {
                for config in 0..CONFIGS {
                    let id = RolloutId::perturbed(task, condition, level, config);
                    let init_id = task.eval_init_ids()[usize::from(config)];
                    ids.push((id.expect("a perturbed level"), init_id));
                }
            }
        }
    }
    ids
}

fn random_records(seed: u64) -> Vec<Record> {
    let mut rng = ChaCha12Rng::seed_from_u64(seed);
    let mut record = |(id, init_id)| Record {
        id,
        init_id,
        replicate: 0,
        outcome: Outcome::from(!rng.next_u32().is_multiple_of(8)),
    };
    design().into_iter().map(&mut record).collect()
}

fn main() {
    let policies: Vec<Vec<Record>> = (0..POLICIES).map(random_records).collect();
    let options = Options::default();
    let mut secs: Vec<f64> = (0..REPETITIONS)
        .map(|_| {
            let start = Instant::now();
            for records in &policies {
                let report = report(records, &options).expect("no duplicates");
                assert!(report.cells.iter().all(|cell| cell.paired.is_some()));
            }
            start.elapsed().as_secs_f64()
        })
        .collect();
    secs.sort_by(f64::total_cmp);
    let profile = if cfg!(debug_assertions) { "dev" } else { "release" };
    let figures = json!({
        "bench": "report",
        "rollouts": policies.iter().map(Vec::len).sum::<usize>(),
        "policies": POLICIES,
        "resamplings_per_interval": options.bootstrap.replicates,
        "profile": profile,
        "cores": available_parallelism().map_or(1, NonZero::get),
        "repetitions": REPETITIONS,
        "secs_median": secs[REPETITIONS / 2],
        "secs_lowest": secs[0],
        "secs_highest": secs[REPETITIONS - 1],
    });
    println!("{figures:#}");
}
