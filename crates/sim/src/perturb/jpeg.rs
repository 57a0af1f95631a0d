//! Effect of JPEG compression on a picture, without the bitstream: colour conversion, 4:2:0 chroma,
//! discrete cosine transform, quantisation, and their inverses. Entropy coding is lossless and left
//! out.
//!
//! The integer arithmetic is that of libjpeg's defaults, which Pillow uses: "islow" transforms,
//! quality-scaled Annex K tables, smooth chroma upsampling. A JPEG library is not used, because
//! libraries differ by more than the tolerance of the perturbation, and pictures must not depend on
//! the decoder.
//!
//! Sources: ITU-T T.81, Annex K; C. Loeffler, A. Ligtenberg and G. Moschytz,
//! "Practical fast 1-D DCT algorithms with 11 multiplications" (1989); the
//! documentation and behaviour of libjpeg-turbo.

use super::dct::{self, Block};

const SIDE: usize = 8;

/// Annex K, table K.1, row by row.
const LUMINANCE_STEPS: [u16; 64] = [
    16, 11, 10, 16, 24, 40, 51, 61, 12, 12, 14, 19, 26, 58, 60, 55, //
    14, 13, 16, 24, 40, 57, 69, 56, 14, 17, 22, 29, 51, 87, 80, 62, //
    18, 22, 37, 56, 68, 109, 103, 77, 24, 35, 55, 64, 81, 104, 113, 92, //
    49, 64, 78, 87, 103, 121, 120, 101, 72, 92, 95, 98, 112, 100, 103, 99,
];

/// Annex K, table K.2, row by row.
const CHROMINANCE_STEPS: [u16; 64] = [
    17, 18, 24, 47, 99, 99, 99, 99, 18, 21, 26, 66, 99, 99, 99, 99, //
    24, 26, 56, 99, 99, 99, 99, 99, 47, 66, 99, 99, 99, 99, 99, 99, //
    99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, //
    99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99,
];

/// Replaces an RGB picture of `width` × `height` pixels by its JPEG-compressed version at
/// `quality`, 1 to 100.
pub(super) fn round_trip(rgb: &mut [u8], width: usize, height: usize, quality: u8) {
    let [mut luminance, blue, red] = to_planes(rgb, width, height);
    luminance.quantise(&scaled(&LUMINANCE_STEPS, quality));
    let steps = scaled(&CHROMINANCE_STEPS, quality);
    let [blue, red] = [blue, red].map(|plane| {
        let mut half = plane.halved();
        half.quantise(&steps);
        half.doubled(width, height)
    });
    for (i, pixel) in rgb.chunks_exact_mut(3).enumerate() {
        let ycc = [&luminance, &blue, &red].map(|plane| i32::from(plane.samples[i]));
        pixel.copy_from_slice(&to_rgb(ycc));
    }
}

struct Plane {
    width: usize,
    height: usize,
    /// Samples per row: the width, plus the encoder's padding.
    stride: usize,
    samples: Vec<u8>,
}

impl Plane {
    /// Returns a row with its padding; the nearest row if `y` is out of range.
    fn row(&self, y: usize) -> &[u8] {
        let y = y.min(self.height - 1);
        &self.samples[y * self.stride..(y + 1) * self.stride]
    }

    /// Blocks that extend beyond the picture repeat the border.
    fn quantise(&mut self, steps: &[i32; 64]) {
        for top in (0..self.height).step_by(SIDE) {
            for left in (0..self.stride).step_by(SIDE) {
                let mut coefficients = dct::forward(&self.block(left, top));
                for (coefficient, step) in coefficients.iter_mut().zip(steps) {
                    *coefficient = quantised(*coefficient, *step);
                }
                self.set_block(left, top, &dct::inverse(&coefficients));
            }
        }
    }

    fn block(&self, left: usize, top: usize) -> Block {
        let mut block = [0; 64];
        for (y, line) in block.chunks_exact_mut(SIDE).enumerate() {
            let row = self.row(top + y);
            for (x, sample) in line.iter_mut().enumerate() {
                *sample = i32::from(row[(left + x).min(self.stride - 1)]) - 128;
            }
        }
        block
    }

    fn set_block(&mut self, left: usize, top: usize, block: &Block) {
        for y in top..self.height.min(top + SIDE) {
            for x in left..self.stride.min(left + SIDE) {
                let value = block[(y - top) * SIDE + (x - left)] + 128;
                self.samples[y * self.stride + x] = value.clamp(0, 255) as u8;
            }
        }
    }

    /// Averages 2 × 2 samples, and pads the result on the right to whole blocks. Rounding
    /// alternates between up and down along a row and its padding, so that it has no bias.
    fn halved(&self) -> Self {
        let (width, height) = (self.width.div_ceil(2), self.height.div_ceil(2));
        let stride = width.next_multiple_of(SIDE);
        let last = self.width - 1;
        let mut samples = Vec::with_capacity(stride * height);
        for y in 0..height {
            let (upper, lower) = (self.row(2 * y), self.row(2 * y + 1));
            for x in 0..stride {
                let (left, right) = ((2 * x).min(last), (2 * x + 1).min(last));
                let sum = [upper[left], upper[right], lower[left], lower[right]]
                    .map(i32::from)
                    .iter()
                    .sum::<i32>();
                let bias = 1 + (x % 2) as i32;
                samples.push(((sum + bias) >> 2) as u8);
            }
        }
        Self { width, height, stride, samples }
    }

    /// Doubles the size with a triangle filter: 9/16 of the nearest sample, 3/16 of each of its two
    /// neighbours, 1/16 of the diagonal neighbour.
    fn doubled(&self, width: usize, height: usize) -> Self {
        let mut samples = Vec::with_capacity(width * height);
        for y in 0..height {
            let near = y / 2;
            let far = if y % 2 == 0 { near.saturating_sub(1) } else { near + 1 };
            let rows = self.row(near).iter().zip(self.row(far));
            let columns: Vec<i32> =
                rows.map(|(&near, &far)| 3 * i32::from(near) + i32::from(far)).collect();
            for x in 0..width {
                let nearest = x / 2;
                let (next, rounding) = match x % 2 {
                    0 => (nearest.saturating_sub(1), 8),
                    _ => ((nearest + 1).min(self.width - 1), 7),
                };
                samples.push(((3 * columns[nearest] + columns[next] + rounding) >> 4) as u8);
            }
        }
        Self { width, height, stride: width, samples }
    }
}

/// Scales a quantisation table to a quality: unchanged at 50, all ones at 100.
fn scaled(steps: &[u16; 64], quality: u8) -> [i32; 64] {
    let quality = i32::from(quality);
    let percent = if quality < 50 { 5000 / quality } else { 200 - 2 * quality };
    steps.map(|step| ((i32::from(step) * percent + 50) / 100).clamp(1, 255))
}

/// The multiple of `step` nearest to an eighth of a coefficient: the transform scales by eight.
fn quantised(coefficient: i32, step: i32) -> i32 {
    let divisor = 8 * step;
    let magnitude = (coefficient.abs() + divisor / 2) / divisor;
    coefficient.signum() * magnitude * step
}

/// Converts a number to fixed point with 16 fractional bits.
const fn fixed(value: f64) -> i32 {
    (value * 65536.0 + 0.5) as i32
}

/// One half in fixed point with 16 fractional bits.
const HALF: i32 = 1 << 15;

/// Converts to luminance, blue difference and red difference (JFIF).
fn to_planes(rgb: &[u8], width: usize, height: usize) -> [Plane; 3] {
    let convert = |[r, g, b]: [i32; 3], offset: i32| Plane {
        width,
        height,
        stride: width,
        samples: rgb
            .chunks_exact(3)
            .map(|pixel| {
                let [red, green, blue] = [pixel[0], pixel[1], pixel[2]].map(i32::from);
                ((r * red + g * green + b * blue + offset) >> 16) as u8
            })
            .collect(),
    };
    // The blue and red differences are rounded half down, so that none of them reaches 256.
    let centre = (128 << 16) + HALF - 1;
    [
        convert([fixed(0.299), fixed(0.587), fixed(0.114)], HALF),
        convert([-fixed(0.16874), -fixed(0.33126), fixed(0.5)], centre),
        convert([fixed(0.5), -fixed(0.41869), -fixed(0.08131)], centre),
    ]
}

fn to_rgb([luminance, blue, red]: [i32; 3]) -> [u8; 3] {
    let (blue, red) = (blue - 128, red - 128);
    [
        luminance + ((fixed(1.402) * red + HALF) >> 16),
        luminance + ((-fixed(0.34414) * blue - fixed(0.71414) * red + HALF) >> 16),
        luminance + ((fixed(1.772) * blue + HALF) >> 16),
    ]
    .map(|channel| channel.clamp(0, 255) as u8)
}

#[cfg(test)]
mod tests {
    use super::*;
    use sha2::{Digest, Sha256};

    #[test]
    fn a_grey_picture_is_unchanged_at_any_quality() {
        for quality in [1, 10, 50, 75, 100] {
            let mut rgb = vec![128; 20 * 12 * 3];
            round_trip(&mut rgb, 20, 12, quality);
            assert!(rgb.iter().all(|&value| value == 128), "{quality}");
        }
    }

    #[test]
    fn loss_grows_as_quality_falls() {
        let original: Vec<u8> = (0..32 * 32 * 3).map(|i| (i * i % 251) as u8).collect();
        let loss = |quality| {
            let mut rgb = original.clone();
            round_trip(&mut rgb, 32, 32, quality);
            let pairs = rgb.iter().zip(&original);
            pairs.map(|(a, b)| u64::from(a.abs_diff(*b))).sum::<u64>()
        };
        assert!(loss(90) < loss(50) && loss(50) < loss(10));
    }

    /// The expected digests are the first eight bytes of the SHA-256 of Pillow 13's results for the
    /// same pictures, most of whose sides are not multiples of the block size.
    #[test]
    fn pictures_with_incomplete_blocks_equal_pillows_results() {
        let check = |width: usize, height: usize, quality, expected: &str| {
            let mut rgb: Vec<u8> = (0..width * height * 3).map(|i| (i * i % 251) as u8).collect();
            round_trip(&mut rgb, width, height, quality);
            let digest = hex::encode(&Sha256::digest(&rgb)[..8]);
            assert_eq!(digest, expected, "{width} x {height} at {quality}");
        };
        check(32, 20, 10, "961d1c801cfe51f4");
        check(32, 20, 50, "4a796c25737e983c");
        check(32, 20, 90, "199a9bf85eb6c829");
        check(17, 23, 10, "2d000ed85fbb20e4");
        check(17, 23, 50, "4f97f96b4b6700f8");
        check(17, 23, 90, "9ef42352256512bd");
        check(6, 5, 10, "cd42607d9b0a4576");
        check(6, 5, 50, "6ad34b72f60a74a6");
        check(6, 5, 90, "d5d958767693b7e7");
    }

    /// The transforms fit in 32 bits even for extreme pictures.
    #[test]
    fn black_and_white_noise_does_not_overflow() {
        let mut word = 1_u32;
        for quality in [1, 25, 100] {
            let mut rgb: Vec<u8> = (0..64 * 64 * 3)
                .map(|_| {
                    word = word.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                    if word >> 31 == 0 { 0 } else { 255 }
                })
                .collect();
            round_trip(&mut rgb, 64, 64, quality);
        }
    }
}
