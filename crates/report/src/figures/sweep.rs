//! Success of the checkpoints of one training by the number in their names, nominally and under all
//! axes, one panel per level.

use std::str;

use benchmark::{Condition, Level};
use maud::{Markup, html};
use paired::SuiteRow;

use super::svg::{
    AXIS, HEAD, MARGIN, Scale, line, number, path, rect, shares, shortened, spaced, text,
};
use super::{Figure, WIDTH, levels};
use crate::document::Document;
use crate::words::{counts, percent};

/// Fewest checkpoints that make a curve.
const FEWEST: usize = 3;
/// Space for the numbers of the vertical axis.
const LABEL_WIDTH: f64 = 48.0;
const LEGEND_HEIGHT: f64 = 28.0;
const PLOT_HEIGHT: f64 = 190.0;
/// Width of a digit of an axis.
const DIGIT_WIDTH: f64 = 7.5;
/// Half of a mark's size, and its distance from its step if there are two curves.
const MARK: f64 = 3.5;

/// Policies whose names differ in one number only.
#[derive(Debug, PartialEq)]
struct Sweep {
    /// The common name, with `N` in place of the number.
    name: String,
    /// The number of each policy.
    steps: Vec<f64>,
}

impl Sweep {
    /// Reads the policies' names; `None` if there are fewer than three, if two have the same number,
    /// or if they differ in anything else.
    fn of(names: &[&str]) -> Option<Self> {
        let names: Vec<Vec<&str>> = names.iter().map(|name| parts(name)).collect();
        let first = names.first().filter(|_| names.len() >= FEWEST)?;
        let differs = |at: &usize| names.iter().any(|name| name.get(*at) != first.get(*at));
        let at = (0..first.len()).find(differs)?;
        let is_alike = |name: &Vec<&str>| {
            name.len() == first.len()
                && name[..at] == first[..at]
                && name[at + 1..] == first[at + 1..]
        };
        let steps = names.iter().map(|name| name.get(at)?.parse().ok().filter(|_| is_alike(name)));
        let steps = steps.collect::<Option<Vec<f64>>>()?;
        let mut sorted = steps.clone();
        sorted.sort_by(f64::total_cmp);
        sorted.dedup();
        let name = [&first[..at], &["N"], &first[at + 1..]].concat().concat();
        (sorted.len() == steps.len()).then_some(Self { name, steps })
    }
}

/// Splits a name into its numbers, which may have a fraction, and the words between them.
fn parts(name: &str) -> Vec<&str> {
    let is_numeric = |byte: u8| byte.is_ascii_digit() || byte == b'.';
    let parts = name.as_bytes().chunk_by(|a, b| is_numeric(*a) == is_numeric(*b));
    parts.map(|part| str::from_utf8(part).expect("split beside ASCII characters")).collect()
}

/// Draws a panel for each level at which three checkpoints or more were run under all axes, or one of
/// nominal success alone; empty if the policies are no checkpoints of one training.
pub fn sweep(document: &Document) -> Vec<Figure> {
    let names = document.analyses.iter().map(|analysis| analysis.subject.policy.as_str());
    let Some(Sweep { name, steps }) = Sweep::of(&names.collect::<Vec<_>>()) else {
        return Vec::new();
    };
    let rows = document.analyses.iter().map(|analysis| analysis.report.suite_rows());
    let mut checkpoints: Vec<(f64, Vec<SuiteRow>)> = steps.into_iter().zip(rows).collect();
    checkpoints.sort_by(|(a, _), (b, _)| a.total_cmp(b));
    let curve = |condition: Condition, level: Level| {
        let points = checkpoints.iter().filter_map(|(step, rows)| {
            let row = rows.iter().find(|row| (row.condition, row.level) == (condition, level))?;
            row.all.rate().map(|rate| (*step, rate, row))
        });
        Some(points.collect::<Vec<_>>()).filter(|points| points.len() >= FEWEST)
    };
    let nominal = curve(Condition::Nominal, Level::L0);
    let panel = |level: Option<(Level, Curve<'_>)>| {
        let (head, file) = match &level {
            Some((level, _)) => {
                (format!("{level}: radius {}", level.radius()), format!("sweep-{level}"))
            }
            None => ("nominal".to_owned(), "sweep-nominal".to_owned()),
        };
        let curves = [nominal.clone(), level.map(|(_, curve)| curve)];
        figure([&file, &head, &name], &curves)
    };
    let panels = levels(document)
        .into_iter()
        .filter_map(|level| Some(panel(Some((level, curve(Condition::Simultaneous, level)?)))));
    let mut panels: Vec<Figure> = panels.collect();
    if panels.is_empty() && nominal.is_some() {
        panels.push(panel(None));
    }
    panels
}

/// Step, rate and row of each checkpoint with outcomes, in order.
type Curve<'a> = Vec<(f64, f64, &'a SuiteRow)>;

/// Draws nominal and simultaneous success.
fn figure([file, head, name]: [&str; 3], curves: &[Option<Curve<'_>>; 2]) -> Figure {
    let points = || curves.iter().flatten().flatten();
    let mut steps: Vec<f64> = points().map(|(step, ..)| *step).collect();
    steps.sort_by(f64::total_cmp);
    let ends = [steps[0], steps[steps.len() - 1]];
    let x = Scale::between(ends, [LABEL_WIDTH + MARGIN, WIDTH - 2.0 * MARGIN]);
    let top = HEAD + LEGEND_HEIGHT;
    let bottom = top + PLOT_HEIGHT;
    let y = |share: f64| bottom - PLOT_HEIGHT * share;
    let distance = DIGIT_WIDTH * (number(ends[1]).len() as f64 + 1.0);
    let ticks = spaced(&x, steps.into_iter(), distance);
    let ticks: Vec<_> = ticks.into_iter().map(|step| (step, number(step))).collect();
    let below = format!("N of {}", shortened(name, 40));
    let legend = HEAD + 4.0;
    let drawn = |curve: &Curve<'_>,
                 key: f64,
                 aside: f64,
                 class: &str,
                 mark: &dyn Fn(f64, f64) -> Markup| {
        let condition = curve.iter().map(|(.., row)| row.condition.name()).next();
        let n = counts(curve.iter().map(|(.., row)| row.all.n));
        let place = |(step, rate, _): &(f64, f64, &SuiteRow)| [x.at(*step) + aside, y(*rate)];
        html! {
            (line(class, [key, legend], [key + 24.0, legend]))
            (mark(key + 12.0, legend))
            (text(key + 30.0, legend + 4.0, "small", &format!("{}, {n}", condition.unwrap_or_default())))
            path class=(class) d=(path(curve.iter().map(place))) {}
            @for point @ (step, rate, row) in curve {
                @let [column, at] = place(point);
                g {
                    title { (number(*step)) ", " (row.name()) ": " (percent(*rate)) " %" }
                    @if let Some([low, high]) = row.ci95 {
                        (line("whisker", [column, y(low)], [column, y(high)]))
                    }
                    (mark(column, at))
                }
            }
        }
    };
    let aside = if curves.iter().all(Option::is_some) { MARK } else { 0.0 };
    let circle = |x: f64, y: f64| {
        html! { circle class="open" cx=(number(x)) cy=(number(y)) r=(number(MARK)) {} }
    };
    let square = |x: f64, y: f64| rect(x - MARK, y - MARK, 2.0 * MARK, 2.0 * MARK, "mark");
    let body = html! {
        (text(0.0, 15.0, "head", head))
        (text(WIDTH, 15.0, "small muted end", "whiskers: 95 %"))
        (x.axis([top, bottom], &ticks, &below))
        (shares(y, [LABEL_WIDTH, WIDTH - MARGIN]))
        @if let Some(curve) = &curves[0] {
            (drawn(curve, 0.0, -aside, "bracket", &circle))
        }
        @if let Some(curve) = &curves[1] {
            (drawn(curve, WIDTH / 2.0 - 20.0, aside, "curve", &square))
        }
    };
    let title = format!("Success of the checkpoints {name}: {head}");
    Figure::new(file, title, bottom + AXIS, body)
}

#[cfg(test)]
mod tests {
    use super::Sweep;

    #[test]
    fn checkpoints_of_one_training_differ_in_one_number() {
        let steps = |names: &[&str]| Sweep::of(names).map(|sweep| (sweep.name, sweep.steps));
        let found = |name: &str, steps: [f64; 3]| Some((name.to_owned(), steps.to_vec()));
        assert_eq!(
            steps(&["step-9000", "step-010000", "step-500"]),
            found("step-N", [9000.0, 10000.0, 500.0])
        );
        assert_eq!(
            steps(&["pi0.5-α-1k.pt", "pi0.5-α-2k.pt", "pi0.5-α-10k.pt"]),
            found("pi0.5-α-Nk.pt", [1.0, 2.0, 10.0])
        );
        assert_eq!(steps(&["epoch0.5", "epoch1", "epoch1.5"]), found("epochN", [0.5, 1.0, 1.5]));
        for others in [
            &["step-1", "step-2"][..],
            &["step-1", "step-2", "step-2"],
            &["step-1", "step-2", "step-x"],
            &["step-1", "step-2", "step-3-again"],
            &["a-1-1", "a-2-1", "a-1-2"],
            &["v1.0.1", "v1.0.2", "v1.0.3"],
            &["student", "student", "student"],
            &["", "1", "2"],
        ] {
            assert_eq!(steps(others), None, "{others:?}");
        }
    }
}
