//! Preprocessing of pictures: halves the resolution and separates the colours into three planes.

use crate::student::query::PICTURE_SIDE;

/// Pixels along a side of the network's input.
pub(crate) const SIDE: usize = PICTURE_SIDE / 2;

/// Network input for each byte: -1 for 0, 1 for 255.
const VALUES: [f32; 256] = {
    let mut values = [0.0; 256];
    let mut byte = 0;
    while byte < values.len() {
        values[byte] = byte as f32 / 127.5 - 1.0;
        byte += 1;
    }
    values
};

/// Converts `rgb` (256 x 256 pixels, row 0 at the bottom) to red, green and blue planes of
/// 128 x 128 numbers, row 0 at the top. Each number is the rounded mean of four bytes, mapped from
/// 0..=255 to -1..=1.
pub(crate) fn planes(rgb: &[u8], planes: &mut Vec<f32>) {
    const WIDTH: usize = PICTURE_SIDE * 3;
    planes.resize(3 * SIDE * SIDE, 0.0);
    let (red, rest) = planes.split_at_mut(SIDE * SIDE);
    let (green, blue) = rest.split_at_mut(SIDE * SIDE);
    for row in 0..SIDE {
        let (upper, lower) = (PICTURE_SIDE - 1 - 2 * row, PICTURE_SIDE - 2 - 2 * row);
        let (upper, _) = rgb[upper * WIDTH..][..WIDTH].as_chunks::<6>();
        let (lower, _) = rgb[lower * WIDTH..][..WIDTH].as_chunks::<6>();
        for (column, (upper, lower)) in upper.iter().zip(lower).enumerate() {
            let value = |channel: usize| {
                let four = [upper[channel], upper[channel + 3], lower[channel], lower[channel + 3]];
                let sum: u16 = four.into_iter().map(u16::from).sum();
                VALUES[usize::from((sum + 2) / 4)]
            };
            let index = row * SIDE + column;
            red[index] = value(0);
            green[index] = value(1);
            blue[index] = value(2);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::student::query::PICTURE_BYTES;

    #[test]
    fn planes_start_with_the_top_row_and_average_four_bytes() {
        let mut rgb = vec![0; PICTURE_BYTES];
        // The four pixels of the upper right corner: the last two of the top row, which is the last
        // row on the wire, and the last two of the row below.
        let pixel = |x: usize, y: usize| (y * PICTURE_SIDE + x) * 3;
        for (start, byte) in [
            (pixel(254, 255), 255),
            (pixel(255, 255), 1),
            (pixel(254, 254), 1),
            (pixel(255, 254), 1),
        ] {
            rgb[start + 1] = byte;
        }
        let mut found = Vec::new();
        planes(&rgb, &mut found);
        // (255 + 1 + 1 + 1 + 2) / 4 = 65
        assert_eq!(found[SIDE * SIDE + SIDE - 1], 65.0 / 127.5 - 1.0);
        let bright = found.iter().filter(|value| **value != -1.0).count();
        assert_eq!(bright, 1);
    }

    #[test]
    fn bytes_span_minus_one_to_one() {
        assert_eq!((VALUES[0], VALUES[255]), (-1.0, 1.0));
    }
}
