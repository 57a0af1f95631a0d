//! Start of a LIBERO-family variant: a reset with one generator for all draws, optionally followed
//! by the initial state, and the camera's corruption, which continues with the same generator.

use benchmark::family::corruption::{Corruption, Picture};
use benchmark::family::plus::{CameraPose, View};
use benchmark::numpy::LegacyRng;

use crate::controller::{ARM_JOINTS, RESET_JOINTS};
use crate::environment::Environment;
use crate::error::SimError;
use crate::mujoco::ObjectKind;
use crate::observation::Frame;
use crate::ready_scene::{PERTURBED_CAMERA, ReadyScene};
use crate::reset::Reset;

/// Rounds of joint samplers: the model has been loaded at construction and by the first reset.
const ROUNDS: u32 = 2;
/// Side of the benchmark's pictures, pixels; determines how many numbers glass blur draws.
const BENCHMARK_SIDE: usize = 256;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Start {
    /// The row's initial state, loaded after a reset. The controllers stay as the reset left them,
    /// so the hand turns back to its orientation at the reset while the scene settles.
    InitialState,
    Reset,
}

#[derive(Debug, Clone, PartialEq)]
pub struct VariantStart {
    /// Pose of `agentview`, rounded as in LIBERO-Plus; `None` for LIBERO's own pose, unrounded.
    pub view: Option<View>,
    /// Angles of the arm's joints at the reset, rad; `None` for LIBERO's.
    pub posture: Option<[f64; ARM_JOINTS]>,
    pub seed: u32,
    /// Resets with the same generator for the preceding trials, since harnesses seed only once.
    pub earlier_resets: u32,
    pub start: Start,
    pub corruption: Option<Corruption>,
}

#[derive(Clone)]
pub(crate) struct Noise {
    corruption: Corruption,
    /// Generator before it draws the numbers of picture number `picture`.
    rng: LegacyRng,
    /// Number of a picture: the number of control steps before it.
    picture: u32,
}

impl VariantStart {
    pub(crate) fn begin(
        &self,
        ready: &ReadyScene,
        environment: &mut Environment,
        state: &[f64],
    ) -> Result<Option<Noise>, SimError> {
        environment.set_reset_joints(self.posture.unwrap_or(RESET_JOINTS))?;
        let mut rng = LegacyRng::seed(self.seed);
        let mut rounds = ROUNDS;
        for _ in 0..self.earlier_resets {
            rounds = environment.reset(&mut rng, Reset::Hard, rounds)? + 1;
        }
        environment.reset(&mut rng, Reset::Hard, rounds)?;
        if let Some(view) = self.view {
            let nominal = ready.written_camera.ok_or_else(|| SimError::Missing {
                kind: ObjectKind::Camera,
                name: PERTURBED_CAMERA.to_owned(),
            })?;
            environment.place_camera(view.apply(nominal))?;
        }
        if self.start == Start::InitialState {
            environment.set_state(state);
            environment.forward();
            environment.post_process();
            environment.observe_now();
        }
        Ok(self.corruption.map(|corruption| Noise { corruption, rng, picture: 0 }))
    }
}

impl Environment {
    /// Moves `agentview` until a hard reset or [`load`](Self::load); normalises like `MuJoCo`.
    pub fn place_camera(&mut self, pose: CameraPose) -> Result<(), SimError> {
        let length = pose.quat.iter().map(|part| part * part).sum::<f64>().sqrt();
        let model = self.model_mut();
        let camera = model.id(ObjectKind::Camera, PERTURBED_CAMERA)?;
        model.cam_pos_mut()[camera * 3..][..3].copy_from_slice(&pose.pos);
        let quat = pose.quat.map(|part| part / length);
        model.cam_quat_mut()[camera * 4..][..4].copy_from_slice(&quat);
        self.has_observed_poses = false;
        Ok(())
    }
}

impl Noise {
    /// `step` counts control steps before the picture. Leaves other cameras' pictures unchanged.
    /// Draws the numbers of all earlier pictures too.
    pub(crate) fn corrupt(
        &mut self,
        frame: &mut Frame,
        control_steps: u32,
    ) -> Result<(), SimError> {
        if frame.camera != PERTURBED_CAMERA {
            return Ok(());
        }
        while self.picture < control_steps {
            self.corruption.skip(BENCHMARK_SIDE, BENCHMARK_SIDE, &mut self.rng);
            self.picture += 1;
        }
        let mut picture = Picture {
            height: frame.height as usize,
            width: frame.width as usize,
            rgb: &mut frame.rgb,
        };
        // Uses a copy of the generator, since the same picture may be requested again.
        let corrupted = self.corruption.apply(&mut picture, &mut self.rng.clone());
        Ok(corrupted?)
    }
}
