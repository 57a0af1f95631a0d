//! Translucent geoms, blended over the geoms behind them: first from near to far, then again from
//! far to near, as in MuJoCo.

use crate::instance::{self, Instance, View, is_behind, is_plane};
use crate::matrix::{dot, minus};
use crate::picture::{Pass, Picture, Workspace};
use crate::raster;
use crate::raster::Drawing;
use crate::scene::{Geom, Scene, Shape};
use crate::shade::{self, Content, Fragment, Lists};
use crate::visible::{Layer, Layers, SAMPLES, Visible};
use crate::window::{BoundingWindow, Window};

/// Geoms with an opacity below this are translucent.
const OPAQUE_FROM: f64 = 0.995;
/// Distance assumed for planes when sorting.
const PLANE_DISTANCE: f32 = 1e10;
/// Limits of what is blended at once. The number of layers, one for each triangle in each pair of
/// pixels, has no bound; the limits keep a frame's memory to some hundred megabytes.
const MAX_PIXELS: i32 = 1 << 17;
const MAX_LAYERS: usize = 1 << 21;

/// Translucent geoms, nearest first; includes planes seen from behind.
pub(crate) fn translucent_geoms(scene: &Scene, view: &View) -> Vec<usize> {
    let mut found: Vec<(f32, usize)> = Vec::new();
    for (index, geom) in scene.geoms.iter().enumerate() {
        let shows_back = is_plane(geom) && is_behind(view.head, geom);
        if f64::from(geom.rgba[3]) >= OPAQUE_FROM && !shows_back {
            continue;
        }
        let distance = match is_plane(geom) {
            true => PLANE_DISTANCE,
            false => {
                let offset = minus(geom.pos, view.head);
                dot(offset, offset).sqrt() - reach(geom)
            }
        };
        found.push((distance, index));
    }
    found.sort_by(|a, b| a.0.total_cmp(&b.0));
    found.into_iter().map(|(_, index)| index).collect()
}

/// Returns the radius of a geom around its centre, by which MuJoCo sorts.
fn reach(geom: &Geom) -> f32 {
    let [x, y, z] = geom.size;
    match geom.shape {
        _ if geom.reach > 0.0 => geom.reach,
        Shape::Capsule => x + z,
        Shape::Cylinder => (x * x + z * z).sqrt(),
        Shape::Box => (x * x + y * y + z * z).sqrt(),
        Shape::Ellipsoid | Shape::Mesh(_) | Shape::Plane(_) | Shape::Rectangle => x.max(y).max(z),
    }
}

/// Blends geoms, which are sorted nearest first, over a picture; returns the changed window.
pub(crate) fn add(
    picture: &mut Picture,
    pass: Pass<'_>,
    geoms: &[Geom],
    work: &mut Workspace,
) -> Option<Window> {
    let mut changed = None;
    let mut pending = vec![pass.window];
    while let Some(window) = pending.pop() {
        let halves = halves(window);
        if let Some(halves) = halves.filter(|_| pixels(window) > MAX_PIXELS) {
            pending.extend(halves);
            continue;
        }
        let part = Pass { window, ..pass };
        let max_layers = halves.map_or(usize::MAX, |_| MAX_LAYERS);
        match (paint_all(picture, part, geoms, work, max_layers), halves) {
            (None, Some(halves)) => pending.extend(halves),
            (painted, _) => {
                let painted = painted.unwrap_or_default();
                changed = Window::union(changed, blend(picture, &painted));
            }
        }
    }
    changed
}

fn pixels(window: Window) -> i32 {
    (window.x[1] - window.x[0] + 1) * (window.y[1] - window.y[0] + 1)
}

/// Splits a window into halves; `None` for a single pair of pixels.
fn halves(Window { x, y }: Window) -> Option<[Window; 2]> {
    let row = y[0] + (y[1] - y[0]) / 2;
    let column = (x[0] + (x[1] - x[0]) / 2) | 1;
    match (y[0] < y[1], column < x[1]) {
        (true, _) => Some([[y[0], row], [row + 1, y[1]]].map(|y| Window { x, y })),
        (false, true) => Some([[x[0], column], [column + 1, x[1]]].map(|x| Window { x, y })),
        (false, false) => None,
    }
}

/// Fragments and colours of a geom, in drawing order.
type Painted = Vec<(Fragment, u32)>;

/// Paints all geoms in a window; `None` if they exceed the limit of layers.
fn paint_all(
    picture: &mut Picture,
    pass: Pass<'_>,
    geoms: &[Geom],
    work: &mut Workspace,
    max_layers: usize,
) -> Option<Vec<Painted>> {
    let mut remaining = max_layers;
    geoms
        .iter()
        .map(|geom| {
            let painted = paint(picture, pass, geom, work, remaining)?;
            remaining = remaining.saturating_sub(painted.len());
            Some(painted)
        })
        .collect()
}

fn blend(picture: &mut Picture, painted: &[Painted]) -> Option<Window> {
    let stride = picture.visible.stride;
    let mut window = None;
    for (fragment, colour) in painted.iter().chain(painted.iter().rev()).flatten() {
        let pixel = &mut picture.samples[fragment.y() * stride + fragment.x()];
        for (sample, under) in pixel.iter_mut().enumerate() {
            if fragment.samples() & (1 << sample) != 0 {
                *under = blended(*under, *colour);
            }
        }
        let pixel = Window::pixel(fragment.x() as i32, fragment.y() as i32);
        window = Window::union(window, Some(pixel));
    }
    window
}

/// Fragments in front of the visible samples, in drawing order; `None` beyond the limit of layers.
fn paint(
    picture: &mut Picture,
    pass: Pass<'_>,
    geom: &Geom,
    work: &mut Workspace,
    max_layers: usize,
) -> Option<Painted> {
    let Picture { instances, visible, .. } = picture;
    let before = (instances.len(), visible.records.len(), visible.clipped.len());
    instance::add(0, geom, pass.view, pass.model, instances);
    let mut layers: Vec<Layer> = Vec::new();
    for index in before.0..instances.len() {
        raster::draw(
            index,
            &mut Drawing {
                model: pass.model,
                instances,
                window: pass.window,
                plane: pass.view.clip,
                positions: &mut work.positions,
                visible,
                touched: BoundingWindow::EMPTY,
                layers: Some(Layers { list: &mut layers, max: max_layers }),
            },
        );
    }
    let painted = (layers.len() <= max_layers).then(|| {
        let surfaces = (instances.as_slice(), &*visible, before.1);
        colour(surfaces, pass, &mut layers, &mut work.lists)
    });
    instances.truncate(before.0);
    visible.records.truncate(before.1);
    visible.clipped.truncate(before.2);
    painted
}

/// Colours the layers of a geom, in drawing order.
fn colour(
    (instances, visible, first): (&[Instance], &Visible, usize),
    pass: Pass<'_>,
    layers: &mut [Layer],
    lists: &mut Lists,
) -> Painted {
    // A stable sort suffices: the pixels of one triangle do not overlap.
    layers.sort_by_key(|layer| layer.rank);
    lists.clear(first, visible.records.len(), pass.model.textures.len());
    // Colours are computed list by list; `order` restores the drawing order.
    let mut order = Vec::with_capacity(2 * layers.len());
    for layer in &*layers {
        let (surface, list) = lists.request_surface(layer.id, &visible.records, instances);
        for (pixel, samples) in [(0, layer.samples & 0xf), (1, layer.samples >> SAMPLES)] {
            // Pixels are drawn in pairs, of which one may lie outside the window.
            let x = i32::from(layer.x + pixel);
            let is_inside = (pass.window.x[0]..=pass.window.x[1]).contains(&x);
            if is_inside && samples != 0 {
                let (x, y) = (u32::from(layer.x + pixel), u32::from(layer.y));
                lists.fragments[list].push(Fragment::new(x, y, samples, surface));
                order.push((list, order.len()));
            }
        }
    }
    let content = Content::Colours(pass.light);
    shade::compute_surfaces(pass.model, visible, instances, content, lists);
    order.sort_unstable();
    let mut painted = vec![(Fragment::default(), 0); order.len()];
    let mut positions = order.into_iter();
    shade::colour(pass.model, pass.largest_levels, lists, |fragment, colour| {
        if let Some((_, position)) = positions.next() {
            painted[position] = (*fragment, colour);
        }
    });
    painted
}

/// Blends the colour `over` over the colour `under` by the opacity of `over`, in 8 bits.
fn blended(under: u32, over: u32) -> u32 {
    let (under, over) = (under.to_le_bytes(), over.to_le_bytes());
    let opacity = over[3];
    let times = |value: u8, share: u8| {
        let product = u32::from(value) * u32::from(share);
        // llvmpipe's division by 255.
        (product + (product >> 8) + 128) >> 8
    };
    u32::from_le_bytes(std::array::from_fn(|at| {
        let sum = times(over[at], opacity) + times(under[at], 255 - opacity);
        sum.min(255) as u8
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blending_with_no_or_full_opacity_keeps_one_colour() {
        let under = u32::from_le_bytes([10, 20, 30, 255]);
        let over = |opacity| u32::from_le_bytes([200, 100, 50, opacity]);
        assert_eq!(blended(under, over(0)).to_le_bytes()[..3], [10, 20, 30]);
        assert_eq!(blended(under, over(255)).to_le_bytes()[..3], [200, 100, 50]);
    }
}
