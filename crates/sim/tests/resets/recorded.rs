//! States after resets, as recorded by `record.py`.

use std::collections::BTreeMap;

use benchmark::numpy::LegacyRng;
use serde::Deserialize;
use sha2::{Digest, Sha256};
use sim::mujoco::ObjectKind;
use sim::{Environment, Reset};

use crate::files::{bddl, compile, crowded, packs};
use crate::fixtures;

/// Tolerance after a reset, m or rad: sines and matrix products differ in the last digit.
const PLACEMENT_TOLERANCE: f64 = 1e-15;
/// Tolerance of the robot's positions after some steps, m or rad.
const MOTION_TOLERANCE: f64 = 1e-12;

#[derive(Deserialize)]
struct Recorded {
    action: [f64; 7],
    steps: usize,
    scenarios: Vec<Scenario>,
}

#[derive(Deserialize)]
struct Scenario {
    file: String,
    seed: u32,
    hard: bool,
    constructed: Generator,
    resets: Vec<AfterReset>,
}

#[derive(Deserialize)]
struct AfterReset {
    attempts: u32,
    generator: Generator,
    fixtures: BTreeMap<String, [f64; 7]>,
    qpos: Vec<f64>,
    /// Positions after some steps; absent if objects touch one another.
    robot_qpos: Option<[f64; 9]>,
}

#[derive(Debug, PartialEq, Deserialize)]
struct Generator {
    words_sha256: String,
    position: usize,
    has_gauss: u8,
    gauss: f64,
}

impl Generator {
    fn from_rng(rng: &LegacyRng) -> Self {
        let state = rng.state();
        let mut hash = Sha256::new();
        for word in state.words {
            hash.update(word.to_le_bytes());
        }
        let hex = hex::encode(hash.finalize());
        Self {
            words_sha256: hex,
            position: state.position,
            has_gauss: state.has_gauss.into(),
            gauss: state.gauss,
        }
    }
}

fn check(scenario: &Scenario, environment: &mut Environment, action: &[f64; 7], steps: usize) {
    let kind = if scenario.hard { Reset::Hard } else { Reset::Soft };
    let mut rng = LegacyRng::seed(scenario.seed);
    let mut rounds = environment.reset(&mut rng, Reset::Hard, 1).unwrap();
    assert_eq!(rounds, 1, "the first attempt places everything");
    assert_eq!(Generator::from_rng(&rng), scenario.constructed);
    for (index, expected) in scenario.resets.iter().enumerate() {
        let reset_name = format!("{} from {}, reset {index}", scenario.file, scenario.seed);
        let before = rounds;
        rounds += u32::from(scenario.hard);
        rounds = environment.reset(&mut rng, kind, rounds).unwrap();
        let loads = if scenario.hard { expected.attempts } else { 0 };
        assert_eq!(rounds, before + loads, "{reset_name}");
        assert_eq!(Generator::from_rng(&rng), expected.generator, "{reset_name}");

        let (model, data) = (environment.model(), environment.data());
        assert_close(data.qpos(model), &expected.qpos, PLACEMENT_TOLERANCE, &reset_name);
        assert!(data.qvel(model).iter().all(|v| *v == 0.0), "{reset_name}");
        let names = fixtures(environment.scene());
        assert_eq!(names.len(), expected.fixtures.len(), "{reset_name}");
        for name in names {
            let body = model.id(ObjectKind::Body, name).unwrap();
            let pose =
                [&model.body_pos()[body * 3..][..3], &model.body_quat()[body * 4..][..4]].concat();
            assert_close(&pose, &expected.fixtures[name], PLACEMENT_TOLERANCE, &reset_name);
        }

        if let Some(robot_qpos) = expected.robot_qpos {
            for _ in 0..steps {
                environment.step(action).unwrap();
            }
            let (model, data) = (environment.model(), environment.data());
            let robot = &data.qpos(model)[..9];
            assert_close(robot, &robot_qpos, MOTION_TOLERANCE, &reset_name);
        }
    }
}

fn assert_close(values: &[f64], expected: &[f64], tolerance: f64, reset_name: &str) {
    assert_eq!(values.len(), expected.len(), "{reset_name}");
    for (index, (value, expected)) in values.iter().zip(expected).enumerate() {
        let difference = (value - expected).abs();
        assert!(
            difference <= tolerance,
            "{reset_name}: number {index} is {value}, off by {difference:e}"
        );
    }
}

#[test]
fn resets_reproduce_liberos_placements_and_generator_state() {
    let recorded: Recorded = serde_json::from_str(include_str!("recorded.json")).unwrap();
    for pack in packs() {
        let mut compiled: Option<(&str, Environment)> = None;
        for scenario in &recorded.scenarios {
            // Two consecutive scenarios may share a scene, because their first reset is hard.
            let reused = compiled.take().filter(|(file, _)| *file == scenario.file);
            let mut environment = reused.map_or_else(
                || {
                    let text = match scenario.file.as_str() {
                        "crowded.bddl" => crowded(),
                        file => bddl(file),
                    };
                    compile(&text, &pack).unwrap()
                },
                |(_, environment)| environment,
            );
            check(scenario, &mut environment, &recorded.action, recorded.steps);
            compiled = Some((&scenario.file, environment));
        }
    }
}
