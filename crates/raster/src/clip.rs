//! Clipping of triangles against the view frustum, in clip space and in Mesa's order. Few triangles
//! need clipping, so they are processed one by one.

use crate::instance::Instance;
use crate::lanes::{F, LANES};
use crate::matrix::Vec3;

#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct ClippedCorner<V> {
    /// Position in the picture, pixels, and depth.
    pub(crate) window: [f32; 3],
    /// Reciprocal of w in clip space.
    pub(crate) over_w: f32,
    /// Interpolated values, not divided by w.
    pub(crate) values: V,
}

#[derive(Debug, Clone, Copy)]
pub(crate) struct ClippedTriangle {
    /// Index of the original triangle in its mesh, and first vertex of its cluster.
    pub(crate) triangle: u32,
    pub(crate) vertices: u32,
    pub(crate) clipping: Clipping,
    pub(crate) piece: u32,
}

#[derive(Debug, Clone, Copy)]
pub(crate) struct Clipping {
    pub(crate) beyond: i32,
    /// The mirror plane, which is the last clip plane; `None` outside reflections.
    pub(crate) plane: Option<[f32; 4]>,
    pub(crate) viewport: Viewport,
}

/// Transformation from normalised coordinates, -1 to 1, to a picture.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Viewport {
    pub(crate) scale: [f32; 2],
    pub(crate) middle: [f32; 2],
}

impl Viewport {
    pub(crate) fn whole(size: [usize; 2]) -> Self {
        let half = size.map(|side| side as f32 * 0.5);
        Self { scale: half, middle: half }
    }
}

pub(crate) const VARYING: usize = LANES;

pub(crate) trait Values: Copy + Default {
    fn toward(self, other: Self, share: f32) -> Self;
}

impl Values for () {
    fn toward(self, (): Self, _: f32) -> Self {}
}

/// One lane per interpolated value.
impl Values for F {
    #[inline(always)]
    fn toward(self, other: Self, share: f32) -> Self {
        self + Self::splat(share) * (other - self)
    }
}

#[derive(Clone, Copy, Default)]
struct Corner<V> {
    pos: [f32; 4],
    values: V,
    /// True for corners of the original triangle, false for corners that clipping added.
    is_original: bool,
}

/// Number of clip planes: the six of the view frustum, and a mirror's plane.
const SIDES: usize = 7;
/// Right, left, upper, lower, both ends of the depth. Inside, the scalar product is not negative.
const SIDE_PLANES: [[f32; 4]; SIDES - 1] = [
    [-1.0, 0.0, 0.0, 1.0],
    [1.0, 0.0, 0.0, 1.0],
    [0.0, -1.0, 0.0, 1.0],
    [0.0, 1.0, 0.0, 1.0],
    [0.0, 0.0, 1.0, 0.0],
    [0.0, 0.0, -1.0, 1.0],
];

/// Each plane adds one corner, and rounding may add another where a plane touches the polygon.
const MAX_CORNERS: usize = 3 + SIDES + 2;

pub(crate) struct Polygon<V> {
    corners: [ClippedCorner<V>; MAX_CORNERS],
    count: usize,
}

impl<V: Values> Polygon<V> {
    /// Returns the pieces in drawing order, wound like the original triangle. Pieces with a
    /// position that is not finite are left out.
    pub(crate) fn pieces(&self) -> impl Iterator<Item = [ClippedCorner<V>; 3]> {
        let is_placed = |corners: &[ClippedCorner<V>; 3]| {
            let mut places = corners.iter().flat_map(|corner| corner.window);
            places.all(f32::is_finite)
        };
        (2..self.count)
            .map(|last| [last - 1, last, 0].map(|corner| self.corners[corner]))
            .filter(is_placed)
    }
}

pub(crate) fn clip<V: Values>(
    instance: &Instance,
    corners: [Vec3; 3],
    values: [V; 3],
    clipping: &Clipping,
) -> Polygon<V> {
    let mut polygons = [[Corner::default(); MAX_CORNERS]; 2];
    let [polygon, output] = &mut polygons;
    let (mut polygon, mut output) = (polygon, output);
    for ((to, pos), values) in polygon.iter_mut().zip(corners).zip(values) {
        *to = Corner { pos: to_clip_space(instance, pos), values, is_original: true };
    }
    let mut count = 3;
    for side in (0..SIDES).filter(|side| clipping.beyond & (1 << side) != 0) {
        let Some(normal) = SIDE_PLANES.get(side).copied().or(clipping.plane) else {
            continue;
        };
        count = clip_by_plane(&polygon[..count], normal, output).unwrap_or(0);
        std::mem::swap(&mut polygon, &mut output);
    }
    let mut finished = [ClippedCorner::default(); MAX_CORNERS];
    for (to, corner) in finished.iter_mut().zip(&polygon[..count]) {
        *to = to_window(corner, &clipping.viewport);
    }
    Polygon { corners: finished, count }
}

fn to_clip_space(instance: &Instance, [x, y, z]: Vec3) -> [f32; 4] {
    let m = &instance.to_clip.0;
    std::array::from_fn(|row| x * m[row] + y * m[row + 4] + z * m[row + 8] + m[row + 12])
}

/// Returns the number of corners inside; `None` if a distance is not finite, or there are too many.
fn clip_by_plane<V: Values>(
    polygon: &[Corner<V>],
    plane: [f32; 4],
    output: &mut [Corner<V>; MAX_CORNERS],
) -> Option<usize> {
    let distance = |corner: &Corner<V>| {
        let p = corner.pos;
        p[0] * plane[0] + p[1] * plane[1] + p[2] * plane[2] + p[3] * plane[3]
    };
    let mut count = 0;
    let mut push = |corner: Corner<V>| {
        let target = output.get_mut(count)?;
        *target = corner;
        count += 1;
        Some(())
    };
    let mut last = polygon.first()?;
    let mut last_distance = distance(last);
    for corner in polygon.iter().skip(1).chain(polygon.first()) {
        let corner_distance = distance(corner);
        if !corner_distance.is_finite() || !last_distance.is_finite() {
            return None;
        }
        if last_distance >= 0.0 {
            push(*last)?;
        }
        if (last_distance >= 0.0) != (corner_distance >= 0.0) {
            // Interpolates from the corner nearer to the plane, for precision.
            let between = corner_distance - last_distance;
            let from_corner = match corner_distance < 0.0 {
                true => -corner_distance < last_distance,
                false => -last_distance >= corner_distance,
            };
            push(match from_corner {
                true => toward(corner, last, corner_distance / between),
                false => toward(last, corner, -last_distance / between),
            })?;
        }
        (last, last_distance) = (corner, corner_distance);
    }
    Some(count)
}

fn toward<V: Values>(from: &Corner<V>, to: &Corner<V>, share: f32) -> Corner<V> {
    let mix = |from: f32, to: f32| from + share * (to - from);
    Corner {
        pos: std::array::from_fn(|at| mix(from.pos[at], to.pos[at])),
        values: from.values.toward(to.values, share),
        is_original: false,
    }
}

/// Mesa fuses the last operation only for corners of original triangles.
fn to_window<V: Values>(corner: &Corner<V>, viewport: &Viewport) -> ClippedCorner<V> {
    let Viewport { scale, middle } = viewport;
    let over_w = 1.0 / corner.pos[3];
    let place = |axis: usize| {
        let share = corner.pos[axis] * over_w;
        match corner.is_original {
            true => share.mul_add(scale[axis], middle[axis]),
            false => share * scale[axis] + middle[axis],
        }
    };
    ClippedCorner {
        window: [place(0), place(1), corner.pos[2] * over_w],
        over_w,
        values: corner.values,
    }
}
