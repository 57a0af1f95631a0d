//! Head of the page: the subjects of the report, and its warnings.

use maud::{Markup, html};

use crate::analysis::Analysis;
use crate::block::in_code;
use crate::document::Document;
use crate::subject::Origin;

pub(super) fn subtitle(document: &Document) -> Markup {
    let rollouts = document.analyses.iter().map(|analysis| {
        let records = analysis.counted().iter();
        records.filter(|record| record.outcome.success().is_some()).count()
    });
    let rollouts: usize = rollouts.sum();
    html! {
        p.muted {
            (rollouts)
            @if document.family.is_some() {
                " rollouts: variants of the benchmark, and their tasks unperturbed."
            } @else if document.analyses.iter().all(|analysis| analysis.findings.is_some()) {
                " rollouts under subsets of the axes, of configurations whose outcome changes under \
                all of them at once."
            } @else if document.analyses.iter().all(|analysis| analysis.thresholds.is_some()) {
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

pub(super) fn warnings(warnings: &[String]) -> Markup {
    html! {
        @if !warnings.is_empty() {
            section.warnings role="note" aria-label="Warnings" {
                h2 { "Warnings" }
                ul { @for warning in warnings { li { (in_code(&sentence(warning))) } } }
            }
        }
    }
}

/// Returns a warning as a sentence.
pub(crate) fn sentence(warning: &str) -> String {
    let mut letters = warning.chars();
    let first = letters.next().map(|c| c.to_uppercase().to_string());
    format!("{}{}.", first.unwrap_or_default(), letters.as_str())
}
