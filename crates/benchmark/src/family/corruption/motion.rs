//! ImageMagick's motion blur: `MagickMotionBlurImage` of 6.9.11-60 with 16 bits per channel,
//! applied to a picture with 8 bits per channel.

use crate::numpy::LegacyRng;

use super::exponential::exp;
use super::{CHANNELS, Picture};

/// Radius and standard deviation of the one-sided filter, pixels, by severity.
const SEVERITIES: [(f64, f64); 10] = [
    (5.0, 2.0),
    (8.0, 3.0),
    (10.0, 4.0),
    (12.0, 5.0),
    (15.0, 6.0),
    (18.0, 8.0),
    (20.0, 10.0),
    (25.0, 12.0),
    (30.0, 15.0),
    (35.0, 20.0),
];
/// Largest magnitude of the angle, degrees.
const MAX_ANGLE: f64 = 45.0;
/// Factor between 8-bit and 16-bit channel values.
const QUANTA: u32 = 257;

pub(super) fn blur(picture: &mut Picture<'_>, severity: usize, rng: &mut LegacyRng) {
    let (radius, sigma) = SEVERITIES[severity];
    let angle = draw_angle(rng);
    let length = 2 * radius.ceil() as usize + 1;
    let weights = weights(length, sigma);
    let offsets = offsets(length, angle);
    let (height, width) = (picture.height, picture.width);
    let source: Vec<f64> = picture.rgb.iter().map(|byte| quantum(*byte)).collect();
    let shift = |position: usize, offset: isize, end: usize| {
        position.saturating_add_signed(offset).min(end - 1)
    };
    for row in 0..height {
        for column in 0..width {
            let mut sum = [0.0; CHANNELS];
            for (weight, (right, down)) in weights.iter().zip(&offsets) {
                let index = shift(row, *down, height) * width + shift(column, *right, width);
                let pixel = &source[index * CHANNELS..][..CHANNELS];
                for (sum, value) in sum.iter_mut().zip(pixel) {
                    *sum += weight * value;
                }
            }
            let to = (row * width + column) * CHANNELS;
            for (byte, sum) in picture.rgb[to..][..CHANNELS].iter_mut().zip(sum) {
                *byte = ((sum + 0.5) as u32 / QUANTA).min(255) as u8;
            }
        }
    }
}

pub(super) fn skip(rng: &mut LegacyRng) {
    draw_angle(rng);
}

fn draw_angle(rng: &mut LegacyRng) -> f64 {
    rng.uniform(-MAX_ANGLE, MAX_ANGLE)
}

fn quantum(byte: u8) -> f64 {
    f64::from(u32::from(byte) * QUANTA)
}

/// Returns the weights of the one-sided filter, starting at the pixel itself.
fn weights(length: usize, sigma: f64) -> Vec<f64> {
    let scale = (2.0 * std::f64::consts::PI).sqrt() * sigma;
    let bell = |index: usize| {
        let distance = index as f64;
        exp(-(distance * distance) / (2.0 * sigma * sigma)) / scale
    };
    let bells: Vec<f64> = (0..length).map(bell).collect();
    let sum: f64 = bells.iter().sum();
    bells.iter().map(|bell| bell / sum).collect()
}

/// Returns the offset of each pixel of the filter, to the right and down.
fn offsets(length: usize, angle: f64) -> Vec<(isize, isize)> {
    let (sin, cos) = libm::sincos(angle.to_radians());
    let (across, along) = (length as f64 * sin, length as f64 * cos);
    let hypotenuse = libm::hypot(across, along);
    let step = |index: usize, part: f64| (index as f64 * part / hypotenuse - 0.5).ceil() as isize;
    (0..length).map(|index| (step(index, along), step(index, across))).collect()
}
