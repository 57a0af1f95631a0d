//! Matched-outcome statistics: what happened to the same configurations under
//! each axis alone and under all of them at once, how often simultaneous
//! perturbation changed an outcome, in which direction, and how sure that is.
//!
//! Pure: records go in, a [`Report`] comes out, the same for the same records
//! in any order. The caller knows where records come from, and passes warnings about
//! how they were made ([`Options::notes`]). Formulas: section 6 of the
//! protocol; source of the design: arXiv 2609.15940.

#![forbid(unsafe_code)]

mod bootstrap;
mod bounds;
mod count;
mod design;
mod gate;
mod mcnemar;
mod measures;
mod outcomes;
mod replication;
mod report;
mod table;

pub use bootstrap::{Bootstrap, Interval, quantile};
pub use bounds::Bounds;
pub use count::Count;
pub use design::{PairedDesign, minimum_detectable_effect, task_correlation};
pub use gate::{GATE_ROLLOUTS, GATE_TOLERANCE, Gate, GateVerdict};
pub use mcnemar::mcnemar_exact;
pub use measures::{Configuration, Measures};
pub use outcomes::{DuplicateRecord, Matched, Outcome, Record, Records, Transition};
pub use replication::{Change, Flips, Replication};
pub use report::{
    Cell, Completeness, Gap, Nominal, NominalSource, Options, Report, SingleAxis, report, report_of,
};
pub use table::{push_wrapped, table};
