//! Gaussian blur as `skimage.filters.gaussian`: SciPy's separable filter, with sums in the
//! same order because truncation to bytes exposes the last bit.

use super::exponential::exp;
use super::{CHANNELS, Picture, truncated, unit};

/// Standard deviations by severity, pixels.
const SIGMAS: [f64; 10] = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0];
/// Radius of the filter, in standard deviations.
const TRUNCATE: f64 = 4.0;

pub(super) fn blur_picture(picture: &mut Picture<'_>, severity: usize) {
    let blurred = blur(unit(picture), picture.height, picture.width, SIGMAS[severity]);
    for (byte, value) in picture.rgb.iter_mut().zip(blurred) {
        *byte = truncated(value.clamp(0.0, 1.0) * 255.0);
    }
}

/// Applies the Gaussian filter to the columns and rows of three channels, with edge values
/// repeated.
pub(super) fn blur(values: Vec<f64>, height: usize, width: usize, sigma: f64) -> Vec<f64> {
    let weights = weights(sigma);
    let row = width * CHANNELS;
    let filtered = filter_lines(&values, &weights, height, row, |line, at| at * row + line);
    filter_lines(&filtered, &weights, width, height * CHANNELS, |line, at| {
        (line / CHANNELS) * row + at * CHANNELS + line % CHANNELS
    })
}

/// Filters `lines` lines of `length` values each; `index_of` maps a line and a position in the
/// line to an index of `values`.
fn filter_lines(
    values: &[f64],
    weights: &[f64],
    length: usize,
    lines: usize,
    index_of: impl Fn(usize, usize) -> usize,
) -> Vec<f64> {
    let radius = weights.len() - 1;
    let mut filtered = vec![0.0; values.len()];
    let mut padded = vec![0.0; length + 2 * radius];
    for line in 0..lines {
        for (index, value) in padded.iter_mut().enumerate() {
            let position = index.saturating_sub(radius).min(length - 1);
            *value = values[index_of(line, position)];
        }
        for position in 0..length {
            let centre = position + radius;
            let mut sum = padded[centre] * weights[0];
            for distance in (1..=radius).rev() {
                sum += (padded[centre - distance] + padded[centre + distance]) * weights[distance];
            }
            filtered[index_of(line, position)] = sum;
        }
    }
    filtered
}

/// Returns one half of the symmetric filter, from the centre outwards.
fn weights(sigma: f64) -> Vec<f64> {
    let radius = (TRUNCATE * sigma + 0.5) as i32;
    let factor = -0.5 / (sigma * sigma);
    let bell: Vec<f64> =
        (-radius..=radius).map(|offset| exp(factor * f64::from(offset * offset))).collect();
    let sum = pairwise_sum(&bell);
    let half = bell[radius as usize..].iter();
    half.map(|weight| weight / sum).collect()
}

/// Sums at most 128 numbers like NumPy: in eight partial sums, which are added pairwise.
fn pairwise_sum(values: &[f64]) -> f64 {
    debug_assert!(values.len() <= 128);
    let (blocks, rest) = values.as_chunks::<8>();
    let Some((first, blocks)) = blocks.split_first() else {
        return rest.iter().fold(0.0, |sum, value| sum + value);
    };
    let mut parts = *first;
    for block in blocks {
        for (part, value) in parts.iter_mut().zip(block) {
            *part += value;
        }
    }
    let [a, b, c, d, e, f, g, h] = parts;
    let sum = ((a + b) + (c + d)) + ((e + f) + (g + h));
    rest.iter().fold(sum, |sum, value| sum + value)
}
