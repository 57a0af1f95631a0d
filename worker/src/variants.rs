//! Rollouts of LIBERO-Plus, LIBERO-PRO, LIBERO-Para or a suite file: their files and their start, as
//! slots and `worker rollout` prepare them; and `worker variants`, which counts them and names the
//! files they lack.

mod audit;
mod case;
mod choice;
mod error;

pub use audit::{Audit, lack};
pub use case::{Prepared, read_suite_file, row};
pub use choice::Choice;
pub use error::VariantsError;
