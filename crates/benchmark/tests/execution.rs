//! Tests of the texts of execution models, of drawn delays, and of files of measured latencies.

use benchmark::{Delays, Execution, TaskRef};

fn execution(text: &str) -> Execution {
    text.parse().expect("an execution model")
}

#[test]
fn models_are_parsed_from_their_text() {
    for text in [
        "wait",
        "hold:0",
        "hold:200",
        "overlap:4",
        "overlap:4,rtc",
        "hold:3*812+4*188",
        "overlap:0*1+200*1000,rtc",
    ] {
        assert_eq!(execution(text).to_string(), text);
    }
    assert_eq!(execution("hold:4*1+3*2+4*1").to_string(), "hold:3*2+4*2");
    assert_eq!(execution("hold:4*7").to_string(), "hold:4");
    assert_eq!(execution("hold:4*1000+4*1000").to_string(), "hold:4");
}

#[test]
fn invalid_texts_are_refused_with_the_problem_and_the_valid_forms() {
    let long: Vec<String> = (0..33).map(|steps| format!("{steps}*1")).collect();
    let long = format!("hold:{}", long.join("+"));
    for (text, problem) in [
        ("", "no model is given"),
        ("hold", "`hold` lacks a delay"),
        ("dawdle:3", "no model `dawdle`"),
        ("hold:", "a number is missing"),
        ("hold:+3", "`+3` is not a number"),
        ("hold:201", "a delay of 201"),
        ("hold:99999999999", "`99999999999` is not a number"),
        ("hold:3,rtc", "`3,rtc` is not a number"),
        ("overlap:3*0", "weight 0"),
        ("overlap:3*1001", "weight 1001"),
        ("hold:4*1000+4*1000+3*1", "delay 4 add up to 2000"),
        ("overlap:3*1+4", "`4` has no weight"),
        (long.as_str(), "33 different delays"),
    ] {
        let error = text.parse::<Execution>().expect_err(text).to_string();
        assert!(error.contains(problem), "{text}: {error}");
        assert!(error.contains("write wait, hold:N"), "{error}");
    }
}

#[test]
fn drawn_delays_have_the_frequencies_of_the_distribution() {
    let delays: Delays = "2*700+3*200+9*100".parse().expect("delays");
    let task = TaskRef::all().next().expect("a task");
    let mut counts = std::collections::BTreeMap::<u16, u32>::new();
    for query in 0..20_000 {
        *counts.entry(delays.of_query(task, 3, query)).or_default() += 1;
    }
    assert_eq!(counts.keys().copied().collect::<Vec<_>>(), [2, 3, 9]);
    for (steps, expected) in [(2, 14_000.0), (3, 4_000.0), (9, 2_000.0)] {
        let deviation = f64::from(counts[&steps]) - expected;
        // 300 is more than four standard deviations, each of at most 65.
        assert!(deviation.abs() < 300.0, "{steps}: {counts:?}");
    }
    let first: Vec<u16> = (0..9).map(|query| delays.of_query(task, 3, query)).collect();
    let of_other_state: Vec<u16> = (0..9).map(|query| delays.of_query(task, 4, query)).collect();
    assert_ne!(first, of_other_state, "each initial state has its own delays");
    // Pins the stream: if these values change, the version in the stream's key must change.
    assert_eq!(first, [2, 9, 2, 2, 2, 2, 2, 2, 2]);
}

#[test]
fn measured_latencies_are_converted_to_weights_in_thousandths() {
    let parse = |text: &str| Delays::from_json(text).map(|delays| delays.to_string());
    let text = r#"{"server": "pi05", "delay_steps": {"3": 8120, "4": 1879, "30": 1, "5": 0}}"#;
    assert_eq!(parse(text).expect("delays"), "3*812+4*188+30*1");
    assert_eq!(parse(r#"{"delay_steps": {"2": 5}}"#).expect("one"), "2");
    for (text, problem) in [
        ("{", "line 1"),
        (r#"{"delay_steps": {}}"#, "no delay"),
        (r#"{"delay_steps": {"3": 0}}"#, "no delay"),
        (r#"{"delay_steps": {"300": 1}}"#, "300 control steps"),
    ] {
        let error = parse(text).expect_err(text).to_string();
        assert!(error.contains(problem), "{text}: {error}");
    }
}

#[test]
fn delays_as_long_as_a_response_are_refused_with_the_remedy() {
    for (text, horizon) in [("wait", 1), ("hold:9", 1), ("overlap:7", 8), ("overlap:1*1+9*1", 8)] {
        assert_eq!(execution(text).check(horizon), Ok(()), "{text}");
    }
    for text in ["overlap:8", "overlap:9,rtc", "overlap:8*1+9*1"] {
        let error = execution(text).check(8).expect_err(text).to_string();
        assert!(error.contains("Choose a delay below 8, `hold:"), "{error}");
    }
}
