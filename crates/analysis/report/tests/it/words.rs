//! Tests of a report's wording: withheld intervals, the legend, and one term for each concept.

use libero_ctrl::Directions;
use paired::Outcome;
use report::{Subject, figures, page};
use rollout_types::{CONNECTED_SINCE, TAUGHT_ON, TAUGHT_ON_LOOK};
use serde_json::Value;

use crate::subjects::{broken, document, example, provenance, replicated};

/// Returns the outcomes of the first `tasks` tasks of the example.
fn some_tasks(tasks: usize) -> Subject {
    let mut subject = example();
    let first: Vec<libero_ctrl::TaskRef> = libero_ctrl::TaskRef::all().take(tasks).collect();
    subject.records.retain(|record| first.contains(&record.id.task()));
    subject
}

#[test]
fn intervals_about_new_directions_are_explained_by_the_assignment_of_directions() {
    let own = Subject { directions: Directions::Own, ..example() };
    let [shared, of_tasks] =
        ["a configuration has one direction in all tasks", "every task has directions of its own"];
    for (subjects, words, foreign) in [
        (vec![example()], Some(shared), of_tasks),
        (vec![own.clone()], Some(of_tasks), shared),
        (vec![own, example()], None, shared),
    ] {
        let document = document(subjects);
        for form in [document.text(), page(&document)] {
            let form = form.split_whitespace().collect::<Vec<_>>().join(" ");
            assert!(words.is_none_or(|words| form.contains(words)), "{form}");
            assert!(!form.contains(foreign), "{foreign} in {form}");
        }
    }
}

#[test]
fn too_few_tasks_for_an_interval_is_stated_in_every_form() {
    let few = document(vec![some_tasks(9)]);
    let json: Value = serde_json::from_str(&few.json().expect("written")).expect("JSON");
    let l2 = &json["paired"]["OpenVLA-OFT"]["L2"];
    assert_eq!((&l2["tasks"], &l2["i_ci95"]), (&9.into(), &Value::Null));
    assert_eq!(l2["no_interval"], "too_few_tasks");
    let text = few.text();
    assert!(text.contains("too few tasks for an interval by resampling, which needs 10"), "{text}");
    let paper = text.split("95 % intervals about").next().expect("the paper's measures");
    assert!(!paper.contains('['), "{text}");
    let html = page(&few);
    assert!(html.contains("(too few tasks)") && !html.contains("S_sim, ["), "no interval");
    let drawn = figures::all(&few);
    for kind in ["decomposition-l2", "directions-l2"] {
        let figure = drawn.iter().find(|figure| figure.name == kind);
        let figure = figure.expect(kind).standalone();
        assert!(figure.contains("(too few tasks)"), "{figure}");
        assert!(!figure.contains("class=\"whisker\""), "{figure}");
    }

    let enough = document(vec![some_tasks(10)]);
    assert!(!enough.text().contains("too few tasks"));
    let json: Value = serde_json::from_str(&enough.json().expect("written")).expect("JSON");
    let l2 = &json["paired"]["OpenVLA-OFT"]["L2"];
    assert_eq!(l2["i_ci95"].as_array().map(Vec::len), Some(2));
    assert_eq!(l2["no_interval"], Value::Null);
}

/// Returns the example with success in all simultaneous rollouts, so that no failure is emergent.
fn without_emergent_failures() -> Subject {
    let mut subject = example();
    for record in &mut subject.records {
        if record.id.condition() == libero_ctrl::Condition::Combination {
            record.outcome = Outcome::Success;
        }
    }
    subject
}

#[test]
fn a_share_of_zero_has_no_bootstrap_interval_but_one_for_new_tasks() {
    let document = document(vec![without_emergent_failures()]);
    let json: Value = serde_json::from_str(&document.json().expect("written")).expect("JSON");
    let l2 = &json["paired"]["OpenVLA-OFT"]["L2"];
    assert_eq!((&l2["b"], &l2["r_e_ci95"]), (&0.into(), &Value::Null));
    assert_eq!(l2["no_interval"], "no_spread");
    assert_eq!(l2["r_c_ci95"].as_array().map(Vec::len), Some(2));
    // A share of 0 still has an interval for new tasks.
    let [low, high] = [0, 1].map(|end| {
        let r_e = &json["reports"][0]["cells"][1]["inference"]["paired"]["r_e"];
        assert_eq!(r_e["value"], 0.0);
        r_e["new_tasks"][end].as_f64().expect("an end")
    });
    assert!(low == 0.0 && high > 0.0, "{low} {high}");
}

#[test]
fn every_symbol_of_the_table_is_explained_below_it_once() {
    let text = document(vec![example(), broken()]).text();
    let legend = text.rfind("\n\n").expect("a block");
    let legend: Vec<&str> = text[legend..].lines().collect();
    for symbol in [
        "loss",
        "simultaneous",
        "n complete",
        "S_indep",
        "S_conj",
        "S_sim",
        "D ",
        "I ",
        "b emergent",
        "c compensated",
        "R_e, R_c, R_d",
        "emergent share",
        "McNemar p",
        "detectable |I|",
        "worst and best",
        "95 %",
    ] {
        let lines = legend.iter().filter(|line| line.starts_with(symbol));
        assert_eq!(lines.count(), 1, "{symbol}: {legend:#?}");
    }
    // The legend leaves out symbols that the table does not print.
    assert!(!legend.iter().any(|line| line.starts_with("solvable")), "{legend:#?}");
    let one_rollout = {
        let mut subject = example();
        subject.records.truncate(1);
        subject
    };
    let text = document(vec![one_rollout]).text();
    assert!(!text.contains("S_indep"), "{text}");
}

#[test]
fn simultaneous_perturbation_has_one_name_in_every_form() {
    let document = document(vec![example(), replicated()]);
    let drawn = figures::all(&document);
    let drawn: String = drawn.iter().map(|figure| figure.standalone()).collect();
    for (form, text) in [("text", document.text()), ("page", page(&document)), ("figures", drawn)] {
        let text = text.to_lowercase();
        assert!(text.contains("simultaneous"), "{form}");
        for other in ["at once", "combination", "all together"] {
            assert!(!text.contains(other), "{form}: {other}");
        }
    }
}

#[test]
fn a_policy_without_nominal_success_gets_a_warning_that_names_the_doctor() {
    let mut subject = example();
    assert!(!page(&document(vec![subject.clone()])).contains("policy-gateway doctor"));
    let failed = (0..3).map(|state| paired::Record {
        id: format!("object/t0/clean/i{state:02}").parse().expect("an id"),
        replicate: 0,
        init_id: state,
        outcome: Outcome::Failure,
    });
    subject.records.extend(failed);
    let expected =
        "policy `OpenVLA-OFT` solved none of 3 nominal rollouts, so that nothing is known";
    let text = document(vec![subject]).text();
    let text = text.split_whitespace().collect::<Vec<_>>().join(" ");
    for part in [expected, "`policy-gateway doctor`"] {
        assert!(text.contains(part), "{part} in {text}");
    }
}

/// A server behind the same address may have been replaced whenever no connection to it was open.
#[test]
fn a_policy_without_an_identity_is_said_to_have_none_and_its_connections_are_counted() {
    let warnings = |name: &str, connections: &[&str]| {
        let provenances = connections.iter().map(|since| {
            let mut provenance = provenance("3.3.7", "single, unseeded");
            provenance.policy_checkpoint = name.to_owned();
            provenance.policy_checkpoint_digest.clear();
            provenance.policy_settings.insert(CONNECTED_SINCE.to_owned(), (*since).to_owned());
            provenance
        });
        let document = document(vec![Subject { provenances: provenances.collect(), ..example() }]);
        let notes = document.analyses[0].report.notes.join(" ");
        assert!(notes.is_empty() || page(&document).contains("not "), "{notes}");
        notes
    };
    let unnamed = "not named by its server, whose metadata are sha256 00…";
    let once = warnings(unnamed, &["a since 1"]);
    assert!(once.contains("names no checkpoint and takes no seed"), "{once}");
    assert!(!once.contains("connections"), "{once}");
    let twice = warnings("pi05_libero, as its route names it", &["a since 1", "a since 2"]);
    assert!(twice.contains("are of 2 connections") && !twice.contains("names no"), "{twice}");
}

#[test]
fn a_policy_that_was_taught_on_another_asset_pack_or_look_gets_a_warning() {
    let taught = |setting: &str, value: &str| {
        let mut provenance = provenance("3.3.7", "single");
        provenance.policy_settings.insert(setting.to_owned(), value.to_owned());
        let subject = Subject { provenances: vec![provenance], ..example() };
        let text = document(vec![subject]).text();
        text.split_whitespace().collect::<Vec<_>>().join(" ")
    };
    let warned = taught(TAUGHT_ON, "primitives");
    let expected = "was taught on asset pack `primitives` and measured on `libero`";
    assert!(warned.contains(expected), "{warned}");
    assert!(!taught(TAUGHT_ON, "libero").contains("was taught on asset pack"));
    let look = taught(TAUGHT_ON_LOOK, "mujoco-3.3.3");
    assert!(look.contains("`mujoco-3.3.3` and measured on `mujoco-3.3.2`"), "{look}");
    assert!(!taught(TAUGHT_ON_LOOK, "mujoco-3.3.2").contains("was taught on the look"));
}
