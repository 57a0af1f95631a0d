//! Tests of reports on measured thresholds: on a terminal, as JSON and as figures.

use std::collections::BTreeSet;

use benchmark::{Condition, Level, Purpose, RolloutId, Thresholds};
use paired::{Outcome, Record};
use parquet::file::reader::{FileReader, SerializedFileReader};
use parquet::record::RowAccessor;
use report::{Derived, Subject, ThresholdReport, figures, page, write_csv, write_parquet};
use serde_json::Value;

use crate::subjects::{document, example};

/// Returns the example with a successful nominal rollout of each initial state; the example itself
/// has no nominal rollouts.
fn nominal() -> Subject {
    let mut subject = example();
    let states = subject.records.iter().map(|record| (record.id.task(), record.init_id));
    let states: BTreeSet<_> = states.collect();
    let nominal = |(task, init_id)| Record {
        id: RolloutId::nominal(task, init_id),
        init_id,
        replicate: 0,
        outcome: Outcome::Success,
    };
    subject.records.extend(states.into_iter().map(nominal));
    subject
}

fn thresholds(max_radius: f64) -> Thresholds {
    Thresholds {
        campaign: "first".to_owned(),
        conditions: Vec::new(),
        tolerance: 0.5,
        max_radius,
        budget: None,
        seed: 0,
    }
}

/// Returns a campaign with the given records that measures the thresholds of `source`.
fn measuring(source: &Subject, records: Vec<Record>, max_radius: f64) -> Subject {
    Subject {
        records,
        derived: Some(Derived {
            purpose: Purpose::Thresholds(thresholds(max_radius)),
            records: source.records.clone(),
        }),
        published_nominal: None,
        published_by_suite: Vec::new(),
        directions: benchmark::Directions::default(),
        reported_nominal: None,
        ..source.clone()
    }
}

fn report_of(source: &Subject, records: Vec<Record>, max_radius: f64) -> ThresholdReport {
    ThresholdReport::of(&measuring(source, records, max_radius)).expect("a measuring campaign")
}

/// Returns the thresholds from the published levels alone.
fn at_levels() -> ThresholdReport {
    report_of(&nominal(), Vec::new(), 8.0)
}

#[test]
fn survival_is_the_success_rate_less_the_share_that_recovers() {
    let report = at_levels();
    let document = document(vec![nominal()]);
    assert_eq!(report.curves.len(), 7);
    assert!(!report.complete, "brackets between the levels exceed the tolerance");
    for curve in &report.curves {
        assert_eq!((curve.n, curve.tasks), (400, 40));
        for level in Level::PERTURBED {
            let survival = curve.at(level.radius()).expect("a point").survival;
            let cell = document.analyses[0].cell(level).expect("a level");
            let rate = match curve.condition {
                Condition::Single(axis) => cell.alone[&axis].count.rate(),
                _ => cell.simultaneous.and_then(|count| count.rate()),
            };
            let rate = rate.expect("outcomes");
            let recovers = |measured: &&report::Measured| {
                measured.condition == curve.condition
                    && measured.recovers_at.contains(&level.radius())
            };
            let recover = report.thresholds.iter().filter(recovers).count() as f64;
            let expected = rate - recover / 400.0;
            assert!((survival - expected).abs() < 1e-12, "{level}: {survival} {expected}");
        }
    }
}

#[test]
fn the_text_fits_a_terminal_and_names_wordings_and_recoveries() {
    let text = at_levels().text();
    for line in text.lines() {
        assert!(line.chars().count() <= 80, "{line}");
    }
    assert!(text.contains("there are wordings at L1, L2 and L3"), "{text}");
    assert!(text.contains("Not monotone: configurations that succeed again beyond a failure"));
    let large_radius = report_of(&nominal(), nominal().records, 100.0).text();
    for line in large_radius.lines() {
        assert!(line.chars().count() <= 80, "{line}");
    }
}

#[test]
fn every_condition_has_a_standalone_figure() {
    let report = at_levels();
    let figures = figures::of_thresholds(&report);
    let names: Vec<&str> = figures.iter().map(|figure| figure.name.as_str()).collect();
    assert_eq!(names.len(), 7);
    assert_eq!((names[0], names[6]), ("survival-camera", "survival-simultaneous"));
    for figure in &figures {
        let svg = figure.standalone();
        let parsed = roxmltree::Document::parse(&svg).expect("XML");
        let texts = parsed.descendants().filter(|node| node.has_tag_name("text"));
        let texts: Vec<&str> = texts.filter_map(|node| node.text()).collect();
        for text in ["L1", "L2", "L3", "100 %", "radius of the perturbation"] {
            assert!(texts.contains(&text), "{}: {texts:?}", figure.name);
        }
        let ends_a_text = |end: &str| texts.iter().any(|text| text.ends_with(end));
        assert!(ends_a_text(", n = 400"), "{}: {texts:?}", figure.name);
        assert!(!svg.contains("NaN") && !svg.contains("inf"), "{}", figure.name);
    }
    let json: Value = serde_json::to_value(&report).expect("JSON");
    assert_eq!(json["curves"][0]["points"][1]["level"], "L1");
    assert_eq!(json["thresholds"].as_array().map(Vec::len), Some(2800));
}

#[test]
fn without_outcomes_there_is_no_curve() {
    let mut subject = nominal();
    for record in &mut subject.records {
        record.outcome = Outcome::Missing;
    }
    let report = report_of(&subject, subject.records.clone(), 16.0);
    assert!(figures::of_thresholds(&report).is_empty() && !report.complete);
    assert_eq!(report.text().lines().count(), 2, "{}", report.text());
}

#[test]
fn the_report_of_a_measuring_campaign_shows_its_findings() {
    let document = document(vec![measuring(&nominal(), Vec::new(), 8.0)]);
    let html = page(&document);
    for expected in [
        "Thresholds of OpenVLA-OFT",
        "class=\"curve\"",
        "Radius at which half of the configurations still succeed",
    ] {
        assert!(html.contains(expected), "{expected}");
    }
    for absent in ["Paired outcomes", "Success by suite", "NaN"] {
        assert!(!html.contains(absent), "{absent}");
    }
    let (text, own) = (document.text(), at_levels().text());
    let (tables, _legend) = own.rsplit_once("\n\n").expect("a legend");
    assert!(text.contains(tables), "{text}");
    let json: Value = serde_json::from_str(&document.json().expect("written")).expect("JSON");
    let expected = serde_json::to_value(at_levels()).expect("JSON");
    assert_eq!(json["reports"][0]["thresholds"], expected);
    let names = figures::all(&document).into_iter().map(|figure| figure.name);
    assert_eq!(names.filter(|name| name.starts_with("survival-")).count(), 7);
}

#[test]
fn the_table_of_thresholds_has_a_row_for_each_threshold() {
    let document = document(vec![measuring(&nominal(), Vec::new(), 8.0)]);
    let mut bytes = Vec::new();
    write_csv(&document, &mut bytes).expect("written");
    let mut csv = csv::Reader::from_reader(bytes.as_slice());
    let header = csv.headers().expect("names").clone();
    let rows: Vec<csv::StringRecord> = csv.records().collect::<Result<_, _>>().expect("rows");
    let report = at_levels();
    assert_eq!(rows.len(), report.thresholds.len());
    let column = |name: &str| header.iter().position(|head| head == name).expect("a column");
    let (kind, fails_at) = (column("threshold"), column("fails_at"));
    let number = |text: &str| (!text.is_empty()).then(|| text.parse::<f64>().expect("a radius"));
    for (row, measured) in rows.iter().zip(&report.thresholds) {
        assert_eq!(&row[kind], measured.threshold.name());
        assert_eq!(number(&row[fails_at]), measured.fails_at);
    }
    let mut file = tempfile::tempfile().expect("a temporary file");
    write_parquet(&document, &mut file).expect("written");
    let file = SerializedFileReader::new(file).expect("Parquet");
    let read = file.get_row_iter(None).expect("rows");
    for (row, measured) in read.zip(&report.thresholds) {
        let row = row.expect("a row");
        assert_eq!(row.get_double(fails_at).ok(), measured.fails_at);
    }
}
