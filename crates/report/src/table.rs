//! Tables for further analysis, with the same columns as CSV and as Parquet. A row is a
//! configuration with all its outcomes; a minimal subset, if the campaigns explain other
//! campaigns; or a threshold, if the campaigns measure thresholds. No column of these tables holds
//! a time, so that the same outcomes give the same bytes. A further table, of results, has a row
//! per committed rollout, with its duration.

#[cfg(feature = "parquet")]
mod parquet;
mod rows;

use std::io::Write;

pub use self::rows::write_results_parquet;
use self::rows::{configurations, explanations, thresholds};
use crate::document::Document;

/// Writes the table as CSV with a header line. Its rows are minimal subsets if every subject
/// explains another campaign, thresholds if every subject measures thresholds, and
/// configurations otherwise.
pub fn write_csv(document: &Document, out: impl Write) -> Result<(), TableError> {
    match rows(document) {
        Rows::Configurations => configurations(document).csv(out),
        Rows::MinimalSubsets => explanations(document).csv(out),
        Rows::Thresholds => thresholds(document).csv(out),
    }
}

/// Writes the table of [`write_csv`] as Parquet: one row group, no compression, and pandas metadata
/// that preserves the types of nullable columns.
pub fn write_parquet(document: &Document, out: impl Write + Send) -> Result<(), TableError> {
    match rows(document) {
        Rows::Configurations => configurations(document).parquet(out),
        Rows::MinimalSubsets => explanations(document).parquet(out),
        Rows::Thresholds => thresholds(document).parquet(out),
    }
}

/// A build without the feature writes no Parquet.
#[cfg(not(feature = "parquet"))]
impl<R> Table<'_, R> {
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

/// Failure to write a table.
#[derive(Debug, thiserror::Error)]
pub enum TableError {
    #[error("write the table as CSV")]
    Csv(#[from] csv::Error),
    #[cfg(feature = "parquet")]
    #[error("write the table as Parquet")]
    Parquet(#[from] ::parquet::errors::ParquetError),
    #[cfg(not(feature = "parquet"))]
    #[error("write the table `{table}` as Parquet: this program was built without `parquet`")]
    Parquet { table: &'static str },
    #[error("write the end of the table")]
    Flush(#[from] std::io::Error),
}

#[derive(Clone, Debug, PartialEq)]
enum Value {
    Text(Option<String>),
    Number(Option<i64>),
    Real(Option<f64>),
    Bool(Option<bool>),
}

/// Type of a column.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    /// Integer that is never null.
    Number,
    Integer,
    Real,
    Text,
    Bool,
}

/// A column: its name, its type, and a function that returns a row's value.
type Column<'a, R> = (String, Kind, Box<dyn Fn(&R) -> Value + 'a>);

/// A column whose value depends on the row alone.
type Plain<R> = (&'static str, Kind, fn(&R) -> Value);

/// Boxes columns.
fn columns<'a, R: 'a, const N: usize>(columns: [Plain<R>; N]) -> Vec<Column<'a, R>> {
    let boxed = |(name, kind, value): Plain<R>| -> Column<'a, R> {
        (name.to_owned(), kind, Box::new(value))
    };
    columns.into_iter().map(boxed).collect()
}

/// A table: its name in the Parquet schema, its columns and its rows.
struct Table<'a, R> {
    name: &'static str,
    columns: Vec<Column<'a, R>>,
    rows: Vec<R>,
}

impl<R> Table<'_, R> {
    fn csv(&self, out: impl Write) -> Result<(), TableError> {
        let mut csv = csv::Writer::from_writer(out);
        csv.write_record(self.columns.iter().map(|(name, ..)| name.as_str()))?;
        for row in &self.rows {
            let values = self.columns.iter().map(|(.., value)| value(row).into_text());
            csv.write_record(values)?;
        }
        Ok(csv.flush()?)
    }
}

fn text(text: impl ToString) -> Value {
    Value::Text(Some(text.to_string()))
}

fn number(number: impl Into<i64>) -> Value {
    Value::Number(Some(number.into()))
}

impl Value {
    fn into_text(self) -> String {
        match self {
            Self::Text(text) => text.unwrap_or_default(),
            Self::Number(number) => number.map_or_else(String::new, |number| number.to_string()),
            Self::Real(real) => real.map_or_else(String::new, |real| real.to_string()),
            Self::Bool(value) => value.map_or_else(String::new, |value| value.to_string()),
        }
    }
}
