//! Arm for tests of this module and for `tests/matched.rs`: a chain of links, each 0.2 m up and
//! 0.05 m sideways, which turn about alternating axes.

use nalgebra::{Matrix3, Rotation3, Vector3, Vector6};

use super::{ArmState, JOINTS, Jacobian, JointVector};

pub(crate) fn nominal_arm() -> JointVector {
    JointVector::from([0.1, 0.4, -0.2, 0.9, 0.3, -0.6, 0.2])
}

pub(crate) fn arm(joints: &JointVector) -> ArmState {
    let mut position = Vector3::zeros();
    let mut rotation = Matrix3::identity();
    let mut pivots = Vec::new();
    for i in 0..JOINTS {
        let local = if i % 2 == 0 { Vector3::z_axis() } else { Vector3::y_axis() };
        pivots.push((position, rotation * local.into_inner()));
        rotation *= Rotation3::from_axis_angle(&local, joints[i]).matrix();
        position += rotation * Vector3::new(0.05, 0.0, 0.2);
    }
    let columns: Vec<Vector6<f64>> = pivots
        .iter()
        .map(|(pivot, axis)| {
            let linear = axis.cross(&(position - pivot));
            Vector6::new(linear.x, linear.y, linear.z, axis.x, axis.y, axis.z)
        })
        .collect();
    ArmState { position, rotation, jacobian: Jacobian::from_columns(&columns) }
}
