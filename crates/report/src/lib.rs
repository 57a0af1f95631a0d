//! Reports of outcomes: text for a terminal, JSON, one page of HTML, its
//! figures as SVG, and the table of configurations as CSV or Parquet. The crate
//! `paired` computes the statistics; a [`Subject`] comes from a coordinator or
//! from [`import()`].
//!
//! Output is deterministic: the same subjects give the same bytes, independent of
//! time, machine and the order of the records.

#![forbid(unsafe_code)]

mod analysis;
mod block;
mod comparison;
mod comparison_tables;
mod document;
mod explanation;
mod family;
mod family_comparison;
pub mod figures;
mod import;
mod interactions;
mod page;
mod paper;
mod sequential;
mod simulated;
mod subject;
mod table;
mod tables;
mod threshold_report;
mod warnings;
mod words;

pub use analysis::Analysis;
pub use comparison::{Comparison, Side, Unpairable};
pub use document::{Document, DocumentError};
pub use explanation::Findings;
pub use family::{Family, FamilyError, Line, Pride};
pub use family_comparison::{FamilyComparison, FamilyComparisonError, PairedLine};
pub use import::{BadLine, ImportError, import};
pub use interactions::{AxisInteractions, LevelInteractions, NoInteractions};
pub use page::{STYLE, comparison as page_comparison, page, sections, warnings as page_warnings};
pub use paper::{published_policies, published_rate};
pub use sequential::{Sequential, describe_early_stop};
pub use simulated::SimulatedTask;
pub use subject::{
    BeyondRange, Derived, EarlyStop, Origin, Prospect, Quarantined, Setups, Subject, counted,
    rollout_name,
};
pub use table::{ResultRow, TableError, write_csv, write_parquet, write_results_parquet};
pub use threshold_report::{AtRadius, BudgetTooSmall, Kind, Measured, ThresholdReport};
