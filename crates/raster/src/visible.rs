//! Visibility buffer: the nearest triangle at every sample, and its depth.

use crate::clip::ClippedTriangle;
use crate::instance::Instance;
use crate::lanes::{F, Floats as _, LANES};
use crate::model::Model;
use crate::window::Window;

pub(crate) const SAMPLES: usize = 4;
/// Side of the blocks for which depth bounds are tracked, pixels.
pub(crate) const BLOCK: i32 = 16;
/// Width and height of a block's parts, pixels. A block has two columns and four rows of parts. Row
/// by row, each lane of a vector stands for one part.
pub(crate) const PART: [i32; 2] = [8, 4];

/// Number of writes to a block after which its depth bounds are recomputed. A small triangle counts
/// as one write, and every part of the block that a large triangle may cover as two.
const WRITES_PER_UPDATE: u8 = 16;

/// Marks a sample without a triangle.
pub(crate) const NOTHING: u32 = u32::MAX;

#[derive(Debug, Clone, Copy)]
pub(crate) struct Record {
    pub(crate) instance: u32,
    /// Index in the mesh, or among the clipped triangles if `vertices` is [`CLIPPED`].
    pub(crate) triangle: u32,
    /// Index in the mesh at which the vertices of the triangle's cluster start, or [`CLIPPED`].
    pub(crate) vertices: u32,
}

/// Value of [`Record::vertices`] that marks a piece of a clipped triangle.
pub(crate) const CLIPPED: u32 = u32::MAX;

/// Depths only grow while a picture is drawn, so bounds stay valid.
#[derive(Debug, Clone, Copy)]
struct Block {
    /// Per part: lower bound of its samples' depths.
    parts: [f32; LANES],
    whole: f32,
    /// Number of writes since the bounds were computed.
    writes: u8,
}

#[derive(Debug, Default)]
pub(crate) struct Visible {
    pub(crate) width: usize,
    pub(crate) height: usize,
    /// Pixels from one row to the next; even, since two pixels are drawn at once.
    pub(crate) stride: usize,
    /// Depths: 1 at the near plane, 0 at the far plane.
    pub(crate) depths: Vec<f32>,
    /// Blocks of the picture, row by row, and the number of blocks in a row.
    blocks: Vec<Block>,
    blocks_in_row: usize,
    /// Indices into `records`.
    pub(crate) ids: Vec<u32>,
    pub(crate) records: Vec<Record>,
    pub(crate) clipped: Vec<ClippedTriangle>,
    /// Bounding window of everything that became visible since the last clearing.
    pub(crate) touched: Option<Window>,
}

impl Visible {
    pub(crate) fn resize(&mut self, [width, height]: [usize; 2]) {
        // Padding keeps rows whose width is a power of two from competing for cache lines.
        let stride = width.next_multiple_of(2) + 4;
        (self.width, self.height, self.stride) = (width, height, stride);
    }

    pub(crate) fn clear(&mut self, size: [usize; 2], window: Window) {
        self.resize(size);
        let (stride, samples) = (self.stride, self.stride * self.height * SAMPLES);
        if self.depths.len() == samples {
            for row in window.rows(stride) {
                let row = row.start * SAMPLES..row.end * SAMPLES;
                self.depths[row.clone()].fill(0.0);
                self.ids[row].fill(NOTHING);
            }
        } else {
            self.depths = vec![0.0; samples];
            self.ids = vec![NOTHING; samples];
        }
        self.records.clear();
        self.clipped.clear();
        self.touched = None;
        self.reset_blocks(0);
    }

    /// Invalidates the depth bounds. Must be called after code outside this module changed depths.
    pub(crate) fn invalidate_bounds(&mut self) {
        self.reset_blocks(WRITES_PER_UPDATE);
    }

    fn reset_blocks(&mut self, writes: u8) {
        self.blocks_in_row = self.width.div_ceil(BLOCK as usize);
        let blocks = self.blocks_in_row * self.height.div_ceil(BLOCK as usize);
        self.blocks.clear();
        let cleared = Block { parts: [0.0; LANES], whole: 0.0, writes };
        self.blocks.resize(blocks, cleared);
    }

    #[inline(always)]
    fn block_of(&self, x: i32, y: i32) -> usize {
        let [x, y] = [x, y].map(|at| at.cast_unsigned() as usize / BLOCK as usize);
        y * self.blocks_in_row + x
    }

    /// The ranges of pixels are inclusive; see [`WRITES_PER_UPDATE`].
    #[inline(always)]
    pub(crate) fn mark_written(&mut self, x: [i32; 2], y: [i32; 2], writes: u8) {
        let mark = |block: &mut Block| block.writes = block.writes.saturating_add(writes);
        let (first, last) = (self.block_of(x[0], y[0]), self.block_of(x[1], y[1]));
        mark(&mut self.blocks[first]);
        if first == last {
            return;
        }
        let right = self.block_of(x[1], y[0]);
        self.blocks[first + 1..=right].iter_mut().for_each(mark);
        for row in (right + self.blocks_in_row..=last).step_by(self.blocks_in_row) {
            let blocks = &mut self.blocks[row + first - right..=row];
            blocks.iter_mut().for_each(mark);
        }
    }

    /// Lower bounds in the parts of the block with this first pixel, and in the whole block.
    #[inline(always)]
    pub(crate) fn depth_bounds(&mut self, [x, y]: [i32; 2]) -> (F, f32) {
        let at = self.block_of(x, y);
        if self.blocks[at].writes >= WRITES_PER_UPDATE {
            self.blocks[at] = self.bounds([x as usize, y as usize]);
        }
        let block = &self.blocks[at];
        (F::new(block.parts), block.whole)
    }

    /// Bounds of the block with this first pixel. Parts outside the picture occlude everything.
    #[inline(never)]
    fn bounds(&self, [x, y]: [usize; 2]) -> Block {
        let mut parts = [F::splat(f32::INFINITY); LANES];
        let [width, height] = PART.map(|side| side as usize);
        for row in 0..(self.height - y).min(BLOCK as usize) {
            for column in 0..2 {
                let left = x + column * width;
                let right = (left + width).min(self.width);
                if left >= right {
                    continue;
                }
                // One pixel more can only lower the bound.
                let pixels = (right - left).next_multiple_of(2);
                let first = ((y + row) * self.stride + left) * SAMPLES;
                let samples = &self.depths[first..first + pixels * SAMPLES];
                let least = &mut parts[row / height * 2 + column];
                for eight in samples.chunks_exact(LANES) {
                    *least = least.min(F::load(eight));
                }
            }
        }
        let [a, b, c, d, e, f, g, h] = F::transpose(parts);
        let parts = a.min(b).min(c.min(d)).min(e.min(f).min(g.min(h))).to_array();
        Block { parts, whole: parts.iter().fold(f32::INFINITY, |a, b| a.min(*b)), writes: 0 }
    }
}

#[derive(Debug, Clone, Copy)]
pub(crate) struct Layer {
    /// Indices of instance and triangle in drawing order.
    pub(crate) rank: (u32, u32),
    pub(crate) id: u32,
    pub(crate) x: u16,
    pub(crate) y: u16,
    /// Bits of the first pixel's samples, then of the second pixel's samples.
    pub(crate) samples: u32,
}

/// Receives layers. Drawing stops when there are more than `max`, and the list is then incomplete.
pub(crate) struct Layers<'a> {
    pub(crate) list: &'a mut Vec<Layer>,
    pub(crate) max: usize,
}

/// Tables for comparing the drawing order of two triangles.
pub(crate) struct Ranks<'a> {
    pub(crate) model: &'a Model,
    pub(crate) instances: &'a [Instance],
    pub(crate) records: &'a [Record],
    pub(crate) clipped: &'a [ClippedTriangle],
}

impl Ranks<'_> {
    /// Returns the drawing order of the instance and of the triangle within its mesh.
    pub(crate) fn rank(&self, record: &Record) -> (u32, u32) {
        let triangle = match record.vertices {
            CLIPPED => self.clipped[record.triangle as usize].triangle,
            _ => record.triangle,
        };
        let instance = &self.instances[record.instance as usize];
        let mesh = instance.mesh.resolve(self.model);
        (instance.rank, mesh.order[triangle as usize])
    }

    /// Samples whose current triangle comes later in the drawing order.
    #[inline(never)]
    pub(crate) fn lost_ties(&self, ties: u32, ids: &[u32], record: &Record) -> u32 {
        let rank = self.rank(record);
        let mut lost = 0;
        for (lane, id) in ids.iter().enumerate() {
            let current = self.records.get(*id as usize);
            if ties & (1 << lane) != 0 && current.is_some_and(|current| self.rank(current) > rank) {
                lost |= 1 << lane;
            }
        }
        lost
    }
}
