use benchmark::Privileged;

#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct ObservationRequest {
    /// Frames to render, in this order.
    pub cameras: Vec<CameraRequest>,
    pub privileged: bool,
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct CameraRequest {
    /// `agentview` or `robot0_eye_in_hand`; other cameras are refused.
    pub name: String,
    pub width: u32,
    pub height: u32,
}

/// Observation of a policy. As in LIBERO's `env.step`, after an initial state was loaded frames and
/// end-effector poses lag 4 ms behind the end of the control step, and joint readings 2 ms.
#[derive(Debug, Clone)]
pub struct Observation {
    /// Frames in the order of the request, with sensor perturbations applied.
    pub frames: Vec<Frame>,
    pub robot: RobotState,
    pub privileged: Option<Privileged>,
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Frame {
    pub camera: String,
    pub width: u32,
    pub height: u32,
    /// Red, green, blue, 8 bits each, row by row; row 0 is the picture's bottom.
    pub rgb: Vec<u8>,
}

#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct RobotState {
    /// Position of the site between the fingertips, world frame, m.
    pub eef_pos: [f64; 3],
    /// Orientation of the hand body, world frame, x y z w.
    pub eef_quat_xyzw: [f64; 4],
    /// Orientation of the hand body as axis times angle, rad.
    pub eef_axis_angle: [f64; 3],
    /// Orientation of the hand body as a matrix, row by row.
    pub eef_rotation: [f64; 9],
    /// Positions of the arm joints, rad.
    pub joint_pos: [f64; 7],
    pub joint_vel: [f64; 7],
    pub gripper_pos: [f64; 2],
    pub gripper_vel: [f64; 2],
}

/// Axis times angle, rad. The angle is twice the arc cosine of w, and so exceeds π if w is
/// negative (robosuite's `quat2axisangle`, with which policies were trained).
pub fn axis_angle_of(quat_xyzw: [f64; 4]) -> [f64; 3] {
    let [x, y, z, w] = quat_xyzw;
    let w = w.clamp(-1.0, 1.0);
    let sin = (1.0 - w * w).sqrt();
    if sin == 0.0 {
        return [0.0; 3];
    }
    let factor = 2.0 * w.acos() / sin;
    [x * factor, y * factor, z * factor]
}

#[cfg(test)]
mod tests {
    use super::axis_angle_of;

    #[test]
    fn axis_angles_may_exceed_half_a_turn() {
        let half = std::f64::consts::FRAC_1_SQRT_2;
        let near = axis_angle_of([half, 0.0, 0.0, half]);
        assert!((near[0] - std::f64::consts::FRAC_PI_2).abs() < 1e-12);
        let far = axis_angle_of([half, 0.0, 0.0, -half]);
        assert!((far[0] - 1.5 * std::f64::consts::PI).abs() < 1e-12);
        assert_eq!(axis_angle_of([0.0, 0.0, 0.0, 1.0]), [0.0; 3]);
    }
}
