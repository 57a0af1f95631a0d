//! Comparison with an independent implementation: the results of NumPy and SciPy in
//! reference/expected.json, which reference/expected.py computes.

use std::collections::BTreeMap;

use benchmark::{Axis, TaskRef};
use paired::{
    Bootstrap, Configuration, Difference, MIN_TASKS, Measures, NoInterval, Options, Outcome, Pair,
    mcnemar_exact, quantile, report,
};
use serde_json::Value;

fn expected() -> Value {
    serde_json::from_str(include_str!("reference/expected.json")).expect("JSON")
}

fn number(value: &Value) -> f64 {
    value.as_f64().expect("a number")
}

/// Returns one data set as configurations; see reference/expected.py for its form.
fn configurations(data_set: &Value) -> Vec<Configuration> {
    let tasks = data_set["tasks"].as_array().expect("tasks");
    let tasks = TaskRef::all().zip(tasks);
    let parse_task = |(task, text): (TaskRef, &Value)| {
        let text = text.as_str().expect("a text");
        let digits = (0..text.len()).step_by(2).map(|at| &text[at..at + 2]);
        let bits = digits.map(|digits| u8::from_str_radix(digits, 16).expect("hexadecimal"));
        let configuration = move |bits: u8| Configuration {
            task,
            alone: BTreeMap::from_iter(
                (0..).zip(Axis::ALL).map(|(k, axis)| (axis, bits >> k & 1 == 1)),
            ),
            simultaneous: bits >> 6 == 1,
        };
        bits.map(configuration).collect::<Vec<_>>()
    };
    tasks.flat_map(parse_task).collect()
}

/// Compares point estimates exactly, and intervals within the Monte-Carlo error of 4,000
/// resamplings.
///
/// An end of the interval is the 2.5th percentile of a nearly normal sample of 4,000, whose
/// standard error is √(0.025·0.975/4000) / φ(1.96) = 0.042 deviations. The tolerance is five of
/// these standard errors, plus one step between two possible rates.
fn check(measures: &Measures, expected: &Value, label: &str) {
    let m = measures;
    assert_eq!(Some(m.n), expected["n"].as_u64(), "{label}");
    assert_eq!(Some(m.b), expected["b"].as_u64(), "{label}");
    assert_eq!(Some(m.c), expected["c"].as_u64(), "{label}");
    let close = |value: f64, key: &str| {
        let expected = number(&expected[key]);
        assert!((value - expected).abs() < 1e-12, "{label} {key}: {value} is not {expected}");
    };
    for (axis, rate) in &m.s_axis {
        let expected = number(&expected["s_axis"][axis.name()]);
        assert!((rate - expected).abs() < 1e-12, "{label} {axis}");
    }
    for (value, key) in [(m.s_indep, "s_indep"), (m.s_conj, "s_conj"), (m.s_sim, "s_sim")] {
        close(value, key);
    }
    let p = number(&expected["mcnemar_p"]);
    assert!((m.mcnemar_p - p).abs() <= 1e-9 * p, "{label}: p {} is not {p}", m.mcnemar_p);
    let with_intervals = [
        (m.d, m.d_ci95, "d"),
        (m.i, m.i_ci95, "i"),
        (m.r_e, m.r_e_ci95, "r_e"),
        (m.r_c, m.r_c_ci95, "r_c"),
        (m.r_d, m.r_d_ci95, "r_d"),
    ];
    for (value, interval, key) in with_intervals {
        close(value, key);
        if m.tasks < MIN_TASKS as u64 {
            assert_eq!(interval, None, "{label}: interval of {} tasks", m.tasks);
            assert_eq!(m.no_interval, Some(NoInterval::TooFewTasks), "{label}");
            continue;
        }
        let interval = interval.expect("enough tasks");
        check_interval(interval, expected, key, m.n, label);
    }
}

fn check_interval(interval: [f64; 2], expected: &Value, key: &str, n: u64, label: &str) {
    let deviation = number(&expected[format!("{key}_deviation")]);
    let tolerance = 5.0 * 0.042 * deviation + 1.0 / n as f64;
    let ends = expected[format!("{key}_ci95")].as_array().expect("two");
    for (end, expected) in interval.into_iter().zip(ends.iter().map(number)) {
        let error = (end - expected).abs();
        assert!(error <= tolerance, "{label} {key}: {interval:?} is not {ends:?}");
    }
}

/// Returns one set of pairs; see reference/expected.py for its form.
fn pairs(data_set: &Value) -> Vec<Pair> {
    let tasks = data_set["tasks"].as_array().expect("tasks");
    let tasks = TaskRef::all().zip(tasks);
    let parse_task = |(task, text): (TaskRef, &Value)| {
        let text = text.as_str().expect("a text").to_owned();
        let digits: Vec<u32> = text.chars().filter_map(|c| c.to_digit(4)).collect();
        assert_eq!(digits.len(), text.len(), "{text}");
        let success = |bit: u32| Outcome::from(bit == 1);
        (0..).zip(digits).map(move |(number, bits)| Pair {
            task,
            number,
            a: success(bits & 1),
            b: success(bits >> 1),
        })
    };
    tasks.flat_map(parse_task).collect()
}

#[test]
fn twelve_random_pairs_of_policies_agree_with_numpy_and_scipy() {
    let expected = expected();
    let data_sets = expected["paired_sets"].as_array().expect("data sets");
    assert_eq!(data_sets.len(), 12);
    let sets: Vec<Vec<Pair>> = data_sets.iter().map(pairs).collect();
    let all = Difference::of_each(&sets, &Bootstrap::default());
    for (index, (data_set, difference)) in data_sets.iter().zip(all).enumerate() {
        let (label, expected) = (format!("pairs {index}"), &data_set["expected"]);
        let difference = difference.expect("not empty");
        let counts = [
            (difference.n, "n"),
            (difference.tasks, "tasks"),
            (difference.both, "both"),
            (difference.a_only, "a_only"),
            (difference.b_only, "b_only"),
            (difference.neither, "neither"),
        ];
        for (count, key) in counts {
            assert_eq!(Some(count), expected[key].as_u64(), "{label} {key}");
        }
        for (value, key) in [
            (difference.s_a, "s_a"),
            (difference.s_b, "s_b"),
            (difference.difference, "difference"),
        ] {
            let error = (value - number(&expected[key])).abs();
            assert!(error < 1e-12, "{label} {key}: {value}");
        }
        let p = number(&expected["mcnemar_p"]);
        assert!((difference.mcnemar_p - p).abs() <= 1e-9 * p, "{label}: {}", difference.mcnemar_p);
        let interval = difference.difference_ci95.expect("enough tasks");
        check_interval(interval, expected, "difference", difference.n, &label);
    }
}

#[test]
fn measures_and_intervals_of_twenty_random_data_sets_agree_with_numpy() {
    let expected = expected();
    let data_sets = expected["data_sets"].as_array().expect("data sets");
    assert_eq!(data_sets.len(), 20);
    for (index, data_set) in data_sets.iter().enumerate() {
        let configurations = configurations(data_set);
        let measures = Measures::of(&configurations, &Bootstrap::default());
        let label = format!("data set {index}");
        check(&measures.expect("not empty"), &data_set["expected"], &label);
    }
}

#[test]
fn measures_and_intervals_of_the_example_data_agree_with_numpy() {
    let records = crate::records(&crate::example("openvla_oft"));
    assert_eq!(records.len(), 8400);
    let report = report(&records, &Options::default()).expect("no duplicates");
    let expected = &expected()["openvla_oft"];
    for cell in &report.cells {
        let level = cell.level.to_string();
        check(cell.paired.as_ref().expect("complete"), &expected[&level], &level);
    }
    assert_eq!(report.cells.len(), 3);
}

#[test]
fn p_values_agree_with_scipy() {
    for case in expected()["mcnemar"].as_array().expect("cases") {
        let count = |key: &str| case[key].as_u64().expect("a count");
        let (p, expected) = (mcnemar_exact(count("b"), count("c")), number(&case["p"]));
        assert!((p - expected).abs() <= 1e-9 * expected, "{case}: {p}");
    }
}

#[test]
fn quantiles_agree_with_numpy() {
    for case in expected()["quantiles"].as_array().expect("cases") {
        let numbers = |key: &str| -> Vec<f64> {
            let values = case[key].as_array().expect("numbers").iter();
            values.map(number).collect()
        };
        let sorted = numbers("sorted");
        for (share, expected) in numbers("shares").into_iter().zip(numbers("values")) {
            let value = quantile(&sorted, share);
            assert!((value - expected).abs() < 1e-12, "{share} of {sorted:?}: {value}");
        }
    }
}
