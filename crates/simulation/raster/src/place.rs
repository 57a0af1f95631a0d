//! Transformation of a cluster's positions from the mesh to the picture.

use crate::drawing::Drawing;
use crate::instance::Instance;
use crate::lanes::{F, Floats as _, I, Ints as _, LANES, Mask};
use crate::mesh::{Cluster, Mesh};
use crate::positions::{EightPositions, MAX_COORDINATE, SUBPIXELS};

/// Extent of a cluster after its positions were transformed.
pub(crate) struct ClusterExtent {
    /// True if any position lies beyond a side of the view frustum.
    pub(crate) is_beyond: bool,
    /// True if the whole cluster lies outside the window.
    pub(crate) is_outside: bool,
}

/// Transforms a cluster's positions to the picture. If `is_inside` is true, the cluster
/// does not extend beyond the view frustum.
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
        // Depth needs no viewport transform: its scale is 1 and its offset 0.
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

/// Returns the bits of the sides of the view frustum that eight positions in clip space lie beyond;
/// see [`clip`](crate::clip).
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
