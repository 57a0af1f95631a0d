//! Scene description: geoms with poses and materials, lights, and a camera, as in
//! MuJoCo's abstract scene (`mjvScene`) for one frame. Lengths are metres; orientations
//! are row-major rotation matrices; colours are 0 to 1.

/// Shape of a geom. Meshes, planes and textures are referred to by their index in the
/// [`Model`](crate::Model).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Shape {
    /// Mesh with this index, at its own size.
    Mesh(usize),
    /// Plane grid with this index, at its own size.
    Plane(usize),
    /// Rectangle of half extents x, y.
    Rectangle,
    /// Box of half extents x, y, z.
    Box,
    /// Ellipsoid of half axes x, y, z.
    Ellipsoid,
    /// Cylinder of radii x, y and half length z.
    Cylinder,
    /// Capsule of radii x, y and half length z, half spheres beyond it.
    Capsule,
}

/// Texture on a geom.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TextureUse {
    /// Index of the texture in the model.
    pub texture: usize,
    /// Repeats of a flat texture along x and y.
    pub repeat: [f32; 2],
    /// True if it repeats by metres rather than by the geom's size.
    pub uniform: bool,
    /// True if the mesh's corners hold the coordinates on a flat texture.
    pub by_corner: bool,
}

/// Drawable object with pose and material.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Geom {
    /// Shape of the geom.
    pub shape: Shape,
    /// Half extents; see [`Shape`].
    pub size: [f32; 3],
    /// Position of the centre, world frame.
    pub pos: [f32; 3],
    /// Orientation in the world frame.
    pub mat: [f32; 9],
    /// Colour and opacity.
    pub rgba: [f32; 4],
    /// Share of the colour that is emitted.
    pub emission: f32,
    /// Share of white that is reflected as highlights.
    pub specular: f32,
    /// Sharpness of highlights, 0 to 1.
    pub shininess: f32,
    /// Share of the surroundings that a plane or a box's upper face mirrors.
    pub reflectance: f32,
    /// Texture of the surface.
    pub texture: Option<TextureUse>,
    /// Radius of the bounding ball by which translucent geoms are ordered; 0 takes it
    /// from the shape.
    pub reach: f32,
    /// Number in segmentation images; `None` leaves the geom out of them.
    pub segment: Option<u32>,
}

/// Kind of a light.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum LightKind {
    /// Light from infinitely far away.
    Directional,
    /// Light from a point, in a cone.
    Spot {
        /// Half the cone's angle, degrees; 180 shines everywhere.
        cutoff: f32,
        /// Exponent of the darkening off the axis.
        exponent: f32,
        /// Constant, linear and quadratic attenuation with distance.
        attenuation: [f32; 3],
    },
}

/// A light. None casts shadows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Light {
    /// Kind of the light.
    pub kind: LightKind,
    /// Position, world frame.
    pub pos: [f32; 3],
    /// Direction of the light, world frame.
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
    /// Position, world frame.
    pub pos: [f32; 3],
    /// Viewing direction, world frame.
    pub forward: [f32; 3],
    /// Up direction, world frame.
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
    /// True for a camera without perspective.
    pub orthographic: bool,
}

/// Everything that is drawn in one frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Scene {
    /// Geoms, in drawing order.
    pub geoms: Vec<Geom>,
    /// Lights, of which the first eight count.
    pub lights: Vec<Light>,
    /// The camera.
    pub camera: Camera,
    /// Index of the sky texture, if there is one.
    pub sky: Option<usize>,
    /// True if mirrors reflect.
    pub reflections: bool,
}
