//! Draws the samples as an SVG figure: one panel per quantity over time, with the events marked.

use std::fmt::Write;

use super::watch::Sample;

/// Sizes in SVG user units: width of the figure, height of a panel, margins to the left and the
/// right of the panels, and gap between two panels.
const WIDTH: f64 = 860.0;
const PANEL: f64 = 130.0;
const LEFT: f64 = 150.0;
const RIGHT: f64 = 20.0;
const GAP: f64 = 26.0;
const COLOURS: [&str; 3] = ["#1f5fa8", "#c4511d", "#3a7d44"];

/// Label and value of a curve; `None` for samples without a measurement.
type Curve = (&'static str, fn(&Sample) -> Option<f64>);

/// Panels: title with unit, and curves.
const PANELS: [(&str, &[Curve]); 6] = [
    (
        "claims, ms",
        &[
            ("p50", |sample| sample.claim_p50.map(|secs| secs * 1e3)),
            ("p99", |sample| sample.claim_p99.map(|secs| secs * 1e3)),
        ],
    ),
    (
        "longest answer, ms",
        &[
            ("page", |sample| sample.page.map(|secs| secs * 1e3)),
            ("metrics", |sample| sample.metrics.map(|secs| secs * 1e3)),
            ("status", |sample| sample.status.map(|secs| secs * 1e3)),
        ],
    ),
    ("memory, MiB", &[("resident", |sample| Some(sample.resident_mib))]),
    ("open files", &[("descriptors", |sample| Some(sample.descriptors as f64))]),
    (
        "disk, MiB",
        &[
            ("database", |sample| Some(sample.database_mib)),
            ("write-ahead log", |sample| Some(sample.wal_mib)),
            ("log", |sample| Some(sample.log_kib / 1024.0)),
        ],
    ),
    ("results, thousands", &[("accepted", |sample| Some(sample.accepted as f64 / 1e3))]),
];

/// Returns the figure as SVG.
pub(crate) fn draw(samples: &[Sample]) -> String {
    let height = PANELS.len() as f64 * (PANEL + GAP) + 2.0 * GAP;
    let duration = samples.last().map_or(1.0, |sample| sample.at).max(1.0);
    let x = |at: f64| LEFT + at / duration * (WIDTH - LEFT - RIGHT);
    let mut svg = format!(
        "<svg xmlns='http://www.w3.org/2000/svg' viewBox='0 0 {WIDTH} {height}' \
         font-family='sans-serif' font-size='12'>\n\
         <rect width='100%' height='100%' fill='white'/>\n"
    );
    for (number, (title, curves)) in PANELS.iter().enumerate() {
        let top = GAP + number as f64 * (PANEL + GAP);
        let values = || curves.iter().flat_map(|curve| samples.iter().filter_map(curve.1));
        let max_value = values().fold(0.0, f64::max).max(1e-9);
        let y = |value: f64| top + PANEL - value / max_value * PANEL;
        let bottom = top + PANEL;
        // Writing to a string cannot fail.
        let _ = writeln!(
            svg,
            "<rect x='{LEFT}' y='{top}' width='{:.1}' height='{PANEL}' fill='none' \
             stroke='#bbb'/>\n<text x='8' y='{:.1}' font-weight='bold'>{title}</text>\n\
             <text x='{:.1}' y='{:.1}' text-anchor='end'>{}</text>\n\
             <text x='{:.1}' y='{bottom:.1}' text-anchor='end'>0</text>",
            WIDTH - LEFT - RIGHT,
            top + 14.0,
            LEFT - 6.0,
            top + 10.0,
            number_text(max_value),
            LEFT - 6.0,
        );
        for (index, ((name, value), colour)) in curves.iter().zip(COLOURS).enumerate() {
            let points = samples.iter().filter_map(|sample| Some((sample.at, value(sample)?)));
            let points: Vec<String> =
                points.map(|(at, value)| format!("{:.1},{:.1}", x(at), y(value))).collect();
            let _ = writeln!(
                svg,
                "<polyline points='{}' fill='none' stroke='{colour}' stroke-width='1.3'/>\n\
                 <text x='8' y='{:.1}' fill='{colour}'>{name}</text>",
                points.join(" "),
                top + 32.0 + 16.0 * index as f64
            );
        }
        for sample in samples {
            let (Some(event), at) = (sample.event, x(sample.at)) else {
                continue;
            };
            let _ = writeln!(
                svg,
                "<line x1='{at:.1}' x2='{at:.1}' y1='{top}' y2='{bottom}' stroke='#888' \
                 stroke-dasharray='3 3'/>\n<text x='{:.1}' y='{:.1}' fill='#666'>{event}</text>",
                at + 3.0,
                top + 12.0
            );
        }
    }
    let _ = writeln!(
        svg,
        "<text x='{LEFT}' y='{:.1}'>0</text>\n\
         <text x='{:.1}' y='{:.1}' text-anchor='end'>{:.1} minutes</text>\n</svg>",
        height - GAP,
        WIDTH - RIGHT,
        height - GAP,
        duration / 60.0
    );
    svg
}

fn number_text(value: f64) -> String {
    match value {
        value if value < 10.0 => format!("{value:.1}"),
        value => format!("{value:.0}"),
    }
}
