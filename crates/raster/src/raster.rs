//! Which triangle is seen at every sample: four to a pixel, at the nearest
//! depth, and where depths are equal the one drawn last. Triangles are taken
//! eight at a time; those that face away or lie between samples go no further.

use std::ops::Range;

use crate::clip::{self, ClippedCorner, ClippedTriangle, Cut};
use crate::instance::Instance;
use crate::lanes::{F, Floats as _, I, Ints as _, LANES, Mask};
use crate::mesh::{CLUSTER, Cluster, Mesh};
use crate::model::Model;
use crate::surface::VARYING;

/// Samples in a pixel.
pub(crate) const SAMPLES: usize = 4;
/// Where in a pixel they are.
pub(crate) const SAMPLE_X: [f32; SAMPLES] = [0.375, 0.875, 0.125, 0.625];
pub(crate) const SAMPLE_Y: [f32; SAMPLES] = [0.125, 0.375, 0.625, 0.875];
/// Positions are snapped to so many parts of a pixel.
const SUBPIXELS: i32 = 256;
/// Samples lie on every such part, off the pixel's corner by some of them.
const LATTICE: i32 = 32;
/// Triangles of at least this extent, in parts of a pixel, are cut into blocks,
/// so that no product leaves 32 bits.
const LARGE: i32 = 32 * SUBPIXELS;
/// Furthest that a corner is taken to be from the picture's, in parts of a pixel.
/// Few are beyond the picture at all: those so near to the eye that their place
/// cannot be told. Twice this, multiplied, stays within 64 bits.
const FURTHEST: i32 = 1 << 24;
/// Side of such a block, pixels.
const BLOCK: i32 = 16;

/// No triangle.
pub(crate) const NOTHING: u32 = u32::MAX;

/// A triangle that may be seen.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Record {
    pub(crate) instance: u32,
    /// In the mesh; or among the clipped ones, if `positions` says so.
    pub(crate) triangle: u32,
    /// Where its cluster's positions start in the mesh, or [`CLIPPED`].
    pub(crate) positions: u32,
}

/// See [`Record::positions`].
pub(crate) const CLIPPED: u32 = u32::MAX;

/// Part of a picture, pixels; the ends are inside.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Window {
    pub(crate) x: [i32; 2],
    pub(crate) y: [i32; 2],
}

impl Window {
    /// All of a picture.
    pub(crate) fn whole(width: usize, height: usize) -> Self {
        Self {
            x: [0, width as i32 - 1],
            y: [0, height as i32 - 1],
        }
    }

    /// The smallest that holds both.
    pub(crate) fn with(self, other: Self) -> Self {
        let around = |a: [i32; 2], b: [i32; 2]| [a[0].min(b[0]), a[1].max(b[1])];
        Self {
            x: around(self.x, other.x),
            y: around(self.y, other.y),
        }
    }

    /// The smallest that holds both, of which either may be empty.
    pub(crate) fn around(one: Option<Self>, other: Option<Self>) -> Option<Self> {
        match (one, other) {
            (Some(one), Some(other)) => Some(one.with(other)),
            (one, other) => one.or(other),
        }
    }

    /// Where its rows are in a list of pixels.
    pub(crate) fn rows(self, stride: usize) -> impl Iterator<Item = Range<usize>> {
        let [left, right] = self.x.map(|x| x as usize);
        (self.y[0]..=self.y[1]).map(move |y| {
            let row = y as usize * stride;
            row + left..row + right + 1
        })
    }
}

/// What is seen at every sample.
#[derive(Debug, Default)]
pub(crate) struct Visible {
    pub(crate) width: usize,
    pub(crate) height: usize,
    /// Pixels from one row to the next: even, since two are drawn at once.
    pub(crate) stride: usize,
    /// 1 at the near plane, 0 at the far one.
    pub(crate) depths: Vec<f32>,
    /// Of each block a depth that no sample in it is beyond, row by row.
    hidden_beyond: Vec<f32>,
    /// Places in `records`.
    pub(crate) ids: Vec<u32>,
    pub(crate) records: Vec<Record>,
    pub(crate) clipped: Vec<ClippedTriangle>,
    /// Where anything became visible since this was last emptied, at most.
    pub(crate) touched: Option<Window>,
}

impl Visible {
    /// Nothing is seen in a window of a picture of this size.
    pub(crate) fn clear(&mut self, [width, height]: [usize; 2], window: Window) {
        // A little more than a power of two, or the rows of a square would all
        // be kept in the same few lines of the processor's cache.
        let stride = width.next_multiple_of(2) + 4;
        let samples = stride * height * SAMPLES;
        (self.width, self.height, self.stride) = (width, height, stride);
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
        self.forget_what_is_hidden();
    }

    /// To be called whenever depths are changed from outside.
    pub(crate) fn forget_what_is_hidden(&mut self) {
        let blocks = self.width.div_ceil(BLOCK as usize) * self.height.div_ceil(BLOCK as usize);
        self.hidden_beyond.clear();
        self.hidden_beyond.resize(blocks, 0.0);
    }

    /// The place of a pixel's block in `hidden_beyond`.
    fn block_of(&self, x: i32, y: i32) -> usize {
        (y / BLOCK) as usize * self.width.div_ceil(BLOCK as usize) + (x / BLOCK) as usize
    }

    /// Whether nothing in some pixels, the ends inside, shows at such a depth.
    fn hides(&self, x: [i32; 2], y: [i32; 2], depth: f32) -> bool {
        (y[0] / BLOCK..=y[1] / BLOCK).all(|row| {
            let first = self.block_of(x[0], row * BLOCK);
            let last = self.block_of(x[1], row * BLOCK);
            self.hidden_beyond[first..=last]
                .iter()
                .all(|beyond| depth < *beyond)
        })
    }
}

/// The positions of a cluster in the picture.
pub(crate) struct Positions {
    x: [f32; MOST],
    y: [f32; MOST],
    z: [f32; MOST],
    snapped_x: [i32; MOST],
    snapped_y: [i32; MOST],
    /// Bits of the planes of [`clip`] that a position is beyond.
    beyond: [i32; MOST],
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

/// What drawing an instance needs beside it.
pub(crate) struct Drawing<'a> {
    pub(crate) model: &'a Model,
    pub(crate) instances: &'a [Instance],
    pub(crate) window: Window,
    /// What lies beyond it is cut off.
    pub(crate) plane: Option<[f32; 4]>,
    pub(crate) positions: &'a mut Positions,
    pub(crate) visible: &'a mut Visible,
    /// Where everything goes that is not behind what is visible; without it,
    /// what is nearest becomes visible.
    pub(crate) layers: Option<Layers<'a>>,
}

/// Where layers go. Drawing ends when there are more than that, and the list is
/// of no use then.
pub(crate) struct Layers<'a> {
    pub(crate) list: &'a mut Vec<Layer>,
    pub(crate) most: usize,
}

/// A triangle in two pixels side by side.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Layer {
    /// Instance and triangle in drawing order.
    pub(crate) rank: (u32, u32),
    /// Its record.
    pub(crate) id: u32,
    pub(crate) x: u16,
    pub(crate) y: u16,
    /// Bits of the first pixel's samples, then the second's.
    pub(crate) samples: u32,
}

/// Draws an instance into what is visible.
#[inline(always)]
pub(crate) fn draw(index: usize, drawing: &mut Drawing<'_>) {
    let instance = &drawing.instances[index];
    let mesh = instance.mesh.of(drawing.model);
    let planes = Planes::of(instance, drawing);
    if planes.hide(mesh.bounds.center, mesh.bounds.radius) {
        return;
    }
    for cluster in &mesh.clusters {
        let faces_away = !instance.inside_out
            && match planes.orthographic {
                true => cluster.faces_along(instance.eye),
                false => cluster.faces_away_from(instance.eye),
            };
        if faces_away || planes.hide(cluster.bounds.center, cluster.bounds.radius) {
            continue;
        }
        let inside =
            drawing.plane.is_none() && planes.contain(cluster.bounds.center, cluster.bounds.radius);
        draw_cluster(index, mesh, cluster, inside, drawing);
        let layers = drawing.layers.as_ref();
        if layers.is_some_and(|layers| layers.list.len() > layers.most) {
            return;
        }
    }
}

/// The sides of what the camera sees, in a mesh's frame.
struct Planes {
    sides: [[f32; 4]; 6],
    lengths: [f32; 6],
    /// Those of the whole picture, exactly.
    frame: [[f32; 4]; 6],
    orthographic: bool,
}

impl Planes {
    fn of(instance: &Instance, drawing: &Drawing<'_>) -> Self {
        let m = &instance.to_clip.0;
        let row = |row: usize| [m[row], m[row + 4], m[row + 8], m[row + 12]];
        let (x, y, z, w) = (row(0), row(1), row(2), row(3));
        let sum = |a: [f32; 4], b: [f32; 4], sign: f32| -> [f32; 4] {
            std::array::from_fn(|at| a[at] + sign * b[at])
        };
        // The window's own sides, half a pixel wider.
        let (wide, high) = (
            drawing.visible.width as f32 * 0.5,
            drawing.visible.height as f32 * 0.5,
        );
        let scaled = |row: [f32; 4], by: f32| row.map(|value| value * by);
        let side = |row: [f32; 4], at: i32, half: f32, sign: f32| {
            let place = (at as f32 - half) / half;
            sum(scaled(row, sign), scaled(w, -sign * place), 1.0)
        };
        let window = &drawing.window;
        let sides = [
            side(x, window.x[0] - 1, wide, 1.0),
            side(x, window.x[1] + 2, wide, -1.0),
            side(y, window.y[0] - 1, high, 1.0),
            side(y, window.y[1] + 2, high, -1.0),
            z,
            sum(w, z, -1.0),
        ];
        Self {
            frame: [
                sum(w, x, 1.0),
                sum(w, x, -1.0),
                sum(w, y, 1.0),
                sum(w, y, -1.0),
                z,
                sum(w, z, -1.0),
            ],
            lengths: sides.map(|it| (it[0] * it[0] + it[1] * it[1] + it[2] * it[2]).sqrt()),
            sides,
            orthographic: w[0] == 0.0 && w[1] == 0.0 && w[2] == 0.0,
        }
    }

    /// Whether a ball is wholly on the inner side of the whole picture's.
    fn contain(&self, [x, y, z]: [f32; 3], radius: f32) -> bool {
        self.frame.iter().all(|side| {
            let length = (side[0] * side[0] + side[1] * side[1] + side[2] * side[2]).sqrt();
            let parts = [side[0] * x, side[1] * y, side[2] * z, side[3]];
            let slack = 1e-5 * parts.iter().map(|part| part.abs()).sum::<f32>();
            parts.iter().sum::<f32>() > radius * length * 1.001 + slack
        })
    }

    /// Whether a ball is wholly beyond one of them, rounding allowed for.
    fn hide(&self, [x, y, z]: [f32; 3], radius: f32) -> bool {
        self.sides.iter().zip(&self.lengths).any(|(side, length)| {
            let parts = [side[0] * x, side[1] * y, side[2] * z, side[3]];
            let slack = 1e-5 * parts.iter().map(|part| part.abs()).sum::<f32>();
            parts.iter().sum::<f32>() < -(radius * length * 1.001 + slack)
        })
    }
}

/// A cluster's triangles that may cover a sample.
struct Candidates {
    count: usize,
    /// Places in the cluster.
    at: [u8; CLUSTER + LANES],
}

#[inline(always)]
fn draw_cluster(
    index: usize,
    mesh: &Mesh,
    cluster: &Cluster,
    inside: bool,
    drawing: &mut Drawing<'_>,
) {
    let instance = &drawing.instances[index];
    let Placed { beyond, hidden } = place(instance, mesh, cluster, inside, drawing);
    if hidden {
        return;
    }
    let mut candidates = Candidates {
        count: 0,
        at: [0; CLUSTER + LANES],
    };
    choose(instance, mesh, cluster, drawing, beyond, &mut candidates);
    if beyond {
        cut_off(index, mesh, cluster, drawing);
    }
    let mut setup = Setup::default();
    for first in (0..candidates.count).step_by(LANES) {
        let count = (candidates.count - first).min(LANES);
        let lanes: &[u8; LANES] = candidates.at[first..][..LANES].try_into().expect("eight");
        set_up(instance, mesh, cluster, drawing, lanes, &mut setup);
        for (lane, &triangle) in lanes[..count].iter().enumerate() {
            let triangle = cluster.first_triangle + u32::from(triangle);
            let record = Record {
                instance: index as u32,
                triangle,
                positions: cluster.first_position,
            };
            fill(lane, &setup, record, drawing);
        }
    }
}

/// What is known of a cluster once its positions are in the picture.
struct Placed {
    /// Whether any is beyond a side of what the camera sees.
    beyond: bool,
    /// Whether all of it is behind what is visible.
    hidden: bool,
}

/// Carries a cluster's positions to the picture. `inside` are those of which none
/// can be beyond a side.
#[inline(always)]
fn place(
    instance: &Instance,
    mesh: &Mesh,
    cluster: &Cluster,
    inside: bool,
    drawing: &mut Drawing<'_>,
) -> Placed {
    let m = instance.to_clip.0.map(F::splat);
    let half_width = F::splat(drawing.visible.width as f32 * 0.5);
    let half_height = F::splat(drawing.visible.height as f32 * 0.5);
    let (zero, one) = (F::splat(0.0), F::splat(1.0));
    let first = cluster.first_position as usize;
    let count = (cluster.positions as usize).next_multiple_of(LANES);
    let mut any = I::splat(0);
    let mut nearest = zero;
    let mut low = [I::splat(i32::MAX); 2];
    let mut high = [I::splat(i32::MIN); 2];
    let to = &mut *drawing.positions;
    for at in (0..count).step_by(LANES) {
        let from = first + at;
        let x = F::load(&mesh.xs[from..from + LANES]);
        let y = F::load(&mesh.ys[from..from + LANES]);
        let z = F::load(&mesh.zs[from..from + LANES]);
        let row = |row: usize| x * m[row] + y * m[row + 4] + z * m[row + 8] + m[row + 12];
        let (cx, cy, cz, cw) = (row(0), row(1), row(2), row(3));
        if !inside {
            let bit = |mask: Mask, bit: i32| mask.ints() & I::splat(bit);
            let mut beyond = bit(cx.gt(cw), 1)
                | bit((cx + cw).lt(zero), 2)
                | bit(cy.gt(cw), 4)
                | bit((cy + cw).lt(zero), 8)
                | bit(cz.lt(zero), 16)
                | bit(cz.gt(cw), 32);
            if let Some(plane) = drawing.plane {
                let [a, b, c, d] = plane.map(F::splat);
                let off = d.fused(cw, c.fused(cz, b.fused(cy, a * cx)));
                beyond |= bit(off.lt(zero), 64);
            }
            beyond.store(&mut to.beyond[at..at + LANES]);
            any |= beyond;
        }
        let over_w = one / cw;
        let wx = (cx * over_w).fused(half_width, half_width);
        let wy = (cy * over_w).fused(half_height, half_height);
        // Depth: the viewport's scale is 1 and its shift 0.
        let wz = cz * over_w;
        let subpixels = F::splat(SUBPIXELS as f32);
        let snapped = [wx, wy].map(|at| {
            let at: I = (at * subpixels).nearest();
            at.max(I::splat(-FURTHEST)).min(I::splat(FURTHEST))
        });
        wx.store(&mut to.x[at..at + LANES]);
        wy.store(&mut to.y[at..at + LANES]);
        wz.store(&mut to.z[at..at + LANES]);
        snapped[0].store(&mut to.snapped_x[at..at + LANES]);
        snapped[1].store(&mut to.snapped_y[at..at + LANES]);
        nearest = nearest.max(wz);
        for axis in 0..2 {
            low[axis] = low[axis].min(snapped[axis]);
            high[axis] = high[axis].max(snapped[axis]);
        }
    }
    let beyond = (!any.equals(I::splat(0))).any();
    if beyond {
        return Placed {
            beyond,
            hidden: false,
        };
    }
    let [x, y] = [0, 1].map(|axis| {
        let window = match axis {
            0 => drawing.window.x,
            _ => drawing.window.y,
        };
        let from = (low[axis].reduce_min() >> 8).max(window[0]);
        [from, (high[axis].reduce_max() >> 8).min(window[1])]
    });
    let depth = nearest.as_array().iter().fold(0.0f32, |a, b| a.max(*b));
    let outside = x[0] > x[1] || y[0] > y[1];
    Placed {
        beyond,
        hidden: outside || drawing.visible.hides(x, y, depth * (1.0 + 1e-5)),
    }
}

/// Its corners as they are gone round: Mesa swaps the first two of those that
/// show their front counter-clockwise.
#[inline(always)]
pub(crate) fn turned(counter_clockwise: bool) -> [usize; 3] {
    if counter_clockwise {
        [1, 0, 2]
    } else {
        [0, 1, 2]
    }
}

/// Finds the triangles that face the camera and do not lie between samples.
#[inline(always)]
fn choose(
    instance: &Instance,
    mesh: &Mesh,
    cluster: &Cluster,
    drawing: &Drawing<'_>,
    beyond: bool,
    into: &mut Candidates,
) {
    let order = turned(instance.counter_clockwise);
    let first = cluster.first_triangle as usize;
    let count = cluster.triangles as usize;
    let splat = |value: i32| I::splat(value);
    let (left, right) = (
        splat(drawing.window.x[0] * 4),
        splat(drawing.window.x[1] * 4 + 3),
    );
    let (low, high) = (
        splat(drawing.window.y[0] * 4),
        splat(drawing.window.y[1] * 4 + 3),
    );
    let positions = &*drawing.positions;
    for at in (0..count).step_by(LANES) {
        let ids = order.map(|corner| -> [u8; LANES] {
            mesh.corners[corner][first + at..][..LANES]
                .try_into()
                .expect("eight")
        });
        let of =
            |values: &[i32; MOST], ids: &[u8; LANES]| I::new(ids.map(|id| values[usize::from(id)]));
        let (xa, ya) = (
            of(&positions.snapped_x, &ids[0]),
            of(&positions.snapped_y, &ids[0]),
        );
        let (xb, yb) = (
            of(&positions.snapped_x, &ids[1]),
            of(&positions.snapped_y, &ids[1]),
        );
        let (xc, yc) = (
            of(&positions.snapped_x, &ids[2]),
            of(&positions.snapped_y, &ids[2]),
        );
        let (x0, x1) = (xa.min(xb).min(xc), xa.max(xb).max(xc));
        let (y0, y1) = (ya.min(yb).min(yc), ya.max(yb).max(yc));
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
        let one_row = row0.equals(row1) & ((column_of_row - column0) & three).gt(column1 - column0);
        let one_column = column0.equals(column1) & ((row_of_column - row0) & three).gt(row1 - row0);
        kept = kept & !(one_row | one_column);
        let area = (xa - xb) * (yc - ya) - (xc - xa) * (ya - yb);
        let large = (x1 - x0).ge(splat(LARGE)) | (y1 - y0).ge(splat(LARGE));
        kept = kept & (area.gt(splat(0)) | large);
        let mut bits = kept.bits();
        if at + LANES > count {
            bits &= (1 << (count - at)) - 1;
        }
        while bits != 0 {
            let lane = bits.trailing_zeros() as usize;
            bits &= bits - 1;
            let is_beyond = beyond
                && ids
                    .iter()
                    .any(|ids| positions.beyond[usize::from(ids[lane])] != 0);
            if !is_beyond {
                into.at[into.count] = (at + lane) as u8;
                into.count += 1;
            }
        }
    }
}

/// Cuts off what is beyond a side of those triangles that reach there.
#[inline(never)]
fn cut_off(index: usize, mesh: &Mesh, cluster: &Cluster, drawing: &mut Drawing<'_>) {
    let first = cluster.first_triangle as usize;
    for triangle in first..first + cluster.triangles as usize {
        let beyond = mesh
            .corners
            .each_ref()
            .map(|ids| drawing.positions.beyond[usize::from(ids[triangle])]);
        let (any, all) = (
            beyond.iter().fold(0, |a, b| a | b),
            beyond.iter().fold(-1, |a, b| a & b),
        );
        if any == 0 || all != 0 {
            continue;
        }
        let corners = std::array::from_fn(|corner| mesh.position(cluster, triangle, corner));
        let instance = &drawing.instances[index];
        let size = [
            drawing.visible.width as f32 * 0.5,
            drawing.visible.height as f32 * 0.5,
        ];
        let cut = Cut {
            beyond: any,
            plane: drawing.plane,
            half: size,
        };
        let pieces = clip::clip(instance, corners, [[0.0; VARYING]; 3], &cut);
        for (piece, corners) in pieces.iter().enumerate() {
            let record = Record {
                instance: index as u32,
                triangle: drawing.visible.clipped.len() as u32,
                positions: CLIPPED,
            };
            let mut setup = Setup::default();
            if !set_up_clipped(instance, corners, drawing.window, &mut setup) {
                continue;
            }
            drawing.visible.clipped.push(ClippedTriangle {
                triangle: triangle as u32,
                positions: cluster.first_position,
                cut,
                piece: piece as u32,
            });
            fill(0, &setup, record, drawing);
        }
    }
}

/// Eight triangles, ready to be filled.
#[derive(Default)]
struct Setup {
    /// Of each edge, at the first sample's lattice point of its block: not
    /// negative inside.
    edge: [[i32; LANES]; 3],
    /// What it changes by from one lattice point to the next.
    along_x: [[i32; LANES]; 3],
    along_y: [[i32; LANES]; 3],
    /// Depth at the picture's corner, and what it changes by per pixel.
    depth: [f32; LANES],
    depth_x: [f32; LANES],
    depth_y: [f32; LANES],
    /// Pixels, ends inside.
    x0: [i32; LANES],
    x1: [i32; LANES],
    y0: [i32; LANES],
    y1: [i32; LANES],
    /// Bits of those whose products may leave 32 bits, and of all the snapped
    /// corners.
    large: u32,
    corners: [[[i32; LANES]; 2]; 3],
}

#[inline(always)]
fn set_up(
    instance: &Instance,
    mesh: &Mesh,
    cluster: &Cluster,
    drawing: &Drawing<'_>,
    lanes: &[u8; LANES],
    to: &mut Setup,
) {
    let order = turned(instance.counter_clockwise);
    let first = cluster.first_triangle as usize;
    let positions = &*drawing.positions;
    let ids = order.map(|corner| {
        let corners = &mesh.corners[corner][first..];
        lanes.map(|lane| usize::from(corners[usize::from(lane)]))
    });
    let whole = |values: &[i32; MOST], corner: usize| I::new(ids[corner].map(|id| values[id]));
    let part = |values: &[f32; MOST], corner: usize| F::new(ids[corner].map(|id| values[id]));
    let x = [0, 1, 2].map(|corner| whole(&positions.snapped_x, corner));
    let y = [0, 1, 2].map(|corner| whole(&positions.snapped_y, corner));
    let splat = |value: i32| I::splat(value);
    let (least_x, most_x) = (x[0].min(x[1]).min(x[2]), x[0].max(x[1]).max(x[2]));
    let (least_y, most_y) = (y[0].min(y[1]).min(y[2]), y[0].max(y[1]).max(y[2]));
    let window = &drawing.window;
    let x0 = ((least_x + splat(31)) >> 8i32).max(splat(window.x[0]));
    let x1 = ((most_x - splat(32)) >> 8i32).min(splat(window.x[1]));
    let y0 = ((least_y + splat(31)) >> 8i32).max(splat(window.y[0]));
    let y1 = ((most_y - splat(32)) >> 8i32).min(splat(window.y[1]));
    let (origin_x, origin_y) = ((x0 & splat(!1)) << 8i32, y0 << 8i32);
    for edge in 0..3 {
        let next = (edge + 1) % 3;
        let (dx, dy) = (y[edge] - y[next], x[edge] - x[next]);
        let value = dx * (x[edge] - origin_x) - dy * (y[edge] - origin_y);
        // Samples on a left or lower edge are inside, those on the others not.
        let inside = dx.lt(splat(0)) | dx.equals(splat(0)) & dy.lt(splat(0));
        let value = (value - inside.ints() - splat(1)) >> 5i32;
        value.store(&mut to.edge[edge]);
        (-dx).store(&mut to.along_x[edge]);
        dy.store(&mut to.along_y[edge]);
        x[edge].store(&mut to.corners[edge][0]);
        y[edge].store(&mut to.corners[edge][1]);
    }
    let is_large = (most_x - least_x).ge(splat(LARGE)) | (most_y - least_y).ge(splat(LARGE));
    to.large = is_large.bits();
    x0.store(&mut to.x0);
    x1.store(&mut to.x1);
    y0.store(&mut to.y0);
    y1.store(&mut to.y1);
    let wx = [0, 1, 2].map(|corner| part(&positions.x, corner));
    let wy = [0, 1, 2].map(|corner| part(&positions.y, corner));
    let wz = [0, 1, 2].map(|corner| part(&positions.z, corner));
    let slopes = Slopes::new(&wx, &wy);
    let (at_corner, per_x, per_y) = slopes.of(&wz);
    at_corner.store(&mut to.depth);
    per_x.store(&mut to.depth_x);
    per_y.store(&mut to.depth_y);
}

/// From three values at corners to one everywhere: eight triangles at once, with
/// llvmpipe's order of operations.
pub(crate) struct Slopes {
    x: F,
    y: F,
    dx01: F,
    dy01: F,
    dx20: F,
    dy20: F,
}

impl Slopes {
    #[inline(always)]
    pub(crate) fn new(x: &[F; 3], y: &[F; 3]) -> Self {
        let (dx01, dy01) = (x[0] - x[1], y[0] - y[1]);
        let (dx20, dy20) = (x[2] - x[0], y[2] - y[0]);
        let over_area = F::splat(1.0) / (dx01 * dy20 - dy01 * dx20);
        Self {
            x: x[0],
            y: y[0],
            dx01: dx01 * over_area,
            dy01: dy01 * over_area,
            dx20: dx20 * over_area,
            dy20: dy20 * over_area,
        }
    }

    /// The value at the picture's corner, and its changes per pixel.
    #[inline(always)]
    pub(crate) fn of(&self, values: &[F; 3]) -> (F, F, F) {
        let (d01, d20) = (values[0] - values[1], values[2] - values[0]);
        let per_x = d01 * self.dy20 - d20 * self.dy01;
        let per_y = d20 * self.dx01 - d01 * self.dx20;
        let at_corner = values[0] - (per_x * self.x + per_y * self.y);
        (at_corner, per_x, per_y)
    }
}

/// The same for one triangle, in lane 0; false if it covers no sample.
fn set_up_clipped(
    instance: &Instance,
    piece: &[ClippedCorner; 3],
    window: Window,
    to: &mut Setup,
) -> bool {
    let order = turned(instance.counter_clockwise);
    let corners = order.map(|corner| piece[corner]);
    let snap = |value: f32| {
        let at = (value * SUBPIXELS as f32).round_ties_even() as i32;
        at.clamp(-FURTHEST, FURTHEST)
    };
    let x = corners.map(|corner| snap(corner.window[0]));
    let y = corners.map(|corner| snap(corner.window[1]));
    let wide = |a: i32, b: i32| i64::from(a) * i64::from(b);
    let area = wide(x[0] - x[1], y[2] - y[0]) - wide(x[2] - x[0], y[0] - y[1]);
    if area <= 0 {
        return false;
    }
    let least = |values: [i32; 3]| (values[0].min(values[1]).min(values[2]) + 31) >> 8i32;
    let most = |values: [i32; 3]| (values[0].max(values[1]).max(values[2]) - 32) >> 8i32;
    to.x0[0] = least(x).max(window.x[0]);
    to.x1[0] = most(x).min(window.x[1]);
    to.y0[0] = least(y).max(window.y[0]);
    to.y1[0] = most(y).min(window.y[1]);
    if to.x0[0] > to.x1[0] || to.y0[0] > to.y1[0] {
        return false;
    }
    for corner in 0..3 {
        to.corners[corner][0][0] = x[corner];
        to.corners[corner][1][0] = y[corner];
    }
    // In blocks, with products of 64 bits.
    to.large = 1;
    for edge in 0..3 {
        let next = (edge + 1) % 3;
        to.along_x[edge][0] = y[next] - y[edge];
        to.along_y[edge][0] = x[edge] - x[next];
    }
    let [wx, wy, wz] = [0, 1, 2].map(|axis| corners.map(|corner| corner.window[axis]));
    let slopes = clip::slopes(&wx, &wy, &wz);
    (to.depth[0], to.depth_x[0], to.depth_y[0]) = slopes;
    true
}

/// Where samples are: two pixels of four, in lattice points and pixels.
const LANE_X: [i32; LANES] = [3, 7, 1, 5, 11, 15, 9, 13];
const LANE_Y: [i32; LANES] = [1, 3, 5, 7, 1, 3, 5, 7];
const POINTS_PER_PIXEL: i32 = SUBPIXELS / LATTICE;

#[inline(always)]
fn fill(lane: usize, setup: &Setup, record: Record, drawing: &mut Drawing<'_>) {
    let (x, y) = (
        [setup.x0[lane], setup.x1[lane]],
        [setup.y0[lane], setup.y1[lane]],
    );
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
        let is_in = i64::from(dx < 0 || dx == 0 && dy < 0);
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
/// first even pixel. Whether it is seen anywhere.
/// An inside one has no edge there.
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
    let per_pair = [0, 1, 2].map(|edge| splat(setup.along_x[edge][lane] * 2 * POINTS_PER_PIXEL));
    let per_row = [0, 1, 2].map(|edge| splat(setup.along_y[edge][lane] * POINTS_PER_PIXEL));
    let [off_x, off_y] = SAMPLE_OFFSETS.map(F::new);
    let (depth, depth_x, depth_y) = (
        real(setup.depth[lane]),
        real(setup.depth_x[lane]),
        real(setup.depth_y[lane]),
    );
    let first_x = x[0] & !1;
    let visible = &mut *drawing.visible;
    let mut touched = false;
    for pixel_y in y[0]..=y[1] {
        let mut edge = rows;
        let sample_y = real(pixel_y as f32) + off_y;
        let row = (pixel_y as usize * visible.stride + first_x as usize) * SAMPLES;
        let pairs = (x[1] - first_x) as usize / 2 + 1;
        let depths = &mut visible.depths[row..row + pairs * LANES];
        let ids = &mut visible.ids[row..row + pairs * LANES];
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
                        let ranks = Ranks {
                            model: drawing.model,
                            instances: drawing.instances,
                            records: &visible.records,
                            clipped: &visible.clipped,
                        };
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
                    let lost = lost_ties(
                        ties.bits(),
                        ids,
                        record,
                        &Ranks {
                            model: drawing.model,
                            instances: drawing.instances,
                            records: &visible.records,
                            clipped: &visible.clipped,
                        },
                    );
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

/// Sample positions of two pixels side by side, from the first one's corner.
const SAMPLE_OFFSETS: [[f32; LANES]; 2] = [
    [
        SAMPLE_X[0],
        SAMPLE_X[1],
        SAMPLE_X[2],
        SAMPLE_X[3],
        1.0 + SAMPLE_X[0],
        1.0 + SAMPLE_X[1],
        1.0 + SAMPLE_X[2],
        1.0 + SAMPLE_X[3],
    ],
    [
        SAMPLE_Y[0],
        SAMPLE_Y[1],
        SAMPLE_Y[2],
        SAMPLE_Y[3],
        SAMPLE_Y[0],
        SAMPLE_Y[1],
        SAMPLE_Y[2],
        SAMPLE_Y[3],
    ],
];

/// What tells which of two triangles is drawn later.
struct Ranks<'a> {
    model: &'a Model,
    instances: &'a [Instance],
    records: &'a [Record],
    clipped: &'a [ClippedTriangle],
}

impl Ranks<'_> {
    fn of(&self, record: &Record) -> (u32, u32) {
        let triangle = match record.positions {
            CLIPPED => self.clipped[record.triangle as usize].triangle,
            _ => record.triangle,
        };
        let instance = &self.instances[record.instance as usize];
        let mesh = instance.mesh.of(self.model);
        (instance.rank, mesh.order[triangle as usize])
    }
}

/// Of samples where depths are equal, those whose triangle is drawn after this
/// one and therefore stays.
#[inline(never)]
fn lost_ties(ties: u32, ids: &[u32], record: Record, ranks: &Ranks<'_>) -> u32 {
    let ours = ranks.of(&record);
    let mut lost = 0;
    for (lane, id) in ids.iter().enumerate() {
        let theirs = ranks.records.get(*id as usize);
        if ties & (1 << lane) != 0 && theirs.is_some_and(|it| ranks.of(it) > ours) {
            lost |= 1 << lane;
        }
    }
    lost
}
