//! Reflections in a single mirror face: a plane, or a box's upper side. MuJoCo draws the mirrored
//! scene in place of the face and adds the face's own colour; this module draws the mirrored scene
//! in the window of the samples at which the face is visible in the finished picture, and adds it
//! to these samples only.

use crate::glass;
use crate::instance::{self, View, is_behind, is_plane};
use crate::light::{EyeLight, Lighting};
use crate::model::Model;
use crate::picture::{Pass, Picture, Workspace};
use crate::scene::{Geom, Scene, Shape};
use crate::shapes::is_upper_face;
use crate::visible::{Ranks, SAMPLES};
use crate::window::Window;

/// The first opaque geom that mirrors; `None` also if the camera is behind its face.
pub(crate) fn find(scene: &Scene, view: &View, translucent: &[usize]) -> Option<usize> {
    let can_mirror = |geom: &Geom| is_plane(geom) || geom.shape == Shape::Box;
    let found = (0..scene.geoms.len()).find(|index| {
        let geom = &scene.geoms[*index];
        can_mirror(geom) && geom.reflectance > 0.0 && !translucent.contains(index)
    })?;
    let (pos, _) = plane(&scene.geoms[found]);
    let face = Geom { pos, ..scene.geoms[found] };
    (scene.reflections && !is_behind(view.head, &face)).then_some(found)
}

/// Returns a point of a geom's mirror face, and the face's normal.
fn plane(geom: &Geom) -> ([f32; 3], [f32; 3]) {
    let normal = [geom.mat[2], geom.mat[5], geom.mat[8]];
    let raised = match geom.shape {
        Shape::Box => geom.size[2],
        _ => 0.0,
    };
    let pos = std::array::from_fn(|axis| geom.pos[axis] + raised * normal[axis]);
    (pos, normal)
}

/// Draws the reflection into `reflection` first; returns the changed window.
pub(crate) fn add(
    picture: &mut Picture,
    reflection: &mut Picture,
    pass: Pass<'_>,
    scene: &Scene,
    (mirror, translucent): (usize, &[usize]),
    work: &mut Workspace,
) -> Option<Window> {
    let face = Face::find(picture, pass.model, mirror, &scene.geoms[mirror])?;
    let (pos, normal) = plane(&scene.geoms[mirror]);
    let view = pass.view.in_mirror(pos, normal);
    let lights: Vec<EyeLight> = EyeLight::all(scene, &view);
    let dimmed = |index: usize| {
        let mut geom = scene.geoms[index];
        for channel in 0..3 {
            geom.rgba[channel] *= scene.geoms[mirror].reflectance;
        }
        geom
    };
    let mirrored = Pass { view: &view, light: Lighting::all(&lights), window: face.window, ..pass };
    let size = [picture.visible.width, picture.visible.height];
    reflection.clear(size, face.window);
    for index in
        (0..scene.geoms.len()).filter(|index| *index != mirror && !translucent.contains(index))
    {
        instance::add(index, &dimmed(index), &view, pass.model, &mut reflection.instances);
    }
    reflection.rasterise(mirrored, 0, work);
    reflection.paint(mirrored, 0, work);
    let translucent: Vec<Geom> = translucent.iter().map(|index| dimmed(*index)).collect();
    glass::add(reflection, mirrored, &translucent, work);
    for (pixel, samples) in face.pixels {
        for sample in (0..SAMPLES).filter(|sample| samples & (1 << sample) != 0) {
            let reflecting = &mut picture.samples[pixel][sample];
            *reflecting = saturating_sum(*reflecting, reflection.samples[pixel][sample]);
        }
    }
    Some(face.window)
}

struct Face {
    window: Window,
    /// Pixel indices, each with the bits of its visible samples.
    pixels: Vec<(usize, u8)>,
}

impl Face {
    fn find(picture: &Picture, model: &Model, mirror: usize, geom: &Geom) -> Option<Self> {
        let visible = &picture.visible;
        let instances = picture.instances.iter();
        let bounds = instances
            .filter(|instance| instance.geom == mirror)
            .fold(None, |bounds, instance| Window::union(bounds, instance.window))?;
        let ranks = Ranks {
            model,
            instances: &picture.instances,
            records: &visible.records,
            clipped: &visible.clipped,
        };
        let shows_mirror = |sample: usize| {
            let record = visible.records.get(visible.ids[sample] as usize);
            record.is_some_and(|record| {
                picture.instances[record.instance as usize].geom == mirror
                    && (geom.shape != Shape::Box || is_upper_face(ranks.rank(record).1))
            })
        };
        let mut pixels = Vec::new();
        let mut window = None;
        for (row, y) in bounds.rows(visible.stride).zip(bounds.y[0]..) {
            for (pixel, x) in row.zip(bounds.x[0]..) {
                let samples = (0..SAMPLES)
                    .filter(|sample| shows_mirror(pixel * SAMPLES + sample))
                    .fold(0, |bits, sample| bits | 1 << sample);
                if samples != 0 {
                    pixels.push((pixel, samples));
                    window = Window::union(window, Some(Window::pixel(x, y)));
                }
            }
        }
        window.map(|window| Self { window, pixels })
    }
}

pub(crate) fn saturating_sum(a: u32, b: u32) -> u32 {
    let (a, b) = (a.to_le_bytes(), b.to_le_bytes());
    u32::from_le_bytes(std::array::from_fn(|at| a[at].saturating_add(b[at])))
}
