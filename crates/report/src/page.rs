//! The report as one self-contained page of HTML without scripts, in a light and a dark
//! scheme, for screens, phones and paper. The modules below write its sections.

pub(crate) mod findings;
mod methods;

use benchmark::{Condition, Level};
use maud::{DOCTYPE, Markup, PreEscaped, html};
use paired::Finding;

use crate::analysis::Analysis;
use crate::block::{self, Block, Rows, Section, cell};
use crate::comparison::Comparison;
use crate::comparison_tables::pairs;
use crate::document::Document;
use crate::figures::{self, Figure, Link, levels};
use crate::paper;
use crate::simulated;
use crate::subject::Quarantined;
use crate::tables;

/// The page's style, with that of its figures.
pub const STYLE: &str = concat!(include_str!("page/style.css"), include_str!("figures/style.css"));

/// Renders the report as a complete HTML file.
pub fn page(document: &Document) -> String {
    let title = title(document);
    let page = html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                meta name="color-scheme" content="light dark";
                meta name="generator" content={ "rollout " (env!("CARGO_PKG_VERSION")) };
                title { (title) }
                style { (PreEscaped(STYLE)) }
            }
            body {
                header {
                    p.kicker { (kicker(document)) }
                    h1 { (title) }
                    (findings::subtitle(document))
                }
                main { (warnings(document)) (sections(document, None)) }
            }
        }
    };
    page.into_string()
}

/// Returns the name of the benchmark's report.
fn kicker(document: &Document) -> String {
    match &document.family {
        Some(family) => format!("{} report", family.benchmark),
        None => "LIBERO-CTRL paired report".to_owned(),
    }
}

/// Renders the warnings, for another page that includes [`STYLE`].
pub fn warnings(document: &Document) -> Markup {
    findings::warnings(&document.all_warnings())
}

/// Renders the sections below the warnings, for another page that includes
/// [`STYLE`]. The squares of the outcome matrices and the explained configurations
/// are linked to the URLs that `link` returns.
pub fn sections(document: &Document, link: Option<Link>) -> Markup {
    let Sections { open, folded } = of_document(document, link);
    block::html(&open, &folded)
}

/// The sections of a report: those of the first screen, and those that a page folds.
pub(crate) struct Sections<'a> {
    pub(crate) open: Vec<Section<'a>>,
    pub(crate) folded: Vec<Section<'a>>,
}

/// Returns the sections of a report.
pub(crate) fn of_document<'a>(document: &'a Document, link: Option<Link<'a>>) -> Sections<'a> {
    let analyses = document.analyses.as_slice();
    let section = |title: &str, blocks| Section { title: title.to_owned(), blocks };
    let methods = || section("Methods", methods::methods(document));
    if let Some(family) = &document.family {
        return Sections { open: vec![family.section()], folded: vec![quarantine(document)] };
    }
    let mut open: Vec<Section<'_>> =
        analyses.iter().flat_map(|analysis| analysis.derived(link)).collect();
    if !analyses.iter().any(Analysis::is_paired) {
        return Sections { open, folded: vec![quarantine(document), methods()] };
    }
    let sweep = Block::Html(Box::new(move || figure(SWEEP, figures::sweep(document))));
    open.push(section("Checkpoints", vec![sweep]));
    open.push(section("Success", overview(document, true)));
    let beside = move || {
        let changes = levels(document).into_iter();
        let changes = changes.filter_map(|level| figures::changes(document, level));
        figure(BESIDE, figures::by_level(document).into_iter().chain(changes).collect())
    };
    let beside = vec![Block::Html(Box::new(beside)), Block::Table(paper::table(document))];
    let per_level = |caption: &'static str, panel: fn(&Document, Level) -> Option<Figure>| {
        Block::Html(Box::new(move || {
            let levels = levels(document);
            let panels = levels.iter().filter_map(|&level| panel(document, level));
            figure(caption, panels.collect())
        }))
    };
    let named = |analysis: &Analysis, sentence: String| match analyses.len() {
        1 => Block::Paragraph(sentence),
        _ => Block::Paragraph(format!("{}: {sentence}", analysis.label)),
    };
    let by_condition =
        tables::suites("Success by condition and suite, %", analyses, true, |_| true);
    let tasks = analyses.iter().map(|of| Block::Html(Box::new(|| tables::tasks(of).folded())));
    let conditions = [Block::Table(by_condition)].into_iter().chain(tasks);
    let conditions = conditions.chain([Block::Folded(tables::subsets(analyses))]);
    let paired = vec![
        Block::Table(tables::complete(analyses)),
        per_level(
            "From independent axes to simultaneous perturbation. D: the effect of failures of \
             several axes that coincide in the same configurations. I: the further effect of \
             simultaneity. In brackets, 95 % intervals.",
            figures::decomposition,
        ),
        Block::Table(tables::bounds(analyses)),
    ];
    let inference = [tables::targets, tables::tests, tables::floor, tables::losses];
    let inference = inference.map(|of| Block::Table(of(analyses)));
    let sequences = analyses.iter().filter_map(|analysis| {
        let explanation = analysis.sequential.as_ref()?.explanation();
        Some(named(analysis, format!("{explanation}.")))
    });
    let sequences = [Block::Table(tables::sequences(analyses))].into_iter().chain(sequences);
    let matrices = Block::Html(Box::new(move || {
        let panels = analyses.iter().flat_map(|analysis| {
            let levels = levels(document).into_iter();
            levels.filter_map(move |level| figures::matrix(analysis, level, link))
        });
        figure(matrix_caption(link), panels.collect())
    }));
    let replication = analyses.iter().flat_map(|analysis| {
        let sentences = tables::replication(analysis).into_iter();
        sentences.map(move |sentence| named(analysis, sentence))
    });
    let interactions = analyses.iter().filter_map(|analysis| {
        let label = if analyses.len() > 1 { analysis.label.as_str() } else { "" };
        Some(analysis.interactions.as_ref()?.section(label))
    });
    let mut folded = vec![
        section("Differences between policies", pairs(document.comparisons())),
        section("Beside the paper's policies", beside),
        section("Findings at other levels", finding_blocks(analyses, false)),
        section("Success by condition, suite and task", conditions.collect()),
        section("Paired outcomes", paired),
        section("Uncertainty by target", inference.into()),
        section("Confidence sequences", sequences.collect()),
        section("Every configuration", vec![matrices]),
        section("Replication", replication.collect()),
    ];
    folded.extend(interactions);
    folded.extend([quarantine(document), methods()]);
    Sections { open, folded }
}

/// Returns the first screen: success by suite and by axis, and the findings at the last level.
pub(crate) fn overview(document: &Document, with_intervals: bool) -> Vec<Block<'_>> {
    let analyses = document.analyses.as_slice();
    let suites = tables::suites("Success by suite, %", analyses, false, |row| {
        matches!(row.condition, Condition::Nominal | Condition::Simultaneous)
    });
    let axes = tables::axes(analyses, with_intervals);
    let mut blocks = vec![Block::Table(suites), Block::Table(axes)];
    blocks.extend(analyses.iter().map(|of| Block::Table(simulated::by_task(of))));
    blocks.extend(finding_blocks(analyses, true));
    let several = analyses.len() > 1;
    for analysis in analyses {
        blocks.extend(tables::gates(&analysis.report).into_iter().map(|sentence| {
            let policy = if several { format!("{}: ", analysis.label) } else { String::new() };
            Block::Paragraph(format!("{policy}{sentence}"))
        }));
    }
    blocks
}

const SWEEP: &str = "Success of each checkpoint, by the number in its name: circles nominally, squares under \
    simultaneous perturbation. Whiskers are 95 % intervals, about new tasks.";

const BESIDE: &str = "Measured policies (capital letters) beside those of the paper (small letters). Left, \
    simultaneous success by level; then, for each level, emergent failures against compensated \
    successes: on the line, they balance.";

/// Returns a paragraph for each policy with its findings at the last level, or with those at the
/// other levels.
fn finding_blocks(analyses: &[Analysis], at_last: bool) -> Vec<Block<'_>> {
    let several = analyses.len() > 1;
    let blocks = analyses.iter().filter_map(|analysis| {
        let last = analysis.report.cells.last().map(|cell| cell.level);
        let is_last = |finding: &Finding| Some(finding.level) == last;
        let findings = analysis.report.findings.iter();
        let findings = findings.filter(|finding| is_last(finding) == at_last);
        let sentences: Vec<&str> = findings.map(|finding| finding.sentence.as_str()).collect();
        let policy = if several { format!("{}. ", analysis.label) } else { String::new() };
        let paragraph = || Block::Paragraph(format!("{policy}{}", sentences.join(" ")));
        (!sentences.is_empty()).then(paragraph)
    });
    blocks.collect()
}

/// Lists the quarantined rollouts with their last errors.
fn quarantine(document: &Document) -> Section<'_> {
    let analyses = document.analyses.iter();
    let rows = analyses.flat_map(|of| of.subject.errors.iter().map(move |error| (of, error)));
    let table = Rows::new("In quarantine, with the last error", rows)
        .key("rollout", |(_, error)| cell(&error.rollout))
        .when(document.analyses.len() > 1, |rows| {
            rows.words("policy", |(of, _): &(&Analysis, &Quarantined)| cell(&of.label))
        })
        .words("last error", |(_, error)| cell(&error.last_error));
    Section { title: "Quarantine".to_owned(), blocks: vec![Block::Table(table.table())] }
}

/// Renders a comparison of two policies, for another page that includes [`STYLE`].
pub fn comparison(comparison: &Comparison) -> Markup {
    let notes = comparison.warnings.iter().chain(&comparison.notes);
    html! {
        (findings::warnings(&notes.cloned().collect::<Vec<_>>()))
        (block::blocks_html(&comparison.blocks()))
    }
}

/// Renders panels with one caption, side by side if there is room; empty without a panel.
pub(crate) fn figure(caption: &str, panels: Vec<Figure>) -> Markup {
    html! {
        @if !panels.is_empty() {
            figure {
                div.panels { @for panel in &panels { (panel.inline()) } }
                figcaption { (caption) }
            }
        }
    }
}

fn title(document: &Document) -> String {
    match document.analyses.as_slice() {
        [analysis] if analysis.findings.is_some() => {
            format!("Explained outcome changes of {}", analysis.label)
        }
        [analysis] if analysis.thresholds.is_some() => format!("Thresholds of {}", analysis.label),
        [analysis] => format!("Robustness of {}", analysis.label),
        several => format!("Robustness of {} policies", several.len()),
    }
}

fn matrix_caption(link: Option<Link>) -> &'static str {
    match link {
        None => {
            "Every configuration: tasks downwards, configurations to the right, one square each. \
             On a screen, pointing at a square shows its rollouts."
        }
        Some(_) => {
            "Every configuration: tasks downwards, configurations to the right, one square each. \
             A square opens its rollouts side by side; with the keyboard, arrow keys go from \
             square to square."
        }
    }
}
