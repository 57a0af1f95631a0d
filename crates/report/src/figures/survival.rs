//! Survival curves: the share of configurations that still succeed at each radius. One
//! panel per condition, with the protocol's levels and the median radius on the axis.

use benchmark::Level;
use maud::{Markup, html};
use paired::adaptive::radii::{Curve, Point};

use super::svg::{AXIS, HEAD, MARGIN, Scale, circle, diamond, line, number, path, shares, spaced};
use super::svg::{text, whisker};
use super::{Figure, WIDTH};
use crate::words;

/// Space for the numbers of the vertical axis.
const LABEL_WIDTH: f64 = 48.0;
const PLOT_HEIGHT: f64 = 190.0;
/// Height of the row that names the protocol's levels.
const LEVEL_ROW_HEIGHT: f64 = 18.0;
const LEGEND_HEIGHT: f64 = 36.0;
/// Smallest distance between two numbers on an axis.
const MIN_LABEL_DISTANCE: f64 = 20.0;

/// Draws the panel of a condition; `None` if the curve has no points.
pub fn survival(curve: &Curve) -> Option<Figure> {
    if curve.points.is_empty() {
        return None;
    }
    let scale = Scale::between([0.0, curve.largest_radius], [LABEL_WIDTH, WIDTH - MARGIN]);
    let (top, bottom) = (HEAD + LEVEL_ROW_HEIGHT, HEAD + LEVEL_ROW_HEIGHT + PLOT_HEIGHT);
    let place = Place { scale, bottom };
    let name = curve.condition.name();
    let body = html! {
        (text(0.0, 15.0, "head", name))
        (text(WIDTH, 15.0, "small muted end", &format!("{}, {}", half(curve), words::counts([curve.n]))))
        (scale.axis([top, bottom], &ticks(&scale, curve), "radius of the perturbation"))
        (shares(|share| place.y(share), [LABEL_WIDTH, WIDTH - MARGIN]))
        (intervals(&place, &curve.points))
        (brackets(&place, &curve.points))
        path class="curve" d=(path(curve.points.iter().map(|point| {
            place.point(point.radius, point.survival)
        }))) {}
        @for (level, point) in levels(&scale, curve) {
            @let [x, y] = place.point(point.radius, point.survival);
            (text(x, HEAD + 12.0, "small middle", &level.to_string()))
            g {
                title { (level) ": " (words::percent(point.survival)) " %" }
                (circle(x, y, "mark"))
            }
        }
        @if let Some(ends) = curve.half_success.ci95 { (whisker(&scale, ends, place.y(0.5))) }
        @if let Some(radius) = curve.half_success.radius {
            (diamond(scale.at(radius), place.y(0.5), "open"))
        }
        (legend(bottom + AXIS))
    };
    let title = format!("Share of configurations that still succeed, by radius: {name}");
    let height = bottom + AXIS + LEGEND_HEIGHT;
    Some(Figure::new(&format!("survival-{name}"), title, height, body))
}

/// Describes the radius at which half of the configurations still succeed, with its interval if
/// there is one, or states that this radius lies outside the curve.
fn half(curve: &Curve) -> String {
    let share = |point: Option<&Point>| point.map_or(0.0, |point| point.survival);
    if share(curve.points.first()) < 0.5 {
        return "fewer than half succeed".to_owned();
    }
    if share(curve.points.last()) > 0.5 {
        return format!("half beyond {}", number(curve.largest_radius));
    }
    let half = words::half_success(curve);
    match curve.half_success.ci95 {
        Some([low, high]) => format!("half at {half} [{low:.2}, {high:.2}]"),
        None => format!("half at {half}"),
    }
}

/// Map from radii and shares to coordinates.
struct Place {
    scale: Scale,
    bottom: f64,
}

impl Place {
    fn y(&self, share: f64) -> f64 {
        self.bottom - PLOT_HEIGHT * share
    }

    fn point(&self, radius: f64, share: f64) -> [f64; 2] {
        [self.scale.at(radius), self.y(share)]
    }
}

/// Returns the radii of the grid whose labels fit on the axis.
fn ticks(scale: &Scale, curve: &Curve) -> Vec<(f64, String)> {
    let radii = [0.0].into_iter().chain(curve.grid.iter().copied());
    let label = |radius: f64| (radius, number(radius));
    spaced(scale, radii, MIN_LABEL_DISTANCE).into_iter().map(label).collect()
}

/// Returns the protocol's levels whose labels fit on the axis, each with the curve's point at that
/// level.
fn levels<'a>(scale: &Scale, curve: &'a Curve) -> Vec<(Level, &'a Point)> {
    let named_points = curve.points.iter().filter_map(|point| Some((point.level?, point)));
    let radii = named_points.clone().map(|(level, _)| level.radius());
    let labelled = spaced(scale, radii, MIN_LABEL_DISTANCE);
    named_points.filter(|(level, _)| labelled.contains(&level.radius())).collect()
}

/// Draws the curve's confidence intervals as a band, which has no width at points without
/// an interval.
fn intervals(place: &Place, points: &[Point]) -> Markup {
    let ends = |point: &Point| point.ci95.unwrap_or([point.survival; 2]);
    let low = points.iter().map(|point| place.point(point.radius, ends(point)[0]));
    let high = points.iter().rev().map(|point| place.point(point.radius, ends(point)[1]));
    html! { path class="band" d={ (path(low.chain(high))) "Z" } {} }
}

/// Draws the range that the brackets allow: a step function below the curve and one above.
fn brackets(place: &Place, points: &[Point]) -> Markup {
    let pairs = || points.iter().zip(points.iter().skip(1));
    // A configuration that fails within a bracket may fail at its start or only at its end.
    let low = pairs().flat_map(|(a, b)| [(a.radius, b.band[0]), (b.radius, b.band[0])]);
    let high = pairs().flat_map(|(a, b)| [(a.radius, a.band[1]), (b.radius, a.band[1])]);
    let to_path = |steps: Vec<(f64, f64)>| {
        path(steps.into_iter().map(|(radius, share)| place.point(radius, share)))
    };
    html! {
        path class="bracket" d=(to_path(low.collect())) {}
        path class="bracket" d=(to_path(high.collect())) {}
    }
}

fn legend(top: f64) -> Markup {
    let key = |x: f64, class: &str, label: &str| {
        html! {
            (line(class, [x, top + 4.0], [x + 18.0, top + 4.0]))
            (text(x + 24.0, top + 8.0, "small", label))
        }
    };
    html! {
        (key(LABEL_WIDTH, "curve", "still succeed"))
        (key(LABEL_WIDTH + 150.0, "bracket", "least and most possible"))
        rect class="band" x=(number(LABEL_WIDTH)) y=(number(top + 16.0)) width="18" height="10" {}
        (text(LABEL_WIDTH + 24.0, top + 25.0, "small", "95 % interval"))
        (diamond(LABEL_WIDTH + 159.0, top + 21.0, "open"))
        (text(LABEL_WIDTH + 174.0, top + 25.0, "small", "half still succeed"))
    }
}
