//! Fingerprint of a slot's arithmetic: a digest over a fixed motion of a small scene, the algebra
//! of the arm's controller, functions of the C library, and two frames. Slots with equal
//! fingerprints compute this sample with equal bits; a processor, C library, driver or build that
//! rounds any of it differently gives another. The scene's solver is set as
//! `scene::compose` sets it. The fingerprint excludes the asset pack. Equal
//! fingerprints are no proof of equal rollouts: computations outside the sample may differ.

use std::hint::black_box;
use std::sync::Arc;

use benchmark::Look;
use nalgebra::SMatrix;
use sha2::{Digest, Sha256};

use crate::compiled_scene::{DISABLE_AUTORESET, DISABLE_NATIVE_CCD};
use crate::controller::ARM_JOINTS;
use crate::error::SimError;
use crate::mujoco::{Data, Model, ObjectKind};
use crate::render::{Canvas, Drawer, Prepared, View};

/// Scene: an arm of seven joints that pushes objects.
const SCENE: &str = include_str!("fingerprint.mjcf");
/// Number of simulation steps.
const STEPS: u32 = 150;
/// Duration of a simulation step, s.
const STEP_SECS: f64 = 0.002;
/// Amplitude of the motors' torques, N·m.
const AMPLITUDE: f64 = 6.0;
/// Frequency of the first motor's torque, rad/s.
const FREQUENCY: f64 = 20.0;
/// Share of it by which each next motor is faster; no two joints move alike.
const DETUNING: f64 = 0.37;
/// Cameras of the frames, with widths and heights, pixels.
const FRAMES: [(&str, u32, u32); 2] = [("front", 96, 64), ("hand", 64, 64)];

/// Returns the fingerprint of this process with a renderer and a look: SHA-256, hex.
pub fn fingerprint(drawer: &Drawer, look: Look) -> Result<String, SimError> {
    let (mut model, mut data, numbers) = simulate()?;
    let frames = frames(drawer, &mut model, &mut data)?;
    Ok(digest(look, &numbers, &frames))
}

fn simulate() -> Result<(Model, Data, Vec<f64>), SimError> {
    let mut model = Model::compile(SCENE)?;
    model.disable(DISABLE_NATIVE_CCD | DISABLE_AUTORESET);
    let mut data = Data::new(&model)?;
    let numbers = motion(&model, &mut data)?;
    Ok((model, data, numbers))
}

fn motion(model: &Model, data: &mut Data) -> Result<Vec<f64>, SimError> {
    let hand = model.id(ObjectKind::Site, "hand")?;
    let mut numbers = Vec::new();
    for step in 0..STEPS {
        let secs = f64::from(step) * STEP_SECS;
        for (joint, torque) in data.ctrl_mut(model).iter_mut().enumerate() {
            let detuned = 1.0 + DETUNING * joint as f64;
            *torque = AMPLITUDE * (FREQUENCY * detuned * secs + detuned).sin();
        }
        data.step(model);
        numbers.extend(data.contacts().map(|contact| contact.distance));
        for state in [data.qpos(model), data.qvel(model), data.qacc(model)] {
            numbers.extend_from_slice(state);
        }
        numbers.extend(operational_space(model, data, hand));
        numbers.extend(functions(secs));
    }
    data.forward(model);
    numbers.extend_from_slice(data.geom_xmat(model));
    Ok(numbers)
}

fn operational_space(model: &Model, data: &Data, hand: usize) -> Vec<f64> {
    let nv = model.nv();
    let mut inertia = vec![0.0; nv * nv];
    let (mut linear, mut angular) = (vec![0.0; 3 * nv], vec![0.0; 3 * nv]);
    data.full_inertia(model, &mut inertia);
    data.site_jacobian(model, hand, &mut linear, &mut angular);
    let inertia = SMatrix::<f64, ARM_JOINTS, ARM_JOINTS>::from_fn(|i, j| inertia[i * nv + j]);
    let jacobian = SMatrix::<f64, 6, ARM_JOINTS>::from_fn(|i, j| match i {
        0..3 => linear[i * nv + j],
        _ => angular[(i - 3) * nv + j],
    });
    let mut numbers = Vec::new();
    let Some(inverse) = inertia.try_inverse() else {
        return numbers;
    };
    numbers.extend_from_slice(inverse.as_slice());
    let full = jacobian * inverse * jacobian.transpose();
    numbers.extend(full.try_inverse().iter().flatten());
    let linear = full.fixed_view::<3, 3>(0, 0).into_owned();
    numbers.extend(linear.try_inverse().iter().flatten());
    numbers
}

/// Evaluates functions of the C library whose last bit may differ between machines. The argument
/// must be unknown at compile time, since a compiler would insert its own machine's values.
fn functions(secs: f64) -> [f64; 11] {
    let x = black_box(secs + 0.1);
    [
        x.sin(),
        x.cos(),
        x.tan(),
        x.asin(),
        x.acos(),
        x.atan2(0.7),
        x.exp(),
        x.exp2(),
        x.ln(),
        x.powf(2.4),
        x.hypot(0.3),
    ]
}

fn frames(drawer: &Drawer, model: &mut Model, data: &mut Data) -> Result<Vec<Vec<u8>>, SimError> {
    let (width, height) = FRAMES
        .iter()
        .fold((0, 0), |(width, height), frame| (frame.1.max(width), frame.2.max(height)));
    let prepare = |model: &Model| Prepared::from_model(model).map(Arc::new);
    let mut canvas = Canvas::new(drawer, model, prepare, [width, height])?;
    let frames = FRAMES.iter().map(|(camera, width, height)| {
        let camera = model.id(ObjectKind::Camera, camera)?;
        let size = [*width, *height];
        canvas.draw(View { model, data, camera, size })
    });
    frames.collect()
}

fn digest(look: Look, numbers: &[f64], frames: &[Vec<u8>]) -> String {
    let mut hash = Sha256::new();
    // The scene has no texture files, so its frames are the same in every look.
    hash.update(look.name());
    for number in numbers {
        hash.update(number.to_bits().to_le_bytes());
    }
    for frame in frames {
        hash.update(frame);
    }
    hex::encode(hash.finalize())
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;
    use std::time::{Duration, Instant};

    use super::*;
    use crate::render::Renderer;

    #[test]
    fn a_fingerprint_is_repeatable_and_takes_less_than_three_seconds() {
        let drawer = Drawer::open(Renderer::default()).expect("a renderer");
        let started = Instant::now();
        let first = fingerprint(&drawer, Look::default()).expect("a fingerprint");
        let took = started.elapsed();
        println!("{first} in {took:?}");
        assert_eq!(first.len(), 64);
        assert_eq!(first, fingerprint(&drawer, Look::default()).expect("a fingerprint"));
        // The limit is ten times the duration on two old cores.
        assert!(took < Duration::from_secs(3), "{took:?}");
    }

    #[test]
    fn the_fingerprint_depends_on_the_look_and_every_bit_of_motion_and_frames() {
        let (_, _, numbers) = simulate().expect("a motion");
        let frames = vec![vec![1, 2, 3], vec![4]];
        let whole = digest(Look::default(), &numbers, &frames);
        for place in [0, numbers.len() / 2, numbers.len() - 1] {
            let mut altered = numbers.clone();
            altered[place] = f64::from_bits(altered[place].to_bits() ^ 1);
            assert_ne!(digest(Look::default(), &altered, &frames), whole, "number {place}");
        }
        assert_ne!(digest(Look::Mujoco333, &numbers, &frames), whole);
        let altered = vec![vec![1, 2, 3], vec![5]];
        assert_ne!(digest(Look::default(), &numbers, &altered), whole);
    }

    #[test]
    fn the_motion_is_finite_and_has_contacts() {
        let (model, data, numbers) = simulate().expect("a motion");
        assert!(numbers.iter().all(|number| number.is_finite()));
        assert_eq!(data.instabilities(), 0);
        let touching: BTreeSet<i32> = data.contacts().flat_map(|contact| contact.geoms).collect();
        assert!(touching.len() >= 5, "{touching:?}");
        let travel: Vec<f64> = data.qpos(&model)[..ARM_JOINTS].to_vec();
        assert!(travel.iter().all(|angle| angle.abs() > 1e-3), "{travel:?}");
        // The result holds the elements of three inverse matrices if all three exist.
        let arm = operational_space(&model, &data, 0);
        assert_eq!(arm.len(), 49 + 36 + 9);
    }

    #[test]
    fn the_frames_show_the_scene() {
        let (mut model, mut data, _) = simulate().expect("a motion");
        let drawer = Drawer::open(Renderer::default()).expect("a renderer");
        let frames = frames(&drawer, &mut model, &mut data).expect("frames");
        for (frame, (camera, width, height)) in frames.iter().zip(FRAMES) {
            assert_eq!(frame.len(), (width * height * 3) as usize);
            let (pixels, _) = frame.as_chunks::<3>();
            let colours: BTreeSet<_> = pixels.iter().collect();
            assert!(colours.len() > 200, "{camera}: {} colours", colours.len());
        }
    }
}
