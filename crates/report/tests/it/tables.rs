//! The table of configurations, as CSV and as Parquet.

use benchmark::Condition;
use parquet::file::reader::{FileReader, SerializedFileReader};
use report::{Document, write_csv, write_parquet, write_results_parquet};
use serde_json::Value;

use crate::subjects::{broken, document, example};

#[test]
fn the_csv_table_has_a_row_per_configuration() {
    let mut bytes = Vec::new();
    write_csv(&document(vec![example(), broken()]), &mut bytes).expect("written");
    let mut reader = csv::Reader::from_reader(bytes.as_slice());
    let header = reader.headers().expect("names").clone();
    let column = |name: &str| header.iter().position(|n| n == name).expect("a column");
    let (transition, policy) = (column("transition"), column("policy"));
    let (level, unresolved) = (column("level"), column("unresolved"));
    let rows: Vec<csv::StringRecord> = reader.records().collect::<Result<_, _>>().expect("rows");
    assert_eq!(rows.len(), 2 * 1200);
    let cell_rows = rows.iter().filter(|r| &r[policy] == "OpenVLA-OFT" && &r[level] == "L2");
    let count = |name: &str| cell_rows.clone().filter(|r| &r[transition] == name).count();
    assert_eq!((count("emergent"), count("compensated")), (54, 55));
    let incomplete = rows.iter().filter(|r| r[transition].is_empty());
    assert!(incomplete.clone().count() > 100);
    for row in incomplete {
        assert!(row[unresolved].contains("missing") || row[unresolved].contains("quarantined"));
    }
}

#[test]
fn a_campaign_without_simultaneous_rollouts_misses_none() {
    let mut subject = example();
    subject.records.retain(|record| record.id.condition() != Condition::Simultaneous);
    let mut bytes = Vec::new();
    write_csv(&document(vec![subject]), &mut bytes).expect("written");
    let mut reader = csv::Reader::from_reader(bytes.as_slice());
    let names = reader.headers().expect("names").clone();
    let unresolved = names.iter().position(|name| name == "unresolved");
    let rows: Vec<csv::StringRecord> = reader.records().collect::<Result<_, _>>().expect("rows");
    assert_eq!(rows.len(), 1200);
    assert!(rows.iter().all(|row| row[unresolved.expect("a column")].is_empty()));
}

#[test]
fn the_parquet_table_has_the_values_of_the_csv_table() {
    let document = document(vec![example(), broken()]);
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("table.parquet");
    let file = std::fs::File::create(&path).expect("created");
    write_parquet(&document, file).expect("written");
    let mut csv_bytes = Vec::new();
    write_csv(&document, &mut csv_bytes).expect("written");
    let mut csv = csv::Reader::from_reader(csv_bytes.as_slice());

    let file = std::fs::File::open(&path).expect("opened");
    let reader = SerializedFileReader::new(file).expect("Parquet");
    let mut rows = 0;
    for (row, expected) in reader.get_row_iter(None).expect("rows").zip(csv.records()) {
        let row = row.expect("a row");
        let values: Vec<String> = row
            .get_column_iter()
            .map(|(_, field)| match field {
                parquet::record::Field::Null => String::new(),
                parquet::record::Field::Str(text) => text.clone(),
                other => other.to_string(),
            })
            .collect();
        assert_eq!(values, expected.expect("a row").iter().collect::<Vec<_>>());
        rows += 1;
    }
    assert_eq!(rows, 2 * 1200);
}

/// Writes a document's Parquet file into a temporary folder.
fn parquet_of(document: &Document) -> (tempfile::TempDir, std::path::PathBuf) {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("table.parquet");
    let file = std::fs::File::create(&path).expect("created");
    write_parquet(document, file).expect("written");
    (folder, path)
}

#[test]
fn parquet_columns_have_types_and_pandas_metadata() {
    use parquet::basic::{LogicalType, Type as Physical};
    let (_folder, path) = parquet_of(&document(vec![broken()]));
    let file = std::fs::File::open(&path).expect("opened");
    let reader = SerializedFileReader::new(file).expect("Parquet");
    let metadata = reader.metadata().file_metadata();
    let entries = metadata.key_value_metadata().expect("metadata");
    let pandas = entries.iter().find(|entry| entry.key == "pandas");
    let pandas = pandas.and_then(|entry| entry.value.as_ref()).expect("a text");
    let pandas: Value = serde_json::from_str(pandas).expect("JSON");
    let documented = pandas["columns"].as_array().expect("columns");
    let columns = metadata.schema_descr().columns();
    assert_eq!(documented.len(), columns.len());
    for (column, documented) in columns.iter().zip(documented) {
        let (name, is_text) =
            (column.name(), column.logical_type_ref() == Some(&LogicalType::String));
        assert_eq!(documented["name"], name);
        let expected = match (column.physical_type(), is_text) {
            (Physical::BOOLEAN, false) => "boolean",
            (Physical::BYTE_ARRAY, true) => "string",
            (Physical::INT64, false) if column.name().ends_with("_steps") => "Int64",
            (Physical::INT64, false) => "int64",
            (Physical::DOUBLE, false) => "float64",
            other => panic!("{name}: {other:?}"),
        };
        assert_eq!(documented["numpy_type"], expected, "{name}");
    }
    let count =
        |kind: &str| documented.iter().filter(|column| column["numpy_type"] == kind).count();
    assert_eq!((count("boolean"), count("int64"), count("string")), (10, 4, 6));
    assert_eq!((count("float64"), count("Int64")), (8, 8));
}

#[test]
fn a_table_of_results_has_a_column_for_the_execution_model() {
    let row = |more: &str| {
        let line = format!(
            r#"{{"rollout_id": "goal/t0/nominal/i06", "success": true, "steps": 113, "axis": "nominal",
                "level": "L0", "suite": "libero_goal", "task_id": 0, "init_id": 6, "config": null,
                "policy": "oft", "wall_s": 7.2, "replicate": 0, "goal_predicates": 1, "goal_at_end": 1,
                "goal_at_most": 1{more}}}"#
        );
        serde_json::from_str(&line).expect("a row")
    };
    let rows = vec![row(""), row(r#", "execution": "overlap:4,rtc""#)];
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("results.parquet");
    let file = std::fs::File::create(&path).expect("created");
    write_results_parquet(rows, file).expect("written");
    let reader = SerializedFileReader::new(std::fs::File::open(&path).expect("opened"));
    let reader = reader.expect("Parquet");
    let models = reader.get_row_iter(None).expect("rows").map(|row| {
        let row = row.expect("a row");
        let mut columns = row.get_column_iter();
        let (_, model) = columns.find(|(name, _)| *name == "execution").expect("a column");
        model.to_string()
    });
    assert_eq!(models.collect::<Vec<_>>(), ["\"wait\"", "\"overlap:4,rtc\""]);
}

#[test]
fn pandas_reads_no_parquet_column_as_objects() {
    let probe =
        std::process::Command::new("python3").args(["-c", "import pandas, pyarrow"]).output();
    if !probe.is_ok_and(|output| output.status.success()) {
        println!("skipped: no python3 with pandas and pyarrow is on the path");
        return;
    }
    let (_folder, path) = parquet_of(&document(vec![broken()]));
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/it/columns.py");
    let output =
        std::process::Command::new("python3").arg(script).arg(&path).output().expect("python3");
    let error = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{error}");
    let output_json: Value = serde_json::from_slice(&output.stdout).expect("JSON");
    assert_eq!(output_json["objects"], serde_json::json!([]), "{output_json}");
    let columns = output_json["columns"].as_object().expect("columns");
    assert_eq!(columns.len(), 36);
    let kinds = |name: &str| columns[name].to_string();
    assert_eq!(kinds("camera"), r#"["boolean",["bool"]]"#);
    assert_eq!(kinds("config"), r#"["int64",["int"]]"#);
    assert_eq!(kinds("level"), r#"["string",["str"]]"#);
    assert_eq!(kinds("transition"), r#"["string",["str"]]"#);
    // Outcomes that are missing or in quarantine are gaps, not values.
    assert!(output_json["gaps"]["camera"].as_u64() > Some(0), "{output_json}");
}
