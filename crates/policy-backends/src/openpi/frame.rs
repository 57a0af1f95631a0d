//! Resizes frames as openpi's LIBERO client does, bit for bit like Pillow's bilinear filter. Pure
//! functions.
//!
//! The client would pad a frame that is not square, but the simulator's frames are square.

/// Side of the frames that openpi's LIBERO client sends, pixels.
pub const SIDE: usize = 224;
/// Fractional bits of Pillow's fixed-point weights.
const WEIGHT_BITS: u32 = 22;

/// Input pixels that contribute to one output pixel.
struct Window {
    first: usize,
    weights: Vec<i32>,
}

/// Resizes an RGB frame; sizes are width and height in pixels. Implements the two passes of
/// Pillow's bilinear filter, along rows and then along columns, with rounding to integers in
/// between. Inlined, so that a crate that resizes many frames compiles this function at its own,
/// higher optimisation level.
#[inline]
pub fn resize(rgb: &[u8], from: [usize; 2], to: [usize; 2]) -> Vec<u8> {
    if from == to {
        return rgb.to_vec();
    }
    let columns = windows(from[0], to[0]);
    let rows = rgb.chunks_exact(3 * from[0]);
    let narrow: Vec<u8> = rows.flat_map(|row| mix(&columns, row, 3)).collect();
    mix(&windows(from[1], to[1]), &narrow, 3 * to[0]).collect()
}

/// Computes one output line per window, as weighted sums of lines of `stride` bytes.
#[inline]
fn mix<'a>(windows: &'a [Window], lines: &'a [u8], stride: usize) -> impl Iterator<Item = u8> + 'a {
    windows.iter().flat_map(move |window| {
        (0..stride).map(move |at| {
            let begin = window.first * stride + at;
            let levels = lines[begin..].iter().step_by(stride);
            let weighted = levels.zip(&window.weights);
            let sum: i32 = weighted.map(|(&level, weight)| i32::from(level) * weight).sum();
            ((sum + (1 << (WEIGHT_BITS - 1))) >> WEIGHT_BITS).clamp(0, 255) as u8
        })
    })
}

/// Computes the triangle filter around each output pixel. The filter extends by one pixel of the
/// coarser grid to either side.
fn windows(from: usize, to: usize) -> Vec<Window> {
    let scale = from as f64 / to as f64;
    let support = scale.max(1.0);
    let window = |at: usize| {
        let centre = (at as f64 + 0.5) * scale;
        let first = (centre - support + 0.5).max(0.0) as usize;
        let last = ((centre + support + 0.5) as usize).min(from);
        let triangle = |pixel: usize| {
            let distance = (pixel as f64 - centre + 0.5) / support;
            (1.0 - distance.abs()).max(0.0)
        };
        let weights: Vec<f64> = (first..last).map(triangle).collect();
        let sum: f64 = weights.iter().sum();
        let fixed = |weight: &f64| (0.5 + weight / sum * f64::from(1 << WEIGHT_BITS)) as i32;
        Window { first, weights: weights.iter().map(fixed).collect() }
    };
    (0..to).map(window).collect()
}

#[cfg(test)]
mod tests {
    use sha2::{Digest, Sha256};

    use super::*;
    use crate::observations::rotated;

    // The expected values are from Pillow 13.0.0, through `resize_with_pad` of openpi-client
    // 0.1.2.

    fn pattern(side: usize) -> Vec<u8> {
        let pixel = |x: usize, y: usize| {
            let level = x * 7 + y * 13 + (x * y) / 7;
            [0, 50, 100].map(|colour| ((level + colour) % 256) as u8)
        };
        let rows = (0..side).map(|y| (0..side).map(move |x| pixel(x, y)));
        rows.flatten().flatten().collect()
    }

    #[test]
    fn a_prepared_frame_equals_that_of_openpis_client_bit_for_bit() {
        let prepared = resize(&rotated(&pattern(256)), [256; 2], [SIDE; 2]);
        let at = |x: usize, y: usize| &prepared[3 * (y * SIDE + x)..][..3];
        assert_eq!(at(0, 0), [45, 88, 138]);
        assert_eq!(at(100, 100), [105, 55, 105]);
        let digest = hex::encode(Sha256::digest(&prepared));
        assert_eq!(digest, "9a4c9d135a8b82e596068dd9c126a3bccc9514f89fa7a4e358f2cf4f526b2cf3");
    }

    #[test]
    fn edge_windows_use_only_existing_pixels() {
        let resized = [
            6, 56, 106, 15, 65, 115, 23, 73, 123, 22, 72, 122, 31, 81, 131, 39, 89, 139, 37, 87,
            137, 46, 96, 146, 55, 105, 155,
        ];
        assert_eq!(resize(&pattern(4), [4; 2], [3; 2]), resized);
    }

    #[test]
    fn a_rotated_frame_has_its_first_pixel_last() {
        let mut frame = vec![0; 3 * SIDE * SIDE];
        frame[0] = 9;
        assert_eq!(rotated(&frame)[3 * SIDE * SIDE - 3..], [9, 0, 0]);
    }

    #[test]
    fn a_frame_of_the_right_size_is_unchanged() {
        assert_eq!(resize(&[7; 3 * SIDE * SIDE], [SIDE; 2], [SIDE; 2]), vec![7; 3 * SIDE * SIDE]);
    }
}
