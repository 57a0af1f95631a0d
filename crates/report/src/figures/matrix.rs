//! The outcome matrix of a cell: its tasks × their configurations, each marked with the
//! transition that simultaneous perturbation caused.

use std::collections::BTreeMap;

use benchmark::{Condition, Level, RolloutId, Suite, TaskRef};
use maud::{Markup, html};
use paired::{Matched, Outcome, Transition};

use super::svg::{HEAD, number, rect, text};
use super::{Figure, Link, WIDTH};
use crate::analysis::Analysis;

/// Largest number of configurations drawn per task; a text gives the number of further ones.
const MAX_COLUMNS: usize = 10;
/// Distance between the left edges of neighbouring squares, and between their upper edges.
const SQUARE_PITCH: f64 = 14.0;
const LABEL_WIDTH: f64 = 26.0;
/// Distance from one suite's block to the next.
const BLOCK_WIDTH: f64 = WIDTH / 2.0 + 6.0;
const BLOCK_HEAD_HEIGHT: f64 = 36.0;
const LEGEND_HEIGHT: f64 = 58.0;

/// Draws the matrix of a level, of the first seed if there are several, with its squares linked by `link` if given; `None`
/// if the campaign lacks the level or runs no simultaneous rollouts.
pub fn matrix(analysis: &Analysis, level: Level, link: Option<Link>) -> Option<Figure> {
    analysis.cell(level)?.simultaneous?;
    let mut tasks: BTreeMap<TaskRef, Vec<&Matched>> = BTreeMap::new();
    for matched in analysis.records.configurations() {
        if matched.replicate == 0 && matched.level == level {
            tasks.entry(matched.task).or_default().push(matched);
        }
    }
    let suites: Vec<Suite> = Suite::ALL
        .into_iter()
        .filter(|suite| tasks.keys().any(|task| task.suite() == *suite))
        .collect();
    let mut y = HEAD;
    let mut blocks = Vec::new();
    for pair in suites.chunks(2) {
        let height = |suite: &Suite| tasks.keys().filter(|t| t.suite() == *suite).count();
        let rows = pair.iter().map(height).max().unwrap_or_default();
        for (column, suite) in pair.iter().enumerate() {
            blocks.push(block(*suite, &tasks, link, [BLOCK_WIDTH * column as f64, y]));
        }
        y += BLOCK_HEAD_HEIGHT + SQUARE_PITCH * rows as f64 + 8.0;
    }
    let all = tasks.values().flatten();
    let complete = all.clone().filter(|matched| matched.transition().is_some()).count();
    let shown = match all.count() {
        all if complete < all => format!("n = {complete} of {all}"),
        all => format!("n = {all}"),
    };
    let seed = if analysis.report.flips.is_empty() { "" } else { ", first seed" };
    let heading = format!("{}, {level}{seed}", super::svg::shortened(&analysis.label, 36));
    let body = html! {
        (text(0.0, 15.0, "head", &heading))
        (text(WIDTH, 15.0, "small muted end", &shown))
        @for block in blocks { (block) }
        (legend(y + 8.0))
    };
    let title = format!("{}, {level}: outcome of every configuration", analysis.label);
    let name = format!("matrix-{}-{level}", analysis.label);
    let mut figure = Figure::new(&name, title, y + LEGEND_HEIGHT, body);
    figure.has_links = link.is_some();
    Some(figure)
}

/// Draws the legend of the squares, in two lines from `top` downwards.
fn legend(top: f64) -> Markup {
    let entries = [
        (0.0, 0.0, Some(Transition::Emergent), "emergent failure"),
        (130.0, 0.0, Some(Transition::Compensated), "compensated success"),
        (292.0, 0.0, None, "incomplete"),
        (0.0, 22.0, Some(Transition::StillSucceeds), "succeeds either way"),
        (150.0, 22.0, Some(Transition::StillFails), "fails either way"),
    ];
    html! {
        @for (x, offset, transition, meaning) in entries {
            (mark([x, top + offset], transition))
            (text(x + 18.0, top + offset + 10.5, "small", meaning))
        }
    }
}

/// Draws the block of one suite: a row per task, a column per configuration.
fn block(
    suite: Suite,
    tasks: &BTreeMap<TaskRef, Vec<&Matched>>,
    link: Option<Link>,
    [x, y]: [f64; 2],
) -> Markup {
    let rows = tasks.iter().filter(|(task, _)| task.suite() == suite);
    let columns = rows.clone().map(|(_, row)| row.len()).max().unwrap_or_default();
    let top = y + BLOCK_HEAD_HEIGHT;
    html! {
        (text(x, y + 14.0, "name", suite.name()))
        @for column in 0..columns.min(MAX_COLUMNS) {
            @let config = rows.clone().find_map(|(_, row)| Some(row.get(column)?.config));
            @let letter = if column == 0 { "c" } else { "" };
            @let name = config.map_or_else(String::new, |config| format!("{letter}{config}"));
            (text(x + LABEL_WIDTH + SQUARE_PITCH * (column as f64 + 0.5), y + 30.0,
                "tiny muted middle", &name))
        }
        @for (index, (task, row)) in rows.enumerate() {
            @let row_top = top + SQUARE_PITCH * index as f64;
            (text(x + LABEL_WIDTH - 5.0, row_top + 10.5, "tiny muted end",
                &format!("t{}", task.index())))
            @for (column, matched) in row.iter().take(MAX_COLUMNS).enumerate() {
                (square(matched, link, [x + LABEL_WIDTH + SQUARE_PITCH * column as f64, row_top]))
            }
            @if row.len() > MAX_COLUMNS {
                (text(x + LABEL_WIDTH + SQUARE_PITCH * MAX_COLUMNS as f64 + 2.0, row_top + 10.5,
                    "tiny muted", &format!("+{}", row.len() - MAX_COLUMNS)))
            }
        }
    }
}

/// Draws a configuration: its mark, with a tooltip and a link.
fn square(matched: &Matched, link: Option<Link>, place: [f64; 2]) -> Markup {
    let content = html! {
        title { (tooltip(matched)) }
        (mark(place, matched.transition()))
    };
    html! {
        @match link {
            Some(link) => a href=(link(simultaneous_rollout(matched), matched.replicate)) {
                (content)
            },
            None => g { (content) },
        }
    }
}

/// Returns the simultaneous rollout, which identifies a configuration in links.
fn simultaneous_rollout(matched: &Matched) -> RolloutId {
    RolloutId::perturbed(matched.task, Condition::Simultaneous, matched.level, matched.config)
        .unwrap_or_else(|_| RolloutId::nominal(matched.task, matched.init_id))
}

/// Draws a square, with a cross for an emergent failure or a plus for a compensated success. A
/// smaller square marks an incomplete configuration.
fn mark([x, y]: [f64; 2], transition: Option<Transition>) -> Markup {
    let side = SQUARE_PITCH - 2.0;
    let class = match transition {
        Some(Transition::Emergent) => "emergent",
        Some(Transition::Compensated) => "compensated",
        Some(Transition::StillSucceeds) => "still-succeeds",
        Some(Transition::StillFails) => "still-fails",
        None => {
            return html! { (rect(x + 1.0, y + 1.0, side - 2.0, side - 2.0, "unknown")) };
        }
    };
    let (left, right) = (number(x + 3.0), number(x + side - 3.0));
    let (top, bottom) = (number(y + 3.0), number(y + side - 3.0));
    let (middle, centre) = (number(x + side / 2.0), number(y + side / 2.0));
    html! {
        (rect(x, y, side, side, class))
        @if transition == Some(Transition::Emergent) {
            path class="cut" d={ "M" (left) " " (top) "L" (right) " " (bottom)
                "M" (right) " " (top) "L" (left) " " (bottom) } {}
        }
        @if transition == Some(Transition::Compensated) {
            path class="cut" d={ "M" (middle) " " (top) "V" (bottom)
                "M" (left) " " (centre) "H" (right) } {}
        }
    }
}

/// Returns the tooltip of a configuration: its outcomes in words.
fn tooltip(matched: &Matched) -> String {
    let conditions_with = |outcome: Outcome| -> Vec<&str> {
        let axes = matched.combined().map(|(axis, _)| Condition::Single(axis));
        axes.chain([Condition::Simultaneous])
            .filter(|&condition| matched.outcome(condition) == outcome)
            .map(Condition::name)
            .collect()
    };
    let place = format!("{} c{}", matched.task, matched.config);
    let transition = matched.transition().map_or("incomplete", Transition::name);
    let mut tooltip = format!("{place}: {transition}");
    for (outcome, verb) in [
        (Outcome::Failure, "fails under"),
        (Outcome::Missing, "no result under"),
        (Outcome::Quarantined, "quarantined under"),
    ] {
        let names = conditions_with(outcome);
        if !names.is_empty() {
            tooltip.push_str(&format!("; {verb} {}", names.join(", ")));
        }
    }
    tooltip
}
