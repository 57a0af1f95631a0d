//! Drawing of a frame in the order of MuJoCo's renderer: opaque geoms and the sky, the light of
//! lights that cast shadows, reflections, and translucent geoms.

use std::cell::RefCell;
use std::sync::atomic::{AtomicU64, Ordering};

use crate::backdrop::{Backdrop, Start};
use crate::error::DrawError;
use crate::fill::FIRST_SAMPLE;
use crate::instance::{self, View};
use crate::lanes::{f32x4, i32x4};
use crate::light::{EyeLight, Lighting};
use crate::model::Model;
use crate::picture::{Pass, Picture, Workspace};
use crate::scene::{Geom, Scene, Shadows, Shape};
use crate::shade::MAX_SIDE;
use crate::visible::SAMPLES;
use crate::window::Window;
use crate::{glass, mirror, shadow};

/// Drawing surface of one camera. It caches the static part of its picture between frames; all
/// other buffers belong to the thread that draws, so that many cameras need little memory. The
/// result does not depend on earlier frames; drawing is fastest if every camera has its own canvas,
/// and each thread draws few canvases.
#[derive(Default)]
pub struct Canvas {
    backdrop: Backdrop,
    /// Number of the last frame; 0 before the first.
    last_frame: u64,
}

#[derive(Default)]
struct Frame {
    /// Number of the frame, unique in the process. If the canvas has drawn its last frame on
    /// another thread, that frame has a larger number, and this frame is outdated.
    number: u64,
    picture: Picture,
    /// Window in which the frame differs from the canvas's backdrop.
    dirty: Option<Window>,
    rgb: Vec<u8>,
}

#[derive(Default)]
struct Scratch {
    /// The last frames of the canvases drawn most recently, the latest at the end.
    frames: Vec<Frame>,
    reflection: Picture,
    work: Workspace,
}

/// Longest side of a shadow map, texels: the longest side of OpenGL's textures.
const MAX_SHADOW_SIDE: usize = 1 << 14;
/// Number of frames that a thread keeps: one for each of the two cameras of an environment.
const KEPT_FRAMES: usize = 2;

static FRAMES: AtomicU64 = AtomicU64::new(0);

thread_local! {
    static SCRATCH: RefCell<Scratch> = RefCell::default();
}

impl Scratch {
    /// Takes out the frame with this number, else a new or the oldest one, to be overwritten.
    fn take(&mut self, number: u64) -> Frame {
        let found = self.frames.iter().position(|frame| frame.number == number);
        match found {
            Some(at) => self.frames.remove(at),
            None if self.frames.len() < KEPT_FRAMES => Frame::default(),
            None => self.frames.remove(0),
        }
    }
}

impl Canvas {
    pub fn new() -> Self {
        Self::default()
    }

    /// `size` is in pixels. Returns red, green and blue of every pixel, row by row from the bottom.
    /// All frames of a canvas must be of one model; `largest_levels` holds the bytes that its
    /// textures were made from.
    pub fn draw(
        &mut self,
        model: &Model,
        largest_levels: &[&[u8]],
        scene: &Scene,
        size: [usize; 2],
    ) -> Result<Vec<u8>, DrawError> {
        self.frame(model, largest_levels, scene, size, |frame| frame.rgb.clone())
    }

    /// Draws a frame. Returns the depths at each pixel's first sample: 0 at the near plane, 1 at
    /// the far plane, as in OpenGL; row by row from the bottom. Translucent geoms are ignored.
    pub fn depths(
        &mut self,
        model: &Model,
        largest_levels: &[&[u8]],
        scene: &Scene,
        size: [usize; 2],
    ) -> Result<Vec<f32>, DrawError> {
        self.frame(model, largest_levels, scene, size, |frame| {
            let visible = &frame.picture.visible;
            let rows = Window::whole(visible.width, visible.height).rows(visible.stride);
            let depth = |pixel: usize| (1.0 - visible.depths[pixel * SAMPLES]).clamp(0.0, 1.0);
            rows.flatten().map(depth).collect()
        })
    }

    fn frame<T>(
        &mut self,
        model: &Model,
        largest_levels: &[&[u8]],
        scene: &Scene,
        [width, height]: [usize; 2],
        read: impl FnOnce(&Frame) -> T,
    ) -> Result<T, DrawError> {
        check(model, scene, width, height)?;
        for (index, texture) in model.textures.iter().enumerate() {
            let (given, needed) =
                (largest_levels.get(index).map_or(0, |bytes| bytes.len()), texture.bytes());
            if given != needed {
                return Err(DrawError::Texels { texture: index, given, needed });
            }
        }
        let view = View::new(&scene.camera, width, height);
        let lights = EyeLight::all(scene, &view);
        let pass = Pass {
            model,
            largest_levels,
            view: &view,
            light: Lighting::all(&lights),
            window: Window::whole(width, height),
        };
        let casting = scene.casting_lights();
        let shadowless = lights.iter().zip(&casting).filter(|(_, casts)| !**casts);
        let shadowless: Vec<EyeLight> = shadowless.map(|(light, _)| *light).collect();
        let opaque = Pass { light: Lighting { lights: &shadowless, ..pass.light }, ..pass };
        SCRATCH.with_borrow_mut(|scratch| {
            let mut frame = scratch.take(self.last_frame);
            let Scratch { reflection, work, .. } = scratch;
            let is_last = frame.number == self.last_frame;
            let before = frame.dirty.take().filter(|_| is_last);
            let start = self.backdrop.compare(scene, [width, height]);
            match start {
                Start::Reuse if is_last => self.backdrop.restore(&mut frame.picture, before),
                Start::Reuse => self.backdrop.restore_all(&mut frame.picture),
                Start::Redraw | Start::Cache => frame.picture.clear([width, height], pass.window),
            }
            frame.draw_opaque(opaque, scene, start, &mut self.backdrop, work);
            shadow::add_all(&mut frame.picture, pass, scene, &casting, work);
            frame.draw_reflections_and_glass(pass, scene, reflection, work);
            let resolved = match start {
                Start::Reuse if is_last => Window::union(before, frame.dirty),
                Start::Reuse | Start::Redraw | Start::Cache => Some(pass.window),
            };
            frame.rgb.resize(width * height * 3, 0);
            if let Some(window) = resolved {
                frame.resolve(window);
            }
            frame.number = 1 + FRAMES.fetch_add(1, Ordering::Relaxed);
            self.last_frame = frame.number;
            let read = read(&frame);
            scratch.frames.push(frame);
            Ok(read)
        })
    }
}

impl Frame {
    /// Draws opaque geoms and the sky. `start` states whether the picture already contains the
    /// backdrop, or whether the backdrop is to be drawn and cached first.
    fn draw_opaque(
        &mut self,
        pass: Pass<'_>,
        scene: &Scene,
        start: Start,
        backdrop: &mut Backdrop,
        work: &mut Workspace,
    ) {
        let picture = &mut self.picture;
        let translucent = glass::translucent_geoms(scene, pass.view);
        let add = |picture: &mut Picture, is_selected: &dyn Fn(usize) -> bool| {
            for (index, geom) in scene.geoms.iter().enumerate() {
                if is_selected(index) && !translucent.contains(&index) {
                    instance::add(index, geom, pass.view, pass.model, &mut picture.instances);
                }
            }
        };
        let sky = |picture: &mut Picture| {
            let sky = scene.sky.and_then(|sky| instance::sky(sky, pass.view, pass.model));
            picture.instances.extend(sky);
        };
        match start {
            Start::Redraw => {
                add(picture, &|_| true);
                sky(picture);
                picture.rasterise(pass, 0, work);
                picture.paint(pass, 0, work);
                return;
            }
            Start::Cache => {
                add(picture, &|index| backdrop.contains(index));
                sky(picture);
                picture.rasterise(pass, 0, work);
                picture.paint(pass, 0, work);
                backdrop.store(picture);
                picture.visible.touched = None;
            }
            Start::Reuse => {}
        }
        let (instances, records) = (picture.instances.len(), picture.visible.records.len());
        add(picture, &|index| !backdrop.contains(index));
        picture.rasterise(pass, instances, work);
        picture.paint(pass, records, work);
        self.dirty = picture.visible.touched;
    }

    fn draw_reflections_and_glass(
        &mut self,
        pass: Pass<'_>,
        scene: &Scene,
        reflection: &mut Picture,
        work: &mut Workspace,
    ) {
        let picture = &mut self.picture;
        let translucent = glass::translucent_geoms(scene, pass.view);
        if let Some(mirror) = mirror::find(scene, pass.view, &translucent) {
            let geoms = (mirror, translucent.as_slice());
            let changed = mirror::add(picture, reflection, pass, scene, geoms, work);
            self.dirty = Window::union(self.dirty, changed);
        }
        let translucent: Vec<Geom> = translucent.iter().map(|index| scene.geoms[*index]).collect();
        let changed = glass::add(picture, pass, &translucent, work);
        self.dirty = Window::union(self.dirty, changed);
    }

    fn resolve(&mut self, window: Window) {
        let (width, stride) = (self.picture.visible.width, self.picture.visible.stride);
        let rows = window.rows(stride).zip(window.rows(width));
        for (from, to) in rows {
            let samples = &self.picture.samples[from];
            let (pixels, _) = self.rgb[to.start * 3..to.end * 3].as_chunks_mut::<3>();
            for (samples, pixel) in samples.iter().zip(pixels) {
                let first = samples[0];
                let [r, g, b, _] = match *samples == [first; SAMPLES] {
                    true => first.to_le_bytes(),
                    false => mean(samples),
                };
                *pixel = [r, g, b];
            }
        }
    }
}

#[inline(always)]
fn mean(samples: &[u32; SAMPLES]) -> [u8; 4] {
    let [a, b, c, d] = samples.map(|sample| {
        let parts = i32x4::new(sample.to_le_bytes().map(i32::from));
        parts.round_float() * f32x4::splat(1.0 / 255.0)
    });
    let mean = (((a + b) + c) + d) * f32x4::splat(0.25);
    let rounded = (mean * f32x4::splat(255.0)).round_int();
    rounded.to_array().map(|part| part as u8)
}

pub(crate) fn check(
    model: &Model,
    scene: &Scene,
    width: usize,
    height: usize,
) -> Result<(), DrawError> {
    if !(1..=MAX_SIDE).contains(&width) || !(1..=MAX_SIDE).contains(&height) {
        return Err(DrawError::Size { width, height });
    }
    let camera = &scene.camera;
    let require = |is_valid: bool, what, value, needed| match is_valid {
        true => Ok(()),
        false => Err(DrawError::Camera { what, value, needed }),
    };
    let (near, far) = (camera.near, camera.far);
    let needed = "it must be finite, positive and nearer than the far plane";
    require(near > 0.0 && near.is_finite(), "near plane", near, needed)?;
    require(
        far > near && far.is_finite(),
        "far plane",
        far,
        "it must be finite and farther than the near plane",
    )?;
    let frustum_height = camera.top - camera.bottom;
    require(
        frustum_height != 0.0 && frustum_height.is_finite(),
        "height",
        frustum_height,
        "its lower and upper ends must differ",
    )?;
    let finite = [camera.half_width, camera.center]
        .into_iter()
        .chain(camera.pos)
        .chain(camera.forward)
        .chain(camera.up);
    for value in finite {
        require(value.is_finite(), "pose or width", value, "it must be finite")?;
    }
    for (at, geom) in scene.geoms.iter().enumerate() {
        let exists = |what, index: usize, count: usize| match index < count {
            true => Ok(()),
            false => Err(DrawError::Missing { geom: at, what, index, count }),
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
    if let Some(Shadows { size, .. }) = scene.shadows
        && !(3..=MAX_SHADOW_SIDE).contains(&size)
    {
        return Err(DrawError::Shadows { size });
    }
    match scene.sky {
        Some(index) if index >= model.textures.len() => {
            Err(DrawError::MissingSky { index, count: model.textures.len() })
        }
        _ => Ok(()),
    }
}

/// The visible geom at the centre of every pixel, row by row from the bottom, as in MuJoCo's
/// segmentation rendering, without lights, sky, mirrors and translucency; `None` where no geom with
/// an id is visible. The size is in pixels.
pub fn segments(
    model: &Model,
    scene: &Scene,
    [width, height]: [usize; 2],
) -> Result<Vec<Option<u32>>, DrawError> {
    check(model, scene, width, height)?;
    let mut view = View::new(&scene.camera, width, height);
    // Each pixel's first sample then lies at the pixel's centre.
    let [x, y] = FIRST_SAMPLE.map(|place| place - 0.5);
    view.projection = view.projection.shifted([2.0 * x / width as f32, 2.0 * y / height as f32]);
    let pass = Pass {
        model,
        largest_levels: &[],
        view: &view,
        light: Lighting::all(&[]),
        window: Window::whole(width, height),
    };
    let mut picture = Picture::default();
    picture.clear([width, height], pass.window);
    for (index, geom) in scene.geoms.iter().enumerate() {
        if geom.segment.is_some() {
            instance::add(index, geom, &view, model, &mut picture.instances);
        }
    }
    picture.rasterise(pass, 0, &mut Workspace::default());
    let visible = &picture.visible;
    let visible_segment = |pixel: usize| {
        let record = visible.records.get(visible.ids[pixel * SAMPLES] as usize)?;
        let instance = &picture.instances[record.instance as usize];
        scene.geoms[instance.geom].segment
    };
    let rows = pass.window.rows(visible.stride);
    Ok(rows.flatten().map(visible_segment).collect())
}
