//! The report as one self-contained page of HTML without scripts, in a light and a dark
//! scheme, for screens, phones and paper. The modules below write its sections.

mod differences;
mod explanation;
mod family;
mod findings;
mod inference;
mod methods;
mod panels;
mod sequential;
mod tables;
mod thresholds;

use maud::{DOCTYPE, Markup, PreEscaped, html};

use crate::analysis::Analysis;
use crate::comparison::Comparison;
use crate::document::Document;
use crate::figures::{self, Figure, Link, levels};
use panels::figure;

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
    findings::warnings(document)
}

/// Renders the sections below the warnings, for another page that includes
/// [`STYLE`]. The squares of the outcome matrices and the explained configurations
/// are linked to the URLs that `link` returns.
pub fn sections(document: &Document, link: Option<Link>) -> Markup {
    if let Some(family) = &document.family {
        return family::sections(family);
    }
    let levels = levels(document);
    let per_level = |panel: fn(&Document, libero_ctrl::Level) -> Option<Figure>| {
        let panels = levels.iter().filter_map(|&level| panel(document, level));
        panels.collect::<Vec<_>>()
    };
    let has_paired = document.analyses.iter().any(Analysis::is_paired);
    html! {
        (explanation::findings(document, link))
        (thresholds::sections(document))
        (findings::section(document))
        @if has_paired {
            section {
                h2 { "Paired outcomes" }
                (tables::paired(document))
            }
        }
        (inference::tables(document))
        (sequential::section(document))
        (figure("Success under each axis alone, and under simultaneous perturbation by all of them.",
            per_level(figures::heat_map)))
        (figure("From independent axes to simultaneous perturbation. D: the effect of failures \
            of several axes that coincide in the same configurations. I: the further effect of \
            simultaneity. In brackets, 95 % intervals.",
            per_level(figures::decomposition)))
        (figure("Outcome changes by direction. Left, every axis alone succeeds and the \
            simultaneous rollout fails; right, some axis alone fails and the simultaneous rollout \
            succeeds. Whiskers and brackets: 95 % intervals; p: exact McNemar test of left against \
            right.",
            per_level(figures::directions)))
        (figure(matrix_caption(link), document.analyses.iter().flat_map(|analysis| {
            levels.iter().filter_map(move |&level| figures::matrix(analysis, level, link))
        }).collect()))
        (explanation::interactions(document))
        @if has_paired {
            section {
                h2 { "Nominal success and single axes" }
                (tables::nominal(document))
                (figure("The reproduction gate: a policy that does not reach its published nominal \
                    success within 5 points is not set up as its authors had it, and its robustness \
                    is not to be interpreted.", figures::gate(document).into_iter().collect()))
                (tables::single_axes(document))
                @for analysis in &document.analyses { (tables::suites(analysis)) }
                (tables::subsets(document))
            }
        }
        (replication(document))
        @let pairs = document.comparisons();
        @if !pairs.is_empty() { (differences::section(&pairs)) }
        (tables::solvable(document))
        (tables::bounds(document))
        (tables::quarantine(document))
        (methods::methods(document))
    }
}

/// Renders a comparison of two policies, for another page that includes [`STYLE`].
pub fn comparison(comparison: &Comparison) -> Markup {
    differences::comparison(comparison)
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

/// Renders the share of outcomes that another policy seed changes, in campaigns with replicates.
fn replication(document: &Document) -> Markup {
    let panels: Vec<_> = document.analyses.iter().filter_map(figures::flips).collect();
    html! {
        @if !panels.is_empty() {
            section {
                h2 { "Replication" }
                (figure("Rollouts whose outcome differs from that of the first seed, with the same \
                    initial state and realised perturbation.", panels))
            }
        }
    }
}
