//! Sums in sixteen lanes, an order of summation that does not depend on the vector width.

const LANES: usize = 16;

/// Sums `term(value)` over all values. Lane `j` sums indices `j`, `j + 16`, … in ascending
/// order; the lanes are then added by halving.
///
/// # Panics
/// If the number of values is not a multiple of sixteen.
#[inline]
pub(crate) fn sum(values: &[f32], term: impl Fn(f32) -> f32) -> f32 {
    let (rows, rest) = values.as_chunks::<LANES>();
    assert!(rest.is_empty(), "{} values, not a multiple of {LANES}", values.len());
    let mut lanes = [0.0; LANES];
    for row in rows {
        for (lane, value) in lanes.iter_mut().zip(row) {
            *lane += term(*value);
        }
    }
    let mut width = LANES / 2;
    while width > 0 {
        for j in 0..width {
            lanes[j] += lanes[j + width];
        }
        width /= 2;
    }
    lanes[0]
}

pub(crate) fn mean(values: &[f32]) -> f32 {
    sum(values, |value| value) / values.len() as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_lane_is_summed_before_lanes_are_added_by_halving() {
        // A large number in lane 0 absorbs a small number in the same lane, but not the sum of
        // small numbers in another lane.
        let mut values = [0.0; 32];
        values[0] = 1.0e8;
        values[16] = 1.0;
        assert_eq!(sum(&values, |value| value), 1.0e8);
        values[16] = 0.0;
        values[1] = 3.0;
        values[17] = 3.0;
        assert_eq!(sum(&values, |value| value), 1.0e8 + 8.0);
        assert_eq!(mean(&[2.0; 48]), 2.0);
    }
}
