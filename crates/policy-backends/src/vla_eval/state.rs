//! Computes the robot's state as vla-eval's LIBERO benchmark does (modules
//! `benchmarks.libero.benchmark` and `rotation`), in the same precision. Pure functions.

/// Sine of half the angle below which a rotation counts as the identity.
const NO_ROTATION: f64 = 1e-8;

/// Returns `states`: position (m), the hand's axis-angle (rad, rounded to single precision as in
/// vla-eval) and finger joints (m).
///
/// If `flips_quaternion`, a quaternion with negative w is replaced by its antipode, so that the
/// angle is at most π; otherwise the angle is up to 2π, as in robosuite.
pub(super) fn states(
    position: [f64; 3],
    quaternion_xyzw: [f64; 4],
    fingers: [f64; 2],
    flips_quaternion: bool,
) -> [f64; 8] {
    let axis_angle = match flips_quaternion {
        true => axis_angle(quaternion_xyzw),
        false => unflipped_axis_angle(quaternion_xyzw),
    };
    let [x, y, z] = position;
    let [a, b, c] = axis_angle.map(f64::from);
    let [left, right] = fingers;
    [x, y, z, a, b, c, left, right]
}

/// Returns `controller_states`: the same quantities for the site that robosuite's controller
/// moves, in single precision. The site has the position of `states`, and is rotated against the
/// hand by −90° about the hand's z axis. vla-eval reads these values at the end of a control step.
/// This function gets the readings of an observation, which are up to 50 ms earlier, because
/// LIBERO's readings and frames lag.
///
/// `hand` is the hand's rotation matrix in row-major order.
pub(super) fn controller_states(position: [f64; 3], hand: [f64; 9], fingers: [f64; 2]) -> [f32; 8] {
    let [xx, xy, xz, yx, yy, yz, zx, zy, zz] = hand;
    let site = [[-xy, xx, xz], [-yy, yx, yz], [-zy, zx, zz]];
    let site = site.map(|row| row.map(|number| f64::from(number as f32)));
    let [a, b, c] = axis_angle(quaternion_of(site));
    let [x, y, z] = position.map(|number| number as f32);
    let [left, right] = fingers.map(|finger| finger as f32);
    [x, y, z, a, b, c, left, right]
}

fn axis_angle(quaternion_xyzw: [f64; 4]) -> [f32; 3] {
    let flipped = match quaternion_xyzw[3] < 0.0 {
        true => quaternion_xyzw.map(|number| -number),
        false => quaternion_xyzw,
    };
    let [x, y, z, w] = flipped;
    let w = w.clamp(-1.0, 1.0);
    let sine = (1.0 - w * w).sqrt();
    if sine < NO_ROTATION {
        return [0.0; 3];
    }
    let angle = 2.0 * w.acos();
    [x, y, z].map(|number| (number / sine * angle) as f32)
}

fn unflipped_axis_angle(quaternion_xyzw: [f64; 4]) -> [f32; 3] {
    let [x, y, z, w] = quaternion_xyzw;
    let w = w.clamp(-1.0, 1.0);
    let sine = (1.0 - w * w).sqrt();
    if sine == 0.0 {
        return [0.0; 3];
    }
    [x, y, z].map(|number| (number * 2.0 * w.acos() / sine) as f32)
}

/// Returns the quaternion x y z w of a rotation matrix, computed from w if the trace is positive,
/// otherwise from the largest of x, y and z, which is then positive. That choice determines the
/// direction of a half turn's axis; the pose of LIBERO's hand is close to a half turn.
fn quaternion_of([[xx, xy, xz], [yx, yy, yz], [zx, zy, zz]]: [[f64; 3]; 3]) -> [f64; 4] {
    let trace = xx + yy + zz;
    if trace > 0.0 {
        let s = 2.0 * (trace + 1.0).sqrt();
        [(zy - yz) / s, (xz - zx) / s, (yx - xy) / s, 0.25 * s]
    } else if xx > yy && xx > zz {
        let s = 2.0 * (1.0 + xx - yy - zz).sqrt();
        [0.25 * s, (xy + yx) / s, (xz + zx) / s, (zy - yz) / s]
    } else if yy > zz {
        let s = 2.0 * (1.0 + yy - xx - zz).sqrt();
        [(xy + yx) / s, 0.25 * s, (yz + zy) / s, (xz - zx) / s]
    } else {
        let s = 2.0 * (1.0 + zz - xx - yy).sqrt();
        [(xz + zx) / s, (yz + zy) / s, 0.25 * s, (yx - xy) / s]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the rotation matrix of a quaternion x y z w, in row-major order.
    fn matrix([x, y, z, w]: [f64; 4]) -> [f64; 9] {
        [
            1.0 - 2.0 * (y * y + z * z),
            2.0 * (x * y - w * z),
            2.0 * (x * z + w * y),
            2.0 * (x * y + w * z),
            1.0 - 2.0 * (x * x + z * z),
            2.0 * (y * z - w * x),
            2.0 * (x * z - w * y),
            2.0 * (y * z + w * x),
            1.0 - 2.0 * (x * x + y * y),
        ]
    }

    fn assert_near(actual: [f64; 3], expected: [f64; 3]) {
        let near = |(a, b): (f64, f64)| (a - b).abs() < 1e-6;
        assert!(actual.into_iter().zip(expected).all(near), "{actual:?} is not {expected:?}");
    }

    #[test]
    fn rotations_are_those_of_vla_evals_own_functions() {
        // Quaternion; its axis-angle, flipped and unflipped; axis-angle of the controller's site.
        let cases = [
            (
                [0.6, 0.0, 0.0, -0.8],
                [-1.287_002_2, 0.0, 0.0],
                [4.996_182_9, 0.0, 0.0],
                [-0.997_640_3, -0.997_640_3, -1.330_187_1],
            ),
            (
                [-0.8, -0.6, 0.0, 0.0],
                [-2.513_274_2, -1.884_955_6, 0.0],
                [-2.513_274_2, -1.884_955_6, 0.0],
                [0.444_288_3, 3.110_018, 0.0],
            ),
            (
                [0.0, 0.6, 0.0, 0.8],
                [0.0, 1.287_002_2, 0.0],
                [0.0, 1.287_002_2, 0.0],
                [-0.997_640_3, 0.997_640_3, -1.330_187_1],
            ),
            (
                [0.0, 0.0, 0.96, -0.28],
                [0.0, 0.0, -2.574_004_4],
                [0.0, 0.0, 3.709_180_8],
                [0.0, 0.0, 2.138_384_6],
            ),
            ([0.0, 0.0, 0.0, 1.0], [0.0; 3], [0.0; 3], [0.0, 0.0, -1.570_796_4]),
        ];
        let (position, fingers) = ([0.1, 0.2, 0.3], [0.04, -0.04]);
        for (quaternion, flipped, unflipped, of_controller) in cases {
            for (flips_quaternion, expected) in [(true, flipped), (false, unflipped)] {
                let [x, y, z, a, b, c, left, right] =
                    states(position, quaternion, fingers, flips_quaternion);
                assert_eq!(([x, y, z], [left, right]), (position, fingers));
                assert_near([a, b, c], expected);
            }
            let [_, _, _, a, b, c, _, _] = controller_states(position, matrix(quaternion), fingers);
            assert_near([a, b, c].map(f64::from), of_controller);
        }
    }
}
