//! The robot axis: an initial arm posture with a displaced end-effector, by damped least squares.
//! The kinematics are a parameter, so this module does not depend on MuJoCo.

use benchmark::RobotShift;
use nalgebra::{Matrix3, Matrix6, Rotation3, SMatrix, SVector, UnitQuaternion, Vector3, Vector6};

pub const JOINTS: usize = 7;
/// Damping λ of the least squares.
const DAMPING: f64 = 0.08;
/// Number of iterations after which the search stops with the last posture.
const MAX_ITERATIONS: u32 = 200;
const POSITION_TOLERANCE_M: f64 = 2e-4;
const ROTATION_TOLERANCE_RAD: f64 = 2e-3;
const CLAMPED_RAD: f64 = 1e-6;

/// Joint angles, rad.
pub type JointVector = SVector<f64, JOINTS>;
/// World-frame velocity per joint velocity: translation rows, then rotation rows.
pub type Jacobian = SMatrix<f64, 6, JOINTS>;
/// Lower and upper limit of a joint, rad.
pub type JointRange = [f64; 2];

/// State of the end-effector at one posture of the arm, world frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ArmState {
    /// Position of the site between the fingertips, m.
    pub position: Vector3<f64>,
    /// Orientation, `world_from_site`.
    pub rotation: Matrix3<f64>,
    pub jacobian: Jacobian,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct IkSolution {
    pub joints: JointVector,
    pub residual_mm: f64,
    pub residual_deg: f64,
    pub clamped_joints: u32,
    pub iterations: u32,
}

/// Displaces the pose at `nominal` by `shift`: translated in the world frame, and rotated in place
/// by a rotation vector applied on the left. Joint limits may leave a residual.
pub fn solve_shifted_pose(
    mut kinematics: impl FnMut(&JointVector) -> ArmState,
    nominal: &JointVector,
    ranges: &[JointRange; JOINTS],
    shift: &RobotShift,
) -> IkSolution {
    let target = Target::new(&kinematics(nominal), shift);
    let mut joints = *nominal;
    let mut state = kinematics(&joints);
    let mut iterations = 0;
    while iterations < MAX_ITERATIONS {
        let error = target.error(&state);
        let is_position_met = error.fixed_rows::<3>(0).norm() < POSITION_TOLERANCE_M;
        if is_position_met && error.fixed_rows::<3>(3).norm() < ROTATION_TOLERANCE_RAD {
            break;
        }
        let step = joints + damped_step(&state.jacobian, &error);
        joints = JointVector::from_fn(|i, _| step[i].clamp(ranges[i][0], ranges[i][1]));
        state = kinematics(&joints);
        iterations += 1;
    }
    let error = target.error(&state);
    let is_at_limit = |&(q, range): &(&f64, &JointRange)| {
        range.iter().any(|limit| (q - limit).abs() < CLAMPED_RAD)
    };
    IkSolution {
        joints,
        residual_mm: error.fixed_rows::<3>(0).norm() * 1e3,
        residual_deg: error.fixed_rows::<3>(3).norm().to_degrees(),
        clamped_joints: joints.iter().zip(ranges).filter(is_at_limit).count() as u32,
        iterations,
    }
}

struct Target {
    position: Vector3<f64>,
    rotation: Matrix3<f64>,
}

impl Target {
    fn new(nominal: &ArmState, shift: &RobotShift) -> Self {
        let moved = Vector3::new(shift.eef_dx_m, shift.eef_dy_m, shift.eef_dz_m);
        let turn = Vector3::new(shift.eef_rx_deg, shift.eef_ry_deg, shift.eef_rz_deg);
        let turn = turn.map(f64::to_radians);
        Self {
            position: nominal.position + moved,
            rotation: Rotation3::from_scaled_axis(turn).matrix() * nominal.rotation,
        }
    }

    /// Returns the position error, m, and then the orientation error as a rotation vector, rad.
    fn error(&self, state: &ArmState) -> Vector6<f64> {
        let position = self.position - state.position;
        let rotation = rotation_vector(&(self.rotation * state.rotation.transpose()));
        Vector6::new(position.x, position.y, position.z, rotation.x, rotation.y, rotation.z)
    }
}

/// Returns Jᵀ (J Jᵀ + λ² I)⁻¹ e. The bracket is positive definite for any J.
fn damped_step(jacobian: &Jacobian, error: &Vector6<f64>) -> JointVector {
    let damped = jacobian * jacobian.transpose() + Matrix6::identity() * (DAMPING * DAMPING);
    let solved = damped
        .cholesky()
        .expect("a Gram matrix plus a positive diagonal is positive definite")
        .solve(error);
    jacobian.transpose() * solved
}

fn rotation_vector(rotation: &Matrix3<f64>) -> Vector3<f64> {
    // The arc cosine of the trace would lose half the digits of a small angle.
    let rotation = Rotation3::from_matrix_unchecked(*rotation);
    UnitQuaternion::from_rotation_matrix(&rotation).scaled_axis()
}

#[cfg(test)]
mod chain;

#[cfg(test)]
mod tests {
    use super::chain::{arm, nominal_arm};
    use super::*;

    const WIDE: [JointRange; JOINTS] = [[-3.0, 3.0]; JOINTS];

    #[test]
    fn a_reachable_pose_is_met_within_tolerance() {
        let shift = RobotShift::from([0.03, -0.02, 0.02, 5.0, -3.0, 8.0]);
        let solution = solve_shifted_pose(arm, &nominal_arm(), &WIDE, &shift);
        assert!(solution.residual_mm < 0.2, "{solution:?}");
        assert!(solution.residual_deg.to_radians() < 2e-3, "{solution:?}");
        assert_eq!(solution.clamped_joints, 0);
    }

    #[test]
    fn without_displacement_the_arm_keeps_its_posture() {
        let shift = RobotShift::default();
        let solution = solve_shifted_pose(arm, &nominal_arm(), &WIDE, &shift);
        assert_eq!(solution.joints, nominal_arm());
        assert_eq!(solution.iterations, 0);
    }

    #[test]
    fn joints_stop_at_their_limits_with_a_residual_error() {
        let mut ranges = WIDE;
        for (range, q) in ranges.iter_mut().zip(nominal_arm().iter()) {
            *range = [q - 0.01, q + 0.01];
        }
        let shift = RobotShift::from([0.2, 0.0, 0.2, 0.0, 0.0, 0.0]);
        let solution = solve_shifted_pose(arm, &nominal_arm(), &ranges, &shift);
        assert!(solution.clamped_joints > 0, "{solution:?}");
        assert!(solution.residual_mm > 10.0, "{solution:?}");
        assert_eq!(solution.iterations, MAX_ITERATIONS);
    }
}
