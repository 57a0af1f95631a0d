//! Differences between policies: a figure and a table for each pair, or the reason why
//! the pair cannot be compared.

use maud::{Markup, html};
use paired::{ComparedCell, Difference};

use super::findings::sentence;
use super::panels::figure;
use super::sequential;
use super::tables::{difference, or_dash, plain, table, with};
use crate::comparison::{Comparison, Unpairable};
use crate::figures;
use crate::words::{self, percent, points};

/// Renders the section with every pair of policies.
pub(super) fn of_pairs(pairs: &[Result<Comparison, Unpairable>]) -> Markup {
    let panels: Vec<_> = pairs
        .iter()
        .filter_map(|pair| figures::differences(pair.as_ref().ok()?))
        .collect();
    html! {
        section {
            h2 { "Differences between policies" }
            (figure(CAPTION, panels))
            @for pair in pairs {
                @match pair {
                    Ok(comparison) => {
                        h3 { (comparison.title()) }
                        (left_out(comparison, &comparison.warnings))
                        (cells(comparison))
                        (sequential::of_two(comparison))
                    }
                    Err(refused) => {
                        h3 { (refused.a) " and " (refused.b) " are not compared" }
                        (sentences(&refused.reasons))
                    }
                }
            }
            (explanation())
        }
    }
}

/// Renders one comparison, for a page of its own.
pub(super) fn of_one(comparison: &Comparison) -> Markup {
    let said: Vec<&String> = comparison
        .warnings
        .iter()
        .chain(&comparison.notes)
        .collect();
    html! {
        @if !said.is_empty() {
            section.warnings role="note" aria-label="Warnings" {
                h2 { "Before you believe these figures" }
                (sentences(&said))
            }
        }
        (left_out(comparison, &[]))
        (figure(CAPTION, figures::differences(comparison).into_iter().collect()))
        (cells(comparison))
        (sequential::of_two(comparison))
        (explanation())
    }
}

const CAPTION: &str = "Difference of success over the same rollouts, in points: to the right of \
    zero, the first policy succeeds more often. Whiskers: 95 % intervals.";

fn sentences(said: &[impl AsRef<str>]) -> Markup {
    html! { ul { @for said in said { li { (sentence(said.as_ref())) } } } }
}

fn left_out(comparison: &Comparison, warnings: &[String]) -> Markup {
    let left_out = comparison.statistics.left_out();
    let said: Vec<&String> = warnings.iter().chain(&left_out).collect();
    html! { @if !said.is_empty() { (sentences(&said)) } }
}

fn cells(comparison: &Comparison) -> Markup {
    let (a, b) = (&comparison.a.label, &comparison.b.label);
    let (rate_a, rate_b) = (format!("{a} %"), format!("{b} %"));
    let (only_a, only_b) = (format!("only {a}"), format!("only {b}"));
    let mut heads = vec![
        "rollouts",
        "n",
        &rate_a,
        &rate_b,
        "A − B points",
        &only_a,
        &only_b,
        "Holm p",
    ];
    let cells = comparison.statistics.cells.iter();
    let cells: Vec<&ComparedCell> = cells.filter(|cell| cell.replicate == 0).collect();
    let has_bounds = cells.iter().any(|cell| cell.bounds.is_some());
    heads.extend(has_bounds.then_some("worst to best points"));
    let rows = cells.into_iter().map(|cell| {
        let mut values = row(cell);
        values.extend(has_bounds.then(|| or_dash(bounds(cell))));
        values
    });
    table(&comparison.title(), &heads, rows.collect())
}

fn row(cell: &ComparedCell) -> Vec<Markup> {
    let it = cell.difference.as_ref();
    let n = it.map_or(0, |it| it.n);
    let of = |value: fn(&Difference) -> Markup| or_dash(it.map(value));
    let gap = match (cell.missing, cell.quarantined) {
        (0, 0) => String::new(),
        (missing, 0) => format!("{missing} missing"),
        (0, quarantined) => format!("{quarantined} quarantined"),
        (missing, quarantined) => format!("{missing} missing, {quarantined} quarantined"),
    };
    vec![
        plain(cell.name()),
        with(n, &gap),
        of(|it| plain(percent(it.s_a))),
        of(|it| plain(percent(it.s_b))),
        of(|it| difference(it.difference, it.difference_ci95, it.no_interval)),
        of(|it| plain(it.a_only)),
        of(|it| plain(it.b_only)),
        of(|it| plain(words::p_value(it.holm_p))),
    ]
}

/// Formats the range of the difference over all possible outcomes of quarantined rollouts.
fn bounds(cell: &ComparedCell) -> Option<String> {
    let [low, high] = cell.bounds.as_ref()?.difference.map(points);
    Some(format!("{low} to {high}"))
}

fn explanation() -> Markup {
    html! {
        p.muted {
            "n: rollouts with an outcome of both policies, replicate 0; every figure is over these. \
            A is the policy that is named first. In brackets, 95 % intervals that resample whole \
            tasks, both policies of a task together. Only: rollouts that one policy alone solves. \
            Holm p: exact two-sided sign-flip test over tasks, corrected for the rows of the table. \
            Worst to best: over every outcome that quarantined rollouts could \
            have had."
        }
    }
}
