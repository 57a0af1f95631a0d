//! The student: a small policy network that maps two pictures, the robot's
//! state and an instruction to a chunk of 8 actions. It is stateless and
//! deterministic. This crate loads weights and runs inference; it does not train.
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
//! # Reproducibility
//!
//! The same weights and query give the same bits on every x86-64 machine,
//! independent of caches, vector widths, and the other queries in the batch.
//! All arithmetic is IEEE 754 binary32 in a fixed order:
//!
//! - A matrix product adds `A B` to `C`, which starts as zero or as the bias.
//!   The inner dimension is cut into runs of 256. Each run is summed from zero
//!   upwards with fused multiply-adds; then the run's sum is added to `C`.
//!   The order depends on nothing but the inner dimension.
//! - A convolution is such a product, whose inner dimension is channels by positions in
//!   the window. The stem and the blocks process 16 channels at a time, so that a run has
//!   length 144 for a window of 3 x 3 and 16 for 1 x 1; the three colours give 27.
//! - Other sums are taken in 16 lanes (lane `j` sums indices `j`, `j + 16`, …),
//!   which are then added by halving, or sequentially if there are few addends.
//! - Exponentials are those of the crate `libm`, which is pure Rust and does not
//!   dispatch on the processor.
//! - All other operations are element-wise, without an order of summation. Rust never
//!   fuses a product and a sum implicitly.
//!
//! `matrixmultiply` computes the products. Its kernels for AVX-512, for AVX2 with FMA,
//! and for NEON compute exactly the sums above. Its kernels for older processors round
//! every product first and are never used: without AVX2 or FMA, a plain loop of
//! [`f32::mul_add`] computes the same bits (`product::add`). Intel's processors have AVX2 and
//! FMA since Haswell (2013), AMD's since Excavator (2015). On older processors, which need a
//! build without the target features of `.cargo/config.toml`, a query takes seconds instead
//! of milliseconds.
//!
//! Tests compare the product with the plain loop on the machine they run on, and a
//! whole network with fixed bits (`tests/bits.rs`).
//!
//! Two assumptions are not checked: the thread has the default floating-point
//! environment (rounding to nearest, subnormals not flushed to zero), and the build sets
//! none of `matrixmultiply`'s variables (`MATMUL_SGEMM_KC`). Beyond x86-64, 64-bit ARM
//! should compute the same sums by the same reasoning, but is untested.
//!
//! # Choice of the library
//!
//! - candle multiplies with `gemm`. Version 0.19 derives the run of the inner
//!   dimension from size and associativity of the level-1 cache: with AVX2, a product
//!   of depth 1152 is cut into three runs if that cache is 8-way (32 KB), into two
//!   if it is 12-way (48 KB). A product with one row or one column takes another
//!   path, so that a batch of one would differ from a batch of two.
//! - tract 0.23 selects kernels by the processor's features and vendor, with a cost
//!   model for each; their equivalence would have to be verified again for each
//!   version. It adds about 30 crates to the workspace, candle about 60.
//! - `matrixmultiply` is already in the workspace, cuts every product at 256,
//!   and has one path for all sizes.

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

/// Weights trained on LIBERO's own assets in unperturbed scenes, as safetensors.
pub const LIBERO: &[u8] = include_bytes!("../weights/student.safetensors");
/// Weights trained on the built-in boxes in unperturbed scenes, for tests that download no assets.
pub const BOXES: &[u8] = include_bytes!("../weights/student-boxes.safetensors");

pub use error::{QueryError, WeightsError};
pub use network::Network;
pub use query::{ACTIONS, Chunk, Output, PICTURE_BYTES, PICTURE_SIDE, Query};
