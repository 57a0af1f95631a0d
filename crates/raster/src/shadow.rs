//! Lighting by lights that cast shadows. MuJoCo first draws opaque geoms in the light of all other
//! lights. Then each light that casts shadows is added where its depth map has nothing nearer to
//! the light. Lookups in the map are neither filtered nor made per sample: a triangle in a pixel is
//! either lit or dark.

use crate::cast::{self, Lookups};
use crate::instance::View;
use crate::lanes::F;
use crate::light::{EyeLight, Lighting};
use crate::matrix::{Matrix, Vec3, cross, dot, normalized};
use crate::mirror::saturating_sum;
use crate::picture::{Pass, Picture, Workspace};
use crate::scene::{Camera, Light, LightKind, Scene, Shadows};
use crate::shade::{self, Content};
use crate::visible::SAMPLES;

/// Widest angle of a spot light's map, degrees.
const WIDEST: f32 = 160.0;
/// Opacity from which a light that casts shadows is added: 0.99 of 255, rounded up.
const LEAST_OPACITY: u32 = 253;

pub(crate) fn add_all(
    picture: &mut Picture,
    pass: Pass<'_>,
    scene: &Scene,
    casting: &[bool],
    work: &mut Workspace,
) {
    let Some(shadows) = scene.shadows else {
        return;
    };
    let lights = scene.lights.iter().zip(pass.light.lights).zip(casting);
    for ((light, in_eye), _) in lights.filter(|(_, casts)| **casts) {
        let view = view(light, shadows, &scene.camera);
        add(picture, pass, scene, (in_eye, &view, shadows.size), work);
    }
}

fn add(
    picture: &mut Picture,
    pass: Pass<'_>,
    scene: &Scene,
    (light, view, size): (&EyeLight, &View, usize),
    work: &mut Workspace,
) {
    let Some(window) = picture.visible.touched else {
        return;
    };
    let Picture { instances, visible, samples } = picture;
    let lists = &mut work.lists;
    lists.clear(0, visible.records.len(), pass.model.textures.len());
    shade::list_fragments(visible, instances, window, lists);
    let content = Content::Colours(Lighting::added_by(light));
    shade::compute_surfaces(pass.model, visible, instances, content, lists);
    let receiver = Receiver::new(pass.view, view);
    shade::compute_surfaces(pass.model, visible, instances, Content::Places(&receiver), lists);
    let mut colours = Vec::new();
    shade::colour(pass.model, pass.largest_levels, lists, |fragment, colour| {
        let record = &visible.records[fragment.surface()];
        let is_lit = instances[record.instance as usize].is_lit;
        let changes = is_lit && colour >> 24 >= LEAST_OPACITY && colour & 0xff_ffff != 0;
        colours.push(changes.then_some(colour));
    });
    let mut places = Vec::with_capacity(colours.len());
    shade::visit_places(lists, |_, place| {
        places.push(colours[places.len()].map(|_| place));
    });
    let mut lookups = Lookups::new(size, &places);
    cast::cast(scene, view, pass.model, &mut lookups);
    let lit = lookups.lit(places.len());
    let stride = visible.stride;
    let fragments = lists.fragments.iter().flatten();
    for ((fragment, colour), is_lit) in fragments.zip(colours).zip(lit) {
        let Some(colour) = colour.filter(|_| is_lit) else {
            continue;
        };
        let pixel = &mut samples[fragment.y() * stride + fragment.x()];
        for (at, sample) in pixel.iter_mut().enumerate().take(SAMPLES) {
            if fragment.samples() & (1 << at) != 0 {
                *sample = saturating_sum(*sample, colour);
            }
        }
    }
}

/// Returns the view from a light, which determines the texels and depths of its shadow map.
fn view(light: &Light, shadows: Shadows, camera: &Camera) -> View {
    let depths = [camera.near, camera.far];
    let (projection, orthographic) = match light.kind {
        LightKind::Directional => {
            let side = [-shadows.half_width, shadows.half_width];
            (Matrix::orthographic(side, side, depths), true)
        }
        LightKind::Spot { cutoff, .. } => {
            let angle = (2.0 * cutoff * shadows.cone_share).min(WIDEST);
            let half = f64::from(angle) / 360.0 * std::f64::consts::PI;
            let half = (libm::tan(half) * f64::from(camera.near)) as f32;
            let side = [-half, half];
            (Matrix::perspective(side, side, depths), false)
        }
    };
    View {
        projection,
        world_to_eye: Matrix::look_at(light.pos, light.dir, upwards(light.dir)),
        head: light.pos,
        mirrored: false,
        clip: None,
        orthographic,
        far: camera.far,
    }
}

/// Returns MuJoCo's choice of a direction that is orthogonal to a light's direction.
fn upwards(dir: Vec3) -> Vec3 {
    let across = cross(dir, [-1.0, 0.0, 0.0]);
    let is_long = f64::from(dot(across, across)) > 0.01;
    normalized(if is_long { across } else { cross(dir, [0.0, 1.0, 0.0]) })
}

/// Planes in the eye's frame. The distances from them are the coordinates in a shadow map: column,
/// row, depth, and their divisor.
#[derive(Debug)]
pub(crate) struct Receiver([[f32; 4]; 4]);

impl Receiver {
    pub(crate) fn new(eye: &View, light: &View) -> Self {
        let to_map = light.projection.times(&light.world_to_eye);
        // Maps columns and rows from the range -1 to 1 to the range 0 to 1.
        let shares = Matrix([
            0.5, 0.0, 0.0, 0.0, 0.0, 0.5, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.5, 0.5, 0.0, 1.0,
        ]);
        let to_map = shares.times(&to_map).0;
        let from_eye = eye.world_to_eye.inverse_of_affine().0;
        Self(std::array::from_fn(|row| {
            std::array::from_fn(|column| {
                let inverse = &from_eye[4 * column..][..4];
                to_map[row] * inverse[0]
                    + to_map[row + 4] * inverse[1]
                    + to_map[row + 8] * inverse[2]
                    + to_map[row + 12] * inverse[3]
            })
        }))
    }

    #[inline(always)]
    pub(crate) fn place(&self, [x, y, z]: [F; 3]) -> [F; 4] {
        self.0.map(|plane| {
            let [a, b, c, d] = plane.map(F::splat);
            d + z * c + y * b + x * a
        })
    }
}
