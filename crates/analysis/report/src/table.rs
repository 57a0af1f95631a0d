//! Tables for further analysis, with the same columns as CSV and as Parquet. A row is a
//! configuration with all its outcomes; a minimal subset, if the campaigns explain other
//! campaigns; or a threshold, if the campaigns measure thresholds. No column of these tables holds
//! a time, so that the same outcomes give the same bytes. A further table, of results, has a row
//! per committed rollout, with its duration.

mod configurations;
mod explanations;
mod form;
#[cfg(feature = "parquet")]
mod parquet;
mod results;
mod thresholds;

use std::io::Write;

use crate::document::Document;

pub use form::TableError;
pub use results::{ResultRow, write_results_parquet};

/// Writes the table as CSV with a header line. Its rows are minimal subsets if every subject
/// explains another campaign, thresholds if every subject measures thresholds, and
/// configurations otherwise.
///
/// # Errors
/// If `out` fails.
pub fn write_csv(document: &Document, out: impl Write) -> Result<(), TableError> {
    match rows(document) {
        Rows::Configurations => configurations::table(document).csv(out),
        Rows::MinimalSubsets => explanations::table(document).csv(out),
        Rows::Thresholds => thresholds::table(document).csv(out),
    }
}

/// Writes the table of [`write_csv`] as Parquet: one row group, no compression, and pandas metadata
/// that preserves the types of nullable columns.
///
/// # Errors
/// If `out` fails.
pub fn write_parquet(document: &Document, out: impl Write + Send) -> Result<(), TableError> {
    match rows(document) {
        Rows::Configurations => configurations::table(document).parquet(out),
        Rows::MinimalSubsets => explanations::table(document).parquet(out),
        Rows::Thresholds => thresholds::table(document).parquet(out),
    }
}

/// A build without the feature writes no Parquet.
#[cfg(not(feature = "parquet"))]
impl<R> form::Table<'_, R> {
    fn parquet(&self, _: impl Write + Send) -> Result<(), TableError> {
        Err(TableError::Parquet { table: self.name })
    }
}

enum Rows {
    Configurations,
    MinimalSubsets,
    Thresholds,
}

fn rows(document: &Document) -> Rows {
    let analyses = document.analyses.as_slice();
    if analyses.is_empty() {
        Rows::Configurations
    } else if analyses.iter().all(|analysis| analysis.findings.is_some()) {
        Rows::MinimalSubsets
    } else if analyses.iter().all(|analysis| analysis.thresholds.is_some()) {
        Rows::Thresholds
    } else {
        Rows::Configurations
    }
}
