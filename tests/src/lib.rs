//! Helpers shared by the tests under `tests/` and the programs under `src/bin/`.

#![forbid(unsafe_code)]

pub mod browser;
pub mod chaos;
pub mod documents;
pub mod family;
pub mod fidelity;
pub mod files;
pub mod measure;
pub mod outcome;
pub mod programs;
pub mod slurm;
pub mod untrusted_input;
