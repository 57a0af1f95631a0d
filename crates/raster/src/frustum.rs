//! View frustum of a camera, with tests whether spheres lie inside or outside the frustum.

use crate::instance::Instance;
use crate::matrix::Vec3;
use crate::raster::Drawing;

/// Planes of the view frustum, in a mesh's frame.
pub(crate) struct Frustum {
    /// Planes of the window, with a margin of one pixel, and the lengths of their normals.
    sides: [[f32; 4]; 6],
    lengths: [f32; 6],
    /// Planes of the whole picture, without a margin.
    frame: [[f32; 4]; 6],
    pub(crate) orthographic: bool,
}

impl Frustum {
    pub(crate) fn new(instance: &Instance, drawing: &Drawing<'_>) -> Self {
        let m = &instance.to_clip.0;
        let row = |row: usize| [m[row], m[row + 4], m[row + 8], m[row + 12]];
        let (x, y, z, w) = (row(0), row(1), row(2), row(3));
        let sum = |a: [f32; 4], b: [f32; 4], sign: f32| -> [f32; 4] {
            std::array::from_fn(|at| a[at] + sign * b[at])
        };
        let (half_width, half_height) =
            (drawing.visible.width as f32 * 0.5, drawing.visible.height as f32 * 0.5);
        let scaled = |row: [f32; 4], by: f32| row.map(|value| value * by);
        let side = |row: [f32; 4], at: i32, half: f32, sign: f32| {
            let place = (at as f32 - half) / half;
            sum(scaled(row, sign), scaled(w, -sign * place), 1.0)
        };
        let window = &drawing.window;
        let sides = [
            side(x, window.x[0] - 1, half_width, 1.0),
            side(x, window.x[1] + 2, half_width, -1.0),
            side(y, window.y[0] - 1, half_height, 1.0),
            side(y, window.y[1] + 2, half_height, -1.0),
            z,
            sum(w, z, -1.0),
        ];
        Self {
            frame: [
                sum(w, x, 1.0),
                sum(w, x, -1.0),
                sum(w, y, 1.0),
                sum(w, y, -1.0),
                z,
                sum(w, z, -1.0),
            ],
            lengths: sides.each_ref().map(length),
            sides,
            orthographic: w[0] == 0.0 && w[1] == 0.0 && w[2] == 0.0,
        }
    }

    pub(crate) fn contains(&self, center: Vec3, radius: f32) -> bool {
        self.frame.iter().all(|side| {
            let (distance, slack) = distance(side, center);
            distance > radius * length(side) * 1.001 + slack
        })
    }

    /// Returns true if a sphere is outside a plane of the window, by more than rounding.
    pub(crate) fn excludes(&self, center: Vec3, radius: f32) -> bool {
        self.sides.iter().zip(&self.lengths).any(|(side, length)| {
            let (distance, slack) = distance(side, center);
            distance < -(radius * length * 1.001 + slack)
        })
    }
}

/// Scaled distance, positive inside, and the bound of its rounding error.
fn distance(side: &[f32; 4], [x, y, z]: Vec3) -> (f32, f32) {
    let parts = [side[0] * x, side[1] * y, side[2] * z, side[3]];
    let slack = 1e-5 * parts.iter().map(|part| part.abs()).sum::<f32>();
    (parts.iter().sum(), slack)
}

fn length(side: &[f32; 4]) -> f32 {
    (side[0] * side[0] + side[1] * side[1] + side[2] * side[2]).sqrt()
}
