//! Resizes frames, bit for bit like Pillow's bilinear filter, which openpi's LIBERO client uses. Pure
//! functions.

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
