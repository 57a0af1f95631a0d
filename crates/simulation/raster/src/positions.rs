//! A cluster's positions in the picture.

use crate::lanes::{F, Floats as _, I, LANES};

/// Positions are snapped to this fraction of a pixel.
pub(crate) const SUBPIXELS: i32 = 256;
/// Furthest that a corner is taken to be from the picture's, in parts of a pixel.
/// Few are beyond the picture at all: those so near to the eye that their place
/// cannot be told. Twice this, multiplied, stays within 64 bits.
pub(crate) const FURTHEST: i32 = 1 << 24;

/// Positions of a cluster at most: as many as a byte can name, so that no name needs
/// a check.
const MOST: usize = 256;

/// The positions of a cluster in the picture, a row of eight numbers each: x, y and
/// depth in pixels, and the bits of x and y snapped and of the planes of
/// [`clip`](crate::clip) that it is beyond. All of a corner is read by one load.
pub(crate) struct Positions {
    rows: [[f32; LANES]; MOST],
}

/// Columns of a row.
const EXACT: usize = 0;
const SNAPPED: usize = 3;
const BEYOND: usize = 5;

/// Eight positions.
pub(crate) struct EightPositions {
    pub(crate) exact: [F; 3],
    pub(crate) snapped: [I; 2],
    pub(crate) beyond: I,
}

/// The corners of eight triangles.
pub(crate) struct EightTriangles([[F; LANES]; 3]);

impl Default for Positions {
    fn default() -> Self {
        Self {
            rows: [[0.0; LANES]; MOST],
        }
    }
}

impl Positions {
    /// Keeps eight positions, the first in row `at`.
    #[inline(always)]
    pub(crate) fn store(&mut self, at: usize, eight: &EightPositions) {
        let [x, y, z] = eight.exact;
        let [snapped_x, snapped_y] = eight.snapped.map(F::from_signed_bits);
        let beyond = F::from_signed_bits(eight.beyond);
        let unused = F::splat(0.0);
        let rows = F::transpose([x, y, z, snapped_x, snapped_y, beyond, unused, unused]);
        for (to, row) in self.rows[at..at + LANES].iter_mut().zip(rows) {
            *to = row.to_array();
        }
    }

    /// Bits of all the planes that any of three positions is beyond.
    pub(crate) fn any_beyond(&self, ids: [u8; 3]) -> i32 {
        let [a, b, c] = ids.map(|id| self.rows[usize::from(id)][BEYOND].to_bits());
        (a | b | c).cast_signed()
    }

    /// The corners of eight triangles, named by their rows.
    #[inline(always)]
    pub(crate) fn corners(&self, ids: &[[u8; LANES]; 3]) -> EightTriangles {
        let mut rows = [[F::splat(0.0); LANES]; 3];
        // Loops: closures of `map` become calls.
        for (rows, ids) in rows.iter_mut().zip(ids) {
            for (row, id) in rows.iter_mut().zip(ids) {
                *row = F::new(self.rows[usize::from(*id)]);
            }
        }
        EightTriangles(rows.map(F::transpose))
    }
}

impl EightTriangles {
    /// Snapped corners in parts of a pixel: x of each corner, and y.
    #[inline(always)]
    pub(crate) fn snapped(&self) -> ([I; 3], [I; 3]) {
        let of = |column: usize| self.ints(column);
        (of(SNAPPED), of(SNAPPED + 1))
    }

    /// Corners in pixels before they were snapped, and their depths.
    #[inline(always)]
    pub(crate) fn exact(&self) -> [[F; 3]; 3] {
        let Self([a, b, c]) = self;
        [EXACT, EXACT + 1, EXACT + 2].map(|column| [a[column], b[column], c[column]])
    }

    /// Bits of the planes that each corner is beyond.
    #[inline(always)]
    pub(crate) fn beyond(&self) -> [I; 3] {
        self.ints(BEYOND)
    }

    #[inline(always)]
    fn ints(&self, column: usize) -> [I; 3] {
        let Self([a, b, c]) = self;
        [a, b, c].map(|corner| corner[column].to_signed_bits())
    }
}
