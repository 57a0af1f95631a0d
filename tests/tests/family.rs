//! Variants of LIBERO-Plus against states that its own code reached: `family/record.py`
//! recorded them.

use std::collections::BTreeMap;
use std::sync::Arc;

use libero_ctrl::numpy::LegacyRng;
use libero_ctrl::{RolloutId, row_of};
use libero_family::plus::{Variant, start_posture};
use scene::sources::LIBERO_PLUS;
use scene::{Sources, TaskFiles};
use sim::{Conditions, Environment, ObjectKind, ReadyScene, Reset, Start, VariantStart};
use tests::files::{libero, sources};

const RECORDED: &str = include_str!("family/states.txt");
/// Largest difference of any coordinate.
const TOLERANCE: f64 = 1e-9;
/// Seed of the recordings.
const SEED: u32 = 7;

/// Recorded numbers of each variant, by what they are.
fn recorded() -> BTreeMap<Variant, BTreeMap<&'static str, Vec<f64>>> {
    let mut recorded: BTreeMap<_, BTreeMap<_, _>> = BTreeMap::new();
    for line in RECORDED.lines() {
        let mut fields = line.split(' ');
        let (_, name) = fields.next().unwrap().split_once('/').unwrap();
        let what = fields.next().unwrap();
        let numbers = fields.map(|field| field.parse().unwrap()).collect();
        let variant = name.parse().unwrap();
        recorded.entry(variant).or_default().insert(what, numbers);
    }
    recorded
}

fn difference(found: &[f64], expected: &[f64]) -> f64 {
    assert_eq!(found.len(), expected.len());
    let pairs = found.iter().zip(expected);
    pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
}

#[test]
fn states_after_reset_and_waits_and_cameras_are_the_originals() {
    let test = "states_after_reset_and_waits_and_cameras_are_the_originals";
    let sources = sources();
    let Some(pack) = libero(&sources, test) else {
        return;
    };
    let mut largest = BTreeMap::new();
    for (variant, recorded) in recorded() {
        let files = TaskFiles::of_variant(&sources, &variant);
        if !(files.bddl.is_file() && files.init.is_file()) {
            let folder = Sources::family(sources.dir(), LIBERO_PLUS);
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
                start,
                corruption: None,
            };
            let begun = Conditions::begin_variant(&ready, environment, &row, &start).unwrap();
            begun.settle(environment).unwrap();
        };
        begin(&mut environment, Start::Reset, 0);
        let mut check = |what: &'static str, found: &[f64]| {
            let difference = difference(found, &recorded[what]);
            println!("{variant} {what}: {difference:e}");
            let largest = largest.entry(what).or_insert((0.0, variant));
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
    for (what, (difference, variant)) in largest {
        assert!(
            difference <= TOLERANCE,
            "{what} of {variant} differs by {difference:e}"
        );
    }
}
