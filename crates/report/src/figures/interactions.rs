//! Interactions of the axes at one level: a matrix of Shapley values and pair interactions,
//! and the additive decomposition from nominal to simultaneous success.

use benchmark::{Axis, AxisSet};
use maud::{Markup, html};
use paired::adaptive::subsets::Estimate;

use super::svg::{AXIS, HEAD, Scale, line, number, percent_ticks, rect, shortened, text, whisker};
use super::{Figure, WIDTH};
use crate::interactions::LevelInteractions;
use crate::words::{percent, points, points_interval};

const LABEL_WIDTH: f64 = 78.0;
/// Height of the heading and of the line below it.
const TOP: f64 = HEAD + 22.0;
const ROW_HEIGHT: f64 = 32.0;
/// Height of the slanted names below the columns.
const NAME_HEIGHT: f64 = 66.0;
/// Opacity of a cell's colour above which its number is white.
const DARK_ABOVE: f64 = 0.6;
const STEP_LABEL_WIDTH: f64 = 132.0;
const NUMBER_WIDTH: f64 = 58.0;
const STEP_HEIGHT: f64 = 26.0;

/// Draws the matrix: the Shapley value of each axis on the diagonal, the interaction of
/// each pair below it.
pub fn interaction_matrix(label: &str, level: &LevelInteractions) -> Figure {
    let interactions = &level.interactions;
    let axes: Vec<Axis> = interactions.full.axes().collect();
    let all = interactions.shapley.values().chain(interactions.pairs.values());
    let largest = all.map(|estimate| estimate.value.abs()).fold(0.01, f64::max);
    let side = (WIDTH - LABEL_WIDTH) / axes.len().max(1) as f64;
    let bottom = TOP + ROW_HEIGHT * axes.len() as f64;
    let place = |row: usize, column: usize| {
        [LABEL_WIDTH + side * column as f64, TOP + ROW_HEIGHT * row as f64]
    };
    let pair = |row: usize, column: usize| {
        let set: AxisSet = [axes[row], axes[column]].into_iter().collect();
        html! {
            @if let Some(estimate) = interactions.pairs.get(&set) {
                (cell(set.name(), estimate, largest, place(row, column), side))
            }
        }
    };
    let body = html! {
        (text(0.0, 15.0, "head", &heading(label, level)))
        (text(WIDTH, 15.0, "small muted end", &format!("n = {}", interactions.n)))
        (text(0.0, 34.0, "small muted", "shares of the axes (framed), and pairs: points of success"))
        @for (row, axis) in axes.iter().enumerate() {
            (text(0.0, TOP + ROW_HEIGHT * row as f64 + 20.5, "small", axis.name()))
            @for column in 0..row { (pair(row, column)) }
            @if let Some(estimate) = interactions.shapley.get(axis) {
                (cell(axis.name(), estimate, largest, place(row, row), side))
                (rect_outline(place(row, row), side))
            }
        }
        @for (column, axis) in axes.iter().enumerate() {
            @let turned = format!("translate({} {}) rotate(-45)",
                number(LABEL_WIDTH + side * (column as f64 + 0.6)), number(bottom + 12.0));
            text class="small end" transform=(turned) { (axis.name()) }
        }
        (rect(0.0, bottom + NAME_HEIGHT + 8.0, 10.0, 10.0, "emergent"))
        (text(16.0, bottom + NAME_HEIGHT + 17.0, "small", "lowers success"))
        (rect(130.0, bottom + NAME_HEIGHT + 8.0, 10.0, 10.0, "compensated"))
        (text(146.0, bottom + NAME_HEIGHT + 17.0, "small", "raises it"))
        (text(0.0, bottom + NAME_HEIGHT + 36.0, "small muted",
            "bold: the 95 % interval excludes 0"))
    };
    let title =
        format!("{}, {}: share of each axis, and interaction of each pair", label, level.level);
    let name = format!("interactions-{}-{}", label, level.level);
    Figure::new(&name, title, bottom + NAME_HEIGHT + 44.0, body)
}

fn heading(label: &str, level: &LevelInteractions) -> String {
    format!("{}, {}", shortened(label, 30), level.level)
}

/// Draws the cell of an axis or a pair: the colour shows the sign of the estimate, the opacity its
/// size relative to `largest`.
fn cell(name: &str, estimate: &Estimate, largest: f64, [x, y]: [f64; 2], side: f64) -> Markup {
    let share = estimate.value.abs() / largest;
    let class = if estimate.value < 0.0 { "emergent" } else { "compensated" };
    let ink = if share > DARK_ABOVE { "bare on-dark" } else { "bare" };
    let excludes_zero = estimate.ci95.is_some_and(|[low, high]| low > 0.0 || high < 0.0);
    let weight = if excludes_zero { "name" } else { "" };
    html! {
        g {
            title {
                (name) ": " (points(estimate.value)) " points"
                (points_interval(estimate.ci95, estimate.no_interval))
            }
            rect class="cell" x=(number(x + 1.0)) y=(number(y + 1.0)) width=(number(side - 2.0))
                height=(number(ROW_HEIGHT - 2.0)) rx="2" {}
            rect class=(class) fill-opacity=(number(share)) x=(number(x + 1.0))
                y=(number(y + 1.0)) width=(number(side - 2.0))
                height=(number(ROW_HEIGHT - 2.0)) rx="2" {}
            (text(x + side / 2.0, y + 20.5, &format!("tiny middle {ink} {weight}"),
                &points(estimate.value)))
        }
    }
}

fn rect_outline([x, y]: [f64; 2], side: f64) -> Markup {
    html! {
        rect class="frame" x=(number(x + 1.5)) y=(number(y + 1.5)) width=(number(side - 3.0))
            height=(number(ROW_HEIGHT - 3.0)) rx="2" {}
    }
}

/// Draws the steps from nominal to simultaneous success: the summed effects of single axes, of
/// pairs, of triples, and so on.
pub fn additive(label: &str, level: &LevelInteractions) -> Figure {
    let interactions = &level.interactions;
    let [nominal, simultaneous] = level.ends();
    let mut reached = nominal.value;
    let steps: Vec<(usize, &Estimate, [f64; 2])> = interactions
        .sizes
        .iter()
        .map(|(&axes, estimate)| {
            let from = reached;
            reached += estimate.value;
            (axes, estimate, [from, reached])
        })
        .collect();
    let ends = steps.iter().flat_map(|(.., ends)| *ends);
    let (low, high) =
        ends.fold((0.0_f64, 1.0_f64), |(low, high), end| (low.min(end), high.max(end)));
    let grain = if high - low > 1.5 { 0.5 } else { 0.25 };
    let domain = [(low / grain + 1e-9).floor() * grain, (high / grain - 1e-9).ceil() * grain];
    let scale = Scale::between(domain, [STEP_LABEL_WIDTH, WIDTH - NUMBER_WIDTH]);
    let rows = steps.len() + 2;
    let bottom = TOP + STEP_HEIGHT * rows as f64;
    let y = |row: usize| TOP + STEP_HEIGHT * row as f64;
    let end = |name: &str, estimate: &Estimate, row: usize| {
        html! {
            (text(0.0, y(row) + 17.0, "small name", name))
            @let length = scale.at(estimate.value) - scale.at(0.0);
            (rect(scale.at(0.0), y(row) + 6.0, length, 14.0, "bar"))
            @if let Some(interval) = estimate.ci95 { (whisker(&scale, interval, y(row) + 13.0)) }
            (text(WIDTH, y(row) + 17.0, "small name end", &percent(estimate.value)))
        }
    };
    let body = html! {
        (text(0.0, 15.0, "head", &heading(label, level)))
        (text(WIDTH, 15.0, "small muted end", &format!("n = {}", interactions.n)))
        (text(0.0, 34.0, "small muted", "from nominal to simultaneous success"))
        (scale.axis([TOP, bottom], &ticks(domain, grain), "success, % of configurations"))
        (line("zero", [scale.at(0.0), TOP], [scale.at(0.0), bottom]))
        (end("nominal", nominal, 0))
        @for (index, (axes, estimate, [from, to])) in steps.iter().enumerate() {
            @let row = index + 1;
            @let (left, right) = (scale.at(from.min(*to)), scale.at(from.max(*to)));
            @let class = if estimate.value < 0.0 { "emergent" } else { "compensated" };
            g {
                title {
                    (points(estimate.value)) " points"
                    (points_interval(estimate.ci95, estimate.no_interval))
                }
                (text(0.0, y(row) + 17.0, "small", &step_name(*axes)))
                (rect(left, y(row) + 6.0, (right - left).max(1.0), 14.0, class))
                (line("zero", [scale.at(*from), y(row) - 6.0], [scale.at(*from), y(row) + 20.0]))
                (text(WIDTH, y(row) + 17.0, "small end", &points(estimate.value)))
            }
        }
        (end("simultaneous", simultaneous, rows - 1))
    };
    let title = format!(
        "{}, {}: from nominal to simultaneous success, by how many axes act together",
        label, level.level
    );
    let name = format!("additive-{}-{}", label, level.level);
    Figure::new(&name, title, bottom + AXIS, body)
}

fn step_name(axes: usize) -> String {
    match axes {
        1 => "each axis alone".to_owned(),
        2 => "+ pairs".to_owned(),
        3 => "+ triples".to_owned(),
        axes => format!("+ sets of {axes} axes"),
    }
}

/// Returns ticks in percent. Partial sums can be negative or exceed 100 %.
fn ticks(domain: [f64; 2], grain: f64) -> Vec<(f64, String)> {
    let ticks = percent_ticks(domain, grain, false).into_iter();
    let signed = |(value, label): (f64, String)| match value < 0.0 {
        true => (value, format!("−{label}")),
        false => (value, label),
    };
    ticks.map(signed).collect()
}
