//! Pipeline from mesh instances to visible samples, cluster by cluster: positions, candidate
//! triangles, edges, samples.

use crate::candidates::Candidates;
use crate::clip::{self, ClippedTriangle, Clipping, Viewport};
use crate::fill::fill;
use crate::frustum::Frustum;
use crate::instance::Instance;
use crate::lanes::LANES;
use crate::mesh::{Cluster, Mesh};
use crate::model::Model;
use crate::positions::{ClusterExtent, Positions, transform};
use crate::setup::Setup;
use crate::visible::{CLIPPED, Layers, Record, Visible};
use crate::window::{BoundingWindow, Window};

pub(crate) struct Drawing<'a> {
    pub(crate) model: &'a Model,
    pub(crate) instances: &'a [Instance],
    pub(crate) window: Window,
    /// Clip-space plane beyond which geometry is clipped.
    pub(crate) plane: Option<[f32; 4]>,
    pub(crate) positions: &'a mut Positions,
    pub(crate) visible: &'a mut Visible,
    pub(crate) touched: BoundingWindow,
    /// Receives every layer that is not behind a visible surface; without it, the nearest layer
    /// becomes visible.
    pub(crate) layers: Option<Layers<'a>>,
}

#[inline(always)]
pub(crate) fn draw(index: usize, drawing: &mut Drawing<'_>) {
    let instance = &drawing.instances[index];
    let mesh = instance.mesh.resolve(drawing.model);
    let frustum = Frustum::new(instance, drawing);
    if frustum.excludes(mesh.bounds.center, mesh.bounds.radius) {
        return;
    }
    for cluster in &mesh.clusters {
        let faces_away = !instance.inside_out
            && match frustum.orthographic {
                true => cluster.faces_along(instance.eye),
                false => cluster.faces_away_from(instance.eye),
            };
        if faces_away || frustum.excludes(cluster.bounds.center, cluster.bounds.radius) {
            continue;
        }
        let is_inside = drawing.plane.is_none()
            && frustum.contains(cluster.bounds.center, cluster.bounds.radius);
        draw_cluster(index, mesh, cluster, is_inside, drawing);
        let layers = drawing.layers.as_ref();
        if layers.is_some_and(|layers| layers.list.len() > layers.max) {
            return;
        }
    }
}

#[inline(always)]
fn draw_cluster(
    index: usize,
    mesh: &Mesh,
    cluster: &Cluster,
    is_inside: bool,
    drawing: &mut Drawing<'_>,
) {
    let instance = &drawing.instances[index];
    let ClusterExtent { is_beyond, is_outside } =
        transform(instance, mesh, cluster, is_inside, drawing);
    if is_outside {
        return;
    }
    let candidates = Candidates::find(instance, mesh, cluster, drawing, is_beyond);
    if candidates.needs_clipping != 0 {
        clip_triangles(index, mesh, cluster, candidates.needs_clipping, drawing);
    }
    let mut setup = Setup::default();
    for first in (0..candidates.count).step_by(LANES) {
        let count = (candidates.count - first).min(LANES);
        let mut rows = [[0; LANES]; 3];
        for (rows, corners) in rows.iter_mut().zip(&candidates.corners) {
            rows.copy_from_slice(&corners[first..first + LANES]);
        }
        setup.eight(drawing, &rows);
        for (lane, &triangle) in candidates.triangles[first..first + count].iter().enumerate() {
            let triangle = cluster.first_triangle + u32::from(triangle);
            let record =
                Record { instance: index as u32, triangle, vertices: cluster.first_vertex };
            fill(lane, &setup, record, drawing);
        }
    }
}

#[inline(never)]
fn clip_triangles(
    index: usize,
    mesh: &Mesh,
    cluster: &Cluster,
    mut triangles: u64,
    drawing: &mut Drawing<'_>,
) {
    let instance = &drawing.instances[index];
    let viewport = Viewport::whole([drawing.visible.width, drawing.visible.height]);
    let mut setup = Setup::default();
    while triangles != 0 {
        let triangle = cluster.first_triangle as usize + triangles.trailing_zeros() as usize;
        triangles &= triangles - 1;
        let ids = mesh.position_ids.each_ref().map(|ids| ids[triangle]);
        let clipping =
            Clipping { beyond: drawing.positions.any_beyond(ids), plane: drawing.plane, viewport };
        let corners = ids.map(|id| mesh.position(cluster, id));
        let polygon = clip::clip(instance, corners, [(); 3], &clipping);
        for (piece, corners) in polygon.pieces().enumerate() {
            if !setup.clipped(instance, &corners, drawing.window) {
                continue;
            }
            let record = Record {
                instance: index as u32,
                triangle: drawing.visible.clipped.len() as u32,
                vertices: CLIPPED,
            };
            drawing.visible.clipped.push(ClippedTriangle {
                triangle: triangle as u32,
                vertices: cluster.first_vertex,
                clipping,
                piece: piece as u32,
            });
            fill(0, &setup, record, drawing);
        }
    }
}
