//! Tables as Parquet: columns are booleans, integers, doubles, or strings for names and enumerations.

use std::io::Write;
use std::sync::Arc;

use parquet::basic::{LogicalType, Repetition, Type as Physical};
use parquet::column::writer::{ColumnWriter, ColumnWriterImpl};
use parquet::data_type::{ByteArray, DataType};
use parquet::errors::ParquetError;
use parquet::file::metadata::KeyValue;
use parquet::file::properties::WriterProperties;
use parquet::file::writer::SerializedFileWriter;
use parquet::schema::types::Type;
use serde_json::{Value as Json, json};

use super::{Column, Kind, Table, TableError, Value};

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
            let values = self.rows.iter().map(value);
            let mut column = group.next_column()?.expect("as many columns as fields");
            match column.untyped() {
                ColumnWriter::ByteArrayColumnWriter(writer) => {
                    write(writer, true, values, |value| {
                        let Value::Text(text) = value else { return None };
                        text.as_deref().map(ByteArray::from)
                    })
                }
                ColumnWriter::BoolColumnWriter(writer) => write(writer, true, values, |value| {
                    let Value::Bool(value) = value else { return None };
                    value
                }),
                ColumnWriter::Int64ColumnWriter(writer) => {
                    write(writer, *kind == Kind::Integer, values, |value| {
                        let Value::Number(value) = value else { return None };
                        value
                    })
                }
                ColumnWriter::DoubleColumnWriter(writer) => write(writer, true, values, |value| {
                    let Value::Real(value) = value else { return None };
                    value
                }),
                _ => unreachable!("columns are texts, booleans, integers and doubles"),
            }?;
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

/// Writes a column's values, with their definition levels if the column is nullable.
fn write<T: DataType>(
    writer: &mut ColumnWriterImpl<'_, T>,
    is_nullable: bool,
    values: impl Iterator<Item = Value>,
    of: impl Fn(Value) -> Option<T::T>,
) -> Result<usize, ParquetError> {
    let values: Vec<Option<T::T>> = values.map(of).collect();
    let levels: Vec<i16> = values.iter().map(|value| i16::from(value.is_some())).collect();
    let values: Vec<T::T> = values.into_iter().flatten().collect();
    writer.write_batch(&values, is_nullable.then_some(levels.as_slice()), None)
}
