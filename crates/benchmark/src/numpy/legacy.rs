//! `numpy.random.RandomState`: the Mersenne Twister MT19937 and the legacy
//! distributions on top of it, whose output NumPy has frozen.

pub const STATE_WORDS: usize = 624;
/// Offset of the word that a new word is combined with: `m` of MT19937.
const SHIFT_WORDS: usize = 397;

/// NumPy's legacy generator. The same seed and sequence of calls give the same values as
/// `numpy.random.RandomState(seed)`.
#[derive(Debug, Clone, PartialEq)]
pub struct LegacyRng(LegacyState);

/// State of the generator, as `numpy.random.get_state(legacy=True)` returns it
/// and `set_state` takes it, without the generator's name, which is always
/// `MT19937`.
#[derive(Debug, Clone, PartialEq)]
pub struct LegacyState {
    /// The Mersenne Twister's words.
    pub words: [u32; STATE_WORDS],
    /// Index of the next word; [`STATE_WORDS`] if all words are used.
    pub position: usize,
    /// True if `randn` returns `gauss` next.
    pub has_gauss: bool,
    /// The second value of the last polar pair.
    pub gauss: f64,
}

impl LegacyRng {
    /// Creates a generator in a given state, like `set_state`. `None` if the position
    /// exceeds [`STATE_WORDS`].
    pub fn from_state(state: LegacyState) -> Option<Self> {
        (state.position <= STATE_WORDS).then_some(Self(state))
    }

    /// Returns the current state, like `get_state(legacy=True)`.
    pub fn state(&self) -> &LegacyState {
        &self.0
    }

    /// `RandomState(seed)`, which is also `numpy.random.seed(seed)`.
    pub fn seed(seed: u32) -> Self {
        let mut words = [0; STATE_WORDS];
        words[0] = seed;
        for i in 1..STATE_WORDS {
            let previous = words[i - 1];
            words[i] =
                1_812_433_253_u32.wrapping_mul(previous ^ (previous >> 30)).wrapping_add(i as u32);
        }
        Self(LegacyState { words, position: STATE_WORDS, has_gauss: false, gauss: 0.0 })
    }

    /// `random_sample()`: uniform in [0, 1), from two 32-bit words.
    pub fn random_sample(&mut self) -> f64 {
        let upper = u64::from(self.next_u32() >> 5);
        let lower = u64::from(self.next_u32() >> 6);
        ((upper << 26) | lower) as f64 / 9_007_199_254_740_992.0
    }

    /// `uniform(low, high)` = `low + (high - low) * random_sample()`. `high < low` is
    /// allowed; LIBERO's regions rely on it.
    pub fn uniform(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.random_sample()
    }

    /// `randn()`: a standard normal by Marsaglia's polar method, which yields pairs. Every second
    /// call returns the cached second value of a pair and consumes no word.
    pub fn randn(&mut self) -> f64 {
        if std::mem::take(&mut self.0.has_gauss) {
            return std::mem::take(&mut self.0.gauss);
        }
        loop {
            let x = 2.0 * self.random_sample() - 1.0;
            let y = 2.0 * self.random_sample() - 1.0;
            let squared_radius = x * x + y * y;
            if squared_radius < 1.0 && squared_radius != 0.0 {
                let scale = (-2.0 * squared_radius.ln() / squared_radius).sqrt();
                self.0.has_gauss = true;
                self.0.gauss = scale * x;
                return scale * y;
            }
        }
    }

    /// `randint(n)`: uniform in `0..n`, by rejection from the smallest bit
    /// mask that covers the range. `randint(1)` is 0 and consumes no word.
    ///
    /// # Panics
    /// If `n` is 0.
    pub fn randint(&mut self, n: u32) -> u32 {
        assert!(n > 0, "randint needs a non-empty range");
        let largest = n - 1;
        if largest == 0 {
            return 0;
        }
        let mask = u32::MAX >> largest.leading_zeros();
        loop {
            let candidate = self.next_u32() & mask;
            if candidate <= largest {
                return candidate;
            }
        }
    }

    fn next_u32(&mut self) -> u32 {
        if self.0.position == STATE_WORDS {
            self.refill();
        }
        let mut word = self.0.words[self.0.position];
        self.0.position += 1;
        word ^= word >> 11;
        word ^= (word << 7) & 0x9d2c_5680;
        word ^= (word << 15) & 0xefc6_0000;
        word ^ (word >> 18)
    }

    fn refill(&mut self) {
        let words = &mut self.0.words;
        for i in 0..STATE_WORDS {
            let joined = (words[i] & 0x8000_0000) | (words[(i + 1) % STATE_WORDS] & 0x7fff_ffff);
            let twisted = (joined >> 1) ^ if joined & 1 == 1 { 0x9908_b0df } else { 0 };
            words[i] = words[(i + SHIFT_WORDS) % STATE_WORDS] ^ twisted;
        }
        self.0.position = 0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Values of NumPy 2.4.6's `RandomState(20260904)`: `randn(7)`, then
    /// `uniform(-0.01, 0.01, 4)`, `randint(3, size=6)`, `randint(1)`,
    /// `uniform(0.4, -0.2)` and `random_sample(3)`.
    #[test]
    fn a_sequence_of_mixed_calls_equals_numpys() {
        let mut rng = LegacyRng::seed(20_260_904);
        let normals: Vec<f64> = (0..7).map(|_| rng.randn()).collect();
        assert_eq!(
            normals,
            [
                -0.7336173942245888,
                -0.46159713058071433,
                -1.758007496510239,
                -0.5632358068913206,
                0.8783533095588868,
                -0.7036896685440318,
                -0.016046815496486323
            ]
        );
        let uniforms: Vec<f64> = (0..4).map(|_| rng.uniform(-0.01, 0.01)).collect();
        assert_eq!(
            uniforms,
            [
                0.00805773770789255,
                -0.00031640391633912593,
                0.006866469272003949,
                0.006933487345919592
            ]
        );
        let integers: Vec<u32> = (0..6).map(|_| rng.randint(3)).collect();
        assert_eq!(integers, [0, 1, 2, 1, 0, 1]);
        assert_eq!(rng.randint(1), 0);
        assert_eq!(rng.uniform(0.4, -0.2), -0.17684886975590175);
        let samples: Vec<f64> = (0..3).map(|_| rng.random_sample()).collect();
        assert_eq!(samples, [0.6148108535945562, 0.347154277697442, 0.2973511671059116]);
    }

    #[test]
    fn randint_of_one_consumes_no_word() {
        let mut rng = LegacyRng::seed(1);
        let mut clone = rng.clone();
        assert_eq!(rng.randint(1), 0);
        assert_eq!(rng.random_sample(), clone.random_sample());
    }

    /// First, second, 397th and last word, sum of all words, position, `has_gauss`, `gauss`.
    type Summary = ([u32; 4], u64, usize, bool, f64);

    fn summary(rng: &LegacyRng) -> Summary {
        let state = rng.state();
        let words = [0, 1, 396, 623].map(|index| state.words[index]);
        let sum = state.words.iter().map(|word| u64::from(*word)).sum();
        (words, sum, state.position, state.has_gauss, state.gauss)
    }

    fn synthetic_state(position: usize, has_gauss: bool, gauss: f64) -> LegacyState {
        LegacyState {
            words: std::array::from_fn(|index| (index as u32).wrapping_mul(2_654_435_761)),
            position,
            has_gauss,
            gauss,
        }
    }

    /// Values of NumPy 2.4.6's `get_state(legacy=True)`.
    #[test]
    fn the_state_equals_numpys() {
        let mut rng = LegacyRng::seed(20_260_904);
        let seeded = [20_260_904, 3_851_304_905, 396_305_077, 1_212_441_072];
        assert_eq!(summary(&rng), (seeded, 1_309_321_831_312, 624, false, 0.0));
        for _ in 0..7 {
            rng.randn();
        }
        let words = [1_635_852_493, 1_952_434_285, 2_631_272_951, 891_169_102];
        let (sum, gauss) = (1_368_315_099_196, 0.535_237_771_368_022_6);
        assert_eq!(summary(&rng), (words, sum, 24, true, gauss));
        for _ in 0..300 {
            rng.random_sample();
        }
        assert_eq!(summary(&rng), (words, sum, 624, true, gauss));
        assert_eq!(rng.randn(), gauss);
        assert_eq!(summary(&rng), (words, sum, 624, false, 0.0));
    }

    /// Values of NumPy 2.4.6 after `set_state`. As in NumPy, `gauss` keeps the given value while
    /// `has_gauss` is false, until `randn` draws a pair, and is 0 after `randn` has returned it.
    #[test]
    fn a_generator_continues_from_a_given_state() {
        let mut rng = LegacyRng::from_state(synthetic_state(623, false, 1.25)).unwrap();
        assert_eq!(rng.random_sample(), 0.662_176_810_485_979_8);
        assert_eq!((rng.state().position, rng.state().gauss), (1, 1.25));
        assert_eq!(rng.randn(), 0.195_226_206_183_389_73);
        let words = [3_390_356_346, 2_752_006_303, 835_125_746, 349_002_831];
        let gauss = 0.612_771_913_430_686_7;
        assert_eq!(summary(&rng), (words, 1_418_623_342_209, 5, true, gauss));

        let mut rng = LegacyRng::from_state(synthetic_state(624, true, -0.5)).unwrap();
        assert_eq!(rng.randn(), -0.5);
        assert_eq!(*rng.state(), synthetic_state(624, false, 0.0));
        assert_eq!(LegacyRng::from_state(synthetic_state(625, false, 0.0)), None);
    }
}
