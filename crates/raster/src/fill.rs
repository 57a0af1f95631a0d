//! Rasterisation of a triangle from its edges and depths to the covered samples: two pixels at a
//! time, and block by block for large triangles.

use crate::lanes::{F, Floats as _, I, Ints as _, LANES, Mask};
use crate::positions::SUBPIXELS;
use crate::raster::Drawing;
use crate::setup::Setup;
use crate::visible::{BLOCK, Layer, PART, Ranks, Record, SAMPLES, Visible};

/// Samples of two pixels side by side, in lattice points from the first one's corner.
const LANE_X: [i32; LANES] = [3, 7, 1, 5, 11, 15, 9, 13];
const LANE_Y: [i32; LANES] = [1, 3, 5, 7, 1, 3, 5, 7];
/// Position of the first pixel's first sample, in pixels along x and y.
pub(crate) const FIRST_SAMPLE: [f32; 2] = [0.375, 0.125];
/// Subpixel units between two lattice points.
const LATTICE: i32 = 32;
const POINTS_PER_PIXEL: i32 = SUBPIXELS / LATTICE;

/// Shifts that multiply by the lattice points across a pair of pixels, and across a row.
const PAIR_SHIFT: i32 = (2 * POINTS_PER_PIXEL).ilog2() as i32;
const ROW_SHIFT: i32 = POINTS_PER_PIXEL.ilog2() as i32;

/// Offsets of the parts of a block from its corner, in lattice points along x and along y.
const PART_X: [i32; LANES] = [0, 64, 0, 64, 0, 64, 0, 64];
const PART_Y: [i32; LANES] = [0, 0, 32, 32, 64, 64, 96, 96];
/// Triangles that span more pairs of pixels than this are filled part by part.
const MAX_PAIRS: i32 = 16;

#[inline(always)]
pub(crate) fn fill(lane: usize, setup: &Setup, record: Record, drawing: &mut Drawing<'_>) {
    // `lane` is already below `LANES`; the remainder removes the bounds check of each read.
    let lane = lane % LANES;
    let (x, y) = (setup.x.map(|end| end[lane]), setup.y.map(|end| end[lane]));
    let id = drawing.visible.records.len() as u32;
    let area = (x, y, (record, id));
    let touched = if setup.large & (1 << lane) != 0 {
        fill_large(lane, setup, area, drawing)
    } else if ((x[1] >> 1) - (x[0] >> 1) + 1) * (y[1] - y[0] + 1) > MAX_PAIRS {
        fill_medium(lane, setup, area, drawing)
    } else {
        let edges = [0, 1, 2].map(|edge| setup.edge[edge][lane]);
        let touched = fill_block::<false>(lane, setup, edges, area, drawing);
        if touched {
            drawing.visible.mark_written(x, y, 1);
        }
        touched
    };
    if touched {
        drawing.visible.records.push(record);
        drawing.touched.add(x, y);
    }
}

/// Inclusive ranges of pixels along x and y, and the triangle in them.
type Area = ([i32; 2], [i32; 2], (Record, u32));

/// The first pixel of each block, and its column and row among the blocks in the range.
fn blocks(x: [i32; 2], y: [i32; 2]) -> impl Iterator<Item = ([i32; 2], [i64; 2])> {
    let [left, low] = [x[0], y[0]].map(|first| first / BLOCK);
    (low..=y[1] / BLOCK).flat_map(move |row| {
        (left..=x[1] / BLOCK).map(move |column| {
            let index = [i64::from(column - left), i64::from(row - low)];
            ([column * BLOCK, row * BLOCK], index)
        })
    })
}

#[inline(never)]
fn fill_large(lane: usize, setup: &Setup, area: Area, drawing: &mut Drawing<'_>) -> bool {
    let (x, y, _) = area;
    let corners = setup.corners.each_ref().map(|corner| corner.map(|axis| i64::from(axis[lane])));
    let [a, b, c] = corners;
    if (a[0] - b[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (a[1] - b[1]) <= 0 {
        return false;
    }
    let first = [x[0] & !(BLOCK - 1), y[0] & !(BLOCK - 1)];
    let edges = [0, 1, 2].map(|edge| LongEdge::new(corners[edge], corners[(edge + 1) % 3], first));
    let mut touched = false;
    for (block, block_index) in blocks(x, y) {
        if edges.iter().any(|edge| edge.is_outside(block_index)) {
            continue;
        }
        let at = edges.each_ref().map(|edge| edge.at(block_index));
        if edges.iter().all(|edge| edge.is_inside(block_index)) {
            touched |= fill_parts::<true>(lane, setup, (block, at), area, drawing);
        } else {
            touched |= fill_parts::<false>(lane, setup, (block, at), area, drawing);
        }
    }
    touched
}

/// Fills a triangle whose edge functions fit in 32 bits.
#[inline(never)]
fn fill_medium(lane: usize, setup: &Setup, area: Area, drawing: &mut Drawing<'_>) -> bool {
    let (x, y, _) = area;
    let mut touched = false;
    for (block, _) in blocks(x, y) {
        let offset =
            [block[0] - (x[0] & !1), block[1] - y[0]].map(|offset| offset * POINTS_PER_PIXEL);
        let at = [0, 1, 2].map(|edge| {
            let (dx, dy) = (setup.along_x[edge][lane], setup.along_y[edge][lane]);
            setup.edge[edge][lane] + dx * offset[0] + dy * offset[1]
        });
        touched |= fill_parts::<false>(lane, setup, (block, at), area, drawing);
    }
    touched
}

/// Fills the parts that the triangle reaches and that do not occlude it; `at` holds the edge values
/// at the block's corner. An `INSIDE` block contains no edge. Returns true if anything is visible.
#[inline(always)]
fn fill_parts<const INSIDE: bool>(
    lane: usize,
    setup: &Setup,
    (block, at): ([i32; 2], [i32; 3]),
    (x, y, triangle): Area,
    drawing: &mut Drawing<'_>,
) -> bool {
    let (parts, whole_block) = drawing.visible.depth_bounds(block);
    let max_depths = max_depths(lane, setup, block);
    if max_depths.lt(F::splat(whole_block)).all() {
        return false;
    }
    let mut reached = !max_depths.lt(parts);
    let mut inside = !0;
    if !INSIDE {
        let zero = I::splat(0);
        let [width, height] = PART.map(|side| side * POINTS_PER_PIXEL);
        let mut is_inside = Mask::from_bits(0xff);
        for (edge, &start) in at.iter().enumerate() {
            let (dx, dy) = (setup.along_x[edge][lane], setup.along_y[edge][lane]);
            let corners =
                I::splat(start) + I::splat(dx) * I::new(PART_X) + I::splat(dy) * I::new(PART_Y);
            let (across, up) = (dx * width, dy * height);
            reached = reached & (corners + I::splat(across.max(0) + up.max(0))).ge(zero);
            is_inside = is_inside & (corners + I::splat(across.min(0) + up.min(0))).ge(zero);
        }
        inside = is_inside.bits();
    }
    let mut bits = reached.bits();
    let mut touched = false;
    while bits != 0 {
        let part = bits.trailing_zeros();
        bits &= bits - 1;
        let (left, low) =
            (block[0] + (part & 1) as i32 * PART[0], block[1] + (part >> 1) as i32 * PART[1]);
        let part_x = [left.max(x[0]), (left + PART[0] - 1).min(x[1])];
        let part_y = [low.max(y[0]), (low + PART[1] - 1).min(y[1])];
        if part_x[0] > part_x[1] || part_y[0] > part_y[1] {
            continue;
        }
        // Offset of the part's first pixel from the block's corner, in lattice points.
        let offset = [(part_x[0] & !1) - block[0], part_y[0] - block[1]]
            .map(|offset| offset * POINTS_PER_PIXEL);
        let at = [0, 1, 2].map(|edge| {
            let (dx, dy) = (setup.along_x[edge][lane], setup.along_y[edge][lane]);
            at[edge]
                .wrapping_add(dx.wrapping_mul(offset[0]))
                .wrapping_add(dy.wrapping_mul(offset[1]))
        });
        let pixels = (part_x, part_y, triangle);
        if INSIDE || inside & (1 << part) != 0 {
            touched |= fill_block::<true>(lane, setup, at, pixels, drawing);
        } else {
            touched |= fill_block::<false>(lane, setup, at, pixels, drawing);
        }
    }
    if touched {
        // Every part that the triangle may cover counts as two writes.
        let parts = reached.bits().count_ones() as u8;
        drawing.visible.mark_written([block[0]; 2], [block[1]; 2], 2 * parts);
    }
    touched
}

/// Upper bounds, including rounding.
#[inline(always)]
fn max_depths(lane: usize, setup: &Setup, [x, y]: [i32; 2]) -> F {
    let real = |value: f32| F::splat(value);
    let pixel = |first: i32, points: [i32; LANES]| -> F {
        let points: F = I::new(points).float();
        real(first as f32) + points * real(1.0 / POINTS_PER_PIXEL as f32)
    };
    let (depth, per_x, per_y) = (setup.depth[lane], setup.depth_x[lane], setup.depth_y[lane]);
    let along = |from: F, per: f32, side: i32| {
        let (near, far) = (from * real(per), (from + real(side as f32)) * real(per));
        (near.max(far), near.abs() + far.abs())
    };
    let (most_x, slack_x) = along(pixel(x, PART_X), per_x, PART[0]);
    let (most_y, slack_y) = along(pixel(y, PART_Y), per_y, PART[1]);
    let slack = real(1e-6) * (real(depth.abs()) + slack_x + slack_y);
    real(depth) + most_x + most_y + slack
}

/// Edge function of a large triangle, evaluated per block.
struct LongEdge {
    /// Value at the corner of the first block, and its change per block.
    value: i64,
    along: [i64; 2],
}

impl LongEdge {
    fn new([x, y]: [i64; 2], [next_x, next_y]: [i64; 2], pixel: [i32; 2]) -> Self {
        let (dx, dy) = (y - next_y, x - next_x);
        let [from_x, from_y] = pixel.map(|pixel| i64::from(pixel) * i64::from(SUBPIXELS));
        let value = dx * (x - from_x) - dy * (y - from_y);
        // 1 if the edge owns the samples exactly on it (top-left rule), see `setup::owns_samples`.
        let owned = i64::from(dx < 0 || dx == 0 && dy > 0);
        let block = i64::from(BLOCK * POINTS_PER_PIXEL);
        Self {
            // The value is rounded down, which preserves its sign.
            value: (value + owned - 1).div_euclid(i64::from(LATTICE)),
            along: [-dx * block, dy * block],
        }
    }

    fn value_at(&self, [column, row]: [i64; 2]) -> i64 {
        self.value + column * self.along[0] + row * self.along[1]
    }

    fn is_outside(&self, block: [i64; 2]) -> bool {
        self.value_at(block) + self.along[0].max(0) + self.along[1].max(0) < 0
    }

    fn is_inside(&self, block: [i64; 2]) -> bool {
        self.value_at(block) + self.along[0].min(0) + self.along[1].min(0) >= 0
    }

    /// Value clamped to 32 bits, since the block is then far from the edge.
    fn at(&self, block: [i64; 2]) -> i32 {
        const FAR: i64 = 1 << 30;
        self.value_at(block).clamp(-FAR, FAR) as i32
    }
}

/// `edges` holds the values at the corner of the first even pixel. An `INSIDE` part contains no
/// edge. Returns true if anything is visible.
#[inline(always)]
fn fill_block<const INSIDE: bool>(
    lane: usize,
    setup: &Setup,
    edges: [i32; 3],
    (x, y, (record, id)): ([i32; 2], [i32; 2], (Record, u32)),
    drawing: &mut Drawing<'_>,
) -> bool {
    let lane_x = I::new(LANE_X);
    let lane_y = I::new(LANE_Y);
    let splat = |value: i32| I::splat(value);
    let real = |value: f32| F::splat(value);
    let mut rows = [0, 1, 2].map(|edge| {
        splat(edges[edge])
            + splat(setup.along_x[edge][lane]) * lane_x
            + splat(setup.along_y[edge][lane]) * lane_y
    });
    let per_pair = [0, 1, 2].map(|edge| splat(setup.along_x[edge][lane]) << PAIR_SHIFT);
    let per_row = [0, 1, 2].map(|edge| splat(setup.along_y[edge][lane]) << ROW_SHIFT);
    let pixels = real(1.0 / POINTS_PER_PIXEL as f32);
    let (off_x, off_y) = (lane_x.float() * pixels, lane_y.float() * pixels);
    let (depth, depth_x, depth_y) =
        (real(setup.depth[lane]), real(setup.depth_x[lane]), real(setup.depth_y[lane]));
    let first_x = x[0] & !1;
    let Visible { stride, depths, ids, records, clipped, .. } = &mut *drawing.visible;
    let ranks = Ranks { model: drawing.model, instances: drawing.instances, records, clipped };
    let first_sample_x = real(first_x as f32) + off_x;
    let mut touched = false;
    for pixel_y in y[0]..y[1] + 1 {
        let mut edge = rows;
        let sample_y = real(pixel_y as f32) + off_y;
        let row = (pixel_y as usize * *stride + first_x as usize) * SAMPLES;
        let pairs = (x[1] - first_x) as usize / 2 + 1;
        let depths = &mut depths[row..row + pairs * LANES];
        let ids = &mut ids[row..row + pairs * LANES];
        let mut sample_x = first_sample_x;
        for (pair, (depths, ids)) in
            depths.chunks_exact_mut(LANES).zip(ids.chunks_exact_mut(LANES)).enumerate()
        {
            let inside = (edge[0] | edge[1] | edge[2]).ge(splat(0));
            edge = [0, 1, 2].map(|at| edge[at] + per_pair[at]);
            let z = depth_y.fused(sample_y, depth_x.fused(sample_x, depth));
            sample_x += real(2.0);
            let nearest = F::load(depths);
            let mut passed = if INSIDE { z.ge(nearest) } else { inside & z.ge(nearest) };
            if !passed.any() {
                continue;
            }
            if let Some(layers) = &mut drawing.layers {
                touched = true;
                layers.list.push(Layer {
                    rank: ranks.rank(&record),
                    id,
                    x: (first_x + 2 * pair as i32) as u16,
                    y: pixel_y as u16,
                    samples: passed.bits(),
                });
                continue;
            }
            let ties = passed & z.equals(nearest);
            if ties.any() {
                let lost = ranks.lost_ties(ties.bits(), ids, &record);
                passed = passed & !Mask::from_bits(lost);
                if !passed.any() {
                    continue;
                }
            }
            touched = true;
            passed.select(z, nearest).store(depths);
            let before = I::load_unsigned(ids);
            let now = I::splat(id.cast_signed());
            passed.select_ints(now, before).store_unsigned(ids);
        }
        rows = [0, 1, 2].map(|at| rows[at] + per_row[at]);
    }
    touched
}
