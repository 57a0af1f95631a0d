//! Head of the page: the subjects of the report, its warnings, and its findings in
//! words.

use maud::{Markup, html};
use paired::Finding;

use crate::analysis::Analysis;
use crate::document::Document;
use crate::subject::Origin;
use crate::words;

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

pub(super) fn warnings(document: &Document) -> Markup {
    let several = document.analyses.len() > 1;
    let label = |analysis: &Analysis| html! { @if several { strong { (analysis.label) ": " } } };
    let has_warnings = document.analyses.iter().any(|analysis| {
        !(analysis.report.notes.is_empty() && analysis.report.quarantined.is_empty())
    });
    html! {
        @if has_warnings || !document.warnings.is_empty() {
            section.warnings role="note" aria-label="Warnings" {
                h2 { "Warnings" }
                ul {
                    @for warning in &document.warnings { li { (sentence(warning)) } }
                    @for analysis in &document.analyses {
                        @for warning in &analysis.report.notes {
                            li { (label(analysis)) (sentence(warning)) }
                        }
                        @let quarantined = analysis.report.quarantined.len();
                        @if quarantined > 0 {
                            li {
                                (label(analysis)) (quarantined)
                                @if quarantined == 1 { " rollout is" } @else { " rollouts are" }
                                " in quarantine (failed too often, or skipped): excluded from every rate"
                                @if document.family.is_none() {
                                    "; tables below bound the effect and list the errors"
                                }
                                "."
                            }
                        }
                    }
                }
            }
        }
    }
}

/// Renders a warning as a sentence, with names between backticks as code.
pub(super) fn sentence(warning: &str) -> Markup {
    let mut letters = warning.chars();
    let first = letters.next().map(|c| c.to_uppercase().to_string());
    in_code(&format!("{}{}.", first.unwrap_or_default(), letters.as_str()))
}

fn in_code(text: &str) -> Markup {
    html! {
        @for (index, part) in text.split('`').enumerate() {
            @if index % 2 == 1 { code { (part) } } @else { (part) }
        }
    }
}

/// Renders the findings of each policy: first those about the last level or no level, then those
/// about earlier levels.
pub(super) fn section(document: &Document) -> Markup {
    let policies = document.analyses.iter().map(|analysis| {
        let findings = &analysis.report.findings;
        let last = findings.last().and_then(|finding| finding.level);
        let is_main = |finding: &&Finding| finding.level.is_none() || finding.level == last;
        let (main, earlier): (Vec<&Finding>, Vec<&Finding>) = findings.iter().partition(is_main);
        (analysis, main, earlier)
    });
    let policies: Vec<_> = policies.filter(|(_, main, _)| !main.is_empty()).collect();
    let several = document.analyses.len() > 1;
    html! {
        @if !policies.is_empty() {
            section {
                h2 { "Findings" }
                @for (analysis, main, earlier) in policies {
                    @if several { h3 { (analysis.label) } }
                    @for finding in main { p { (render_finding(finding)) } }
                    @if !earlier.is_empty() {
                        ul.findings { @for finding in earlier { li { (render_finding(finding)) } } }
                    }
                }
            }
        }
    }
}

/// Renders a finding, in bold if it claims an effect.
fn render_finding(finding: &Finding) -> Markup {
    let sentence = words::minus_signs(&finding.sentence);
    html! {
        @if finding.claims { strong { (in_code(&sentence)) } } @else { (in_code(&sentence)) }
    }
}
