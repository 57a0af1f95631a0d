//! Lookups in a light's shadow map, and the geoms that darken them. A picture looks up only tens of
//! thousands of the map's texels, of which there are usually millions, so the map itself is never
//! drawn: every triangle is compared with the lookups that it covers.

use crate::clip::{self, Clipping, Viewport};
use crate::instance::{self, Instance, View};
use crate::lanes::{F, Floats as _, I, LANES};
use crate::mesh::{Cluster, Mesh};
use crate::model::Model;
use crate::positions::{MAX_COORDINATE, SUBPIXELS, sides_beyond};
use crate::scene::Scene;

/// Width of the map's border around the viewport, texels. The border's texels stand for everything
/// beyond the map, so no shadow may touch them.
const BORDER: f32 = 1.0;
/// Largest depth in the map, which has 24 bits.
const FULL_DEPTH: f32 = 16_777_215.0;
/// Offset away from the light: a multiple of the largest change of depth between texels, plus a
/// constant. MuJoCo passes four units to `glPolygonOffset`, each two in llvmpipe.
const OFFSET_FACTOR: f32 = -1.5;
const OFFSET: f32 = -8.0 / FULL_DEPTH;
/// Texels on a side of a cell, as a power of two.
const CELL_SHIFT: i32 = 3;

#[derive(Debug, Clone, Copy, Default)]
struct Lookup {
    texel: [i32; 2],
    /// Depth of the fragment: 1 at the light's near plane, 0 at its far plane.
    depth: f32,
    fragment: u32,
    is_dark: bool,
}

/// Lookups in a map, sorted into square cells.
pub(crate) struct Lookups {
    /// Side of the map, texels.
    size: i32,
    cells: usize,
    lookups: Vec<Lookup>,
    /// Per cell, row by row: index of its first lookup; ends with the number of lookups.
    starts: Vec<u32>,
    /// Per corner of a cell, row by row: number of lookups to its left and below it.
    sums: Vec<u32>,
}

impl Lookups {
    /// Creates the lookups of fragments at places of [`visit_places`](crate::shade::visit_places);
    /// fragments without a place are dark.
    pub(crate) fn new(size: usize, places: &[Option<[f32; 3]>]) -> Self {
        let cells = size.div_ceil(1 << CELL_SHIFT);
        let last = size as i32 - 1;
        let texel = |share: f32| ((share * size as f32).floor() as i32).clamp(0, last);
        let lookup = |(fragment, place): (u32, &Option<[f32; 3]>)| {
            place.map(|[s, t, depth]| Lookup {
                texel: [texel(s), texel(t)],
                depth: depth.clamp(0.0, 1.0),
                fragment,
                is_dark: false,
            })
        };
        let unsorted: Vec<Lookup> = (0..).zip(places).filter_map(lookup).collect();
        let cell = |lookup: &Lookup| {
            let [x, y] = lookup.texel.map(|at| (at >> CELL_SHIFT) as usize);
            y * cells + x
        };
        let mut starts = vec![0u32; cells * cells + 1];
        for lookup in &unsorted {
            starts[cell(lookup) + 1] += 1;
        }
        let mut sums = vec![0u32; (cells + 1) * (cells + 1)];
        for (y, row) in starts[1..].chunks_exact(cells).enumerate() {
            let mut in_row = 0;
            for (x, count) in row.iter().enumerate() {
                in_row += count;
                sums[(y + 1) * (cells + 1) + x + 1] = sums[y * (cells + 1) + x + 1] + in_row;
            }
        }
        for at in 1..starts.len() {
            starts[at] += starts[at - 1];
        }
        let mut lookups = vec![Lookup::default(); unsorted.len()];
        let mut next = starts.clone();
        for lookup in unsorted {
            let at = &mut next[cell(&lookup)];
            lookups[*at as usize] = lookup;
            *at += 1;
        }
        Self { size: size as i32, cells, lookups, starts, sums }
    }

    /// A fragment is lit if it has a lookup that no triangle darkens.
    pub(crate) fn lit(&self, fragments: usize) -> Vec<bool> {
        let mut lit = vec![false; fragments];
        for lookup in &self.lookups {
            lit[lookup.fragment as usize] = !lookup.is_dark;
        }
        lit
    }

    /// Returns the cells that contain an inclusive range of texels; `None` if no lookup is in them.
    #[inline(always)]
    fn cells_with_lookups(&self, low: [i32; 2], high: [i32; 2]) -> Option<[[usize; 2]; 2]> {
        let low = low.map(|at| at.max(0));
        let high = high.map(|at| at.min(self.size - 1));
        if low[0] > high[0] || low[1] > high[1] {
            return None;
        }
        let [[left, below], [right, above]] =
            [low, high].map(|texel| texel.map(|at| (at >> CELL_SHIFT) as usize));
        let sum = |x: usize, y: usize| self.sums[y * (self.cells + 1) + x];
        let count = sum(right + 1, above + 1) + sum(left, below)
            - sum(left, above + 1)
            - sum(right + 1, below);
        (count > 0).then_some([[left, right], [below, above]])
    }

    /// A corner is a column and a row of the map, texels, and a depth.
    fn darken(&mut self, corners: [[f32; 3]; 3]) {
        let snap = |at: f32| {
            let at = ((at - 0.5) * SUBPIXELS as f32).round_ties_even() as i32;
            at.clamp(-MAX_COORDINATE, MAX_COORDINATE)
        };
        let snapped = corners.map(|[x, y, _]| [snap(x), snap(y)]);
        let ends = |axis: usize| {
            let [a, b, c] = snapped.map(|corner| corner[axis]);
            let texel = SUBPIXELS.ilog2();
            [(a.min(b).min(c) + SUBPIXELS - 1) >> texel, a.max(b).max(c) >> texel]
        };
        let [x, y] = [ends(0), ends(1)];
        let Some([columns, rows]) = self.cells_with_lookups([x[0], y[0]], [x[1], y[1]]) else {
            return;
        };
        let mut triangle: Option<Triangle> = None;
        for row in rows[0]..=rows[1] {
            let first = self.starts[row * self.cells + columns[0]] as usize;
            let end = self.starts[row * self.cells + columns[1] + 1] as usize;
            for lookup in &mut self.lookups[first..end] {
                let [column, row] = lookup.texel;
                let is_near = (x[0] <= column) & (column <= x[1]) & (y[0] <= row) & (row <= y[1]);
                if lookup.is_dark | !is_near {
                    continue;
                }
                let triangle = match &triangle {
                    Some(triangle) => triangle,
                    None => match Triangle::new(corners, snapped) {
                        Some(new) => triangle.insert(new),
                        None => return,
                    },
                };
                lookup.is_dark = triangle.has_inside(lookup.texel)
                    && lookup.depth < triangle.depths.at(lookup.texel);
            }
        }
    }
}

struct Triangle {
    edges: [Edge; 3],
    depths: Depths,
}

impl Triangle {
    /// `snapped` is in subpixel units. `None` if the triangle is degenerate.
    fn new(mut corners: [[f32; 3]; 3], mut snapped: [[i32; 2]; 3]) -> Option<Self> {
        let area = {
            let [a, b, c] = snapped.map(|corner| corner.map(i64::from));
            (a[0] - b[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (a[1] - b[1])
        };
        if area == 0 {
            return None;
        }
        // Both sides of a triangle darken. Mesa swaps the first two corners of a triangle that
        // faces away from the light.
        if area < 0 {
            corners.swap(0, 1);
            snapped.swap(0, 1);
        }
        Some(Self {
            edges: [0, 1, 2].map(|at| Edge::new(snapped[at], snapped[(at + 1) % 3])),
            depths: Depths::new(corners),
        })
    }

    fn has_inside(&self, texel: [i32; 2]) -> bool {
        self.edges.iter().all(|edge| edge.has_inside(texel))
    }
}

/// Edge of a triangle, as a function that is not negative at the centres of texels inside.
struct Edge {
    at_origin: i64,
    per_texel: [i64; 2],
}

impl Edge {
    /// Corners in subpixel units; see [`owns_samples`](crate::setup::owns_samples).
    fn new(from: [i32; 2], to: [i32; 2]) -> Self {
        let (from, to) = (from.map(i64::from), to.map(i64::from));
        let (dx, dy) = (from[1] - to[1], from[0] - to[0]);
        let owns_texels = i64::from(dx < 0 || dx == 0 && dy > 0);
        let texel = i64::from(SUBPIXELS);
        Self {
            at_origin: dx * from[0] - dy * from[1] + owns_texels - 1,
            per_texel: [-dx * texel, dy * texel],
        }
    }

    fn has_inside(&self, [x, y]: [i32; 2]) -> bool {
        self.at_origin + self.per_texel[0] * i64::from(x) + self.per_texel[1] * i64::from(y) >= 0
    }
}

/// Depths of a triangle in the map, as a plane over the centres of its texels.
struct Depths {
    at_origin: f32,
    per_texel: [f32; 2],
}

impl Depths {
    /// Computes the plane with llvmpipe's order of operations.
    fn new([a, b, c]: [[f32; 3]; 3]) -> Self {
        let (dx01, dy01) = (a[0] - b[0], a[1] - b[1]);
        let (dx20, dy20) = (c[0] - a[0], c[1] - a[1]);
        let over_area = 1.0 / (dx01 * dy20 - dy01 * dx20);
        let (dz01, dz20) = (a[2] - b[2], c[2] - a[2]);
        let steepest = {
            let x = ((dz20 * dy01 - dy20 * dz01) * over_area).abs();
            let y = ((dx20 * dz01 - dz20 * dx01) * over_area).abs();
            if x > y { x } else { y }
        };
        let offset = OFFSET + steepest * OFFSET_FACTOR;
        let [a2, b2, c2] = [a[2], b[2], c[2]].map(|depth| depth + offset);
        let (d01, d20) = (a2 - b2, c2 - a2);
        let per_x = d01 * (dy20 * over_area) - d20 * (dy01 * over_area);
        let per_y = d20 * (dx01 * over_area) - d01 * (dx20 * over_area);
        Self {
            at_origin: a2 - (per_x * (a[0] - 0.5) + per_y * (a[1] - 0.5)),
            per_texel: [per_x, per_y],
        }
    }

    fn at(&self, [x, y]: [i32; 2]) -> f32 {
        let along = self.per_texel[0].mul_add(x as f32, self.at_origin);
        let depth = self.per_texel[1].mul_add(y as f32, along);
        (depth.clamp(0.0, 1.0) * FULL_DEPTH).round_ties_even() * (1.0 / FULL_DEPTH)
    }
}

pub(crate) fn cast(scene: &Scene, light: &View, model: &Model, lookups: &mut Lookups) {
    let half = lookups.size as f32 * 0.5;
    let viewport = Viewport { scale: [half - BORDER; 2], middle: [half; 2] };
    let mut instances = Vec::new();
    for (index, geom) in scene.geoms.iter().enumerate() {
        instance::add(index, geom, light, model, &mut instances);
    }
    let mut positions = Positions::default();
    for instance in &instances {
        let mesh = instance.mesh.resolve(model);
        for cluster in &mesh.clusters {
            cast_cluster(instance, mesh, cluster, viewport, &mut positions, lookups);
        }
    }
}

fn cast_cluster(
    instance: &Instance,
    mesh: &Mesh,
    cluster: &Cluster,
    viewport: Viewport,
    positions: &mut Positions,
    lookups: &mut Lookups,
) {
    positions.transform(instance, mesh, cluster, viewport);
    let (low, high) = (positions.low, positions.high);
    let is_outside = !positions.is_beyond && lookups.cells_with_lookups(low, high).is_none();
    if is_outside {
        return;
    }
    let first = cluster.first_triangle as usize;
    for triangle in first..first + cluster.triangles as usize {
        let ids = mesh.position_ids.each_ref().map(|ids| ids[triangle]);
        let at = ids.map(usize::from);
        let beyond = at.map(|at| positions.beyond[at]);
        if beyond == [0; 3] {
            let [x, y, z] = &positions.places;
            lookups.darken(at.map(|at| [x[at], y[at], z[at]]));
        } else if beyond[0] & beyond[1] & beyond[2] == 0 {
            let clipping =
                Clipping { beyond: beyond[0] | beyond[1] | beyond[2], plane: None, viewport };
            let corners = ids.map(|id| mesh.position(cluster, id));
            let polygon = clip::clip(instance, corners, [(); 3], &clipping);
            for piece in polygon.pieces() {
                lookups.darken(piece.map(|corner| corner.window));
            }
        }
    }
}

/// Largest number of positions of a cluster; see [`positions`](crate::positions).
const CAPACITY: usize = 256;

struct Positions {
    places: [[f32; CAPACITY]; 3],
    /// Bits of the sides of the light's frustum that each position lies beyond.
    beyond: [i32; CAPACITY],
    is_beyond: bool,
    /// Bounds of the columns and rows, texels.
    low: [i32; 2],
    high: [i32; 2],
}

impl Default for Positions {
    fn default() -> Self {
        Self {
            places: [[0.0; CAPACITY]; 3],
            beyond: [0; CAPACITY],
            is_beyond: false,
            low: [0; 2],
            high: [0; 2],
        }
    }
}

impl Positions {
    fn transform(
        &mut self,
        instance: &Instance,
        mesh: &Mesh,
        cluster: &Cluster,
        viewport: Viewport,
    ) {
        let count = (cluster.positions as usize).next_multiple_of(LANES);
        let first = cluster.first_position as usize;
        let all = [&mesh.xs, &mesh.ys, &mesh.zs].map(|all| &all[first..first + count]);
        let (scale, middle) = (viewport.scale.map(F::splat), viewport.middle.map(F::splat));
        let mut any = I::splat(0);
        let mut low = [I::splat(i32::MAX); 2];
        let mut high = [I::splat(i32::MIN); 2];
        for at in (0..count).step_by(LANES) {
            let row = instance.to_clip.rows(all.map(|values| F::load(&values[at..at + LANES])));
            let in_clip = [row(0), row(1), row(2), row(3)];
            let beyond = sides_beyond(in_clip);
            any |= beyond;
            self.beyond[at..at + LANES].copy_from_slice(beyond.as_array());
            let over_w = F::splat(1.0) / in_clip[3];
            for axis in 0..2 {
                let place = (in_clip[axis] * over_w).fused(scale[axis], middle[axis]);
                place.store(&mut self.places[axis][at..at + LANES]);
                let texel: I = place.round_to_int();
                low[axis] = low[axis].min(texel);
                high[axis] = high[axis].max(texel);
            }
            (in_clip[2] * over_w).store(&mut self.places[2][at..at + LANES]);
        }
        self.is_beyond = any.as_array().iter().any(|bits| *bits != 0);
        // One texel more on each side allows for rounding.
        self.low = low.map(|lanes| lanes.reduce_min().saturating_sub(1));
        self.high = high.map(|lanes| lanes.reduce_max().saturating_add(1));
    }
}
