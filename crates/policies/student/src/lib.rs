//! The student: a small policy network that turns two pictures, the robot's
//! state and an instruction into a chunk of 8 actions. It has no memory and no
//! randomness. This crate reads its weights and computes it; training is
//! elsewhere.
//!
//! ```text
//! instruction ─▶ text ─▶ t ────────────┬───────────────────┐
//!                                      ▼ FiLM              │
//! agentview ─▶ picture ─▶ encoder, 320 numbers ─┐          │
//! wrist ─────▶ picture ─▶ encoder, 320 numbers ─┼─▶ head ◀─┘
//! robot state ─▶ 64 numbers ────────────────────┘    │
//!                                                    ▼
//!                                        arm 8 x 6, gripper 8
//! ```
//!
//! # The same bits
//!
//! Equal weights and equal queries give equal bits on every x86-64 machine,
//! whatever its caches and vector widths, and whatever else is in the batch.
//! All arithmetic is IEEE 754's, in binary32, in a stated order:
//!
//! - A matrix product adds `A B` to `C`, which starts as zero or as the bias.
//!   The inner dimension is cut into runs of 256. Each run is summed from zero
//!   upwards with fused multiply-adds; then the run's sum is added to `C`.
//!   The order depends on nothing but the inner dimension.
//! - A convolution is such a product, whose inner dimension is channels by places of
//!   the window. It is handed on 16 channels at a time, so that its runs are of 144.
//! - Other sums are taken in 16 lanes (lane `j` sums places `j`, `j + 16`, …),
//!   which are then added in halves, or one by one where few are added.
//! - Exponentials are `libm`'s, which are computed in Rust, without a look at the
//!   processor.
//! - What is left is element by element: no order to keep. Rust never fuses
//!   a product and a sum by itself.
//!
//! `matrixmultiply` computes the products. Of its kernels, those for AVX-512, for
//! AVX2 with FMA, and for NEON compute exactly the sums above. Its kernels for
//! older processors round every product first, so they are never used: where AVX2 or
//! FMA is missing, a plain loop of [`f32::mul_add`] computes the same bits
//! ([`Products`]). Intel's processors have both since Haswell (2013), AMD's since
//! Excavator (2015). On older ones, which need a build without `.cargo/config.toml`'s
//! instructions, a query takes seconds instead of milliseconds.
//!
//! Tests hold the product against the plain loop on whatever machine they run, and a
//! whole network against fixed bits (`tests/bits.rs`).
//!
//! Two things are taken for granted: the thread computes as threads do when they
//! start (rounding to nearest, tiny numbers not flushed to zero), and the build sets
//! none of `matrixmultiply`'s own variables (`MATMUL_SGEMM_KC`). Beyond x86-64,
//! 64-bit ARM computes the same sums by the same reasoning, but no test has run there.
//!
//! # Why this library
//!
//! - candle multiplies with `gemm`. Version 0.19 computes the run of the inner
//!   dimension from size and associativity of the level-1 cache: with AVX2, a product
//!   of depth 1152 is cut into three runs where that cache is 8-way (32 KB), into two
//!   where it is 12-way (48 KB). A product with one row or one column takes another
//!   path, so a batch of one would differ from a batch of two.
//! - tract 0.23 chooses kernels by the processor's features and by its maker, with a
//!   cost model for each; that all of them sum alike would have to be shown anew for
//!   each version. It brings about 30 crates that this workspace does not have, candle
//!   about 60.
//! - `matrixmultiply` is in the workspace already, cuts every product at 256,
//!   and has one path for all sizes.

#![deny(unsafe_op_in_unsafe_fn)]

mod block;
mod columns;
mod convolution;
mod encoder;
mod error;
mod lanes;
mod linear;
mod network;
mod norm;
mod picture;
mod points;
mod product;
mod query;
mod text;
mod weights;

/// Weights that were taught on LIBERO's own assets, in unperturbed scenes, as safetensors.
pub const LIBERO: &[u8] = include_bytes!("../weights/student.safetensors");
/// Weights that were taught on the built-in boxes, in unperturbed scenes.
pub const BOXES: &[u8] = include_bytes!("../weights/student-boxes.safetensors");
/// Weights that were taught on the built-in boxes, in randomly perturbed scenes.
pub const BOXES_RANDOMISED: &[u8] =
    include_bytes!("../weights/student-boxes-randomised.safetensors");

pub use error::{QueryError, WeightsError};
pub use network::Network;
pub use product::Products;
pub use query::{ACTIONS, Chunk, Output, PICTURE_BYTES, PICTURE_SIDE, Query};
