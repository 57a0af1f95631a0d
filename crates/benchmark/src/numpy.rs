//! NumPy's two generators, reproduced draw for draw: [`LegacyRng`] is
//! `numpy.random.RandomState`, which LIBERO's placement samplers use, and
//! [`DefaultRng`] is `numpy.random.default_rng`, which the reference
//! implementation of LIBERO-CTRL uses.
//!
//! Use [`crate::streams`], not this module, as the source of randomness for new
//! code. Only the distributions that LIBERO and the reference call are implemented.
//!
//! Sources: M. Matsumoto and T. Nishimura, MT19937 (1998); M. O'Neill, PCG
//! XSL-RR 128/64 and `seed_seq_fe` (2014, 2015); J. Doornik, ZIGNOR (2005);
//! NumPy 2.4.6 for the order in which they are combined.

mod default_rng;
mod legacy;
mod ziggurat;
mod ziggurat_tables;

pub use default_rng::DefaultRng;
pub use legacy::{LegacyRng, LegacyState, STATE_WORDS};
pub(crate) use ziggurat::standard_normal;

/// Returns a double in [0, 1) from the upper 53 bits of a 64-bit word.
pub(crate) fn unit_from_bits(bits: u64) -> f64 {
    (bits >> 11) as f64 * (1.0 / 9_007_199_254_740_992.0)
}
