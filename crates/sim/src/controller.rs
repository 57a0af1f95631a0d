//! Controllers of the robot: operational-space control of the arm (OSC_POSE) and the gripper's
//! position ramp, with robosuite 1.4.0's configuration for LIBERO. An action is seven numbers in
//! -1..1: end-effector translation, rotation, gripper.
//!
//! The arithmetic follows robosuite's order and precision where results depend on it, including one
//! computation in single precision (`rotation_of`).

use nalgebra::{Matrix3, SMatrix, SVector, Vector3};
use scene::rotation::single_precision_matrix;

use crate::error::SimError;
use crate::mujoco::{Data, Model, ObjectKind};

pub const ARM_JOINTS: usize = 7;
pub const GRIP_SITE: &str = "gripper0_grip_site";
/// Angles at a reset, rad (`MountedPanda.init_qpos`). Robots of LIBERO-Plus have others.
pub const RESET_JOINTS: [f64; ARM_JOINTS] =
    [0.0, -1.61037389e-01, 0.00, -2.44459747e00, 0.00, 2.22675220e00, std::f64::consts::FRAC_PI_4];
/// Simulation steps of 2 ms per control step: actions are executed at 20 Hz.
pub const SUBSTEPS: usize = 25;

/// Goal displacement of a full-scale action: m, rad (`osc_pose.json`).
const TRANSLATION_SCALE: f64 = 0.05;
const ROTATION_SCALE: f64 = 0.5;
/// Stiffness of the end-effector's pose, 1/s²; the pose is critically damped.
const STIFFNESS: f64 = 150.0;
/// Stiffness of the null-space posture, 1/s²; the posture is critically damped.
const POSTURE_STIFFNESS: f64 = 10.0;
/// Change of a finger's position per simulation step, as a share of half its range.
const GRIPPER_RAMP: f64 = 0.01;

type ArmVector = SVector<f64, ARM_JOINTS>;
type ArmMatrix = SMatrix<f64, ARM_JOINTS, ARM_JOINTS>;

#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum ActionFrame {
    /// Displacement, as a fraction of the largest displacement: 0.05 m, 0.5 rad (`use_delta`).
    #[default]
    Relative,
    /// Pose in the world frame: m, and axis times angle, rad.
    Absolute,
}

#[derive(Clone)]
pub struct Controller {
    site: usize,
    torque_limits: [[f64; 2]; ARM_JOINTS],
    finger_range: [[f64; 2]; 2],
    /// Robosuite still uses this in the first simulation step after an initial state is loaded.
    reset_arm: ArmState,
    uses_reset_arm: bool,
    last_pose: (Vector3<f64>, Matrix3<f64>),
    goal_pos: Vector3<f64>,
    goal_orientation: Matrix3<f64>,
    gripper: [f64; 2],
    buffers: Buffers,
}

/// Buffers for quantities that MuJoCo computes over all degrees of freedom.
#[derive(Clone)]
struct Buffers {
    inertia: Vec<f64>,
    jacobian_pos: Vec<f64>,
    jacobian_rot: Vec<f64>,
}

#[derive(Clone)]
struct ArmState {
    pos: Vector3<f64>,
    orientation: Matrix3<f64>,
    jacobian: SMatrix<f64, 6, ARM_JOINTS>,
    joint_pos: ArmVector,
    joint_vel: ArmVector,
    inertia: ArmMatrix,
    bias: ArmVector,
}

impl Controller {
    /// `reset` is the model's state at the reset pose, after [`Data::forward`].
    pub fn new(model: &Model, reset: &Data) -> Result<Self, SimError> {
        let site = model.id(ObjectKind::Site, GRIP_SITE)?;
        for index in 0..ARM_JOINTS {
            // The code below relies on the arm's joints coming first, which holds in every LIBERO
            // model.
            let id = model.id(ObjectKind::Joint, &format!("robot0_joint{}", index + 1))?;
            assert_eq!(id, index, "the arm's joints come first");
        }
        let range = |actuator: usize| -> [f64; 2] {
            let range = &model.actuator_ctrlrange()[actuator * 2..];
            [range[0], range[1]]
        };
        let mut buffers = Buffers::new(model);
        let reset_arm = buffers.read_arm(model, reset, site);
        Ok(Self {
            site,
            torque_limits: std::array::from_fn(range),
            finger_range: [range(ARM_JOINTS), range(ARM_JOINTS + 1)],
            uses_reset_arm: true,
            last_pose: (reset_arm.pos, reset_arm.orientation),
            goal_pos: reset_arm.pos,
            goal_orientation: reset_arm.orientation,
            gripper: [0.0; 2],
            buffers,
            reset_arm,
        })
    }

    /// Position, m, and rotation matrix, row by row, in the world frame.
    pub fn last_pose(&self) -> ([f64; 3], [f64; 9]) {
        let (pos, matrix) = &self.last_pose;
        let row_by_row = std::array::from_fn(|index| matrix[(index / 3, index % 3)]);
        ((*pos).into(), row_by_row)
    }

    pub fn reset(&mut self) {
        self.reset_arm();
        self.gripper = [0.0; 2];
    }

    /// Resets the arm's controller. The gripper's ramp keeps its position, which robosuite stores
    /// with its model; the goal's position is set with the next action.
    pub fn reset_arm(&mut self) {
        self.last_pose = (self.reset_arm.pos, self.reset_arm.orientation);
        self.goal_orientation = self.reset_arm.orientation;
        self.uses_reset_arm = true;
    }

    /// `data` must be the state after [`Data::step1`].
    pub fn set_goal(&mut self, model: &Model, data: &Data, action: &[f64; 7], frame: ActionFrame) {
        if frame == ActionFrame::Absolute {
            let [x, y, z, axis_angle @ ..] = *action;
            self.goal_pos = Vector3::new(x, y, z);
            self.goal_orientation = match Vector3::new(axis_angle[0], axis_angle[1], axis_angle[2])
            {
                zero if zero == Vector3::zeros() => Matrix3::identity(),
                rotation => rotation_of(rotation),
            };
            return;
        }
        let delta: [f64; 6] = std::array::from_fn(|axis| {
            let scale = if axis < 3 { TRANSLATION_SCALE } else { ROTATION_SCALE };
            action[axis].clamp(-1.0, 1.0) * scale
        });
        let (pos, orientation) = if self.uses_reset_arm {
            (self.reset_arm.pos, self.reset_arm.orientation)
        } else {
            site_pose(model, data, self.site)
        };
        self.goal_pos = pos + Vector3::new(delta[0], delta[1], delta[2]);
        let rotation = Vector3::new(delta[3], delta[4], delta[5]);
        // An action without a rotation keeps the previous goal rather than the arm's orientation.
        if rotation != Vector3::zeros() {
            self.goal_orientation = rotation_of(rotation) * orientation;
        }
    }

    /// `data` must be the state after [`Data::step1`]. False if a matrix has no inverse.
    #[must_use]
    pub fn run(&mut self, model: &Model, data: &mut Data, action: &[f64; 7]) -> bool {
        let arm = if std::mem::take(&mut self.uses_reset_arm) {
            ArmState { bias: arm_vector(data.qfrc_bias(model)), ..self.reset_arm.clone() }
        } else {
            self.buffers.read_arm(model, data, self.site)
        };
        self.last_pose = (arm.pos, arm.orientation);
        let Some(torques) = self.torques(&arm) else {
            return false;
        };
        let ramp = GRIPPER_RAMP * sign(action[6]);
        self.gripper[0] = (self.gripper[0] - ramp).clamp(-1.0, 1.0);
        self.gripper[1] = (self.gripper[1] + ramp).clamp(-1.0, 1.0);
        let ctrl = data.ctrl_mut(model);
        for (joint, [low, high]) in self.torque_limits.iter().enumerate() {
            ctrl[joint] = torques[joint].clamp(*low, *high);
        }
        for (finger, [low, high]) in self.finger_range.iter().enumerate() {
            let (bias, weight) = (0.5 * (high + low), 0.5 * (high - low));
            ctrl[ARM_JOINTS + finger] = bias + weight * self.gripper[finger];
        }
        true
    }

    /// Khatib's operational-space law, position and orientation decoupled, plus a posture.
    fn torques(&self, arm: &ArmState) -> Option<ArmVector> {
        let damping = 2.0 * STIFFNESS.sqrt();
        let velocity = arm.jacobian * arm.joint_vel;
        let force = (self.goal_pos - arm.pos) * STIFFNESS - velocity.fixed_rows::<3>(0) * damping;
        let torque = orientation_error(&self.goal_orientation, &arm.orientation) * STIFFNESS
            - velocity.fixed_rows::<3>(3) * damping;

        let inertia_inverse = arm.inertia.try_inverse()?;
        let full = arm.jacobian * inertia_inverse * arm.jacobian.transpose();
        let lambda_full = full.try_inverse()?;
        let lambda_pos = full.fixed_view::<3, 3>(0, 0).into_owned().try_inverse()?;
        let lambda_rot = full.fixed_view::<3, 3>(3, 3).into_owned().try_inverse()?;
        let mut wrench = SVector::<f64, 6>::zeros();
        wrench.fixed_rows_mut::<3>(0).copy_from(&(lambda_pos * force));
        wrench.fixed_rows_mut::<3>(3).copy_from(&(lambda_rot * torque));

        let posture_damping = 2.0 * POSTURE_STIFFNESS.sqrt();
        let posture_error = self.reset_arm.joint_pos - arm.joint_pos;
        let posture =
            arm.inertia * (posture_error * POSTURE_STIFFNESS - arm.joint_vel * posture_damping);
        let inverse_jacobian = inertia_inverse * arm.jacobian.transpose() * lambda_full;
        let null_space = ArmMatrix::identity() - inverse_jacobian * arm.jacobian;
        Some(arm.jacobian.transpose() * wrench + arm.bias + null_space.transpose() * posture)
    }
}

impl Buffers {
    fn new(model: &Model) -> Self {
        let nv = model.nv();
        Self {
            inertia: vec![0.0; nv * nv],
            jacobian_pos: vec![0.0; 3 * nv],
            jacobian_rot: vec![0.0; 3 * nv],
        }
    }

    fn read_arm(&mut self, model: &Model, data: &Data, site: usize) -> ArmState {
        let nv = model.nv();
        data.full_inertia(model, &mut self.inertia);
        data.site_jacobian(model, site, &mut self.jacobian_pos, &mut self.jacobian_rot);
        let (pos, orientation) = site_pose(model, data, site);
        ArmState {
            pos,
            orientation,
            jacobian: SMatrix::from_fn(|row, joint| {
                if row < 3 {
                    self.jacobian_pos[row * nv + joint]
                } else {
                    self.jacobian_rot[(row - 3) * nv + joint]
                }
            }),
            joint_pos: arm_vector(data.qpos(model)),
            joint_vel: arm_vector(data.qvel(model)),
            inertia: ArmMatrix::from_fn(|row, column| self.inertia[row * nv + column]),
            bias: arm_vector(data.qfrc_bias(model)),
        }
    }
}

fn arm_vector(values: &[f64]) -> ArmVector {
    ArmVector::from_column_slice(&values[..ARM_JOINTS])
}

fn site_pose(model: &Model, data: &Data, site: usize) -> (Vector3<f64>, Matrix3<f64>) {
    (
        Vector3::from_row_slice(&data.site_xpos(model)[site * 3..][..3]),
        Matrix3::from_row_slice(&data.site_xmat(model)[site * 9..][..9]),
    )
}

fn orientation_error(goal: &Matrix3<f64>, current: &Matrix3<f64>) -> Vector3<f64> {
    let cross = |axis: usize| {
        let (from, to): (Vector3<f64>, Vector3<f64>) =
            (current.column(axis).into_owned(), goal.column(axis).into_owned());
        from.cross(&to)
    };
    (cross(0) + cross(1) + cross(2)) * 0.5
}

/// Returns the sign as NumPy does: zero for zero.
fn sign(value: f64) -> f64 {
    if value == 0.0 { 0.0 } else { value.signum() }
}

/// Rotation about `vector` by its length, rad, in single precision like robosuite's
/// `transform_utils.quat2mat`, which moves goals by up to 1e-7 rad.
fn rotation_of(vector: Vector3<f64>) -> Matrix3<f64> {
    let angle = vector.dot(&vector).sqrt();
    let axis = vector / angle;
    let (sin, cos) = ((angle / 2.0).sin(), (angle / 2.0).cos());
    let rows = single_precision_matrix([cos, axis.x * sin, axis.y * sin, axis.z * sin]);
    Matrix3::from_fn(|row, column| rows[row][column])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_rotation_is_exact_to_single_precision() {
        let vector = Vector3::new(0.1, -0.3, 0.2);
        let exact = nalgebra::Rotation3::from_scaled_axis(vector);
        let difference = (rotation_of(vector) - exact.matrix()).abs().max();
        assert!(difference < 2e-7, "{difference}");
        assert!(
            difference > 1e-12,
            "the rotation is not in single precision like robosuite's: {difference}"
        );
    }

    #[test]
    fn the_orientation_error_is_the_small_rotation_between_two_frames() {
        let current = *nalgebra::Rotation3::from_euler_angles(0.3, 0.2, -0.4).matrix();
        let small = Vector3::new(1e-4, -2e-4, 3e-4);
        let goal = nalgebra::Rotation3::from_scaled_axis(small) * current;
        assert!((orientation_error(&goal, &current) - small).norm() < 1e-7);
    }
}
