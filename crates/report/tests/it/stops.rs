//! Reports of campaigns that may end early.

use benchmark::{Level, Stop, Strata};
use paired::Outcome;
use report::{Document, EarlyStop, Subject};
use serde_json::Value;

use crate::assert_fits_a_terminal;
use crate::subjects::example;

/// Returns a campaign with the published outcomes and a stop rule.
fn early(rule: &str, has_stopped: bool) -> Subject {
    Subject {
        early_stop: Some(EarlyStop {
            stop: Stop { rule: rule.parse().expect("a rule"), seed: 3, strata: Strata::Suites },
            has_stopped,
        }),
        ..example()
    }
}

fn json(document: &Document) -> Value {
    serde_json::from_str(&document.json().expect("JSON")).expect("JSON")
}

/// Returns the text with single spaces in place of its line breaks.
fn words(document: &Document) -> String {
    let text = document.text();
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

fn document(subject: Subject) -> Document {
    Document::new(vec![subject]).expect("no rollout twice")
}

#[test]
fn figures_of_a_stopped_campaign_use_the_configurations_of_its_intervals() {
    let stopped = document(early("width(I) < 0.2", true));
    let report = json(&stopped);
    let sequential = &report["reports"][0]["sequential"];
    let used = &sequential["used"];
    assert!(used.as_u64().is_some_and(|used| used < 400), "{used}");
    let policy = report["paired"].as_object().expect("policies").keys().next();
    let measures = &report["paired"][policy.expect("a policy")];
    for level in ["L1", "L2", "L3"] {
        assert_eq!(&measures[level]["n"], used, "{level}");
        let [low, high] = [0, 1].map(|end| &sequential["levels"][level]["I"][end]);
        let width = high.as_f64().expect("a number") - low.as_f64().expect("a number");
        assert!(width < 0.2, "{level}: {width}");
    }
    let text = stopped.text();
    assert_fits_a_terminal(&text);
    let page = report::page(&stopped);
    assert!(page.contains("Stopped early after") && page.contains("not valid"));

    // Outcomes after the look at which the campaign stopped affect no figure.
    let analysis = &stopped.analyses[0];
    let mut altered = early("width(I) < 0.2", true);
    for record in &mut altered.records {
        let is_used = |matched: &&paired::Matched| {
            (matched.task, Some(matched.config)) == (record.id.task(), record.id.config())
        };
        let is_perturbed = record.id.level() != Level::L0;
        let used = analysis.records.configurations().iter().any(|matched| is_used(&matched));
        if is_perturbed && !used {
            record.outcome = Outcome::Success;
        }
    }
    assert_eq!(json(&document(altered)), report);
}

#[test]
fn only_the_estimate_that_ended_a_campaign_has_a_star_and_a_warning() {
    let stopped = document(early("I excludes 0 and width(S_sim) < 0.5", true));
    let text = words(&stopped);
    let report = json(&stopped);
    let sequential = &report["reports"][0]["sequential"];
    assert_eq!(sequential["has_stopped"], true);
    for level in ["L1", "L3"] {
        let number = |value: &Value| value.as_f64().expect("a number");
        let estimate = number(&sequential["estimates"][level]["I"]);
        let ends = &sequential["levels"][level]["I"];
        assert!(number(&ends[0]) <= estimate && estimate <= number(&ends[1]));
        assert!(text.contains(&format!("{:+.1}*", 100.0 * estimate)), "{text}");
    }
    assert!(text.contains("* is overstated"), "{text}");
    assert!(text.contains("estimates of I are overstated"), "{text}");
    assert_eq!(sequential["overstated"], serde_json::json!(["I"]));
    assert_eq!(report["reports"][0]["overstated"], serde_json::json!(["I"]));
    let page = report::page(&stopped);
    assert!(page.contains("*<small>[") && page.contains("estimates of I are overstated"));
    let width = document(early("width(I) < 0.2", true)).text();
    assert!(!width.contains("overstated") && !width.contains("* "), "{width}");
}

#[test]
fn the_confidence_sequences_of_a_complete_campaign_are_points() {
    let plain = json(&document(example()));
    let mut ended = json(&document(early("I excludes 1", false)));
    let report = ended["reports"][0].as_object_mut().expect("a report");
    let sequential = report.remove("sequential").expect("confidence sequences");
    assert_eq!(sequential["used"], 400);
    for interval in sequential["levels"]["L2"].as_object().expect("measures").values() {
        assert_eq!(interval[0], interval[1]);
    }
    assert_eq!(ended, plain, "the rest of the report is the same");
}
