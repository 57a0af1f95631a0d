//! Replays every call of NumPy's global generator that a reset of the original LIBERO makes, for
//! all evaluation tasks. Skipped, with a message, if the reference data is missing.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufReader;

use benchmark::TaskRef;
use benchmark::numpy::LegacyRng;
use scene::TaskFiles;
use serde::Deserialize;
use sim::Reset;
use sim::mujoco::ObjectKind;

use crate::LOADED_TWICE;
use crate::files::{compile, packs, shared, sources};

const SEED: u32 = 0;

#[derive(Deserialize)]
struct Recorded {
    body_pos_seed0: BTreeMap<String, ([f64; 3], [f64; 4])>,
    /// Function, its arguments as printed by Python, and two ignored values.
    rng_calls_seed0: Vec<(String, String, serde_json::Value, serde_json::Value)>,
}

fn replay(rng: &mut LegacyRng, function: &str, arguments: &str) {
    let first_argument = || -> u32 {
        let digits = arguments.trim_start_matches('(').split(',').next();
        digits.and_then(|digits| digits.parse().ok()).unwrap()
    };
    let keyword_argument = |name: &str| -> f64 {
        let (_, value) = arguments.split_once(&format!("'{name}': ")).unwrap();
        let value = value.trim_start_matches("np.float64(");
        let end = value.find([',', '}', ')']).unwrap();
        value[..end].parse().unwrap()
    };
    match function {
        "randn" => {
            for _ in 0..first_argument() {
                rng.randn();
            }
        }
        "randint" => {
            rng.randint(first_argument());
        }
        "uniform" => {
            rng.uniform(keyword_argument("low"), keyword_argument("high"));
        }
        _ => panic!("the record has a call of the unknown function {function}"),
    }
}

fn check_suite(suite: &str) {
    let Some(folder) = shared("oracle/rng") else {
        return;
    };
    let mut tasks = 0;
    for part in ["rng_part0", "rng_part0b", "rng_part1"] {
        let file = File::open(folder.join(part).with_extension("json")).unwrap();
        let recorded: BTreeMap<String, Recorded> =
            serde_json::from_reader(BufReader::new(file)).unwrap();
        for (task, recorded) in recorded {
            if task.starts_with(suite) {
                check(task.parse().unwrap(), &recorded);
                tasks += 1;
            }
        }
    }
    assert_eq!(tasks, 10);
}

#[test]
fn resets_of_libero_spatial_draw_the_same_numbers_as_the_original() {
    check_suite("libero_spatial/");
}

#[test]
fn resets_of_libero_object_draw_the_same_numbers_as_the_original() {
    check_suite("libero_object/");
}

#[test]
fn resets_of_libero_goal_draw_the_same_numbers_as_the_original() {
    check_suite("libero_goal/");
}

#[test]
fn resets_of_libero_10_draw_the_same_numbers_as_the_original() {
    check_suite("libero_10/");
}

fn check(task: TaskRef, recorded: &Recorded) {
    let calls = &recorded.rng_calls_seed0;
    let mut recorded_rng = LegacyRng::seed(SEED);
    for (function, arguments, ..) in calls {
        replay(&mut recorded_rng, function, arguments);
    }
    let files = TaskFiles::of_task(&sources(), task);
    let text = std::fs::read_to_string(&files.bddl).unwrap();
    let mut environment = compile(&text, &packs()[0]).unwrap();
    let mut rng = LegacyRng::seed(SEED);
    environment.reset(&mut rng, Reset::Hard, LOADED_TWICE).unwrap();
    assert_eq!(rng, recorded_rng, "{task}: the number of draws differs");
    let model = environment.model();
    for (name, (pos, quat)) in &recorded.body_pos_seed0 {
        let body = model.id(ObjectKind::Body, name).unwrap();
        assert_eq!(&model.body_pos()[body * 3..][..3], pos, "{task} {name}");
        assert_eq!(&model.body_quat()[body * 4..][..4], quat, "{task} {name}");
    }
}
