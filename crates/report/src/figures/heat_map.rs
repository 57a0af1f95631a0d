//! Success under each axis alone and under simultaneous perturbation, policies ×
//! axes, one panel per level.

use benchmark::{Axis, Condition, Level};
use maud::{Markup, html};
use paired::{Cell, Count};

use super::svg::{HEAD, Scale, number, shortened, text};
use super::{Figure, WIDTH};
use crate::document::Document;
use crate::words;

const LABEL_WIDTH: f64 = 108.0;
/// Characters of a policy's name that fit beside the squares.
const LABEL_CHARACTERS: usize = 12;
const ROW_HEIGHT: f64 = 28.0;
/// Height of the slanted names below the columns.
const NAME_HEIGHT: f64 = 78.0;
const LEGEND_HEIGHT: f64 = 52.0;
/// Number of rectangles that draw the colour scale.
const LEGEND_STEPS: u32 = 40;
/// ColorBrewer's YlGnBu in nine classes, from no success to full success.
const COLOURS: [[u8; 3]; 9] = [
    [255, 255, 217],
    [237, 248, 177],
    [199, 233, 180],
    [127, 205, 187],
    [65, 182, 196],
    [29, 145, 192],
    [34, 94, 168],
    [37, 52, 148],
    [8, 29, 88],
];
/// Success rate above which a cell's number is white.
const DARK_ABOVE: f64 = 0.55;

/// Draws the panel of a level; `None` if no campaign has this level.
pub fn heat_map(document: &Document, level: Level) -> Option<Figure> {
    let rows: Vec<(&str, &Cell)> = document
        .analyses
        .iter()
        .filter_map(|analysis| Some((analysis.label.as_str(), analysis.cell(level)?)))
        .collect();
    if rows.is_empty() {
        return None;
    }
    let all = Axis::every().map(Condition::Single);
    let is_run =
        |condition: &Condition| rows.iter().any(|(_, cell)| count(cell, *condition).is_some());
    let columns: Vec<Condition> = all.chain([Condition::Simultaneous]).filter(is_run).collect();
    let width = (WIDTH - LABEL_WIDTH - 6.0) / columns.len().max(1) as f64;
    let counts = rows.iter().flat_map(|(_, cell)| {
        let counts = columns.iter().filter_map(|condition| count(cell, *condition));
        counts.map(|count| count.n).filter(|n| *n > 0)
    });
    let counts = words::counts(counts);
    let bottom = HEAD + ROW_HEIGHT * rows.len() as f64;
    let body = html! {
        (text(0.0, 15.0, "head", &format!("{level}: radius {}", level.radius())))
        @for (row, (name, cell)) in rows.iter().enumerate() {
            @let y = HEAD + ROW_HEIGHT * row as f64;
            g {
                title { (name) }
                (text(0.0, y + 18.0, "name", &shortened(name, LABEL_CHARACTERS)))
            }
            @for (column, condition) in columns.iter().enumerate() {
                @let label = format!("{name}, {}", condition.name());
                @let place = [LABEL_WIDTH + width * column as f64, y];
                (square(&label, count(cell, *condition), place, width))
            }
        }
        @for (column, condition) in columns.iter().enumerate() {
            (slanted([LABEL_WIDTH + width * (column as f64 + 0.6), bottom + 12.0], *condition))
        }
        (legend(bottom + NAME_HEIGHT, &counts))
    };
    let title = format!("Success under each axis alone and simultaneous at {level}, by policy");
    let name = format!("single-axis-{level}");
    Some(Figure::new(&name, title, bottom + NAME_HEIGHT + LEGEND_HEIGHT, body))
}

/// Returns the results under a condition; `None` if the campaign does not run it.
fn count(cell: &Cell, condition: Condition) -> Option<Count> {
    match condition {
        Condition::Nominal | Condition::Subset(_) | Condition::Variant => None,
        Condition::Single(axis) => cell.alone.get(&axis).map(|alone| alone.count),
        Condition::Simultaneous => cell.simultaneous,
    }
}

/// Draws a column's name at 45 degrees; the text ends at `[x, y]`.
fn slanted([x, y]: [f64; 2], condition: Condition) -> Markup {
    let turned = format!("translate({} {}) rotate(-45)", number(x), number(y));
    html! { text class="small end" transform=(turned) { (condition.name()) } }
}

fn square(label: &str, count: Option<Count>, [x, y]: [f64; 2], width: f64) -> Markup {
    let rate = count.as_ref().and_then(Count::rate);
    let tooltip = match count {
        Some(Count { successes, n }) => format!("{label}: {successes} of {n} succeed"),
        None => format!("{label}: not measured"),
    };
    let (left, top) = (number(x + 1.0), number(y + 1.0));
    let (middle, base) = (number(x + width / 2.0), number(y + 17.5));
    let (width, height) = (number(width - 2.0), number(ROW_HEIGHT - 2.0));
    html! {
        g {
            title { (tooltip) }
            @if let Some(rate) = rate {
                @let ink = if rate > DARK_ABOVE { "on-dark" } else { "on-light" };
                rect fill=(colour(rate)) x=(left) y=(top) width=(width) height=(height)
                    rx="2" {}
                text class={ "tiny middle bare " (ink) } x=(middle) y=(base) {
                    (words::percent(rate))
                }
            } @else {
                rect class="unknown" x=(left) y=(top) width=(width) height=(height) rx="2" {}
                text class="tiny middle muted" x=(middle) y=(base) { "–" }
            }
        }
    }
}

fn legend(top: f64, counts: &str) -> Markup {
    let scale = Scale::between([0.0, 1.0], [LABEL_WIDTH, WIDTH - 14.0]);
    let step = |step: u32| f64::from(step) / f64::from(LEGEND_STEPS);
    html! {
        @for index in 0..LEGEND_STEPS {
            @let (x, next) = (scale.at(step(index)), scale.at(step(index + 1)));
            rect fill=(colour(step(index) + 0.5 * step(1))) x=(number(x))
                y=(number(top)) width=(number(next - x + 0.3)) height="8" {}
        }
        @for tick in [0.0, 0.25, 0.5, 0.75, 1.0] {
            (text(scale.at(tick), top + 21.0, "tiny muted middle", &number(100.0 * tick)))
        }
        (text(f64::midpoint(LABEL_WIDTH, WIDTH - 14.0), top + 38.0, "small muted middle",
            &format!("success, % of rollouts ({counts} each)")))
    }
}

/// Interpolates linearly between the nine [`COLOURS`].
fn colour(rate: f64) -> String {
    let position = rate.clamp(0.0, 1.0) * (COLOURS.len() - 1) as f64;
    let (below, above) = (position.floor() as usize, position.ceil() as usize);
    let mixed: Vec<String> = (0..3)
        .map(|i| {
            let (from, to) = (f64::from(COLOURS[below][i]), f64::from(COLOURS[above][i]));
            format!("{:02x}", (from + (to - from) * position.fract()).round() as u8)
        })
        .collect();
    format!("#{}", mixed.concat())
}
