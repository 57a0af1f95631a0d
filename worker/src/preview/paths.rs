//! The end-effector's paths under the actuation axis: one open-loop motion,
//! nominal and at each severity, seen from above and from the side.

use std::fmt::Write as _;

use benchmark::{Axis, Condition};
use sim::{SimError, Simulator};

use super::{LEVELS, MOTION_STEPS, Request, motion, row};

/// Colours for colour-blind readers (Okabe and Ito), and dashes for black-and-white print.
const STYLES: [(&str, &str); 4] =
    [("#000000", ""), ("#0072B2", "8 3"), ("#D55E00", "3 3"), ("#009E73", "10 3 2 3")];
/// Side of one view and the margin around it, pixels.
const VIEW: f64 = 320.0;
const MARGIN: f64 = 60.0;

type Path = Vec<[f64; 3]>;

/// Simulates and draws the paths.
pub(super) fn svg(simulator: &mut Simulator, request: &Request) -> Result<String, SimError> {
    let condition = Condition::Single(Axis::Actuation);
    let mut paths: Vec<(String, Path)> = Vec::new();
    for level in [None].into_iter().chain(LEVELS.map(Some)) {
        let row = row(request.task, condition, level, request.config);
        let mut episode = simulator.begin(&row, request.realisation)?;
        episode.settle()?;
        let mut path = vec![episode.environment().robot_state().eef_pos];
        for step in 0..MOTION_STEPS {
            episode.step(&motion(step))?;
            path.push(episode.environment().robot_state().eef_pos);
        }
        paths.push((level.map_or("nominal".to_owned(), |level| level.to_string()), path));
    }
    Ok(draw(&paths, &format!("{}, configuration {}", request.task, request.config)))
}

fn draw(paths: &[(String, Path)], title: &str) -> String {
    let (width, height) = (2.0 * (VIEW + 2.0 * MARGIN), VIEW + 2.0 * MARGIN + 20.0);
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\" \
         font-family=\"sans-serif\" font-size=\"12\">\n<rect width=\"100%\" height=\"100%\" \
         fill=\"white\"/>\n<text x=\"{MARGIN}\" y=\"24\" font-size=\"14\">End-effector paths under \
         actuation: {title}, {MOTION_STEPS} control steps of one motion</text>\n"
    );
    view(&mut svg, paths, MARGIN, "from above", ["x", "y"], |p| [p[0], p[1]]);
    let second = VIEW + 3.0 * MARGIN;
    view(&mut svg, paths, second, "from the side", ["x", "z"], |p| [p[0], p[2]]);
    for (index, (name, _)) in paths.iter().enumerate() {
        let (colour, dash) = STYLES[index % STYLES.len()];
        let (x, y) = (MARGIN + index as f64 * 120.0, height - 14.0);
        let _ = writeln!(
            svg,
            "<line x1=\"{x}\" y1=\"{ly}\" x2=\"{x2}\" y2=\"{ly}\" stroke=\"{colour}\" \
             stroke-width=\"2\" stroke-dasharray=\"{dash}\"/><text x=\"{tx}\" y=\"{y}\">{name}</text>",
            ly = y - 4.0,
            x2 = x + 28.0,
            tx = x + 34.0,
        );
    }
    svg.push_str("</svg>\n");
    svg
}

/// Draws one view, with both axes to the same scale, metres.
fn view(
    svg: &mut String,
    paths: &[(String, Path)],
    left: f64,
    name: &str,
    axes: [&str; 2],
    project: impl Fn(&[f64; 3]) -> [f64; 2],
) {
    let points: Vec<[f64; 2]> =
        paths.iter().flat_map(|(_, path)| path.iter().map(&project)).collect();
    let bound = |axis: usize, pick: fn(f64, f64) -> f64, start: f64| {
        points.iter().map(|point| point[axis]).fold(start, pick)
    };
    let low = [0, 1].map(|axis| bound(axis, f64::min, f64::INFINITY));
    let high = [0, 1].map(|axis| bound(axis, f64::max, f64::NEG_INFINITY));
    let span = (high[0] - low[0]).max(high[1] - low[1]).max(1e-6) * 1.1;
    let middle = [0, 1].map(|axis| (low[axis] + high[axis]) / 2.0);
    let to_pixels = |point: [f64; 2]| {
        [
            left + ((point[0] - middle[0]) / span + 0.5) * VIEW,
            MARGIN + (0.5 - (point[1] - middle[1]) / span) * VIEW,
        ]
    };
    let (right, bottom, centre) = (left + VIEW, MARGIN + VIEW, left + VIEW / 2.0);
    let edge = |axis: usize, side: f64| middle[axis] + side * span / 2.0;
    let _ = writeln!(
        svg,
        "<rect x=\"{left}\" y=\"{MARGIN}\" width=\"{VIEW}\" height=\"{VIEW}\" fill=\"none\" \
         stroke=\"#888\"/>\n<text x=\"{centre}\" y=\"{ty}\" text-anchor=\"middle\">{name}</text>\n\
         <text x=\"{left}\" y=\"{by}\">{:.2}</text><text x=\"{centre}\" y=\"{by}\" \
         text-anchor=\"middle\">{} (m)</text><text x=\"{right}\" y=\"{by}\" \
         text-anchor=\"end\">{:.2}</text>\n<text x=\"{lx}\" y=\"{bottom}\" \
         text-anchor=\"end\">{:.2}</text><text x=\"{lx}\" y=\"{my}\" text-anchor=\"end\">{} (m)</text>\
         <text x=\"{lx}\" y=\"{ny}\" text-anchor=\"end\">{:.2}</text>",
        edge(0, -1.0),
        axes[0],
        edge(0, 1.0),
        edge(1, -1.0),
        axes[1],
        edge(1, 1.0),
        ty = MARGIN - 8.0,
        by = bottom + 16.0,
        lx = left - 6.0,
        my = MARGIN + VIEW / 2.0,
        ny = MARGIN + 10.0,
    );
    for (index, (_, path)) in paths.iter().enumerate() {
        let (colour, dash) = STYLES[index % STYLES.len()];
        let line: Vec<String> = path
            .iter()
            .map(|point| to_pixels(project(point)))
            .map(|[x, y]| format!("{x:.1},{y:.1}"))
            .collect();
        let _ = writeln!(
            svg,
            "<polyline points=\"{}\" fill=\"none\" stroke=\"{colour}\" stroke-width=\"2\" \
             stroke-dasharray=\"{dash}\"/>",
            line.join(" ")
        );
    }
}
