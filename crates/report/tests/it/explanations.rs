//! Tests of explanations and interactions: figures, page and tables of planted rules.

use benchmark::{AxisSet, Condition, Explanation, Level, Purpose, RolloutId, TaskRef};
use paired::{Outcome, Record, Transition};
use parquet::file::reader::{FileReader, SerializedFileReader};
use report::{
    AxisInteractions, Derived, Findings, NoInteractions, Subject, figures, page, write_csv,
    write_parquet,
};

use crate::assert_fits_a_terminal;
use crate::subjects::{document, example};

fn set(text: &str) -> AxisSet {
    text.parse().expect("a set of axes")
}

/// Returns true if a task fails under these axes by its planted rule.
fn fails(task: usize, axes: AxisSet) -> bool {
    let has = |text| set(text).is_subset(axes);
    match task % 4 {
        0 => has("camera+robot"),
        1 => has("camera+lighting+sensor"),
        2 => has("robot") && !has("camera"),
        _ => has("lighting+actuation") && !has("lighting+actuation+sensor") || axes == AxisSet::ALL,
    }
}

/// Returns the records of one configuration in each of twelve tasks, under the subsets for which
/// `is_included` returns true.
fn records(is_included: impl Fn(usize, AxisSet) -> bool) -> Vec<Record> {
    let mut records = Vec::new();
    for (index, task) in TaskRef::all().take(12).enumerate() {
        for axes in AxisSet::ALL.subsets() {
            let condition = Condition::of(axes);
            let id = match condition {
                Condition::Nominal => RolloutId::nominal(task, 16),
                _ => RolloutId::perturbed(task, condition, Level::L2, 0).expect("an id"),
            };
            if is_included(index, axes) {
                records.push(Record {
                    id,
                    init_id: 16,
                    replicate: 0,
                    outcome: Outcome::from(!fails(index, axes)),
                });
            }
        }
    }
    records
}

fn is_of_campaign(axes: AxisSet) -> bool {
    axes.len() < 2 || axes == AxisSet::ALL
}

/// Returns a campaign that ran every subset.
fn complete_campaign() -> Subject {
    Subject {
        records: records(|_, _| true),
        directions: benchmark::Directions::default(),
        reported_nominal: None,
        published_nominal: None,
        published_by_suite: Vec::new(),
        ..example()
    }
}

/// Returns a campaign that explains another by pairs and triples of axes, without the pair
/// camera+lighting.
fn explaining() -> Subject {
    let explanation = Explanation {
        campaign: "first <b>".to_owned(),
        budget: None,
        seed: 0,
        exhaustive: false,
        repeats: None,
    };
    let is_run =
        |_: usize, axes: AxisSet| (2..=3).contains(&axes.len()) && axes != set("camera+lighting");
    Subject {
        records: records(is_run),
        derived: Some(Derived {
            purpose: Purpose::Explanation(explanation),
            records: records(|_, axes| is_of_campaign(axes)),
        }),
        directions: benchmark::Directions::default(),
        reported_nominal: None,
        published_nominal: None,
        published_by_suite: Vec::new(),
        ..example()
    }
}

/// Returns all texts of a figure, including the descriptions of its parts.
fn texts(figure: &figures::Figure) -> String {
    let file = figure.standalone();
    let svg = roxmltree::Document::parse(&file);
    let svg = svg.unwrap_or_else(|error| panic!("{}: {error}", figure.name));
    let texts: Vec<&str> = svg.descendants().filter_map(|node| node.text()).collect();
    assert!(!file.contains("NaN"), "{}", figure.name);
    texts.join("\n")
}

#[test]
fn an_upset_plot_counts_each_minimal_subset_and_its_established_share() {
    let document = document(vec![explaining()]);
    let findings = document.analyses[0].findings.as_ref().expect("findings");
    let emergent = figures::upset(findings, Transition::Emergent).expect("a figure");
    let emergent = texts(&emergent);
    for expected in [
        "camera+robot: 3 configurations, established in 3",
        // Not established: its proper subset camera+lighting was not run.
        "camera+lighting+sensor: 3 configurations, established in 0",
        "lighting+actuation: 3 configurations, established in 3",
        "n = 9",
    ] {
        assert!(emergent.contains(expected), "{expected}: {emergent}");
    }
    let compensated = figures::upset(findings, Transition::Compensated).expect("a figure");
    let expected = "robot with camera: 3 configurations, established in 3";
    assert!(texts(&compensated).contains(expected));
    let names: Vec<String> =
        figures::all(&document).into_iter().map(|figure| figure.name).collect();
    assert_eq!(names, ["minimal-subsets-emergent", "minimal-subsets-compensated"]);
}

#[test]
fn a_lattice_has_a_node_for_every_subset_and_a_shape_for_every_outcome() {
    let document = document(vec![explaining()]);
    let findings = document.analyses[0].findings.as_ref().expect("findings");
    let explained = &findings.configurations[0];
    let link = |set: AxisSet| (set.len() == 2).then(|| format!("/{set}"));
    let figure = figures::lattice(
        explained.configuration,
        explained.full,
        &explained.outcomes,
        Some(&explained.explanation),
        &link,
    );
    let shown = texts(&figure);
    for words in [
        "camera+robot: fails; minimal",
        "camera+lighting: not run",
        "robot: succeeds",
        "nominal: succeeds",
        "simultaneous: fails",
    ] {
        assert!(shown.contains(words), "{words}: {shown}");
    }
    let file = figure.standalone();
    let count = |markup: &str| file.matches(markup).count();
    assert_eq!(count("<title>"), 1 + 64, "the figure, and its nodes");
    assert_eq!(count("class=\"edge\""), 6 * 32, "a line for every added axis");
    assert_eq!(count("<a href=\"/"), 15);
    // Each outcome has its own shape and colour; the legend adds one mark of each.
    let fails =
        explained.outcomes.iter().filter(|outcome| outcome.verdict.success() == Some(false));
    assert_eq!(count("class=\"fails\""), 1 + fails.count());
    assert_eq!(count("<rect class=\"fails\""), count("class=\"fails\""));
    assert_eq!(count("<circle class=\"succeeds\""), count("class=\"succeeds\""));
}

#[test]
fn the_report_of_an_explaining_campaign_shows_its_findings() {
    let document = document(vec![explaining()]);
    let html = page(&document);
    for expected in [
        "Explained outcome changes of OpenVLA-OFT",
        "Emergent failures: the fewest axes that fail together",
        "lighting+actuation by lighting+sensor+actuation",
        "first &lt;b&gt;",
    ] {
        assert!(html.contains(expected), "{expected}");
    }
    for absent in ["Paired outcomes", "Success by suite", "NaN", "<b>"] {
        assert!(!html.contains(absent), "{absent}");
    }
    let text = document.text();
    assert_fits_a_terminal(&text);
    assert!(text.contains("transitions explained"), "{text}");
    // A page about a measured policy and an explaining campaign has the sections of both.
    let both = page(&crate::subjects::document(vec![example(), explaining()]));
    assert!(both.contains("Minimal subsets of the axes") && both.contains("Paired outcomes"));
}

#[test]
fn rollouts_of_an_incomplete_configuration_count_as_waiting() {
    let mut subject = explaining();
    let derived = subject.derived.as_mut().expect("an explaining campaign");
    // The first task's transition becomes unknown.
    let mut explained = derived.records.iter_mut();
    let simultaneous = explained.find(|record| record.id.condition() == Condition::Simultaneous);
    simultaneous.expect("a simultaneous rollout").outcome = Outcome::Quarantined;
    subject.records[0].outcome = Outcome::Missing;
    let findings = Findings::of(&subject).expect("two axes").expect("findings");
    assert_eq!((findings.transitions, findings.waiting, findings.complete), (11, 1, false));
    let text = findings.text();
    let text = text.split_whitespace().collect::<Vec<_>>().join(" ");
    assert!(text.contains(", of which 1 has no outcome yet"), "{text}");
}

#[test]
fn the_table_of_explanations_has_a_row_for_each_minimal_subset() {
    let document = document(vec![explaining()]);
    let mut bytes = Vec::new();
    write_csv(&document, &mut bytes).expect("written");
    let mut csv = csv::Reader::from_reader(bytes.as_slice());
    let header = csv.headers().expect("names").clone();
    let column = |name: &str| header.iter().position(|head| head == name).expect("a column");
    let (subset, undone, open) = (column("subset"), column("undone_by"), column("open"));
    let rows: Vec<csv::StringRecord> = csv.records().collect::<Result<_, _>>().expect("rows");
    assert_eq!(rows.len(), 12);
    for row in &rows {
        let is_undone = &row[subset] == "lighting+actuation";
        let expected = if is_undone { "lighting+sensor+actuation" } else { "" };
        assert_eq!(&row[undone], expected);
        let expected = if &row[subset] == "camera+lighting+sensor" { "1" } else { "0" };
        assert_eq!(&row[open], expected);
    }
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("table.parquet");
    let file = std::fs::File::create(&path).expect("created");
    write_parquet(&document, file).expect("written");
    let file = std::fs::File::open(&path).expect("opened");
    let reader = SerializedFileReader::new(file).expect("Parquet");
    let read = reader.get_row_iter(None).expect("rows").count();
    assert_eq!(read, rows.len());
}

#[test]
fn interactions_add_up_to_the_simultaneous_success_of_the_report() {
    let document = document(vec![complete_campaign()]);
    let analysis = &document.analyses[0];
    let axis_interactions = analysis.interactions.as_ref().expect("whole lattices");
    let [level] = axis_interactions.levels.as_slice() else {
        panic!("one level");
    };
    let interactions = &level.interactions;
    let s_sim = analysis.cell(Level::L2).and_then(|cell| cell.paired.as_ref());
    let s_sim = s_sim.expect("measures").s_sim;
    let nominal = interactions.success[&AxisSet::EMPTY];
    let all: i64 = interactions.moebius.values().map(|estimate| estimate.numerator).sum();
    let total = (nominal.numerator + all) as f64 / nominal.denominator as f64;
    assert_eq!(total, s_sim, "the sum is exact");

    let text = axis_interactions.text();
    let index = 100.0 * interactions.pairs[&set("camera+robot")].value;
    let pair = text
        .lines()
        .find(|line| line.starts_with("camera+robot") && line.contains(&format!("{index:+.1}")));
    assert!(pair.is_some() && text.contains("+ sets of 3 axes"), "{text}");
    assert_fits_a_terminal(&text);
    assert!(page(&document).contains("Interactions of the axes"));
}

#[test]
fn without_a_whole_lattice_there_are_no_interactions_and_the_remedy_is_named() {
    let gap = set("robot+language");
    let incomplete = Subject { records: records(|_, axes| axes != gap), ..complete_campaign() };
    let error = AxisInteractions::of(&incomplete).expect_err("no complete configuration");
    assert!(matches!(error, NoInteractions::Incomplete { configurations: 12, .. }));
    let words = error.to_string();
    assert!(words.contains("robot+language") && words.contains("--subsets all"), "{words}");
    // A configuration with a gap is excluded.
    let one_incomplete =
        Subject { records: records(|index, axes| index > 0 || axes != gap), ..complete_campaign() };
    let remaining = AxisInteractions::of(&one_incomplete).expect("eleven configurations");
    assert_eq!((remaining.levels[0].interactions.n, remaining.levels[0].left_out), (11, 1));
}

/// Returns a campaign that repeats the first transition eight times; all axes together fail in
/// `failures` of the repeats.
fn repeating(failures: u32) -> Subject {
    let mut subject = explaining();
    let derived = subject.derived.as_mut().expect("an explaining campaign");
    let Purpose::Explanation(explanation) = &mut derived.purpose else {
        panic!("an explaining campaign");
    };
    explanation.repeats = Some(24);
    let first = records(|task, axes| task == 0 && is_of_campaign(axes) && !axes.is_empty());
    let repeats = first.iter().flat_map(|record| {
        (1..=8).map(move |replicate| Record {
            replicate,
            outcome: match record.id.condition() {
                Condition::Simultaneous => Outcome::from(replicate > failures),
                _ => Outcome::Success,
            },
            ..*record
        })
    });
    subject.records = repeats.collect();
    subject
}

#[test]
fn a_transition_that_its_repeats_do_not_show_is_reported_as_not_confirmed() {
    let findings = |failures| {
        let findings = Findings::of(&repeating(failures)).expect("two axes");
        findings.expect("findings")
    };
    let (shown, chance) = (findings(8), findings(4));
    assert_eq!((shown.transitions, shown.not_confirmed), (12, 0));
    assert_eq!((chance.transitions, chance.not_confirmed), (12, 1));
    let text =
        |findings: &Findings| findings.text().split_whitespace().collect::<Vec<_>>().join(" ");
    let words = "not confirmed by repeats, so that they may be due to chance: 1";
    assert!(text(&chance).contains(words) && !text(&shown).contains("not confirmed"));
}

#[test]
fn the_prospect_has_the_repeats_of_every_subset_and_too_few_repeats_are_refused() {
    let campaign =
        Subject { records: records(|_, axes| is_of_campaign(axes)), ..complete_campaign() };
    let prospect = |repeats| {
        let explanation = Explanation {
            campaign: "first".to_owned(),
            budget: None,
            seed: 0,
            exhaustive: false,
            repeats,
        };
        Findings::prospect(&campaign, &explanation)
    };
    let rollouts =
        |repeats| prospect(repeats).map(|prospect| (prospect.sought, prospect.rollouts()));
    assert_eq!(rollouts(None), Ok((12, 12 * 56)));
    assert_eq!(rollouts(Some(12)), Ok((12, 12 * 63 * 12)));
    let error =
        rollouts(Some(11)).expect_err("the p-value of 11 equal repeats, 2⁻¹⁰, is above 5 % / 56");
    assert!(error.to_string().contains("allow 12 or more"), "{error}");
}
