//! Colours and texture coordinates of visible triangles, computed at the corners and interpolated
//! as planes over the picture.

use crate::clip::{self, VARYING};
use crate::instance::{Instance, Mapping};
use crate::lanes::{F, Floats as _, LANES};
use crate::light::{Shading, shade};
use crate::mesh::{CLUSTER, Mesh, Vertex};
use crate::setup::{Slopes, winding_order};
use crate::shadow::Receiver;
use crate::visible::{CLIPPED, Record, Visible};

/// Index at which each value starts among the interpolated values, all of which are divided by w.
pub(crate) const OVER_W: usize = 0;
pub(crate) const COLOUR: usize = 1;
pub(crate) const COORDINATES: usize = 4;
pub(crate) const OPACITY: usize = 7;
/// Index at which the four coordinates of a place in a shadow map start.
pub(crate) const PLACE: usize = 1;

/// Values at the picture's corner and their changes per pixel along x and y.
#[derive(Debug, Clone, Copy, Default)]
#[repr(align(32))]
pub(crate) struct Surface {
    pub(crate) at_corner: [f32; VARYING],
    pub(crate) per_x: [f32; VARYING],
    pub(crate) per_y: [f32; VARYING],
}

#[derive(Clone, Copy)]
pub(crate) enum Interpolated<'a> {
    /// Colour, texture coordinates and opacity; without shading, the colour is white.
    Colour(Option<&'a Shading<'a>>),
    Place(&'a Receiver),
}

/// A triangle of a cluster, and the index of its surface among all surfaces.
#[derive(Debug, Clone, Copy)]
pub(crate) struct SurfaceRequest {
    pub(crate) triangle: u32,
    pub(crate) surface: u32,
}

#[derive(Debug)]
pub(crate) struct Vertices {
    /// Per vertex: its index in `x`, `y` and `varying`, or [`UNLIT`].
    slots: [u8; CAPACITY],
    x: [f32; CAPACITY],
    y: [f32; CAPACITY],
    varying: [[f32; VARYING]; CAPACITY],
}

/// Vertices that a byte can index, so that indices need no bounds check; includes padding to eight.
const CAPACITY: usize = 256;
const _: () =
    assert!(3 * CLUSTER + LANES <= CAPACITY, "a byte holds the index of every vertex, and UNLIT");
/// Marks a vertex that no triangle has needed so far.
const UNLIT: u8 = u8::MAX;

impl Default for Vertices {
    fn default() -> Self {
        Self {
            slots: [UNLIT; CAPACITY],
            x: [0.0; CAPACITY],
            y: [0.0; CAPACITY],
            varying: [[0.0; VARYING]; CAPACITY],
        }
    }
}

impl Vertices {
    #[inline(always)]
    fn light(
        &mut self,
        instance: &Instance,
        mesh: &Mesh,
        interpolated: Interpolated<'_>,
        size: [f32; 2],
        (first, requests): (u32, &[SurfaceRequest]),
    ) {
        let vertices = &mesh.vertices[first as usize..];
        let corners = mesh.corners.each_ref().map(|corners| &corners[..]);
        self.slots.fill(UNLIT);
        let (mut needed, mut count) = ([0; CAPACITY], 0);
        for triangle in requests.iter().map(|request| request.triangle as usize) {
            for corners in corners {
                let slot = &mut self.slots[usize::from(corners[triangle])];
                if *slot == UNLIT {
                    *slot = count as u8;
                    needed[count] = corners[triangle];
                    count += 1;
                }
            }
        }
        for at in (0..count).step_by(LANES) {
            let mut eight = [Vertex::default(); LANES];
            for (vertex, id) in eight.iter_mut().zip(&needed[at..at + LANES]) {
                *vertex = vertices[usize::from(*id)];
            }
            let from = Corners::new(eight);
            let projected = from.project(instance, size);
            projected.x.store(&mut self.x[at..at + LANES]);
            projected.y.store(&mut self.y[at..at + LANES]);
            let values = F::transpose(from.values(instance, interpolated, projected.over_w));
            for (varying, values) in self.varying[at..at + LANES].iter_mut().zip(values) {
                *varying = values.to_array();
            }
        }
    }
}

/// Computes the surfaces of triangles in one cluster, whose vertices start at `first`.
#[inline(always)]
pub(crate) fn compute_cluster(
    instance: &Instance,
    mesh: &Mesh,
    interpolated: Interpolated<'_>,
    size: [f32; 2],
    (first, requests): (u32, &[SurfaceRequest]),
    vertices: &mut Vertices,
    into: &mut [Surface],
) {
    vertices.light(instance, mesh, interpolated, size, (first, requests));
    let order = winding_order(instance.counter_clockwise).map(|corner| &mesh.corners[corner][..]);
    for requests in requests.chunks(LANES) {
        let mut slots = [[0u8; 3]; LANES];
        let (mut x, mut y) = ([[0.0; LANES]; 3], [[0.0; LANES]; 3]);
        for (lane, request) in requests.iter().enumerate() {
            for (turn, corners) in order.into_iter().enumerate() {
                let vertex = corners[request.triangle as usize];
                let slot = vertices.slots[usize::from(vertex)];
                slots[lane][turn] = slot;
                x[turn][lane] = vertices.x[usize::from(slot)];
                y[turn][lane] = vertices.y[usize::from(slot)];
            }
        }
        let slopes = Slopes::new(&x.map(F::new), &y.map(F::new)).each();
        for ((request, slots), slopes) in requests.iter().zip(slots).zip(slopes) {
            let values = slots.map(|slot| F::new(vertices.varying[usize::from(slot)]));
            let [at_corner, per_x, per_y] = slopes.plane(&values);
            into[request.surface as usize] = Surface {
                at_corner: at_corner.to_array(),
                per_x: per_x.to_array(),
                per_y: per_y.to_array(),
            };
        }
    }
}

/// Eight vertices as stored in the mesh.
struct Corners {
    pos: [F; 3],
    normal: [F; 3],
    st: [F; 2],
}

/// Positions of eight vertices in the picture, and 1/w.
struct Projected {
    x: F,
    y: F,
    over_w: F,
}

impl Corners {
    #[inline(always)]
    fn new(vertices: [Vertex; LANES]) -> Self {
        let [x, y, z, nx, ny, nz, s, t] = F::transpose(vertices.map(F::new));
        Self { pos: [x, y, z], normal: [nx, ny, nz], st: [s, t] }
    }

    /// Repeats the computation of [`transform`](crate::place::transform) bit for bit.
    #[inline(always)]
    fn project(&self, instance: &Instance, size: [f32; 2]) -> Projected {
        let [x, y, z] = self.pos;
        let row = instance.to_clip.rows([x, y, z]);
        let half = size.map(|size| F::splat(size * 0.5));
        let over_w = F::splat(1.0) / row(3);
        Projected {
            x: (row(0) * over_w).fused(half[0], half[0]),
            y: (row(1) * over_w).fused(half[1], half[1]),
            over_w,
        }
    }

    #[inline(always)]
    fn values(
        &self,
        instance: &Instance,
        interpolated: Interpolated<'_>,
        over_w: F,
    ) -> [F; VARYING] {
        let splat = |value: f32| F::splat(value);
        let [x, y, z] = self.pos;
        let shading = match interpolated {
            Interpolated::Colour(shading) => shading,
            Interpolated::Place(receiver) => {
                let row = instance.to_eye.rows([x, y, z]);
                let [s, t, r, q] = receiver.place([row(0), row(1), row(2)]);
                let unused = splat(0.0);
                return [splat(1.0), s, t, r, q, unused, unused, unused]
                    .map(|value| value * over_w);
            }
        };
        let colour = match shading {
            None => [splat(1.0); 3],
            Some(shading) => {
                let row = instance.to_eye.rows([x, y, z]);
                let normal = self.normal;
                let inverse = instance.normals.map(splat);
                let eye_normal = [0, 1, 2].map(|axis| {
                    normal[2] * inverse[6 + axis]
                        + normal[1] * inverse[3 + axis]
                        + normal[0] * inverse[axis]
                });
                shade(shading, [row(0), row(1), row(2)], eye_normal)
            }
        };
        let [s, t] = self.st;
        let coordinates = match instance.mapping {
            Mapping::None => [splat(0.0); 3],
            Mapping::Corners => [s, t, splat(0.0)],
            Mapping::Flat([sx, sy]) => {
                [x * splat(sx) - splat(0.5), y * splat(sy) - splat(0.5), splat(0.0)]
            }
            Mapping::Cube([sx, sy, sz]) => [x * splat(sx), y * splat(sy), z * splat(sz)],
            Mapping::Sky => [x, z, -y],
        };
        let opacity = splat(instance.rgba[3].clamp(0.0, 1.0));
        let [r, g, b] = colour;
        let [u, v, w] = coordinates;
        [splat(1.0), r, g, b, u, v, w, opacity].map(|value| value * over_w)
    }
}

/// Clips the triangle again, with all interpolated values.
#[inline(never)]
pub(crate) fn compute_clipped(
    instance: &Instance,
    mesh: &Mesh,
    interpolated: Interpolated<'_>,
    visible: &Visible,
    record: &Record,
) -> Surface {
    debug_assert_eq!(record.vertices, CLIPPED, "the record is a piece of a clipped triangle");
    let piece = &visible.clipped[record.triangle as usize];
    let ids = mesh.corners.each_ref().map(|corners| corners[piece.triangle as usize]);
    let [a, b, c] = ids.map(|id| mesh.vertices[piece.vertices as usize + usize::from(id)]);
    let from = Corners::new([a, b, c, c, c, c, c, c]);
    let [a, b, c, ..] = F::transpose(from.values(instance, interpolated, F::splat(1.0)));
    let pos = [0, 1, 2].map(|lane| from.pos.map(|axis| axis.as_array()[lane]));
    let polygon = clip::clip(instance, pos, [a, b, c], &piece.clipping);
    let Some(corners) = polygon.pieces().nth(piece.piece as usize) else {
        return Surface::default();
    };
    let corners = winding_order(instance.counter_clockwise).map(|corner| corners[corner]);
    let place = |axis: usize| corners.map(|corner| F::splat(corner.window[axis]));
    let slopes = Slopes::new(&place(0), &place(1));
    let values = corners.map(|corner| corner.values * F::splat(corner.over_w));
    let [at_corner, per_x, per_y] = slopes.plane(&values);
    Surface { at_corner: at_corner.to_array(), per_x: per_x.to_array(), per_y: per_y.to_array() }
}
