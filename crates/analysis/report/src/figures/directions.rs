//! Direction of outcome changes: emergent failures to the left, compensated successes to
//! the right. The paper's Figure 3 B, D and F, one panel per level.

use libero_ctrl::Level;
use maud::{Markup, html};
use paired::Measures;

use super::svg::{AXIS, HEAD, MARGIN, Scale, line, percent_ticks, rect, shortened, text, whisker};
use super::{Figure, WIDTH};
use crate::document::Document;
use crate::words;

const LEGEND_HEIGHT: f64 = 20.0;
const ROW_HEIGHT: f64 = 54.0;
const BAR_HEIGHT: f64 = 14.0;
/// Candidate distances of ticks, fractions; the first that needs at most [`MAX_TICKS`] ticks on
/// each side of zero is used, and the axis ends at a multiple of this distance.
const TICK_STEPS: [f64; 4] = [0.02, 0.05, 0.1, 0.25];
const MAX_TICKS: f64 = 4.0;

/// Draws the panel of a level; `None` if no policy has a complete configuration.
pub fn directions(document: &Document, level: Level) -> Option<Figure> {
    let rows = document.paired(level);
    if rows.is_empty() {
        return None;
    }
    let (end, step) = end_and_step(largest_rate(document));
    let scale = Scale::over([-end, end]);
    let top = HEAD + LEGEND_HEIGHT;
    let bottom = top + ROW_HEIGHT * rows.len() as f64;
    let counts = words::counts(rows.iter().map(|(_, m)| m.n));
    let middle = WIDTH / 2.0;
    let body = html! {
        (text(0.0, 15.0, "head", &format!("{level}: radius {}", level.radius())))
        (rect(MARGIN, HEAD - 1.0, 10.0, 10.0, "emergent"))
        (text(MARGIN + 15.0, HEAD + 8.0, "small", "R_e emergent failures"))
        (rect(middle - 6.0, HEAD - 1.0, 10.0, 10.0, "compensated"))
        (text(middle + 9.0, HEAD + 8.0, "small", "R_c compensated successes"))
        (scale.axis([top, bottom], &percent_ticks([-end, end], step, false),
            &format!("changed outcomes, % of {counts} configurations")))
        @for (index, (name, measures)) in rows.iter().enumerate() {
            (row(&scale, name, measures, top + ROW_HEIGHT * index as f64))
        }
        (line("zero", [middle, top], [middle, bottom]))
    };
    let title = format!("Emergent failures and compensated successes at {level}, by policy");
    Some(Figure::new(&format!("directions-{level}"), title, bottom + AXIS, body))
}

/// Returns the largest upper bound of R_e and R_c in the document; all panels share one
/// scale.
fn largest_rate(document: &Document) -> f64 {
    let cells = document.analyses.iter().flat_map(|analysis| &analysis.report.cells);
    let measures = cells.filter_map(|cell| cell.paired.as_ref());
    let ends = measures.flat_map(|m| {
        let high = |interval: Option<[f64; 2]>| interval.map_or(0.0, |[_, high]| high);
        [m.r_e, m.r_c, high(m.r_e_ci95), high(m.r_c_ci95)]
    });
    ends.fold(0.01, f64::max)
}

fn end_and_step(largest: f64) -> (f64, f64) {
    let fits = |step: &&f64| largest / **step <= MAX_TICKS;
    let step = *TICK_STEPS.iter().find(fits).unwrap_or(&TICK_STEPS[TICK_STEPS.len() - 1]);
    ((largest / step - 1e-9).ceil() * step, step)
}

fn row(scale: &Scale, name: &str, m: &Measures, top: f64) -> Markup {
    let (zero, y) = (scale.at(0.0), top + 22.0);
    let (left, right) = (scale.at(-m.r_e), scale.at(m.r_c));
    let mirrored = m.r_e_ci95.map(|[low, high]| [-high, -low]);
    let tooltip = format!("{name}: {} emergent failures, {} compensated successes", m.b, m.c);
    let emergent =
        format!("{}{}", words::percent(m.r_e), words::rate_interval(m.r_e_ci95, m.no_interval));
    let compensated =
        format!("{}{}", words::percent(m.r_c), words::rate_interval(m.r_c_ci95, m.no_interval));
    html! {
        g {
            title { (tooltip) }
            (text(0.0, top + 15.0, "name", &shortened(name, 40)))
            (text(WIDTH, top + 15.0, "small muted end",
                &format!("n = {}, p = {}", m.n, words::p_value(m.mcnemar_p))))
            (rect(left, y, zero - left, BAR_HEIGHT, "emergent"))
            (rect(zero, y, right - zero, BAR_HEIGHT, "compensated"))
            @if let Some(interval) = mirrored { (whisker(scale, interval, y + BAR_HEIGHT / 2.0)) }
            @if let Some(interval) = m.r_c_ci95 { (whisker(scale, interval, y + BAR_HEIGHT / 2.0)) }
            (text(zero - 8.0, top + 49.0, "small end", &emergent))
            (text(zero + 8.0, top + 49.0, "small", &compensated))
        }
    }
}
