//! From a triangle's edges and depths to the samples that it covers, two pixels
//! at a time; a large one block by block.

use crate::drawing::Drawing;
use crate::lanes::{F, Floats as _, I, Ints as _, LANES, Mask};
use crate::positions::SUBPIXELS;
use crate::setup::Setup;
use crate::visible::{BLOCK, Layer, Ranks, Record, SAMPLES, Visible};
use crate::window::Window;

/// Where the samples of two pixels side by side are, in lattice points from the
/// first one's corner.
const LANE_X: [i32; LANES] = [3, 7, 1, 5, 11, 15, 9, 13];
const LANE_Y: [i32; LANES] = [1, 3, 5, 7, 1, 3, 5, 7];
/// The same of the first, in pixels along x and y.
pub(crate) const FIRST_SAMPLE: [f32; 2] = [0.375, 0.125];
/// Parts of a pixel from one lattice point to the next.
const LATTICE: i32 = 32;
const POINTS_PER_PIXEL: i32 = SUBPIXELS / LATTICE;

/// Fills one of the triangles that were set up.
#[inline(always)]
pub(crate) fn fill(lane: usize, setup: &Setup, record: Record, drawing: &mut Drawing<'_>) {
    let (x, y) = (setup.x.map(|end| end[lane]), setup.y.map(|end| end[lane]));
    let id = drawing.visible.records.len() as u32;
    let touched = if setup.large & (1 << lane) == 0 {
        let edges = [0, 1, 2].map(|edge| setup.edge[edge][lane]);
        fill_block::<false>(lane, setup, edges, (x, y, (record, id)), drawing)
    } else {
        fill_large(lane, setup, x, y, (record, id), drawing)
    };
    if touched {
        let visible = &mut *drawing.visible;
        visible.records.push(record);
        visible.touched = Window::around(visible.touched, Some(Window { x, y }));
    }
}

#[inline(never)]
fn fill_large(
    lane: usize,
    setup: &Setup,
    x: [i32; 2],
    y: [i32; 2],
    (record, id): (Record, u32),
    drawing: &mut Drawing<'_>,
) -> bool {
    let corners = setup
        .corners
        .each_ref()
        .map(|corner| corner.map(|axis| i64::from(axis[lane])));
    let [a, b, c] = corners;
    if (a[0] - b[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (a[1] - b[1]) <= 0 {
        return false;
    }
    let first = [x[0] & !(BLOCK - 1), y[0] & !(BLOCK - 1)];
    let edges = [0, 1, 2].map(|edge| LongEdge::new(corners[edge], corners[(edge + 1) % 3], first));
    let mut touched = false;
    for (down, block_y) in (first[1]..=y[1]).step_by(BLOCK as usize).enumerate() {
        for (right, block_x) in (first[0]..=x[1]).step_by(BLOCK as usize).enumerate() {
            let blocks = [right as i64, down as i64];
            if edges.iter().any(|edge| edge.is_beyond(blocks)) {
                continue;
            }
            let block = drawing.visible.block_of(block_x, block_y);
            let depths = depth_range(lane, setup, [block_x, block_y]);
            if depths[1] < drawing.visible.hidden_beyond[block] {
                continue;
            }
            let is_inside = edges.iter().all(|edge| edge.is_before(blocks));
            let part_x = [block_x.max(x[0]), (block_x + BLOCK - 1).min(x[1])];
            let part_y = [block_y.max(y[0]), (block_y + BLOCK - 1).min(y[1])];
            // To the first of its pixels, in lattice points.
            let off = [part_x[0] & !1, part_y[0]];
            let off = [off[0] - block_x, off[1] - block_y].map(|off| off * POINTS_PER_PIXEL);
            let at = [0, 1, 2].map(|edge| {
                let (dx, dy) = (setup.along_x[edge][lane], setup.along_y[edge][lane]);
                edges[edge]
                    .at(blocks)
                    .wrapping_add(dx.wrapping_mul(off[0]))
                    .wrapping_add(dy.wrapping_mul(off[1]))
            });
            let part = (part_x, part_y, (record, id));
            if !is_inside {
                touched |= fill_block::<false>(lane, setup, at, part, drawing);
                continue;
            }
            touched |= fill_block::<true>(lane, setup, at, part, drawing);
            let is_whole = drawing.layers.is_none()
                && part_x == [block_x, block_x + BLOCK - 1]
                && part_y == [block_y, block_y + BLOCK - 1];
            let beyond = &mut drawing.visible.hidden_beyond[block];
            if is_whole && depths[0] > *beyond {
                *beyond = depths[0];
            }
        }
    }
    touched
}

/// The least and the largest depth of a triangle's plane in a block, rounding
/// allowed for.
fn depth_range(lane: usize, setup: &Setup, [x, y]: [i32; 2]) -> [f32; 2] {
    let (depth, per_x, per_y) = (setup.depth[lane], setup.depth_x[lane], setup.depth_y[lane]);
    let along = |from: i32, per: f32| [from as f32 * per, (from + BLOCK) as f32 * per];
    let (along_x, along_y) = (along(x, per_x), along(y, per_y));
    let least = depth + along_x[0].min(along_x[1]) + along_y[0].min(along_y[1]);
    let most = depth + along_x[0].max(along_x[1]) + along_y[0].max(along_y[1]);
    let parts = [depth, along_x[0], along_x[1], along_y[0], along_y[1]];
    let slack = 1e-6 * parts.iter().map(|part| part.abs()).sum::<f32>();
    [least - slack, most + slack]
}

/// An edge of a large triangle, block by block.
struct LongEdge {
    /// At the corner of the first block, and what it changes by per block.
    value: i64,
    along: [i64; 2],
}

impl LongEdge {
    fn new([x, y]: [i64; 2], [next_x, next_y]: [i64; 2], pixel: [i32; 2]) -> Self {
        let (dx, dy) = (y - next_y, x - next_x);
        let [from_x, from_y] = pixel.map(|pixel| i64::from(pixel) * i64::from(SUBPIXELS));
        let value = dx * (x - from_x) - dy * (y - from_y);
        let is_in = i64::from(dx < 0 || dx == 0 && dy > 0);
        let block = i64::from(BLOCK * POINTS_PER_PIXEL);
        Self {
            // Rounded down, so that the sign is that of the whole value.
            value: (value + is_in - 1).div_euclid(i64::from(LATTICE)),
            along: [-dx * block, dy * block],
        }
    }

    fn value_at(&self, [right, down]: [i64; 2]) -> i64 {
        self.value + right * self.along[0] + down * self.along[1]
    }

    /// Whether a block is wholly on its outer side.
    fn is_beyond(&self, block: [i64; 2]) -> bool {
        self.value_at(block) + self.along[0].max(0) + self.along[1].max(0) < 0
    }

    /// Whether a block is wholly on its inner side.
    fn is_before(&self, block: [i64; 2]) -> bool {
        self.value_at(block) + self.along[0].min(0) + self.along[1].min(0) >= 0
    }

    /// At a block's corner. Where 32 bits are not enough, the block is far from
    /// the edge.
    fn at(&self, block: [i64; 2]) -> i32 {
        const FAR: i64 = 1 << 30;
        self.value_at(block).clamp(-FAR, FAR) as i32
    }
}

/// Fills the part of a triangle in some pixels; `edges` are at the corner of the
/// first even pixel. An `INSIDE` part has no edge there. Returns whether the
/// triangle is seen anywhere.
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
    let per_pair =
        [0, 1, 2].map(|edge| splat(setup.along_x[edge][lane]) * splat(2 * POINTS_PER_PIXEL));
    let per_row = [0, 1, 2].map(|edge| splat(setup.along_y[edge][lane]) * splat(POINTS_PER_PIXEL));
    let pixels = real(1.0 / POINTS_PER_PIXEL as f32);
    let (off_x, off_y) = (lane_x.float() * pixels, lane_y.float() * pixels);
    let (depth, depth_x, depth_y) = (
        real(setup.depth[lane]),
        real(setup.depth_x[lane]),
        real(setup.depth_y[lane]),
    );
    let first_x = x[0] & !1;
    let Visible {
        stride,
        depths,
        ids,
        records,
        clipped,
        ..
    } = &mut *drawing.visible;
    let ranks = Ranks {
        model: drawing.model,
        instances: drawing.instances,
        records,
        clipped,
    };
    let mut touched = false;
    for pixel_y in y[0]..=y[1] {
        let mut edge = rows;
        let sample_y = real(pixel_y as f32) + off_y;
        let row = (pixel_y as usize * *stride + first_x as usize) * SAMPLES;
        let pairs = (x[1] - first_x) as usize / 2 + 1;
        let depths = &mut depths[row..row + pairs * LANES];
        let ids = &mut ids[row..row + pairs * LANES];
        let mut pixel_x = first_x as f32;
        for (depths, ids) in depths
            .chunks_exact_mut(LANES)
            .zip(ids.chunks_exact_mut(LANES))
        {
            let inside = (edge[0] | edge[1] | edge[2]).ge(splat(0));
            if INSIDE || inside.any() {
                let sample_x = real(pixel_x) + off_x;
                let z = depth_y.fused(sample_y, depth_x.fused(sample_x, depth));
                let nearest = F::load(depths);
                let mut seen = match INSIDE {
                    true => z.ge(nearest),
                    false => inside & z.ge(nearest),
                };
                if let Some(layers) = &mut drawing.layers {
                    let samples = seen.bits();
                    if samples != 0 {
                        touched = true;
                        layers.list.push(Layer {
                            rank: ranks.of(&record),
                            id,
                            x: pixel_x as u16,
                            y: pixel_y as u16,
                            samples,
                        });
                    }
                    edge = [0, 1, 2].map(|at| edge[at] + per_pair[at]);
                    pixel_x += 2.0;
                    continue;
                }
                let ties = seen & z.equals(nearest);
                if ties.any() {
                    let lost = ranks.lost_ties(ties.bits(), ids, &record);
                    seen = seen & !Mask::from_bits(lost);
                }
                if seen.any() {
                    touched = true;
                    seen.select(z, nearest).store(depths);
                    let before = I::load_unsigned(ids);
                    let now = I::splat(id.cast_signed());
                    seen.select_ints(now, before).store_unsigned(ids);
                }
            }
            edge = [0, 1, 2].map(|at| edge[at] + per_pair[at]);
            pixel_x += 2.0;
        }
        rows = [0, 1, 2].map(|at| rows[at] + per_row[at]);
    }
    touched
}
