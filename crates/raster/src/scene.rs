//! Scene description: geoms with poses and materials, lights, and a camera, as in
//! MuJoCo's abstract scene (`mjvScene`) for one frame. Lengths are metres; orientations
//! are row-major rotation matrices; colours are 0 to 1.

/// Largest number of lights in OpenGL.
pub(crate) const MAX_LIGHTS: usize = 8;

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
    /// Cylinder of radii x, y and half length z, with a half sphere added at each end.
    Capsule,
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TextureUse {
    pub texture: usize,
    /// Repeats of a flat texture along x and y.
    pub repeat: [f32; 2],
    /// True if `repeat` is per metre rather than per geom.
    pub uniform: bool,
    /// True if the mesh's corners hold the texture coordinates.
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
    pub texture: Option<TextureUse>,
    /// Radius of the bounding sphere by which translucent geoms are sorted; 0 derives it from the
    /// shape.
    pub reach: f32,
    /// Id in segmentation images; `None` leaves the geom out of them.
    pub segment: Option<u32>,
}

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

#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Light {
    pub kind: LightKind,
    /// Position, world frame.
    pub pos: [f32; 3],
    /// Direction of the light, world frame.
    pub dir: [f32; 3],
    pub ambient: [f32; 3],
    pub diffuse: [f32; 3],
    pub specular: [f32; 3],
    /// True if opaque geoms are lit only where no geom lies between them and the light; see
    /// [`Scene::shadows`].
    pub casts_shadow: bool,
}

/// Quality of shadows, which are drawn from a square depth map of each light that casts them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Shadows {
    /// Side of the map, texels.
    pub size: usize,
    /// Half the side of the square that a directional light's map covers, metres.
    pub half_width: f32,
    /// Share of a spot light's cone that its map covers.
    pub cone_share: f32,
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Camera {
    /// Position, world frame.
    pub pos: [f32; 3],
    /// Viewing direction, world frame.
    pub forward: [f32; 3],
    /// Up direction, world frame.
    pub up: [f32; 3],
    /// Horizontal centre of the near plane's rectangle.
    pub center: f32,
    /// Half the width of the near plane's rectangle; 0 derives it from the picture's aspect ratio.
    pub half_width: f32,
    /// Lower end of the near plane's rectangle.
    pub bottom: f32,
    /// Upper end of the near plane's rectangle.
    pub top: f32,
    pub near: f32,
    pub far: f32,
    pub orthographic: bool,
}

/// Complete description of a frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Scene {
    /// Geoms, in drawing order.
    pub geoms: Vec<Geom>,
    /// Lights; only the first eight are used.
    pub lights: Vec<Light>,
    pub camera: Camera,
    /// Index of the sky texture, if there is one.
    pub sky: Option<usize>,
    /// True if mirrors are rendered.
    pub reflections: bool,
    /// Quality of shadows; if `None`, no light casts shadows.
    pub shadows: Option<Shadows>,
}

impl Scene {
    /// Returns true for each light, up to OpenGL's limit, that casts shadows.
    pub(crate) fn casting_lights(&self) -> Vec<bool> {
        let lights = self.lights.iter().take(MAX_LIGHTS);
        let has_shadows = self.shadows.is_some();
        lights.map(|light| has_shadows && light.casts_shadow).collect()
    }
}
