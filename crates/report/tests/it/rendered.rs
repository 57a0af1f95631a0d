//! Snapshots of each form of a small campaign with replicates, missing and
//! quarantined rollouts, of a comparison, and of a campaign of LIBERO's family.

use std::collections::BTreeSet;

use benchmark::{Axis, Condition, Level, RolloutId, TaskRef};
use paired::Outcome;
use report::{Comparison, Document, Subject, page};

use crate::assert_fits_a_terminal;
use crate::subjects::{broken, example, replicated};

/// Returns the rollouts of the first `tasks` tasks at L2, under three conditions.
fn of_tasks(tasks: usize, mut subject: Subject) -> Subject {
    let first: Vec<TaskRef> = TaskRef::all().take(tasks).collect();
    subject.records.retain(|record| {
        let id = record.id;
        let is_kept = match id.condition() {
            Condition::Single(axis) => matches!(axis, Axis::Camera | Axis::Robot),
            _ => true,
        };
        is_kept && id.level() == Level::L2 && first.contains(&id.task())
    });
    subject.errors.truncate(1);
    subject
}

/// Removes the style and the figures, which have tests of their own, and breaks lines between rows.
fn without_figures(page: &str) -> String {
    let mut text = page.to_owned();
    for [start, end] in [["<style>", "</style>"], ["<figure>", "</figure>"], ["<svg", "</svg>"]] {
        while let Some(at) = text.find(start) {
            let length = text[at..].find(end).expect("closed") + end.len();
            text.replace_range(at..at + length, "");
        }
    }
    ["<section", "<h4", "<p", "<tr", "<dl"]
        .into_iter()
        .fold(text, |text, tag| text.replace(tag, &format!("\n{tag}")))
}

#[test]
fn every_form_of_a_small_campaign() {
    let document = Document::new(vec![of_tasks(10, broken()), of_tasks(9, replicated())]);
    let document = document.expect("no rollout twice");
    for (name, text) in [("brief", document.brief()), ("text", document.text())] {
        assert_fits_a_terminal(&text);
        insta::assert_snapshot!(name, text);
    }
    let alone = Document::new(vec![of_tasks(10, broken())]).expect("no rollout twice");
    insta::assert_snapshot!("page", without_figures(&page(&alone)));
    insta::assert_snapshot!("latex", document.latex());
}

/// Returns the first tasks and configurations at L2, with their nominal rollouts and these outcomes.
fn edge(tasks: usize, configs: u16, success: Option<bool>) -> Subject {
    let mut subject = of_tasks(tasks, example());
    subject.records.retain(|record| record.id.config().is_some_and(|config| config < configs));
    let states: BTreeSet<_> = subject.records.iter().map(|of| (of.id.task(), of.init_id)).collect();
    let first = subject.records[0];
    subject.records.extend(states.into_iter().map(|(task, init_id)| paired::Record {
        id: RolloutId::nominal(task, init_id),
        init_id,
        outcome: Outcome::Success,
        ..first
    }));
    for record in &mut subject.records {
        record.outcome = success.map_or(record.outcome, Outcome::from);
    }
    Subject { reported_nominal: None, published_nominal: None, ..subject }
}

#[test]
fn sentences_at_the_edges() {
    let cases = [
        ("nothing succeeds", edge(10, 10, Some(false))),
        ("everything succeeds", edge(10, 10, Some(true))),
        ("two configurations", edge(1, 2, None)),
        ("one task", edge(1, 10, None)),
    ];
    let texts = cases.map(|(name, subject)| {
        let document = Document::new(vec![subject]).expect("no rollout twice");
        let text = document.brief();
        let (text, _) = text.split_once("`--full`").expect("a hint");
        format!("--- {name}\n{text}")
    });
    insta::assert_snapshot!("edges", texts.concat());
}

#[test]
fn a_comparison() {
    let mut other = of_tasks(10, broken());
    "other".clone_into(&mut other.policy);
    for (index, record) in other.records.iter_mut().enumerate() {
        if index % 7 == 0 && record.outcome == Outcome::Success {
            record.outcome = Outcome::Failure;
        }
    }
    let mut subjects = [of_tasks(10, broken()), other];
    for subject in &mut subjects {
        subject.provenances.truncate(1);
    }
    let document = Document::new(subjects.into()).expect("no rollout twice");
    let [a, b] = document.analyses.as_slice() else { panic!("two analyses") };
    let setups = [&a.subject.setups, &b.subject.setups];
    let text = Comparison::of([a, b], setups).expect("comparable").text();
    assert_fits_a_terminal(&text);
    insta::assert_snapshot!("comparison", text);
}
