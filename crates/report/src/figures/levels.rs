//! The paper's Figure 3, one panel per level with a row per policy. A, C and E: decomposition of
//! simultaneous success from the prediction for independent axes, S_indep → S_conj by D, S_conj →
//! S_sim by I. B, D and F: direction of outcome changes, emergent failures to the left, compensated
//! successes to the right.

use benchmark::Level;
use maud::{Markup, html};
use paired::Measures;

use super::svg::{
    AXIS, HEAD, MARGIN, Scale, circle, diamond, end_and_step, line, percent_ticks, rect, shortened,
    square, text, whisker,
};
use super::{Figure, WIDTH};
use crate::document::Document;
use crate::words::{self, p_value, percent, points, points_interval, rate_interval};

const LEGEND_HEIGHT: f64 = 20.0;
const BAR_HEIGHT: f64 = 14.0;

/// A kind of panel.
struct Panel<'a> {
    name: &'static str,
    title: &'static str,
    axis: &'static str,
    scale: Scale,
    ticks: &'a [(f64, String)],
    legend: Markup,
    row_height: f64,
    row: fn(&Scale, &str, &Measures, f64) -> Markup,
    /// Value of the line across all rows.
    line: Option<f64>,
}

/// Draws the panel of a level; `None` if no policy has a complete configuration.
fn draw(document: &Document, level: Level, panel: &Panel<'_>) -> Option<Figure> {
    let rows = document.paired(level);
    if rows.is_empty() {
        return None;
    }
    let top = HEAD + LEGEND_HEIGHT;
    let bottom = top + panel.row_height * rows.len() as f64;
    let counts = words::counts(rows.iter().map(|(_, m)| m.n));
    let axis = format!("{}, % of {counts} configurations", panel.axis);
    let body = html! {
        (text(0.0, 15.0, "head", &format!("{level}: radius {}", level.radius())))
        (panel.legend)
        (panel.scale.axis([top, bottom], panel.ticks, &axis))
        @for (index, (name, measures)) in rows.iter().enumerate() {
            @let top = top + panel.row_height * index as f64;
            g {
                (text(0.0, top + 15.0, "name", &shortened(name, 40)))
                ((panel.row)(&panel.scale, name, measures, top))
            }
        }
        @if let Some(value) = panel.line {
            (line("zero", [panel.scale.at(value), top], [panel.scale.at(value), bottom]))
        }
    };
    let title = format!("{} at {level}", panel.title);
    Some(Figure::new(&format!("{}-{level}", panel.name), title, bottom + AXIS, body))
}

/// Draws the decomposition of simultaneous success.
pub fn decomposition(document: &Document, level: Level) -> Option<Figure> {
    let y = HEAD + 4.0;
    let name = |x: f64, name: &str| text(x, y + 4.0, "small", name);
    let panel = Panel {
        name: "decomposition",
        title: "Success expected of independent axes, under every axis alone, and under \
                simultaneous perturbation,",
        axis: "success",
        scale: Scale::over([0.0, 1.0]),
        ticks: &percent_ticks([0.0, 1.0], 0.25, false),
        legend: html! {
            (circle(MARGIN, y, "open"))
            (name(MARGIN + 10.0, "S_indep"))
            (line("d", [88.0, y], [108.0, y]))
            (name(114.0, "D"))
            (diamond(146.0, y, "mark"))
            (name(157.0, "S_conj"))
            (line("i", [218.0, y], [238.0, y]))
            (name(244.0, "I"))
            (square(274.0, y, "mark"))
            (name(284.0, "S_sim"))
        },
        row_height: 66.0,
        row: decomposition_row,
        line: None,
    };
    draw(document, level, &panel)
}

fn decomposition_row(scale: &Scale, name: &str, m: &Measures, top: f64) -> Markup {
    let [indep, conj, sim] = [m.s_indep, m.s_conj, m.s_sim].map(|rate| scale.at(rate));
    let (d, i) = (top + 28.0, top + 40.0);
    let [s_indep, s_conj, s_sim] = [m.s_indep, m.s_conj, m.s_sim].map(percent);
    let change = |name: &str, value, interval| {
        format!("{name} {}{}", points(value), points_interval(interval, m.no_interval))
    };
    html! {
        title { (name) ": S_indep " (s_indep) " %, S_conj " (s_conj) " %, S_sim " (s_sim) " %" }
        (text(scale.at(1.0) + MARGIN, top + 15.0, "small muted end", &format!("n = {}", m.n)))
        (line("d", [indep, d], [conj, d]))
        (line("zero", [conj, d], [conj, i]))
        (line("i", [conj, i], [sim, i]))
        (circle(indep, d, "open"))
        (diamond(conj, f64::midpoint(d, i), "mark"))
        (square(sim, i, "mark"))
        (text(0.0, top + 61.0, "small d", &change("D", m.d, m.d_ci95)))
        (text(scale.at(0.5) , top + 61.0, "small i", &change("I", m.i, m.i_ci95)))
    }
}

/// Draws the directions of outcome changes.
pub fn directions(document: &Document, level: Level) -> Option<Figure> {
    // All panels share one scale.
    let cells = document.analyses.iter().flat_map(|analysis| &analysis.report.cells);
    let measures = cells.filter_map(|cell| cell.paired.as_ref());
    let ends = measures.flat_map(|m| {
        let high = |interval: Option<[f64; 2]>| interval.map_or(0.0, |[_, high]| high);
        [m.r_e, m.r_c, high(m.r_e_ci95), high(m.r_c_ci95)]
    });
    let (end, step) = end_and_step(ends.fold(0.01, f64::max), 4.0);
    let middle = WIDTH / 2.0;
    let panel = Panel {
        name: "directions",
        title: "Emergent failures and compensated successes, by policy,",
        axis: "changed outcomes",
        scale: Scale::over([-end, end]),
        ticks: &percent_ticks([-end, end], step, false),
        legend: html! {
            (rect(MARGIN, HEAD - 1.0, 10.0, 10.0, "emergent"))
            (text(MARGIN + 15.0, HEAD + 8.0, "small", "R_e emergent failures"))
            (rect(middle - 6.0, HEAD - 1.0, 10.0, 10.0, "compensated"))
            (text(middle + 9.0, HEAD + 8.0, "small", "R_c compensated successes"))
        },
        row_height: 54.0,
        row: directions_row,
        line: Some(0.0),
    };
    draw(document, level, &panel)
}

fn directions_row(scale: &Scale, name: &str, m: &Measures, top: f64) -> Markup {
    let (zero, y) = (scale.at(0.0), top + 22.0);
    let (left, right) = (scale.at(-m.r_e), scale.at(m.r_c));
    let mirrored = m.r_e_ci95.map(|[low, high]| [-high, -low]);
    let share =
        |value, interval| format!("{}{}", percent(value), rate_interval(interval, m.no_interval));
    html! {
        title { (name) ": " (m.b) " emergent failures, " (m.c) " compensated successes" }
        (text(WIDTH, top + 15.0, "small muted end",
            &format!("n = {}, p = {}", m.n, p_value(m.mcnemar_p))))
        (rect(left, y, zero - left, BAR_HEIGHT, "emergent"))
        (rect(zero, y, right - zero, BAR_HEIGHT, "compensated"))
        @for interval in mirrored.into_iter().chain(m.r_c_ci95) {
            (whisker(scale, interval, y + BAR_HEIGHT / 2.0))
        }
        (text(zero - 8.0, top + 49.0, "small end", &share(m.r_e, m.r_e_ci95)))
        (text(zero + 8.0, top + 49.0, "small", &share(m.r_c, m.r_c_ci95)))
    }
}
