//! Small scenes whose pixels were recorded from MuJoCo 3.3.7 through Mesa 22.3.6's
//! llvmpipe. Each scene tests one rule of rasterisation or texturing that changes whole pixels.

use std::ops::Range;

use raster::{Camera, Canvas, Geom, Light, LightKind, Scene, Shadows, Shape, TextureUse};

use crate::scenes::{geom, largest_levels, model};

/// Scene seen orthographically, without lights; a pixel is one unit, the origin in the middle.
fn from_above(side: usize, geoms: Vec<Geom>) -> Scene {
    let middle = side as f32 / 2.0;
    Scene {
        geoms,
        lights: Vec::new(),
        camera: Camera {
            pos: [0.0, 0.0, 8.0],
            forward: [0.0, 0.0, -1.0],
            up: [0.0, 1.0, 0.0],
            center: 0.0,
            half_width: 0.0,
            bottom: -middle,
            top: middle,
            near: 4.0,
            far: 32.0,
            orthographic: true,
        },
        sky: None,
        reflections: false,
        shadows: None,
    }
}

/// Draws a scene. Returns red of every pixel, row by row from the lowest.
fn red(side: usize, scene: &Scene) -> Vec<Vec<u8>> {
    let mut canvas = Canvas::new();
    let frame = canvas.draw(&model(), &largest_levels(), scene, [side, side]).expect("a frame");
    let red: Vec<u8> = frame.chunks_exact(3).map(|pixel| pixel[0]).collect();
    red.chunks_exact(side).map(<[u8]>::to_vec).collect()
}

/// Draws glowing geoms without lights. The origin is the picture's lower left corner.
fn red_of_glowing(side: usize, mut geoms: Vec<Geom>) -> Vec<Vec<u8>> {
    let middle = side as f32 / 2.0;
    for geom in &mut geoms {
        for along in &mut geom.pos[..2] {
            *along -= middle;
        }
        (geom.specular, geom.shininess, geom.emission) = (0.0, 0.0, 1.0);
    }
    red(side, &from_above(side, geoms))
}

fn white_box(x: f32, y: f32, half: f32) -> Geom {
    geom(Shape::Box, [x, y, 0.0], [half, half, 0.5], [1.0; 4])
}

fn part(picture: &[Vec<u8>], x: Range<usize>, y: Range<usize>) -> Vec<Vec<u8>> {
    y.map(|y| picture[y][x.clone()].to_vec()).collect()
}

/// Mesa applies the top-left rule and takes the first row of a frame buffer object as the top row;
/// in MuJoCo, the first row is the lowest.
#[test]
fn samples_on_left_and_lower_edges_are_inside_and_samples_on_other_edges_are_outside() {
    // Every edge lies on samples: from 0.375 to 2.875, from 4.875 to 7.375 and from 4.625 to 7.125.
    let small =
        red_of_glowing(48, vec![white_box(1.625, 1.625, 1.25), white_box(6.125, 5.875, 1.25)]);
    assert_eq!(
        part(&small, 0..8, 0..8),
        [
            [128, 191, 128, 0, 0, 0, 0, 0],
            [191, 255, 191, 0, 0, 0, 0, 0],
            [128, 191, 128, 0, 0, 0, 0, 0],
            [0, 0, 0, 0, 0, 0, 0, 0],
            [0, 0, 0, 0, 0, 128, 128, 64],
            [0, 0, 0, 0, 64, 255, 255, 64],
            [0, 0, 0, 0, 64, 255, 255, 64],
            [0, 0, 0, 0, 0, 0, 0, 0],
        ]
    );
    // The box extends from 0.375 to 42.875. Large triangles are filled block by block.
    let large = red_of_glowing(48, vec![white_box(21.625, 21.625, 21.25)]);
    let mut line = vec![255; 48];
    (line[0], line[42]) = (191, 191);
    line[43..].fill(0);
    assert_eq!(large[20], line);
    assert_eq!(large.iter().map(|row| row[20]).collect::<Vec<_>>(), line);
    assert_eq!(part(&large, 0..2, 0..2), [[128, 191], [191, 255]]);
    assert_eq!(part(&large, 42..44, 42..44), [[128, 0], [0, 0]]);
}

/// A flat texture has one per square of four pixels; a cube's faces are chosen per pixel.
#[test]
fn every_pixel_of_a_cube_has_its_own_level_of_detail() {
    const CUBE: usize = 3;
    let size = [5.0, 4.0, 3.0];
    let mut ball = geom(Shape::Ellipsoid, [6.0, 6.0, 0.0], size, [1.0; 4]);
    ball.texture =
        Some(TextureUse { texture: CUBE, repeat: [1.0; 2], uniform: false, by_corner: false });
    assert_eq!(
        part(&red_of_glowing(12, vec![ball]), 1..11, 2..10),
        [
            [0, 0, 32, 102, 106, 129, 61, 63, 0, 0],
            [0, 65, 133, 115, 133, 147, 132, 119, 46, 0],
            [63, 125, 101, 136, 157, 161, 143, 128, 109, 34],
            [99, 111, 104, 190, 136, 180, 121, 121, 113, 102],
            [94, 113, 130, 152, 184, 118, 153, 115, 106, 118],
            [32, 112, 116, 163, 154, 137, 124, 105, 116, 64],
            [0, 53, 120, 134, 136, 128, 121, 132, 68, 0],
            [0, 0, 64, 63, 131, 108, 98, 32, 0, 0],
        ]
    );
}

/// The directional light's shadow is short and to the right, the spot light's below the floating
/// box. Every texel of the coarse maps shows.
#[test]
fn shadows_have_the_texels_of_the_lights_maps() {
    let light = |kind, dir, pos, diffuse| Light {
        kind,
        pos,
        dir,
        ambient: [0.0; 3],
        diffuse: [diffuse; 3],
        specular: [0.0; 3],
        casts_shadow: true,
    };
    let spot = LightKind::Spot { cutoff: 45.0, exponent: 0.0, attenuation: [1.0, 0.0, 0.0] };
    let mut scene = from_above(
        16,
        vec![
            geom(Shape::Box, [0.0; 3], [7.0, 7.0, 0.5], [1.0; 4]),
            geom(Shape::Box, [-2.0, -1.0, 3.0], [2.0, 1.5, 0.5], [1.0; 4]),
        ],
    );
    scene.lights = vec![
        light(
            LightKind::Directional,
            [0.498_272_87, 0.249_136_43, -0.830_454_8],
            [0.0, 0.0, 8.0],
            0.5,
        ),
        light(spot, [0.099_503_72, 0.0, -0.995_037_2], [-2.0, 0.0, 12.0], 0.3),
    ];
    scene.shadows = Some(Shadows { size: 24, half_width: 12.0, cone_share: 0.6 });
    assert_eq!(
        part(&red(16, &scene), 1..15, 1..15),
        [
            [168, 169, 169, 170, 170, 171, 171, 171, 169, 168, 166, 165, 163, 162],
            [169, 170, 170, 171, 171, 172, 173, 172, 171, 169, 168, 166, 165, 163],
            [171, 171, 172, 172, 173, 173, 174, 174, 172, 171, 169, 168, 166, 164],
            [172, 172, 173, 173, 174, 175, 176, 175, 174, 172, 171, 169, 167, 164],
            [173, 174, 174, 142, 143, 143, 142, 106, 175, 174, 172, 170, 167, 165],
            [174, 175, 176, 180, 181, 181, 180, 106, 177, 175, 173, 170, 168, 166],
            [176, 177, 177, 181, 182, 182, 181, 106, 72, 176, 173, 171, 169, 167],
            [176, 177, 177, 180, 180, 181, 180, 180, 71, 175, 173, 171, 169, 167],
            [175, 175, 176, 177, 178, 178, 179, 178, 176, 174, 172, 169, 167, 166],
            [173, 174, 175, 176, 176, 177, 177, 176, 174, 172, 170, 168, 166, 165],
            [172, 173, 174, 174, 175, 175, 176, 175, 173, 171, 168, 167, 165, 164],
            [171, 172, 172, 173, 173, 174, 174, 173, 171, 169, 168, 166, 165, 163],
            [170, 170, 171, 171, 172, 172, 173, 172, 170, 168, 167, 165, 164, 162],
            [168, 169, 169, 170, 170, 171, 171, 170, 169, 167, 166, 164, 163, 161],
        ]
    );
}
