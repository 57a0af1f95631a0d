//! Primitives of the figures: numbers, scales, axes, intervals.

use maud::{Markup, html};
use paired::Interval;

/// Width of a panel that is not `WIDE`, in user units, which are pixels if the panel is not
/// scaled.
pub const WIDTH: f64 = 380.0;
/// Width of a figure that fills a page.
pub(super) const WIDE: f64 = 1140.0;
/// Space to the left and to the right of a scale.
pub(super) const MARGIN: f64 = 14.0;
/// Height of a panel's heading.
pub(super) const HEAD: f64 = 26.0;
/// Height of an axis with its numbers and its title.
pub(super) const AXIS: f64 = 40.0;

/// Formats a coordinate to two decimals without trailing zeros.
pub(super) fn number(value: f64) -> String {
    let text = format!("{value:.2}");
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

/// Map from values to horizontal coordinates.
#[derive(Clone, Copy)]
pub(super) struct Scale {
    domain: [f64; 2],
    range: [f64; 2],
}

impl Scale {
    /// Maps `domain` onto the width of a panel without its margins.
    pub(super) fn over(domain: [f64; 2]) -> Self {
        Self::between(domain, [MARGIN, WIDTH - MARGIN])
    }

    pub(super) fn between(domain: [f64; 2], range: [f64; 2]) -> Self {
        Self { domain, range }
    }

    pub(super) fn at(&self, value: f64) -> f64 {
        let [from, to] = self.domain;
        let [left, right] = self.range;
        let share = ((value - from) / (to - from)).clamp(0.0, 1.0);
        left + share * (right - left)
    }

    /// Draws an axis: a vertical line per tick from `top` to `bottom`, its label below, and
    /// a centred title.
    pub(super) fn axis(
        &self,
        [top, bottom]: [f64; 2],
        ticks: &[(f64, String)],
        title: &str,
    ) -> Markup {
        let [left, right] = self.range;
        html! {
            @for (value, label) in ticks {
                line class="grid" x1=(number(self.at(*value))) x2=(number(self.at(*value)))
                    y1=(number(top)) y2=(number(bottom)) {}
                (text(self.at(*value), bottom + 14.0, "tiny muted middle", label))
            }
            (text(f64::midpoint(left, right), bottom + 31.0, "small muted middle", title))
        }
    }
}

/// Returns ticks at every multiple of `step`, a fraction, with labels in percent.
pub(super) fn percent_ticks([from, to]: [f64; 2], step: f64) -> Vec<(f64, String)> {
    let first = (from / step - 1e-9).ceil() as i64;
    let last = (to / step + 1e-9).floor() as i64;
    let tick = |k: i64| k as f64 * step;
    (first..=last).map(|k| (tick(k), format!("{}", (100.0 * tick(k)).round()))).collect()
}

/// Returns the end of an axis from zero, and the distance of its ticks: the first
/// candidate that needs at most `most` ticks.
pub(super) fn end_and_step(largest: f64, most: f64) -> (f64, f64) {
    let mut steps = [0.02, 0.05, 0.1, 0.25].into_iter();
    let step = steps.find(|step| largest / step <= most).unwrap_or(0.5);
    ((largest / step - 1e-9).ceil() * step, step)
}

/// Drops each value that is closer than `distance` to the next larger kept value on the scale.
pub(super) fn spaced(
    scale: &Scale,
    values: impl DoubleEndedIterator<Item = f64>,
    distance: f64,
) -> Vec<f64> {
    let mut kept: Vec<f64> = Vec::new();
    for value in values.rev() {
        let has_room = |last: &f64| scale.at(*last) - scale.at(value) >= distance;
        if kept.last().is_none_or(has_room) {
            kept.push(value);
        }
    }
    kept.reverse();
    kept
}

/// Draws the vertical axis of a rate: a horizontal line per quarter, with its label in percent.
pub(super) fn shares(y: impl Fn(f64) -> f64, [left, right]: [f64; 2]) -> Markup {
    html! {
        @for share in [0.0, 0.25, 0.5, 0.75, 1.0] {
            (line("grid", [left, y(share)], [right, y(share)]))
            @let unit = if share >= 1.0 { " %" } else { "" };
            (text(left - 6.0, y(share) + 4.0, "tiny muted end",
                &format!("{}{unit}", number(100.0 * share))))
        }
    }
}

/// Returns the data of a path through the places.
pub(super) fn path(places: impl Iterator<Item = [f64; 2]>) -> String {
    let step = |(index, [x, y]): (usize, [f64; 2])| {
        let command = if index == 0 { "M" } else { "L" };
        format!("{command}{} {}", number(x), number(y))
    };
    places.enumerate().map(step).collect()
}

pub(super) fn text(x: f64, y: f64, class: &str, content: &str) -> Markup {
    html! { text x=(number(x)) y=(number(y)) class=(class) { (content) } }
}

/// Draws an interval as a horizontal line with end caps.
pub(super) fn whisker(scale: &Scale, [low, high]: Interval, y: f64) -> Markup {
    let (low, high) = (number(scale.at(low)), number(scale.at(high)));
    let (top, middle, bottom) = (number(y - 4.0), number(y), number(y + 4.0));
    html! {
        path class="whisker"
            d={ "M" (low) " " (top) "V" (bottom) "M" (low) " " (middle) "H" (high)
                "M" (high) " " (top) "V" (bottom) } {}
    }
}

pub(super) fn circle(x: f64, y: f64, class: &str) -> Markup {
    html! { circle class=(class) cx=(number(x)) cy=(number(y)) r="5" {} }
}

pub(super) fn diamond(x: f64, y: f64, class: &str) -> Markup {
    let (left, right, x) = (number(x - 6.5), number(x + 6.5), number(x));
    let (top, bottom, y) = (number(y - 6.5), number(y + 6.5), number(y));
    let d = format!("M{x} {top}L{right} {y}L{x} {bottom}L{left} {y}Z");
    html! { path class=(class) d=(d) {} }
}

pub(super) fn square(x: f64, y: f64, class: &str) -> Markup {
    html! {
        rect class=(class) x=(number(x - 5.0)) y=(number(y - 5.0)) width="10" height="10" {}
    }
}

pub(super) fn rect(x: f64, y: f64, width: f64, height: f64, class: &str) -> Markup {
    html! {
        rect class=(class) x=(number(x)) y=(number(y)) width=(number(width.max(0.0)))
            height=(number(height)) {}
    }
}

pub(super) fn line(class: &str, [x1, y1]: [f64; 2], [x2, y2]: [f64; 2]) -> Markup {
    html! {
        line class=(class) x1=(number(x1)) y1=(number(y1)) x2=(number(x2)) y2=(number(y2)) {}
    }
}

/// Truncates a name to `most` characters, of which the last is an ellipsis.
pub(super) fn shortened(name: &str, most: usize) -> String {
    match name.chars().count() > most {
        true => name.chars().take(most - 1).chain(['…']).collect(),
        false => name.to_owned(),
    }
}
