//! Frames have the same bits on every machine, independent of earlier frames, and every
//! valid request gives a frame.

mod opengl;
mod scenes;

use proptest::prelude::*;
use raster::{Canvas, DrawError, MeshBuilder, Scene, Shape};
use scenes::{corner, largest_levels, model, room, shadows};
use sha2::{Digest, Sha256};

fn digest(frame: &[u8]) -> String {
    hex::encode(&Sha256::digest(frame)[..8])
}

/// First eight bytes of the SHA-256 of the room's frames, by size. The frames change only with
/// `raster::NAME`, not with the processor or with the instructions that the code is compiled for.
const GOLDEN: [(usize, usize, &str); 5] = [
    (256, 256, "4ba14bd951c34ccc"),
    (128, 96, "5c3164d02b0f20e6"),
    (333, 17, "0d99e039d3d2eebd"),
    (1, 1, "802e0f4cecd486c8"),
    (640, 480, "50eb2984acde7677"),
];

#[test]
fn golden_frames_have_the_same_bits_on_every_machine() {
    let (model, scene) = (model(), room());
    let found = GOLDEN.map(|(width, height, _)| {
        let mut canvas = Canvas::new();
        let frame =
            canvas.draw(&model, &largest_levels(), &scene, [width, height]).expect("a frame");
        (width, height, digest(&frame))
    });
    let expected = GOLDEN.map(|(width, height, digest)| (width, height, digest.to_owned()));
    assert_eq!(found, expected);
}

#[test]
fn every_part_of_the_room_changes_the_frame() {
    let model = model();
    let scene = room();
    let draw = |scene: &Scene| {
        Canvas::new().draw(&model, &largest_levels(), scene, [128, 128]).expect("a frame")
    };
    let whole = draw(&scene);
    for geom in 0..scene.geoms.len() {
        let mut without = scene.clone();
        without.geoms.remove(geom);
        assert_ne!(draw(&without), whole, "geom {geom} changes nothing");
    }
    for change in [
        |scene: &mut Scene| scene.reflections = false,
        |scene: &mut Scene| scene.sky = None,
        |scene: &mut Scene| scene.lights.truncate(1),
        |scene: &mut Scene| scene.lights.clear(),
        |scene: &mut Scene| scene.camera.orthographic = true,
        |scene: &mut Scene| {
            scene.shadows = Some(shadows(512));
            scene.lights[1].casts_shadow = true;
        },
    ] {
        let mut changed = scene.clone();
        change(&mut changed);
        assert_ne!(draw(&changed), whole);
    }
}

#[derive(Debug, Clone)]
enum Change {
    Move(usize, [i8; 3]),
    SetOpacity(usize, u8),
    TurnCamera([i8; 3]),
    SetDiffuse(u8),
    CastShadow(bool),
    Rest,
}

fn change() -> impl Strategy<Value = Change> {
    prop_oneof![
        4 => (0..10usize, any::<[i8; 3]>()).prop_map(|(geom, by)| Change::Move(geom, by)),
        1 => (0..10usize, any::<u8>()).prop_map(|(geom, to)| Change::SetOpacity(geom, to)),
        1 => any::<[i8; 3]>().prop_map(Change::TurnCamera),
        1 => any::<u8>().prop_map(Change::SetDiffuse),
        1 => any::<bool>().prop_map(Change::CastShadow),
        4 => Just(Change::Rest),
    ]
}

impl Change {
    fn apply(&self, scene: &mut Scene) {
        let moved = |place: [f32; 3], by: [i8; 3]| -> [f32; 3] {
            std::array::from_fn(|axis| place[axis] + f32::from(by[axis]) * 1e-3)
        };
        match *self {
            Self::Move(geom, by) => scene.geoms[geom].pos = moved(scene.geoms[geom].pos, by),
            Self::SetOpacity(geom, to) => scene.geoms[geom].rgba[3] = f32::from(to) / 255.0,
            Self::TurnCamera(by) => scene.camera.forward = moved(scene.camera.forward, by),
            Self::SetDiffuse(to) => scene.lights[1].diffuse = [f32::from(to) / 255.0; 3],
            Self::CastShadow(casts) => {
                scene.lights[1].casts_shadow = casts;
                scene.shadows = Some(shadows(256));
            }
            Self::Rest => {}
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn frames_do_not_depend_on_earlier_frames(changes in prop::collection::vec(change(), 1..24)) {
        let model = model();
        let mut scene = room();
        let mut canvas = Canvas::new();
        for (frame, change) in changes.iter().enumerate() {
            change.apply(&mut scene);
            let mut new_canvas = Canvas::new();
            let levels = largest_levels();
            let expected = new_canvas.draw(&model, &levels, &scene, [64, 48]).expect("a frame");
            let drawn = canvas.draw(&model, &levels, &scene, [64, 48]).expect("a frame");
            prop_assert!(drawn == expected, "frame {frame} after {changes:?}");
        }
    }

    #[test]
    fn every_scene_gives_a_frame_or_an_error(
        numbers in prop::collection::vec(any::<f32>(), 64),
        bounded_numbers in prop::collection::vec(-2.0f32..2.0, 64),
        shapes in prop::collection::vec(0..7usize, 6),
        is_unbounded in any::<bool>(),
        has_shadows in any::<bool>(),
        size in (prop_oneof![1..40usize, Just(0), Just(4097)], 1..40usize),
    ) {
        let mut model = model();
        let numbers = if is_unbounded { numbers } else { bounded_numbers };
        let mut next = numbers.iter().copied().cycle();
        let mut number = || next.next().expect("endless");
        let mut builder = MeshBuilder::default();
        for _ in 0..20 {
            builder.triangle(std::array::from_fn(|_| corner(std::array::from_fn(|_| number()))));
        }
        model.meshes.push(builder.build().into());
        let mut scene = room();
        for shape in shapes {
            let mut geom = scene.geoms[shape];
            geom.shape = [
                Shape::Mesh(1), Shape::Plane(0), Shape::Rectangle, Shape::Box,
                Shape::Ellipsoid, Shape::Cylinder, Shape::Capsule,
            ][shape];
            geom.pos = std::array::from_fn(|_| number());
            geom.size = std::array::from_fn(|_| number());
            geom.mat = std::array::from_fn(|_| number());
            geom.rgba = std::array::from_fn(|_| number());
            geom.reflectance = number();
            geom.shininess = number();
            scene.geoms.push(geom);
        }
        for light in &mut scene.lights {
            light.pos = std::array::from_fn(|_| number());
            light.dir = std::array::from_fn(|_| number());
            light.diffuse = std::array::from_fn(|_| number());
            light.casts_shadow = has_shadows;
        }
        scene.shadows = Some(shadows(64));
        if is_unbounded {
            scene.camera.pos = std::array::from_fn(|_| number());
            scene.camera.forward = std::array::from_fn(|_| number());
        }
        let (width, height) = size;
        match Canvas::new().draw(&model, &largest_levels(), &scene, [width, height]) {
            Ok(frame) => prop_assert_eq!(frame.len(), width * height * 3),
            Err(error) => prop_assert!(!error.to_string().is_empty()),
        }
    }
}

#[test]
fn a_scene_that_cannot_be_drawn_is_refused_with_the_reason() {
    let model = model();
    let draw = |change: &dyn Fn(&mut Scene), width: usize| {
        let mut scene = room();
        change(&mut scene);
        let mut canvas = Canvas::new();
        canvas.draw(&model, &largest_levels(), &scene, [width, 8]).map(|frame| frame.len())
    };
    assert_eq!(draw(&|_| {}, 0), Err(DrawError::Size { width: 0, height: 8 }));
    assert_eq!(draw(&|_| {}, 4097), Err(DrawError::Size { width: 4097, height: 8 }));
    assert_eq!(draw(&|_| {}, 4096), Ok(4096 * 8 * 3));
    for (what, change) in [
        ("near plane", (|scene: &mut Scene| scene.camera.near = 0.0) as fn(&mut Scene)),
        ("far plane", |scene: &mut Scene| scene.camera.far = 0.001),
        ("height", |scene: &mut Scene| scene.camera.top = scene.camera.bottom),
        ("pose", |scene: &mut Scene| scene.camera.pos[1] = f32::NAN),
        ("mesh 7", |scene: &mut Scene| scene.geoms[0].shape = Shape::Mesh(7)),
        ("the sky names texture 9", |scene: &mut Scene| scene.sky = Some(9)),
        ("shadow maps of 2 × 2", |scene: &mut Scene| scene.shadows = Some(shadows(2))),
    ] {
        let error = draw(&change, 8).expect_err(what).to_string();
        assert!(error.contains(what), "{error}");
    }
    let empty = |scene: &mut Scene| {
        scene.geoms.clear();
        scene.lights.clear();
        scene.sky = None;
    };
    assert_eq!(draw(&empty, 8), Ok(8 * 8 * 3));
}

/// Draws each scene often enough to be cached.
fn assert_equal_to_new_canvases(scenes: &[Scene], size: [usize; 2]) {
    let model = model();
    let mut canvas = Canvas::new();
    for (number, scene) in scenes.iter().enumerate() {
        let mut new_canvas = Canvas::new();
        let expected = new_canvas.draw(&model, &largest_levels(), scene, size).expect("a frame");
        for repetition in 0..4 {
            let drawn = canvas.draw(&model, &largest_levels(), scene, size).expect("a frame");
            assert!(drawn == expected, "scene {number}, repetition {repetition}");
        }
    }
}

/// A kept frame is outdated if another thread drew the canvas last.
#[test]
fn canvases_that_take_turns_on_two_threads_draw_the_same_as_new_canvases() {
    let model = model();
    let moved = |step: u16, ball: f32| {
        let mut scene = room();
        scene.geoms[6].pos[0] += ball + 0.01 * f32::from(step);
        scene
    };
    let mut canvases: [(f32, Canvas); 4] = [0.0, 0.1, 0.2, 0.3].map(|ball| (ball, Canvas::new()));
    for step in 0..12 {
        for (at, (ball, canvas)) in canvases.iter_mut().enumerate() {
            let scene = moved(step / 5, *ball);
            let expected =
                Canvas::new().draw(&model, &largest_levels(), &scene, [64, 48]).expect("a frame");
            let mut draw = || canvas.draw(&model, &largest_levels(), &scene, [64, 48]);
            let drawn = match (at + usize::from(step)).is_multiple_of(3) {
                true => std::thread::scope(|scope| scope.spawn(draw).join().expect("no panic")),
                false => draw(),
            };
            assert!(drawn == Ok(expected), "canvas {at}, step {step}");
        }
    }
}

/// Zeros of both signs compare as equal, but their reciprocals do not.
#[test]
fn zeros_of_both_signs_are_distinguished() {
    let with_attenuation = |zero: f32| {
        let mut scene = room();
        scene.lights[1].kind =
            raster::LightKind::Spot { cutoff: 180.0, exponent: 0.0, attenuation: [zero; 3] };
        scene.lights[1].ambient = [0.1; 3];
        scene
    };
    assert_equal_to_new_canvases(&[with_attenuation(0.0), with_attenuation(-0.0)], [32, 32]);
}

/// The expected digest belongs to a frame whose layers were all blended at once.
#[test]
fn translucent_geoms_blended_in_parts_give_the_same_frame() {
    let mut builder = MeshBuilder::default();
    for layer in 0..1500 {
        let z = layer as f32 * 1e-3;
        builder.quad([[-9.0, -9.0, z], [9.0, -9.0, z], [9.0, 9.0, z], [-9.0, 9.0, z]].map(corner));
    }
    let mut model = model();
    model.meshes.push(builder.build().into());
    let mut scene = room();
    let glass = scenes::geom(Shape::Mesh(1), [0.0, 0.0, -2.0], [1.0; 3], [0.2, 0.4, 0.6, 0.01]);
    scene.geoms = vec![glass];
    let mut canvas = Canvas::new();
    let frame = canvas.draw(&model, &largest_levels(), &scene, [96, 64]).expect("a frame");
    assert_eq!(digest(&frame), "b3803dc6681de13b");
}

/// The reciprocal of the corners' distance overflows, so their position becomes NaN.
#[test]
fn corners_very_close_to_the_eye_give_a_frame() {
    let mut builder = MeshBuilder::default();
    let near = 1e-40;
    for [x, y] in [[0.1, 0.05], [-0.1, 0.05], [0.05, -0.1], [0.1, 0.1]] {
        let tip = [x * near, y * near, -near];
        let far = [[-1.0, 0.8, -2.0], [-1.0, -0.9, -2.0], [1.0, 0.7, -2.0]];
        builder.triangle([tip, far[0], far[1]].map(corner));
        builder.triangle([tip, far[1], far[2]].map(corner));
        builder.triangle([tip, far[2], far[0]].map(corner));
    }
    let mut model = model();
    model.meshes.push(builder.build().into());
    let mut scene = room();
    scene.geoms = vec![scenes::geom(Shape::Mesh(1), [0.0; 3], [1.0; 3], [1.0; 4])];
    let camera = &mut scene.camera;
    (camera.pos, camera.forward, camera.up) = ([0.0; 3], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]);
    (camera.near, camera.bottom, camera.top) = (near, -near, near);
    let mut canvas = Canvas::new();
    let frame = canvas.draw(&model, &largest_levels(), &scene, [256, 256]);
    assert_eq!(frame.map(|frame| frame.len()), Ok(256 * 256 * 3));
}

/// Directions whose reciprocal length is not finite hit no face of a cube.
#[test]
fn a_cube_sampled_in_very_short_directions_gives_a_frame() {
    let mut scene = room();
    let ball = &mut scene.geoms[6];
    ball.size = [1e-39; 3];
    ball.mat = scenes::UPRIGHT.map(|part| part * 3e38);
    let texture = ball.texture.as_mut().expect("a texture");
    (texture.texture, texture.uniform) = (3, true);
    let mut canvas = Canvas::new();
    let frame = canvas.draw(&model(), &largest_levels(), &scene, [64, 48]);
    assert_eq!(frame.map(|frame| frame.len()), Ok(64 * 48 * 3));
}
