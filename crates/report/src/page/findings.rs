//! What comes first: what the report is of, what to know before believing it,
//! and what it shows, in words.

use maud::{Markup, html};
use paired::{Cell, Measures};

use crate::analysis::Analysis;
use crate::document::Document;
use crate::subject::Origin;
use crate::words;

/// Below this p-value, b and c are said to differ.
const SIGNIFICANT: f64 = 0.05;

pub(super) fn subtitle(document: &Document) -> Markup {
    let rollouts = document.analyses.iter().map(|analysis| {
        let records = analysis.counted().iter();
        records
            .filter(|record| record.outcome.success().is_some())
            .count()
    });
    let rollouts: usize = rollouts.sum();
    html! {
        p.muted {
            (rollouts)
            @if document.analyses.iter().all(|it| it.findings.is_some()) {
                " rollouts under subsets of the axes, of configurations whose outcome changes under \
                all of them at once."
            } @else if document.analyses.iter().all(|it| it.how_far.is_some()) {
                " rollouts of the same configurations, perturbed at further radii."
            } @else {
                " rollouts: the same configurations under each axis alone, and under simultaneous \
                perturbation by all of them."
            }
            @if let [Analysis { subject, .. }] = document.analyses.as_slice() {
                @match &subject.origin {
                    Origin::Campaign { name, design, .. } => {
                        " Campaign " (name) ", design " code { (design) } "."
                    }
                    Origin::File { name, source, .. } => {
                        " Results of " (name) @if !source.is_empty() { ": " (source) } "."
                    }
                }
            }
        }
    }
}

pub(super) fn warnings(document: &Document) -> Markup {
    let several = document.analyses.len() > 1;
    let of = |analysis: &Analysis| html! { @if several { strong { (analysis.label) ": " } } };
    let any = document.analyses.iter().any(|analysis| {
        !(analysis.report.notes.is_empty() && analysis.report.quarantined.is_empty())
    });
    html! {
        @if any || !document.warnings.is_empty() {
            section.warnings role="note" aria-label="Warnings" {
                h2 { "Before you believe these figures" }
                ul {
                    @for warning in &document.warnings { li { (sentence(warning)) } }
                    @for analysis in &document.analyses {
                        @for warning in &analysis.report.notes {
                            li { (of(analysis)) (sentence(warning)) }
                        }
                        @let quarantined = analysis.report.quarantined.len();
                        @if quarantined > 0 {
                            li {
                                (of(analysis)) (quarantined)
                                @if quarantined == 1 { " rollout is" } @else { " rollouts are" }
                                " in quarantine after repeated errors: in no rate, bounded and listed \
                                below."
                            }
                        }
                    }
                }
            }
        }
    }
}

/// A warning as a sentence, names between backticks as code.
pub(super) fn sentence(warning: &str) -> Markup {
    let mut letters = warning.chars();
    let first = letters.next().map(|c| c.to_uppercase().to_string());
    let text = format!("{}{}.", first.unwrap_or_default(), letters.as_str());
    html! {
        @for (index, part) in text.split('`').enumerate() {
            @if index % 2 == 1 { code { (part) } } @else { (part) }
        }
    }
}

pub(super) fn in_words(document: &Document) -> Markup {
    let cells: Vec<(&Analysis, &Cell, &Measures)> = document
        .analyses
        .iter()
        .flat_map(|analysis| {
            let cells = analysis.cells();
            cells.filter_map(move |cell| Some((analysis, cell, cell.paired.as_ref()?)))
        })
        .collect();
    html! {
        @if !cells.is_empty() {
            section {
                h2 { "What it shows" }
                ul.findings.many[document.analyses.len() > 1] {
                    @for (analysis, cell, measures) in cells {
                        (finding(&format!("{}, {}", analysis.label, cell.level), cell, measures))
                    }
                }
            }
        }
    }
}

fn finding(what: &str, cell: &Cell, m: &Measures) -> Markup {
    let net = match (m.mcnemar_p < SIGNIFICANT, m.i < 0.0) {
        (false, _) => "neither direction outweighs the other by more than chance would",
        (true, true) => "failures emerge more often than they are compensated",
        (true, false) => "failures are compensated more often than they emerge",
    };
    html! {
        li {
            strong { (what) } ": of " (m.n)
            @if cell.completeness.complete < cell.completeness.expected {
                " complete configurations out of " (cell.completeness.expected)
            } @else { " configurations" }
            ", "
            // A nought is nothing to warn of.
            span class=[(m.b > 0).then_some("emergent")] {
                (m.b) @if m.b == 1 { " fails" } @else { " fail" }
                " only under simultaneous perturbation"
            }
            " and "
            span class=[(m.c > 0).then_some("compensated")] {
                (m.c) @if m.c == 1 { " succeeds" } @else { " succeed" }
                " although an axis alone makes them fail"
            }
            ". Net effect " (words::points(m.i)) " points" (words::points_interval(m.i_ci95, m.no_interval))
            "; " (net) " (p = " (words::p_value(m.mcnemar_p)) ")."
        }
    }
}
