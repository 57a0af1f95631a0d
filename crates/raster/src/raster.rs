//! From the instances of a mesh to what is visible, cluster by cluster: positions,
//! the triangles that may cover a sample, their edges, the samples.

use crate::candidates::Candidates;
use crate::clip::{self, ClippedTriangle, Cut, VARYING};
use crate::drawing::Drawing;
use crate::fill::fill;
use crate::frustum::Frustum;
use crate::lanes::LANES;
use crate::mesh::{Cluster, Mesh};
use crate::place::{Placed, place};
use crate::setup::Setup;
use crate::visible::{CLIPPED, Record};

/// Draws an instance into what is visible.
#[inline(always)]
pub(crate) fn draw(index: usize, drawing: &mut Drawing<'_>) {
    let instance = &drawing.instances[index];
    let mesh = instance.mesh.of(drawing.model);
    let frustum = Frustum::of(instance, drawing);
    if frustum.hide(mesh.bounds.center, mesh.bounds.radius) {
        return;
    }
    for cluster in &mesh.clusters {
        let faces_away = !instance.inside_out
            && match frustum.orthographic {
                true => cluster.faces_along(instance.eye),
                false => cluster.faces_away_from(instance.eye),
            };
        if faces_away || frustum.hide(cluster.bounds.center, cluster.bounds.radius) {
            continue;
        }
        let inside = drawing.plane.is_none()
            && frustum.contain(cluster.bounds.center, cluster.bounds.radius);
        draw_cluster(index, mesh, cluster, inside, drawing);
        let layers = drawing.layers.as_ref();
        if layers.is_some_and(|layers| layers.list.len() > layers.most) {
            return;
        }
    }
}

#[inline(always)]
fn draw_cluster(
    index: usize,
    mesh: &Mesh,
    cluster: &Cluster,
    inside: bool,
    drawing: &mut Drawing<'_>,
) {
    let instance = &drawing.instances[index];
    let Placed { beyond, outside } = place(instance, mesh, cluster, inside, drawing);
    if outside {
        return;
    }
    let candidates = Candidates::find(instance, mesh, cluster, drawing, beyond);
    if beyond {
        cut_off(index, mesh, cluster, drawing);
    }
    let mut setup = Setup::default();
    for first in (0..candidates.count).step_by(LANES) {
        let count = (candidates.count - first).min(LANES);
        let lanes: &[u8; LANES] = candidates.at[first..][..LANES].try_into().expect("eight");
        setup.eight(instance, mesh, cluster, drawing, lanes);
        for (lane, &triangle) in lanes[..count].iter().enumerate() {
            let triangle = cluster.first_triangle + u32::from(triangle);
            let record = Record {
                instance: index as u32,
                triangle,
                positions: cluster.first_position,
            };
            fill(lane, &setup, record, drawing);
        }
    }
}

/// Cuts off what is beyond a side of those triangles that reach there.
#[inline(never)]
fn cut_off(index: usize, mesh: &Mesh, cluster: &Cluster, drawing: &mut Drawing<'_>) {
    let first = cluster.first_triangle as usize;
    for triangle in first..first + cluster.triangles as usize {
        let beyond = mesh
            .corners
            .each_ref()
            .map(|ids| drawing.positions.beyond[usize::from(ids[triangle])]);
        let (any, all) = (
            beyond.iter().fold(0, |a, b| a | b),
            beyond.iter().fold(-1, |a, b| a & b),
        );
        if any == 0 || all != 0 {
            continue;
        }
        let corners = std::array::from_fn(|corner| mesh.position(cluster, triangle, corner));
        let instance = &drawing.instances[index];
        let size = [
            drawing.visible.width as f32 * 0.5,
            drawing.visible.height as f32 * 0.5,
        ];
        let cut = Cut {
            beyond: any,
            plane: drawing.plane,
            half: size,
        };
        let pieces = clip::clip(instance, corners, [[0.0; VARYING]; 3], &cut);
        for (piece, corners) in pieces.iter().enumerate() {
            let record = Record {
                instance: index as u32,
                triangle: drawing.visible.clipped.len() as u32,
                positions: CLIPPED,
            };
            let mut setup = Setup::default();
            if !setup.clipped(instance, corners, drawing.window) {
                continue;
            }
            drawing.visible.clipped.push(ClippedTriangle {
                triangle: triangle as u32,
                positions: cluster.first_position,
                cut,
                piece: piece as u32,
            });
            fill(0, &setup, record, drawing);
        }
    }
}
