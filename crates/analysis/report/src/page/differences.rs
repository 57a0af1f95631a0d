//! Differences between policies: a figure and a table for each pair, or the reason why
//! the pair cannot be compared.

use std::collections::BTreeSet;

use libero_ctrl::{Condition, Directions, TaskRef};
use maud::{Markup, html};
use paired::{ComparedCell, Difference, Interval, MeanDifference, Profile};

use super::findings::sentence;
use super::panels::figure;
use super::tables::{difference, or_dash, plain, table, with_note};
use crate::comparison::{Comparison, Unpairable};
use crate::figures;
use crate::words::{self, percent, points};

/// Renders the section with every pair of policies.
pub(super) fn section(pairs: &[Result<Comparison, Unpairable>]) -> Markup {
    let panels: Vec<_> =
        pairs.iter().filter_map(|pair| figures::differences(pair.as_ref().ok()?)).collect();
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
                        (profiles(comparison))
                        (progress(comparison))
                    }
                    Err(unpairable) => {
                        h3 { (unpairable.a) " and " (unpairable.b) " are not compared" }
                        (sentences(&unpairable.reasons))
                    }
                }
            }
            (explanation())
        }
    }
}

/// Renders one comparison, for a page of its own.
pub(super) fn comparison(comparison: &Comparison) -> Markup {
    let notes: Vec<&String> = comparison.warnings.iter().chain(&comparison.notes).collect();
    html! {
        @if !notes.is_empty() {
            section.warnings role="note" aria-label="Warnings" {
                h2 { "Warnings" }
                (sentences(&notes))
            }
        }
        (left_out(comparison, &[]))
        (figure(CAPTION, figures::differences(comparison).into_iter().collect()))
        (cells(comparison))
        (profiles(comparison))
        (progress(comparison))
        (explanation())
    }
}

const CAPTION: &str = "Difference of success over the same rollouts, in points: to the right of \
    zero, the first policy succeeds more often. Whiskers: 95 % intervals.";

fn sentences(texts: &[impl AsRef<str>]) -> Markup {
    html! { ul { @for text in texts { li { (sentence(text.as_ref())) } } } }
}

fn left_out(comparison: &Comparison, warnings: &[String]) -> Markup {
    let left_out = comparison.statistics.left_out();
    let notes: Vec<&String> = warnings.iter().chain(&left_out).collect();
    html! { @if !notes.is_empty() { (sentences(&notes)) } }
}

fn cells(comparison: &Comparison) -> Markup {
    let (a, b) = (&comparison.a.label, &comparison.b.label);
    let (rate_a, rate_b) = (format!("{a} %"), format!("{b} %"));
    let (only_a, only_b) = (format!("only {a}"), format!("only {b}"));
    let mut heads =
        vec!["rollouts", "n", &rate_a, &rate_b, "A − B points", &only_a, &only_b, "Holm p"];
    let cells = &comparison.statistics.cells;
    let has_bounds = cells.iter().any(|cell| cell.bounds.is_some());
    heads.extend(has_bounds.then_some("worst to best points"));
    let rows = cells.iter().map(|cell| {
        let mut values = row(cell);
        values.extend(has_bounds.then(|| or_dash(bounds(cell))));
        values
    });
    table(&comparison.title(), &heads, rows.collect())
}

/// Renders the further intervals and the profile of tasks: a row for each condition, then one
/// for each task.
fn profiles(comparison: &Comparison) -> Markup {
    let heads = [
        "rollouts",
        "new tasks and directions",
        "all rows together",
        "equivalence p",
        "tasks A:B",
        "A better %",
        "A − B least",
        "A − B most",
    ];
    let row = |(cell, delta): (&ComparedCell, &Difference)| {
        let profile = &delta.profile;
        let better = &profile.improvement;
        let extremes = profile.extremes().map(|extremes| extremes.map(task_change));
        let [least, most] = extremes.map_or([None, None], |extremes| extremes.map(Some));
        vec![
            plain(cell.name()),
            interval(delta.estimate.new_tasks_and_directions, points),
            interval(delta.simultaneous_ci95, points),
            or_dash(delta.equivalence_p.map(words::p_value)),
            plain(format!("{}:{}", profile.a_better, profile.b_better)),
            with_note(percent(better.value), &words::rate_interval(better.new_tasks, None)),
            or_dash(least),
            or_dash(most),
        ]
    };
    let rows: Vec<_> = compared(comparison).map(row).collect();
    html! {
        @if !rows.is_empty() {
            h4 { "By task" }
            (table("A − B by task", &heads, rows))
            (tasks(comparison))
            p.muted {
                "New tasks and directions: 95 % interval of A − B"
                @if comparison.statistics.directions == Directions::Own {
                    "; every task has its own directions, so that the variation between tasks \
                     covers both"
                }
                ". All rows together: simultaneous intervals about new tasks. Equivalence p: \
                p-value of the hypothesis that A and B differ by more than 5 points; if it is \
                small, A and B are equivalent. Tasks A:B: number of tasks in which A succeeds more \
                often, and number in which B does. A better: probability that A succeeds more \
                often in a task drawn at random, where ties count half, with its interval about \
                new tasks. Least and most: the tasks with the smallest and the largest A − B."
            }
        }
    }
}

/// Renders A − B of each task, nominally and under all axes.
fn tasks(comparison: &Comparison) -> Markup {
    let is_nominal_or_simultaneous =
        |condition| matches!(condition, Condition::Clean | Condition::Combination);
    let columns =
        compared(comparison).filter(|(cell, _)| is_nominal_or_simultaneous(cell.condition));
    let columns: Vec<(String, &Profile)> =
        columns.map(|(cell, delta)| (cell.name(), &delta.profile)).collect();
    let mut heads = vec!["task"];
    heads.extend(columns.iter().map(|(name, _)| name.as_str()));
    let tasks = columns.iter().flat_map(|(_, profile)| profile.tasks.keys());
    let tasks: BTreeSet<&TaskRef> = tasks.collect();
    let rows = tasks.into_iter().map(|task| {
        let changes = columns
            .iter()
            .map(|(_, profile)| or_dash(profile.tasks.get(task).copied().map(points)));
        [plain(task)].into_iter().chain(changes).collect()
    });
    html! {
        details {
            summary { "A − B of each task, points" }
            (table("A − B of each task, points", &heads, rows.collect()))
        }
    }
}

/// Renders partial progress; empty unless progress is known for both policies.
fn progress(comparison: &Comparison) -> Markup {
    let heads = [
        "rollouts",
        "measure.",
        "n",
        "A",
        "B",
        "A − B",
        "new tasks",
        "new tasks and directions",
        "Holm p",
    ];
    let row = |name: String, measure: &str, mean: &MeanDifference, number: fn(f64) -> String| {
        let signed = |value: f64| match value < 0.0 {
            true => number(value),
            false => format!("+{}", number(value)),
        };
        vec![
            plain(name),
            plain(measure),
            plain(mean.n),
            plain(number(mean.mean_a)),
            plain(number(mean.mean_b)),
            plain(signed(mean.difference.value)),
            interval(mean.difference.new_tasks, signed),
            interval(mean.difference.new_tasks_and_directions, signed),
            or_dash(mean.holm_p.map(words::p_value)),
        ]
    };
    let rows = comparison.statistics.cells.iter().flat_map(|cell| {
        let progress = cell.progress.as_ref();
        let goal = progress.and_then(|progress| progress.goal.as_ref());
        let steps = progress.and_then(|progress| progress.steps.as_ref());
        let goal = goal.map(|mean| row(cell.name(), "goal %", mean, percent));
        let steps = steps.map(|mean| row(cell.name(), "steps", mean, words::steps));
        goal.into_iter().chain(steps)
    });
    let rows: Vec<_> = rows.collect();
    html! {
        @if !rows.is_empty() {
            h4 { "Partial progress" }
            (table("Partial progress", &heads, rows))
            p.muted {
                "Secondary to success. Goal: largest share of the goal's predicates that held \
                together at any step. Steps: until success, or until the end of the budget, so \
                that no rollout is left out for its outcome. 95 % intervals; Holm p: t test over \
                tasks, corrected for the rows of a measure."
            }
        }
    }
}

/// Returns the cells with a difference.
fn compared(comparison: &Comparison) -> impl Iterator<Item = (&ComparedCell, &Difference)> {
    comparison.statistics.cells.iter().filter_map(|cell| Some((cell, cell.difference.as_ref()?)))
}

fn task_change((task, change): (TaskRef, f64)) -> String {
    format!("{task} {}", points(change))
}

fn interval(ends: Option<Interval>, number: impl Fn(f64) -> String) -> Markup {
    or_dash(ends.map(|[low, high]| format!("{} to {}", number(low), number(high))))
}

fn row(cell: &ComparedCell) -> Vec<Markup> {
    let delta = cell.difference.as_ref();
    let n = delta.map_or(0, |delta| delta.n);
    let formatted = |value: fn(&Difference) -> Markup| or_dash(delta.map(value));
    let gap = match (cell.missing, cell.quarantined) {
        (0, 0) => String::new(),
        (missing, 0) => format!("{missing} missing"),
        (0, quarantined) => format!("{quarantined} quarantined"),
        (missing, quarantined) => format!("{missing} missing, {quarantined} quarantined"),
    };
    vec![
        plain(cell.name()),
        with_note(n, &gap),
        formatted(|delta| plain(percent(delta.s_a))),
        formatted(|delta| plain(percent(delta.s_b))),
        formatted(|delta| difference(delta.difference, delta.difference_ci95, delta.no_interval)),
        formatted(|delta| plain(delta.a_only)),
        formatted(|delta| plain(delta.b_only)),
        formatted(|delta| plain(words::p_value(delta.holm_p))),
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
            "n: rollouts with an outcome of both policies, of all seeds; all rates and differences \
            are over these. A is the policy that is named first. In brackets, 95 % intervals that \
            resample whole tasks, both policies of a task together. Only: rollouts that one policy \
            alone solves. Holm p: exact two-sided sign-flip test over tasks, corrected for the \
            rows of the table. Worst to best: over every outcome that quarantined rollouts could \
            have had."
        }
    }
}
