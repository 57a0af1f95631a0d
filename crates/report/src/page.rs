//! The report as one self-contained page of HTML without scripts, in a light and a dark
//! scheme, for screens, phones and paper. The modules below write its sections.

pub(crate) mod findings;
mod methods;

use benchmark::Level;
use maud::{DOCTYPE, Markup, PreEscaped, html};

use crate::analysis::Analysis;
use crate::block::{self, Block, Rows, Section, cell};
use crate::comparison::Comparison;
use crate::document::Document;
use crate::figures::{self, Figure, Link, levels};
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
    block::html(&of_document(document, link))
}

/// Returns the sections of a report, without a title for those of figures alone.
pub(crate) fn of_document<'a>(document: &'a Document, link: Option<Link<'a>>) -> Vec<Section<'a>> {
    if let Some(family) = &document.family {
        return vec![family.section(), quarantine(document)];
    }
    let analyses = document.analyses.as_slice();
    let section = |title: &str, blocks| Section { title: title.to_owned(), blocks };
    let per_level = |caption: &'static str, panel: fn(&Document, Level) -> Option<Figure>| {
        Block::Html(Box::new(move || {
            let levels = levels(document);
            let panels = levels.iter().filter_map(|&level| panel(document, level));
            figure(caption, panels.collect())
        }))
    };
    let methods = || section("", vec![Block::Html(Box::new(move || methods::methods(document)))]);
    let mut sections: Vec<Section<'_>> =
        analyses.iter().flat_map(|analysis| analysis.derived(link)).collect();
    sections.push(section("Findings", finding_blocks(analyses)));
    if !analyses.iter().any(Analysis::is_paired) {
        sections.push(quarantine(document));
        sections.push(methods());
        return sections;
    }
    let suites = analyses.iter().flat_map(|analysis| {
        let policy = match analyses.len() {
            1 => String::new(),
            _ => format!(": {}", analysis.label),
        };
        [
            Block::Table(tables::suites(analysis, &policy, |_| true)),
            Block::Html(Box::new(move || tables::tasks(analysis).folded())),
        ]
    });
    let named = |analysis: &Analysis, sentence: String| match analyses.len() {
        1 => Block::Paragraph(sentence),
        _ => Block::Paragraph(format!("{}: {sentence}", analysis.label)),
    };
    let gates = analyses.iter().flat_map(|analysis| {
        let gates = tables::gates(&analysis.report).into_iter();
        gates.map(move |gate| named(analysis, gate))
    });
    let nominal = [Block::Table(tables::nominal(analyses))]
        .into_iter()
        .chain(gates)
        .chain([Block::Table(tables::success(analyses, false))])
        .chain(suites)
        .chain([Block::Folded(tables::subsets(analyses))]);
    sections.push(section("Nominal success and single axes", nominal.collect()));
    let paired = tables::paired(tables::PAIRED, analyses, |cell| cell.paired.as_ref());
    sections.push(section("Paired outcomes", vec![Block::Table(paired)]));
    let inference =
        [tables::targets, tables::tests, tables::floor, tables::losses].map(|of| of(analyses));
    if analyses.iter().any(|analysis| analysis.report.cells.iter().any(|c| c.inference.is_some())) {
        let tables = inference.into_iter().map(Block::Table);
        sections.push(section("Uncertainty by target", tables.collect()));
    }
    let sequences = analyses.iter().filter_map(|analysis| {
        let explanation = analysis.sequential.as_ref()?.explanation();
        Some(named(analysis, format!("{explanation}.")))
    });
    let sequences: Vec<Block<'a>> = sequences.collect();
    if !sequences.is_empty() {
        let table = Block::Table(tables::sequences(analyses));
        let blocks = [table].into_iter().chain(sequences).collect();
        sections.push(section("Confidence sequences", blocks));
    }
    let matrices = Block::Html(Box::new(move || {
        let panels = analyses.iter().flat_map(|analysis| {
            let levels = levels(document).into_iter();
            levels.filter_map(move |level| figures::matrix(analysis, level, link))
        });
        figure(matrix_caption(link), panels.collect())
    }));
    sections.push(section(
        "",
        vec![
            per_level(
                "Success under each axis alone, and under simultaneous perturbation by all of them.",
                figures::heat_map,
            ),
            per_level(
                "From independent axes to simultaneous perturbation. D: the effect of failures of \
                 several axes that coincide in the same configurations. I: the further effect of \
                 simultaneity. In brackets, 95 % intervals.",
                figures::decomposition,
            ),
            per_level(
                "Outcome changes by direction. Left, every axis alone succeeds and the \
                 simultaneous rollout fails; right, some axis alone fails and the simultaneous \
                 rollout succeeds. Whiskers and brackets: 95 % intervals; p: exact McNemar test of \
                 left against right.",
                figures::directions,
            ),
            matrices,
        ],
    ));
    sections.extend(
        analyses
            .iter()
            .filter_map(|analysis| Some(analysis.interactions.as_ref()?.section(&analysis.label))),
    );
    let replication = analyses.iter().flat_map(|analysis| {
        let sentences = tables::replication(analysis).into_iter();
        sentences.map(move |sentence| named(analysis, sentence))
    });
    sections.push(section("Replication", replication.collect()));
    let pairs = document.comparisons().iter().flat_map(|pair| match pair {
        Ok(comparison) => {
            let warnings = comparison.warnings.iter().cloned().map(Block::Paragraph);
            let title = [Block::Heading(comparison.title())].into_iter();
            title.chain(warnings).chain(comparison.blocks()).collect::<Vec<_>>()
        }
        Err(unpairable) => {
            let title = format!("{} and {} are not compared", unpairable.a, unpairable.b);
            let reasons = unpairable.reasons.iter().cloned().map(Block::Paragraph);
            [Block::Heading(title)].into_iter().chain(reasons).collect()
        }
    });
    sections.push(section("Differences between policies", pairs.collect()));
    let solvable = tables::paired(SOLVABLE, analyses, |cell| cell.solvable.as_ref());
    let rest = [solvable, tables::bounds(analyses)].map(Block::Table);
    sections.push(section("Further tables", rest.into()));
    sections.push(quarantine(document));
    sections.push(methods());
    sections
}

/// Name of the table of configurations whose nominal rollout succeeds.
const SOLVABLE: &str = "Paired outcomes of solvable configurations, whose nominal rollout succeeds";

/// Returns the findings of each policy.
pub(crate) fn finding_blocks(analyses: &[Analysis]) -> Vec<Block<'_>> {
    let several = analyses.len() > 1;
    let findings = analyses.iter().filter(|analysis| !analysis.report.findings.is_empty());
    let blocks = findings.flat_map(|analysis| {
        let heading = several.then(|| Block::Heading(analysis.label.clone()));
        let sentences = analysis.report.findings.iter().map(|finding| match finding.claims {
            true => Block::Claim(finding.sentence.clone()),
            false => Block::Paragraph(finding.sentence.clone()),
        });
        heading.into_iter().chain(sentences)
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
