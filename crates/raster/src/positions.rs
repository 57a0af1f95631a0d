//! Positions of a cluster in the picture.

use crate::instance::Instance;
use crate::lanes::{F, Floats as _, I, Ints as _, LANES, Mask};
use crate::mesh::{Cluster, Mesh};
use crate::raster::Drawing;

/// Subpixel units in a pixel; positions are snapped to these units.
pub(crate) const SUBPIXELS: i32 = 256;
/// Limit in subpixel units. Corners beyond are too close to the eye for a reliable position. The
/// product of two coordinates fits in 64 bits.
pub(crate) const MAX_COORDINATE: i32 = 1 << 24;

/// Positions that a byte can index, so that indices need no bounds check.
const CAPACITY: usize = 256;

/// Eight numbers per row, read by one load: x and y in pixels, depth, snapped x and y as bits, and
/// the bits of the planes of [`clip`](crate::clip) that the position lies beyond.
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

pub(crate) struct ClusterExtent {
    /// True if any position lies beyond a side of the view frustum.
    pub(crate) is_beyond: bool,
    pub(crate) is_outside: bool,
}

/// Transforms a cluster to the picture; `is_inside` clusters do not leave the view frustum.
#[inline(always)]
pub(crate) fn transform(
    instance: &Instance,
    mesh: &Mesh,
    cluster: &Cluster,
    is_inside: bool,
    drawing: &mut Drawing<'_>,
) -> ClusterExtent {
    let half_width = F::splat(drawing.visible.width as f32 * 0.5);
    let half_height = F::splat(drawing.visible.height as f32 * 0.5);
    let one = F::splat(1.0);
    let count = (cluster.positions as usize).next_multiple_of(LANES);
    let mut any = I::splat(0);
    let mut low = [I::splat(i32::MAX); 2];
    let mut high = [I::splat(i32::MIN); 2];
    let to = &mut *drawing.positions;
    let first = cluster.first_position as usize;
    let [xs, ys, zs] = [&mesh.xs, &mesh.ys, &mesh.zs].map(|all| &all[first..first + count]);
    for at in (0..count).step_by(LANES) {
        let [x, y, z] = [xs, ys, zs].map(|values| F::load(&values[at..at + LANES]));
        let row = instance.to_clip.rows([x, y, z]);
        let (cx, cy, cz, cw) = (row(0), row(1), row(2), row(3));
        let mut beyond = I::splat(0);
        if !is_inside {
            beyond = sides_beyond([cx, cy, cz, cw]);
            if let Some(plane) = drawing.plane {
                let [a, b, c, d] = plane.map(F::splat);
                let distance = d.fused(cw, c.fused(cz, b.fused(cy, a * cx)));
                // The bit of the last clip plane, a mirror's.
                beyond |= distance.lt(F::splat(0.0)).ints() & I::splat(64);
            }
            any |= beyond;
        }
        let over_w = one / cw;
        let wx = (cx * over_w).fused(half_width, half_width);
        let wy = (cy * over_w).fused(half_height, half_height);
        // The viewport's depth has scale 1 and offset 0.
        let wz = cz * over_w;
        let subpixels = F::splat(SUBPIXELS as f32);
        let snapped = [wx, wy].map(|at| {
            let at: I = (at * subpixels).round_to_int();
            at.max(I::splat(-MAX_COORDINATE)).min(I::splat(MAX_COORDINATE))
        });
        let exact = [wx, wy, wz];
        to.store(at, &EightPositions { exact, snapped, beyond });
        for axis in 0..2 {
            low[axis] = low[axis].min(snapped[axis]);
            high[axis] = high[axis].max(snapped[axis]);
        }
    }
    let is_beyond = (!any.equals(I::splat(0))).any();
    let misses = |axis: usize, [first, last]: [i32; 2]| {
        (low[axis].reduce_min() >> 8) > last || (high[axis].reduce_max() >> 8) < first
    };
    ClusterExtent {
        is_beyond,
        is_outside: !is_beyond && (misses(0, drawing.window.x) || misses(1, drawing.window.y)),
    }
}

/// Bits of the sides of the view frustum that positions lie beyond; see [`clip`](crate::clip).
#[inline(always)]
pub(crate) fn sides_beyond([x, y, z, w]: [F; 4]) -> I {
    let zero = F::splat(0.0);
    let bit = |mask: Mask, bit: i32| mask.ints() & I::splat(bit);
    bit(x.gt(w), 1)
        | bit((x + w).lt(zero), 2)
        | bit(y.gt(w), 4)
        | bit((y + w).lt(zero), 8)
        | bit(z.lt(zero), 16)
        | bit(z.gt(w), 32)
}
