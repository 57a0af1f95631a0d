//! The table of configurations: one row per policy, replicate, level, task and
//! configuration, with all its outcomes, for people's own analyses. As CSV and
//! as Parquet, with the same columns.
//!
//! An outcome is true, false, or empty where there is none: `unresolved` says
//! whether it is missing or quarantined. Parquet's columns have types: outcomes
//! are booleans, numbers integers, names and enumerations strings. No column is
//! an instant: the same outcomes give the same bytes.

use std::io::Write;
use std::sync::Arc;

use paired::{Matched, Outcome};
use parquet::basic::{LogicalType, Repetition, Type as Physical};
use parquet::column::writer::ColumnWriter;
use parquet::data_type::ByteArray;
use parquet::errors::ParquetError;
use parquet::file::metadata::KeyValue;
use parquet::file::properties::WriterProperties;
use parquet::file::writer::SerializedFileWriter;
use parquet::schema::types::Type;
use protocol::{Axis, Condition};
use serde_json::{Value as Json, json};

use crate::analysis::Analysis;
use crate::document::Document;

/// A table that cannot be written.
#[derive(Debug, thiserror::Error)]
pub enum TableError {
    /// As CSV.
    #[error("write the table as CSV")]
    Csv(#[from] csv::Error),
    /// As Parquet.
    #[error("write the table as Parquet")]
    Parquet(#[from] ParquetError),
    /// The end of the file.
    #[error("write the end of the table")]
    Flush(#[from] std::io::Error),
}

/// One value of a row.
#[derive(Clone, Debug, PartialEq)]
enum Value {
    Text(Option<String>),
    Number(i64),
    Bool(Option<bool>),
}

type Column = (&'static str, fn(&Analysis, &Matched) -> Value);

const COLUMNS: [Column; 19] = [
    ("policy", |a, _| text(&a.label)),
    ("origin", |a, _| text(a.subject.origin_name())),
    ("replicate", |_, m| Value::Number(m.replicate.into())),
    ("level", |_, m| text(&m.level.to_string())),
    ("suite", |_, m| text(m.task.suite().name())),
    ("task", |_, m| Value::Number(m.task.index().into())),
    ("config", |_, m| Value::Number(m.config.into())),
    ("init_id", |_, m| Value::Number(m.init_id.into())),
    ("nominal", |_, m| Value::Bool(m.nominal.success())),
    ("camera", |_, m| alone(m, Axis::Camera)),
    ("lighting", |_, m| alone(m, Axis::Lighting)),
    ("robot", |_, m| alone(m, Axis::Robot)),
    ("sensor", |_, m| alone(m, Axis::Sensor)),
    ("actuation", |_, m| alone(m, Axis::Actuation)),
    ("language", |_, m| alone(m, Axis::Language)),
    ("conjunction", |_, m| {
        Value::Bool(m.configuration().map(|c| c.conjunction()))
    }),
    ("combination", |_, m| Value::Bool(m.simultaneous.success())),
    ("transition", |_, m| {
        Value::Text(
            m.transition()
                .map(|transition| transition.name().to_owned()),
        )
    }),
    ("unresolved", |_, m| unresolved(m)),
];

/// Writes the table as CSV, with a line of column names.
///
/// # Errors
/// When `out` fails.
pub fn write_csv(document: &Document, out: impl Write) -> Result<(), TableError> {
    let mut csv = csv::Writer::from_writer(out);
    csv.write_record(COLUMNS.map(|(name, _)| name))?;
    for (analysis, matched) in rows(document) {
        csv.write_record(COLUMNS.map(|(_, value)| value(analysis, matched).into_text()))?;
    }
    Ok(csv.flush()?)
}

/// Writes the table as Parquet: one row group, no compression. The footer also
/// has what pandas needs to read nullable columns as what they are, see
/// [`for_pandas`].
///
/// # Errors
/// When `out` fails.
pub fn write_parquet(document: &Document, out: impl Write + Send) -> Result<(), TableError> {
    let rows: Vec<(&Analysis, &Matched)> = rows(document).collect();
    let columns = COLUMNS.map(|(_, value)| -> Vec<Value> {
        rows.iter()
            .map(|(analysis, matched)| value(analysis, matched))
            .collect()
    });
    let fields: Result<Vec<_>, _> = COLUMNS
        .iter()
        .map(|(name, _)| field(name).map(Arc::new))
        .collect();
    let schema = Type::group_type_builder("configurations").with_fields(fields?);
    let about = KeyValue::new("pandas".to_owned(), for_pandas().to_string());
    let properties = WriterProperties::builder().set_key_value_metadata(Some(vec![about]));
    let properties = Arc::new(properties.build());
    let mut file = SerializedFileWriter::new(out, Arc::new(schema.build()?), properties)?;
    let mut group = file.next_row_group()?;
    for values in columns {
        let mut column = group.next_column()?.expect("as many columns as fields");
        match column.untyped() {
            ColumnWriter::ByteArrayColumnWriter(writer) => {
                let texts = values.iter().map(Value::as_text);
                let levels: Vec<i16> = texts.clone().map(|t| i16::from(t.is_some())).collect();
                let texts: Vec<ByteArray> = texts.flatten().map(ByteArray::from).collect();
                writer.write_batch(&texts, Some(&levels), None)?;
            }
            ColumnWriter::BoolColumnWriter(writer) => {
                let bools = values.iter().map(Value::as_bool);
                let levels: Vec<i16> = bools.clone().map(|b| i16::from(b.is_some())).collect();
                let bools: Vec<bool> = bools.flatten().collect();
                writer.write_batch(&bools, Some(&levels), None)?;
            }
            ColumnWriter::Int64ColumnWriter(writer) => {
                let numbers: Vec<i64> = values.iter().map(Value::as_number).collect();
                writer.write_batch(&numbers, None, None)?;
            }
            _ => unreachable!("columns are texts, booleans and integers"),
        }
        column.close()?;
    }
    group.close()?;
    file.close()?;
    Ok(())
}

fn rows(document: &Document) -> impl Iterator<Item = (&Analysis, &Matched)> {
    document.analyses.iter().flat_map(|analysis| {
        let configurations = analysis.records.configurations().iter();
        configurations.map(move |matched| (analysis, matched))
    })
}

/// What a column holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Number,
    Text,
    Outcome,
}

fn kind(name: &str) -> Kind {
    match name {
        "replicate" | "task" | "config" | "init_id" => Kind::Number,
        "policy" | "origin" | "level" | "suite" | "transition" | "unresolved" => Kind::Text,
        _ => Kind::Outcome,
    }
}

/// The footer's entry `pandas`: without it, pandas makes a column of booleans or
/// texts with gaps a column of `object`, in which `None` stands between them.
/// Its form: <https://pandas.pydata.org/docs/development/developer.html>.
fn for_pandas() -> Json {
    let column = |(name, _): &Column| {
        let (pandas_type, numpy_type) = match kind(name) {
            Kind::Number => ("int64", "int64"),
            Kind::Text => ("unicode", "string"),
            Kind::Outcome => ("bool", "boolean"),
        };
        json!({
            "name": name,
            "field_name": name,
            "pandas_type": pandas_type,
            "numpy_type": numpy_type,
            "metadata": null,
        })
    };
    json!({
        "index_columns": [],
        "column_indexes": [],
        "columns": COLUMNS.iter().map(column).collect::<Vec<_>>(),
        "creator": {"library": "rollout", "version": env!("CARGO_PKG_VERSION")},
        "pandas_version": "1.0.0",
    })
}

/// The schema of a column: texts and outcomes may be absent.
fn field(name: &str) -> Result<Type, ParquetError> {
    let (physical, repetition, logical) = match kind(name) {
        Kind::Number => (Physical::INT64, Repetition::REQUIRED, None),
        Kind::Text => (
            Physical::BYTE_ARRAY,
            Repetition::OPTIONAL,
            Some(LogicalType::String),
        ),
        Kind::Outcome => (Physical::BOOLEAN, Repetition::OPTIONAL, None),
    };
    let field = Type::primitive_type_builder(name, physical).with_repetition(repetition);
    field.with_logical_type(logical).build()
}

fn text(text: &str) -> Value {
    Value::Text(Some(text.to_owned()))
}

fn alone(matched: &Matched, axis: Axis) -> Value {
    Value::Bool(matched.outcome(Condition::Single(axis)).success())
}

/// The conditions without an outcome, of those that the campaign has.
fn unresolved(matched: &Matched) -> Value {
    let alone = matched.alone.keys().copied().map(Condition::Single);
    let named = alone
        .chain([Condition::Combination])
        .filter_map(|condition| match matched.outcome(condition) {
            Outcome::Missing => Some(format!("{condition} missing")),
            Outcome::Quarantined => Some(format!("{condition} quarantined")),
            Outcome::Success | Outcome::Failure => None,
        });
    let named: Vec<String> = named.collect();
    Value::Text((!named.is_empty()).then(|| named.join(", ")))
}

impl Value {
    fn into_text(self) -> String {
        match self {
            Self::Text(text) => text.unwrap_or_default(),
            Self::Number(number) => number.to_string(),
            Self::Bool(value) => value.map_or_else(String::new, |value| value.to_string()),
        }
    }

    fn as_text(&self) -> Option<&str> {
        match self {
            Self::Text(text) => text.as_deref(),
            _ => None,
        }
    }

    fn as_bool(&self) -> Option<bool> {
        match self {
            Self::Bool(value) => *value,
            _ => None,
        }
    }

    fn as_number(&self) -> i64 {
        match self {
            Self::Number(number) => *number,
            _ => 0,
        }
    }
}
