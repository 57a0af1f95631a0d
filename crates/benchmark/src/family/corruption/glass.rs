//! Frosted glass: pixels copied from nearby. The released code intends to swap two pixels
//! but only copies one over the other; this is reproduced.

use crate::numpy::LegacyRng;

use super::gaussian;
use super::{CHANNELS, Picture, truncated, unit};

/// Standard deviation of the blur in pixels, largest offset in pixels, and number of rounds,
/// by severity.
const SEVERITIES: [(f64, u32, u32); 10] = [
    (0.5, 1, 3),
    (0.7, 1, 3),
    (0.9, 2, 3),
    (1.0, 2, 2),
    (1.1, 3, 2),
    (1.3, 3, 2),
    (1.5, 4, 2),
    (1.8, 4, 2),
    (2.2, 5, 1),
    (2.5, 5, 1),
];

pub(super) fn blur(picture: &mut Picture<'_>, severity: usize, rng: &mut LegacyRng) {
    let (sigma, reach, rounds) = SEVERITIES[severity];
    let (height, width) = (picture.height, picture.width);
    let blurred = gaussian::blur(unit(picture), height, width, sigma);
    for (byte, value) in picture.rgb.iter_mut().zip(blurred) {
        *byte = truncated(value * 255.0);
    }
    displace(height, width, reach, rounds, rng, |from, to| {
        let from = from * CHANNELS;
        picture.rgb.copy_within(from..from + CHANNELS, to * CHANNELS);
    });
    let blurred = gaussian::blur(unit(picture), height, width, sigma);
    for (byte, value) in picture.rgb.iter_mut().zip(blurred) {
        *byte = truncated(value.clamp(0.0, 1.0) * 255.0);
    }
}

pub(super) fn skip(height: usize, width: usize, severity: usize, rng: &mut LegacyRng) {
    let (_, reach, rounds) = SEVERITIES[severity];
    displace(height, width, reach, rounds, rng, |_, _| {});
}

/// Draws pairs of pixels and calls `copy` with the source and the target of each.
fn displace(
    height: usize,
    width: usize,
    reach: u32,
    rounds: u32,
    rng: &mut LegacyRng,
    mut copy: impl FnMut(usize, usize),
) {
    let max_offset = reach as usize;
    let offset = |rng: &mut LegacyRng| rng.randint(2 * reach) as usize;
    for _ in 0..rounds {
        for row in (max_offset + 1..=height.saturating_sub(max_offset)).rev() {
            for column in (max_offset + 1..=width.saturating_sub(max_offset)).rev() {
                let from_column = column + offset(rng) - max_offset;
                let from_row = row + offset(rng) - max_offset;
                copy(from_row * width + from_column, row * width + column);
            }
        }
    }
}
