//! Comparison with the results that the authors of the protocol published. A test that needs more
//! data than `examples/openvla_oft` is skipped, with a message, if these data are missing.

use std::collections::BTreeMap;
use std::path::Path;

use benchmark::{Axis, Condition, Level, RolloutId, TaskRef};
use paired::{Cell, Interval, Options, Outcome, Record, Report, report};
use serde_json::Value;

use crate::{example, records};

fn read(name: &str) -> Option<String> {
    let path =
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/libero-ctrl-v0.1").join(name);
    let text = std::fs::read_to_string(&path).ok();
    if text.is_none() {
        println!("skipped: {} is missing", path.display());
    }
    text
}

fn published() -> Option<Value> {
    read("paper_results.json").map(|text| serde_json::from_str(&text).expect("JSON"))
}

fn outcome(success: bool) -> Outcome {
    if success { Outcome::Success } else { Outcome::Failure }
}

fn check_cell(cell: &Cell, published: &Value, label: &str) {
    let measures = cell.paired.as_ref().expect("a complete cell");
    let percent = |key: &str| published[key].as_f64().expect(key) / 100.0;
    let close = |value: f64, expected: f64, key: &str| {
        assert!((value - expected).abs() < 1e-12, "{label} {key}: {value} is not {expected}");
    };
    assert_eq!(measures.n, 400, "{label}");
    for (axis, &rate) in &measures.s_axis {
        close(rate, percent(axis.name()), axis.name());
    }
    close(measures.s_conj, percent("and"), "S_conj");
    close(measures.s_sim, percent("sim"), "S_sim");
    assert_eq!(Some(measures.b), published["b"].as_u64(), "{label} b");
    assert_eq!(Some(measures.c), published["c"].as_u64(), "{label} c");
    close(measures.i, percent("sim") - percent("and"), "I");
    close(measures.i, measures.r_c - measures.r_e, "I = R_c - R_e");
    let independent: f64 = Axis::ALL.iter().map(|axis| percent(axis.name())).product();
    close(measures.s_indep, independent, "S_indep");
    close(measures.d + measures.i, measures.s_sim - measures.s_indep, "D + I");
}

/// Returns 400 configurations with the counts of a published cell. The combinations of failures are
/// arbitrary; every measure depends on the counts alone.
fn records_with_counts(published: &Value, level: Level) -> Vec<Record> {
    // Published rates are percentages of 400 configurations.
    let count = |key: &str| (published[key].as_f64().expect(key) * 4.0).round() as usize;
    let emergent = published["b"].as_u64().expect("b") as usize;
    let compensated = published["c"].as_u64().expect("c") as usize;
    let conjunction = count("and");
    let failing = 400 - conjunction;
    // The first `conjunction` configurations succeed under every axis alone. The axes' failures are
    // spread over the other configurations, so that each has at least one failure.
    let mut alone = vec![[true; 6]; 400];
    let mut next = 0;
    for (i, axis) in Axis::ALL.iter().enumerate() {
        for _ in 0..400 - count(axis.name()) {
            alone[conjunction + next % failing][i] = false;
            next += 1;
        }
    }
    assert!(next >= failing, "fewer failures than failing configurations");
    let tasks: Vec<TaskRef> = TaskRef::all().collect();
    let mut records = Vec::new();
    for (index, alone) in alone.into_iter().enumerate() {
        let (task, config) = (tasks[index % 40], (index / 40) as u16);
        let simultaneous = match index < conjunction {
            true => index >= emergent,
            false => index - conjunction < compensated,
        };
        let mut add = |condition, success| {
            let id = RolloutId::perturbed(task, condition, level, config).expect("an id");
            records.push(Record {
                id,
                init_id: task.eval_init_ids()[usize::from(config)],
                replicate: 0,
                outcome: outcome(success),
            });
        };
        for (axis, success) in Axis::ALL.into_iter().zip(alone) {
            add(Condition::Single(axis), success);
        }
        add(Condition::Simultaneous, simultaneous);
    }
    records
}

#[test]
fn all_published_cells_are_reproduced_from_their_counts() {
    let Some(published) = published() else { return };
    let mut cells = 0;
    for (policy, levels) in published["paired"].as_object().expect("policies") {
        let Some(levels) = levels.as_object() else {
            continue; // A note, not the levels of a policy.
        };
        for (level, published) in levels {
            let level: Level = level.parse().expect("a level");
            let records = records_with_counts(published, level);
            let report = report(&records, &Options::default()).expect("no duplicates");
            let label = format!("{policy} {level}");
            check_cell(&report.cells[0], published, &label);
            cells += 1;
        }
    }
    assert_eq!(cells, 21);
}

/// Returns the report on OpenVLA-OFT's 8,400 published outcomes, from the example data.
fn openvla_oft() -> Report {
    let records = records(&example("openvla_oft"));
    assert_eq!(records.len(), 8400);
    report(&records, &Options::default()).expect("no duplicates")
}

#[test]
fn the_example_data_equal_the_published_outcomes() {
    let Some(published) = read("openvla_oft_eval/rollouts.jsonl") else {
        return;
    };
    let by_id = |text: &str| -> BTreeMap<RolloutId, (u16, Outcome)> {
        let records = records(text).into_iter();
        records.map(|r| (r.id, (r.init_id, r.outcome))).collect()
    };
    assert!(by_id(&published) == by_id(&example("openvla_oft")));
}

#[test]
fn published_outcomes_reproduce_their_cells_exactly() {
    let Some(published) = published() else { return };
    let report = openvla_oft();
    assert_eq!(report.axes, Axis::ALL);
    for cell in &report.cells {
        let level = cell.level.to_string();
        check_cell(cell, &published["paired"]["openvla_oft"][&level], &level);
        assert_eq!(cell.completeness.complete, 400);
        assert!(cell.completeness.gaps.is_empty());
    }
}

/// Compares the intervals with the paper's interval of I at L2 and with those of an independent
/// bootstrap of 200,000 replicates. With 4,000 replicates, an end is uncertain by about 0.15
/// points.
#[test]
fn intervals_agree_with_the_published_ones_within_monte_carlo_error() {
    let report = openvla_oft();
    let check = |interval: Option<Interval>, expected: [f64; 2], label: &str| {
        let interval = interval.expect("forty tasks");
        for (end, expected) in interval.into_iter().zip(expected) {
            let error = (100.0 * end - expected).abs();
            assert!(error < 0.6, "{label}: {interval:?} is not {expected:?}");
        }
    };
    let measures: Vec<_> = report.cells.iter().filter_map(|cell| cell.paired.as_ref()).collect();
    check(measures[0].i_ci95, [2.0, 12.5], "I at L1");
    check(measures[1].i_ci95, [-6.0, 6.51], "I at L2");
    check(measures[2].i_ci95, [-14.25, -4.5], "I at L3");
    check(measures[1].r_e_ci95, [9.75, 17.75], "R_e at L2");
    check(measures[1].r_c_ci95, [10.25, 17.5], "R_c at L2");
}
