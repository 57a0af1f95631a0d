//! A rollout in the protocol's order: the perturbed scene at its initial state, then observations
//! and actions, each passed through its perturbation.

use benchmark::attempt::Realised;
use benchmark::family::plus::CameraPose as WrittenPose;
use benchmark::streams::Randomness;
use benchmark::{Axis, ManifestRow, Realisation, RobotShift};
use nalgebra::Matrix3;

use crate::controller::{ARM_JOINTS, ActionFrame, GRIP_SITE, RESET_JOINTS};
use crate::error::SimError;
use crate::mujoco::{Data, ObjectKind};
use crate::observation::{Frame, Observation, ObservationRequest};
use crate::perturb::{
    ActuationStage, ArmState, FrameSource, IkSolution, Jacobian, JointRange, Light, Lighting,
    SensorStage, look_at_point, shift_camera, shift_lighting, solve_shifted_pose,
};
use crate::ready_scene::{PERTURBED_CAMERA, ReadyScene, nominal_camera};
use crate::render::LazyDrawer;
use crate::variant::{Noise, Start, VariantStart};
use crate::{Environment, perturb};

pub const NO_OP: [f64; 7] = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, -1.0];
/// Clips every number of an action to [-1, 1].
pub fn clip(action: &[f64; 7]) -> [f64; 7] {
    action.map(|number| number.clamp(-1.0, 1.0))
}

/// Displacement of the hand by [`Episode::nudge`], m: a thousandth of a pixel in camera frames.
pub const NUDGE_M: f64 = 1e-6;
/// Damping of the least squares of a nudge, in units of the squared Jacobian, m².
const NUDGE_DAMPING: f64 = 1e-9;

const WRIST_CAMERA: &str = "robot0_eye_in_hand";

/// Digests that identify a rollout's circumstances; each is hexadecimal SHA-256.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Digests {
    /// Digest of the composed scene with its fixtures placed.
    pub scene: String,
    /// Digest of the released initial state, before any robot perturbation.
    pub init_state: String,
}

/// Campaigns and the Python environments both step through [`Conditions::step`], so that a
/// perturbed rollout has the same bits in both.
#[derive(Clone)]
pub struct Conditions {
    realisation: Realisation,
    realised: Realised,
    ik: Option<IkSolution>,
    interference: Interference,
    noise: Option<Noise>,
    settle_steps: u32,
    policy_steps: u32,
}

/// Perturbations between policy and simulator: of the frames and of the actions.
#[derive(Clone, Default)]
pub struct Interference {
    sensor: Option<SensorStage>,
    actuation: Option<ActuationStage>,
}

pub struct Episode<'a> {
    environment: &'a mut Environment,
    drawer: &'a mut LazyDrawer,
    digests: Digests,
    conditions: Conditions,
}

impl Conditions {
    pub fn begin(
        ready: &ReadyScene,
        environment: &mut Environment,
        row: &ManifestRow,
        realisation: Realisation,
    ) -> Result<Self, SimError> {
        let state = ready.state(row.init_id)?.to_vec();
        Self::begin_at(state, ready, environment, row, realisation)
    }

    /// `state` (time, qpos, qvel) replaces the row's initial state.
    pub fn begin_at(
        state: Vec<f64>,
        ready: &ReadyScene,
        environment: &mut Environment,
        row: &ManifestRow,
        realisation: Realisation,
    ) -> Result<Self, SimError> {
        Self::begin_seen_from(None, state, ready, environment, row, realisation)
    }

    /// `view` replaces the scene's pose of `agentview`.
    fn begin_seen_from(
        view: Option<WrittenPose>,
        mut state: Vec<f64>,
        ready: &ReadyScene,
        environment: &mut Environment,
        row: &ManifestRow,
        realisation: Realisation,
    ) -> Result<Self, SimError> {
        environment.set_reset_joints(RESET_JOINTS)?;
        let perturbation = &row.perturbation;
        let mut realised = Realised::default();
        let mut realise = |axis, elements| {
            realised.add(axis, perturbation.values(axis), elements);
        };
        let ik = perturbation.robot.map(|shift| displaced_arm(environment, &state, &shift));
        if let Some(ik) = &ik {
            state[1..=ARM_JOINTS].copy_from_slice(ik.joints.as_slice());
            realise(Axis::Robot, ik.joints.as_slice().to_vec());
        }
        environment.load(&state);
        if let Some(pose) = view {
            environment.place_camera(pose)?;
        }
        if let Some(shift) = &perturbation.camera {
            let nominal = nominal_camera(environment)?;
            let look_at = match view {
                None => ready.look_at,
                Some(_) => look_at_point(&nominal, &[ready.look_at]),
            };
            let moved = apply_camera(&nominal, look_at, environment, shift)?;
            realise(Axis::Camera, moved.to_vec());
        }
        if let Some(shift) = &perturbation.lighting {
            realise(Axis::Lighting, apply_lighting(ready, environment, shift));
        }
        let interference = Interference::new(row, realisation, &mut realised);
        Ok(Self {
            realisation,
            realised,
            ik,
            interference,
            noise: None,
            settle_steps: row.settle_steps,
            policy_steps: 0,
        })
    }

    /// Uses only the row's initial state and number of settling steps; ignores its perturbation.
    pub fn begin_variant(
        ready: &ReadyScene,
        environment: &mut Environment,
        row: &ManifestRow,
        variant: &VariantStart,
    ) -> Result<Self, SimError> {
        let noise = variant.begin(ready, environment, ready.state(row.init_id)?)?;
        Ok(Self {
            realisation: Realisation::Matched,
            realised: Realised::default(),
            ik: None,
            interference: Interference::default(),
            noise,
            settle_steps: row.settle_steps,
            policy_steps: 0,
        })
    }

    /// Starts a suite file's task under LIBERO-CTRL's axes: at the variant's state, posture and view,
    /// which the row perturbs.
    pub fn begin_perturbed_variant(
        ready: &ReadyScene,
        environment: &mut Environment,
        row: &ManifestRow,
        realisation: Realisation,
        variant: &VariantStart,
    ) -> Result<Self, SimError> {
        let released = ready.state(row.init_id)?;
        let noise = variant.begin(ready, environment, released)?;
        let mut state = match variant.start {
            Start::InitialState => released.to_vec(),
            Start::Reset => environment.state(),
        };
        if let Some(posture) = variant.posture {
            state[1..=ARM_JOINTS].copy_from_slice(&posture);
        }
        let view = variant.view.zip(ready.written_camera).map(|(view, pose)| view.apply(pose));
        let begun = Self::begin_seen_from(view, state, ready, environment, row, realisation)?;
        Ok(Self { noise, ..begun })
    }

    /// Lets the scene settle, since objects float in the released states.
    pub fn settle(&self, environment: &mut Environment) -> Result<(), SimError> {
        for _ in 0..self.settle_steps {
            environment.step(&NO_OP)?;
        }
        Ok(())
    }

    /// The command before the actuation axis distorts it. It is clipped into -1..1, except in the
    /// reference realisation, which like LIBERO-CTRL's released code clips the distorted action;
    /// without an actuation axis both give the same step, because the controller clips.
    /// The function is idempotent, so recorded commands can be simulated again.
    pub fn command(&self, policy_action: &[f64; 7]) -> [f64; 7] {
        match self.realisation {
            Realisation::Matched => clip(policy_action),
            Realisation::Reference => *policy_action,
        }
    }

    /// Returns true if the goal holds after the step.
    pub fn step(
        &mut self,
        environment: &mut Environment,
        policy_action: &[f64; 7],
        frame: ActionFrame,
    ) -> Result<bool, SimError> {
        let action = match frame {
            ActionFrame::Absolute if self.interference.actuation.is_some() => {
                return Err(SimError::DistortedPose);
            }
            ActionFrame::Absolute => *policy_action,
            ActionFrame::Relative => {
                let command = self.command(policy_action);
                self.interference.distort(&command)
            }
        };
        self.policy_steps += 1;
        environment.step_in(&action, frame)
    }

    /// Leaves cameras that policies do not receive unchanged. For a given camera and size, the
    /// corruption depends only on the control step.
    pub fn corrupt(&mut self, frame: &mut Frame) {
        if frame_source(&frame.camera).is_ok() {
            self.interference.corrupt(frame, self.policy_steps);
        }
    }
}

impl Interference {
    /// Adds the realised axes to `realised`.
    pub fn new(row: &ManifestRow, realisation: Realisation, realised: &mut Realised) -> Self {
        let randomness = |axis| Randomness::of(&row.id, axis, realisation);
        let mut realise = |axis, elements| {
            realised.add(axis, row.perturbation.values(axis), elements);
        };
        let sensor = row.perturbation.sensor.map(|corruption| {
            let stage = SensorStage::new(&corruption, &randomness(Axis::Sensor));
            realise(Axis::Sensor, stage.realised());
            stage
        });
        let actuation = row.perturbation.actuation.map(|distortion| {
            let rms = row.id.task().suite().demo_action_rms();
            let stage = ActuationStage::new(&distortion, rms, &randomness(Axis::Actuation));
            realise(Axis::Actuation, stage.realised());
            stage
        });
        Self { sensor, actuation }
    }

    /// Returns the action that a command causes.
    pub fn distort(&mut self, command: &[f64; 7]) -> [f64; 7] {
        match &mut self.actuation {
            Some(stage) => stage.apply(command),
            None => *command,
        }
    }

    /// `step` is the number of control steps before the frame.
    pub fn corrupt(&mut self, frame: &mut Frame, step: u32) {
        if let Some(stage) = &mut self.sensor {
            stage.apply(&mut perturb::Frame {
                source: frame_source(&frame.camera)
                    .unwrap_or_else(|_| FrameSource::other(&frame.camera)),
                step,
                width: frame.width as usize,
                height: frame.height as usize,
                rgb: &mut frame.rgb,
            });
        }
    }
}

impl<'a> Episode<'a> {
    pub(crate) fn begin(
        ready: &ReadyScene,
        environment: &'a mut Environment,
        drawer: &'a mut LazyDrawer,
        row: &ManifestRow,
        realisation: Realisation,
        variant: Option<&VariantStart>,
    ) -> Result<Self, SimError> {
        let conditions = match variant {
            None => Conditions::begin(ready, environment, row, realisation)?,
            Some(variant) if row.id.variant().is_some() => {
                Conditions::begin_variant(ready, environment, row, variant)?
            }
            Some(variant) => {
                Conditions::begin_perturbed_variant(ready, environment, row, realisation, variant)?
            }
        };
        let init_id = usize::from(row.init_id);
        let digests = Digests {
            scene: ready.digest.clone(),
            init_state: ready.states.digest(init_id).expect("the state was loaded"),
        };
        Ok(Self { environment, drawer, digests, conditions })
    }

    pub fn digests(&self) -> &Digests {
        &self.digests
    }

    pub fn realised(&self) -> &Realised {
        &self.conditions.realised
    }

    pub fn ik(&self) -> Option<&IkSolution> {
        self.conditions.ik.as_ref()
    }

    pub fn settle(&mut self) -> Result<(), SimError> {
        self.conditions.settle(self.environment)
    }

    pub fn command(&self, policy_action: &[f64; 7]) -> [f64; 7] {
        self.conditions.command(policy_action)
    }

    /// Takes a policy's action or its command; returns true if the goal holds after the step.
    pub fn step(&mut self, policy_action: &[f64; 7]) -> Result<bool, SimError> {
        let conditions = &mut self.conditions;
        conditions.step(self.environment, policy_action, ActionFrame::Relative)
    }

    /// Lets the policy see the nominal scene, and its actions reach the robot unchanged.
    /// Past effects on the state remain, including a displaced arm.
    pub fn lift(&mut self) {
        self.environment.restore_appearance();
        self.conditions.interference = Interference::default();
        self.conditions.noise = None;
    }

    /// Moves the point between the fingertips up by [`NUDGE_M`] with the smallest change of the
    /// joints. Nothing else changes, and observations show the new pose from the next step on. A
    /// rollout whose outcome changes because of the nudge is chaotic at this point.
    pub fn nudge(&mut self) {
        let site = self.environment.model().id(ObjectKind::Site, GRIP_SITE);
        let site = site.expect("the controller requires the site");
        let (model, data) = self.environment.model_and_data();
        let jacobian = arm_state(model, data, site).jacobian;
        let jacobian = jacobian.fixed_rows::<3>(0).into_owned();
        // Invertible in every posture; the damping is negligible beside the matrix's elements.
        let damped = jacobian * jacobian.transpose() + Matrix3::identity() * NUDGE_DAMPING;
        let inverse = damped.try_inverse().expect("positive definite");
        let change = jacobian.transpose() * inverse * nalgebra::Vector3::new(0.0, 0.0, NUDGE_M);
        for (angle, change) in data.qpos_mut(model).iter_mut().zip(change.iter()) {
            *angle += change;
        }
    }

    /// Includes the effects of all perturbations. For a given camera and size, the pixels depend
    /// only on the control step, not on how often and at which sizes the scene was drawn before.
    pub fn observe(&mut self, request: &ObservationRequest) -> Result<Observation, SimError> {
        let mut frames = Vec::with_capacity(request.cameras.len());
        for camera in &request.cameras {
            frame_source(&camera.name)?;
            let drawer = self.drawer.open()?;
            let (width, height) = (camera.width, camera.height);
            let mut frame = self.environment.draw(drawer, &camera.name, width, height)?;
            self.conditions.corrupt(&mut frame);
            if let Some(noise) = &mut self.conditions.noise {
                noise.corrupt(&mut frame, self.environment.control_steps())?;
            }
            frames.push(frame);
        }
        let privileged =
            if request.privileged { Some(self.environment.privileged()?) } else { None };
        Ok(Observation { frames, robot: self.environment.robot_state(), privileged })
    }

    pub fn environment(&mut self) -> &mut Environment {
        self.environment
    }
}

fn frame_source(camera: &str) -> Result<FrameSource, SimError> {
    match camera {
        PERTURBED_CAMERA => Ok(FrameSource::Agentview),
        WRIST_CAMERA => Ok(FrameSource::Wrist),
        other => Err(SimError::Camera(other.to_owned())),
    }
}

fn apply_camera(
    nominal: &perturb::CameraPose,
    look_at: [f64; 3],
    environment: &mut Environment,
    shift: &benchmark::CameraShift,
) -> Result<[f64; 7], SimError> {
    let pose = shift_camera(nominal, look_at, shift);
    let model = environment.model_mut();
    let camera = model.id(ObjectKind::Camera, PERTURBED_CAMERA)?;
    model.cam_pos_mut()[camera * 3..][..3].copy_from_slice(&pose.position);
    model.cam_quat_mut()[camera * 4..][..4].copy_from_slice(&pose.quat_wxyz);
    let ([x, y, z], [qw, qx, qy, qz]) = (pose.position, pose.quat_wxyz);
    Ok([x, y, z, qw, qx, qy, qz])
}

fn apply_lighting(
    ready: &ReadyScene,
    environment: &mut Environment,
    shift: &benchmark::LightingShift,
) -> Vec<f64> {
    let look_at = ready.look_at;
    let model = environment.model_mut();
    let to_doubles = |values: &[f32], light: usize| -> [f64; 3] {
        std::array::from_fn(|channel| f64::from(values[light * 3 + channel]))
    };
    let triple = |values: &[f64], light: usize| -> [f64; 3] {
        std::array::from_fn(|axis| values[light * 3 + axis])
    };
    let lights = (0..model.count(ObjectKind::Light)).map(|light| Light {
        position: triple(model.light_pos(), light),
        direction: triple(model.light_dir(), light),
        diffuse: to_doubles(model.light_diffuse(), light),
        specular: to_doubles(model.light_specular(), light),
    });
    let nominal = Lighting {
        lights: lights.collect(),
        headlight_ambient: model.headlight_ambient().map(f64::from),
    };
    let shifted = shift_lighting(&nominal, look_at, shift);
    let mut realised = shifted.headlight_ambient.to_vec();
    model.set_headlight_ambient(shifted.headlight_ambient.map(|channel| channel as f32));
    for (index, light) in shifted.lights.iter().enumerate() {
        let at = index * 3;
        model.light_pos_mut()[at..][..3].copy_from_slice(&light.position);
        model.light_dir_mut()[at..][..3].copy_from_slice(&light.direction);
        let to_singles = |colour: [f64; 3]| colour.map(|channel| channel as f32);
        model.light_diffuse_mut()[at..][..3].copy_from_slice(&to_singles(light.diffuse));
        model.light_specular_mut()[at..][..3].copy_from_slice(&to_singles(light.specular));
        for part in [light.position, light.direction, light.diffuse, light.specular] {
            realised.extend(part);
        }
    }
    realised
}

fn displaced_arm(environment: &mut Environment, state: &[f64], shift: &RobotShift) -> IkSolution {
    environment.load(state);
    let nominal = perturb::JointVector::from_column_slice(&state[1..=ARM_JOINTS]);
    let range = environment.model().jnt_range();
    let ranges: [JointRange; ARM_JOINTS] =
        std::array::from_fn(|joint| [range[joint * 2], range[joint * 2 + 1]]);
    let site = environment
        .model()
        .id(ObjectKind::Site, GRIP_SITE)
        .expect("the controller requires the site");
    let kinematics = |joints: &perturb::JointVector| {
        let (model, data) = environment.model_and_data();
        data.qpos_mut(model)[..ARM_JOINTS].copy_from_slice(joints.as_slice());
        data.kinematics(model);
        data.com_pos(model);
        arm_state(model, data, site)
    };
    solve_shifted_pose(kinematics, &nominal, &ranges, shift)
}

fn arm_state(model: &crate::mujoco::Model, data: &Data, site: usize) -> ArmState {
    let nv = model.nv();
    let (mut pos, mut rot) = (vec![0.0; 3 * nv], vec![0.0; 3 * nv]);
    data.site_jacobian(model, site, &mut pos, &mut rot);
    ArmState {
        position: nalgebra::Vector3::from_column_slice(&data.site_xpos(model)[site * 3..][..3]),
        rotation: Matrix3::from_row_slice(&data.site_xmat(model)[site * 9..][..9]),
        jacobian: Jacobian::from_fn(|row, joint| {
            let rows = if row < 3 { &pos } else { &rot };
            rows[(row % 3) * nv + joint]
        }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_numbers_outside_the_range_are_clipped() {
        let inside = [1.0, -1.0, 0.5, 0.0, 0.0, 0.0, -1.0];
        assert_eq!(clip(&inside), inside);
        let outside = [1.5, -1.0, 0.5, 0.0, 0.0, 0.0, -3.0];
        assert_eq!(clip(&outside), inside);
    }
}
