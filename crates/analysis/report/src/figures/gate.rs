//! The reproduction gate: nominal success against the published figure and its
//! tolerance.

use maud::{Markup, html};
use paired::{GATE_TOLERANCE, Gate, GateVerdict, SuiteGate};

use super::svg::{AXIS, HEAD, Scale, circle, line, percent_ticks, rect, shortened, text};
use super::{Figure, WIDTH};
use crate::document::Document;
use crate::words;

const LEGEND_HEIGHT: f64 = 20.0;
const ROW_HEIGHT: f64 = 46.0;
/// The axis begins at a multiple of this success rate.
const START_STEP: f64 = 0.1;

/// Draws the panel; `None` if no published success rate is known.
pub fn gate(document: &Document) -> Option<Figure> {
    let rows: Vec<(String, &Gate)> = document
        .analyses
        .iter()
        .flat_map(|analysis| {
            let suite_label = |suite: &SuiteGate| format!("{}, {}", analysis.label, suite.suite);
            let all = analysis.report.gate.iter();
            let all = all.map(|gate| (analysis.label.clone(), gate));
            let suites = analysis.report.suite_gates.iter();
            all.chain(suites.map(move |suite| (suite_label(suite), &suite.gate)))
        })
        .collect();
    if rows.is_empty() {
        return None;
    }
    let lowest = rows.iter().map(|(_, gate)| {
        let measured = gate.nominal.rate().unwrap_or(1.0);
        measured.min(gate.published - GATE_TOLERANCE)
    });
    let lowest = lowest.fold(0.9, f64::min);
    let domain = [((lowest / START_STEP).floor() * START_STEP).max(0.0), 1.0];
    let scale = Scale::over(domain);
    let top = HEAD + LEGEND_HEIGHT;
    let bottom = top + ROW_HEIGHT * rows.len() as f64;
    let counts = words::counts(rows.iter().map(|(_, gate)| gate.nominal.n));
    let step = if domain[0] > 0.75 { 0.05 } else { 0.1 };
    let body = html! {
        (text(0.0, 15.0, "head", "Reproduction gate"))
        (rect(14.0, HEAD - 1.0, 22.0, 10.0, "band"))
        (line("zero", [25.0, HEAD - 2.0], [25.0, HEAD + 10.0]))
        (text(42.0, HEAD + 8.0, "small", "published, ± 5 points"))
        (circle(212.0, HEAD + 4.0, "mark"))
        (text(222.0, HEAD + 8.0, "small", "measured"))
        (scale.axis([top, bottom], &percent_ticks(domain, step, false),
            &format!("nominal success, % of {counts} nominal rollouts")))
        @for (index, (name, gate)) in rows.iter().enumerate() {
            (row(&scale, name, gate, top + ROW_HEIGHT * index as f64))
        }
    };
    let title = "Nominal success against the published figure, by policy".to_owned();
    Some(Figure::new("reproduction-gate", title, bottom + AXIS, body))
}

fn row(scale: &Scale, name: &str, gate: &Gate, top: f64) -> Markup {
    let verdict = match gate.verdict {
        GateVerdict::Passed => "passed",
        GateVerdict::Failed => "FAILED",
        GateVerdict::Undecided => "undecided",
    };
    let difference = gate
        .difference
        .map_or_else(String::new, |difference| format!("{} points: ", words::points(difference)));
    let (left, right) =
        (scale.at(gate.published - GATE_TOLERANCE), scale.at(gate.published + GATE_TOLERANCE));
    let published = scale.at(gate.published);
    html! {
        (text(0.0, top + 15.0, "name", &shortened(name, 30)))
        (text(WIDTH, top + 15.0, "small end", &format!("{difference}{verdict}")))
        (rect(left, top + 22.0, right - left, 16.0, "band"))
        (line("zero", [published, top + 20.0], [published, top + 40.0]))
        @if let Some(rate) = gate.nominal.rate() { (circle(scale.at(rate), top + 30.0, "mark")) }
    }
}
