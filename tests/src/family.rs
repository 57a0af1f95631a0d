//! Numerical comparison of LIBERO-Plus, LIBERO-PRO and LIBERO-Para with what their own Python code
//! does, as recorded by the scripts in `tests/tests/family`.

mod comparison;
mod recording;
mod table;

pub use comparison::{Comparison, Findings, MODEL_LOADS, Skipped, TOLERANCE};
pub use recording::{RECORDED, Recording, recordings};
pub use table::Table;
