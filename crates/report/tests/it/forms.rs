//! Output formats of a report: each has its required content, and a page needs no other files.

use paired::Outcome;
use report::{Subject, figures, page};
use serde_json::Value;

use crate::assert_fits_a_terminal;
use crate::subjects::{broken, document, example, replicated};

#[test]
fn json_has_the_measures_of_each_policy_and_level() {
    let json = document(vec![example()]).json().expect("written");
    let json: Value = serde_json::from_str(&json).expect("JSON");
    let levels = json["paired"]["OpenVLA-OFT"].as_object().expect("levels");
    assert_eq!(levels.keys().collect::<Vec<_>>(), ["L1", "L2", "L3"]);
    let l2 = &levels["L2"];
    assert_eq!((&l2["n"], &l2["b"], &l2["c"]), (&400.into(), &54.into(), &55.into()));
    assert_eq!(l2["s_axis"]["camera"], 0.875);
    assert_eq!((&l2["s_conj"], &l2["s_sim"]), (&0.575.into(), &0.5775.into()));
    for key in ["s_indep", "d", "i", "r_e", "r_c", "r_d", "mcnemar_p"] {
        assert!(l2[key].is_f64(), "{key}: {l2}");
    }
    for key in ["i_ci95", "r_e_ci95", "r_c_ci95"] {
        assert_eq!(l2[key].as_array().map(Vec::len), Some(2), "{key}: {l2}");
    }
    // The paper's interval, within Monte-Carlo error.
    let end = |k: usize| 100.0 * l2["i_ci95"][k].as_f64().expect("a number");
    assert!((end(0) + 6.0).abs() < 0.6 && (end(1) - 6.51).abs() < 0.6, "{l2}");
}

#[test]
fn policies_with_the_same_name_get_distinct_labels() {
    let document = document(vec![example(), broken(), example()]);
    let labels: Vec<&str> = document.analyses.iter().map(|a| a.label.as_str()).collect();
    assert_eq!(labels, ["OpenVLA-OFT (openvla_oft)", "servo <b>", "OpenVLA-OFT (openvla_oft) 2"]);
}

#[test]
fn the_text_fits_a_terminal_and_begins_with_the_warnings() {
    let text = document(vec![example(), broken(), replicated()]).text();
    assert_fits_a_terminal(&text);
    assert!(text.starts_with("! the policies were perturbed in different realisation modes"));
}

#[test]
fn a_page_loads_no_other_resource() {
    let page = page(&document(vec![example(), broken(), replicated()]));
    for foreign in ["<script", "<link", "@import", "src=", "href=", "url("] {
        assert!(!page.contains(foreign), "the page holds {foreign}");
    }
    // The only URLs are XML namespaces and policy endpoints, which browsers do not load.
    let addresses = page.match_indices("http").map(|(at, _)| &page[at..at + 26]);
    for address in addresses {
        let allowed = ["http://www.w3.org/2000/svg", "http://127.0.0.1:1"];
        assert!(allowed.iter().any(|allowed| address.starts_with(allowed)), "{address}");
    }
    assert!(!page.contains("<b>") && page.contains("servo &lt;b&gt;"), "names are escaped");
    assert!(!page.contains("NaN") && !page.contains(">inf"), "every number is finite");
}

#[test]
fn a_complete_evaluation_has_no_warning() {
    assert!(!page(&document(vec![example()])).contains("class=\"warnings\""));
}

#[test]
fn the_page_of_a_campaign_without_results_warns_of_missing_results() {
    let mut subject = broken();
    for record in &mut subject.records {
        record.outcome = Outcome::Missing;
    }
    subject.errors.clear();
    let document = document(vec![subject]);
    assert!(page(&document).contains("8400 of 8400 rollouts have no result yet"));
    assert!(document.json().expect("written").contains("\"L1\": null"));
}

#[test]
fn figures_are_well_formed_files_with_counts() {
    // A label that differs from that of `broken` but maps to the same file name.
    let twin = Subject { policy: "servo {b}".to_owned(), ..broken() };
    let document = document(vec![example(), broken(), twin, replicated()]);
    let figures = figures::all(&document);
    let mut names: Vec<&str> = figures.iter().map(|figure| figure.name.as_str()).collect();
    for expected in ["single-axis-l1", "decomposition-l2", "directions-l3"] {
        assert!(names.contains(&expected), "{names:?}");
    }
    assert!(names.iter().any(|name| name.starts_with("matrix-")), "{names:?}");
    for figure in &figures {
        let file = figure.standalone();
        let svg = roxmltree::Document::parse(&file);
        let svg = svg.unwrap_or_else(|error| panic!("{}: {error}", figure.name));
        let texts = svg.descendants().filter_map(|node| node.text());
        let texts: String = texts.collect();
        assert!(!figure.title.is_empty());
        assert!(texts.contains("n = ") || texts.contains(" of "), "{}", figure.name);
        assert!(!file.contains("NaN"), "{}", figure.name);
        // Literal colours, which every converter knows, and one scheme.
        assert!(!file.contains("--") && !file.contains("@media"), "{}", figure.name);
        assert!(file.contains(".ground{fill:#fff}"), "{}", figure.name);
    }
    names.sort_unstable();
    names.dedup();
    assert_eq!(names.len(), figures.len(), "no file overwrites another");
}

#[test]
fn json_has_success_by_task() {
    let document = document(vec![example()]);
    let json: serde_json::Value =
        serde_json::from_str(&document.json().expect("written")).expect("JSON");
    let rows = json["reports"][0]["by_task"].as_array().expect("rows");
    assert_eq!(rows.len(), 3 * 7 * 40);
    assert!(rows.iter().all(|row| row["n"] == 10));
}

#[test]
fn the_same_subjects_give_the_same_bytes_in_any_order_of_their_records() {
    let mut reversed = replicated();
    reversed.records.reverse();
    let (in_order, reversed) = (document(vec![replicated()]), document(vec![reversed]));
    assert!(page(&in_order) == page(&reversed));
    let [json_in_order, json_reversed] =
        [in_order, reversed].map(|document| document.json().expect("written"));
    assert_eq!(json_in_order, json_reversed);
}
