//! Geometry of the expert: vectors, rotations, and footprints of boxes. World frame,
//! metres, radians, z up.

use std::f64::consts::FRAC_PI_2;
use std::ops::{Add, Mul, Sub};

#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Vec3 {
    pub(crate) x: f64,
    pub(crate) y: f64,
    pub(crate) z: f64,
}

impl Vec3 {
    pub(crate) const UP: Self = Self::new(0.0, 0.0, 1.0);

    pub(crate) const fn new(x: f64, y: f64, z: f64) -> Self {
        Self { x, y, z }
    }

    pub(crate) fn heading(angle: f64) -> Self {
        Self::new(angle.cos(), angle.sin(), 0.0)
    }

    pub(crate) fn dot(self, other: Self) -> f64 {
        self.x * other.x + self.y * other.y + self.z * other.z
    }

    pub(crate) fn cross(self, other: Self) -> Self {
        Self::new(
            self.y * other.z - self.z * other.y,
            self.z * other.x - self.x * other.z,
            self.x * other.y - self.y * other.x,
        )
    }

    pub(crate) fn norm(self) -> f64 {
        self.dot(self).sqrt()
    }

    pub(crate) fn horizontal_norm(self) -> f64 {
        self.x.hypot(self.y)
    }

    pub(crate) fn at_height(self, z: f64) -> Self {
        Self { z, ..self }
    }

    pub(crate) fn abs(self) -> Self {
        Self::new(self.x.abs(), self.y.abs(), self.z.abs())
    }

    pub(crate) fn max_coordinate(self) -> f64 {
        self.x.max(self.y).max(self.z)
    }

    pub(crate) fn max_abs(self) -> f64 {
        self.x.abs().max(self.y.abs()).max(self.z.abs())
    }
}

impl Add for Vec3 {
    type Output = Self;
    fn add(self, o: Self) -> Self {
        Self::new(self.x + o.x, self.y + o.y, self.z + o.z)
    }
}

impl Sub for Vec3 {
    type Output = Self;
    fn sub(self, o: Self) -> Self {
        Self::new(self.x - o.x, self.y - o.y, self.z - o.z)
    }
}

impl Mul<f64> for Vec3 {
    type Output = Self;
    fn mul(self, k: f64) -> Self {
        Self::new(self.x * k, self.y * k, self.z * k)
    }
}

const AXES: [Vec3; 3] = [Vec3::new(1.0, 0.0, 0.0), Vec3::new(0.0, 1.0, 0.0), Vec3::UP];

#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Quat {
    pub(crate) w: f64,
    pub(crate) v: Vec3,
}

impl Quat {
    pub(crate) const IDENTITY: Self = Self { w: 1.0, v: Vec3::new(0.0, 0.0, 0.0) };

    pub(crate) fn turn(axis: Vec3, angle: f64) -> Self {
        Self { w: (angle / 2.0).cos(), v: axis * (angle / 2.0).sin() }
    }

    pub(crate) fn inverse(self) -> Self {
        Self { w: self.w, v: self.v * -1.0 }
    }

    /// Composes rotations: `first`, then this rotation.
    pub(crate) fn after(self, first: Self) -> Self {
        Self {
            w: self.w * first.w - self.v.dot(first.v),
            v: first.v * self.w + self.v * first.w + self.v.cross(first.v),
        }
    }

    pub(crate) fn rotate(self, p: Vec3) -> Vec3 {
        let t = self.v.cross(p) * 2.0;
        p + t * self.w + self.v.cross(t)
    }

    /// Returns axis times angle for the shorter direction, so that the length is at most pi.
    pub(crate) fn rotation_vector(self) -> Vec3 {
        let q = if self.w < 0.0 { Self { w: -self.w, v: self.v * -1.0 } } else { self };
        let s = q.v.norm();
        if s < 1e-9 { q.v * 2.0 } else { q.v * (2.0 * s.atan2(q.w) / s) }
    }
}

/// Reduces `angle` to (-pi/2, pi/2] by half turns, under which a two-fingered hand or a line
/// is symmetric.
pub(crate) fn half_turn(angle: f64) -> f64 {
    let a = angle.rem_euclid(2.0 * FRAC_PI_2);
    if a > FRAC_PI_2 { a - 2.0 * FRAC_PI_2 } else { a }
}

/// Footprint of a body as a rectangle along its own horizontal axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Footprint {
    /// Direction of the narrower side, rad from the x axis, in (-pi/2, pi/2].
    pub(crate) narrow_angle: f64,
    /// Half extents, m, `narrow <= wide`.
    pub(crate) narrow: f64,
    pub(crate) wide: f64,
}

/// Recovers a rectangle from its world-aligned bounding box (`half`) and the body's orientation:
/// the box of a rectangle a × b turned by t is a·|cos t| + b·|sin t| by a·|sin t| + b·|cos t|,
/// which is solved for a and b. Near 45° the two equations are degenerate, and the result is a
/// square along the body's axes. A solution that is not positive means a nearly round body, whose
/// bounding box is returned unchanged, along the world's axes.
pub(crate) fn footprint(quat: Quat, half: Vec3) -> Footprint {
    let t = horizontal_axis_angle(quat);
    let (c, s) = (t.cos().abs(), t.sin().abs());
    let det = c * c - s * s;
    let (mut a, mut b) = if det.abs() > 0.05 {
        ((half.x * c - half.y * s) / det, (half.y * c - half.x * s) / det)
    } else {
        let side = (half.x + half.y) / (2.0 * (c + s));
        (side, side)
    };
    let mut angle = t;
    if a.min(b) <= 0.0 {
        // The bounding box of a round body does not depend on its orientation.
        (a, b, angle) = (half.x, half.y, 0.0);
    }
    let (narrow, wide, turn) = if a <= b { (a, b, 0.0) } else { (b, a, FRAC_PI_2) };
    Footprint { narrow_angle: half_turn(angle + turn), narrow, wide }
}

/// Returns the horizontal part of the most upright body axis: zero if a body axis is vertical,
/// otherwise a vector towards the low side of the tilted body.
pub(crate) fn lean(quat: Quat) -> Vec3 {
    let most_upright = AXES
        .map(|axis| quat.rotate(axis))
        .into_iter()
        .max_by(|a, b| a.z.abs().total_cmp(&b.z.abs()))
        .unwrap_or(Vec3::UP);
    most_upright.at_height(0.0) * most_upright.z.signum()
}

/// Returns the heading of the body axis closest to the horizontal plane.
fn horizontal_axis_angle(quat: Quat) -> f64 {
    let flattest = AXES
        .map(|axis| quat.rotate(axis))
        .into_iter()
        .min_by(|a, b| a.z.abs().total_cmp(&b.z.abs()))
        .unwrap_or(Vec3::new(1.0, 0.0, 0.0));
    flattest.y.atan2(flattest.x)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn near(a: f64, b: f64) -> bool {
        (a - b).abs() < 1e-9
    }

    #[test]
    fn a_quarter_turn_takes_x_to_y_and_its_vector_is_the_axis_times_the_angle() {
        let q = Quat::turn(Vec3::UP, FRAC_PI_2);
        assert!((q.rotate(Vec3::new(1.0, 0.0, 0.0)) - Vec3::new(0.0, 1.0, 0.0)).norm() < 1e-12);
        assert!(near(q.rotation_vector().z, FRAC_PI_2));
        assert!(q.after(q.inverse()).rotation_vector().norm() < 1e-12);
    }

    #[test]
    fn a_rotation_by_more_than_pi_gives_the_vector_of_the_shorter_direction() {
        let v = Quat::turn(Vec3::UP, 1.5 * std::f64::consts::PI).rotation_vector();
        assert!(near(v.z, -FRAC_PI_2));
    }

    #[test]
    fn the_sides_of_a_turned_box_are_recovered_from_its_bounding_box() {
        for angle in [0.0, 0.3, -0.7, 1.2, 2.6] {
            let (c, s) = (f64::cos(angle).abs(), f64::sin(angle).abs());
            let (a, b) = (0.014, 0.056);
            let half = Vec3::new(a * c + b * s, a * s + b * c, 0.07);
            let found = footprint(Quat::turn(Vec3::UP, angle), half);
            assert!(near(found.narrow, a) && near(found.wide, b), "{angle}: {found:?}");
            assert!(near(half_turn(found.narrow_angle - angle), 0.0), "{angle}: {found:?}");
        }
    }

    #[test]
    fn a_lying_body_is_measured_along_the_axes_that_lie_flat() {
        // The body's z axis points along the world's y.
        let lying = Quat::turn(Vec3::new(1.0, 0.0, 0.0), -FRAC_PI_2);
        let found = footprint(lying, Vec3::new(0.02, 0.05, 0.03));
        assert!(near(found.narrow, 0.02) && near(found.wide, 0.05));
        assert!(near(found.narrow_angle, 0.0));
    }
}
