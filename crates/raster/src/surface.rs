//! Colour and texture coordinates over the triangles that are seen: worked out
//! at their corners, and from there as planes over the picture.

use crate::clip::{self, VARYING};
use crate::instance::{Instance, Mapping};
use crate::lanes::{F, Floats as _, LANES};
use crate::light::{Shading, shade};
use crate::mesh::Mesh;
use crate::setup::{Slopes, turned};
use crate::visible::{CLIPPED, Record, Visible};

/// What varies over a triangle, divided by w, in this order.
pub(crate) const OVER_W: usize = 0;
pub(crate) const COLOUR: usize = 1;
pub(crate) const COORDINATES: usize = 4;
pub(crate) const OPACITY: usize = 7;

/// A triangle's planes: values at the picture's corner and their changes per
/// pixel along x and y.
#[derive(Debug, Clone, Copy, Default)]
#[repr(align(32))]
pub(crate) struct Surface {
    pub(crate) at_corner: [f32; VARYING],
    pub(crate) per_x: [f32; VARYING],
    pub(crate) per_y: [f32; VARYING],
}

/// Works out up to eight triangles of one instance.
#[inline(always)]
pub(crate) fn work_out(
    instance: &Instance,
    mesh: &Mesh,
    shading: Option<&Shading<'_>>,
    size: [f32; 2],
    records: &[Record; LANES],
    into: &mut [Surface],
) {
    let order = turned(instance.counter_clockwise);
    let (mut x, mut y) = ([F::splat(0.0); 3], [F::splat(0.0); 3]);
    let mut varying = [[F::splat(0.0); 3]; VARYING];
    for (turn, corner) in order.into_iter().enumerate() {
        let from = Corners::gather(mesh, corner, records);
        let placed = from.place(instance, size);
        (x[turn], y[turn]) = (placed.x, placed.y);
        let values = from.values(instance, shading, placed.over_w);
        for (varying, value) in varying.iter_mut().zip(values) {
            varying[turn] = value;
        }
    }
    let slopes = Slopes::new(&x, &y);
    let planes = varying.each_ref().map(|values| slopes.of(values));
    let [at_corner, per_x, per_y] =
        [0, 1, 2].map(|part| F::transpose(planes.map(|it| it[part])).map(F::to_array));
    for (lane, surface) in into.iter_mut().enumerate() {
        surface.at_corner = at_corner[lane];
        surface.per_x = per_x[lane];
        surface.per_y = per_y[lane];
    }
}

/// One corner of each of eight triangles, as the mesh has it.
struct Corners {
    pos: [[f32; LANES]; 3],
    normal: [[f32; LANES]; 3],
    st: [[f32; LANES]; 2],
}

struct Placed {
    x: F,
    y: F,
    over_w: F,
}

impl Corners {
    #[inline(always)]
    fn gather(mesh: &Mesh, corner: usize, records: &[Record; LANES]) -> Self {
        let mut it = Self {
            pos: [[0.0; LANES]; 3],
            normal: [[0.0; LANES]; 3],
            st: [[0.0; LANES]; 2],
        };
        for (lane, record) in records.iter().enumerate() {
            let triangle = record.triangle as usize;
            let at = record.positions as usize + usize::from(mesh.corners[corner][triangle]);
            it.pos[0][lane] = mesh.xs[at];
            it.pos[1][lane] = mesh.ys[at];
            it.pos[2][lane] = mesh.zs[at];
            let attributes = &mesh.attributes[mesh.attribute_ids[triangle][corner] as usize];
            for axis in 0..3 {
                it.normal[axis][lane] = attributes.normal[axis];
            }
            it.st[0][lane] = attributes.st[0];
            it.st[1][lane] = attributes.st[1];
        }
        it
    }

    /// The same steps as [`Positions`](crate::setup::Positions) took, bit for bit.
    #[inline(always)]
    fn place(&self, instance: &Instance, size: [f32; 2]) -> Placed {
        let [x, y, z] = self.pos.map(F::new);
        let row = instance.to_clip.rows([x, y, z]);
        let half = size.map(|size| F::splat(size * 0.5));
        let over_w = F::splat(1.0) / row(3);
        Placed {
            x: (row(0) * over_w).fused(half[0], half[0]),
            y: (row(1) * over_w).fused(half[1], half[1]),
            over_w,
        }
    }

    /// Everything that varies, divided by w.
    #[inline(always)]
    fn values(
        &self,
        instance: &Instance,
        shading: Option<&Shading<'_>>,
        over_w: F,
    ) -> [F; VARYING] {
        let splat = |value: f32| F::splat(value);
        let [x, y, z] = self.pos.map(F::new);
        let colour = match shading {
            None => [splat(1.0); 3],
            Some(shading) => {
                let row = instance.to_eye.rows([x, y, z]);
                let normal = self.normal.map(F::new);
                let inverse = instance.normals.map(splat);
                let turned = [0, 1, 2].map(|axis| {
                    normal[2] * inverse[6 + axis]
                        + normal[1] * inverse[3 + axis]
                        + normal[0] * inverse[axis]
                });
                shade(shading, [row(0), row(1), row(2)], turned)
            }
        };
        let [s, t] = self.st.map(F::new);
        let coordinates = match instance.mapping {
            Mapping::None => [splat(0.0); 3],
            Mapping::Corners => [s, t, splat(0.0)],
            Mapping::Flat([sx, sy]) => [
                x * splat(sx) - splat(0.5),
                y * splat(sy) - splat(0.5),
                splat(0.0),
            ],
            Mapping::Cube([sx, sy, sz]) => [x * splat(sx), y * splat(sy), z * splat(sz)],
            Mapping::Sky => [x, z, -y],
        };
        let opacity = splat(instance.rgba[3].clamp(0.0, 1.0));
        let [r, g, b] = colour;
        let [u, v, w] = coordinates;
        [splat(1.0), r, g, b, u, v, w, opacity].map(|value| value * over_w)
    }
}

/// A piece that was cut off a triangle, which is cut again with everything that
/// varies.
#[inline(never)]
pub(crate) fn work_out_clipped(
    instance: &Instance,
    mesh: &Mesh,
    shading: Option<&Shading<'_>>,
    visible: &Visible,
    record: &Record,
) -> Surface {
    debug_assert_eq!(record.positions, CLIPPED, "a piece of a triangle");
    let piece = &visible.clipped[record.triangle as usize];
    let whole = Record {
        instance: record.instance,
        triangle: piece.triangle,
        positions: piece.positions,
    };
    let one = F::splat(1.0);
    let values = std::array::from_fn(|corner| {
        let from = Corners::gather(mesh, corner, &[whole; LANES]);
        let values = from.values(instance, shading, one);
        values.map(|value| value.as_array()[0])
    });
    let pos = std::array::from_fn(|corner| {
        let at =
            piece.positions as usize + usize::from(mesh.corners[corner][piece.triangle as usize]);
        [mesh.xs[at], mesh.ys[at], mesh.zs[at]]
    });
    let pieces = clip::clip(instance, pos, values, &piece.cut);
    let corners =
        turned(instance.counter_clockwise).map(|corner| pieces[piece.piece as usize][corner]);
    let place = |axis: usize| corners.map(|corner| F::splat(corner.window[axis]));
    let slopes = Slopes::new(&place(0), &place(1));
    let mut surface = Surface::default();
    for at in 0..VARYING {
        let values = corners.map(|corner| F::splat(corner.values[at] * corner.over_w));
        let [at_corner, per_x, per_y] = slopes.of(&values).map(|it| it.as_array()[0]);
        surface.at_corner[at] = at_corner;
        surface.per_x[at] = per_x;
        surface.per_y[at] = per_y;
    }
    surface
}
