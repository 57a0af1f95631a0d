//! Four-by-four matrices in single precision, column-major as in OpenGL. Every operation follows
//! Mesa's order, because a difference in the last bit of a vertex becomes visible where surfaces
//! coincide.

use crate::lanes::F;

/// A matrix; element (row, column) is at `row + 4 * column`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Matrix(pub(crate) [f32; 16]);

/// Mesa treats smaller differences between matrix elements as rounding errors.
const SMALL: f32 = 1e-6;
/// Mesa treats a matrix with a smaller determinant as singular.
const SINGULAR: f32 = 1e-25;

pub(crate) type Vec3 = [f32; 3];

impl Matrix {
    pub(crate) const IDENTITY: Self = {
        let mut values = [0.0; 16];
        values[0] = 1.0;
        values[5] = 1.0;
        values[10] = 1.0;
        values[15] = 1.0;
        Self(values)
    };

    pub(crate) fn times(&self, other: &Self) -> Self {
        let (a, b) = (&self.0, &other.0);
        Self(std::array::from_fn(|index| {
            let (row, column) = (index % 4, index / 4 * 4);
            a[row] * b[column]
                + a[row + 4] * b[column + 1]
                + a[row + 8] * b[column + 2]
                + a[row + 12] * b[column + 3]
        }))
    }

    /// Returns a function that computes rows of the product with eight points.
    #[inline(always)]
    pub(crate) fn rows(&self, [x, y, z]: [F; 3]) -> impl Fn(usize) -> F + use<> {
        let m = self.0.map(F::splat);
        move |row| x * m[row] + y * m[row + 4] + z * m[row + 8] + m[row + 12]
    }

    pub(crate) fn translated(mut self, [x, y, z]: Vec3) -> Self {
        let m = &mut self.0;
        for row in 0..4 {
            m[row + 12] += m[row] * x + m[row + 4] * y + m[row + 8] * z;
        }
        self
    }

    /// Shifts a projection along x and y of the picture, which extends from -1 to 1.
    pub(crate) fn shifted(mut self, shift: [f32; 2]) -> Self {
        for column in self.0.chunks_exact_mut(4) {
            column[0] += shift[0] * column[3];
            column[1] += shift[1] * column[3];
        }
        self
    }

    pub(crate) fn scaled(mut self, [x, y, z]: Vec3) -> Self {
        let m = &mut self.0;
        for row in 0..4 {
            m[row] *= x;
            m[row + 4] *= y;
            m[row + 8] *= z;
        }
        self
    }

    pub(crate) fn rotation(rows: &[f32; 9]) -> Self {
        let r = rows;
        Self([
            r[0], r[3], r[6], 0.0, r[1], r[4], r[7], 0.0, r[2], r[5], r[8], 0.0, 0.0, 0.0, 0.0, 1.0,
        ])
    }

    /// Creates a reversed-depth perspective: 1 at the near plane, 0 at the far plane. The first
    /// four numbers are the sides of the near plane's rectangle.
    pub(crate) fn perspective(
        [left, right]: [f32; 2],
        [bottom, top]: [f32; 2],
        [near, far]: [f32; 2],
    ) -> Self {
        let mut m = [0.0; 16];
        m[0] = (2.0 * near) / (right - left);
        m[5] = (2.0 * near) / (top - bottom);
        m[8] = (right + left) / (right - left);
        m[9] = (top + bottom) / (top - bottom);
        m[10] = -(far + near) / (far - near);
        m[11] = -1.0;
        m[14] = -(2.0 * far * near) / (far - near);
        reversed_depth().times(&Self(m))
    }

    /// Orthographic projection with the conventions of [`perspective`](Self::perspective).
    pub(crate) fn orthographic(
        [left, right]: [f32; 2],
        [bottom, top]: [f32; 2],
        [near, far]: [f32; 2],
    ) -> Self {
        let mut m = [0.0; 16];
        m[0] = 2.0 / (right - left);
        m[5] = 2.0 / (top - bottom);
        m[10] = -2.0 / (far - near);
        m[12] = -(right + left) / (right - left);
        m[13] = -(top + bottom) / (top - bottom);
        m[14] = -(far + near) / (far - near);
        m[15] = 1.0;
        reversed_depth().times(&Self(m))
    }

    /// Creates the transformation from the world to the eye.
    pub(crate) fn look_at(eye: Vec3, forward: Vec3, up: Vec3) -> Self {
        let f = normalized(forward);
        let s = normalized(cross(f, up));
        let u = normalized(cross(s, f));
        let m = Self([
            s[0],
            u[0],
            -f[0],
            0.0,
            s[1],
            u[1],
            -f[1],
            0.0,
            s[2],
            u[2],
            -f[2],
            0.0,
            -dot(s, eye),
            -dot(u, eye),
            dot(f, eye),
            1.0,
        ]);
        Self::IDENTITY.times(&m)
    }

    /// Creates a reflection at a plane through `pos` with this unit normal.
    pub(crate) fn mirror(pos: Vec3, normal: Vec3) -> Self {
        let v = normal;
        let outer: [f32; 9] = std::array::from_fn(|index| v[index / 3] * v[index % 3]);
        let row = |index: usize| [outer[3 * index], outer[3 * index + 1], outer[3 * index + 2]];
        Self([
            1.0 - 2.0 * outer[0],
            -2.0 * outer[1],
            -2.0 * outer[2],
            0.0,
            -2.0 * outer[3],
            1.0 - 2.0 * outer[4],
            -2.0 * outer[5],
            0.0,
            -2.0 * outer[6],
            -2.0 * outer[7],
            1.0 - 2.0 * outer[8],
            0.0,
            2.0 * dot(row(0), pos),
            2.0 * dot(row(1), pos),
            2.0 * dot(row(2), pos),
            1.0,
        ])
    }

    pub(crate) fn point(&self, [x, y, z]: Vec3) -> Vec3 {
        let m = &self.0;
        std::array::from_fn(|row| m[row] * x + m[row + 4] * y + m[row + 8] * z + m[row + 12])
    }

    pub(crate) fn direction(&self, [x, y, z]: Vec3) -> Vec3 {
        let m = &self.0;
        std::array::from_fn(|row| m[row] * x + m[row + 4] * y + m[row + 8] * z)
    }

    /// Inverse for a last row of (0, 0, 0, 1); the identity if singular, as in Mesa.
    pub(crate) fn inverse_of_affine(&self) -> Self {
        let Some(rows) = self.inverse_of_linear_part() else {
            return Self::IDENTITY;
        };
        let mut inverse = Self::rotation(&rows);
        let [x, y, z] = [self.0[12], self.0[13], self.0[14]];
        for row in 0..3 {
            let [a, b, c] = [rows[3 * row], rows[3 * row + 1], rows[3 * row + 2]];
            inverse.0[12 + row] = -(x * a + y * b + z * c);
        }
        inverse
    }

    /// Returns the inverse of the upper left 3 × 3 part, row by row; `None` if that part is
    /// singular. If Mesa considers the part a rotation, returns the transpose instead.
    pub(crate) fn inverse_of_linear_part(&self) -> Option<[f32; 9]> {
        let m = &self.0;
        let (c1, c2, c3): (Vec3, Vec3, Vec3) =
            ([m[0], m[1], m[2]], [m[4], m[5], m[6]], [m[8], m[9], m[10]]);
        let squares = [dot(c1, c1), dot(c2, c2), dot(c3, c3)];
        let near = |difference: f32| difference * difference < SMALL * SMALL;
        let unit = near(squares[0] - squares[1])
            && near(squares[0] - squares[2])
            && near(squares[0] - 1.0);
        let third = cross(c1, c2);
        let offset: Vec3 = std::array::from_fn(|axis| third[axis] - c3[axis]);
        if unit && near(dot(c1, c2)) && dot(offset, offset) < SMALL * SMALL {
            return Some([m[0], m[1], m[2], m[4], m[5], m[6], m[8], m[9], m[10]]);
        }
        general_inverse(|row, column| m[row + 4 * column])
    }
}

fn reversed_depth() -> Matrix {
    Matrix::IDENTITY.translated([0.0, 0.0, 0.5]).scaled([1.0, 1.0, -0.5])
}

/// Returns the inverse by cofactors, row by row.
fn general_inverse(at: impl Fn(usize, usize) -> f32) -> Option<[f32; 9]> {
    let (mut positive, mut negative) = (0.0f32, 0.0f32);
    for term in [
        at(0, 0) * at(1, 1) * at(2, 2),
        at(1, 0) * at(2, 1) * at(0, 2),
        at(2, 0) * at(0, 1) * at(1, 2),
        -at(2, 0) * at(1, 1) * at(0, 2),
        -at(1, 0) * at(0, 1) * at(2, 2),
        -at(0, 0) * at(2, 1) * at(1, 2),
    ] {
        if term >= 0.0 {
            positive += term;
        } else {
            negative += term;
        }
    }
    let determinant = positive + negative;
    if determinant.is_nan() || determinant.abs() < SINGULAR {
        return None;
    }
    let scale = 1.0 / determinant;
    let minor = |a: (usize, usize), b: (usize, usize), c: (usize, usize), d: (usize, usize)| {
        at(a.0, a.1) * at(b.0, b.1) - at(c.0, c.1) * at(d.0, d.1)
    };
    Some([
        minor((1, 1), (2, 2), (2, 1), (1, 2)) * scale,
        -minor((0, 1), (2, 2), (2, 1), (0, 2)) * scale,
        minor((0, 1), (1, 2), (1, 1), (0, 2)) * scale,
        -minor((1, 0), (2, 2), (2, 0), (1, 2)) * scale,
        minor((0, 0), (2, 2), (2, 0), (0, 2)) * scale,
        -minor((0, 0), (1, 2), (1, 0), (0, 2)) * scale,
        minor((1, 0), (2, 1), (2, 0), (1, 1)) * scale,
        -minor((0, 0), (2, 1), (2, 0), (0, 1)) * scale,
        minor((0, 0), (1, 1), (1, 0), (0, 1)) * scale,
    ])
}

pub(crate) fn dot(a: Vec3, b: Vec3) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

pub(crate) fn cross(a: Vec3, b: Vec3) -> Vec3 {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

pub(crate) fn minus(a: Vec3, b: Vec3) -> Vec3 {
    std::array::from_fn(|axis| a[axis] - b[axis])
}

/// Normalises a vector; returns the z axis for a vector without direction.
pub(crate) fn normalized(v: Vec3) -> Vec3 {
    let length = dot(v, v).sqrt();
    if length < 1e-10 {
        return [0.0, 0.0, 1.0];
    }
    let scale = 1.0 / length;
    v.map(|part| part * scale)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_general_inverse_undoes_its_matrix() {
        let matrix = Matrix::rotation(&[0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0])
            .scaled([2.0, 3.0, 0.5]);
        let inverse = matrix.inverse_of_linear_part().expect("an inverse");
        let transformed = matrix.direction([1.0, 2.0, 3.0]);
        let back: Vec3 = std::array::from_fn(|row| {
            dot([inverse[3 * row], inverse[3 * row + 1], inverse[3 * row + 2]], transformed)
        });
        assert_eq!(back, [1.0, 2.0, 3.0]);
        let flat = matrix.scaled([1.0, 0.0, 1.0]);
        assert_eq!(flat.inverse_of_linear_part(), None);
    }

    #[test]
    fn near_and_far_planes_have_depth_one_and_zero() {
        let projection = Matrix::perspective([-1.0, 1.0], [-1.0, 1.0], [0.5, 8.0]).0;
        for (z, depth) in [(-0.5f32, 1.0f32), (-8.0, 0.0)] {
            let clip_z = projection[10] * z + projection[14];
            let w = projection[11] * z;
            assert!((clip_z / w - depth).abs() < 1e-6);
        }
    }
}
