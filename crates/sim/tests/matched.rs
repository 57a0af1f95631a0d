//! Basis of pairing: in `matched` mode, an axis is realised with the same bits alone and in any
//! combination, for any configuration and radius. Runs without MuJoCo: camera, lights and arm are
//! synthetic.

use std::collections::BTreeMap;

use benchmark::streams::Randomness;
use benchmark::{
    Axis, Condition, Design, Level, MAX_CONFIGS, ManifestRow, Nominal, Realisation, TaskRef,
};
use proptest::prelude::*;
use proptest::sample::{select, subsequence};
use sim::perturb::{
    ActuationStage, ArmState, CameraPose, Frame, FrameSource, JOINTS, Jacobian, JointRange,
    JointVector, Light, Lighting, SensorStage, look_at_point, shift_camera, shift_lighting,
    solve_shifted_pose,
};

#[path = "../src/perturb/robot/chain.rs"]
mod chain;

use chain::{arm, nominal_arm};

const PICTURE_PX: usize = 24;
const PICTURED_STEPS: [u32; 3] = [0, 1, 40];
const ACTIONS: usize = 30;

/// Stored part of a result, and per axis the bits of every number that affects the rollout.
#[derive(Debug)]
struct Realised {
    stored: benchmark::attempt::Realised,
    bits: BTreeMap<Axis, Vec<u64>>,
}

fn realise(row: &ManifestRow, mode: Realisation) -> Realised {
    let perturbation = &row.perturbation;
    let mut realised =
        Realised { stored: benchmark::attempt::Realised::default(), bits: BTreeMap::new() };
    let camera = nominal_camera();
    let look_at = look_at_point(&camera, &[[0.1, 0.05, 0.9], [-0.1, 0.0, 0.95]]);
    if let Some(shift) = &perturbation.camera {
        let pose = shift_camera(&camera, look_at, shift);
        let values = [pose.position.as_slice(), &pose.quat_wxyz].concat();
        realised.add(Axis::Camera, &perturbation.values(Axis::Camera), &values, &[]);
    }
    if let Some(shift) = &perturbation.lighting {
        let values = lighting_values(&shift_lighting(&nominal_lighting(), look_at, shift));
        realised.add(Axis::Lighting, &perturbation.values(Axis::Lighting), &values, &[]);
    }
    if let Some(shift) = &perturbation.robot {
        let ranges: [JointRange; JOINTS] = [[-2.8, 2.8]; JOINTS];
        let solution = solve_shifted_pose(arm, &nominal_arm(), &ranges, shift);
        let values = solution.joints.as_slice();
        realised.add(Axis::Robot, &perturbation.values(Axis::Robot), values, &[]);
    }
    if let Some(corruption) = &perturbation.sensor {
        let randomness = Randomness::of(&row.id, Axis::Sensor, mode);
        let mut stage = SensorStage::new(corruption, &randomness);
        let fixed = stage.realised();
        let pixels = pictures(&mut stage);
        realised.add(Axis::Sensor, &perturbation.values(Axis::Sensor), &fixed, &pixels);
    }
    if let Some(distortion) = &perturbation.actuation {
        let randomness = Randomness::of(&row.id, Axis::Actuation, mode);
        let rms = row.id.task().suite().demo_action_rms();
        let mut stage = ActuationStage::new(distortion, rms, &randomness);
        let fixed = stage.realised();
        let outputs = actions(&mut stage);
        realised.add(Axis::Actuation, &perturbation.values(Axis::Actuation), &fixed, &outputs);
    }
    realised
}

impl Realised {
    /// Adds an axis: the values that a result keeps, and the values of each step.
    fn add(&mut self, axis: Axis, parameters: &[f64], fixed: &[f64], steps: &[f64]) {
        self.stored.add(axis, parameters.to_vec(), fixed.to_vec());
        let values = fixed.iter().chain(steps);
        self.bits.insert(axis, values.map(|value| value.to_bits()).collect());
    }
}

fn pictures(stage: &mut SensorStage) -> Vec<f64> {
    let mut pixels = Vec::new();
    for step in PICTURED_STEPS {
        for source in FrameSource::ALL {
            let bytes = 0..PICTURE_PX * PICTURE_PX * 3;
            let mut rgb: Vec<u8> = bytes.map(|i| (i * 37 % 251) as u8).collect();
            stage.apply(&mut Frame {
                source,
                step,
                width: PICTURE_PX,
                height: PICTURE_PX,
                rgb: &mut rgb,
            });
            pixels.extend(rgb.into_iter().map(f64::from));
        }
    }
    pixels
}

fn actions(stage: &mut ActuationStage) -> Vec<f64> {
    let action = |step: usize| std::array::from_fn(|i| ((step * 7 + i * 3) as f64).sin());
    (0..ACTIONS).flat_map(|step| stage.apply(&action(step))).collect()
}

fn nominal_camera() -> CameraPose {
    // A quarter turn about y, so that the camera looks along −x.
    let half = std::f64::consts::FRAC_1_SQRT_2;
    CameraPose { position: [0.9, 0.1, 1.4], quat_wxyz: [half, 0.0, half, 0.0] }
}

fn nominal_lighting() -> Lighting {
    let light = |x: f64| Light {
        position: [x, 0.3, 2.0],
        direction: [0.0, 0.0, -1.0],
        diffuse: [0.8, 0.7, 0.6],
        specular: [0.3; 3],
    };
    Lighting { lights: vec![light(1.0), light(-0.5)], headlight_ambient: [0.2; 3] }
}

fn lighting_values(lighting: &Lighting) -> Vec<f64> {
    let lights = lighting.lights.iter();
    let lights = lights.flat_map(|l| [l.position, l.direction, l.diffuse, l.specular]);
    lights.flatten().chain(lighting.headlight_ambient).collect()
}

fn any_level() -> impl Strategy<Value = Level> {
    let radius = (1..=20_000_u32).prop_map(|millis| {
        let text = format!("r{}.{:03}", millis / 1_000, millis % 1_000);
        text.parse().expect("a level")
    });
    prop_oneof![select(Level::PERTURBED.to_vec()), radius]
}

prop_compose! {
    fn any_design()(
        axes in subsequence(Axis::METRIC.to_vec(), 2..=5),
        task in select(TaskRef::all().collect::<Vec<_>>()),
        level in any_level(),
        config in prop_oneof![0..10_u16, 0..MAX_CONFIGS],
        seed in any::<u64>(),
    ) -> Design {
        // A design with three axes or more also has a condition with its first two axes.
        let pair = axes[..2].iter().copied().collect();
        let subsets = if axes.len() > 2 { vec![pair] } else { Vec::new() };
        Design {
            tasks: vec![task],
            axes,
            subsets,
            levels: vec![level],
            configs: vec![config],
            nominal: Nominal::None,
            seed,
            ..Design::v0_1()
        }
    }
}

/// Compares each axis of every condition with one or two axes with simultaneous.
fn each_axis(
    design: &Design,
    mode: Realisation,
    mut compare: impl FnMut(Axis, Realised, &Realised),
) {
    let rows = design.expand().expect("rows");
    let (combined, alone) = rows.split_last().expect("a simultaneous rollout");
    assert_eq!(combined.id.condition(), Condition::Simultaneous);
    let combined = realise(combined, mode);
    for row in alone {
        for axis in row.id.condition().axes(design.axis_set()).axes() {
            compare(axis, realise(row, mode), &combined);
        }
    }
}

proptest! {
    // A failing case prints its input, so it is not stored in a file.
    #![proptest_config(ProptestConfig {
        failure_persistence: None,
        ..ProptestConfig::default()
    })]

    #[test]
    fn an_axis_has_the_same_bits_alone_and_in_any_combination(design in any_design()) {
        let mut compared = 0;
        each_axis(&design, Realisation::Matched, |axis, alone, combined| {
            assert_eq!(alone.bits[&axis], combined.bits[&axis], "{axis}");
            assert!(alone.stored.of(axis).is_some());
            assert_eq!(alone.stored.of(axis), combined.stored.of(axis), "{axis}");
            compared += 1;
        });
        prop_assert_eq!(compared, design.axes.len() + 2 * design.subsets.len());
    }

    /// In `reference` mode, each condition draws its own random elements, so an axis differs
    /// between conditions. The `matched` mode exists for this reason.
    #[test]
    fn in_reference_mode_the_random_elements_differ_between_conditions(
        task in select(TaskRef::all().collect::<Vec<_>>()),
        config in 0..10_u16,
    ) {
        let design = Design {
            tasks: vec![task],
            axes: Axis::METRIC.to_vec(),
            levels: vec![Level::L3],
            configs: vec![config],
            nominal: Nominal::None,
            ..Design::v0_1()
        };
        each_axis(&design, Realisation::Reference, |axis, alone, combined| {
            let is_drawn = matches!(axis, Axis::Sensor | Axis::Actuation);
            assert_eq!(alone.bits[&axis] != combined.bits[&axis], is_drawn, "{axis}");
        });
    }
}
