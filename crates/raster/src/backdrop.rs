//! Cache of the static part of a picture. While a camera and its lights are unchanged, unchanged
//! geoms are drawn once and cached with their depths, and only moving geoms are drawn over them.
//! The visible triangle at a sample does not depend on the drawing order, so the cache changes no
//! bit of a frame.

use crate::clip::ClippedTriangle;
use crate::instance::Instance;
use crate::picture::Picture;
use crate::scene::{Camera, Geom, Light, LightKind, Scene, TextureUse};
use crate::visible::{Record, SAMPLES};
use crate::window::Window;

/// Number of frames for which a geom must be at rest before it is cached: initial and largest
/// value. The number is multiplied by four whenever a cached geom moves.
const FIRST_REST: u16 = 1;
const LONGEST_REST: u16 = 256;
/// Number of frames at rest after which an uncached geom justifies redrawing the cached picture.
const REST_BEFORE_REDRAW: u16 = 8;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Start {
    /// Draw everything and cache nothing: no geom is known to be at rest, or a light casts shadows.
    Redraw,
    Cache,
    Reuse,
}

#[derive(Default)]
pub(crate) struct Backdrop {
    last: Option<(Scene, [usize; 2])>,
    /// For each geom: number of frames at rest so far, and number of frames required for caching.
    rested: Vec<u16>,
    needed: Vec<u16>,
    is_cached: Vec<bool>,
    has_picture: bool,
    instances: Vec<Instance>,
    records: Vec<Record>,
    clipped: Vec<ClippedTriangle>,
    depths: Vec<f32>,
    ids: Vec<u32>,
    samples: Vec<[u32; SAMPLES]>,
}

impl Backdrop {
    pub(crate) fn compare(&mut self, scene: &Scene, size: [usize; 2]) -> Start {
        // A moving geom's shadow may fall on every geom at rest.
        if scene.casting_lights().contains(&true) {
            *self = Self::default();
            return Start::Redraw;
        }
        let count = scene.geoms.len();
        let is_same_view = self.last.as_ref().is_some_and(|(last, last_size)| {
            *last_size == size
                && camera_bits(&last.camera) == camera_bits(&scene.camera)
                && last.lights.len() == scene.lights.len()
                && (last.lights.iter().zip(&scene.lights))
                    .all(|(a, b)| light_bits(a) == light_bits(b))
                && (last.sky, last.reflections) == (scene.sky, scene.reflections)
                && last.geoms.len() == count
        });
        if !is_same_view {
            // Frees the cached picture: a moving camera rarely rests long enough for a new one.
            *self = Self {
                last: Some((scene.clone(), size)),
                rested: vec![0; count],
                needed: vec![FIRST_REST; count],
                is_cached: vec![false; count],
                ..Self::default()
            };
            return Start::Redraw;
        }
        let mut is_valid = self.has_picture;
        if let Some((last, _)) = &mut self.last {
            for (index, (before, now)) in last.geoms.iter_mut().zip(&scene.geoms).enumerate() {
                if same_bits(before, now) {
                    self.rested[index] = self.rested[index].saturating_add(1);
                    continue;
                }
                self.rested[index] = 0;
                if self.is_cached[index] {
                    self.needed[index] = (self.needed[index] * 4).min(LONGEST_REST);
                    is_valid = false;
                }
                *before = *now;
            }
        }
        let should_be_added = |index: usize| {
            !self.is_cached[index]
                && self.rested[index] >= self.needed[index].max(REST_BEFORE_REDRAW)
        };
        if is_valid && !(0..count).any(should_be_added) {
            return Start::Reuse;
        }
        for index in 0..count {
            self.is_cached[index] = self.rested[index] >= self.needed[index];
        }
        self.has_picture = self.is_cached.iter().any(|is_cached| *is_cached);
        if self.has_picture { Start::Cache } else { Start::Redraw }
    }

    pub(crate) fn contains(&self, geom: usize) -> bool {
        self.has_picture && self.is_cached[geom]
    }

    pub(crate) fn store(&mut self, picture: &Picture) {
        let visible = &picture.visible;
        self.instances.clone_from(&picture.instances);
        self.records.clone_from(&visible.records);
        self.clipped.clone_from(&visible.clipped);
        self.depths.clone_from(&visible.depths);
        self.ids.clone_from(&visible.ids);
        self.samples.clone_from(&picture.samples);
    }

    pub(crate) fn restore_all(&self, picture: &mut Picture) {
        let size = self.last.as_ref().map_or([0; 2], |(_, size)| *size);
        picture.instances.clone_from(&self.instances);
        picture.samples.clone_from(&self.samples);
        let visible = &mut picture.visible;
        visible.resize(size);
        visible.records.clone_from(&self.records);
        visible.clipped.clone_from(&self.clipped);
        visible.depths.clone_from(&self.depths);
        visible.ids.clone_from(&self.ids);
        visible.touched = None;
        visible.invalidate_bounds();
    }

    /// Restores a window; elsewhere, the picture must equal the cached picture already.
    pub(crate) fn restore(&self, picture: &mut Picture, window: Option<Window>) {
        let visible = &mut picture.visible;
        for row in window.into_iter().flat_map(|window| window.rows(visible.stride)) {
            let samples = row.start * SAMPLES..row.end * SAMPLES;
            visible.depths[samples.clone()].copy_from_slice(&self.depths[samples.clone()]);
            visible.ids[samples.clone()].copy_from_slice(&self.ids[samples]);
            picture.samples[row.clone()].copy_from_slice(&self.samples[row]);
        }
        picture.instances.truncate(self.instances.len());
        visible.records.truncate(self.records.len());
        visible.clipped.truncate(self.clipped.len());
        visible.touched = None;
        visible.invalidate_bounds();
    }
}

/// Returns the bits of a camera for comparison; zeros of different sign are unequal.
fn camera_bits(camera: &Camera) -> ([[u32; 3]; 3], [u32; 6], bool) {
    let vectors = [camera.pos, camera.forward, camera.up];
    let numbers =
        [camera.center, camera.half_width, camera.bottom, camera.top, camera.near, camera.far];
    (vectors.map(|vector| vector.map(f32::to_bits)), numbers.map(f32::to_bits), camera.orthographic)
}

fn light_bits(light: &Light) -> ([[u32; 3]; 5], Option<[u32; 5]>) {
    let vectors = [light.pos, light.dir, light.ambient, light.diffuse, light.specular];
    let spot = match light.kind {
        LightKind::Directional => None,
        LightKind::Spot { cutoff, exponent, attenuation: [a, b, c] } => {
            Some([cutoff, exponent, a, b, c].map(f32::to_bits))
        }
    };
    (vectors.map(|vector| vector.map(f32::to_bits)), spot)
}

fn texture_bits(used: &TextureUse) -> (usize, [u32; 2], bool, bool) {
    let repeat = used.repeat.map(f32::to_bits);
    (used.texture, repeat, used.uniform, used.by_corner)
}

/// Returns true if two geoms give the same picture; zeros of different sign are unequal.
fn same_bits(a: &Geom, b: &Geom) -> bool {
    let numbers = |geom: &Geom| {
        let [px, py, pz] = geom.pos;
        let [sx, sy, sz] = geom.size;
        let mut all = [0; 24];
        let parts = geom.mat.into_iter().chain(geom.rgba).chain([
            px,
            py,
            pz,
            sx,
            sy,
            sz,
            geom.emission,
            geom.specular,
            geom.shininess,
            geom.reflectance,
            geom.reach,
        ]);
        for (bits, part) in all.iter_mut().zip(parts) {
            *bits = part.to_bits();
        }
        all
    };
    let texture = |geom: &Geom| geom.texture.as_ref().map(texture_bits);
    a.shape == b.shape && texture(a) == texture(b) && numbers(a) == numbers(b)
}
