//! Which triangles of a cluster may cover a sample: those that face the camera
//! and do not lie between samples.

use crate::drawing::Drawing;
use crate::instance::Instance;
use crate::lanes::{I, Ints as _, LANES};
use crate::mesh::{CLUSTER, Cluster, Mesh};
use crate::setup::{extent, is_large, turned};

/// A cluster's triangles that may cover a sample.
pub(crate) struct Candidates {
    pub(crate) count: usize,
    /// Places in the cluster.
    pub(crate) at: [u8; CLUSTER + LANES],
}

impl Candidates {
    /// Finds them. `beyond` says whether any position is beyond a side; triangles
    /// that reach there are left to be cut.
    #[inline(always)]
    pub(crate) fn find(
        instance: &Instance,
        mesh: &Mesh,
        cluster: &Cluster,
        drawing: &Drawing<'_>,
        beyond: bool,
    ) -> Self {
        let mut found = Self {
            count: 0,
            at: [0; CLUSTER + LANES],
        };
        let order = turned(instance.counter_clockwise);
        let first = cluster.first_triangle as usize;
        let count = cluster.triangles as usize;
        let splat = |value: i32| I::splat(value);
        let [left, low] = [drawing.window.x, drawing.window.y].map(|it| splat(it[0] * 4));
        let [right, high] = [drawing.window.x, drawing.window.y].map(|it| splat(it[1] * 4 + 3));
        let positions = &*drawing.positions;
        for at in (0..count).step_by(LANES) {
            let ids = order.map(|corner| -> [u8; LANES] {
                mesh.corners[corner][first + at..][..LANES]
                    .try_into()
                    .expect("eight")
            });
            let (x, y) = positions.snapped(&ids);
            let ([x0, x1], [y0, y1]) = (extent(&x), extent(&y));
            // Samples lie in every fourth of a pixel, once in a row and column.
            let (column0, column1) = (
                ((x0 + splat(31)) >> 6i32).max(left),
                ((x1 - splat(32)) >> 6i32).min(right),
            );
            let (row0, row1) = (
                ((y0 + splat(31)) >> 6i32).max(low),
                ((y1 - splat(32)) >> 6i32).min(high),
            );
            let mut kept = column0.le(column1) & row0.le(row1);
            let three = splat(3);
            let column_of_row = (splat(0x8d) >> ((row0 & three) << 1i32)) & three;
            let row_of_column = (splat(0x72) >> ((column0 & three) << 1i32)) & three;
            let one_row =
                row0.equals(row1) & ((column_of_row - column0) & three).gt(column1 - column0);
            let one_column =
                column0.equals(column1) & ((row_of_column - row0) & three).gt(row1 - row0);
            kept = kept & !(one_row | one_column);
            let area = (x[0] - x[1]) * (y[2] - y[0]) - (x[2] - x[0]) * (y[0] - y[1]);
            kept = kept & (area.gt(splat(0)) | is_large([x0, x1], [y0, y1]));
            let mut bits = kept.bits();
            if at + LANES > count {
                bits &= (1 << (count - at)) - 1;
            }
            while bits != 0 {
                let lane = bits.trailing_zeros() as usize;
                bits &= bits - 1;
                let reaches_beyond = || {
                    let mut corners = ids.iter().map(|ids| usize::from(ids[lane]));
                    corners.any(|id| positions.beyond[id] != 0)
                };
                if !(beyond && reaches_beyond()) {
                    found.at[found.count] = (at + lane) as u8;
                    found.count += 1;
                }
            }
        }
        found
    }
}
