//! The standard normal by a ziggurat of 256 layers, as NumPy samples it, over
//! any source of 64-bit words.

use super::unit_from_bits;
use super::ziggurat_tables::{ACCEPT_BELOW, DENSITY, INV_RIGHT_EDGE, RIGHT_EDGE, WIDTH};

/// Draws a standard normal; 98.8 % of draws take one word.
pub(crate) fn standard_normal(mut next_word: impl FnMut() -> u64) -> f64 {
    loop {
        let bits = next_word();
        let layer = (bits & 0xff) as usize;
        let is_negative = (bits >> 8) & 1 == 1;
        let magnitude = (bits >> 9) & 0x000f_ffff_ffff_ffff;
        let distance = magnitude as f64 * WIDTH[layer];
        let x = if is_negative { -distance } else { distance };
        if magnitude < ACCEPT_BELOW[layer] {
            return x;
        }
        if layer == 0 {
            // Like NumPy, takes the sign of the tail from a bit of the magnitude, not from
            // the sign bit.
            let distance = tail(&mut next_word);
            let is_negative = (magnitude >> 8) & 1 == 1;
            return if is_negative { -distance } else { distance };
        }
        let position = unit_from_bits(next_word());
        let height = (DENSITY[layer - 1] - DENSITY[layer]) * position + DENSITY[layer];
        if height < (-0.5 * x * x).exp() {
            return x;
        }
    }
}

/// Draws a value beyond the ziggurat's right edge.
fn tail(next_word: &mut impl FnMut() -> u64) -> f64 {
    loop {
        let x = -INV_RIGHT_EDGE * (-unit_from_bits(next_word())).ln_1p();
        let y = -(-unit_from_bits(next_word())).ln_1p();
        if y + y > x * x {
            return RIGHT_EDGE + x;
        }
    }
}
