//! Pictures in the reference realisation, to the last bit.

use std::path::Path;

use benchmark::streams::Randomness;
use benchmark::{Axis, Level, Realisation, RolloutId, SensorCorruption};
use sim::perturb::{Frame, FrameSource, SensorStage};

use crate::reference::{folder, presets};

struct Picture {
    width: usize,
    height: usize,
    rgb: Vec<u8>,
}

fn read(folder: &Path, name: &str) -> Picture {
    let path = folder.join(name);
    let picture = image::open(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    let rgb = picture.to_rgb8();
    Picture { width: rgb.width() as usize, height: rgb.height() as usize, rgb: rgb.into_raw() }
}

fn stage(corruption: &SensorCorruption, level: Level, config: u16) -> SensorStage {
    let id = format!("object/t2/sensor/{level}/c{config:02}");
    let id: RolloutId = id.parse().expect("an id");
    let randomness = Randomness::of(&id, Axis::Sensor, Realisation::Reference);
    SensorStage::new(corruption, &randomness)
}

fn corrupted(
    stage: &mut SensorStage,
    picture: &Picture,
    source: FrameSource,
    step: u32,
) -> Vec<u8> {
    let mut rgb = picture.rgb.clone();
    stage.apply(&mut Frame {
        source,
        step,
        width: picture.width,
        height: picture.height,
        rgb: &mut rgb,
    });
    rgb
}

fn check_equal(picture: &[u8], expected: &[u8], case: &str) {
    let differing = picture.iter().zip(expected).filter(|(a, b)| a != b);
    assert_eq!(picture.len(), expected.len(), "{case}");
    assert_eq!(differing.count(), 0, "{case} differs from the reference");
}

#[test]
fn blur_and_compression_of_all_presets_equal_the_reference() {
    let Some(folder) = folder("perturb") else {
        return;
    };
    let agentview = read(&folder, "sensor_in_agentview.png");
    for (level, config, perturbation) in presets(Axis::Sensor) {
        let corruption = SensorCorruption { noise_sigma: 0.0, ..perturbation.sensor.expect("set") };
        let mut stage = stage(&corruption, level, config);
        let output = corrupted(&mut stage, &agentview, FrameSource::Agentview, 0);
        let name = format!("sensor_{level}_c{config:02}_nonoise_agentview.png");
        check_equal(&output, &read(&folder, &name).rgb, &name);
    }
}

#[test]
fn noise_of_both_cameras_and_steps_equals_the_reference_in_any_order() {
    let Some(folder) = folder("perturb") else {
        return;
    };
    let agentview = read(&folder, "sensor_in_agentview.png");
    let wrist = read(&folder, "sensor_in_wrist.png");
    let requests = [
        (FrameSource::Wrist, &wrist, "wrist", 1),
        (FrameSource::Agentview, &agentview, "agentview", 0),
        (FrameSource::Agentview, &agentview, "agentview", 1),
        (FrameSource::Wrist, &wrist, "wrist", 0),
    ];
    let noisy_presets = presets(Axis::Sensor).filter(|&(_, config, _)| config % 3 == 0);
    for (level, config, perturbation) in noisy_presets {
        let mut stage = stage(&perturbation.sensor.expect("set"), level, config);
        for (source, picture, camera, step) in requests {
            let output = corrupted(&mut stage, picture, source, step);
            let name = format!("sensor_{level}_c{config:02}_step{step}_{camera}.png");
            check_equal(&output, &read(&folder, &name).rgb, &name);
        }
    }
}
