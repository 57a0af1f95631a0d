//! Replication: the share of rollouts whose outcome changes with the policy's seed.

use maud::html;
use paired::Flips;

use super::svg::{AXIS, HEAD, Scale, number, percent_ticks, rect, text};
use super::{Figure, WIDTH};
use crate::analysis::Analysis;
use crate::words;

const LABEL_WIDTH: f64 = 84.0;
const BAR_ROW_HEIGHT: f64 = 24.0;

/// Draws the share of rollouts whose outcome differs from that of replicate 0, by condition, over
/// all other replicates; `None` if no rollout has an outcome in replicate 0 and in another.
pub fn flips(analysis: &Analysis) -> Option<Figure> {
    let conditions = &analysis.report.flips;
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
