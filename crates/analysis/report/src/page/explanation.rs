//! Sections on the findings of a campaign that explains another, and on the interactions
//! of axes in whole lattices.

use adaptive::subsets::{Answer, Explained, Occurrence};
use libero_ctrl::RolloutId;
use maud::{Markup, html};
use paired::Transition;

use super::figure;
use super::markup::{difference, plain, table, with_note};
use crate::analysis::Analysis;
use crate::document::Document;
use crate::explanation::{Findings, subset};
use crate::figures::{self, Link};
use crate::interactions::{AxisInteractions, LevelInteractions};
use crate::subject::pluralise;
use crate::words::{percent, rate_interval};

/// Renders the findings of every subject that explains another campaign.
pub(super) fn findings(document: &Document, link: Option<Link>) -> Markup {
    let campaigns = document.analyses.iter();
    let campaigns = campaigns.filter_map(|analysis| analysis.findings.as_ref());
    html! { @for findings in campaigns { (campaign_sections(findings, link)) } }
}

fn campaign_sections(findings: &Findings, link: Option<Link>) -> Markup {
    let transitions = [Transition::Emergent, Transition::Compensated];
    let panels = transitions.iter().filter_map(|transition| figures::upset(findings, *transition));
    html! {
        section {
            h2 { "Minimal subsets of the axes" }
            p { code { (findings.explained_by) } " " (findings.describe_progress()) "." }
            ul.findings {
                @for transition in transitions { (transition_summary(findings, transition)) }
                (non_monotone(findings))
            }
        }
        (figure("The smallest sets of axes that change the outcome. Each column of dots is one set: \
            a filled dot is an axis that is perturbed. The bar above a column counts the \
            configurations in which the set changes the outcome and no smaller set that was run \
            does; a configuration can have several such sets. Left, sets that make a rollout fail \
            although it succeeds under every axis alone; right, sets that make a rollout succeed \
            although it fails under one axis alone.",
            panels.collect()))
        (configurations(findings, link))
    }
}

/// Renders the number of explained configurations with this transition and their most frequent
/// minimal subset.
fn transition_summary(findings: &Findings, transition: Transition) -> Markup {
    let is_of_kind = |explained: &&Explained| explained.explanation.transition == transition;
    let all: Vec<&Explained> = findings.configurations.iter().filter(is_of_kind).collect();
    let is_established = |explained: &&&Explained| {
        let mut minimal = explained.explanation.answers.iter().flat_map(|answer| &answer.minimal);
        minimal.all(adaptive::subsets::MinimalSubset::is_established)
    };
    let established = all.iter().filter(is_established).count();
    let subsets: Vec<&Occurrence> =
        findings.subsets.iter().filter(|occurrence| occurrence.transition == transition).collect();
    let most = subsets.iter().map(|occurrence| occurrence.configurations).max();
    // Several subsets can explain the same, largest number of configurations.
    let most_frequent: Vec<&Occurrence> =
        subsets.into_iter().filter(|occurrence| Some(occurrence.configurations) == most).collect();
    let n = all.len();
    let (class, one, several) = match transition {
        Transition::Compensated => (
            "compensated",
            "compensated success was explained",
            "compensated successes were explained",
        ),
        _ => ("emergent", "emergent failure was explained", "emergent failures were explained"),
    };
    html! {
        @if let Some(most) = most {
            li {
                span class=(class) { (n) " " @if n == 1 { (one) } @else { (several) } }
                ". "
                @match most_frequent.as_slice() {
                    [first] => {
                        "The most frequent minimal subset is "
                        strong { (subset(first.start, first.set)) }
                        ", in " (pluralise(most, "configuration")) "."
                    }
                    several => {
                        (several.len()) " minimal subsets are equally frequent, in "
                        (pluralise(most, "configuration")) " each."
                    }
                }
                @if established == n {
                    " Every smaller subset was run."
                } @else {
                    " Every smaller subset was run for " (established) " of the " (n)
                    " configurations; the other configurations may have smaller minimal subsets."
                }
            }
        }
    }
}

/// Renders the number of pairs of a minimal subset and a larger subset that undoes its change.
fn non_monotone(findings: &Findings) -> Markup {
    let pairs = |explained: &Explained| {
        let answers = explained.explanation.answers.iter();
        answers.map(|answer| answer.non_monotone.len()).sum::<usize>()
    };
    let all: usize = findings.configurations.iter().map(pairs).sum();
    let affected = findings.configurations.iter().filter(|explained| pairs(explained) > 0);
    html! {
        @if all > 0 {
            li {
                strong { "Larger sets can undo a change" } ": in "
                (pluralise(affected.count() as u64, "configuration"))
                ", a set that contains a minimal subset does not change the outcome ("
                (pluralise(all as u64, "pair")) " of sets, listed below as “undone by”)."
            }
        }
    }
}

fn configurations(findings: &Findings, link: Option<Link>) -> Markup {
    let name = |id: RolloutId| {
        html! {
            @match link {
                Some(link) => a href=(link(id, 0)) { code { (id) } },
                None => code { (id) },
            }
        }
    };
    let row = |explained: &Explained| {
        let answers = &explained.explanation.answers;
        vec![
            name(explained.configuration),
            plain(explained.explanation.transition.name()),
            html! { @for answer in answers { (minimal(answer)) } },
            html! { @for answer in answers { (unflipped(answer)) } },
            plain(explained.rollouts),
        ]
    };
    let heads = [
        "configuration",
        "transition.",
        "minimal subsets.",
        "largest unchanged subsets.",
        "rollouts",
    ];
    let rows: Vec<Vec<Markup>> = findings.configurations.iter().map(row).collect();
    html! {
        @if !rows.is_empty() {
            section {
                h2 { "Each configuration" }
                (table("Each configuration", &heads, rows))
                p.muted {
                    "“robot with camera” means that the configuration fails under robot alone, and \
                    succeeds if camera is perturbed as well. Largest unchanged subsets: the largest \
                    subsets that were run and do not change the outcome."
                }
            }
        }
    }
}

fn minimal(answer: &Answer) -> Markup {
    html! {
        @for minimal in &answer.minimal {
            div {
                (subset(answer.start, minimal.set))
                @if !minimal.is_established() {
                    span.muted {
                        " (not established: "
                        (pluralise(minimal.open.len() as u64, "smaller subset"))
                        " not run or not decided)"
                    }
                }
            }
        }
        @for pair in &answer.non_monotone {
            div.muted { (pair.minimal) " is undone by " (pair.superset) }
        }
    }
}

fn unflipped(answer: &Answer) -> Markup {
    let names: Vec<&str> = answer.largest_unflipped.iter().map(|set| set.name()).collect();
    html! { div { (names.join(", ")) } }
}

/// Renders the sections on the interactions of the axes, for every subject with whole lattices.
pub(super) fn interactions(document: &Document) -> Markup {
    let subjects = document.analyses.iter();
    let subjects =
        subjects.filter_map(|analysis| Some((analysis, analysis.interactions.as_ref()?)));
    let subjects: Vec<(&Analysis, &AxisInteractions)> = subjects.collect();
    html! {
        @if !subjects.is_empty() {
            section {
                h2 { "Interactions of the axes" }
                p {
                    "These figures cover the configurations of which every subset of the axes was \
                    run. The effects of single axes, of pairs beyond single axes, of triples \
                    beyond both, and so on, add up exactly to the change from nominal to \
                    simultaneous success."
                }
                @for (_, interactions) in &subjects {
                    @for note in &interactions.notes { p { strong { (super::findings::sentence(note)) } } }
                }
            }
            @for (analysis, interactions) in &subjects {
                @for level in &interactions.levels { (level_section(analysis, level)) }
            }
        }
    }
}

fn level_section(analysis: &Analysis, level: &LevelInteractions) -> Markup {
    let interactions = &level.interactions;
    let row = |(set, success): (&libero_ctrl::AxisSet, &adaptive::subsets::Estimate)| {
        let moebius = interactions.moebius.get(set);
        vec![
            plain(set),
            with_note(percent(success.value), &rate_interval(success.ci95, success.no_interval)),
            super::markup::or_dash(
                moebius.map(|estimate| {
                    difference(estimate.value, estimate.ci95, estimate.no_interval)
                }),
            ),
        ]
    };
    let rows: Vec<Vec<Markup>> = interactions.success.iter().map(row).collect();
    html! {
        (figure("Left, framed on the diagonal: each axis's share of the change from nominal to \
            simultaneous success, averaged over all orders in which the axes can be added (Shapley \
            value); the shares add up to the whole change. Below the diagonal: the amount by which \
            one axis of a pair changes the effect of the other (Shapley interaction index); \
            negative if the two axes do more harm together than the sum of their separate effects, \
            positive if one makes up for the other, or if both do the same harm. Right: the \
            change, by the number of axes that act together.",
            vec![
                figures::interaction_matrix(analysis, level),
                figures::additive(analysis, level),
            ]))
        details {
            summary {
                "Every subset at " (level.level) ": success, and the effect of its axes beyond \
                smaller subsets (" (interactions.n) " configurations"
                @if level.left_out > 0 { "; " (level.left_out) " lack an outcome and are left out" }
                ")"
            }
            (table("Every subset", &["axes", "success %", "beyond smaller, points"], rows))
        }
    }
}
