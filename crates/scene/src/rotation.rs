//! Rotations of placed instances, in LIBERO's order and precision: robosuite computes quaternion
//! products and rotation matrices in single precision.

use benchmark::numpy::LegacyRng;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Axis {
    X,
    Y,
    Z,
}

/// A random orientation: one uniform number for each angle, between two bounds, rad.
///
/// LIBERO builds a movable object's quaternion as x y z w and passes it to MuJoCo, which
/// reads w x y z. In the scene, a "rotation about x by θ" is therefore a rotation about z by π − θ;
/// one about y or z is a rotation by π, about an axis in the x–z or y–z plane that depends on θ.
/// The sampled orientations are as MuJoCo reads them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Rotation {
    /// Rotation of a fixture about z.
    Yaw([f64; 2]),
    /// Rotation of a movable object about one axis.
    About(Axis, [f64; 2]),
    /// Rotation of a movable object about several axes in sequence.
    InTurn(&'static [(Axis, [f64; 2])]),
}

impl Rotation {
    /// Samples an orientation, w x y z as MuJoCo reads it.
    pub(crate) fn sample(self, rng: &mut LegacyRng) -> [f64; 4] {
        let mut angle = |[a, b]: [f64; 2]| rng.uniform(a.min(b), a.max(b));
        match self {
            Self::Yaw(range) => {
                let half = angle(range) / 2.0;
                [half.cos(), 0.0, 0.0, half.sin()]
            }
            Self::About(axis, range) => about(axis, angle(range)),
            Self::InTurn(turns) => turns.iter().fold([0.0, 0.0, 0.0, 1.0], |quat, turn| {
                single_precision_product(about(turn.0, angle(turn.1)), quat)
            }),
        }
    }
}

/// Returns a rotation about an axis, x y z w.
fn about(axis: Axis, angle: f64) -> [f64; 4] {
    let (sin, cos) = ((angle / 2.0).sin(), (angle / 2.0).cos());
    let mut quat = [0.0, 0.0, 0.0, cos];
    quat[axis as usize] = sin;
    quat
}

/// Returns `q1 q0`, all x y z w, rounded to single precision (`quat_multiply`).
fn single_precision_product(q1: [f64; 4], q0: [f64; 4]) -> [f64; 4] {
    let [x0, y0, z0, w0] = q0;
    let [x1, y1, z1, w1] = q1;
    [
        x1 * w0 + y1 * z0 - z1 * y0 + w1 * x0,
        -x1 * z0 + y1 * w0 + z1 * x0 + w1 * y0,
        x1 * y0 - y1 * x0 + z1 * w0 + w1 * z0,
        -x1 * x0 - y1 * y0 - z1 * z0 + w1 * w0,
    ]
    .map(|value| f64::from(value as f32))
}

/// Matrix of w x y z, row by row, in single precision like `quat2mat`: off by up to 1e-7.
pub fn single_precision_matrix(quat: [f64; 4]) -> [[f64; 3]; 3] {
    let mut q = quat.map(|value| value as f32);
    let square: f64 = q.iter().map(|value| f64::from(value * value)).sum();
    let scale = (2.0 / f64::from(square as f32)).sqrt();
    for value in &mut q {
        *value = (f64::from(*value) * scale) as f32;
    }
    let product = |a: usize, b: usize| q[a] * q[b];
    let diagonal = |a: usize, b: usize| 1.0 - f64::from(product(a, a)) - f64::from(product(b, b));
    let sum = |a: f32, b: f32| f64::from(a + b);
    [
        [diagonal(2, 3), sum(product(1, 2), -product(3, 0)), sum(product(1, 3), product(2, 0))],
        [sum(product(1, 2), product(3, 0)), diagonal(1, 3), sum(product(2, 3), -product(1, 0))],
        [sum(product(1, 3), -product(2, 0)), sum(product(2, 3), product(1, 0)), diagonal(1, 2)],
    ]
}
