//! What is drawn: things with poses and materials, lights, and a camera, as
//! MuJoCo's abstract scene (`mjvScene`) has them for one frame. Lengths are
//! metres; orientations are matrices, row by row; colours are 0 to 1.

/// What a thing is shaped like. Meshes, planes and textures are named by their
/// place in the [`Model`](crate::Model).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Shape {
    /// A mesh, as large as it is.
    Mesh(usize),
    /// A plane with a grid of its own, as large as it is.
    Plane(usize),
    /// A rectangle of half extents x, y.
    Rectangle,
    /// Of half extents x, y, z.
    Box,
    /// Of half axes x, y, z.
    Ellipsoid,
    /// Of radii x, y and half length z.
    Cylinder,
    /// Of radii x, y and half length z, half spheres beyond it.
    Capsule,
}

/// A texture on a thing.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TextureUse {
    /// Which one.
    pub texture: usize,
    /// How often a flat one repeats along x and y.
    pub repeat: [f32; 2],
    /// Whether it repeats by metres rather than by the thing's size.
    pub uniform: bool,
    /// Whether the mesh says where each corner lies on a flat one.
    pub by_corner: bool,
}

/// A thing.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Geom {
    /// What it is shaped like.
    pub shape: Shape,
    /// Half extents; see [`Shape`].
    pub size: [f32; 3],
    /// Where its centre is, world frame.
    pub pos: [f32; 3],
    /// How it is turned.
    pub mat: [f32; 9],
    /// Colour and opacity.
    pub rgba: [f32; 4],
    /// Share of the colour that it glows with.
    pub emission: f32,
    /// Share of white that it reflects as highlights.
    pub specular: f32,
    /// How small highlights are, 0 to 1.
    pub shininess: f32,
    /// Share of the surroundings that a plane or a box's upper face mirrors.
    pub reflectance: f32,
    /// What is on it.
    pub texture: Option<TextureUse>,
    /// Radius of a ball around it, by which see-through things are ordered; 0
    /// where its shape says.
    pub reach: f32,
    /// Its number in segmentation images; none leaves it out of them.
    pub segment: Option<u32>,
}

/// How a light shines.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum LightKind {
    /// From infinitely far away.
    Directional,
    /// From a point, in a cone.
    Spot {
        /// Half the cone's angle, degrees; 180 shines everywhere.
        cutoff: f32,
        /// How much darker it is off the axis.
        exponent: f32,
        /// Constant, linear and quadratic attenuation with distance.
        attenuation: [f32; 3],
    },
}

/// A light. None casts shadows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Light {
    /// How it shines.
    pub kind: LightKind,
    /// Where it is, world frame.
    pub pos: [f32; 3],
    /// Where it shines to, world frame.
    pub dir: [f32; 3],
    /// Light that reaches every face.
    pub ambient: [f32; 3],
    /// Light that faces reflect in all directions.
    pub diffuse: [f32; 3],
    /// Light that faces reflect as highlights.
    pub specular: [f32; 3],
}

/// A camera.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Camera {
    /// Where it is, world frame.
    pub pos: [f32; 3],
    /// Where it looks to, world frame.
    pub forward: [f32; 3],
    /// What is above, world frame.
    pub up: [f32; 3],
    /// The near plane's rectangle: centre and half width; half the width that
    /// the picture's proportions give where it is 0.
    pub center: f32,
    /// See `center`.
    pub half_width: f32,
    /// Lower and upper end of the near plane's rectangle.
    pub bottom: f32,
    /// See `bottom`.
    pub top: f32,
    /// Distance of the near plane.
    pub near: f32,
    /// Distance of the far plane.
    pub far: f32,
    /// Whether it sees without perspective.
    pub orthographic: bool,
}

/// All that is drawn in one frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Scene {
    /// In the order in which they are drawn.
    pub geoms: Vec<Geom>,
    /// At most eight count.
    pub lights: Vec<Light>,
    /// The camera.
    pub camera: Camera,
    /// The texture around everything, if there is one.
    pub sky: Option<usize>,
    /// Whether mirrors mirror.
    pub reflections: bool,
}
