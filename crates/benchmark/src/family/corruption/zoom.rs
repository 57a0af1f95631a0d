//! Zoom blur: the mean of the picture and of magnifications of its centre by increasing
//! factors, in single precision like `scipy.ndimage.zoom` of order 1.

use super::{CHANNELS, Picture};

/// End and step of the factors, which begin at 1, by severity. As in `numpy.arange`, rounding
/// decides whether the end is included.
const SEVERITIES: [(f64, f64); 10] = [
    (1.11, 0.01),
    (1.16, 0.01),
    (1.21, 0.02),
    (1.26, 0.02),
    (1.31, 0.03),
    (1.36, 0.01),
    (1.41, 0.01),
    (1.46, 0.02),
    (1.51, 0.02),
    (1.56, 0.03),
];

pub(super) fn blur(picture: &mut Picture<'_>, severity: usize) {
    let side = picture.height;
    let bytes = picture.rgb.iter();
    let values: Vec<f32> = bytes.map(|byte| (f64::from(*byte) / 255.0) as f32).collect();
    let factors = factors(severity);
    let mut sum = vec![0.0_f32; values.len()];
    for factor in &factors {
        add_magnified(&mut sum, &values, side, *factor);
    }
    let count = (factors.len() + 1) as f32;
    for (byte, (value, sum)) in picture.rgb.iter_mut().zip(values.iter().zip(sum)) {
        *byte = (((value + sum) / count).clamp(0.0, 1.0) * 255.0) as u8;
    }
}

/// Returns `numpy.arange(1, end, step)`.
fn factors(severity: usize) -> Vec<f64> {
    let (end, step) = SEVERITIES[severity];
    let count = ((end - 1.0) / step).ceil() as u32;
    let delta = (1.0 + step) - 1.0;
    (0..count).map(|index| 1.0 + f64::from(index) * delta).collect()
}

fn add_magnified(sum: &mut [f32], values: &[f32], side: usize, factor: f64) {
    let cropped = (side as f64 / factor).ceil() as usize;
    let margin = (side - cropped) / 2;
    let magnified = (cropped as f64 * factor).round_ties_even() as usize;
    let trimmed = magnified.saturating_sub(side) / 2;
    let scale = (cropped - 1) as f64 / (magnified - 1) as f64;
    // For each output pixel: the two neighbours and the weight of the second.
    let sources: Vec<(usize, usize, f64)> = (0..side)
        .map(|index| {
            let position = (index + trimmed) as f64 * scale;
            let first = position.floor() as usize;
            let second = (first + 1).min(cropped - 1);
            (margin + first, margin + second, position - position.floor())
        })
        .collect();
    for (row, (above, below, down)) in sources.iter().enumerate() {
        for (column, (left, right, across)) in sources.iter().enumerate() {
            for channel in 0..CHANNELS {
                let value = |row: &usize, column: &usize| {
                    f64::from(values[(row * side + column) * CHANNELS + channel])
                };
                let mut mean = value(above, left) * (1.0 - down) * (1.0 - across);
                mean += value(above, right) * (1.0 - down) * across;
                mean += value(below, left) * down * (1.0 - across);
                mean += value(below, right) * down * across;
                sum[(row * side + column) * CHANNELS + channel] += mean as f32;
            }
        }
    }
}
