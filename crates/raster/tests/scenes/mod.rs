//! A test room with one object of every kind.

use std::sync::LazyLock;

use raster::{
    Camera, Corner, Geom, Light, LightKind, MeshBuilder, Model, Quality, Scene, Shadows, Shape,
    Texture, TextureKind, TextureUse, mesh_triangle, plane, plane_grid,
};

pub(crate) const UPRIGHT: [f32; 9] = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];

pub(crate) fn model() -> Model {
    let quality = Quality { slices: 12, stacks: 8, quads: 2 };
    let mut model = Model::new(quality).expect("shapes");
    let mut bumpy = MeshBuilder::default();
    let height = |x: i32, y: i32| ((x * 7 + y * 13) % 5) as f32 * 0.02;
    let at = |x: i32, y: i32| [x as f32 * 0.05, y as f32 * 0.05, height(x, y)];
    for x in -6..6 {
        for y in -6..6 {
            for three in [[(0, 0), (1, 0), (0, 1)], [(1, 0), (1, 1), (0, 1)]] {
                let pos = three.map(|(dx, dy)| at(x + dx, y + dy));
                let st = pos.map(|pos| [pos[0] * 3.0, pos[1] * 3.0]);
                bumpy.triangle(mesh_triangle(pos, [[0.0, 0.0, 1.0]; 3], Some(st)));
            }
        }
    }
    model.meshes.push(bumpy.build().into());
    let lines = plane_grid(2.0, 0.5, None, 10.0);
    model.planes.push(plane(&lines, &lines));
    for ((kind, width, height), bytes) in TEXTURES.into_iter().zip(largest_levels()) {
        let texture = Texture::new(kind, width, height, 3, bytes).expect("a texture");
        model.textures.push(texture.into());
    }
    model
}

const TEXTURES: [(TextureKind, usize, usize); 5] = [
    (TextureKind::Flat { srgb: false }, 32, 32),
    (TextureKind::Flat { srgb: false }, 21, 13),
    (TextureKind::Flat { srgb: true }, 24, 24),
    (TextureKind::Cube, 10, 10),
    (TextureKind::Cube, 8, 48),
];

pub(crate) fn largest_levels() -> Vec<&'static [u8]> {
    static BYTES: LazyLock<Vec<u8>> = LazyLock::new(|| {
        let byte = |byte: usize| (byte * 37 + byte / 7 * 11) as u8;
        (0..32 * 32 * 3).map(byte).collect()
    });
    let sizes = TEXTURES.iter().map(|(_, width, height)| width * height * 3);
    sizes.map(|size| &BYTES[..size]).collect()
}

pub(crate) fn geom(shape: Shape, pos: [f32; 3], size: [f32; 3], rgba: [f32; 4]) -> Geom {
    Geom {
        shape,
        size,
        pos,
        mat: UPRIGHT,
        rgba,
        emission: 0.0,
        specular: 0.5,
        shininess: 0.5,
        reflectance: 0.0,
        texture: None,
        reach: 0.0,
        segment: None,
    }
}

fn with_texture(mut geom: Geom, texture: usize, by_corner: bool) -> Geom {
    geom.texture =
        Some(TextureUse { texture, repeat: [2.0, 3.0], uniform: texture == 2, by_corner });
    geom
}

pub(crate) fn room() -> Scene {
    let white = [1.0, 1.0, 1.0, 1.0];
    let mut mirror = geom(Shape::Box, [0.3, 0.0, 0.1], [0.25, 0.3, 0.1], [0.4, 0.4, 0.5, 1.0]);
    mirror.reflectance = 0.4;
    let mut tilted =
        geom(Shape::Capsule, [-0.2, 0.3, 0.4], [0.08, 0.08, 0.2], [0.2, 0.7, 0.3, 1.0]);
    tilted.mat = [0.8, 0.0, 0.6, 0.0, 1.0, 0.0, -0.6, 0.0, 0.8];
    let mut dull = geom(Shape::Cylinder, [0.0, -0.5, 0.3], [0.1, 0.1, 0.3], [0.8, 0.3, 0.2, 1.0]);
    (dull.shininess, dull.specular, dull.emission) = (0.0, 0.3, 0.1);
    Scene {
        geoms: vec![
            with_texture(geom(Shape::Plane(0), [0.0; 3], [2.0, 2.0, 0.5], white), 2, false),
            mirror,
            tilted,
            dull,
            with_texture(geom(Shape::Mesh(0), [-0.4, -0.1, 0.3], [0.3; 3], white), 1, true),
            with_texture(geom(Shape::Box, [-0.5, 0.6, 0.2], [0.15, 0.1, 0.2], white), 3, false),
            with_texture(
                geom(Shape::Ellipsoid, [0.3, 0.1, 0.45], [0.1, 0.15, 0.2], white),
                0,
                false,
            ),
            with_texture(
                geom(Shape::Rectangle, [-1.0, 0.0, 0.5], [0.4, 0.4, 0.4], white),
                0,
                false,
            ),
            geom(Shape::Ellipsoid, [0.1, -0.2, 0.35], [0.2; 3], [0.3, 0.5, 1.0, 0.4]),
            geom(Shape::Box, [0.0, 0.3, 0.5], [0.05, 0.2, 0.2], [1.0, 0.6, 0.1, 0.6]),
        ],
        lights: vec![
            Light {
                kind: LightKind::Directional,
                pos: [0.0; 3],
                dir: [-0.6, 0.2, -0.77],
                ambient: [0.1; 3],
                diffuse: [0.4; 3],
                specular: [0.5; 3],
                casts_shadow: false,
            },
            Light {
                kind: LightKind::Spot {
                    cutoff: 45.0,
                    exponent: 10.0,
                    attenuation: [1.0, 0.1, 0.05],
                },
                pos: [0.5, 1.0, 2.0],
                dir: [-0.2, -0.4, -0.9],
                ambient: [0.0; 3],
                diffuse: [0.8, 0.7, 0.6],
                specular: [0.3; 3],
                casts_shadow: false,
            },
        ],
        camera: Camera {
            pos: [1.2, 0.2, 0.9],
            forward: [-0.8, -0.1, -0.6],
            up: [-0.6, 0.0, 0.8],
            center: 0.0,
            half_width: 0.0,
            bottom: -0.006,
            top: 0.006,
            near: 0.01,
            far: 50.0,
            orthographic: false,
        },
        sky: Some(4),
        reflections: true,
        shadows: None,
    }
}

pub(crate) fn corner(pos: [f32; 3]) -> Corner {
    Corner { pos, normal: [0.0, 0.0, 1.0], st: [0.0; 2] }
}

pub(crate) fn shadows(size: usize) -> Shadows {
    Shadows { size, half_width: 2.0, cone_share: 0.6 }
}
