//! Spatial softmax: the expected position and the peak score of each channel.

/// Number of channels that locate a point.
pub(crate) const POINTS: usize = 64;
/// Side of the planes of the last features, which [`enlarged`] doubles.
pub(crate) const SIDE: usize = 16;

/// Writes the expected column and row, from -1 to 1, and the highest score of each channel of
/// `scores` (planes of `WIDTH` x `WIDTH`): first all columns, then all rows, then all scores.
pub(crate) fn locate<const WIDTH: usize>(scores: &[f32], found: &mut [f32]) {
    let (columns, rest) = found.split_at_mut(POINTS);
    let (rows, peaks) = rest.split_at_mut(POINTS);
    let planes = scores.chunks_exact(WIDTH * WIDTH);
    for (channel, scores) in planes.enumerate() {
        let peak = scores.iter().copied().fold(f32::NEG_INFINITY, higher);
        let mut in_column = [0.0; WIDTH];
        let mut in_row = [0.0; WIDTH];
        let (lines, _) = scores.as_chunks::<WIDTH>();
        for (line, in_row) in lines.iter().zip(&mut in_row) {
            for (score, in_column) in line.iter().zip(&mut in_column) {
                let weight = libm::expf(score - peak);
                *in_column += weight;
                *in_row += weight;
            }
        }
        let total: f32 = in_row.iter().fold(0.0, |sum, weight| sum + weight);
        columns[channel] = centre(&in_column) / total;
        rows[channel] = centre(&in_row) / total;
        peaks[channel] = peak;
    }
}

/// Upsamples planes of [`SIDE`] x [`SIDE`] to twice the side by nearest neighbour.
pub(crate) fn enlarged(planes: &[f32]) -> Vec<f32> {
    let mut large = Vec::with_capacity(4 * planes.len());
    let (lines, _) = planes.as_chunks::<SIDE>();
    for line in lines {
        let start = large.len();
        large.extend(line.iter().flat_map(|value| [*value; 2]));
        large.extend_from_within(start..);
    }
    large
}

/// Returns the higher of two scores; the first if they are equal, also for zeros of different
/// signs.
fn higher(first: f32, second: f32) -> f32 {
    if second > first { second } else { first }
}

/// Returns the sum of weights times coordinates, which range from -1 to 1.
fn centre<const WIDTH: usize>(weights: &[f32; WIDTH]) -> f32 {
    let mut sum = 0.0;
    for (place, weight) in weights.iter().enumerate() {
        sum += weight * (-1.0 + 2.0 * place as f32 / (WIDTH - 1) as f32);
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_lone_peak_is_located_and_equal_scores_lie_in_the_middle() {
        let mut scores = vec![0.0; POINTS * SIDE * SIDE];
        scores[5 * SIDE * SIDE + 2 * SIDE + 15] = 80.0;
        let mut found = vec![0.0; 3 * POINTS];
        locate::<SIDE>(&scores, &mut found);
        let at = |channel: usize| [0, 1, 2].map(|figure| found[figure * POINTS + channel]);
        let [column, row, peak] = at(5);
        assert!((column - 1.0).abs() < 1e-6, "{column}");
        assert!((row - (-1.0 + 4.0 / 15.0)).abs() < 1e-6, "{row}");
        assert_eq!(peak, 80.0);
        let [column, row, peak] = at(6);
        assert!(column.abs() < 1e-6 && row.abs() < 1e-6, "{column} {row}");
        assert_eq!(peak, 0.0);
    }
}
