//! Compares the perturbations that a rollout applies to MuJoCo's model with values computed
//! independently from the written specification, and frames under them with those that the original
//! draws with these values, recorded by `perturbations/record.py`.

use std::path::Path;

use benchmark::{
    Axis, Condition, Level, ManifestRow, Perturbation, Realisation, RolloutId, Suite, TaskRef,
    presets, row_of,
};
use proto::checks::CAMERAS;
use sim::mujoco::ObjectKind;
use sim::{CameraRequest, ObservationRequest, Renderer, Simulator, SimulatorConfig};
use tests::fidelity::{Array, FrameFindings, SAME_ARITHMETIC, read_npz, read_upright};
use tests::files::{libero, shared, sources};

const LEVELS: [Level; 3] = [Level::L1, Level::L2, Level::L3];
const CONFIGS: u16 = 10;

fn check_suite(suite: Suite) {
    let test = format!("camera_lights_and_arm_are_where_the_specification_puts_them_in_{suite}");
    let sources = sources();
    let (Some(reference), Some(pack)) = (shared("oracle/perturb", &test), libero(&sources, &test))
    else {
        return;
    };
    let mut simulator = Simulator::new(SimulatorConfig {
        sources,
        pack,
        renderer: Renderer::default(),
        cached_scenes: 1,
    });
    let mut checked = 0;
    for task in suite.tasks() {
        let file = format!("model_{}_t{}.npz", suite.short_name(), task.index());
        if reference.join(&file).is_file() {
            check_task(&mut simulator, task, &reference.join(&file));
            checked += 1;
        }
    }
    assert!(checked > 0, "no reference for {suite}");
}

fn check_task(simulator: &mut Simulator, task: TaskRef, file: &Path) {
    let reference = read_npz(file).unwrap();
    for level in LEVELS {
        for config in 0..CONFIGS {
            let row = row(task, level, config);
            let mut episode = simulator.begin(&row, Realisation::Matched).unwrap();
            let ik = *episode.ik().unwrap();
            let environment = episode.environment();
            let model = environment.model();
            let camera = model.id(ObjectKind::Camera, "agentview").unwrap();
            let expect = |name: &str, ours: &[f64], tolerance: f64| {
                let array: &Array = &reference[&format!("{level}_{name}")];
                for (ours, theirs) in ours.iter().zip(array.row(usize::from(config))) {
                    let difference = (ours - theirs).abs();
                    assert!(
                        difference <= tolerance,
                        "{task} {level} c{config} {name}: {difference}"
                    );
                }
            };
            let widened =
                |values: &[f32]| -> Vec<f64> { values.iter().map(|v| f64::from(*v)).collect() };
            expect("cam_pos", &model.cam_pos()[camera * 3..][..3], 1e-9);
            expect("cam_quat", &model.cam_quat()[camera * 4..][..4], 1e-9);
            expect("light_pos", model.light_pos(), 1e-9);
            expect("light_dir", model.light_dir(), 1e-9);
            // MuJoCo rounds colours to single precision; the crate `sim` tests their values in
            // double precision.
            expect("light_diffuse", &widened(model.light_diffuse()), 3e-6);
            expect("light_specular", &widened(model.light_specular()), 3e-6);
            expect("ambient", &widened(&model.headlight_ambient()), 3e-6);
            expect("ik_q", ik.joints.as_slice(), 1e-6);
            expect("ik_q", &environment.data().qpos(model)[..7], 1e-6);
            expect("ik_res_mm", &[ik.residual_mm], 1e-3);
            expect("ik_clamped", &[f64::from(ik.clamped_joints)], 0.0);
        }
    }
}

/// Returns the row of a rollout whose camera, lights and arm are perturbed together.
fn row(task: TaskRef, level: Level, config: u16) -> ManifestRow {
    let id = RolloutId::perturbed(task, Condition::Simultaneous, level, config).unwrap();
    let mut perturbation = Perturbation::default();
    for axis in [Axis::Camera, Axis::Lighting, Axis::Robot] {
        presets::apply_preset(&mut perturbation, axis, level, config);
    }
    let init_id = task.eval_init_ids()[usize::from(config)];
    ManifestRow::new(id, config, init_id, perturbation)
}

#[test]
fn camera_lights_and_arm_are_where_the_specification_puts_them_in_libero_spatial() {
    check_suite(Suite::Spatial);
}

#[test]
fn camera_lights_and_arm_are_where_the_specification_puts_them_in_libero_object() {
    check_suite(Suite::Object);
}

#[test]
fn camera_lights_and_arm_are_where_the_specification_puts_them_in_libero_goal() {
    check_suite(Suite::Goal);
}

#[test]
fn camera_lights_and_arm_are_where_the_specification_puts_them_in_libero_10() {
    check_suite(Suite::Long);
}

/// Rollouts of which the original's pictures were recorded in the default look.
const CASES: &str = include_str!("perturbations/cases.json");
/// Folder of the recorded pictures, with a folder for each look.
const RECORDED: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/perturbations");

#[test]
fn frames_under_presets_of_camera_and_lights_equal_the_originals() {
    let test = "frames_under_presets_of_camera_and_lights_equal_the_originals";
    let sources = sources();
    let Some(pack) = libero(&sources, test) else {
        return;
    };
    let recorded = Path::new(RECORDED).join(pack.look().name());
    let renderer = Renderer::Software;
    let mut simulator =
        Simulator::new(SimulatorConfig { sources, pack, renderer, cached_scenes: 1 });
    let cases: Vec<RolloutId> = serde_json::from_str(CASES).unwrap();
    for id in cases {
        let cameras: &[&str] = match id.condition() {
            // Presets of the camera do not change the wrist camera.
            Condition::Single(Axis::Camera) => &CAMERAS[..1],
            _ => &CAMERAS,
        };
        let mut episode = simulator.begin(&row_of(id).unwrap(), Realisation::Matched).unwrap();
        episode.settle().unwrap();
        for camera in cameras {
            let place = format!("{}_{camera}.png", id.to_string().replace('/', "_"));
            let expected = read_upright(&recorded.join(&place)).unwrap();
            let (width, height) = expected.dimensions();
            let name = (*camera).to_owned();
            let cameras = vec![CameraRequest { name, width, height }];
            let request = ObservationRequest { cameras, privileged: false };
            let frame = episode.observe(&request).unwrap().frames.remove(0);
            let mut findings = FrameFindings::default();
            findings.add(&frame.rgb, &expected, &place);
            println!("{place}: {findings}");
            assert_eq!(findings.violations(&SAME_ARITHMETIC), [""; 0]);
        }
    }
}
