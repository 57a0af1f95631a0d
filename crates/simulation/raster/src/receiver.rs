//! Places of visible surfaces in a light's shadow map.

use crate::instance::View;
use crate::lanes::F;
use crate::matrix::Matrix;

/// Four planes in the eye's frame. The distances of a position from them are its coordinates in a
/// shadow map: column, row, depth, and the number by which these three are divided.
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

    /// Returns the coordinates of eight positions in the eye's frame.
    #[inline(always)]
    pub(crate) fn place(&self, [x, y, z]: [F; 3]) -> [F; 4] {
        self.0.map(|plane| {
            let [a, b, c, d] = plane.map(F::splat);
            d + z * c + y * b + x * a
        })
    }
}
