//! Comparison of the simulator with the original: by all of the reference data if it is available,
//! and by a few committed figures on every machine.

use std::collections::BTreeSet;

use benchmark::presets::ENV_SEED;
use benchmark::{Look, ManifestRow, Perturbation, Realisation, RolloutId, TaskRef};
use scene::{InitialStates, TaskFiles, compose};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use sim::{
    CameraRequest, Drawer, Environment, GlDevice, ObservationRequest, Renderer, Simulator,
    SimulatorConfig,
};
use tests::fidelity::{Limits, RendererRelation, compare, find_tasks};
use tests::files::{libero, primitives, shared, sources};
use worker::open_loop::smooth_action;

fn check_suite(suite: &str) {
    let test = format!("every_reference_task_of_{suite}_agrees_with_the_original");
    let sources = sources();
    let (Some(reference), Some(frames), Some(pack)) = (
        shared("oracle/tasks-real", &test),
        shared("oracle/tasks-look", &test),
        libero(&sources, &test),
    ) else {
        return;
    };
    let drawer = Drawer::open(Renderer::default()).unwrap();
    let limits = Limits::new(RendererRelation::for_drawer(&drawer, false));
    let tasks = find_tasks(&reference, Some(&frames)).unwrap();
    let mut compared = 0;
    for task in tasks.iter().filter(|task| task.suite == suite) {
        let findings = compare(task, &sources, &pack, &drawer).unwrap();
        let violations = findings.violations(&limits);
        assert!(violations.is_empty(), "{}: {violations:#?}", task.id());
        compared += 1;
    }
    assert!(compared > 0, "the reference has no task of {suite}");
}

#[test]
fn every_reference_task_of_libero_spatial_agrees_with_the_original() {
    check_suite("libero_spatial");
}

#[test]
fn every_reference_task_of_libero_object_agrees_with_the_original() {
    check_suite("libero_object");
}

#[test]
fn every_reference_task_of_libero_goal_agrees_with_the_original() {
    check_suite("libero_goal");
}

#[test]
fn every_reference_task_of_libero_10_agrees_with_the_original() {
    check_suite("libero_10");
}

/// Compares one task of each suite in the look of MuJoCo 3.3.3; the tests above use the default
/// look.
#[test]
fn the_newer_look_equals_the_originals_under_a_newer_mujoco() {
    let test = "the_newer_look_equals_the_originals_under_a_newer_mujoco";
    check_one_task_of_each_suite(Renderer::Software, Look::Mujoco333, test);
}

/// Compares one task of each suite with frames drawn through OpenGL; the tests above draw with the
/// software renderer.
#[test]
fn frames_drawn_through_opengl_equal_the_originals_within_bounds() {
    let test = "frames_drawn_through_opengl_equal_the_originals_within_bounds";
    check_one_task_of_each_suite(Renderer::Gl(GlDevice::Auto), Look::Mujoco332, test);
}

fn check_one_task_of_each_suite(renderer: Renderer, look: Look, test: &str) {
    let sources = sources();
    let (Some(reference), Some(frames), Some(pack)) = (
        shared("oracle/tasks-real", test),
        shared("oracle/tasks-look", test),
        libero(&sources, test),
    ) else {
        return;
    };
    let pack = pack.with_look(look);
    let frames = (look == Look::Mujoco332).then_some(frames);
    let drawer = match Drawer::open(renderer) {
        Ok(drawer) => drawer,
        Err(error) => {
            println!("skipped {test}: {error}");
            return;
        }
    };
    let limits = Limits::new(RendererRelation::for_drawer(&drawer, false));
    let mut tasks = find_tasks(&reference, frames.as_deref()).unwrap();
    tasks.dedup_by_key(|task| task.suite.clone());
    assert_eq!(tasks.len(), 4, "the reference has tasks of all suites");
    for task in tasks {
        let findings = compare(&task, &sources, &pack, &drawer).unwrap();
        let violations = findings.violations(&limits);
        assert!(violations.is_empty(), "{}: {violations:#?}", task.id());
    }
}

/// SHA-256 of frames of LIBERO's scenes, drawn by the software renderer, 256 × 256: for one task of
/// each suite, the first frames of both cameras that a policy sees, nominal and with presets of the
/// camera and lighting axes. In the look of MuJoCo 3.3.3 only those of libero_object, where the
/// looks differ most. They change with `raster::NAME`, MuJoCo and the content of scenes.
const REAL_FRAMES: &str = include_str!("../data/real_frames.jsonl");

#[derive(Deserialize, Serialize)]
struct RealFrame {
    look: Look,
    rollout: String,
    camera: String,
    sha256: String,
}

#[test]
fn frames_of_real_scenes_have_the_same_bits_on_every_machine() {
    let test = "frames_of_real_scenes_have_the_same_bits_on_every_machine";
    let sources = sources();
    let Some(pack) = libero(&sources, test) else {
        return;
    };
    let mut found = String::new();
    for look in Look::ALL {
        let mut simulator = Simulator::new(SimulatorConfig {
            sources: sources.clone(),
            pack: pack.clone().with_look(look),
            renderer: Renderer::Software,
            cached_scenes: 1,
        });
        let tasks: &[&str] = match look {
            Look::Mujoco332 => &["spatial/t0", "object/t0", "goal/t8", "long/t0"],
            Look::Mujoco333 => &["object/t0"],
        };
        for task in tasks {
            for condition in ["nominal/i00", "camera/L3/c05", "lighting/L3/c07"] {
                let id: RolloutId = format!("{task}/{condition}").parse().unwrap();
                let row = benchmark::row_of(id).unwrap();
                let mut episode = simulator.begin(&row, Realisation::Matched).unwrap();
                episode.settle().unwrap();
                for camera in ["agentview", "robot0_eye_in_hand"] {
                    let request = ObservationRequest {
                        cameras: vec![CameraRequest {
                            name: camera.to_owned(),
                            width: 256,
                            height: 256,
                        }],
                        privileged: false,
                    };
                    let frame = episode.observe(&request).unwrap().frames.remove(0);
                    let digest = Sha256::digest(&frame.rgb);
                    let frame = RealFrame {
                        look,
                        rollout: row.id.to_string(),
                        camera: camera.to_owned(),
                        sha256: hex::encode(digest),
                    };
                    found.push_str(&serde_json::to_string(&frame).unwrap());
                    found.push('\n');
                }
            }
        }
    }
    assert!(
        found == REAL_FRAMES,
        "frames differ from those of other machines; if the renderer or a scene was changed on \
         purpose, this is the new tests/data/real_frames.jsonl:\n{found}"
    );
}

/// Compares depths and segments, for one task of each suite and both cameras. Other tests compare
/// colours.
#[test]
fn depths_and_segments_equal_those_of_opengl() {
    const SIZE: [u32; 2] = [256, 256];
    // A thousandth of the pixels: those at silhouettes and where surfaces meet.
    const LIMIT: usize = 65;
    let drawers = [
        Drawer::open(Renderer::Software).unwrap(),
        match Drawer::open(Renderer::Gl(GlDevice::Auto)) {
            Ok(drawer) => drawer,
            Err(error) => {
                println!("skipped depths_and_segments_equal_those_of_opengl: {error}");
                return;
            }
        },
    ];
    let sources = sources();
    let pack = primitives(&sources);
    for task in ["libero_spatial/0", "libero_object/0", "libero_goal/0", "libero_10/0"] {
        let task: TaskRef = task.parse().unwrap();
        let files = TaskFiles::of_task(&sources, task);
        let scene = compose(&files.problem().unwrap(), &pack, &sources, ENV_SEED).unwrap();
        let mut environment = Environment::new(scene, &pack, &sources).unwrap();
        let states = InitialStates::read(&files.init).unwrap();
        environment.load(states.get(0).unwrap());
        for camera in ["agentview", "robot0_eye_in_hand"] {
            let [ours, theirs] = drawers
                .each_ref()
                .map(|drawer| environment.segmentation(drawer, camera, SIZE).unwrap());
            let kinds: BTreeSet<_> =
                ours.iter().flatten().map(|segment| (segment.kind, segment.id)).collect();
            assert!(kinds.len() > 5, "{task} {camera} shows {kinds:?}");
            let differ = ours.iter().zip(&theirs).filter(|(a, b)| a != b).count();
            println!("{task} {camera}: {differ} segments differ");
            assert!(differ <= LIMIT, "{task} {camera}: {differ} segments differ");
            let [ours, theirs] =
                drawers.each_ref().map(|drawer| environment.depth(drawer, camera, SIZE).unwrap());
            assert!(ours.iter().all(|depth| (0.0..=1.0).contains(depth)));
            let differ = ours.iter().zip(&theirs);
            let differ = differ.filter(|(a, b)| (*a - *b).abs() > 1e-6).count();
            println!("{task} {camera}: {differ} depths differ");
            assert!(differ <= LIMIT, "{task} {camera}: {differ} depths differ");
        }
    }
}

/// Figures of the original that do not depend on the asset pack's shapes.
#[derive(Deserialize)]
struct Figures {
    placement: std::collections::BTreeMap<String, Vec<Pose>>,
    arm: std::collections::BTreeMap<String, ArmMotion>,
}

#[derive(Deserialize)]
struct Pose {
    root_body: String,
    pos: [f64; 3],
    quat: [f64; 4],
}

/// Positions of arm and fingers, and the observed end-effector, after some of
/// the reference's smooth steps.
#[derive(Deserialize)]
struct ArmMotion {
    init_id: u16,
    steps: Vec<usize>,
    qpos: Vec<[f64; 9]>,
    eef_pos: Vec<[f64; 3]>,
}

fn figures() -> Figures {
    serde_json::from_str(include_str!("../data/reference_figures.json")).unwrap()
}

#[test]
fn fixtures_are_placed_where_the_original_places_them() {
    let sources = sources();
    let pack = primitives(&sources);
    for (task, poses) in figures().placement {
        let task: TaskRef = task.parse().unwrap();
        let problem = TaskFiles::of_task(&sources, task).problem().unwrap();
        let scene = compose(&problem, &pack, &sources, ENV_SEED).unwrap();
        assert_eq!(scene.fixture_poses.len(), poses.len(), "{task}");
        for expected in poses {
            let ours = scene.fixture_poses.iter().find(|pose| pose.root_body == expected.root_body);
            let ours = ours.unwrap_or_else(|| panic!("{task}: no {}", expected.root_body));
            let pairs = ours.pos.iter().chain(&ours.quat);
            for (ours, theirs) in pairs.zip(expected.pos.iter().chain(&expected.quat)) {
                assert!((ours - theirs).abs() < 1e-12, "{task} {}: {ours}", expected.root_body);
            }
        }
    }
}

#[test]
fn the_arm_moves_as_in_the_original_with_any_asset_pack() {
    let sources = sources();
    let pack = primitives(&sources);
    let mut simulator = Simulator::new(SimulatorConfig {
        sources,
        pack,
        renderer: Renderer::default(),
        cached_scenes: 1,
    });
    for (task, motion) in figures().arm {
        let task: TaskRef = task.parse().unwrap();
        let id: RolloutId = format!(
            "{}/t{}/nominal/i{:02}",
            task.suite().short_name(),
            task.index(),
            motion.init_id
        )
        .parse()
        .unwrap();
        let row = ManifestRow::new(id, motion.init_id, motion.init_id, Perturbation::default());
        let mut episode = simulator.begin(&row, Realisation::Matched).unwrap();
        episode.settle().unwrap();
        let last = *motion.steps.last().unwrap();
        for step in 0..=last {
            if step > 0 {
                episode.step(&smooth_action(step - 1)).unwrap();
            }
            let Some(index) = motion.steps.iter().position(|recorded| *recorded == step) else {
                continue;
            };
            let environment = episode.environment();
            let eef_pos = environment.robot_state().eef_pos;
            let qpos = environment.data().qpos(environment.model());
            let pairs = qpos.iter().zip(&motion.qpos[index]);
            for (ours, theirs) in pairs.chain(eef_pos.iter().zip(&motion.eef_pos[index])) {
                // The solver handles all contacts of a scene together, so other objects affect the
                // arm too, by less than the solver's tolerance.
                assert!(
                    (ours - theirs).abs() < 1e-7,
                    "{task}, step {step}: {ours} instead of {theirs}"
                );
            }
        }
    }
}
