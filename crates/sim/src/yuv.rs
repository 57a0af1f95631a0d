//! Colours of videos.

/// Converts two square frames of `side` pixels, RGB with row 0 at the bottom, to one upright planar
/// 4:2:0 frame in BT.709, limited range, which shows them side by side. openh264's own conversion
/// uses the coefficients of BT.601, which would shift the colours of a stream declared as BT.709.
pub fn bt709(panes: [&[u8]; 2], side: usize) -> Vec<u8> {
    let (width, height) = (2 * side, side);
    let mut yuv = vec![0; width * height * 3 / 2];
    let (luma, chroma) = yuv.split_at_mut(width * height);
    let (blue, red) = chroma.split_at_mut(width * height / 4);
    for y in (0..height).step_by(2) {
        for x in (0..width).step_by(2) {
            let mut sum = [0.0; 3];
            for (x, y) in [(x, y), (x + 1, y), (x, y + 1), (x + 1, y + 1)] {
                let rgb = pixel(panes, side, x, y);
                luma[y * width + x] = quantise(16.0 + 219.0 * brightness(rgb));
                for (sum, channel) in sum.iter_mut().zip(rgb) {
                    *sum += channel / 4.0;
                }
            }
            let bright = brightness(sum);
            let at = y / 2 * (width / 2) + x / 2;
            blue[at] = quantise(128.0 + 224.0 * (sum[2] - bright) / 1.8556);
            red[at] = quantise(128.0 + 224.0 * (sum[0] - bright) / 1.5748);
        }
    }
    yuv
}

/// Returns red, green and blue in [0, 1] at column `x` and row `y` from the top.
fn pixel(panes: [&[u8]; 2], side: usize, x: usize, y: usize) -> [f32; 3] {
    let at = ((side - 1 - y) * side + x % side) * 3;
    let pane = panes[x / side];
    [pane[at], pane[at + 1], pane[at + 2]].map(|channel| f32::from(channel) / 255.0)
}

/// Returns the Rec. 709 luma of a colour.
fn brightness([red, green, blue]: [f32; 3]) -> f32 {
    0.2126 * red + 0.7152 * green + 0.0722 * blue
}

/// Rounds to an integer of 0..=255; the cast saturates.
fn quantise(value: f32) -> u8 {
    value.round() as u8
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIDE: usize = 8;

    fn pane(top: [u8; 3], bottom: [u8; 3]) -> Vec<u8> {
        let rows = SIDE * SIDE / 2;
        let mut pixels = bottom.repeat(rows);
        pixels.extend(top.repeat(rows));
        pixels
    }

    #[test]
    fn pictures_stand_upright_side_by_side() {
        let left = pane([255, 255, 255], [0, 0, 0]);
        let right = pane([0, 0, 0], [255, 255, 255]);
        let yuv = bt709([&left, &right], SIDE);
        let luma = |x: usize, y: usize| yuv[y * 2 * SIDE + x];
        assert_eq!([luma(0, 0), luma(7, 3), luma(0, 7)], [235, 235, 16]);
        assert_eq!([luma(8, 0), luma(15, 7)], [16, 235]);
    }

    /// Expected values: ITU-R BT.709-6, table 4, for 8 bits.
    #[test]
    fn primaries_have_the_codes_of_bt_709() {
        let check = |rgb: [u8; 3], expected: [u8; 3]| {
            let colour = pane(rgb, rgb);
            let yuv = bt709([&colour, &colour], SIDE);
            let quarter = SIDE * SIDE / 2;
            let codes = [yuv[0], yuv[4 * quarter], yuv[5 * quarter]];
            assert_eq!(codes, expected, "{rgb:?}");
        };
        check([255, 0, 0], [63, 102, 240]);
        check([0, 255, 0], [173, 42, 26]);
        check([0, 0, 255], [32, 240, 118]);
        check([128, 128, 128], [126, 128, 128]);
    }
}
