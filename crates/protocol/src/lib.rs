//! LIBERO-CTRL as data and pure functions: suites, axes, presets, manifests,
//! rollout ids, seeds and the streams from which perturbations are drawn.
//!
//! Nothing here opens a file, reads a clock or knows a simulator: text and
//! numbers go in, text and numbers come out.

#![forbid(unsafe_code)]

pub mod numpy;
