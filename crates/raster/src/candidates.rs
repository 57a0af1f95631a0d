//! Selects the triangles of a cluster that may cover a sample: those that face the camera
//! and do not lie between samples.

use crate::instance::Instance;
use crate::lanes::{I, Ints as _, LANES, Mask};
use crate::mesh::{CLUSTER, Cluster, Mesh};
use crate::raster::Drawing;
use crate::setup::{extent, is_large, owns_samples, winding_order};

pub(crate) struct Candidates {
    pub(crate) count: usize,
    pub(crate) triangles: [u8; ROOM],
    /// Rows of the corners among the positions, in winding order.
    pub(crate) corners: [[u8; ROOM]; 3],
    /// Bit per triangle of the cluster: a part of it lies outside the view frustum.
    pub(crate) needs_clipping: u64,
}

/// Capacity for a cluster, plus room for reading eight at a time.
const ROOM: usize = CLUSTER + LANES;
const _: () = assert!(CLUSTER <= u64::BITS as usize, "a bit for each triangle");

impl Candidates {
    /// Selects the candidates. `is_beyond` is true if any position lies outside the view frustum.
    /// Triangles that extend beyond the frustum are kept for clipping.
    #[inline(always)]
    pub(crate) fn find(
        instance: &Instance,
        mesh: &Mesh,
        cluster: &Cluster,
        drawing: &Drawing<'_>,
        is_beyond: bool,
    ) -> Self {
        let mut found =
            Self { count: 0, triangles: [0; ROOM], corners: [[0; ROOM]; 3], needs_clipping: 0 };
        let order = winding_order(instance.counter_clockwise);
        let first = cluster.first_triangle as usize;
        let count = cluster.triangles as usize;
        let splat = |value: i32| I::splat(value);
        let [left, low] = [drawing.window.x, drawing.window.y].map(|range| splat(range[0] * 4));
        let [right, high] =
            [drawing.window.x, drawing.window.y].map(|range| splat(range[1] * 4 + 3));
        let positions = &*drawing.positions;
        let padded = count.next_multiple_of(LANES);
        let places = order.map(|corner| &mesh.position_ids[corner][first..first + padded]);
        for at in (0..count).step_by(LANES) {
            let mut ids = [[0; LANES]; 3];
            for (ids, places) in ids.iter_mut().zip(places) {
                ids.copy_from_slice(&places[at..at + LANES]);
            }
            let corners = positions.corners(&ids);
            let mut left_out = 0;
            if at + LANES > count {
                left_out = !0 << (count - at);
            }
            if is_beyond {
                let [a, b, c] = corners.beyond();
                let reach_beyond = !(a | b | c).equals(splat(0));
                let all_beyond = !(a & b & c).equals(splat(0));
                let clipped = (reach_beyond & !all_beyond).bits() & !left_out;
                found.needs_clipping |= u64::from(clipped) << at;
                left_out |= reach_beyond.bits();
            }
            let (x, y) = corners.snapped();
            let ([x0, x1], [y0, y1]) = (extent(&x), extent(&y));
            // Columns and rows of samples are 64 subpixel units apart, the first at 32. Each row
            // and each column of a pixel contains one sample.
            let (column0, column1) =
                (((x0 + splat(31)) >> 6i32).max(left), ((x1 - splat(32)) >> 6i32).min(right));
            let (row0, row1) =
                (((y0 + splat(31)) >> 6i32).max(low), ((y1 - splat(32)) >> 6i32).min(high));
            let mut selected = column0.le(column1) & row0.le(row1);
            let three = splat(3);
            let column_of_row = sample_column(row0);
            // The constant has two bits per column of a pixel: the row of the column's sample.
            let row_of_column = (splat(0x72) >> ((column0 & three) << 1i32)) & three;
            // Discards triangles that reach one row or column of samples but none of its samples.
            let one_row =
                row0.equals(row1) & ((column_of_row - column0) & three).gt(column1 - column0);
            let one_column =
                column0.equals(column1) & ((row_of_column - row0) & three).gt(row1 - row0);
            selected = selected & !(one_row | one_column);
            let area = (x[0] - x[1]) * (y[2] - y[0]) - (x[2] - x[0]) * (y[0] - y[1]);
            selected = selected & (area.gt(splat(0)) | is_large([x0, x1], [y0, y1]));
            if !selected.any() {
                continue;
            }
            let is_small =
                (row1 - row0).lt(splat(SMALL[1])) & (column1 - column0).lt(splat(SMALL[0]));
            let grid = [[column0, column1], [row0, row1]];
            let mut bits = (selected & (!is_small | small_triangles_with_samples(&x, &y, grid)))
                .bits()
                & !left_out;
            while bits != 0 {
                let lane = bits.trailing_zeros() as usize;
                bits &= bits - 1;
                found.triangles[found.count] = (at + lane) as u8;
                for (corners, ids) in found.corners.iter_mut().zip(&ids) {
                    corners[found.count] = ids[lane];
                }
                found.count += 1;
            }
        }
        found
    }
}

/// Largest span in columns and rows of samples: two adjacent pixels.
const SMALL: [i32; 2] = [8, 4];

/// Returns the column of a row's sample within a pixel. The constant has two bits per row.
#[inline(always)]
fn sample_column(row: I) -> I {
    (I::splat(0x8d) >> ((row & I::splat(3)) << 1i32)) & I::splat(3)
}

/// Returns the mask that is true for each of eight small triangles that covers a sample. `columns`
/// and `rows` are the first and last columns and rows of samples that each triangle may cover.
#[inline(always)]
fn small_triangles_with_samples(x: &[I; 3], y: &[I; 3], [columns, rows]: [[I; 2]; 2]) -> Mask {
    let splat = |value: i32| I::splat(value);
    // Positions of the first column and the first row of samples, in subpixel units.
    let [first_x, first_y] = [columns[0], rows[0]].map(|first| (first << 6i32) + splat(32));
    let mut edges = [splat(0); 3];
    let (mut per_column, mut per_row) = (edges, edges);
    for edge in 0..3 {
        let next = (edge + 1) % 3;
        let (dx, dy) = (y[edge] - y[next], x[edge] - x[next]);
        let value = dx * (x[edge] - first_x) - dy * (y[edge] - first_y);
        edges[edge] = value - owns_samples(dx, dy).ints() - splat(1);
        per_column[edge] = dx << 6i32;
        per_row[edge] = dy << 6i32;
    }
    let mut covers = Mask::from_bits(0);
    for row in 0..SMALL[1] {
        let row = rows[0] + splat(row);
        let offset = (sample_column(row) - columns[0]) & splat(3);
        let near = [0, 1, 2].map(|edge| edges[edge] - per_column[edge] * offset);
        let far = [0, 1, 2].map(|edge| near[edge] - (per_column[edge] << 2i32));
        let covered = |values: [I; 3], column: I| {
            (values[0] | values[1] | values[2]).ge(splat(0)) & column.le(columns[1])
        };
        let column = columns[0] + offset;
        let either = covered(near, column) | covered(far, column + splat(4));
        covers = covers | either & row.le(rows[1]);
        edges = [0, 1, 2].map(|edge| edges[edge] + per_row[edge]);
    }
    covers
}
