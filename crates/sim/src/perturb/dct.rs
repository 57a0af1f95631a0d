//! The 8 × 8 discrete cosine transform and its inverse in integers, bit-identical to libjpeg's
//! "islow".

/// Samples or coefficients, row by row.
pub(super) type Block = [i32; 64];

const FACTOR_BITS: u32 = 13;
/// Fractional bits kept between the two passes.
const PASS_BITS: u32 = 2;

// Sums of cosines, √2 · cos(kπ/16), with 13 fractional bits.
const F_0_298: i32 = 2446;
const F_0_390: i32 = 3196;
const F_0_541: i32 = 4433;
const F_0_765: i32 = 6270;
const F_0_899: i32 = 7373;
const F_1_175: i32 = 9633;
const F_1_501: i32 = 12299;
const F_1_847: i32 = 15137;
const F_1_961: i32 = 16069;
const F_2_053: i32 = 16819;
const F_2_562: i32 = 20995;
const F_3_072: i32 = 25172;

/// Returns coefficients, scaled by eight, of samples centred at zero.
pub(super) fn forward(samples: &Block) -> Block {
    let mut block = *samples;
    for row in 0..8 {
        transform_line(&mut block, 8 * row, 1, forward_line, FACTOR_BITS - PASS_BITS);
    }
    for column in 0..8 {
        transform_line(&mut block, column, 8, forward_line, FACTOR_BITS + PASS_BITS);
    }
    block
}

/// Returns samples centred at zero from unscaled coefficients.
pub(super) fn inverse(coefficients: &Block) -> Block {
    let mut block = *coefficients;
    for column in 0..8 {
        transform_line(&mut block, column, 8, inverse_line, FACTOR_BITS - PASS_BITS);
    }
    for row in 0..8 {
        let shift = FACTOR_BITS + PASS_BITS + 3;
        transform_line(&mut block, 8 * row, 1, inverse_line, shift);
    }
    block
}

/// Transforms one row or column of a block, and divides by 2 to the power of `shift`, rounded.
fn transform_line(
    block: &mut Block,
    start: usize,
    stride: usize,
    line: fn([i32; 8]) -> [i32; 8],
    shift: u32,
) {
    let transformed = line(std::array::from_fn(|i| block[start + i * stride]));
    for (i, value) in transformed.into_iter().enumerate() {
        block[start + i * stride] = (value + (1 << (shift - 1))) >> shift;
    }
}

/// Transforms a row or column; the results have 13 fractional bits.
fn forward_line(x: [i32; 8]) -> [i32; 8] {
    let sum: [i32; 4] = std::array::from_fn(|i| x[i] + x[7 - i]);
    let [d7, d6, d5, d4]: [i32; 4] = std::array::from_fn(|i| x[i] - x[7 - i]);
    let (outer, outer_d) = (sum[0] + sum[3], sum[0] - sum[3]);
    let (inner, inner_d) = (sum[1] + sum[2], sum[1] - sum[2]);
    let even = (outer_d + inner_d) * F_0_541;
    let [o7, o5, o3, o1] = odd_part([d4, d5, d6, d7]);
    [
        (outer + inner) << FACTOR_BITS,
        o1,
        even + outer_d * F_0_765,
        o3,
        (outer - inner) << FACTOR_BITS,
        o5,
        even - inner_d * F_1_847,
        o7,
    ]
}

/// Inverts the transform of a row or column of integers; the results have 13 fractional bits.
fn inverse_line(x: [i32; 8]) -> [i32; 8] {
    let even = (x[2] + x[6]) * F_0_541;
    let (e2, e3) = (even - x[6] * F_1_847, even + x[2] * F_0_765);
    let (e0, e1) = ((x[0] + x[4]) << FACTOR_BITS, (x[0] - x[4]) << FACTOR_BITS);
    let even = [e0 + e3, e1 + e2, e1 - e2, e0 - e3];
    let [o0, o1, o2, o3] = odd_part([x[7], x[5], x[3], x[1]]);
    let odd = [o3, o2, o1, o0];
    std::array::from_fn(|i| if i < 4 { even[i] + odd[i] } else { even[7 - i] - odd[7 - i] })
}

/// Computes the rotations for the odd coefficients, which the transform and its inverse share.
fn odd_part([a, b, c, d]: [i32; 4]) -> [i32; 4] {
    let common = (a + c + b + d) * F_1_175;
    let ad = -(a + d) * F_0_899;
    let bc = -(b + c) * F_2_562;
    let ac = common - (a + c) * F_1_961;
    let bd = common - (b + d) * F_0_390;
    [a * F_0_298 + ad + ac, b * F_2_053 + bc + bd, c * F_3_072 + bc + ac, d * F_1_501 + ad + bd]
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::PI;

    fn sample_block() -> Block {
        std::array::from_fn(|i| (i as i32 * 37 + 11) % 256 - 128)
    }

    #[test]
    fn forward_is_the_cosine_transform_times_eight() {
        let samples = sample_block();
        let coefficients = forward(&samples);
        let scale = |k: usize| if k == 0 { 0.5_f64.sqrt() } else { 1.0 };
        let cosine = |k: usize, n: usize| ((2 * n + 1) as f64 * k as f64 * PI / 16.0).cos();
        for (i, &coefficient) in coefficients.iter().enumerate() {
            let (v, u) = (i / 8, i % 8);
            let sum: f64 =
                (0..64).map(|j| samples[j] as f64 * cosine(v, j / 8) * cosine(u, j % 8)).sum();
            let exact = 8.0 * 0.25 * scale(u) * scale(v) * sum;
            assert!((coefficient as f64 - exact).abs() < 2.0, "{i}: {coefficient} {exact}");
        }
    }

    #[test]
    fn inverse_undoes_forward() {
        let samples = sample_block();
        let coefficients = forward(&samples).map(|c| (c + 4) >> 3);
        for (value, expected) in inverse(&coefficients).into_iter().zip(samples) {
            assert!((value - expected).abs() <= 1, "{value} {expected}");
        }
    }
}
