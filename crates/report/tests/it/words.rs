//! Warnings about a policy, and withheld intervals.

use benchmark::attempt::{CONNECTED_SINCE, TAUGHT_ON, TAUGHT_ON_LOOK};
use paired::Outcome;
use report::{Subject, page};
use serde_json::Value;

use crate::subjects::{document, example, provenance};

/// Returns the example with success in all simultaneous rollouts, so that no failure is emergent.
fn without_emergent_failures() -> Subject {
    let mut subject = example();
    for record in &mut subject.records {
        if record.id.condition() == benchmark::Condition::Simultaneous {
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
fn a_policy_without_nominal_success_gets_a_warning_that_names_the_doctor() {
    let mut subject = example();
    assert!(!page(&document(vec![subject.clone()])).contains("policy-gateway doctor"));
    let failed = (0..3).map(|state| paired::Record {
        id: format!("object/t0/nominal/i{state:02}").parse().expect("an id"),
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
