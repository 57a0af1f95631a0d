//! A cluster's positions in the picture.

use crate::lanes::{F, I, LANES};
use crate::mesh::CLUSTER;

/// Positions are snapped to this fraction of a pixel.
pub(crate) const SUBPIXELS: i32 = 256;
/// Furthest that a corner is taken to be from the picture's, in parts of a pixel.
/// Few are beyond the picture at all: those so near to the eye that their place
/// cannot be told. Twice this, multiplied, stays within 64 bits.
pub(crate) const FURTHEST: i32 = 1 << 24;

/// The positions of a cluster in the picture.
pub(crate) struct Positions {
    pub(crate) x: [f32; MOST],
    pub(crate) y: [f32; MOST],
    pub(crate) z: [f32; MOST],
    pub(crate) snapped_x: [i32; MOST],
    pub(crate) snapped_y: [i32; MOST],
    /// Bits of the planes of [`clip`](crate::clip) that a position is beyond.
    pub(crate) beyond: [i32; MOST],
}

/// Positions of a cluster at most.
const MOST: usize = 3 * CLUSTER;

impl Default for Positions {
    fn default() -> Self {
        Self {
            x: [0.0; MOST],
            y: [0.0; MOST],
            z: [0.0; MOST],
            snapped_x: [0; MOST],
            snapped_y: [0; MOST],
            beyond: [0; MOST],
        }
    }
}

impl Positions {
    /// Where the corners of eight triangles are, in parts of a pixel.
    #[inline(always)]
    pub(crate) fn snapped(&self, ids: &[[u8; LANES]; 3]) -> ([I; 3], [I; 3]) {
        let of = |values: &[i32; MOST]| {
            let [a, b, c] = eight(values, ids);
            [I::new(a), I::new(b), I::new(c)]
        };
        (of(&self.snapped_x), of(&self.snapped_y))
    }

    /// Where they are in pixels, before they were snapped, and their depths.
    #[inline(always)]
    pub(crate) fn exact(&self, ids: &[[u8; LANES]; 3]) -> [[F; 3]; 3] {
        let of = |values: &[f32; MOST]| {
            let [a, b, c] = eight(values, ids);
            [F::new(a), F::new(b), F::new(c)]
        };
        [of(&self.x), of(&self.y), of(&self.z)]
    }
}

/// One value of each corner of eight triangles.
#[inline(always)]
fn eight<T: Copy>(values: &[T; MOST], ids: &[[u8; LANES]; 3]) -> [[T; LANES]; 3] {
    // Loops: closures of `map` become calls.
    let mut eight = [[values[0]; LANES]; 3];
    for (values_of, ids) in eight.iter_mut().zip(ids) {
        for (value, id) in values_of.iter_mut().zip(ids) {
            *value = values[usize::from(*id)];
        }
    }
    eight
}
