//! Fog: a plasma fractal by the diamond-square algorithm, drawn for each picture.

use crate::numpy::LegacyRng;

use super::{CHANNELS, Picture, truncated, unit};

/// Largest side of a picture, pixels; the released code fails on larger pictures.
pub(super) const SIDE: usize = 256;
/// Initial range of the fractal's random values.
const INITIAL_RANGE: f64 = 100.0;
/// Density of the fog, and divisor of the range of the random values from one step to the next,
/// by severity.
const SEVERITIES: [(f64, f64); 10] = [
    (0.5, 3.0),
    (1.0, 2.8),
    (1.5, 2.5),
    (2.0, 2.2),
    (2.5, 2.0),
    (3.0, 1.8),
    (3.5, 1.6),
    (4.0, 1.5),
    (4.5, 1.4),
    (5.0, 1.3),
];

pub(super) fn add_fog(picture: &mut Picture<'_>, severity: usize, rng: &mut LegacyRng) {
    let (density, decay) = SEVERITIES[severity];
    let map = plasma(decay, rng);
    let values = unit(picture);
    let brightest = values.iter().copied().fold(0.0, f64::max);
    let pixels = picture.rgb.as_chunks_mut::<CHANNELS>().0.iter_mut();
    for (index, (pixel, values)) in pixels.zip(values.as_chunks::<CHANNELS>().0).enumerate() {
        let (row, column) = (index / picture.width, index % picture.width);
        let fog = density * map[row * SIDE + column];
        for (byte, value) in pixel.iter_mut().zip(values) {
            let value = (value + fog) * brightest / (brightest + density);
            *byte = truncated(value.clamp(0.0, 1.0) * 255.0);
        }
    }
}

pub(super) fn skip(rng: &mut LegacyRng) {
    for _ in 1..SIDE * SIDE {
        rng.random_sample();
    }
}

/// Draws a map of numbers in [0, 1]. Every point except the corner takes one draw.
fn plasma(decay: f64, rng: &mut LegacyRng) -> Vec<f64> {
    let mut map = vec![0.0; SIDE * SIDE];
    let mut step = SIDE;
    let mut range = INITIAL_RANGE;
    while step >= 2 {
        let (count, half) = (SIDE / step, step / 2);
        // Indices of the corners and the centres of the squares, which wrap around.
        let corner =
            |row: usize, column: usize| (row % count) * step * SIDE + (column % count) * step;
        let centre = |row: usize, column: usize| {
            ((row % count) * step + half) * SIDE + (column % count) * step + half
        };
        let mut fill = |map: &mut Vec<f64>, index: usize, sum: f64| {
            // The amplitude is the square of `range`, because the released code applies `range`
            // twice.
            map[index] = sum / 4.0 + range * rng.uniform(-range, range);
        };
        let squares = || (0..count).flat_map(|row| (0..count).map(move |column| (row, column)));
        for (row, column) in squares() {
            let left = map[corner(row, column)] + map[corner(row + 1, column)];
            let right = map[corner(row, column + 1)] + map[corner(row + 1, column + 1)];
            fill(&mut map, centre(row, column), left + right);
        }
        for (row, column) in squares() {
            let centres = map[centre(row, column)] + map[centre(row + count - 1, column)];
            let corners = map[corner(row, column)] + map[corner(row, column + 1)];
            fill(&mut map, corner(row, column) + half, centres + corners);
        }
        for (row, column) in squares() {
            let centres = map[centre(row, column)] + map[centre(row, column + count - 1)];
            let corners = map[corner(row, column)] + map[corner(row + 1, column)];
            fill(&mut map, corner(row, column) + half * SIDE, centres + corners);
        }
        step /= 2;
        range /= decay;
    }
    let lowest = map.iter().copied().fold(f64::INFINITY, f64::min);
    map.iter_mut().for_each(|value| *value -= lowest);
    let highest = map.iter().copied().fold(0.0, f64::max);
    map.iter_mut().for_each(|value| *value /= highest);
    map
}
