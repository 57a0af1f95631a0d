//! A frame from beginning to end, in the order of MuJoCo's renderer: what a
//! mirror shows, everything opaque, the sky, and what one can see through.

use crate::error::DrawError;
use crate::instance::{self, Instance, View, is_behind, is_plane};
use crate::light::{EyeLight, MOST_LIGHTS};
use crate::model::Model;
use crate::raster::{self, Drawing, Layer, NOTHING, Positions, SAMPLES, Visible, Window};
use crate::scene::{Geom, Scene, Shape};
use crate::shade::{self, Fragment, Lists};
use crate::shapes::is_upper_face;

/// Longest side of a frame, pixels.
const MAX_SIDE: usize = 4096;
/// Geoms of less opacity are seen through.
const OPAQUE_FROM: f32 = 0.995;

/// What draws, and what it keeps from frame to frame.
pub struct Canvas {
    instances: Vec<Instance>,
    positions: Box<Positions>,
    visible: Visible,
    lists: Lists,
    /// Colours of all samples, red in the lowest byte.
    samples: Vec<[u32; SAMPLES]>,
    rgb: Vec<u8>,
}

impl Default for Canvas {
    fn default() -> Self {
        Self::new()
    }
}

impl Canvas {
    /// A canvas without anything on it.
    pub fn new() -> Self {
        Self {
            instances: Vec::new(),
            positions: Box::default(),
            visible: Visible::default(),
            lists: Lists::default(),
            samples: Vec::new(),
            rgb: Vec::new(),
        }
    }

    /// Draws a frame; red, green and blue of every pixel, row by row from the
    /// lowest.
    ///
    /// # Errors
    /// If the scene's numbers cannot be drawn, or name what the model lacks.
    pub fn draw(
        &mut self,
        model: &Model,
        scene: &Scene,
        width: usize,
        height: usize,
    ) -> Result<&[u8], DrawError> {
        check(model, scene, width, height)?;
        let view = View::new(&scene.camera, width, height);
        self.draw_view(model, scene, &view, [width, height]);
        Ok(&self.rgb)
    }

    fn draw_view(
        &mut self,
        model: &Model,
        scene: &Scene,
        view: &View,
        [width, height]: [usize; 2],
    ) {
        let whole = Window {
            x: [0, width as i32 - 1],
            y: [0, height as i32 - 1],
        };
        let lights = eye_lights(scene, view);
        let glassy = see_through(scene, view);
        let mirror = mirror(scene, view, &glassy);
        self.instances.clear();
        for (index, geom) in scene.geoms.iter().enumerate() {
            if !glassy.contains(&index) {
                instance::add(index, geom, view, model, &mut self.instances);
            }
        }
        if let Some(sky) = scene.sky.and_then(|sky| instance::sky(sky, view, model)) {
            self.instances.push(sky);
        }
        self.visible.clear(width, height);
        self.rasterise(model, view, whole);
        self.samples.clear();
        self.samples
            .resize(self.visible.stride * height, [0; SAMPLES]);
        self.paint(model, &lights, whole);
        if let Some(mirror) = mirror {
            self.add_reflection(model, scene, view, mirror, &glassy);
        }
        if !glassy.is_empty() {
            self.add_glass(model, scene, view, &lights, &glassy, whole);
        }
        self.resolve(width, height);
    }

    /// Finds what is visible of the instances, the near ones first.
    fn rasterise(&mut self, model: &Model, view: &View, window: Window) {
        let mut order: Vec<usize> = (0..self.instances.len()).collect();
        order.sort_by(|a, b| {
            let distance = |at: &usize| self.instances[*at].distance;
            distance(a).total_cmp(&distance(b))
        });
        let mut drawing = Drawing {
            model,
            instances: &self.instances,
            window,
            plane: view.clip,
            positions: &mut self.positions,
            visible: &mut self.visible,
            layers: None,
        };
        for index in order {
            raster::draw(index, &mut drawing);
        }
    }

    /// Colours what is visible.
    fn paint(&mut self, model: &Model, lights: &[EyeLight], window: Window) {
        let (visible, lists) = (&self.visible, &mut self.lists);
        lists.clear(visible.records.len(), model.textures.len());
        shade::list_fragments(visible, &self.instances, window, lists);
        shade::work_out_surfaces(model, visible, &self.instances, lights, lists);
        let (stride, samples) = (visible.stride, &mut self.samples);
        shade::colour(model, lists, |fragment, colour| {
            let pixel = &mut samples[usize::from(fragment.y) * stride + usize::from(fragment.x)];
            if fragment.samples == 0xf {
                *pixel = [colour; SAMPLES];
                return;
            }
            for (sample, value) in pixel.iter_mut().enumerate() {
                if fragment.samples & (1 << sample) != 0 {
                    *value = colour;
                }
            }
        });
    }

    /// Adds what a mirror shows to the samples at which its face is visible.
    fn add_reflection(
        &mut self,
        model: &Model,
        scene: &Scene,
        view: &View,
        mirror: usize,
        glassy: &[usize],
    ) {
        let geom = &scene.geoms[mirror];
        let Some(window) = self.mirror_window(model, mirror, geom) else {
            return;
        };
        let mut other = Canvas::new();
        let size = [self.visible.width, self.visible.height];
        let (pos, normal) = mirror_plane(geom);
        let reflected = view.in_mirror(pos, normal);
        let lights = eye_lights(scene, &reflected);
        let dimmed = |index: usize| {
            let mut geom = scene.geoms[index];
            for channel in 0..3 {
                geom.rgba[channel] *= scene.geoms[mirror].reflectance;
            }
            geom
        };
        for index in (0..scene.geoms.len()).filter(|it| *it != mirror && !glassy.contains(it)) {
            instance::add(
                index,
                &dimmed(index),
                &reflected,
                model,
                &mut other.instances,
            );
        }
        other.visible.clear(size[0], size[1]);
        other.rasterise(model, &reflected, window);
        other.samples.resize(self.samples.len(), [0; SAMPLES]);
        other.paint(model, &lights, window);
        if !glassy.is_empty() {
            let mut seen = scene.clone();
            for index in 0..seen.geoms.len() {
                seen.geoms[index] = dimmed(index);
            }
            other.add_glass(model, &seen, &reflected, &lights, glassy, window);
        }
        for y in window.y[0]..=window.y[1] {
            for x in window.x[0]..=window.x[1] {
                let at = y as usize * self.visible.stride + x as usize;
                for sample in 0..SAMPLES {
                    if self.shows_mirror(model, mirror, geom, at * SAMPLES + sample) {
                        let (own, added) =
                            (&mut self.samples[at][sample], other.samples[at][sample]);
                        *own = saturating_sum(*own, added);
                    }
                }
            }
        }
    }

    /// Whether a sample shows the face that mirrors.
    fn shows_mirror(&self, model: &Model, mirror: usize, geom: &Geom, sample: usize) -> bool {
        let id = self.visible.ids[sample];
        if id == NOTHING {
            return false;
        }
        let record = &self.visible.records[id as usize];
        let instance = &self.instances[record.instance as usize];
        if instance.geom != mirror {
            return false;
        }
        let triangle = match record.positions {
            raster::CLIPPED => self.visible.clipped[record.triangle as usize].triangle,
            _ => record.triangle,
        };
        let order = instance.mesh.of(model).order[triangle as usize];
        geom.shape != Shape::Box || is_upper_face(order)
    }

    /// The pixels in which the face that mirrors is visible; none if it is not.
    fn mirror_window(&self, model: &Model, mirror: usize, geom: &Geom) -> Option<Window> {
        let mut window: Option<Window> = None;
        let (width, stride) = (self.visible.width, self.visible.stride);
        for y in 0..self.visible.height {
            for x in 0..width {
                let first = (y * stride + x) * SAMPLES;
                let shows = (first..first + SAMPLES)
                    .any(|sample| self.shows_mirror(model, mirror, geom, sample));
                if shows {
                    let (x, y) = (x as i32, y as i32);
                    let found = window.get_or_insert(Window {
                        x: [x, x],
                        y: [y, y],
                    });
                    found.x = [found.x[0].min(x), found.x[1].max(x)];
                    found.y = [found.y[0].min(y), found.y[1].max(y)];
                }
            }
        }
        window
    }

    /// Blends what one can see through: the near things first, and then all of
    /// them again the far ones first.
    #[expect(clippy::too_many_arguments, reason = "all that a pass consists of")]
    fn add_glass(
        &mut self,
        model: &Model,
        scene: &Scene,
        view: &View,
        lights: &[EyeLight],
        glassy: &[usize],
        window: Window,
    ) {
        let mut painted = Vec::with_capacity(glassy.len());
        for index in glassy {
            painted.push(self.glass_layers(model, &scene.geoms[*index], view, lights, window));
        }
        for fragments in painted.iter().chain(painted.iter().rev()) {
            for (fragment, colour) in fragments {
                let at = usize::from(fragment.y) * self.visible.stride + usize::from(fragment.x);
                for sample in 0..SAMPLES {
                    if fragment.samples & (1 << sample) != 0 {
                        let under = &mut self.samples[at][sample];
                        *under = blended(*under, *colour);
                    }
                }
            }
        }
    }

    /// All of a geom that is in front of what is opaque, in drawing order.
    fn glass_layers(
        &mut self,
        model: &Model,
        geom: &Geom,
        view: &View,
        lights: &[EyeLight],
        window: Window,
    ) -> Vec<(Fragment, u32)> {
        self.instances.clear();
        instance::add(0, geom, view, model, &mut self.instances);
        self.visible.records.clear();
        self.visible.clipped.clear();
        let mut layers: Vec<Layer> = Vec::new();
        for index in 0..self.instances.len() {
            let mut drawing = Drawing {
                model,
                instances: &self.instances,
                window,
                plane: view.clip,
                positions: &mut self.positions,
                visible: &mut self.visible,
                layers: Some(&mut layers),
            };
            raster::draw(index, &mut drawing);
        }
        // Stable: the pixels of a triangle do not overlap.
        layers.sort_by_key(|layer| layer.rank);
        let (visible, lists) = (&self.visible, &mut self.lists);
        lists.clear(visible.records.len(), model.textures.len());
        let mut sources = Vec::with_capacity(layers.len());
        for layer in &layers {
            let (surface, instance) = lists.surface_of(layer.id, &visible.records);
            let list = lists.list_of(&self.instances[instance as usize]);
            for (pixel, bits) in [(0, layer.samples & 0xf), (1, layer.samples >> 4)] {
                if bits != 0 {
                    let fragment = Fragment {
                        x: layer.x + pixel,
                        y: layer.y,
                        surface,
                        // Colours come back list by list; this is for sorting them.
                        samples: bits | (sources.len() as u32) << SAMPLES,
                    };
                    sources.push(());
                    lists.fragments[list].push(fragment);
                }
            }
        }
        shade::work_out_surfaces(model, visible, &self.instances, lights, lists);
        let mut painted = Vec::with_capacity(sources.len());
        shade::colour(model, lists, |fragment, colour| {
            painted.push((*fragment, colour));
        });
        painted.sort_by_key(|(fragment, _)| fragment.samples >> SAMPLES);
        painted
    }

    /// The mean of each pixel's samples.
    fn resolve(&mut self, width: usize, height: usize) {
        self.rgb.resize(width * height * 3, 0);
        let rows = self.samples.chunks_exact(self.visible.stride);
        for (row, to) in rows.zip(self.rgb.chunks_exact_mut(width * 3)) {
            for (samples, to) in row.iter().zip(to.chunks_exact_mut(3)) {
                let [a, b, c, d] = *samples;
                if a == b && a == c && a == d {
                    to.copy_from_slice(&a.to_le_bytes()[..3]);
                    continue;
                }
                let parts = samples.map(u32::to_le_bytes);
                for (channel, to) in to.iter_mut().enumerate() {
                    let [a, b, c, d] = parts.map(|part| f32::from(part[channel]) * (1.0 / 255.0));
                    let mean = (((a + b) + c) + d) * 0.25;
                    *to = (mean * 255.0).round_ties_even() as u8;
                }
            }
        }
    }
}

fn check(model: &Model, scene: &Scene, width: usize, height: usize) -> Result<(), DrawError> {
    if !(1..=MAX_SIDE).contains(&width) || !(1..=MAX_SIDE).contains(&height) {
        return Err(DrawError::Size { width, height });
    }
    let camera = &scene.camera;
    let demand = |holds: bool, what, value, needed| match holds {
        true => Ok(()),
        false => Err(DrawError::Camera {
            what,
            value,
            needed,
        }),
    };
    let (near, far) = (camera.near, camera.far);
    let needed = "it must be finite, positive and below the far plane's";
    demand(near > 0.0 && near.is_finite(), "near plane", near, needed)?;
    demand(
        far > near && far.is_finite(),
        "far plane",
        far,
        "it must be finite and above the near plane's",
    )?;
    let height_seen = camera.top - camera.bottom;
    demand(
        height_seen != 0.0 && height_seen.is_finite(),
        "height",
        height_seen,
        "its lower and upper ends must differ",
    )?;
    let finite = [camera.half_width, camera.center]
        .into_iter()
        .chain(camera.pos)
        .chain(camera.forward)
        .chain(camera.up);
    for value in finite {
        demand(
            value.is_finite(),
            "pose or width",
            value,
            "it must be finite",
        )?;
    }
    for (at, geom) in scene.geoms.iter().enumerate() {
        let exists = |what, index: usize, count: usize| match index < count {
            true => Ok(()),
            false => Err(DrawError::Missing {
                geom: at,
                what,
                index,
                count,
            }),
        };
        match geom.shape {
            Shape::Mesh(index) => exists("mesh", index, model.meshes.len())?,
            Shape::Plane(index) => exists("plane", index, model.planes.len())?,
            _ => {}
        }
        if let Some(used) = geom.texture {
            exists("texture", used.texture, model.textures.len())?;
        }
    }
    match scene.sky {
        Some(index) if index >= model.textures.len() => Err(DrawError::Missing {
            geom: scene.geoms.len(),
            what: "texture",
            index,
            count: model.textures.len(),
        }),
        _ => Ok(()),
    }
}

fn eye_lights(scene: &Scene, view: &View) -> Vec<EyeLight> {
    let lights = scene.lights.iter().take(MOST_LIGHTS);
    lights.map(|light| EyeLight::new(light, view)).collect()
}

/// The geoms that one can see through, the near ones first.
fn see_through(scene: &Scene, view: &View) -> Vec<usize> {
    let mut found: Vec<(f32, usize)> = Vec::new();
    for (index, geom) in scene.geoms.iter().enumerate() {
        let is_turned = is_plane(geom) && is_behind(view.head, geom);
        if f64::from(geom.rgba[3]) >= f64::from(OPAQUE_FROM) && !is_turned {
            continue;
        }
        let distance = match is_plane(geom) {
            true => 1e10,
            false => {
                let off = crate::matrix::minus(geom.pos, view.head);
                crate::matrix::dot(off, off).sqrt() - reach(geom)
            }
        };
        found.push((distance, index));
    }
    found.sort_by(|a, b| a.0.total_cmp(&b.0));
    found.into_iter().map(|(_, index)| index).collect()
}

/// How far a geom reaches from its middle, as MuJoCo sorts by.
fn reach(geom: &Geom) -> f32 {
    let [x, y, z] = geom.size;
    match geom.shape {
        _ if geom.reach > 0.0 => geom.reach,
        Shape::Ellipsoid => x.max(y).max(z),
        Shape::Capsule => x + z,
        Shape::Cylinder => (x * x + z * z).sqrt(),
        Shape::Box => (x * x + y * y + z * z).sqrt(),
        Shape::Mesh(_) | Shape::Plane(_) | Shape::Rectangle => 0.0,
    }
}

/// The one geom that mirrors, if the camera is before its face.
fn mirror(scene: &Scene, view: &View, glassy: &[usize]) -> Option<usize> {
    let can = |geom: &Geom| is_plane(geom) || geom.shape == Shape::Box;
    let found = (0..scene.geoms.len()).find(|index| {
        let geom = &scene.geoms[*index];
        can(geom) && geom.reflectance > 0.0 && !glassy.contains(index)
    })?;
    let (pos, _) = mirror_plane(&scene.geoms[found]);
    let face = Geom {
        pos,
        ..scene.geoms[found]
    };
    (scene.reflections && !is_behind(view.head, &face)).then_some(found)
}

/// A point of the face that mirrors, and its normal.
fn mirror_plane(geom: &Geom) -> ([f32; 3], [f32; 3]) {
    let normal = [geom.mat[2], geom.mat[5], geom.mat[8]];
    let raised = match geom.shape {
        Shape::Box => geom.size[2],
        _ => 0.0,
    };
    let pos = std::array::from_fn(|axis| geom.pos[axis] + raised * normal[axis]);
    (pos, normal)
}

fn saturating_sum(a: u32, b: u32) -> u32 {
    let (a, b) = (a.to_le_bytes(), b.to_le_bytes());
    u32::from_le_bytes(std::array::from_fn(|at| a[at].saturating_add(b[at])))
}

/// A colour over another, by its opacity, in 8 bits.
fn blended(under: u32, over: u32) -> u32 {
    let (under, over) = (under.to_le_bytes(), over.to_le_bytes());
    let opacity = over[3];
    let times = |value: u8, share: u8| {
        let product = u32::from(value) * u32::from(share);
        (product + (product >> 8) + 128) >> 8
    };
    u32::from_le_bytes(std::array::from_fn(|at| {
        let sum = times(over[at], opacity) + times(under[at], 255 - opacity);
        sum.min(255) as u8
    }))
}
