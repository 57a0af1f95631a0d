//! The paper's Figure 3 A, C and E, one panel per level with a row per policy: decomposition of
//! simultaneous success from the prediction for independent axes, S_indep → S_conj by D, S_conj →
//! S_sim by I.

use benchmark::Level;
use maud::{Markup, html};
use paired::Measures;

use super::Figure;
use super::svg::{
    AXIS, HEAD, MARGIN, Scale, circle, diamond, line, percent_ticks, shortened, square, text,
};
use crate::document::Document;
use crate::words::{self, percent, points, points_interval};

const LEGEND_HEIGHT: f64 = 20.0;
const ROW_HEIGHT: f64 = 66.0;

/// Draws the panel of a level; `None` if no policy has a complete configuration.
pub fn decomposition(document: &Document, level: Level) -> Option<Figure> {
    let rows = document.paired(level);
    if rows.is_empty() {
        return None;
    }
    let top = HEAD + LEGEND_HEIGHT;
    let bottom = top + ROW_HEIGHT * rows.len() as f64;
    let axis =
        format!("success, % of {} configurations", words::counts(rows.iter().map(|(_, m)| m.n)));
    let scale = Scale::over([0.0, 1.0]);
    let y = HEAD + 4.0;
    let name = |x: f64, name: &str| text(x, y + 4.0, "small", name);
    let body = html! {
        (text(0.0, 15.0, "head", &format!("{level}: radius {}", level.radius())))
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
        (scale.axis([top, bottom], &percent_ticks([0.0, 1.0], 0.25), &axis))
        @for (index, (name, measures)) in rows.iter().enumerate() {
            @let top = top + ROW_HEIGHT * index as f64;
            g {
                (text(0.0, top + 15.0, "name", &shortened(name, 40)))
                (decomposition_row(&scale, name, measures, top))
            }
        }
    };
    let title = format!(
        "Success expected of independent axes, under every axis alone, and under simultaneous \
         perturbation, at {level}"
    );
    Some(Figure::new(&format!("decomposition-{level}"), title, bottom + AXIS, body))
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
