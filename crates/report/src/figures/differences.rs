//! The difference of two policies under every condition at every level, with
//! intervals.

use benchmark::Condition;
use maud::{Markup, html};
use paired::{ComparedCell, Difference};

use super::svg::{
    AXIS, HEAD, Scale, circle, end_and_step, line, number, percent_ticks, shortened, text, whisker,
    withheld,
};
use super::{Figure, WIDTH};
use crate::comparison::Comparison;
use crate::words;

const LABEL_WIDTH: f64 = 96.0;
const ROW_HEIGHT: f64 = 18.0;
const LEVEL_GAP: f64 = 10.0;
/// Draws the panel of two policies; `None` if no rollout has an outcome for both
/// policies.
pub fn differences(comparison: &Comparison) -> Option<Figure> {
    let cells = comparison.statistics.cells.iter();
    let rows: Vec<(&ComparedCell, &Difference)> =
        cells.filter_map(|cell| Some((cell, cell.difference.as_ref()?))).collect();
    if rows.is_empty() {
        return None;
    }
    let ends = rows.iter().flat_map(|(_, delta)| {
        let [low, high] = delta.difference_ci95.unwrap_or([delta.difference; 2]);
        [low, high, delta.difference].map(f64::abs)
    });
    let largest = ends.fold(0.01, f64::max);
    let (end, step) = end_and_step(largest, 3.0);
    let scale = Scale::between([-end, end], [LABEL_WIDTH, WIDTH - 20.0]);
    let mut y = HEAD + 22.0;
    let mut previous = None;
    let mut body = Vec::new();
    for (cell, difference) in &rows {
        if previous.is_some_and(|previous| previous != cell.level) {
            y += LEVEL_GAP;
        }
        let names_level = previous != Some(cell.level) && cell.condition != Condition::Nominal;
        previous = Some(cell.level);
        body.push(row(&scale, cell, difference, names_level, y));
        y += ROW_HEIGHT;
    }
    let counts = words::counts(rows.iter().map(|(_, delta)| delta.n));
    let (a, b) = (&comparison.a.label, &comparison.b.label);
    let (better_a, better_b) = (shortened(a, 20), shortened(b, 20));
    let markup = html! {
        (text(0.0, 15.0, "head", &shortened(&comparison.title(), 46)))
        (text(scale.at(0.0) - 6.0, HEAD + 10.0, "small muted end", &format!("← {better_b}")))
        (text(scale.at(0.0) + 6.0, HEAD + 10.0, "small muted", &format!("{better_a} →")))
        (scale.axis([HEAD + 16.0, y], &percent_ticks([-end, end], step, true),
            &format!("difference of success, points ({counts})")))
        (line("zero", [scale.at(0.0), HEAD + 16.0], [scale.at(0.0), y]))
        @for row in body { (row) }
    };
    let title = format!("Success of {a} less that of {b}, by condition and level");
    let name = format!("difference-{a}-{b}");
    Some(Figure::new(&name, title, y + AXIS, markup))
}

fn row(
    scale: &Scale,
    cell: &ComparedCell,
    delta: &Difference,
    names_level: bool,
    y: f64,
) -> Markup {
    let middle = y + ROW_HEIGHT / 2.0;
    let tooltip = format!(
        "{}: {}{}; only A {}, only B {}, of {}",
        cell.name(),
        words::points(delta.difference),
        words::points_interval(delta.difference_ci95, delta.no_interval),
        delta.a_only,
        delta.b_only,
        delta.n
    );
    html! {
        g {
            title { (tooltip) }
            @if names_level { (text(0.0, middle + 4.0, "name small", &cell.level.to_string())) }
            text class="small end" x=(number(LABEL_WIDTH - 10.0)) y=(number(middle + 4.0)) {
                (cell.condition.name())
            }
            @match delta.difference_ci95 {
                Some(interval) => (whisker(scale, interval, middle)),
                None => (withheld(scale, delta.difference, delta.no_interval, middle)),
            }
            (circle(scale.at(delta.difference), middle, "mark"))
        }
    }
}
