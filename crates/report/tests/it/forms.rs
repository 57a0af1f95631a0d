//! Output formats of a report: each has its required content, and a page needs no other files.

use benchmark::{Condition, Level};
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
    let without_contents = page.replace("href=\"#", "");
    for foreign in ["<script", "<link", "@import", "src=", "href=", "url("] {
        assert!(!without_contents.contains(foreign), "the page holds {foreign}");
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
    for expected in ["decomposition-l2", "paper-success", "paper-changes-l3"] {
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
        let has_counts = texts.contains("n = ") || texts.contains(" of ");
        assert!(has_counts || figure.name.starts_with("paper-"), "{}", figure.name);
        assert!(!file.contains("NaN"), "{}", figure.name);
        // Literal colours, which every converter knows, and one scheme.
        assert!(!file.contains("--") && !file.contains("@media"), "{}", figure.name);
        assert!(file.contains(".ground{fill:#fff}"), "{}", figure.name);
        if figure.name.starts_with("paper-") {
            assert_letters_are_apart(&figure.name, &svg);
        }
    }
    names.sort_unstable();
    names.dedup();
    assert_eq!(names.len(), figures.len(), "no file overwrites another");
}

#[test]
fn checkpoints_have_a_curve_over_their_numbers() {
    let checkpoint = |step: u32| Subject { policy: format!("step-{step}"), ..example() };
    let sweep = |subjects| {
        let figures = figures::all(&document(subjects)).into_iter();
        figures.filter(|figure| figure.name.starts_with("sweep")).collect::<Vec<_>>()
    };
    let figures = sweep([10_000, 500, 9000].map(checkpoint).into());
    let names = |figures: &[figures::Figure]| {
        figures.iter().map(|figure| figure.name.clone()).collect::<Vec<_>>()
    };
    assert_eq!(names(&figures), ["sweep-l1", "sweep-l2", "sweep-l3"]);
    let file = figures[1].standalone();
    let svg = roxmltree::Document::parse(&file).expect("well formed");
    let titles = svg.descendants().filter(|node| node.has_tag_name("title"));
    let titles: Vec<&str> = titles.skip(1).filter_map(|node| node.text()).collect();
    let at = |condition: &str| [500, 9000, 10_000].map(|step| format!("{step}, {condition} %"));
    assert_eq!(titles, [at("nominal: 96.7"), at("L2 simultaneous: 57.8")].concat());
    let whiskers = svg.descendants().filter(|node| node.attribute("class") == Some("whisker"));
    // The nominal rate was reported without the rollouts.
    assert_eq!(whiskers.count(), 3);
    let nominal = |step: u32| {
        let mut subject = checkpoint(step);
        subject.records.retain(|record| record.id.condition() == Condition::Nominal);
        subject
    };
    assert_eq!(names(&sweep([1, 2, 3].map(nominal).into())), ["sweep-nominal"]);
    assert!(sweep([1, 2].map(checkpoint).into()).is_empty());
}

/// Asserts that the letter of a policy hides neither a point nor the letter of another.
fn assert_letters_are_apart(figure: &str, svg: &roxmltree::Document<'_>) {
    let place = |node: roxmltree::Node<'_, '_>, names: [&str; 2], above: f64| {
        let [x, y] = names.map(|name| node.attribute(name)?.parse::<f64>().ok());
        Some([x?, y? - above])
    };
    let is_letter = |node: &roxmltree::Node<'_, '_>| {
        node.has_tag_name("text") && node.text().is_some_and(|text| text.len() == 1 && text >= "A")
    };
    let letters = svg.descendants().filter(is_letter).filter_map(|at| place(at, ["x", "y"], 4.5));
    let points = svg.descendants().filter(|node| node.attribute("r") == Some("3"));
    let points = points.filter_map(|node| place(node, ["cx", "cy"], 0.0));
    let places: Vec<[f64; 2]> = letters.chain(points).collect();
    assert!(places.len() > 14, "{figure}");
    for (index, [x, y]) in places[..places.len() / 2].iter().enumerate() {
        for [a, b] in &places[index + 1..] {
            assert!((a - x).abs() > 6.0 || (b - y).abs() > 8.0, "{figure}: {a} {b}, {x} {y}");
        }
    }
}

#[test]
fn success_by_suite_and_axis_comes_first() {
    let document = document(vec![example(), replicated()]);
    let page = page(&document);
    let (first, _) = page.split_once("<details").expect("folded sections");
    let rates = (0..3).map(|replicate| {
        let of_seed = replicated().records.into_iter().filter(move |record| {
            let id = record.id;
            let condition = (id.condition(), id.level());
            record.replicate == replicate && condition == (Condition::Simultaneous, Level::L2)
        });
        of_seed.filter(|record| record.outcome == Outcome::Success).count() as f64 / 4.0
    });
    let rates: Vec<f64> = rates.collect();
    let mean = rates.iter().sum::<f64>() / 3.0;
    let variance = rates.iter().map(|rate| (rate - mean).powi(2)).sum::<f64>() / 2.0;
    let seeds = format!("± {:.1} of 3", variance.sqrt());
    for text in ["spatial", "average", "[51.2, 64.1]", "simultaneous", &seeds, "not the one"] {
        assert!(first.contains(text), "{text}");
    }
    let json: Value = serde_json::from_str(&document.json().expect("written")).expect("JSON");
    let report = &json["reports"][0];
    assert_eq!(report["by_task"].as_array().map(Vec::len), Some(3 * 7 * 40));
    let success = report["success"].as_array().expect("rows");
    assert_eq!(success.len(), 1 + 3 * 7);
    assert_eq!(success[0]["all"], serde_json::json!({"successes": 1934, "n": 2000}));
    for cell in report["cells"].as_array().expect("levels") {
        let is_row =
            |row: &&Value| row["level"] == cell["level"] && row["condition"] == "simultaneous";
        let row = success.iter().find(is_row).expect("a row");
        assert_eq!(row["suites"]["libero_goal"]["n"], 100);
        assert_eq!(row["ci95"], cell["inference"]["paired"]["s_sim"]["new_tasks"]);
    }
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

#[test]
fn the_published_row_of_a_policy_is_that_of_its_published_outcomes() {
    let mut elsewhere = replicated();
    elsewhere.policy = "elsewhere".to_owned();
    elsewhere.realisation = Some(benchmark::Realisation::Matched);
    elsewhere.look = Some(benchmark::Look::Mujoco333);
    let text = document(vec![example(), elsewhere]).latex();
    let (_, beside) = text.split_once("caption{Beside").expect("the table");
    let mut rows = beside.lines().skip_while(|line| !line.starts_with("OpenVLA-OFT &"));
    let measured: Vec<&str> = rows.by_ref().take(3).collect();
    let rows = rows.skip_while(|line| !line.starts_with("OpenVLA-OFT (paper) &"));
    let published = rows.take(3).map(|row| row.replace(" (paper)", ""));
    assert_eq!(measured, published.collect::<Vec<_>>());
    assert!(beside.contains("look, realisation, sentences"));
}

#[test]
fn many_policies_have_a_row_per_pair() {
    let policies = ["a", "b", "c", "d"].map(|policy| {
        let mut subject = example();
        subject.policy = policy.to_owned();
        subject
    });
    let text = document(policies.into()).pairs();
    assert_fits_a_terminal(&text);
    let (_, table) = text.split_once("of every pair").expect("the table");
    let pairs = ["a  b", "a  c", "a  d", "b  c", "b  d", "c  d"];
    for pair in pairs {
        assert_eq!(table.matches(pair).count(), 1, "{pair} in {table}");
    }
}
