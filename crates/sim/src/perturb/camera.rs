//! The camera axis: turns the `agentview` camera about its look-at point, changes its distance from
//! that point, and moves the point in the horizontal plane. The wrist camera is never moved.

use benchmark::CameraShift;
use nalgebra::{Matrix3, Quaternion, Rotation3, UnitQuaternion, Vector3};

/// Distance of the look-at point if the scene does not determine it, m.
const FALLBACK_DISTANCE_M: f64 = 1.1;
/// Least distance of a valid look-at point, which must lie in front of the camera, m.
const NEAREST_DISTANCE_M: f64 = 0.2;

/// Pose of a fixed camera, world frame. The camera looks along −z, and y is up in the picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CameraPose {
    pub position: [f64; 3],
    /// Orientation, unit quaternion w x y z, as MuJoCo's `cam_quat`.
    pub quat_wxyz: [f64; 4],
}

/// Returns the point on the nominal optical axis nearest to the mean of the movable objects'
/// centres of mass (`xipos`) in the task's initial state 0. If that point is nearer than 0.2 m or
/// behind the camera, or if nothing is movable, returns the point 1.1 m ahead. World frame, m.
pub fn look_at_point(nominal: &CameraPose, centres_of_mass: &[[f64; 3]]) -> [f64; 3] {
    let position = Vector3::from(nominal.position);
    let [w, x, y, z] = nominal.quat_wxyz;
    let rotation = UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z));
    let forward = -(rotation * Vector3::z());
    let sum: Vector3<f64> = centres_of_mass.iter().map(|&c| Vector3::from(c)).sum();
    let mean = sum / centres_of_mass.len() as f64;
    let distance = (mean - position).dot(&forward);
    // Without movable objects the mean is 0/0, and the distance is NaN.
    let is_usable = distance.is_finite() && distance >= NEAREST_DISTANCE_M;
    let distance = if is_usable { distance } else { FALLBACK_DISTANCE_M };
    (position + distance * forward).into()
}

/// The nominal spherical coordinates about `look_at`, shifted, give the position about the shifted
/// look-at point, at which the camera looks with world z up.
pub fn shift_camera(nominal: &CameraPose, look_at: [f64; 3], shift: &CameraShift) -> CameraPose {
    let look_at = Vector3::from(look_at);
    let offset = Vector3::from(nominal.position) - look_at;
    let nominal_distance = offset.norm();
    let direction = offset / nominal_distance;
    let azimuth = direction.y.atan2(direction.x) + shift.d_azimuth_deg.to_radians();
    let elevation = direction.z.asin() + shift.d_elevation_deg.to_radians();
    let distance = nominal_distance + shift.d_distance_m;

    let target = look_at + Vector3::new(shift.d_lookat_x_m, shift.d_lookat_y_m, 0.0);
    let direction = Vector3::new(
        elevation.cos() * azimuth.cos(),
        elevation.cos() * azimuth.sin(),
        elevation.sin(),
    );
    let position = target + distance * direction;
    CameraPose { position: position.into(), quat_wxyz: looking_at(position, target) }
}

fn looking_at(position: Vector3<f64>, target: Vector3<f64>) -> [f64; 4] {
    let backward = (position - target).normalize();
    let right = Vector3::z().cross(&backward).normalize();
    let up = backward.cross(&right);
    let axes = Matrix3::from_columns(&[right, up, backward]);
    let rotation = Rotation3::from_matrix_unchecked(axes);
    let q = UnitQuaternion::from_rotation_matrix(&rotation);
    [q.w, q.i, q.j, q.k]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns a camera at (1, 0, 1) that looks at the origin.
    fn nominal() -> CameraPose {
        let position = Vector3::new(1.0, 0.0, 1.0);
        CameraPose { position: position.into(), quat_wxyz: looking_at(position, Vector3::zeros()) }
    }

    #[test]
    fn look_at_point_lies_on_the_optical_axis() {
        let point = look_at_point(&nominal(), &[[0.1, 0.2, 0.1], [0.1, -0.2, 0.1]]);
        for (value, expected) in point.into_iter().zip([0.1, 0.0, 0.1]) {
            assert!((value - expected).abs() < 1e-12, "{point:?}");
        }
    }

    #[test]
    fn objects_behind_the_camera_or_absent_give_the_fallback_distance() {
        let expected = look_at_point(&nominal(), &[]);
        let distance = (Vector3::from(expected) - Vector3::new(1.0, 0.0, 1.0)).norm();
        assert!((distance - FALLBACK_DISTANCE_M).abs() < 1e-12);
        assert_eq!(look_at_point(&nominal(), &[[5.0, 0.0, 5.0]]), expected);
    }

    #[test]
    fn azimuth_turns_the_camera_about_the_look_at_point() {
        let shift = CameraShift { d_azimuth_deg: 90.0, ..CameraShift::default() };
        let shifted = shift_camera(&nominal(), [0.0; 3], &shift);
        for (value, expected) in shifted.position.into_iter().zip([0.0, 1.0, 1.0]) {
            assert!((value - expected).abs() < 1e-12, "{shifted:?}");
        }
    }
}
