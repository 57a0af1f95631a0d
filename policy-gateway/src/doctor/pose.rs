//! Conversions between the representations of an orientation that policies use. Pure functions.

/// A unit quaternion, x y z w.
pub type Quaternion = [f64; 4];

/// Returns axis times angle, rad, with the angle in 0..2π, so that a quaternion and its antipode
/// have different vectors, as in robosuite.
pub fn axis_angle([x, y, z, w]: Quaternion) -> [f64; 3] {
    let sine = (x * x + y * y + z * z).sqrt();
    if sine == 0.0 {
        return [0.0; 3];
    }
    let angle = 2.0 * sine.atan2(w);
    [x, y, z].map(|number| number / sine * angle)
}

/// Returns the quaternion of an axis-angle; its w is negative for angles above π.
pub fn from_axis_angle(rotation: [f64; 3]) -> Quaternion {
    let [x, y, z] = rotation;
    let angle = (x * x + y * y + z * z).sqrt();
    if angle == 0.0 {
        return [0.0, 0.0, 0.0, 1.0];
    }
    let (sine, cosine) = (angle / 2.0).sin_cos();
    let [x, y, z] = rotation.map(|number| number / angle * sine);
    [x, y, z, cosine]
}

/// Returns the rotation matrix in row-major order.
pub(crate) fn matrix([x, y, z, w]: Quaternion) -> [f64; 9] {
    [
        1.0 - 2.0 * (y * y + z * z),
        2.0 * (x * y - z * w),
        2.0 * (x * z + y * w),
        2.0 * (x * y + z * w),
        1.0 - 2.0 * (x * x + z * z),
        2.0 * (y * z - x * w),
        2.0 * (x * z - y * w),
        2.0 * (y * z + x * w),
        1.0 - 2.0 * (x * x + y * y),
    ]
}

/// Returns roll, pitch and yaw, rad: rotations about the fixed axes x, y, z, in this order.
pub fn roll_pitch_yaw(quaternion: Quaternion) -> [f64; 3] {
    let m = matrix(quaternion);
    [m[7].atan2(m[8]), (-m[6]).clamp(-1.0, 1.0).asin(), m[3].atan2(m[0])]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn close(actual: &[f64], expected: &[f64]) -> bool {
        actual.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-9)
    }

    #[test]
    fn an_axis_angle_converts_back_to_the_quaternion() {
        for quaternion in [
            [0.96, -0.2, 0.1, 0.0],
            [0.5, 0.5, -0.5, 0.5],
            [0.1, 0.9, 0.3, -0.2],
            [0.0, 0.1, 0.9, 0.2],
        ] {
            let norm: f64 = quaternion.iter().map(|number| number * number).sum();
            let quaternion = quaternion.map(|number: f64| number / norm.sqrt());
            assert!(close(&from_axis_angle(axis_angle(quaternion)), &quaternion));
        }
    }

    #[test]
    fn the_antipode_has_another_axis_angle_and_the_same_matrix() {
        let quaternion = from_axis_angle([3.0, 0.2, -0.1]);
        let antipode = quaternion.map(|number| -number);
        assert!(close(&matrix(quaternion), &matrix(antipode)));
        let angle = axis_angle(antipode).iter().map(|number| number * number).sum::<f64>();
        let full_turn = 2.0 * std::f64::consts::PI;
        assert!((angle.sqrt() + (9.05_f64).sqrt() - full_turn).abs() < 1e-9);
    }

    #[test]
    fn roll_pitch_and_yaw_are_those_of_the_fixed_axes() {
        assert!(close(&roll_pitch_yaw(from_axis_angle([0.3, 0.0, 0.0])), &[0.3, 0.0, 0.0]));
        assert!(close(&roll_pitch_yaw(from_axis_angle([0.0, 0.0, -2.0])), &[0.0, 0.0, -2.0]));
    }
}
