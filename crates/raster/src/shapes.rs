//! MuJoCo's built-in shapes at unit size, tessellated as the model specifies. Angles are computed
//! like in MuJoCo, in double precision, then rounded.

use std::f64::consts::PI;

use crate::matrix::{Vec3, normalized};
use crate::mesh::{Corner, Mesh, MeshBuilder};

/// Tessellation of round and flat shapes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Quality {
    /// Pieces around an axis.
    pub slices: usize,
    /// Pieces along an axis.
    pub stacks: usize,
    /// Pieces along each side of a rectangle.
    pub quads: usize,
}

#[derive(Debug)]
pub(crate) struct Shapes {
    pub(crate) rectangle: Mesh,
    pub(crate) cuboid: Mesh,
    pub(crate) sphere: Mesh,
    /// Half-spheres at the ends of a capsule whose cylinder extends from −1 to 1 along the axis.
    pub(crate) upper_half: Mesh,
    pub(crate) lower_half: Mesh,
    pub(crate) cylinder: Mesh,
    pub(crate) open_cylinder: Mesh,
}

/// Faces: in each cell of their grids, the upper face's triangles precede those of the others.
const CUBOID_FACES: u32 = 6;
const TRIANGLES_PER_QUAD: u32 = 2;

/// Returns true if a triangle of the cuboid, in drawing order, is part of its upper face.
pub(crate) fn is_upper_face(order: u32) -> bool {
    order % (CUBOID_FACES * TRIANGLES_PER_QUAD) < TRIANGLES_PER_QUAD
}

impl Shapes {
    pub(crate) fn new(quality: Quality) -> Self {
        let Quality { slices, stacks, .. } = quality;
        let mesh = |add: &dyn Fn(&mut MeshBuilder)| {
            let mut builder = MeshBuilder::default();
            add(&mut builder);
            builder.build()
        };
        Self {
            rectangle: mesh(&|builder| rectangle(builder, quality.quads)),
            cuboid: mesh(&|builder| cuboid(builder, quality.quads)),
            sphere: mesh(&|builder| sphere(builder, slices, stacks)),
            upper_half: mesh(&|builder| half_sphere(builder, 1, slices, stacks / 2)),
            lower_half: mesh(&|builder| half_sphere(builder, -1, slices, stacks / 2)),
            cylinder: mesh(&|builder| {
                disk(builder, -1, slices, stacks / 2);
                open_cylinder(builder, slices, stacks);
                disk(builder, 1, slices, stacks / 2);
            }),
            open_cylinder: mesh(&|builder| open_cylinder(builder, slices, stacks)),
        }
    }
}

fn corner(pos: Vec3, normal: Vec3) -> Corner {
    Corner { pos, normal, st: [0.0; 2] }
}

fn rectangle(builder: &mut MeshBuilder, quads: usize) {
    let step = 2.0 / quads as f64;
    let at = |x: usize, y: usize| {
        let place = |index: usize| (step * index as f64 - 1.0) as f32;
        corner([place(x), place(y), 0.0], [0.0, 0.0, 1.0])
    };
    for x in 0..quads {
        for y in 0..quads {
            builder.quad([at(x, y), at(x + 1, y), at(x + 1, y + 1), at(x, y + 1)]);
        }
    }
}

fn cuboid(builder: &mut MeshBuilder, quads: usize) {
    let step = 2.0 / quads as f32;
    let place = |index: usize| step * index as f32 - 1.0;
    for x in 0..quads {
        for y in 0..quads {
            let (x0, x1, y0, y1) = (place(x), place(x + 1), place(y), place(y + 1));
            let mut face = |normal: Vec3, corners: [Vec3; 4]| {
                builder.quad(corners.map(|pos| corner(pos, normal)));
            };
            face([0.0, 0.0, 1.0], [[x0, y0, 1.0], [x1, y0, 1.0], [x1, y1, 1.0], [x0, y1, 1.0]]);
            face(
                [0.0, 0.0, -1.0],
                [[x0, y1, -1.0], [x1, y1, -1.0], [x1, y0, -1.0], [x0, y0, -1.0]],
            );
            face([1.0, 0.0, 0.0], [[1.0, x0, y0], [1.0, x1, y0], [1.0, x1, y1], [1.0, x0, y1]]);
            face(
                [-1.0, 0.0, 0.0],
                [[-1.0, x0, y1], [-1.0, x1, y1], [-1.0, x1, y0], [-1.0, x0, y0]],
            );
            face(
                [0.0, -1.0, 0.0],
                [[x0, -1.0, y0], [x1, -1.0, y0], [x1, -1.0, y1], [x0, -1.0, y1]],
            );
            face([0.0, 1.0, 0.0], [[x0, 1.0, y1], [x1, 1.0, y1], [x1, 1.0, y0], [x0, 1.0, y0]]);
        }
    }
}

fn azimuth(slice: usize, slices: usize) -> f32 {
    ((2.0 * PI * slice as f64) / f64::from(slices as f32)) as f32
}

/// Returns a point of the unit sphere, shifted along the axis by `raised`.
fn on_sphere(azimuth: f32, elevation: f32, raised: f32) -> Corner {
    let (ca, sa) = (libm::cosf(azimuth), libm::sinf(azimuth));
    let (ce, se) = (libm::cosf(elevation), libm::sinf(elevation));
    let z = raised + se;
    corner([ca * ce, sa * ce, z], [ca * ce, sa * ce, z - raised])
}

/// Adds the half of a sphere above its equator if `side` is 1, or below it if `side` is −1, shifted
/// along the axis by `raised`. `elevation` returns the angle of a ring, numbered from the equator.
fn dome(
    builder: &mut MeshBuilder,
    side: i32,
    raised: f32,
    slices: usize,
    elevation: &dyn Fn(usize) -> f32,
    rings: usize,
) {
    let tip = corner([0.0, 0.0, raised + side as f32], [0.0, 0.0, side as f32]);
    let wound = |mut corners: Vec<Corner>| {
        if side < 0 {
            corners.reverse();
        }
        corners
    };
    for slice in 0..slices {
        let (a, b) = (azimuth(slice, slices), azimuth(slice + 1, slices));
        let low = elevation(rings - 1);
        let corners = wound(vec![on_sphere(a, low, raised), on_sphere(b, low, raised), tip]);
        builder.triangle([corners[0], corners[1], corners[2]]);
    }
    for ring in 0..rings - 1 {
        let (low, high) = (elevation(ring), elevation(ring + 1));
        for slice in 0..slices {
            let (a, b) = (azimuth(slice, slices), azimuth(slice + 1, slices));
            let corners = wound(vec![
                on_sphere(a, low, raised),
                on_sphere(b, low, raised),
                on_sphere(b, high, raised),
                on_sphere(a, high, raised),
            ]);
            builder.quad([corners[0], corners[1], corners[2], corners[3]]);
        }
    }
}

fn sphere(builder: &mut MeshBuilder, slices: usize, stacks: usize) {
    let rings = stacks / 2;
    for side in [-1, 1] {
        let elevation = |ring: usize| {
            ((0.5 * PI * f64::from(side) * ring as f64) / f64::from(rings as f32)) as f32
        };
        dome(builder, side, 0.0, slices, &elevation, rings);
    }
}

fn half_sphere(builder: &mut MeshBuilder, side: i32, slices: usize, stacks: usize) {
    let elevation = |ring: usize| {
        ((PI / 2.0 * f64::from(side) * ring as f64) / f64::from(stacks as f32)) as f32
    };
    dome(builder, side, side as f32, slices, &elevation, stacks);
}

fn disk(builder: &mut MeshBuilder, side: i32, slices: usize, stacks: usize) {
    let z = side as f32;
    let at = |azimuth: f32, radius: f32| {
        let pos = [libm::cosf(azimuth) * radius, libm::sinf(azimuth) * radius, z];
        corner(pos, [0.0, 0.0, z])
    };
    let wound = |mut corners: Vec<Corner>| {
        if side < 0 {
            corners.reverse();
        }
        corners
    };
    let inner = 1.0 / stacks as f32;
    for slice in 0..slices {
        let (a, b) = (azimuth(slice, slices), azimuth(slice + 1, slices));
        let middle = corner([0.0, 0.0, z], [0.0, 0.0, z]);
        let corners = wound(vec![at(a, inner), at(b, inner), middle]);
        builder.triangle([corners[0], corners[1], corners[2]]);
    }
    for ring in 0..stacks - 1 {
        let radius = |ring: usize| ring as f32 / stacks as f32;
        let (r1, r2) = (radius(ring + 1), radius(ring + 2));
        for slice in 0..slices {
            let (a, b) = (azimuth(slice, slices), azimuth(slice + 1, slices));
            let corners = wound(vec![at(a, r2), at(b, r2), at(b, r1), at(a, r1)]);
            builder.quad([corners[0], corners[1], corners[2], corners[3]]);
        }
    }
}

fn open_cylinder(builder: &mut MeshBuilder, slices: usize, stacks: usize) {
    let at = |azimuth: f32, height: f32| {
        let (x, y) = (libm::cosf(azimuth), libm::sinf(azimuth));
        let length = (x * x + y * y).sqrt();
        corner([x, y, height], [x / length, y / length, 0.0])
    };
    let height = |stack: usize| (2 * stack) as f32 / stacks as f32 - 1.0;
    for stack in 0..stacks {
        let (low, high) = (height(stack), height(stack + 1));
        for slice in 0..slices {
            let (a, b) = (azimuth(slice, slices), azimuth(slice + 1, slices));
            builder.quad([at(a, low), at(b, low), at(b, high), at(a, high)]);
        }
    }
}

/// Returns the positions of the lines of a plane's grid along one direction.
///
/// `half` is half the plane's length, 0 for an infinite plane; `spacing` is half the distance of a
/// finite plane's lines; `period` is the repeat length of an infinite plane's texture, or `None`
/// without a texture that repeats; `far` is the viewing distance. All are in the same unit.
pub fn plane_grid(half: f64, spacing: f64, period: Option<f64>, far: f64) -> Vec<f64> {
    /// `mjMAXPLANEGRID`.
    const MAX_LINES: usize = 200;
    if half > 0.0 {
        let step = spacing.max(half / (MAX_LINES - 2) as f64);
        let mut cells = (half / step.max(1e-15)).floor() as usize;
        cells -= cells % 2;
        let pad = half - cells as f64 * step;
        cells += 2;
        let mut lines = vec![-half];
        for cell in 0..cells {
            let left = match cell {
                0 => -half,
                _ => -half + pad + (cell - 1) as f64 * step * 2.0,
            };
            let width = if cell == 0 || cell == cells - 1 { pad } else { step * 2.0 };
            lines[cell] = left;
            lines.push(left.max(left + width));
        }
        return lines;
    }
    let step = period.unwrap_or(2.1 * far / (MAX_LINES - 2) as f64);
    let cell = (2.1 * far + 2.0 * step) / MAX_LINES as f64;
    let middle = (MAX_LINES / 2) as f64;
    (0..=MAX_LINES).map(|line| cell * line as f64 - cell * middle).collect()
}

pub fn plane(xs: &[f64], ys: &[f64]) -> Mesh {
    let mut builder = MeshBuilder::default();
    let at = |x: f64, y: f64| corner([x as f32, y as f32, 0.0], [0.0, 0.0, 1.0]);
    for x in xs.windows(2) {
        for y in ys.windows(2) {
            builder.quad([at(x[0], y[0]), at(x[1], y[0]), at(x[1], y[1]), at(x[0], y[1])]);
        }
    }
    builder.build()
}

/// Returns the corners of a mesh's triangle from its positions, normals and texture coordinates.
/// Without texture coordinates, a corner gets the face's normal if the cosine of the angle between
/// its own normal and the face's is below 0.8. This keeps edges sharp, as in MuJoCo.
pub fn mesh_triangle(pos: [Vec3; 3], normals: [Vec3; 3], st: Option<[[f32; 2]; 3]>) -> [Corner; 3] {
    let (u, v) = (crate::matrix::minus(pos[1], pos[0]), crate::matrix::minus(pos[2], pos[0]));
    let face = normalized(crate::matrix::cross(u, v));
    std::array::from_fn(|index| {
        let normal = normals[index];
        // The comparison is in double precision, like C's comparison with a `double` constant.
        let is_sharp = st.is_none() && f64::from(crate::matrix::dot(normal, face)) < 0.8;
        Corner {
            pos: pos[index],
            normal: if is_sharp { face } else { normal },
            st: st.map_or([0.0; 2], |st| st[index]),
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shapes_have_as_many_triangles_as_mujocos_shapes() {
        let quality = Quality { slices: 28, stacks: 16, quads: 4 };
        let shapes = Shapes::new(quality);
        assert_eq!(shapes.rectangle.triangles(), 32);
        assert_eq!(shapes.cuboid.triangles(), 192);
        assert_eq!(shapes.sphere.triangles(), 2 * (28 + 7 * 28 * 2));
        assert_eq!(shapes.open_cylinder.triangles(), 16 * 28 * 2);
        let upper = shapes.cuboid.order.iter().filter(|order| is_upper_face(**order));
        assert!(upper.count() >= 32);
    }

    #[test]
    fn a_grid_covers_its_plane_from_end_to_end() {
        for (half, spacing) in [(1.0, 0.3), (3.0, 1.0), (0.5, 2.0), (100.0, 1e-6)] {
            let lines = plane_grid(half, spacing, None, 50.0);
            assert_eq!(lines[0], -half);
            assert!((lines[lines.len() - 1] - half).abs() < 1e-9);
            assert!(lines.windows(2).all(|pair| pair[0] <= pair[1]));
        }
        assert_eq!(plane_grid(0.0, 1.0, Some(2.0), 50.0).len(), 201);
    }
}
