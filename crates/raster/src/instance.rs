//! The view of a drawing pass, and the pass's mesh instances with their transformations and
//! materials.

use crate::matrix::{Matrix, Vec3, dot, minus};
use crate::mesh::Mesh;
use crate::model::Model;
use crate::scene::{Camera, Geom, Shape, TextureUse};
use crate::texture::TextureKind;
use crate::window::Window;

#[derive(Debug, Clone)]
pub(crate) struct View {
    pub(crate) projection: Matrix,
    pub(crate) world_to_eye: Matrix,
    /// Position of the camera, world frame.
    pub(crate) head: Vec3,
    pub(crate) mirrored: bool,
    /// Clip-space plane beyond which geometry is clipped.
    pub(crate) clip: Option<[f32; 4]>,
    pub(crate) orthographic: bool,
    pub(crate) far: f32,
}

impl View {
    pub(crate) fn new(camera: &Camera, width: usize, height: usize) -> Self {
        let half_width = match camera.half_width {
            0.0 => 0.5 * (width as f32) / (height as f32) * (camera.top - camera.bottom),
            given => given,
        };
        let sides = [camera.center - half_width, camera.center + half_width];
        let (ends, depths) = ([camera.bottom, camera.top], [camera.near, camera.far]);
        let projection = match camera.orthographic {
            true => Matrix::orthographic(sides, ends, depths),
            false => Matrix::perspective(sides, ends, depths),
        };
        Self {
            projection,
            world_to_eye: Matrix::look_at(camera.pos, camera.forward, camera.up),
            head: camera.pos,
            mirrored: false,
            clip: None,
            orthographic: camera.orthographic,
            far: camera.far,
        }
    }

    /// Geometry behind the mirror is clipped.
    pub(crate) fn in_mirror(&self, pos: Vec3, normal: Vec3) -> Self {
        let plane = [
            -normal[0],
            -normal[1],
            -normal[2],
            pos[0] * normal[0] + pos[1] * normal[1] + pos[2] * normal[2],
        ];
        Self {
            world_to_eye: self.world_to_eye.times(&Matrix::mirror(pos, normal)),
            mirrored: !self.mirrored,
            clip: self.plane_in_clip_space(plane),
            ..self.clone()
        }
    }

    fn plane_in_clip_space(&self, [a, b, c, d]: [f32; 4]) -> Option<[f32; 4]> {
        let view = &self.world_to_eye;
        let inverse = view.inverse_of_linear_part()?;
        // The inverse transforms the normal; the offset follows from the view's translation.
        let normal: Vec3 = std::array::from_fn(|row| {
            inverse[row] * a + inverse[3 + row] * b + inverse[6 + row] * c
        });
        let shift = [view.0[12], view.0[13], view.0[14]];
        let offset = d - (normal[0] * shift[0] + normal[1] * shift[1] + normal[2] * shift[2]);
        let p = &self.projection.0;
        let (x, y) = (normal[0] / p[0], normal[1] / p[5]);
        let (z, w) = if self.orthographic {
            let z = normal[2] / p[10];
            (z, offset - x * p[12] - y * p[13] - z * p[14])
        } else {
            let z = offset / p[14];
            (z, (normal[2] - x * p[8] - y * p[9] - z * p[10]) / p[11])
        };
        Some([x, y, z, w])
    }
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Mapping {
    None,
    Corners,
    Flat([f32; 2]),
    /// A cube texture in the direction from the centre, with this scale.
    Cube([f32; 3]),
    Sky,
}

#[derive(Debug, Clone)]
pub(crate) struct Instance {
    pub(crate) mesh: MeshRef,
    /// Index in the scene; `usize::MAX` for the sky, 0 for translucent geoms while blended.
    pub(crate) geom: usize,
    pub(crate) to_eye: Matrix,
    pub(crate) to_clip: Matrix,
    /// Inverse of the linear part of `to_eye`, row by row; the identity if that part is singular.
    pub(crate) normals: [f32; 9],
    /// Position in the mesh's frame, or the viewing direction if infinitely far away.
    pub(crate) eye: Vec3,
    pub(crate) counter_clockwise: bool,
    /// True if back faces are drawn instead of front faces.
    pub(crate) inside_out: bool,
    /// True if lights determine the instance's colour; otherwise the instance is white.
    pub(crate) is_lit: bool,
    pub(crate) rgba: [f32; 4],
    pub(crate) emission: f32,
    pub(crate) specular: f32,
    pub(crate) shininess: f32,
    pub(crate) texture: Option<usize>,
    pub(crate) mapping: Mapping,
    /// Distance of the far end from the eye. Instances are drawn nearest first.
    pub(crate) distance: f32,
    /// Position in OpenGL's drawing order.
    pub(crate) rank: u32,
    /// Bounding window of the pixels in which the instance became visible.
    pub(crate) window: Option<Window>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum MeshRef {
    Mesh(usize),
    Plane(usize),
    Rectangle,
    Cuboid,
    Sphere,
    UpperHalf,
    LowerHalf,
    Cylinder,
    OpenCylinder,
}

impl MeshRef {
    pub(crate) fn resolve(self, model: &Model) -> &Mesh {
        match self {
            Self::Mesh(index) => &model.meshes[index],
            Self::Plane(index) => &model.planes[index],
            Self::Rectangle => &model.shapes.rectangle,
            Self::Cuboid => &model.shapes.cuboid,
            Self::Sphere => &model.shapes.sphere,
            Self::UpperHalf => &model.shapes.upper_half,
            Self::LowerHalf => &model.shapes.lower_half,
            Self::Cylinder => &model.shapes.cylinder,
            Self::OpenCylinder => &model.shapes.open_cylinder,
        }
    }
}

/// Ranks reserved for the meshes of each geom; a capsule has the most meshes, three.
const MAX_PARTS: u32 = 4;

pub(crate) fn add(
    geom_index: usize,
    geom: &Geom,
    view: &View,
    model: &Model,
    into: &mut Vec<Instance>,
) {
    let placed = view.world_to_eye.translated(geom.pos).times(&Matrix::rotation(&geom.mat));
    let [x, y, z] = geom.size;
    let shows_back = is_plane(geom) && is_behind(view.head, geom);
    let mut parts = 0;
    let mut add = |mesh: MeshRef, to_eye: Matrix| {
        let Some(mut instance) = Instance::new(mesh, geom_index, to_eye, view, model) else {
            return;
        };
        instance.counter_clockwise = view.mirrored == shows_back;
        instance.inside_out = shows_back;
        instance.rank = geom_index as u32 * MAX_PARTS + parts;
        parts += 1;
        instance.rgba = geom.rgba;
        if shows_back {
            // MuJoCo shows the back of a plane with 0.3 of the plane's opacity. The product is in
            // double precision, like C's product with a `double` constant.
            instance.rgba[3] = (f64::from(instance.rgba[3]) * 0.3) as f32;
        }
        instance.emission = geom.emission;
        instance.specular = geom.specular;
        instance.shininess = geom.shininess * 128.0;
        if let Some(used) = geom.texture {
            instance.texture = Some(used.texture);
            instance.mapping = mapping(geom, &used, model);
        }
        into.push(instance);
    };
    match geom.shape {
        Shape::Mesh(index) => add(MeshRef::Mesh(index), placed),
        Shape::Plane(index) => add(MeshRef::Plane(index), placed),
        Shape::Rectangle => add(MeshRef::Rectangle, placed.scaled([x, y, 1.0])),
        Shape::Box => add(MeshRef::Cuboid, placed.scaled(geom.size)),
        Shape::Ellipsoid => add(MeshRef::Sphere, placed.scaled(geom.size)),
        Shape::Cylinder => add(MeshRef::Cylinder, placed.scaled(geom.size)),
        Shape::Capsule => {
            let radius = (0.5 * f64::from(x + y)) as f32;
            let middle = placed.scaled(geom.size);
            add(MeshRef::OpenCylinder, middle);
            let above =
                middle.scaled([1.0, 1.0, radius / z]).translated([0.0, 0.0, (z - radius) / radius]);
            add(MeshRef::UpperHalf, above);
            let below = above.translated([0.0, 0.0, 2.0 * (radius - z) / radius]);
            add(MeshRef::LowerHalf, below);
        }
    }
}

/// Returns the sky: a cylinder around the camera, seen from inside.
pub(crate) fn sky(texture: usize, view: &View, model: &Model) -> Option<Instance> {
    // The factor is just below the reciprocal of √2, so that no corner is beyond the far plane.
    let size = (f64::from(view.far) * f64::from(0.70f32)) as f32;
    let placed = view.world_to_eye.translated(view.head).scaled([size; 3]);
    let mut sky = Instance::new(MeshRef::Cylinder, usize::MAX, placed, view, model)?;
    sky.counter_clockwise = false;
    sky.inside_out = true;
    sky.is_lit = false;
    sky.rank = u32::MAX;
    sky.texture = Some(texture);
    sky.mapping = Mapping::Sky;
    Some(sky)
}

impl Instance {
    /// Creates an instance; `None` if no part of the mesh can be visible.
    fn new(mesh: MeshRef, geom: usize, to_eye: Matrix, view: &View, model: &Model) -> Option<Self> {
        let bounds = mesh.resolve(model).bounds;
        let is_finite = to_eye.0.iter().all(|value| value.is_finite());
        if bounds.radius == 0.0 || !is_finite {
            return None;
        }
        // Mesa uses the identity as the inverse of a singular matrix.
        const IDENTITY: [f32; 9] = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];
        let inverse = to_eye.inverse_of_linear_part();
        let normals = inverse.unwrap_or(IDENTITY);
        let shift = [to_eye.0[12], to_eye.0[13], to_eye.0[14]];
        let back = |v: Vec3| -> Vec3 {
            std::array::from_fn(|row| {
                normals[3 * row] * v[0] + normals[3 * row + 1] * v[1] + normals[3 * row + 2] * v[2]
            })
        };
        // With a NaN eye, no triangle is culled.
        let eye = match (inverse, view.orthographic) {
            (None, _) => [f32::NAN; 3],
            (_, true) => back([0.0, 0.0, -1.0]),
            (_, false) => back(shift.map(|part| -part)),
        };
        let middle = to_eye.point(bounds.center);
        let columns = [0, 4, 8].map(|at| [to_eye.0[at], to_eye.0[at + 1], to_eye.0[at + 2]]);
        let widest = columns.map(|column| dot(column, column)).into_iter().fold(0.0, f32::max);
        Some(Self {
            mesh,
            geom,
            to_clip: view.projection.times(&to_eye),
            normals,
            eye,
            to_eye,
            counter_clockwise: true,
            inside_out: false,
            is_lit: true,
            rgba: [1.0; 4],
            emission: 0.0,
            specular: 0.0,
            shininess: 0.0,
            texture: None,
            mapping: Mapping::None,
            rank: 0,
            window: None,
            distance: dot(middle, middle).sqrt() + bounds.radius * widest.sqrt(),
        })
    }
}

pub(crate) fn is_plane(geom: &Geom) -> bool {
    matches!(geom.shape, Shape::Plane(_) | Shape::Rectangle)
}

/// Returns true if the camera is below the geom's xy plane.
pub(crate) fn is_behind(head: Vec3, geom: &Geom) -> bool {
    let offset = minus(head, geom.pos);
    offset[0] * geom.mat[2] + offset[1] * geom.mat[5] + offset[2] * geom.mat[8] < 0.0
}

fn mapping(geom: &Geom, used: &TextureUse, model: &Model) -> Mapping {
    let kind = model.textures[used.texture].kind;
    let has_own_size = matches!(geom.shape, Shape::Mesh(_) | Shape::Plane(_));
    match kind {
        TextureKind::Flat { .. } if used.by_corner => Mapping::Corners,
        TextureKind::Flat { .. } => {
            let mut scale = used.repeat;
            for (axis, scale) in scale.iter_mut().enumerate() {
                let size = geom.size[axis];
                if has_own_size && size > 0.0 {
                    *scale = (f64::from(*scale) / f64::from(size).max(1e-15)) as f32;
                }
                if used.uniform && size > 0.0 {
                    *scale *= size;
                }
            }
            Mapping::Flat([(0.5 * f64::from(scale[0])) as f32, (-0.5 * f64::from(scale[1])) as f32])
        }
        TextureKind::Cube => Mapping::Cube(if used.uniform { geom.size } else { [1.0; 3] }),
    }
}
