//! Measured policies beside those of the paper: simultaneous success by level, and emergent failures
//! against compensated successes. Measured policies have capital letters and intervals, those of
//! the paper small letters.

use std::collections::BTreeSet;

use benchmark::Level;
use maud::{Markup, html};
use paired::Interval;

use super::svg::{AXIS, HEAD, MARGIN, Scale, end_and_step, line, percent_ticks, text, whisker};
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
/// Distance between the letters of published policies at a level.
const PITCH: f64 = 10.0;

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

    fn mark(&self, point: &Point, [x, y]: [f64; 2]) -> Markup {
        let class = if point.is_published { "small muted middle" } else { "name middle" };
        html! {
            g {
                title { (point.policy) }
                (text(x, y + 4.5, class, &point.letter.to_string()))
            }
        }
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
        let legend = in_lines(&names.join(" "), LEGEND_CHARACTERS);
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
    let place = |level: &Level| levels.range(..level).count() as f64;
    let columns: Vec<_> = levels.iter().map(|level| (place(level), level.to_string())).collect();
    let domain = [-0.2, place(levels.last()?) + 0.8];
    let x = Scale::between(domain, [LABEL_WIDTH, WIDTH - MARGIN]);
    let plot = Plot { points: &points, x, end: 1.0 };
    let body = html! {
        @for point in &points {
            @let column = x.at(place(&point.level));
            @if let Some(interval) = point.intervals[0] { (plot.vertical(column, interval)) }
            @let shift = match point.is_published {
                true => PITCH * (2.0 + f64::from(u32::from(point.letter) - u32::from('a'))),
                false => 0.0,
            };
            (plot.mark(point, [column + shift, plot.y(point.s_sim)]))
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
    let high = |interval: Option<Interval>| interval.map_or(0.0, |[_, high]| high);
    let ends = points.iter().flat_map(|point| {
        let [_, r_e, r_c] = point.intervals;
        [point.r_e, point.r_c, high(r_e), high(r_c)]
    });
    let (end, step) = end_and_step(ends.fold(0.01, f64::max), 6.0);
    points.retain(|point| point.level == level);
    points.iter().find(|point| !point.is_published)?;
    let x = Scale::between([0.0, end], [LABEL_WIDTH, WIDTH - MARGIN]);
    let plot = Plot { points: &points, x, end };
    let body = html! {
        (line("zero", [x.at(0.0), plot.y(0.0)], [x.at(end), plot.y(end)]))
        @for point in &points {
            @let [column, row] = [x.at(point.r_c), plot.y(point.r_e)];
            @let [_, r_e, r_c] = point.intervals;
            @if let Some(interval) = r_e { (plot.vertical(column, interval)) }
            @if let Some(interval) = r_c { (whisker(&x, interval, row)) }
            (plot.mark(point, [column, row]))
        }
    };
    let title = format!("Emergent failures against compensated successes at {level}");
    let head = format!("{level}: R_e emergent, %");
    let words = [title.as_str(), &head, "above the line: I < 0", "R_c compensated, %"];
    let ticks = percent_ticks([0.0, end], step);
    Some(plot.figure(&format!("paper-changes-{level}"), words, [&ticks, &ticks], &body))
}
