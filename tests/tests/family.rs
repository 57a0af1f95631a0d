//! Compares variants of LIBERO-Plus with states that its own code reached, as recorded by
//! `family/record.py`.

use std::collections::BTreeMap;
use std::sync::Arc;

use libero_ctrl::numpy::LegacyRng;
use libero_ctrl::{RolloutId, row_of};
use libero_family::corruption::Corruption;
use libero_family::plus::{Variant, start_posture};
use libero_family::pro::ProSuite;
use libero_family::protocol::Benchmark;
use scene::{AssetPack, Sources, TaskFiles};
use sim::{Conditions, Environment, ObjectKind, ReadyScene, Reset, Start, VariantStart};
use tests::files::{libero, sources};

const RECORDED: &str = include_str!("family/states.txt");
/// Largest difference of any coordinate.
const TOLERANCE: f64 = 1e-9;
/// Seed of the recordings.
const SEED: u32 = 7;

/// Returns the recorded numbers of each variant, by kind.
fn recorded() -> BTreeMap<Variant, BTreeMap<&'static str, Vec<f64>>> {
    let mut recorded: BTreeMap<_, BTreeMap<_, _>> = BTreeMap::new();
    for line in RECORDED.lines() {
        let mut fields = line.split(' ');
        let (_, name) = fields.next().unwrap().split_once('/').unwrap();
        let kind = fields.next().unwrap();
        if kind == "noise" {
            continue;
        }
        let numbers = fields.map(|field| field.parse().unwrap()).collect();
        let variant = name.parse().unwrap();
        recorded.entry(variant).or_default().insert(kind, numbers);
    }
    recorded
}

fn difference(found: &[f64], expected: &[f64]) -> f64 {
    assert_eq!(found.len(), expected.len());
    let pairs = found.iter().zip(expected);
    pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
}

#[test]
fn states_and_cameras_after_resets_and_waits_equal_the_originals() {
    let test = "states_and_cameras_after_resets_and_waits_equal_the_originals";
    let sources = sources();
    let Some(pack) = libero(&sources, test) else {
        return;
    };
    let mut largest = BTreeMap::new();
    for (variant, recorded) in recorded() {
        let files = TaskFiles::of_variant(&sources, &variant);
        if !(files.bddl.is_file() && files.init.is_file()) {
            let folder = Sources::family(sources.dir(), Benchmark::Plus);
            println!(
                "skipped {test}: {variant}: no task files at {}",
                folder.display()
            );
            continue;
        }
        pack.provide_with_bar(std::slice::from_ref(&files)).unwrap();
        let ready = ReadyScene::compile(files, &pack, &sources).unwrap();
        let mut environment = Environment::of(Arc::clone(ready.compiled())).unwrap();
        let begin = |environment: &mut Environment, start, waits| {
            let mut row = row_of(RolloutId::clean(variant.task, 0)).unwrap();
            row.settle_steps = waits;
            let start = VariantStart {
                view: Some(variant.view()),
                posture: variant.robot().and_then(start_posture),
                seed: SEED,
                earlier_resets: 0,
                start,
                corruption: None,
            };
            let conditions = Conditions::begin_variant(&ready, environment, &row, &start).unwrap();
            conditions.settle(environment).unwrap();
        };
        begin(&mut environment, Start::Reset, 0);
        let mut check = |kind: &'static str, found: &[f64]| {
            let difference = difference(found, &recorded[kind]);
            println!("{variant} {kind}: {difference:e}");
            let largest = largest.entry(kind).or_insert((0.0, variant));
            if difference >= largest.0 {
                *largest = (difference, variant);
            }
        };
        check("reset", &environment.state());
        let model = environment.model();
        let camera = model.id(ObjectKind::Camera, "agentview").unwrap();
        let pose = [
            &model.cam_pos()[camera * 3..][..3],
            &model.cam_quat()[camera * 4..][..4],
        ];
        check("camera", &pose.concat());
        let mut rng = LegacyRng::seed(SEED);
        environment.reset(&mut rng, Reset::Hard, 2).unwrap();
        check("draw", &[rng.random_sample()]);
        begin(&mut environment, Start::Reset, 15);
        check("reset-only", &environment.state());
        begin(&mut environment, Start::InitialState, 10);
        check("official", &environment.state());
    }
    for (kind, (difference, variant)) in largest {
        assert!(
            difference <= TOLERANCE,
            "{kind} of {variant} differs by {difference:e}"
        );
    }
}

/// The generator draws for the picture of the reset and for every later picture, even if it is not
/// rendered.
#[test]
fn corruption_draws_as_many_random_numbers_as_the_original() {
    let test = "corruption_draws_as_many_random_numbers_as_the_original";
    let sources = sources();
    let Some(pack) = libero(&sources, test) else {
        return;
    };
    let mut checked = 0;
    for line in RECORDED.lines().filter(|line| line.contains(" noise ")) {
        let fields: Vec<&str> = line.split(' ').collect();
        let (_, name) = fields[0].split_once('/').unwrap();
        let variant: Variant = name.parse().unwrap();
        let corruption = Corruption::new(variant.corruption().unwrap()).unwrap();
        let files = TaskFiles::of_variant(&sources, &variant);
        let ready = ReadyScene::compile(files, &pack, &sources).unwrap();
        let mut environment = Environment::of(Arc::clone(ready.compiled())).unwrap();
        let mut rng = LegacyRng::seed(SEED);
        environment.reset(&mut rng, Reset::Hard, 2).unwrap();
        // One picture of the reset, and one of each of the ten waits.
        for _ in 0..11 {
            corruption.skip(256, 256, &mut rng);
        }
        let expected: f64 = fields[2].parse().unwrap();
        assert_eq!(rng.random_sample(), expected, "{variant}");
        checked += 1;
    }
    assert_eq!(checked, 5);
}

/// Compares states of LIBERO-PRO in trials 0 and 1, as recorded by `family/record_pro.py`.
#[test]
fn states_of_libero_pro_after_resets_and_waits_equal_the_originals() {
    let test = "states_of_libero_pro_after_resets_and_waits_equal_the_originals";
    let sources = sources();
    let Some(pack) = libero(&sources, test) else {
        return;
    };
    // The object suites need models that are not LIBERO's.
    let pro_pack = std::env::var("ROLLOUT_PRO_ASSETS").ok();
    let pro_pack = pro_pack.map(|dir| AssetPack::open_whole(dir.as_ref()).unwrap());
    let mut largest = 0.0_f64;
    for line in include_str!("family/pro.txt").lines() {
        let mut fields = line.split(' ');
        let suite: ProSuite = fields.next().unwrap().parse().unwrap();
        let name = fields.next().unwrap();
        let trial: u16 = fields.next().unwrap().parse().unwrap();
        let expected: Vec<f64> = fields.map(|field| field.parse().unwrap()).collect();
        let task = suite
            .suite
            .tasks()
            .find(|task| task.name() == name)
            .unwrap();
        let files = TaskFiles::of_pro_task(&sources, suite, task);
        if !(files.bddl.is_file() && files.init.is_file()) {
            let folder = Sources::family(sources.dir(), Benchmark::Pro);
            println!("skipped {test}: no task files at {}", folder.display());
            return;
        }
        let pack = match (
            AssetPack::files_of_tasks(std::slice::from_ref(&files)),
            &pro_pack,
        ) {
            (Ok(_), _) => {
                pack.provide_with_bar(std::slice::from_ref(&files)).unwrap();
                &pack
            }
            (Err(_), Some(pro_pack)) => pro_pack,
            (Err(_), None) => {
                println!("skipped {test}: {suite}: ROLLOUT_PRO_ASSETS names no folder of assets");
                continue;
            }
        };
        let ready = ReadyScene::compile(files, pack, &sources).unwrap();
        let mut environment = Environment::of(Arc::clone(ready.compiled())).unwrap();
        let row = row_of(RolloutId::clean(task, trial)).unwrap();
        let start = VariantStart {
            view: None,
            posture: None,
            seed: SEED,
            earlier_resets: u32::from(trial),
            start: Start::InitialState,
            corruption: None,
        };
        let conditions = Conditions::begin_variant(&ready, &mut environment, &row, &start).unwrap();
        conditions.settle(&mut environment).unwrap();
        let difference = difference(&environment.state(), &expected);
        println!("{suite} {name} {trial}: {difference:e}");
        largest = largest.max(difference);
    }
    assert!(largest <= TOLERANCE, "states differ by {largest:e}");
}
