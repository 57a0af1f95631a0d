//! Small scenes whose pixels were recorded from MuJoCo 3.3.7 through Mesa 22.3.6's
//! llvmpipe. Each scene tests one rule of rasterisation or texturing that changes whole pixels.

use std::ops::Range;

use raster::{Camera, Canvas, Geom, Scene, Shape, TextureUse};

use crate::scenes::{geom, largest, model};

/// Draws geoms on an empty background from above, orthographically and without lights. Returns red
/// of every pixel, row by row from the lowest. A pixel is one unit wide; the origin is the
/// picture's lower left corner.
fn red(side: usize, mut geoms: Vec<Geom>) -> Vec<Vec<u8>> {
    let middle = side as f32 / 2.0;
    for geom in &mut geoms {
        for along in &mut geom.pos[..2] {
            *along -= middle;
        }
        (geom.specular, geom.shininess, geom.emission) = (0.0, 0.0, 1.0);
    }
    let scene = Scene {
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
    };
    let mut canvas = Canvas::new();
    let frame = canvas
        .draw(&model(), &largest(), &scene, [side, side])
        .expect("a frame");
    let red: Vec<u8> = frame.chunks_exact(3).map(|pixel| pixel[0]).collect();
    red.chunks_exact(side).map(<[u8]>::to_vec).collect()
}

/// Returns a white box centred at x, y.
fn white_box(x: f32, y: f32, half: f32) -> Geom {
    geom(Shape::Box, [x, y, 0.0], [half, half, 0.5], [1.0; 4])
}

fn part(picture: &[Vec<u8>], x: Range<usize>, y: Range<usize>) -> Vec<Vec<u8>> {
    y.map(|y| picture[y][x.clone()].to_vec()).collect()
}

/// Mesa applies the top-left rule and takes the first row of a frame buffer object as the top row;
/// in MuJoCo, the first row is the lowest.
#[test]
fn samples_on_left_and_lower_edges_are_inside_and_those_on_other_edges_are_outside() {
    // The first box extends from 0.375 to 2.875 along both axes, the second from 4.875 to 7.375
    // along x and from 4.625 to 7.125 along y. Every edge lies on samples.
    let small = red(
        48,
        vec![white_box(1.625, 1.625, 1.25), white_box(6.125, 5.875, 1.25)],
    );
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
    let large = red(48, vec![white_box(21.625, 21.625, 21.25)]);
    let mut line = vec![255; 48];
    (line[0], line[42]) = (191, 191);
    line[43..].fill(0);
    assert_eq!(large[20], line);
    assert_eq!(large.iter().map(|row| row[20]).collect::<Vec<_>>(), line);
    assert_eq!(part(&large, 0..2, 0..2), [[128, 191], [191, 255]]);
    assert_eq!(part(&large, 42..44, 42..44), [[128, 0], [0, 0]]);
}

/// A flat texture has one level of detail per square of four pixels. A cube has one per pixel,
/// because its faces are chosen per pixel.
#[test]
fn every_pixel_of_a_cube_has_its_own_level_of_detail() {
    const CUBE: usize = 3;
    let size = [5.0, 4.0, 3.0];
    let mut ball = geom(Shape::Ellipsoid, [6.0, 6.0, 0.0], size, [1.0; 4]);
    ball.texture = Some(TextureUse {
        texture: CUBE,
        repeat: [1.0; 2],
        uniform: false,
        by_corner: false,
    });
    assert_eq!(
        part(&red(12, vec![ball]), 1..11, 2..10),
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
