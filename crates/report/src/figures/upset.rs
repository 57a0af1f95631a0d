//! UpSet plot of the minimal subsets that explain a campaign's transitions (A. Lex et
//! al., IEEE Transactions on Visualization and Computer Graphics 20, 2014). Axes are
//! rows, each minimal subset is a column of dots, and a bar above it counts the
//! configurations in which the subset was found.

use benchmark::{Axis, AxisSet};
use maud::{Markup, html};
use paired::Transition;
use paired::adaptive::subsets::Occurrence;

use super::svg::{HEAD, line, number, rect, text};
use super::{Figure, WIDTH};
use crate::explanation::{Findings, subset};

const LABEL_WIDTH: f64 = 100.0;
const COLUMN_WIDTH: f64 = 23.0;
const ROW_HEIGHT: f64 = 22.0;
/// Height of the tallest bar, without the number above it.
const MAX_BAR_HEIGHT: f64 = 96.0;
const NUMBER_HEIGHT: f64 = 18.0;
const DOT_RADIUS: f64 = 6.0;
const LEGEND_HEIGHT: f64 = 46.0;
/// Largest number of columns; further subsets are counted in a text.
const MAX_COLUMNS: usize = ((WIDTH - LABEL_WIDTH) / COLUMN_WIDTH) as usize;

/// Draws the panel of one transition; `None` if no minimal subset explains such a transition.
pub fn upset(findings: &Findings, transition: Transition) -> Option<Figure> {
    let occurrences: Vec<&Occurrence> =
        findings.subsets.iter().filter(|occurrence| occurrence.transition == transition).collect();
    let full = findings.configurations.first()?.full;
    let most = occurrences.iter().map(|occurrence| occurrence.configurations).max()?;
    let (shown, further) = occurrences.split_at(occurrences.len().min(MAX_COLUMNS));
    let configurations = findings.configurations.iter();
    let n = configurations.filter(|explained| explained.explanation.transition == transition);
    let n = n.count();
    let top = HEAD + NUMBER_HEIGHT;
    let base = top + MAX_BAR_HEIGHT;
    let rows = base + 8.0;
    let axes: Vec<Axis> = full.axes().collect();
    let bottom = rows + ROW_HEIGHT * axes.len() as f64;
    let is_compensated = transition == Transition::Compensated;
    let heading = match is_compensated {
        true => "Compensated successes",
        false => "Emergent failures",
    };
    let body = html! {
        (text(0.0, 15.0, "head", heading))
        (text(WIDTH, 15.0, "small muted end", &format!("n = {n}")))
        (text(4.0, base - 4.0, "tiny muted", "configurations"))
        @for (row, axis) in axes.iter().enumerate() {
            @let y = rows + ROW_HEIGHT * row as f64;
            @if row % 2 == 0 { (rect(0.0, y, WIDTH, ROW_HEIGHT, "band")) }
            (text(4.0, y + 15.5, "small bare", axis.name()))
        }
        (line("zero", [LABEL_WIDTH, base], [WIDTH, base]))
        @for (index, occurrence) in shown.iter().enumerate() {
            @let x = LABEL_WIDTH + COLUMN_WIDTH * (index as f64 + 0.5);
            (column(occurrence, &axes, most, [x, base, rows]))
        }
        @if !further.is_empty() {
            (text(WIDTH, top - 2.0, "tiny muted end", &format!("{} rarer subsets are not drawn", further.len())))
        }
        (legend(bottom + 10.0, is_compensated))
    };
    let name = format!("minimal-subsets-{}", transition.name());
    let title = format!(
        "{}: minimal subsets of {}, and in how many of {n} configurations each was found",
        findings.explained_by,
        heading.to_lowercase()
    );
    Some(Figure::new(&name, title, bottom + LEGEND_HEIGHT, body))
}

/// Draws a bar and below it a dot for each axis: filled for the axes of the subset, a ring
/// for the axis that fails alone.
fn column(occurrence: &Occurrence, axes: &[Axis], most: u64, [x, base, rows]: [f64; 3]) -> Markup {
    let height = |count: u64| MAX_BAR_HEIGHT * count as f64 / most as f64;
    let (all, established) = (height(occurrence.configurations), height(occurrence.established));
    let class = match occurrence.transition {
        Transition::Compensated => "compensated",
        _ => "emergent",
    };
    let tooltip = format!(
        "{}: {} configurations, established in {}",
        subset(occurrence.start, occurrence.set),
        occurrence.configurations,
        occurrence.established
    );
    let y = |row: usize| rows + ROW_HEIGHT * (row as f64 + 0.5);
    let perturbed: Vec<usize> =
        (0..axes.len()).filter(|&row| occurrence.set.contains(axes[row])).collect();
    html! {
        g {
            title { (tooltip) }
            (rect(x - 7.0, base - all, 14.0, all, &format!("{class} pale")))
            (rect(x - 7.0, base - established, 14.0, established, class))
            (text(x, base - all - 5.0, "tiny middle", &occurrence.configurations.to_string()))
            @if let (Some(first), Some(last)) = (perturbed.first(), perturbed.last()) {
                (line("join", [x, y(*first)], [x, y(*last)]))
            }
            @for (row, axis) in axes.iter().enumerate() {
                @let is_start = AxisSet::of(*axis) == occurrence.start;
                (dot([x, y(row)], occurrence.set.contains(*axis), is_start))
            }
        }
    }
}

fn dot([x, y]: [f64; 2], is_perturbed: bool, is_start: bool) -> Markup {
    let class = match (is_perturbed, is_start) {
        (_, true) => "open",
        (true, false) => "mark",
        (false, false) => "absent",
    };
    let radius = if class == "absent" { DOT_RADIUS / 2.0 } else { DOT_RADIUS };
    html! { circle class=(class) cx=(number(x)) cy=(number(y)) r=(number(radius)) {} }
}

fn legend(top: f64, is_compensated: bool) -> Markup {
    let class = if is_compensated { "compensated" } else { "emergent" };
    html! {
        (rect(0.0, top, 10.0, 10.0, class))
        (text(16.0, top + 9.0, "small", "established"))
        (rect(100.0, top, 10.0, 10.0, &format!("{class} pale")))
        (text(116.0, top + 9.0, "small", "smaller subsets were not all run"))
        @if is_compensated {
            (dot([6.0, top + 24.0], true, true))
            (text(16.0, top + 28.0, "small", "fails alone"))
            (dot([106.0, top + 24.0], true, false))
            (text(116.0, top + 28.0, "small", "perturbed as well, it succeeds"))
        } @else {
            (dot([6.0, top + 24.0], true, false))
            (text(16.0, top + 28.0, "small", "perturbed: these axes together fail"))
        }
    }
}
