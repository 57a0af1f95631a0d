//! Segmentation: the visible geom at the centre of every pixel, as in MuJoCo's segmentation
//! rendering, without lights, sky, mirrors and translucency.

use crate::canvas::check;
use crate::error::DrawError;
use crate::fill::FIRST_SAMPLE;
use crate::instance::{self, View};
use crate::light::Lighting;
use crate::model::Model;
use crate::picture::{Pass, Picture, Workspace};
use crate::scene::Scene;
use crate::visible::SAMPLES;
use crate::window::Window;

/// Draws the segmentation ids of geoms, row by row from the bottom; `None` where no geom with an id
/// is visible. The size is the width and height in pixels.
pub fn segments(
    model: &Model,
    scene: &Scene,
    [width, height]: [usize; 2],
) -> Result<Vec<Option<u32>>, DrawError> {
    check(model, scene, width, height)?;
    let mut view = View::new(&scene.camera, width, height);
    // Shifts the picture so that each pixel's first sample lies at the pixel's centre.
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
