//! Columns and values of a table, and its writer for CSV.

use std::io::Write;

/// Failure to write a table.
#[derive(Debug, thiserror::Error)]
pub enum TableError {
    #[error("write the table as CSV")]
    Csv(#[from] csv::Error),
    #[cfg(feature = "parquet")]
    #[error("write the table as Parquet")]
    Parquet(#[from] parquet::errors::ParquetError),
    #[cfg(not(feature = "parquet"))]
    #[error("write the table `{table}` as Parquet: this program was built without `parquet`")]
    Parquet { table: &'static str },
    #[error("write the end of the table")]
    Flush(#[from] std::io::Error),
}

#[derive(Clone, Debug, PartialEq)]
pub(super) enum Value {
    Text(Option<String>),
    Number(i64),
    Integer(Option<i64>),
    Real(Option<f64>),
    Bool(Option<bool>),
}

/// Type of a column.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    /// Integer that is never null.
    Number,
    /// Nullable integer.
    Integer,
    Real,
    Text,
    Bool,
}

/// A column: its name, its type, and a function that returns a row's value.
pub(super) type Column<'a, R> = (String, Kind, Box<dyn Fn(&R) -> Value + 'a>);

/// Boxes columns whose values depend on the row alone.
pub(super) fn columns<'a, R: 'a, const N: usize>(
    columns: [(&str, Kind, fn(&R) -> Value); N],
) -> Vec<Column<'a, R>> {
    let columns = columns.into_iter();
    let boxed = |(name, kind, value): (&str, _, fn(&R) -> Value)| -> Column<'a, R> {
        (name.to_owned(), kind, Box::new(value))
    };
    columns.map(boxed).collect()
}

/// A table: its name in the Parquet schema, its columns and its rows.
pub(super) struct Table<'a, R> {
    pub(super) name: &'static str,
    pub(super) columns: Vec<Column<'a, R>>,
    pub(super) rows: Vec<R>,
}

impl<R> Table<'_, R> {
    pub(super) fn csv(&self, out: impl Write) -> Result<(), TableError> {
        let mut csv = csv::Writer::from_writer(out);
        csv.write_record(self.columns.iter().map(|(name, ..)| name.as_str()))?;
        for row in &self.rows {
            let values = self.columns.iter().map(|(.., value)| value(row).into_text());
            csv.write_record(values)?;
        }
        Ok(csv.flush()?)
    }
}

pub(super) fn text(text: &str) -> Value {
    Value::Text(Some(text.to_owned()))
}

impl Value {
    fn into_text(self) -> String {
        match self {
            Self::Text(text) => text.unwrap_or_default(),
            Self::Number(number) => number.to_string(),
            Self::Integer(number) => number.map_or_else(String::new, |number| number.to_string()),
            Self::Real(real) => real.map_or_else(String::new, |real| real.to_string()),
            Self::Bool(value) => value.map_or_else(String::new, |value| value.to_string()),
        }
    }
}
