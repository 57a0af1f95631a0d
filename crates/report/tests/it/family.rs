//! Reports of campaigns of LIBERO's family.

use std::collections::BTreeMap;
use std::path::Path;

use benchmark::Suite;
use benchmark::family::plus::Dimension;
use benchmark::family::protocol::Protocol;
use benchmark::family::{Case, ParaFilters, PlusFilters, Selection};
use paired::{NoInterval, Outcome, Record};
use report::{Document, DocumentError, Family, FamilyComparison, Origin, Subject, page};

use crate::subjects::{document, example};

/// Returns a campaign of noise and robot variants in which `outcome` decides each rollout.
fn subject(suites: Vec<Suite>, outcome: impl Fn(&Case) -> Outcome) -> Subject {
    let selection = Selection::Plus(PlusFilters {
        suites,
        dimensions: vec![Dimension::Noise, Dimension::Robot],
        ..PlusFilters::default()
    });
    subject_of(&selection, &Protocol::PLUS_OFFICIAL, outcome)
}

/// Returns a campaign of a selection in which `outcome` decides each rollout.
fn subject_of(
    selection: &Selection,
    protocol: &Protocol,
    outcome: impl Fn(&Case) -> Outcome,
) -> Subject {
    let variants = selection.cases().expect("variants");
    let cases = Case::unperturbed(&variants).into_iter().chain(variants);
    let records = cases.map(|case| Record {
        id: case.row(protocol).id,
        init_id: 0,
        replicate: 0,
        outcome: outcome(&case),
    });
    Subject {
        origin: Origin::Campaign {
            name: "plus".to_owned(),
            endpoint: "http://127.0.0.1:1".to_owned(),
            design: "rows-00000000".to_owned(),
        },
        protocol: Some(protocol.name.to_owned()),
        records: records.collect(),
        progress: Vec::new(),
        errors: Vec::new(),
        ..example()
    }
}

/// Unperturbed rollouts succeed in tasks of even number, robot variants everywhere, and noise
/// nowhere.
fn by_dimension(case: &Case) -> Outcome {
    match case.group().as_deref() {
        None => Outcome::from(case.task.index().is_multiple_of(2)),
        Some("robot") => Outcome::Success,
        Some(_) => Outcome::Failure,
    }
}

fn family(subject: Subject) -> Family {
    document(vec![subject]).family.expect("of LIBERO's family")
}

#[test]
fn variants_are_counted_by_dimension_and_paired_with_the_unperturbed_rollout() {
    let family = family(subject(Suite::ALL.to_vec(), by_dimension));
    let names: Vec<&str> = family.groups.iter().map(|line| line.name.as_str()).collect();
    // In the order of the benchmark's table.
    assert_eq!(names, ["robot", "noise"]);
    let [robot, noise] = family.groups.as_slice() else {
        panic!("{names:?}");
    };
    assert_eq!((robot.rollouts, robot.successes, robot.pairs), (1550, 1550, 1550));
    assert_eq!((noise.rollouts, noise.successes, noise.tasks), (1601, 0, 40));
    assert_eq!((robot.broken, noise.gained), (0, 0));
    assert!(robot.gained > 0 && robot.gained < 1550);
    assert_eq!(noise.loss, Some(100.0 * noise.broken as f64 / 1601.0));
    // The success rate is the same in every resampling, but the loss is not.
    assert_eq!(robot.no_interval, Some(NoInterval::NoSpread));
    let [low, high] = noise.loss_interval.expect("an interval");
    assert!(low < noise.loss.expect("pairs") && noise.loss.expect("pairs") < high);
    let all = &family.all;
    assert_eq!((all.rollouts, all.successes), (3151, 1550));
    let [low, high] = all.interval.expect("an interval");
    assert!(low < 49.2 && 49.2 < high && high - low < 10.0, "{low} {high}");
    let of_difficulties: u64 = family.difficulties.iter().map(|line| line.rollouts).sum();
    let of_cells: u64 = family.cells.iter().map(|line| line.rollouts).sum();
    assert_eq!((of_difficulties, of_cells), (3151, 3151));
    assert_eq!((family.unperturbed.rollouts, family.unperturbed.successes), (40, 20));
}

#[test]
fn a_variant_is_paired_with_the_unperturbed_rollout_of_its_replicate() {
    let mut subject = subject(vec![Suite::Goal], |_| Outcome::Success);
    let failed = |record: &Record| Record { replicate: 1, outcome: Outcome::Failure, ..*record };
    let second: Vec<Record> = subject.records.iter().map(failed).collect();
    subject.records.extend(second);
    let all = family(subject).all;
    assert_eq!((all.pairs, all.broken, all.gained), (all.rollouts, 0, 0));
}

#[test]
fn rollouts_without_an_outcome_are_reported_and_in_no_figure() {
    let document = document(vec![subject(vec![Suite::Goal], |case| match case.task.index() {
        0 => Outcome::Missing,
        1 => Outcome::Quarantined,
        _ => by_dimension(case),
    })]);
    let family = document.family.as_ref().expect("of LIBERO's family");
    assert!(family.missing > 10 && family.quarantined > 10);
    assert_eq!(family.unperturbed.rollouts, 8);
    assert_eq!(family.all.pairs, family.all.rollouts);
    // Eight tasks are too few for an interval.
    assert_eq!(family.all.no_interval, Some(NoInterval::TooFewTasks));
    let text = document.text();
    assert!(text.contains("have no outcome so far"), "{text}");
    assert!(text.contains("are quarantined"), "{text}");
    assert!(text.lines().all(|line| line.chars().count() <= 80), "{text}");
}

#[test]
fn every_form_has_the_dimensions_and_no_measure_of_libero_ctrl() {
    let document = document(vec![subject(Suite::ALL.to_vec(), by_dimension)]);
    let json = document.json().expect("JSON");
    for form in [&document.brief(), &document.text(), &page(&document), &json] {
        assert!(form.contains("noise") && form.contains("plus-official"), "{form}");
        assert!(!form.contains("R_e") && !form.contains("S_sim"), "{form}");
    }
    let text = document.text();
    assert!(text.contains("noise difficulty 1"));
    let row = |policy: &str| text.lines().find(|line| line.starts_with(policy));
    let percents = |policy| -> Vec<&str> {
        let row: &str = row(policy).expect("a row of the published table");
        row.split_whitespace().rev().take(7).collect()
    };
    // In reverse: light, layout, noise, language, camera, robot, background.
    assert_eq!(percents("this campaign"), ["-", "-", "0.0", "-", "-", "100.0", "-"]);
    assert_eq!(percents("OpenVLA-OFT "), ["88.7", "74.2", "75.8", "79.5", "56.4", "31.9", "93.3"]);
    assert!(text.lines().all(|line| line.chars().count() <= 80), "{text}");
    assert!(page(&document).contains("OpenVLA-OFT+") && json.contains("OpenVLA-OFT+"));
}

/// Returns a campaign of all sentences of LIBERO-Para and their unperturbed rollouts.
fn para(outcome: impl Fn(&Case) -> Outcome) -> Subject {
    let selection = Selection::Para(ParaFilters::default());
    subject_of(&selection, &Protocol::PARA_OFFICIAL, outcome)
}

#[test]
fn sentences_are_counted_by_type_and_paired_with_the_unperturbed_rollout() {
    // Other words for the object are understood in the first five tasks only.
    let subject = || {
        para(|case| match case.group().as_deref() {
            None => Outcome::Success,
            Some("obj lexical") => Outcome::from(case.task.index() < 5),
            Some(group) => Outcome::from(group.starts_with("act")),
        })
    };
    let found = family(subject());
    let names = |lines: &[report::Line]| -> Vec<String> {
        lines.iter().map(|line| line.name.clone()).collect()
    };
    assert_eq!(names(&found.kinds), ["obj", "act", "comp"]);
    assert_eq!(
        names(&found.groups),
        [
            "obj lexical",
            "act lexical",
            "act structural",
            "act pragmatical",
            "comp lexical+lexical",
            "comp lexical+structural",
            "comp lexical+pragmatical",
        ]
    );
    assert_eq!(found.cells.len(), 43);
    let counts = found.kinds.iter().map(|line| (line.rollouts, line.pairs));
    let counts: Vec<(u64, u64)> = counts.collect();
    assert_eq!(counts, [(259, 259), (870, 870), (2963, 2963)]);
    let [objects, actions, both] = found.kinds.as_slice() else {
        panic!("{:?}", found.kinds);
    };
    assert_eq!((actions.broken, both.broken), (0, 2963));
    assert_eq!(objects.broken, 259 - objects.successes);
    let [low, high] = objects.interval.expect("ten tasks");
    assert!(low < 50.0 && 50.0 < high, "{low} to {high}");
    assert_eq!(found.unperturbed.rollouts, 10);
    // Sentences of `comp` are far from the tasks' instructions, so that their failures cost more.
    let [usual, _, _] = found.pride.as_slice() else {
        panic!("{:?}", found.pride);
    };
    assert!(usual.percent < found.all.percent && usual.interval.is_some());
    let document = document(vec![subject()]);
    let json = document.json().expect("JSON");
    for form in [&document.brief(), &document.text(), &page(&document), &json] {
        for words in ["para-official", "act structural"] {
            assert!(form.contains(words), "{form}");
        }
        assert!(form.to_lowercase().contains("pride"), "{form}");
    }
    let text = document.text();
    assert!(text.contains("comp contextual+subordination"), "{text}");
    assert!(text.lines().all(|line| line.chars().count() <= 80), "{text}");
}

/// Figures of the benchmark's own code for the log that it ships.
#[test]
fn the_shipped_log_of_libero_para_has_the_scores_of_its_own_code() {
    let test = "the_shipped_log_of_libero_para_has_the_scores_of_its_own_code";
    let Ok(checkout) = std::env::var("ROLLOUT_PARA") else {
        println!("skipped {test}: ROLLOUT_PARA names no checkout of LIBERO-Para");
        return;
    };
    let folder = Path::new(&checkout).join("logs_para/example_xiaomi-robotics-0/seed7");
    let mut successes = BTreeMap::new();
    for eval in 0..10 {
        let path = folder.join(format!("eval{eval}.json"));
        let text = std::fs::read_to_string(&path).expect("the log of a checkout");
        let log: serde_json::Value = serde_json::from_str(&text).expect("JSON");
        for episode in log["episodes"].as_array().expect("episodes") {
            let name = episode["bddl_file"].as_str().expect("a file");
            let success = episode["success"].as_bool().expect("an outcome");
            successes.insert(name.trim_end_matches(".bddl").to_owned(), success);
        }
    }
    assert_eq!(successes.len(), 4092);
    let found = family(para(|case| {
        successes.get(&case.name()).map_or(Outcome::Missing, |success| Outcome::from(*success))
    }));
    assert_eq!((found.all.rollouts, found.missing), (4092, 10));
    let percents = found.pride.iter().map(|pride| pride.percent);
    let percents: Vec<String> = [found.all.percent]
        .into_iter()
        .chain(percents)
        .map(|percent| format!("{:.1}", percent.expect("rollouts")))
        .collect();
    assert_eq!(percents, ["76.1", "69.3", "73.8", "63.7"]);
}

#[test]
fn the_family_is_never_pooled_with_other_rollouts() {
    let plus = || subject(vec![Suite::Goal], by_dimension);
    let exported = Subject { protocol: None, ..plus() };
    for subjects in [vec![plus(), plus()], vec![example(), plus()], vec![exported]] {
        let error = Document::new(subjects).expect_err("pooled");
        assert!(matches!(error, DocumentError::Pooled { .. }), "{error}");
    }
    let unknown = Subject { protocol: Some("plus-unheard-of".to_owned()), ..plus() };
    let error = Document::new(vec![unknown]).expect_err("no such protocol");
    assert!(matches!(error, DocumentError::Family(_)), "{error}");
}

/// A variant is paired with itself under another protocol.
#[test]
fn two_protocols_are_compared_variant_by_variant() {
    let official = subject(vec![Suite::Goal], by_dimension);
    // Under protocol `plus-rlinf`, robot variants of tasks of odd number fail.
    let rlinf = Subject {
        protocol: Some("plus-rlinf".to_owned()),
        ..subject(vec![Suite::Goal], |case| match by_dimension(case) {
            Outcome::Success if case.group().is_some() => {
                Outcome::from(case.task.index().is_multiple_of(2))
            }
            outcome => outcome,
        })
    };
    let compared = FamilyComparison::of(&official, &rlinf).expect("comparable");
    let compared = compared.expect("of LIBERO's family");
    let [robot, noise] = compared.groups.as_slice() else {
        panic!("{:?}", compared.groups);
    };
    assert_eq!((robot.name.as_str(), noise.name.as_str()), ("robot", "noise"));
    assert_eq!((robot.pairs, robot.a_successes), (409, 409));
    assert_eq!(robot.only_a, robot.pairs - robot.b_successes);
    assert!(robot.only_a > 0 && robot.only_b == 0, "{robot:?}");
    let difference = 100.0 * robot.only_a as f64 / 409.0;
    assert!((robot.difference.expect("pairs") - difference).abs() < 1e-9);
    let [low, high] = robot.interval.expect("ten tasks");
    assert!(low < difference && difference < high, "{low} to {high}");
    assert_eq!((noise.pairs, noise.only_a, noise.only_b), (379, 0, 0));
    assert_eq!(compared.unperturbed.pairs, 10);
    assert_eq!(compared.unpaired, [0, 0]);
    let text = compared.text();
    assert!(text.contains("under plus-official") && text.contains("under plus-rlinf"), "{text}");
    assert!(text.lines().all(|line| line.len() <= 80), "{text}");
}

#[test]
fn campaigns_without_a_common_rollout_or_benchmark_are_not_compared() {
    let goal = subject(vec![Suite::Goal], by_dimension);
    let spatial = subject(vec![Suite::Spatial], by_dimension);
    let error = FamilyComparison::of(&goal, &spatial).expect_err("other tasks");
    assert!(error.to_string().contains("no rollout in common"), "{error}");
    let pro = Subject {
        protocol: Some("pro-official".to_owned()),
        ..subject(vec![Suite::Goal], by_dimension)
    };
    let error = FamilyComparison::of(&goal, &pro).expect_err("other benchmark");
    assert!(error.to_string().contains("run both with the same"), "{error}");
    assert_eq!(FamilyComparison::of(&goal, &example()).expect("no comparison"), None);
}
