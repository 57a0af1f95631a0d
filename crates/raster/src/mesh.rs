//! Meshes, prepared once. Triangles are grouped into clusters of neighbours with similar normals,
//! so that whole clusters can be culled. Corners at the same position share one position of
//! their cluster, which is transformed once; identical corners share a vertex, which is lit once.

use std::collections::HashMap;

use bytes::Bytes;

use crate::error::ModelError;
use crate::lanes::LANES;
use crate::matrix::{Vec3, cross, dot, minus};
use crate::values::{Blob, Values};

/// Maximum number of triangles in a cluster, so that the indices of their corners fit in a byte.
pub(crate) const CLUSTER: usize = 64;
/// Weight of normals relative to a distance in splitting into clusters, in radii of the mesh.
const FACING_WEIGHT: f32 = 0.35;

#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Corner {
    /// Position, mesh frame.
    pub pos: [f32; 3],
    /// Normal for lighting, mesh frame, of any length.
    pub normal: [f32; 3],
    /// Texture coordinates.
    pub st: [f32; 2],
}

impl Corner {
    /// Returns the bits of all fields for comparison; zeros of different sign are unequal.
    fn bits(&self) -> [u32; 8] {
        let ([x, y, z], [nx, ny, nz], [s, t]) = (self.pos, self.normal, self.st);
        [x, y, z, nx, ny, nz, s, t].map(f32::to_bits)
    }
}

#[derive(Debug, Default)]
pub struct Mesh {
    pub(crate) clusters: Vec<Cluster>,
    /// Positions, cluster by cluster; each cluster's positions are padded to a multiple of eight.
    pub(crate) xs: Values<f32>,
    pub(crate) ys: Values<f32>,
    pub(crate) zs: Values<f32>,
    /// Vertices, cluster by cluster: position, normal and texture coordinates.
    pub(crate) vertices: Values<Vertex>,
    /// Indices in the cluster, per triangle, cluster by cluster, padded to a multiple of eight.
    pub(crate) position_ids: [Values<u8>; 3],
    /// Vertex indices of the same triangles' corners within the cluster.
    pub(crate) corners: [Values<u8>; 3],
    /// Per triangle: its index in the mesh's drawing order.
    pub(crate) order: Values<u32>,
    pub(crate) bounds: Sphere,
}

pub(crate) type Vertex = [f32; 8];

#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Sphere {
    pub(crate) center: Vec3,
    pub(crate) radius: f32,
}

#[derive(Debug, Clone, Copy)]
pub(crate) struct Cluster {
    pub(crate) bounds: Sphere,
    /// Axis of the cone of all normals; `sine` is that of the angle to the farthest one.
    axis: Vec3,
    sine: f32,
    pub(crate) first_position: u32,
    pub(crate) positions: u32,
    pub(crate) first_vertex: u32,
    vertices: u32,
    pub(crate) first_triangle: u32,
    pub(crate) triangles: u32,
}

impl Cluster {
    /// Returns true if every triangle is back-facing for an eye in the mesh's frame.
    pub(crate) fn faces_away_from(&self, eye: Vec3) -> bool {
        let to = minus(self.bounds.center, eye);
        let distance = dot(to, to).sqrt();
        // Tolerates rounding, including the rounding of poses, for triangles seen edge-on.
        dot(to, self.axis) > (self.sine + 2e-3) * distance + 1.01 * self.bounds.radius
    }

    /// Every triangle is back-facing for an infinitely distant eye with this viewing direction.
    pub(crate) fn faces_along(&self, forward: Vec3) -> bool {
        let length = dot(forward, forward).sqrt();
        dot(forward, self.axis) > (self.sine + 2e-3) * length
    }
}

/// Collects the triangles of a mesh in drawing order.
#[derive(Debug, Default)]
pub struct MeshBuilder {
    triangles: Vec<[Corner; 3]>,
}

impl MeshBuilder {
    /// Adds a triangle whose front is wound counter-clockwise.
    pub fn triangle(&mut self, corners: [Corner; 3]) {
        self.triangles.push(corners);
    }

    /// Adds a quadrilateral, split into triangles as in Mesa.
    pub fn quad(&mut self, [a, b, c, d]: [Corner; 4]) {
        self.triangle([a, b, d]);
        self.triangle([b, c, d]);
    }

    /// Leaves out invisible triangles: a position is not finite, or two corners share one.
    pub fn build(self) -> Mesh {
        let bits = |corner: &Corner| corner.pos.map(f32::to_bits);
        let is_visible = |corners: &[Corner; 3]| {
            let [a, b, c] = corners.each_ref().map(bits);
            let is_finite = corners.iter().all(|corner| corner.pos.iter().all(|x| x.is_finite()));
            is_finite && a != b && b != c && c != a
        };
        let all = self.triangles.iter().enumerate();
        let mut pieces: Vec<Piece> = all
            .filter(|(_, corners)| is_visible(corners))
            .map(|(order, corners)| Piece::new(order as u32, corners))
            .collect();
        let mut mesh = Mesh {
            bounds: bounding_sphere(pieces.iter().flat_map(|piece| piece.pos)),
            ..Mesh::default()
        };
        let weight = mesh.bounds.radius * FACING_WEIGHT;
        for piece in &mut pieces {
            for axis in 0..3 {
                piece.key[3 + axis] = piece.facing[axis] * weight;
            }
        }
        split(&mut pieces, &mut |cluster| {
            mesh.add_cluster(cluster, &self.triangles);
        });
        mesh
    }
}

struct Piece {
    order: u32,
    pos: [Vec3; 3],
    /// Unit normal of the triangle's plane; zero if the triangle is degenerate.
    facing: Vec3,
    /// Centre, and normal times a weight: the dimensions along which triangles are split.
    key: [f32; 6],
}

impl Piece {
    fn new(order: u32, corners: &[Corner; 3]) -> Self {
        let pos = corners.map(|corner| corner.pos);
        let normal = cross(minus(pos[1], pos[0]), minus(pos[2], pos[0]));
        let length = dot(normal, normal).sqrt();
        let facing = match length > 0.0 && length.is_finite() {
            true => normal.map(|part| part / length),
            false => [0.0; 3],
        };
        let mut key = [0.0; 6];
        for (axis, value) in key.iter_mut().take(3).enumerate() {
            *value = (pos[0][axis] + pos[1][axis] + pos[2][axis]) / 3.0;
        }
        Self { order, pos, facing, key }
    }
}

/// Splits along the widest dimension until the pieces fit a cluster.
fn split(pieces: &mut [Piece], emit: &mut impl FnMut(&mut [Piece])) {
    if pieces.is_empty() {
        return;
    }
    if pieces.len() <= CLUSTER {
        emit(pieces);
        return;
    }
    let widest = (0..6)
        .map(|axis| {
            let (mut low, mut high) = (f32::INFINITY, f32::NEG_INFINITY);
            for piece in pieces.iter() {
                low = low.min(piece.key[axis]);
                high = high.max(piece.key[axis]);
            }
            (axis, high - low)
        })
        .max_by(|a, b| a.1.total_cmp(&b.1));
    let axis = widest.map_or(0, |(axis, _)| axis);
    // Fills the clusters on the left completely; the remainder goes to the right.
    let middle = (pieces.len() / 2).next_multiple_of(CLUSTER);
    pieces.select_nth_unstable_by(middle - 1, |a, b| a.key[axis].total_cmp(&b.key[axis]));
    let (left, right) = pieces.split_at_mut(middle);
    split(left, emit);
    split(right, emit);
}

impl Mesh {
    fn add_cluster(&mut self, pieces: &mut [Piece], triangles: &[[Corner; 3]]) {
        // The triangles are sorted by drawing order: at equal depth, the later triangle is visible.
        pieces.sort_unstable_by_key(|piece| piece.order);
        let (first_position, first_vertex) = (self.xs.len() as u32, self.vertices.len() as u32);
        let first_triangle = self.order.len() as u32;
        let mut positions: HashMap<[u32; 3], u8> = HashMap::new();
        let mut vertices: HashMap<[u32; 8], u8> = HashMap::new();
        for piece in pieces.iter() {
            for (at, corner) in triangles[piece.order as usize].iter().enumerate() {
                let next = positions.len() as u8;
                let bits = corner.bits();
                let position = *positions.entry([bits[0], bits[1], bits[2]]).or_insert_with(|| {
                    self.push_position(corner.pos);
                    next
                });
                self.position_ids[at].push(position);
                let next = vertices.len() as u8;
                let vertex = *vertices.entry(bits).or_insert_with(|| {
                    self.vertices.push(bits.map(f32::from_bits));
                    next
                });
                self.corners[at].push(vertex);
            }
            self.order.push(piece.order);
        }
        let bounds = bounding_sphere(pieces.iter().flat_map(|piece| piece.pos));
        let (axis, sine) = normal_cone(pieces);
        self.clusters.push(Cluster {
            bounds,
            axis,
            sine,
            first_position,
            positions: positions.len() as u32,
            first_vertex,
            vertices: vertices.len() as u32,
            first_triangle,
            triangles: pieces.len() as u32,
        });
        while !self.xs.len().is_multiple_of(LANES) {
            self.push_position(pieces[0].pos[0]);
        }
        while !self.order.len().is_multiple_of(LANES) {
            let lists = self.position_ids.iter_mut().chain(&mut self.corners);
            lists.for_each(|corners| corners.push(0));
            self.order.push(0);
        }
    }

    fn push_position(&mut self, [x, y, z]: Vec3) {
        self.xs.push(x);
        self.ys.push(y);
        self.zs.push(z);
    }

    /// Serialises the mesh for [`Mesh::from_bytes`] with the same [`SOURCES`](crate::SOURCES) on
    /// the same kind of machine.
    pub fn to_bytes(&self) -> Vec<u8> {
        let Self { clusters, xs, ys, zs, vertices, position_ids, corners, order, bounds } = self;
        let counts = [clusters.len(), xs.len(), vertices.len(), order.len()];
        let counts = counts.map(|count| count as u32);
        let mut bytes = bytemuck::cast_slice(&counts).to_vec();
        bytes.extend_from_slice(bytemuck::cast_slice(&bounds.words()));
        for cluster in clusters {
            bytes.extend_from_slice(bytemuck::cast_slice(&cluster.words()));
        }
        for values in [xs, ys, zs] {
            bytes.extend_from_slice(bytemuck::cast_slice(values));
        }
        bytes.extend_from_slice(bytemuck::cast_slice(vertices));
        bytes.extend_from_slice(bytemuck::cast_slice(order));
        for values in position_ids.iter().chain(corners) {
            bytes.extend_from_slice(values);
        }
        bytes
    }

    /// Deserialises a mesh without copying its arrays out of the bytes of [`Mesh::to_bytes`], which
    /// must be aligned to four.
    pub fn from_bytes(bytes: Bytes) -> Result<Self, ModelError> {
        Self::read(Blob::new(bytes)).ok_or(ModelError::Bytes)
    }

    fn read(mut blob: Blob) -> Option<Self> {
        let counts = blob.take::<u32>(4)?;
        let [clusters, positions, vertices, triangles] = [0, 1, 2, 3].map(|at| counts[at] as usize);
        let bounds = Sphere::from_words(blob.take::<[u32; 4]>(1)?[0]);
        let clusters = blob.take::<[u32; WORDS]>(clusters)?;
        let mesh = Self {
            clusters: clusters.iter().copied().map(Cluster::from_words).collect(),
            xs: blob.take(positions)?,
            ys: blob.take(positions)?,
            zs: blob.take(positions)?,
            vertices: blob.take(vertices)?,
            order: blob.take(triangles)?,
            position_ids: [blob.take(triangles)?, blob.take(triangles)?, blob.take(triangles)?],
            corners: [blob.take(triangles)?, blob.take(triangles)?, blob.take(triangles)?],
            bounds,
        };
        let is_within_arrays = |cluster: &Cluster| {
            let end = |first: u32, count: u32| first as usize + count as usize;
            end(cluster.first_position, cluster.positions) <= positions
                && end(cluster.first_vertex, cluster.vertices) <= vertices
                && end(cluster.first_triangle, cluster.triangles) <= triangles
        };
        (blob.is_empty() && mesh.clusters.iter().all(is_within_arrays)).then_some(mesh)
    }

    pub fn triangles(&self) -> usize {
        let counts = self.clusters.iter().map(|cluster| cluster.triangles as usize);
        counts.sum()
    }

    pub(crate) fn position(&self, cluster: &Cluster, id: u8) -> Vec3 {
        let at = cluster.first_position as usize + usize::from(id);
        [self.xs[at], self.ys[at], self.zs[at]]
    }
}

impl Sphere {
    fn words(self) -> [u32; 4] {
        let [x, y, z] = self.center;
        [x, y, z, self.radius].map(f32::to_bits)
    }

    fn from_words(words: [u32; 4]) -> Self {
        let [x, y, z, radius] = words.map(f32::from_bits);
        Self { center: [x, y, z], radius }
    }
}

const WORDS: usize = 14;

impl Cluster {
    fn words(&self) -> [u32; WORDS] {
        let [a, b, c, d] = self.bounds.words();
        let [x, y, z] = self.axis.map(f32::to_bits);
        let sine = self.sine.to_bits();
        let [p, q] = [self.first_position, self.positions];
        let [v, w] = [self.first_vertex, self.vertices];
        let [t, u] = [self.first_triangle, self.triangles];
        [a, b, c, d, x, y, z, sine, p, q, v, w, t, u]
    }

    fn from_words(words: [u32; WORDS]) -> Self {
        let [a, b, c, d, x, y, z, sine, p, q, v, w, t, u] = words;
        Self {
            bounds: Sphere::from_words([a, b, c, d]),
            axis: [x, y, z].map(f32::from_bits),
            sine: f32::from_bits(sine),
            first_position: p,
            positions: q,
            first_vertex: v,
            vertices: w,
            first_triangle: t,
            triangles: u,
        }
    }
}

/// Returns a bounding sphere of points, not necessarily the smallest.
fn bounding_sphere(points: impl Iterator<Item = Vec3> + Clone) -> Sphere {
    let (mut low, mut high) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
    for point in points.clone() {
        for axis in 0..3 {
            low[axis] = low[axis].min(point[axis]);
            high[axis] = high[axis].max(point[axis]);
        }
    }
    if low[0] > high[0] {
        return Sphere::default();
    }
    // Halves before adding, since the sum of two large numbers may overflow.
    let center: Vec3 = std::array::from_fn(|axis| low[axis] * 0.5 + high[axis] * 0.5);
    let furthest = points
        .map(|point| {
            let offset = minus(point, center);
            dot(offset, offset)
        })
        .fold(0.0, f32::max);
    Sphere { center, radius: furthest.sqrt() * 1.0001 }
}

/// Returns the mean normal of triangles and the sine of the largest angle from it; a zero axis if
/// the normals differ too much or a triangle is degenerate.
fn normal_cone(pieces: &[Piece]) -> (Vec3, f32) {
    const NO_CONE: (Vec3, f32) = ([0.0; 3], 1.0);
    let mut sum = [0.0; 3];
    for piece in pieces {
        for (sum, part) in sum.iter_mut().zip(piece.facing) {
            *sum += part;
        }
    }
    let length = dot(sum, sum).sqrt();
    if length.is_nan() || length <= 1e-3 || pieces.iter().any(|piece| piece.facing == [0.0; 3]) {
        return NO_CONE;
    }
    let axis = sum.map(|part| part / length);
    let cosine = pieces.iter().map(|piece| dot(piece.facing, axis)).fold(1.0, f32::min);
    if cosine <= 0.05 {
        return NO_CONE;
    }
    (axis, (1.0 - cosine * cosine).max(0.0).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn corner(x: f32, y: f32, z: f32) -> Corner {
        Corner { pos: [x, y, z], normal: [0.0, 0.0, 1.0], st: [0.0; 2] }
    }

    #[test]
    fn every_triangle_is_in_one_cluster_with_its_own_corners() {
        let mut builder = MeshBuilder::default();
        for index in 0..1000u32 {
            let x = (index % 31) as f32;
            let y = (index / 31) as f32;
            builder.triangle([corner(x, y, 0.0), corner(x + 1.0, y, 0.0), corner(x, y + 1.0, 0.0)]);
        }
        let expected = builder.triangles.clone();
        let mesh = builder.build();
        assert_eq!(mesh.triangles(), 1000);
        let mut found = vec![0; 1000];
        for cluster in &mesh.clusters {
            assert!(cluster.triangles as usize <= CLUSTER);
            let first = cluster.first_triangle as usize;
            for triangle in first..first + cluster.triangles as usize {
                let order = mesh.order[triangle] as usize;
                found[order] += 1;
                for (at, corner) in expected[order].iter().enumerate() {
                    let position = mesh.position_ids[at][triangle];
                    assert_eq!(mesh.position(cluster, position), corner.pos);
                    let vertex =
                        cluster.first_vertex as usize + usize::from(mesh.corners[at][triangle]);
                    assert_eq!(mesh.vertices[vertex].map(f32::to_bits), corner.bits());
                }
            }
        }
        assert!(found.iter().all(|count| *count == 1));
    }

    #[test]
    fn only_the_complete_bytes_restore_a_mesh() {
        let mut builder = MeshBuilder::default();
        for index in 0..200 {
            let x = index as f32;
            let lifted = Corner { st: [x, -x], ..corner(x, 0.5 * x, -0.0) };
            builder.triangle([lifted, corner(x, x, 1.0), corner(x, -x, 2.0)]);
        }
        let bytes = builder.build().to_bytes();
        // Vectors of bytes may be misaligned; mapped files are aligned.
        let words: Vec<u32> = bytemuck::pod_collect_to_vec(&bytes);
        let aligned = Bytes::from_owner(Aligned(words)).slice(..bytes.len());
        let restored = Mesh::from_bytes(aligned.clone()).expect("a mesh");
        assert_eq!(restored.triangles(), 200);
        assert!(restored.to_bytes() == bytes);
        for length in [0, 4, 30, bytes.len() / 2, bytes.len() - 1] {
            let truncated = Mesh::from_bytes(aligned.slice(..length));
            assert_eq!(truncated.err(), Some(ModelError::Bytes), "{length} bytes");
        }
    }

    struct Aligned(Vec<u32>);

    impl AsRef<[u8]> for Aligned {
        fn as_ref(&self) -> &[u8] {
            bytemuck::cast_slice(&self.0)
        }
    }

    #[test]
    fn invisible_triangles_are_left_out() {
        let mut builder = MeshBuilder::default();
        builder.triangle([corner(0.0, 0.0, 0.0), corner(0.0, 0.0, 0.0), corner(1.0, 0.0, 0.0)]);
        builder.triangle([
            corner(f32::NAN, 0.0, 0.0),
            corner(0.0, 1.0, 0.0),
            corner(1.0, 0.0, 0.0),
        ]);
        let mesh = builder.build();
        assert_eq!((mesh.triangles(), mesh.bounds.radius), (0, 0.0));
    }

    #[test]
    fn a_cluster_faces_away_only_from_an_eye_behind_it() {
        let mut builder = MeshBuilder::default();
        builder.triangle([corner(0.0, 0.0, 0.0), corner(1.0, 0.0, 0.0), corner(0.0, 1.0, 0.0)]);
        let mesh = builder.build();
        let cluster = &mesh.clusters[0];
        assert!(cluster.faces_away_from([0.3, 0.3, -9.0]));
        assert!(!cluster.faces_away_from([0.3, 0.3, 9.0]));
        assert!(!cluster.faces_away_from([9.0, 0.0, 0.0]));
    }
}
