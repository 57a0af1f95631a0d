//! Positions of a cluster in the picture.

use crate::lanes::{F, Floats as _, I, LANES};

/// Subpixel units in a pixel; positions are snapped to these units.
pub(crate) const SUBPIXELS: i32 = 256;
/// Limit of the magnitude of a corner's x and y in the picture, subpixel units. Only corners that
/// are so close to the eye that their position is unreliable lie beyond this limit. The product of
/// two such coordinates fits in 64 bits.
pub(crate) const MAX_COORDINATE: i32 = 1 << 24;

/// Largest number of positions of a cluster: as many as a byte can index, so that indices need no
/// bounds check.
const CAPACITY: usize = 256;

/// Positions of a cluster in the picture, eight numbers per row: x and y in pixels, depth, snapped
/// x and y as bits, and the bits of the planes of [`clip`](crate::clip) that the position lies
/// beyond. One load reads a whole row.
pub(crate) struct Positions {
    rows: [[f32; LANES]; CAPACITY],
}

/// Columns of a row.
const EXACT: usize = 0;
const SNAPPED: usize = 3;
const BEYOND: usize = 5;

pub(crate) struct EightPositions {
    pub(crate) exact: [F; 3],
    pub(crate) snapped: [I; 2],
    pub(crate) beyond: I,
}

pub(crate) struct EightTriangles([[F; LANES]; 3]);

impl Default for Positions {
    fn default() -> Self {
        Self { rows: [[0.0; LANES]; CAPACITY] }
    }
}

impl Positions {
    /// Stores eight positions, the first in row `at`.
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

    /// Returns the bits of all planes that any of three positions lies beyond.
    pub(crate) fn any_beyond(&self, ids: [u8; 3]) -> i32 {
        let [a, b, c] = ids.map(|id| self.rows[usize::from(id)][BEYOND].to_bits());
        (a | b | c).cast_signed()
    }

    /// Loads the corners of eight triangles by their rows.
    #[inline(always)]
    pub(crate) fn corners(&self, ids: &[[u8; LANES]; 3]) -> EightTriangles {
        let mut rows = [[F::splat(0.0); LANES]; 3];
        // Loops are used, because the closures of `map` would not be inlined.
        for (rows, ids) in rows.iter_mut().zip(ids) {
            for (row, id) in rows.iter_mut().zip(ids) {
                *row = F::new(self.rows[usize::from(*id)]);
            }
        }
        EightTriangles(rows.map(F::transpose))
    }
}

impl EightTriangles {
    /// Returns the snapped corners in subpixel units: x of each corner, and y.
    #[inline(always)]
    pub(crate) fn snapped(&self) -> ([I; 3], [I; 3]) {
        (self.ints(SNAPPED), self.ints(SNAPPED + 1))
    }

    /// Returns the unsnapped corners in pixels, and their depths.
    #[inline(always)]
    pub(crate) fn exact(&self) -> [[F; 3]; 3] {
        let Self([a, b, c]) = self;
        [EXACT, EXACT + 1, EXACT + 2].map(|column| [a[column], b[column], c[column]])
    }

    /// Returns the bits of the planes that each corner lies beyond.
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
