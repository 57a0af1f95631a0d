//! Rendering of arbitrary models, scenes and cameras.
//!
//! An input is a [`script`] of model data, scene data and draw commands.

use raster::{
    Camera, Canvas, Corner, Geom, Light, LightKind, Mesh, MeshBuilder, Model, Quality, Scene,
    Shadows, Shape, Texture, TextureKind, TextureUse, mesh_triangle, plane, plane_grid,
};

use crate::untrusted_input::script;

/// Kinds of messages; the method number of a script's call selects one.
const QUALITY: u8 = 0;
const MESH: u8 = 1;
const PLANE: u8 = 2;
const TEXTURE: u8 = 3;
const GEOM: u8 = 4;
const LIGHTS: u8 = 5;
const CAMERA: u8 = 6;
const SURROUNDINGS: u8 = 7;
const DRAW: u8 = 8;

/// Most pixels of a frame, so that an input takes milliseconds.
const MOST_PIXELS: usize = 1 << 12;
/// Most bytes of a texture that its sizes require; an input may add up to 255 surplus bytes.
const MOST_TEXTURE_BYTES: usize = 1 << 16;
/// Most lights of a scene, of which the renderer uses eight.
const MOST_LIGHTS: usize = 20;
const MOST_TRIANGLES: usize = 1 << 11;
const MOST_FRAMES: usize = 8;

/// Checks that every scene gives either an error or a frame of the requested size, and that the
/// frame does not depend on what the canvas drew before. Returns true if the renderer refused
/// nothing.
pub(crate) fn draw(input: &[u8]) -> bool {
    let calls = script::read(input);
    let messages = || {
        calls.iter().flat_map(|call| {
            let bytes = call.messages.iter();
            bytes.map(|bytes| (call.method, Bytes(bytes)))
        })
    };
    let quality = messages().find(|(kind, _)| *kind == QUALITY);
    let mut bytes = quality.map_or(Bytes(&[]), |(_, bytes)| bytes);
    let Some(mut drawing) = Drawing::new(bytes.quality()) else {
        return false;
    };
    // All model data is applied first, since the model is the same for all frames.
    for (kind, bytes) in messages() {
        drawing.add_to_model(kind, bytes);
    }
    for (kind, bytes) in messages() {
        drawing.run_command(kind, bytes);
    }
    !drawing.is_refused
}

struct Drawing {
    model: Model,
    /// For each texture: the bytes of its largest mipmap level.
    largest_levels: Vec<Vec<u8>>,
    scene: Scene,
    canvas: Canvas,
    frames: usize,
    is_refused: bool,
}

impl Drawing {
    fn new(quality: Quality) -> Option<Self> {
        Some(Self {
            model: Model::new(quality).ok()?,
            largest_levels: Vec::new(),
            scene: Scene {
                geoms: Vec::new(),
                lights: Vec::new(),
                camera: DEFAULT_CAMERA,
                sky: None,
                reflections: true,
                shadows: None,
            },
            canvas: Canvas::new(),
            frames: 0,
            is_refused: false,
        })
    }

    fn add_to_model(&mut self, kind: u8, mut bytes: Bytes<'_>) {
        match kind {
            MESH => self.model.meshes.push(bytes.mesh().into()),
            PLANE => {
                let [xs, ys] = [bytes.grid(), bytes.grid()];
                self.model.planes.push(plane(&xs, &ys));
            }
            TEXTURE => {
                let (kind, width, height, channels, texels) = bytes.texture();
                match Texture::new(kind, width, height, channels, &texels) {
                    Ok(texture) => {
                        self.model.textures.push(texture.into());
                        self.largest_levels.push(texels);
                    }
                    Err(error) => {
                        assert!(!error.to_string().is_empty());
                        self.is_refused = true;
                    }
                }
            }
            _ => {}
        }
    }

    fn run_command(&mut self, kind: u8, mut bytes: Bytes<'_>) {
        match kind {
            GEOM => {
                let at = usize::from(bytes.byte());
                let geom = bytes.geom();
                match self.scene.geoms.get_mut(at) {
                    Some(existing) => *existing = geom,
                    None => self.scene.geoms.push(geom),
                }
            }
            LIGHTS => {
                self.scene.lights.clear();
                while !bytes.0.is_empty() && self.scene.lights.len() < MOST_LIGHTS {
                    self.scene.lights.push(bytes.light());
                }
            }
            CAMERA => self.scene.camera = bytes.camera(),
            SURROUNDINGS => {
                let flags = bytes.byte();
                self.scene.reflections = flags & 1 == 0;
                self.scene.sky = bytes.index();
                self.scene.shadows = (flags & 2 != 0).then(|| bytes.shadows());
            }
            DRAW => {
                let size = bytes.frame_size();
                for _ in 0..=bytes.byte() % 4 {
                    if self.frames < MOST_FRAMES {
                        self.frames += 1;
                        self.draw(size);
                    }
                }
            }
            _ => {}
        }
    }

    /// Draws on the reused canvas and on a new canvas, and compares the frames.
    fn draw(&mut self, [width, height]: [usize; 2]) {
        let levels: Vec<&[u8]> = self.largest_levels.iter().map(Vec::as_slice).collect();
        let mut fresh = Canvas::new();
        let redrawn = fresh.draw(&self.model, &levels, &self.scene, [width, height]);
        let size = [width, height];
        let drawn = self.canvas.draw(&self.model, &levels, &self.scene, size);
        match (drawn, redrawn) {
            (Ok(drawn), Ok(redrawn)) => {
                assert_eq!(drawn.len(), width * height * 3);
                let first_difference = drawn.iter().zip(&redrawn).position(|(a, b)| a != b);
                let at = first_difference.map(|byte| (byte / 3 % width, byte / 3 / width));
                assert_eq!(at, None, "a pixel depends on an earlier frame");
                let [depths, redrawn_depths] = [&mut self.canvas, &mut fresh].map(|canvas| {
                    let depths = canvas.depths(&self.model, &levels, &self.scene, size);
                    depths.expect("depths of a valid scene")
                });
                assert!(depths == redrawn_depths, "a depth depends on an earlier frame");
                assert!(depths.iter().all(|depth| (0.0..=1.0).contains(depth)));
                assert_eq!(depths.len(), width * height);
                let segments = raster::segments(&self.model, &self.scene, size);
                assert_eq!(segments.expect("segments of a valid scene").len(), width * height);
            }
            (Err(drawn), Err(redrawn)) => {
                raster::segments(&self.model, &self.scene, size).expect_err("an invalid scene");
                assert_eq!(drawn.to_string(), redrawn.to_string());
                self.is_refused = true;
            }
            (drawn, redrawn) => {
                panic!("reused canvas: {:?}, new canvas: {:?}", drawn.err(), redrawn.err())
            }
        }
    }
}

const DEFAULT_CAMERA: Camera = Camera {
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
};

/// Reader of a message's values; yields zeros after the end of the message.
struct Bytes<'a>(&'a [u8]);

impl Bytes<'_> {
    fn byte(&mut self) -> u8 {
        let Some((first, rest)) = self.0.split_first() else {
            return 0;
        };
        self.0 = rest;
        *first
    }

    /// Reads the upper two bytes of an `f32`. The precision suffices, any two bytes are valid, and
    /// half of all values are huge, tiny or NaN.
    fn number(&mut self) -> f32 {
        f32::from_bits(u32::from_le_bytes([0, 0, self.byte(), self.byte()]))
    }

    fn numbers<const N: usize>(&mut self) -> [f32; N] {
        [0; N].map(|_: u8| self.number())
    }

    /// Reads an index into a list; `None` for zero, the most common byte.
    fn index(&mut self) -> Option<usize> {
        match self.byte() {
            0 => None,
            255 => Some(usize::MAX),
            place => Some(usize::from(place) - 1),
        }
    }

    /// Reads a size that a hostile file may claim.
    fn claimed_size(&mut self) -> usize {
        const CLAIMS: [usize; 8] =
            [256, 300, 1 << 14, (1 << 14) + 1, 6 << 14, 1 << 32, usize::MAX / 2, usize::MAX];
        let byte = usize::from(self.byte());
        CLAIMS.get(byte.wrapping_sub(248)).copied().unwrap_or(byte)
    }

    /// Reads the quality of shapes: fewer than 24 subdivisions, since more take long, or a number
    /// above the limit.
    fn quality(&mut self) -> Quality {
        let mut subdivisions = |most: usize| match self.byte() {
            255 => usize::MAX,
            254 => most + 1,
            byte => usize::from(byte) % 24,
        };
        Quality { slices: subdivisions(512), stacks: subdivisions(512), quads: subdivisions(64) }
    }

    fn mesh(&mut self) -> Mesh {
        let mut builder = MeshBuilder::default();
        let kind = self.byte();
        // Number of repetitions of the triangles, and the shift from each to the next.
        let (times, step): (u8, [f32; 3]) = (self.byte() % 32, self.numbers());
        let mut triangles = Vec::new();
        while !self.0.is_empty() && triangles.len() < MOST_TRIANGLES / 32 {
            let pos: [[f32; 3]; 3] = [0; 3].map(|_: u8| self.numbers());
            let st = [0; 3].map(|_: u8| match kind & 1 {
                0 => [0.0; 2],
                _ => self.numbers(),
            });
            let normals = [0; 3].map(|_: u8| match kind & 2 {
                0 => [0.0, 0.0, 1.0],
                _ => self.numbers(),
            });
            triangles.push((pos, normals, st));
        }
        for time in 0..=times {
            for (pos, normals, st) in &triangles {
                let shift = step.map(|step| step * f32::from(time));
                let pos = pos.map(|pos| std::array::from_fn(|axis| pos[axis] + shift[axis]));
                builder.triangle(match kind & 4 {
                    0 => mesh_triangle(pos, *normals, (kind & 1 != 0).then_some(*st)),
                    _ => std::array::from_fn(|at| Corner {
                        pos: pos[at],
                        normal: normals[at],
                        st: st[at],
                    }),
                });
            }
        }
        builder.build()
    }

    fn grid(&mut self) -> Vec<f64> {
        let kind = self.byte();
        let [half, spacing, period, far] = self.numbers().map(f64::from);
        let mut lines = plane_grid(half, spacing, (kind & 1 != 0).then_some(period), far);
        // Further lines give no new kinds of triangles.
        lines.truncate(2 + usize::from(kind >> 3));
        lines
    }

    fn texture(&mut self) -> (TextureKind, usize, usize, usize, Vec<u8>) {
        let kind = match self.byte() % 3 {
            0 => TextureKind::Flat { srgb: false },
            1 => TextureKind::Flat { srgb: true },
            _ => TextureKind::Cube,
        };
        let (width, height, channels) =
            (self.claimed_size(), self.claimed_size(), self.claimed_size());
        let needed = width
            .checked_mul(height)
            .and_then(|texels| texels.checked_mul(channels))
            .filter(|needed| *needed <= MOST_TEXTURE_BYTES);
        let (excess, value) = (self.byte(), self.byte());
        let length = needed.unwrap_or(MOST_TEXTURE_BYTES) + usize::from(excess);
        let texels = (0..length).map(|at| (at as u8).wrapping_mul(value));
        (kind, width, height, channels, texels.collect())
    }

    fn geom(&mut self) -> Geom {
        let (kind, place) = (self.byte(), usize::from(self.byte()));
        let mut geom = Geom {
            shape: match kind % 7 {
                0 => Shape::Mesh(place),
                1 => Shape::Plane(place),
                2 => Shape::Rectangle,
                3 => Shape::Box,
                4 => Shape::Ellipsoid,
                5 => Shape::Cylinder,
                _ => Shape::Capsule,
            },
            size: self.numbers(),
            pos: self.numbers(),
            mat: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
            rgba: self.numbers(),
            emission: 0.0,
            specular: 0.5,
            shininess: 0.5,
            reflectance: 0.0,
            texture: None,
            reach: 0.0,
            segment: None,
        };
        let flags = self.byte();
        if flags & 1 != 0 {
            geom.texture = Some(TextureUse {
                texture: usize::from(self.byte()),
                repeat: self.numbers(),
                uniform: flags & 2 != 0,
                by_corner: flags & 4 != 0,
            });
        }
        if flags & 8 != 0 {
            let numbers = self.numbers();
            [geom.emission, geom.specular, geom.shininess, geom.reflectance, geom.reach] = numbers;
        }
        if flags & 16 != 0 {
            geom.mat = self.numbers();
        }
        geom
    }

    fn light(&mut self) -> Light {
        let flags = self.byte();
        let kind = match flags & 1 {
            0 => LightKind::Directional,
            _ => LightKind::Spot {
                cutoff: self.number(),
                exponent: self.number(),
                attenuation: self.numbers(),
            },
        };
        Light {
            kind,
            pos: self.numbers(),
            dir: self.numbers(),
            ambient: self.numbers(),
            diffuse: self.numbers(),
            specular: self.numbers(),
            casts_shadow: flags & 2 != 0,
        }
    }

    /// Reads the quality of shadows. The map's size is small or invalid, because larger valid maps
    /// give no new kinds of lookups.
    fn shadows(&mut self) -> Shadows {
        Shadows {
            size: match self.byte() {
                255 => usize::MAX,
                254 => (1 << 14) + 1,
                side => usize::from(side),
            },
            half_width: self.number(),
            cone_share: self.number(),
        }
    }

    fn camera(&mut self) -> Camera {
        Camera {
            orthographic: self.byte() & 1 != 0,
            pos: self.numbers(),
            forward: self.numbers(),
            up: self.numbers(),
            center: self.number(),
            half_width: self.number(),
            bottom: self.number(),
            top: self.number(),
            near: self.number(),
            far: self.number(),
        }
    }

    /// Reads a frame size with a small area. A side has from zero to 4097 pixels, one more than the
    /// renderer allows.
    fn frame_size(&mut self) -> [usize; 2] {
        let mut side = || usize::from(u16::from_le_bytes([self.byte(), self.byte()])) % 4098;
        let (width, height) = (side(), side());
        match width * height <= MOST_PIXELS {
            true => [width, height],
            false => [width, (MOST_PIXELS / width).max(1)],
        }
    }
}

pub(crate) fn seeds() -> Vec<Vec<u8>> {
    let draw = |width: u16, height: u16, repeats: u8| {
        let size = [width.to_le_bytes(), height.to_le_bytes()].concat();
        script::write(DRAW, &[size, vec![repeats]].concat())
    };
    let quality = script::write(QUALITY, &[12, 8, 2]);
    let model = [
        quality.clone(),
        script::write(MESH, &bumps()),
        script::write(PLANE, &encoded(&[0xf8, 0], &[2.0, 0.5, 0.0, 10.0])),
        script::write(TEXTURE, &[0, 32, 32, 3, 0, 37]),
        script::write(TEXTURE, &[1, 21, 13, 3, 0, 11]),
        script::write(TEXTURE, &[2, 8, 48, 4, 0, 5]),
    ]
    .concat();
    let lights = [
        encoded(&[0], &[0.0, 0.0, 0.0, -0.6, 0.2, -0.77]),
        encoded(&[], &[0.1, 0.1, 0.1, 0.4, 0.4, 0.4, 0.5, 0.5, 0.5]),
        encoded(&[1], &[45.0, 10.0, 1.0, 0.1, 0.05, 0.5, 1.0, 2.0]),
        encoded(&[], &[-0.2, -0.4, -0.9, 0.0, 0.0, 0.0, 0.8, 0.7, 0.6]),
        encoded(&[], &[0.3, 0.3, 0.3]),
    ];
    // A place past the end of the list of geoms appends the geom.
    let geom = |place: u8, shape: [u8; 2], numbers: [f32; 10], more: &[u8]| {
        let head = [place, shape[0], shape[1]];
        script::write(GEOM, &[encoded(&head, &numbers), more.to_vec()].concat())
    };
    let white = [1.0; 4];
    let numbers = |size: [f32; 3], pos: [f32; 3], rgba: [f32; 4]| -> [f32; 10] {
        let all = [&size[..], &pos[..], &rgba[..]].concat();
        all.try_into().expect("ten numbers")
    };
    let mirror = encoded(&[8], &[0.0, 0.5, 0.5, 0.4, 0.0]);
    let capsule = |z: f32| {
        let pos = [-0.2, 0.3, z];
        geom(2, [6, 0], numbers([0.08, 0.08, 0.2], pos, [0.2, 0.7, 0.3, 1.0]), &[])
    };
    let geoms = [
        geom(99, [1, 0], numbers([2.0, 2.0, 0.5], [0.0; 3], white), &encoded(&[3, 1], &[2.0, 3.0])),
        geom(99, [3, 0], numbers([0.25, 0.3, 0.1], [0.3, 0.0, 0.1], white), &mirror),
        capsule(0.4),
        geom(
            99,
            [0, 0],
            numbers([0.3; 3], [-0.4, -0.1, 0.3], white),
            &encoded(&[5, 0], &[1.0, 1.0]),
        ),
        geom(
            99,
            [3, 0],
            numbers([0.15, 0.1, 0.2], [-0.5, 0.6, 0.2], white),
            &encoded(&[1, 2], &[1.0, 1.0]),
        ),
        geom(99, [5, 0], numbers([0.1, 0.1, 0.3], [0.0, -0.5, 0.3], white), &[]),
        geom(99, [4, 0], numbers([0.4; 3], [0.1, -0.2, 0.35], [0.3, 0.5, 1.0, 0.4]), &[]),
    ]
    .concat();
    let room = [
        model,
        script::write(LIGHTS, &lights.concat()),
        script::write(SURROUNDINGS, &[0, 3]),
        geoms,
    ]
    .concat();
    let near = encoded(
        &[0],
        &[0.3, 0.1, 0.5, -0.8, -0.1, -0.2, 0.0, 0.0, 1.0, 0.0, 0.0, -0.02, 0.02, 0.01, 50.0],
    );
    let from_above = encoded(
        &[1],
        &[0.0, 0.0, 3.0, 0.0, 0.0, -1.0, 0.0, 1.0, 0.0, 0.1, 1.5, -1.0, 1.0, 0.5, 9.0],
    );
    let moves = [draw(64, 48, 3), capsule(0.5), draw(64, 48, 1), draw(33, 17, 2)].concat();
    vec![
        [room.clone(), moves].concat(),
        [room.clone(), script::write(CAMERA, &near), draw(65, 39, 2)].concat(),
        [room, script::write(CAMERA, &from_above), draw(1, 4096, 0), draw(4096, 1, 0)].concat(),
        [quality, draw(1, 1, 3), draw(64, 64, 0)].concat(),
    ]
}

/// Encodes bytes and numbers as [`Bytes`] reads them.
fn encoded(bytes: &[u8], numbers: &[f32]) -> Vec<u8> {
    let mut all = bytes.to_vec();
    for number in numbers {
        all.extend(&number.to_le_bytes()[2..]);
    }
    all
}

/// Returns a bumpy mesh with texture coordinates and more than one cluster.
fn bumps() -> Vec<u8> {
    let mut mesh = encoded(&[1, 7], &[0.09, 0.0, 0.0]);
    for y in 0..8_u8 {
        let y = f32::from(y) * 0.07 - 0.3;
        let corners = [
            [-0.3, y, 0.0],
            [-0.2, y, 0.05],
            [-0.3, y + 0.07, 0.02],
            [-0.2, y, 0.05],
            [-0.2, y + 0.07, 0.0],
            [-0.3, y + 0.07, 0.02],
        ];
        for three in corners.chunks(3) {
            let pos = three.concat();
            let st: Vec<f32> =
                three.iter().flat_map(|point| [point[0] * 3.0, point[1] * 3.0]).collect();
            mesh.extend(encoded(&[], &pos));
            mesh.extend(encoded(&[], &st));
        }
    }
    mesh
}
