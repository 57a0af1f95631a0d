//! Comparison of two policies: the pairing, refusals with their messages, and every output format.

use std::path::Path;

use benchmark::attempt::{GoalProgress, Pin, Provenance};
use benchmark::{Condition, Directions, Look, RolloutId};
use paired::{Obstacle, Outcome, Progress};
use report::{Comparison, Document, Origin, Setups, Subject, Unpairable, figures, import, page};
use serde_json::{Value, json};

use crate::assert_fits_a_terminal;

/// Returns a campaign with the published outcomes of OpenVLA-OFT.
fn campaign(policy: &str) -> Subject {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../../examples/openvla_oft");
    let subject = import(Path::new(folder)).expect("the example data");
    Subject {
        policy: policy.to_owned(),
        origin: Origin::Campaign {
            name: format!("of-{policy}"),
            endpoint: "http://127.0.0.1:1".to_owned(),
            design: "libero-ctrl-v0.1".to_owned(),
        },
        realisation: Some("matched".parse().expect("a mode")),
        look: None,
        provenances: vec![Provenance {
            pin: Pin {
                renderer: "software".to_owned(),
                look: Look::default(),
                mujoco_version: "3.3.7".to_owned(),
                asset_pack: "libero".to_owned(),
                asset_pack_digest: "a".repeat(64),
            },
            policy_checkpoint: "step 7".to_owned(),
            ..Provenance::default()
        }],
        published_nominal: None,
        published_by_suite: Vec::new(),
        ..subject
    }
}

/// Returns [`campaign`] with other outcomes: rollouts at multiples of 17 succeed, and the rest of
/// those at multiples of 13 fail.
fn altered(policy: &str) -> Subject {
    let mut subject = campaign(policy);
    for (index, record) in subject.records.iter_mut().enumerate() {
        if index.is_multiple_of(17) {
            record.outcome = Outcome::Success;
        } else if index.is_multiple_of(13) {
            record.outcome = Outcome::Failure;
        }
    }
    subject
}

fn compare(a: Subject, b: Subject) -> Result<Comparison, Unpairable> {
    let document = Document::new(vec![a, b]).expect("no duplicates");
    let [a, b] = document.analyses.as_slice() else {
        panic!("two analyses");
    };
    Comparison::of([a, b], [&a.subject.setups, &b.subject.setups])
}

#[test]
fn the_documented_columns_are_those_of_the_tables() {
    let columns = compare(campaign("first"), altered("second")).expect("comparable").columns();
    let documented = include_str!("../../../../docs/REPORT.md");
    assert!(documented.contains(&columns), "docs/REPORT.md lacks\n{columns}");
}

#[test]
fn json_has_every_condition_at_every_level_with_its_counts() {
    let (a, b) = (campaign("first"), altered("second"));
    // Counts the expected pairs by position: both subjects list their rollouts in the same order.
    let is_cell = |id: &RolloutId| {
        id.level().to_string() == "L2" && id.condition() == Condition::Simultaneous
    };
    let pairs = a.records.iter().zip(&b.records);
    let pairs = pairs.filter(|(a, _)| is_cell(&a.id));
    let count = |outcome_a: Outcome, outcome_b: Outcome| {
        let matching =
            pairs.clone().filter(|(a, b)| (a.outcome, b.outcome) == (outcome_a, outcome_b));
        matching.count()
    };
    let (a_only, b_only) =
        (count(Outcome::Success, Outcome::Failure), count(Outcome::Failure, Outcome::Success));
    assert!(a_only > 0 && b_only > 0);
    let comparison = compare(a, b).expect("comparable");
    let json: Value = serde_json::to_value(&comparison).expect("JSON");
    assert_eq!(json["a"]["label"], "first");
    assert_eq!(json["b"]["origin"]["campaign"]["name"], "of-second");
    assert_eq!((&json["warnings"], &json["notes"]), (&json!([]), &json!([])));
    assert_eq!(json["min_tasks"], 10);
    let cells = json["cells"].as_array().expect("cells");
    assert_eq!(cells.len(), 3 * 7);
    let is_expected = |cell: &&Value| cell["level"] == "L2" && cell["condition"] == "simultaneous";
    let cell = cells.iter().find(is_expected).expect("a cell");
    let difference_json = &cell["difference"];
    assert_eq!((&difference_json["n"], &difference_json["tasks"]), (&json!(400), &json!(40)));
    assert_eq!(
        (&difference_json["a_only"], &difference_json["b_only"]),
        (&json!(a_only), &json!(b_only))
    );
    let difference = (a_only as f64 - b_only as f64) / 400.0;
    assert!((difference_json["difference"].as_f64().expect("a number") - difference).abs() < 1e-12);
    let ends = difference_json["difference_ci95"].as_array().expect("an interval");
    let ends: Vec<f64> = ends.iter().filter_map(Value::as_f64).collect();
    assert!(ends[0] < difference && difference < ends[1], "{difference_json}");
    assert_eq!(difference_json["no_interval"], Value::Null);
}

#[test]
fn a_policy_against_itself_differs_nowhere_and_has_no_interval() {
    let comparison = compare(campaign("one"), campaign("one")).expect("comparable");
    assert_eq!(
        (comparison.a.label.as_str(), comparison.b.label.as_str()),
        ("one (of-one)", "one (of-one) 2")
    );
    for cell in &comparison.statistics.cells {
        let difference = cell.difference.as_ref().expect("outcomes");
        assert_eq!((difference.a_only, difference.b_only, difference.mcnemar_p), (0, 0, 1.0));
        assert_eq!((difference.difference, difference.difference_ci95), (0.0, None));
    }
    assert!(comparison.text().contains("no spread"));
}

fn reasons(a: Subject, b: Subject) -> String {
    let error = compare(a, b).expect_err("nothing can be paired");
    error.to_string()
}

#[test]
fn policies_measured_differently_are_not_compared_and_the_difference_is_named() {
    type Alter = fn(&mut Pin);
    let alterations: [(Alter, &str); 4] = [
        (
            |pin| {
                "primitives".clone_into(&mut pin.asset_pack);
                pin.asset_pack_digest = "b".repeat(64);
            },
            "asset pack (first with libero (aaaaaaaaaaaa), second with primitives (bbbbbbbbbbbb))",
        ),
        (|pin| "llvmpipe".clone_into(&mut pin.renderer), "renderer"),
        (
            |pin| pin.look = Look::Mujoco333,
            "look (first with mujoco-3.3.2, second with mujoco-3.3.3)",
        ),
        (|pin| "3.9.9".clone_into(&mut pin.mujoco_version), "MuJoCo version"),
    ];
    for (alter, expected) in alterations {
        let mut subject = altered("second");
        alter(&mut subject.provenances[0].pin);
        let message = reasons(campaign("first"), subject);
        assert!(message.contains(&format!("more than one {expected}")), "{message}");
    }
    let mut file = altered("second");
    file.provenances.clear();
    file.look = Some(Look::Mujoco333);
    assert!(reasons(campaign("first"), file).contains("more than one look"));
    let mut reference = altered("second");
    reference.realisation = Some("reference".parse().expect("a mode"));
    let message = reasons(campaign("first"), reference);
    assert!(
        message.contains("first: matched, second: reference") && message.contains("--realisation"),
        "{message}"
    );
    // A subject that mixes two packs is comparable with no subject, not even with itself.
    let mut mixed = altered("second");
    let mut second_pack = mixed.provenances[0].clone();
    second_pack.pin.asset_pack_digest = "b".repeat(64);
    mixed.provenances.push(second_pack);
    assert!(reasons(campaign("first"), mixed.clone()).contains("asset pack"));
    assert!(reasons(mixed.clone(), mixed).contains("asset pack"));
}

#[test]
fn policies_without_a_common_rollout_are_not_compared() {
    let is_l1 = |id: &RolloutId| id.level().to_string() == "L1";
    let (mut a, mut b) = (campaign("first"), altered("second"));
    a.records.retain(|record| is_l1(&record.id));
    b.records.retain(|record| !is_l1(&record.id));
    let message = reasons(a, b);
    assert!(message.contains("no rollout in common"), "{message}");
}

#[test]
fn result_files_are_compared_with_a_warning_of_unknown_properties() {
    let mut file = altered("second");
    file.provenances.clear();
    file.realisation = None;
    file.origin =
        Origin::File { name: "second".to_owned(), digest: "0".repeat(64), source: String::new() };
    let comparison = compare(campaign("first"), file).expect("comparable");
    let message = comparison.warnings.join("\n");
    let expected =
        "`second`: asset pack, MuJoCo version, renderer, look, realisation mode not known";
    assert!(message.starts_with(expected), "{message}");
    let text = comparison.text();
    assert!(text.contains("! `second`: asset pack, MuJoCo"), "{text}");
}

#[test]
fn a_campaign_without_results_is_compared_without_warning_and_reported_as_incomplete() {
    let mut not_run = altered("second");
    not_run.provenances.clear();
    for record in &mut not_run.records {
        record.outcome = Outcome::Missing;
    }
    let comparison = compare(campaign("first"), not_run).expect("comparable");
    assert_eq!(comparison.warnings, [""; 0]);
    assert_eq!(comparison.statistics.compared(), 0);
    let text = comparison.text();
    assert!(text.contains("8400 of 8400 rollouts have no result yet"), "{text}");
}

#[test]
fn rollouts_of_another_scene_or_perturbation_are_left_out_and_named() {
    let (mut a, mut b) = (campaign("first"), altered("second"));
    let (id, init_id) = (a.records[0].id, a.records[0].init_id);
    let state = RolloutId::nominal(id.task(), init_id);
    let from_state = a.records.iter();
    let from_state =
        from_state.filter(|record| record.id.task() == id.task() && record.init_id == init_id);
    let from_state = from_state.count();
    let perturbed = a.records.iter().find(|record| record.id.task() != id.task());
    let perturbed = perturbed.expect("forty tasks").id;
    let setups = |scene: &str, row: &str| Setups {
        rollouts: [(perturbed, row.to_owned())].into(),
        scenes: [(state, scene.to_owned())].into(),
    };
    (a.setups, b.setups) = (setups("11", "33"), setups("22", "44"));
    let comparison = compare(a, b).expect("comparable");
    let unpaired = &comparison.statistics.unpaired;
    assert_eq!(unpaired[&Obstacle::Scene].len(), from_state);
    assert_eq!(unpaired[&Obstacle::Perturbation], [perturbed]);
    assert_eq!(comparison.statistics.shared(), 8400 - 1 - from_state as u64);
    let text = comparison.text();
    assert!(
        text.contains("1 rollout that both policies have cannot be paired (another perturbation"),
        "{text}"
    );
}

#[test]
fn a_page_of_several_policies_shows_every_pair_or_why_it_cannot_be_compared() {
    let mut third = altered("third <b>");
    third.provenances[0].pin.renderer = "llvmpipe".to_owned();
    let subjects = vec![campaign("first"), altered("second"), third];
    let document = Document::new(subjects).expect("no duplicates");
    let page = page(&document);
    for words in [
        "Differences between policies",
        "<h3>first − second</h3>",
        "first and third &lt;b&gt; are not compared",
        "second and third &lt;b&gt; are not compared",
        "more than one renderer",
    ] {
        assert!(page.contains(words), "{words}");
    }
    let figures = figures::all(&document);
    let of_pairs: Vec<&str> = figures
        .iter()
        .map(|figure| figure.name.as_str())
        .filter(|name| name.starts_with("difference-"))
        .collect();
    assert_eq!(of_pairs, ["difference-first-second"]);
    let alone = Document::new(vec![campaign("first")]).expect("no duplicates");
    assert!(!report::page(&alone).contains("Differences between policies"));
}

#[test]
fn quarantined_rollouts_of_either_policy_are_excluded_from_rates_and_counted_in_the_bounds() {
    let (a, mut b) = (campaign("first"), campaign("second"));
    b.records[0].outcome = Outcome::Quarantined;
    b.records[1].outcome = Outcome::Missing;
    let cells = [b.records[0].id, b.records[1].id];
    let comparison = compare(a, b).expect("comparable");
    let cell = |id: RolloutId| {
        let mut cells = comparison.statistics.cells.iter();
        let cell = cells.find(|cell| (cell.level, cell.condition) == (id.level(), id.condition()));
        cell.expect("a cell")
    };
    let quarantined = cell(cells[0]);
    assert_eq!(quarantined.quarantined, 1);
    let bounds = quarantined.bounds.expect("bounds");
    assert!((bounds.difference[1] - bounds.difference[0] - 1.0 / bounds.n as f64).abs() < 1e-12);
    assert_eq!(cell(cells[1]).missing, 1);
}

/// Adds progress to all rollouts. If `more` is above 0, the rollouts take more steps and satisfy
/// one predicate fewer.
fn with_progress(mut subject: Subject, more: u32) -> Subject {
    let records = subject.records.iter().enumerate();
    let progress = records.map(|(index, record)| Progress {
        id: record.id,
        replicate: record.replicate,
        steps: Some(100 + index as u32 % 7 * (1 + more) + more),
        goal: Some(GoalProgress {
            predicates: 4,
            at_end: 3 - more.min(1),
            at_most: 3 - more.min(1),
        }),
    });
    subject.progress = progress.collect();
    subject
}

#[test]
fn partial_progress_is_in_text_page_and_json_beside_success() {
    let (a, b) = (campaign("first"), altered("second"));
    let without = compare(a.clone(), b.clone()).expect("comparable");
    assert!(!without.text().contains("Partial progress"));
    let comparison = compare(with_progress(a, 0), with_progress(b, 4)).expect("comparable");
    let json: Value = serde_json::to_value(&comparison).expect("JSON");
    for cell in json["cells"].as_array().expect("cells") {
        let (goal, steps) = (&cell["progress"]["goal"], &cell["progress"]["steps"]);
        assert_eq!((&goal["n"], &steps["n"]), (&cell["difference"]["n"], &cell["difference"]["n"]));
        assert_eq!(goal["difference"]["value"], 0.25);
        assert!(steps["difference"]["value"].as_f64() < Some(-4.0), "{steps}");
        assert!(steps["difference"]["new_tasks"][1].as_f64() < Some(0.0), "{steps}");
        assert!(steps["holm_p"].as_f64() < Some(0.01), "{steps}");
    }
    assert_fits_a_terminal(&comparison.text());
    let page = report::page_comparison(&comparison).into_string();
    for form in [page, comparison.text()] {
        assert!(form.contains("Partial progress: steps until success"), "{form}");
    }
}

#[test]
fn differing_directions_or_placebos_give_a_warning() {
    let (mut a, b) = (campaign("first"), altered("second"));
    let alike = compare(a.clone(), b.clone()).expect("comparable");
    assert_eq!(alike.warnings, [] as [String; 0]);
    a.directions = Directions::Own;
    a.placebo_radius = Some(0.02);
    let same_settings =
        Subject { directions: Directions::Own, placebo_radius: Some(0.02), ..b.clone() };
    let comparable = compare(a.clone(), same_settings).expect("comparable");
    let json: Value = serde_json::to_value(&comparable).expect("JSON");
    assert_eq!((&json["directions"], &json["warnings"]), (&json!("own"), &json!([])));
    let mixed = Subject { placebo_radius: Some(0.05), ..b };
    let mixed = compare(a, mixed).expect("comparable");
    let text = mixed.text().split_whitespace().collect::<Vec<_>>().join(" ");
    assert!(
        text.contains("the designs differ in their directions (`first`: directions of its own")
    );
    assert!(text.contains("placebo levels have different radii (`first`: 0.02, `second`: 0.05)"));
    assert_eq!(mixed.statistics.directions, Directions::Shared);
}
