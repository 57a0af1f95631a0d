//! Measured policies beside those of the paper: simultaneous success by level, and emergent failures
//! against compensated successes. Measured policies have capital letters and intervals, those of
//! the paper small letters.

use std::collections::BTreeSet;

use benchmark::Level;
use maud::{Markup, html};
use paired::Interval;

use super::svg::{
    AXIS, HEAD, MARGIN, Scale, end_and_step, line, number, percent_ticks, text, whisker,
};
use super::{Figure, WIDTH};
use crate::block::in_lines;
use crate::document::Document;
use crate::paper::{Point, points};

/// Space for the numbers of the vertical axis.
const LABEL_WIDTH: f64 = 36.0;
const PLOT_HEIGHT: f64 = 260.0;
const LINE_HEIGHT: f64 = 16.0;
/// Characters of a line of the legend.
const LEGEND_CHARACTERS: usize = 58;
/// Smallest distances of a letter from a point and from another letter, across and down.
const LETTER: [f64; 2] = [9.0, 12.5];

/// A plot of shares of up to `end` against another quantity.
struct Plot<'a> {
    points: &'a [Point],
    x: Scale,
    end: f64,
}

impl Plot<'_> {
    fn y(&self, share: f64) -> f64 {
        HEAD + PLOT_HEIGHT * (1.0 - share / self.end)
    }

    fn vertical(&self, x: f64, [low, high]: Interval) -> Markup {
        line("whisker", [x, self.y(low)], [x, self.y(high)])
    }

    /// Draws a policy's point, and its letter around a place.
    fn mark(&self, point: &Point, [x, y]: [f64; 2], letter: [f64; 2]) -> Markup {
        let (dot, class) = match point.is_published {
            true => ("open", "small muted middle"),
            false => ("mark", "name middle"),
        };
        html! {
            g {
                title { (point.policy) }
                circle class=(dot) cx=(number(x)) cy=(number(y)) r="3" {}
                (text(letter[0], letter[1] + 4.5, class, &point.letter.to_string()))
            }
        }
    }

    /// Finds a place for the letter of each point, where it hides neither a point nor another letter.
    fn letters(&self, points: &[[f64; 2]]) -> Vec<[f64; 2]> {
        let mut taken = points.to_vec();
        for [x, y] in points {
            let around = (1..=8).flat_map(|ring| {
                let [dx, dy] = LETTER.map(|distance| distance * f64::from(ring));
                let steps = [[0.0, -1.0], [1.0, 0.0], [0.0, 1.0], [-1.0, 0.0]];
                let corners = [[1.0, -1.0], [1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0]];
                let places = steps.into_iter().chain(corners);
                places.map(move |[right, down]| [x + dx * right, y + dy * down])
            });
            let is_free = |[x, y]: &[f64; 2]| {
                let hides =
                    |[a, b]: &[f64; 2]| (a - x).abs() < LETTER[0] && (b - y).abs() < LETTER[1];
                let is_inside = *x > LABEL_WIDTH && *x < WIDTH && *y > HEAD;
                is_inside && *y < HEAD + PLOT_HEIGHT && !taken.iter().any(hides)
            };
            let place = around.into_iter().find(is_free).unwrap_or([*x, *y]);
            taken.push(place);
        }
        taken.split_off(points.len())
    }

    /// Adds axes and legend.
    fn figure(
        &self,
        name: &str,
        [title, head, aside, below]: [&str; 4],
        [columns, shares]: [&[(f64, String)]; 2],
        body: &Markup,
    ) -> Figure {
        let bottom = HEAD + PLOT_HEIGHT;
        let mut names: Vec<String> = Vec::new();
        for Point { policy, letter, .. } in self.points {
            let name = format!("{letter} {policy}").replace(' ', "\u{a0}");
            if !names.contains(&name) {
                names.push(name);
            }
        }
        let legend = in_lines(&names.join(", "), LEGEND_CHARACTERS);
        let body = html! {
            (text(0.0, 15.0, "head", head))
            (text(WIDTH, 15.0, "small muted end", aside))
            (self.x.axis([HEAD, bottom], columns, below))
            @for (share, label) in shares {
                (line("grid", [LABEL_WIDTH, self.y(*share)], [WIDTH - MARGIN, self.y(*share)]))
                (text(LABEL_WIDTH - 6.0, self.y(*share) + 4.0, "tiny muted end", label))
            }
            (body)
            @for (index, line) in legend.iter().enumerate() {
                (text(0.0, bottom + AXIS + LINE_HEIGHT * (index as f64 + 0.6), "small", line))
            }
        };
        let height = bottom + AXIS + LINE_HEIGHT * legend.len() as f64;
        Figure::new(name, title.to_owned(), height, body)
    }
}

/// Draws simultaneous success by level; `None` if no policy was measured as in the paper.
pub fn by_level(document: &Document) -> Option<Figure> {
    let points = points(document);
    let levels: BTreeSet<Level> = points.iter().map(|point| point.level).collect();
    levels.last()?;
    // Each policy has a place of its own within a level.
    let mut letters: Vec<char> = points.iter().map(|point| point.letter).collect();
    letters.dedup();
    let pitch = 1.0 / (letters.len() as f64 + 1.0);
    let x = Scale::between([0.0, levels.len() as f64], [LABEL_WIDTH, WIDTH - MARGIN]);
    let columns: Vec<_> = (0..=levels.len()).map(|end| (end as f64, String::new())).collect();
    let plot = Plot { points: &points, x, end: 1.0 };
    let body = html! {
        @for (index, level) in levels.iter().enumerate() {
            @let middle = x.at(index as f64 + 0.5);
            (text(middle, HEAD + PLOT_HEIGHT + 14.0, "tiny muted middle", &level.to_string()))
        }
        @for point in &points {
            @let level = levels.range(..point.level).count() as f64;
            @let place = letters.iter().take_while(|letter| **letter != point.letter).count();
            @let column = x.at(level + pitch * (place as f64 + 1.0));
            @if let Some(interval) = point.intervals[0] { (plot.vertical(column, interval)) }
            @let top = plot.y(point.intervals[0].map_or(point.s_sim, |[_, high]| high));
            (plot.mark(point, [column, plot.y(point.s_sim)], [column, top - LETTER[1]]))
        }
    };
    let title = "Simultaneous success by level, measured and published";
    let words = [title, "Simultaneous success, %", "whiskers: 95 %", "level"];
    let shares = percent_ticks([0.0, 1.0], 0.25);
    Some(plot.figure("paper-success", words, [&columns, &shares], &body))
}

/// Draws emergent failures against compensated successes at a level; `None` if no policy was measured
/// as in the paper.
pub fn changes(document: &Document, level: Level) -> Option<Figure> {
    let mut points = points(document);
    points.retain(|point| point.level == level);
    points.iter().find(|point| !point.is_published)?;
    let high = |interval: Option<Interval>| interval.map_or(0.0, |[_, high]| high);
    let ends = points.iter().flat_map(|point| {
        let [_, r_e, r_c] = point.intervals;
        [point.r_e, point.r_c, high(r_e), high(r_c)]
    });
    let (end, step) = end_and_step(ends.fold(0.01, f64::max), 6.0);
    let x = Scale::between([0.0, end], [LABEL_WIDTH, WIDTH - MARGIN]);
    let plot = Plot { points: &points, x, end };
    let places = points.iter().map(|point| [x.at(point.r_c), plot.y(point.r_e)]);
    let places: Vec<[f64; 2]> = places.collect();
    let body = html! {
        (line("zero", [x.at(0.0), plot.y(0.0)], [x.at(end), plot.y(end)]))
        @for ((point, &[column, row]), letter) in points.iter().zip(&places).zip(plot.letters(&places)) {
            @let [_, r_e, r_c] = point.intervals;
            (line("grid", [column, row], letter))
            @if let Some(interval) = r_e { (plot.vertical(column, interval)) }
            @if let Some(interval) = r_c { (whisker(&x, interval, row)) }
            (plot.mark(point, [column, row], letter))
        }
    };
    let title = format!("Emergent failures against compensated successes at {level}");
    let head = format!("{level}: R_e emergent, %");
    let words = [title.as_str(), &head, "above the line: I < 0", "R_c compensated, %"];
    let ticks = percent_ticks([0.0, end], step);
    Some(plot.figure(&format!("paper-changes-{level}"), words, [&ticks, &ticks], &body))
}
