//! `numpy.random.default_rng`: an integer seed spread by `SeedSequence`, the
//! generator PCG64 (XSL-RR 128/64), and the ziggurat normal on top of it.

use super::unit_from_bits;
use super::ziggurat::standard_normal;

/// Multiplier of PCG64's 128-bit state.
const PCG_MULTIPLIER: u128 = 0x2360_ed05_1fc6_5da4_4385_df64_9fcc_f645;
/// 32-bit words of the pool of `SeedSequence`.
const POOL_WORDS: usize = 4;

/// NumPy's current generator. The same seed and sequence of calls give the same values as
/// `numpy.random.default_rng(seed)`.
#[derive(Clone)]
pub struct DefaultRng {
    state: u128,
    increment: u128,
}

impl DefaultRng {
    /// `default_rng(seed)` for a non-negative integer seed.
    pub fn seed(seed: impl Into<u128>) -> Self {
        let [state_high, state_low, stream_high, stream_low] = seed_words(seed.into());
        let initial_state = join(state_high, state_low);
        let mut rng = Self { state: 0, increment: (join(stream_high, stream_low) << 1) | 1 };
        rng.step();
        rng.state = rng.state.wrapping_add(initial_state);
        rng.step();
        rng
    }

    /// `random()`: uniform in [0, 1).
    pub fn random(&mut self) -> f64 {
        unit_from_bits(self.next_u64())
    }

    /// `uniform(low, high)` = `low + (high - low) * random()`.
    pub fn uniform(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.random()
    }

    /// `normal(mean, deviation)` = `mean + deviation * standard_normal()`.
    pub fn normal(&mut self, mean: f64, deviation: f64) -> f64 {
        mean + deviation * self.standard_normal()
    }

    /// `standard_normal()`, by a ziggurat of 256 layers.
    pub fn standard_normal(&mut self) -> f64 {
        standard_normal(|| self.next_u64())
    }

    fn next_u64(&mut self) -> u64 {
        self.step();
        let folded = (self.state >> 64) as u64 ^ self.state as u64;
        folded.rotate_right((self.state >> 122) as u32)
    }

    fn step(&mut self) {
        self.state = self.state.wrapping_mul(PCG_MULTIPLIER).wrapping_add(self.increment);
    }
}

fn join(high: u64, low: u64) -> u128 {
    u128::from(high) << 64 | u128::from(low)
}

/// Hash of `SeedSequence`, whose constant changes with every word. The initial constants and the
/// multipliers are NumPy's.
struct WordHash {
    constant: u32,
    multiplier: u32,
}

impl WordHash {
    fn digest(&mut self, word: u32) -> u32 {
        let word = word ^ self.constant;
        self.constant = self.constant.wrapping_mul(self.multiplier);
        let word = word.wrapping_mul(self.constant);
        word ^ (word >> 16)
    }
}

/// `SeedSequence(seed).generate_state(4, uint64)`.
fn seed_words(seed: u128) -> [u64; 4] {
    let pool = entropy_pool(seed);
    let mut output = WordHash { constant: 0x8b51_f9dd, multiplier: 0x58f3_8ded };
    let mut next = |i: usize| u64::from(output.digest(pool[i % POOL_WORDS]));
    std::array::from_fn(|i| next(2 * i) | next(2 * i + 1) << 32)
}

/// Mixes the seed's 32-bit words into a pool of four words, which a seed of up to 128 bits
/// does not overflow.
fn entropy_pool(seed: u128) -> [u32; POOL_WORDS] {
    let mut input = WordHash { constant: 0x43b0_d7e5, multiplier: 0x931e_8875 };
    let mut pool: [u32; POOL_WORDS] =
        std::array::from_fn(|i| input.digest((seed >> (32 * i)) as u32));
    for source in 0..POOL_WORDS {
        for target in 0..POOL_WORDS {
            if source != target {
                let digest = input.digest(pool[source]);
                pool[target] = mix(pool[target], digest);
            }
        }
    }
    pool
}

fn mix(x: u32, y: u32) -> u32 {
    let mixed = x.wrapping_mul(0xca01_f9dd).wrapping_sub(y.wrapping_mul(0x4973_f715));
    mixed ^ (mixed >> 16)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn check(seed: u64, six_normals: [f64; 6], angle: f64, sum_of_100_000: f64) {
        let mut rng = DefaultRng::seed(seed);
        let normals: [f64; 6] = std::array::from_fn(|_| rng.normal(0.0, 1.0));
        assert_eq!(normals, six_normals, "seed {seed}");
        assert_eq!(rng.uniform(0.0, std::f64::consts::PI), angle, "seed {seed}");

        // NumPy sums pairwise, this test sequentially; the sums agree up to rounding.
        let mut rng = DefaultRng::seed(seed);
        let sum: f64 = (0..100_000).map(|_| rng.standard_normal()).sum();
        assert!((sum - sum_of_100_000).abs() < 1e-9, "seed {seed}: {sum}");
    }

    /// Values of NumPy 2.4.6; the last seed is wider than 32 bits.
    #[test]
    fn normals_and_uniforms_equal_numpys() {
        check(
            0,
            [
                0.1257302210933933,
                -0.1321048632913019,
                0.6404226504432821,
                0.10490011715303971,
                -0.535669373161111,
                0.36159505490948474,
            ],
            1.9058024965549174,
            -90.82507731206121,
        );
        check(
            20_260_904,
            [
                1.517923536380196,
                -1.2732520112276784,
                0.7968718311840443,
                -0.19497453628744288,
                0.41476403853923177,
                0.028851567858211382,
            ],
            1.7100609151587036,
            609.8473073914503,
        );
        check(
            4_294_972_295,
            [
                -0.8394566774098134,
                -0.2959060831182642,
                -0.1393980863951821,
                0.34370976459047853,
                0.04942574339059489,
                0.9485350959456589,
            ],
            2.690527821987903,
            518.6168678606837,
        );
    }
}
