//! Replication: the net effect in every replicate, and the share of rollouts whose outcome
//! changes with the policy's seed.

use std::collections::BTreeMap;

use libero_ctrl::{Condition, Level};
use maud::{Markup, html};
use paired::{Cell, Flips};

use super::svg::{
    AXIS, HEAD, Scale, circle, line, number, percent_ticks, rect, text, whisker, withheld,
};
use super::{Figure, WIDTH};
use crate::analysis::Analysis;
use crate::words;

const LABEL_WIDTH: f64 = 84.0;
const REPLICATE_HEIGHT: f64 = 20.0;
const LEVEL_GAP: f64 = 12.0;
const BAR_ROW_HEIGHT: f64 = 24.0;

/// Draws I with its interval for every replicate and level; `None` if there is only one replicate
/// or no complete configuration.
pub fn replicates(analysis: &Analysis) -> Option<Figure> {
    let mut levels: BTreeMap<Level, Vec<&Cell>> = BTreeMap::new();
    for cell in analysis.report.cells.iter().filter(|cell| cell.paired.is_some()) {
        levels.entry(cell.level).or_default().push(cell);
    }
    if analysis.report.replication.is_empty() || levels.is_empty() {
        return None;
    }
    let measures = levels.values().flatten().filter_map(|cell| cell.paired.as_ref());
    let ends = measures.clone().flat_map(|m| m.i_ci95.unwrap_or([m.i, m.i]));
    let largest = ends.fold(0.05, |most: f64, end| most.max(end.abs()));
    let step = if largest > 0.2 { 0.1 } else { 0.05 };
    let end = (largest / step).ceil() * step;
    let scale = Scale::between([-end, end], [LABEL_WIDTH, WIDTH - 14.0]);
    let rows: usize = levels.values().map(Vec::len).sum();
    let bottom = HEAD + REPLICATE_HEIGHT * rows as f64 + LEVEL_GAP * levels.len() as f64;
    let counts = words::counts(measures.map(|m| m.n));
    let mut y = HEAD;
    let body = html! {
        (text(0.0, 15.0, "head", "I = S_sim − S_conj by replicate"))
        (scale.axis([HEAD, bottom], &percent_ticks([-end, end], step, true),
            &format!("I, points of success ({counts})")))
        (line("zero", [scale.at(0.0), HEAD], [scale.at(0.0), bottom]))
        @for (level, cells) in &levels {
            @let first = y + LEVEL_GAP / 2.0 + REPLICATE_HEIGHT / 2.0;
            (text(0.0, first + 4.0, "name", &level.to_string()))
            @for (index, cell) in cells.iter().enumerate() {
                (replicate(&scale, cell, first + REPLICATE_HEIGHT * index as f64))
            }
            ({ y += REPLICATE_HEIGHT * cells.len() as f64 + LEVEL_GAP; html! {} })
        }
    };
    let title = format!("{}: net effect of simultaneity in every replicate", analysis.label);
    let name = format!("replicates-{}", analysis.label);
    Some(Figure::new(&name, title, bottom + AXIS, body))
}

fn replicate(scale: &Scale, cell: &Cell, y: f64) -> Markup {
    let Some(measures) = &cell.paired else {
        return html! {};
    };
    let label = format!("replicate {}", cell.replicate);
    html! {
        (text(LABEL_WIDTH - 10.0, y + 4.0, "small muted end", &label))
        @match measures.i_ci95 {
            Some(interval) => (whisker(scale, interval, y)),
            None => (withheld(scale, measures.i, measures.no_interval, y)),
        }
        (circle(scale.at(measures.i), y, "mark"))
    }
}

/// Draws the share of rollouts whose outcome differs from that of replicate 0, by condition, over
/// all other replicates; `None` if no rollout has an outcome in replicate 0 and in another.
pub fn flips(analysis: &Analysis) -> Option<Figure> {
    let mut conditions: BTreeMap<Condition, Flips> = BTreeMap::new();
    for replication in &analysis.report.replication {
        for (&condition, flips) in &replication.flips_by_condition {
            let sum = conditions.entry(condition).or_default();
            sum.compared += flips.compared;
            sum.flipped += flips.flipped;
        }
    }
    let largest = conditions.values().filter_map(Flips::rate).fold(0.0, f64::max);
    if conditions.is_empty() {
        return None;
    }
    let step = if largest > 0.2 { 0.1 } else { 0.05 };
    let end = ((largest / step).ceil() * step).max(step);
    let scale = Scale::between([0.0, end], [LABEL_WIDTH, WIDTH - 100.0]);
    let bottom = HEAD + BAR_ROW_HEIGHT * conditions.len() as f64;
    let body = html! {
        (text(0.0, 15.0, "head", "Outcomes that another seed changes"))
        (scale.axis([HEAD, bottom], &percent_ticks([0.0, end], step, false),
            "flipped outcomes, % of rollouts"))
        @for (index, (condition, flips)) in conditions.iter().enumerate() {
            @let y = HEAD + BAR_ROW_HEIGHT * index as f64;
            @let rate = flips.rate().unwrap_or_default();
            (text(0.0, y + 16.0, "small", condition.label()))
            (rect(LABEL_WIDTH, y + 5.0, scale.at(rate) - LABEL_WIDTH, 14.0, "bar"))
            text class="small muted" x=(number(scale.at(rate) + 6.0)) y=(number(y + 16.0)) {
                (words::percent(rate)) " % of " (flips.compared)
            }
        }
    };
    let title = format!("{}: share of outcomes that another policy seed changes", analysis.label);
    let name = format!("flips-{}", analysis.label);
    Some(Figure::new(&name, title, bottom + AXIS, body))
}
