//! Tables as Parquet: columns are booleans, integers, doubles, or strings for names and enumerations.

use std::io::Write;
use std::sync::Arc;

use parquet::basic::{LogicalType, Repetition, Type as Physical};
use parquet::column::writer::ColumnWriter;
use parquet::data_type::ByteArray;
use parquet::errors::ParquetError;
use parquet::file::metadata::KeyValue;
use parquet::file::properties::WriterProperties;
use parquet::file::writer::SerializedFileWriter;
use parquet::schema::types::Type;
use serde_json::{Value as Json, json};

use super::form::{Column, Kind, Table, TableError, Value};

impl<R> Table<'_, R> {
    /// Writes the table as one row group without compression. Its footer holds pandas
    /// metadata that preserves the types of nullable columns, see [`pandas_metadata`].
    pub(super) fn parquet(&self, out: impl Write + Send) -> Result<(), TableError> {
        let fields = self.columns.iter();
        let fields = fields.map(|(name, kind, _)| field(name, *kind).map(Arc::new));
        let fields: Result<Vec<_>, _> = fields.collect();
        let schema = Type::group_type_builder(self.name).with_fields(fields?);
        let pandas = KeyValue::new("pandas".to_owned(), pandas_metadata(&self.columns).to_string());
        let properties = WriterProperties::builder().set_key_value_metadata(Some(vec![pandas]));
        let properties = Arc::new(properties.build());
        let mut file = SerializedFileWriter::new(out, Arc::new(schema.build()?), properties)?;
        let mut group = file.next_row_group()?;
        for (_, kind, value) in &self.columns {
            let values: Vec<Value> = self.rows.iter().map(value).collect();
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
                    let numbers = values.iter().map(Value::as_number);
                    let levels: Vec<i16> =
                        numbers.clone().map(|n| i16::from(n.is_some())).collect();
                    let levels = matches!(kind, Kind::Integer).then_some(levels.as_slice());
                    let numbers: Vec<i64> = numbers.flatten().collect();
                    writer.write_batch(&numbers, levels, None)?;
                }
                ColumnWriter::DoubleColumnWriter(writer) => {
                    let reals = values.iter().map(Value::as_real);
                    let levels: Vec<i16> = reals.clone().map(|r| i16::from(r.is_some())).collect();
                    let reals: Vec<f64> = reals.flatten().collect();
                    writer.write_batch(&reals, Some(&levels), None)?;
                }
                _ => unreachable!("columns are texts, booleans, integers and doubles"),
            }
            column.close()?;
        }
        group.close()?;
        file.close()?;
        Ok(())
    }
}

/// Returns the footer's entry `pandas`. Without it, pandas reads nullable booleans and strings
/// as columns of type `object` with `None` for absent values.
/// Format: <https://pandas.pydata.org/docs/development/developer.html>.
fn pandas_metadata<R>(columns: &[Column<'_, R>]) -> Json {
    let column = |(name, kind, _): &Column<'_, R>| {
        let (pandas_type, numpy_type) = match kind {
            Kind::Number => ("int64", "int64"),
            Kind::Integer => ("int64", "Int64"),
            Kind::Real => ("float64", "float64"),
            Kind::Text => ("unicode", "string"),
            Kind::Bool => ("bool", "boolean"),
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
        "columns": columns.iter().map(column).collect::<Vec<_>>(),
        "creator": {"library": "rollout", "version": env!("CARGO_PKG_VERSION")},
        "pandas_version": "1.0.0",
    })
}

/// Returns the Parquet type of a column. Only [`Kind::Number`] is required; all other kinds
/// are nullable.
fn field(name: &str, kind: Kind) -> Result<Type, ParquetError> {
    let (physical, repetition, logical) = match kind {
        Kind::Number => (Physical::INT64, Repetition::REQUIRED, None),
        Kind::Integer => (Physical::INT64, Repetition::OPTIONAL, None),
        Kind::Real => (Physical::DOUBLE, Repetition::OPTIONAL, None),
        Kind::Text => (Physical::BYTE_ARRAY, Repetition::OPTIONAL, Some(LogicalType::String)),
        Kind::Bool => (Physical::BOOLEAN, Repetition::OPTIONAL, None),
    };
    let field = Type::primitive_type_builder(name, physical).with_repetition(repetition);
    field.with_logical_type(logical).build()
}

impl Value {
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

    fn as_real(&self) -> Option<f64> {
        match self {
            Self::Real(real) => *real,
            _ => None,
        }
    }

    fn as_number(&self) -> Option<i64> {
        match self {
            Self::Number(number) => Some(*number),
            Self::Integer(number) => *number,
            _ => None,
        }
    }
}
