//! Segmentation: the geom that is visible in the middle of every pixel, as in MuJoCo's
//! segmentation rendering: no lights, no sky, no mirrors, and no translucency.

use crate::canvas::check;
use crate::error::DrawError;
use crate::fill::FIRST_SAMPLE;
use crate::instance::{self, View};
use crate::model::Model;
use crate::picture::{Pass, Picture, Workspace};
use crate::scene::Scene;
use crate::visible::SAMPLES;
use crate::window::Window;

/// Draws the numbers that geoms have in segmentation images, row by row from the
/// lowest; none where nothing is that has one.
///
/// # Errors
/// If the scene's numbers cannot be drawn, or name what the model lacks.
pub fn segments(
    model: &Model,
    scene: &Scene,
    [width, height]: [usize; 2],
) -> Result<Vec<Option<u32>>, DrawError> {
    check(model, scene, width, height)?;
    let mut view = View::new(&scene.camera, width, height);
    // Moves the middle of each pixel to where its first sample is.
    let [x, y] = FIRST_SAMPLE.map(|place| place - 0.5);
    view.projection = view
        .projection
        .shifted([2.0 * x / width as f32, 2.0 * y / height as f32]);
    let pass = Pass {
        model,
        largest: &[],
        view: &view,
        lights: &[],
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
    let seen = |pixel: usize| {
        let record = visible.records.get(visible.ids[pixel * SAMPLES] as usize)?;
        let instance = &picture.instances[record.instance as usize];
        scene.geoms[instance.geom].segment
    };
    let rows = pass.window.rows(visible.stride);
    Ok(rows.flatten().map(seen).collect())
}
