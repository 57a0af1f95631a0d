//! Plot of the hand's motion in a rollout: its path from above, and its height over the control
//! steps. All rollouts of a configuration share one scale, and the nominal rollout's path is drawn
//! beneath the path of every other rollout.

use benchmark::attempt::Motion;
use maud::{Markup, html};

/// Positions of the hand, after settling and then after every control step of the policy: x, y, z
/// in the world frame, m.
pub(super) type Path = Vec<[f64; 3]>;

/// Unit of a stored position, m.
const UNIT_M: f64 = 1e-4;
/// Size of the plot in SVG user units, CSS pixels when unscaled.
const WIDTH: f64 = 248.0;
const HEIGHT: f64 = 136.0;
/// Side of the square that shows the path from above.
const VIEW_SIDE: f64 = 104.0;
/// Top of the drawings, below their headings.
const TOP: f64 = 16.0;
/// Left edge of the drawing of the height.
const LEFT: f64 = 138.0;
/// Length that the scale bar shows, m.
const SCALE_BAR_M: f64 = 0.1;
/// Least extent of a scale, m, so that the jitter of a resting hand is not magnified.
const MIN_EXTENT_M: f64 = 0.1;

/// The scale that several paths share.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Extent {
    /// Least and greatest x, y and z, m.
    low: [f64; 3],
    high: [f64; 3],
    /// Control steps of the longest path.
    steps: usize,
}

/// Converts a stored motion to positions in metres.
pub(super) fn read(motion: &Motion) -> Path {
    let metres = |position: [i16; 3]| position.map(|units| f64::from(units) * UNIT_M);
    motion.path().into_iter().map(metres).collect()
}

impl Extent {
    /// Returns the extent of several paths; `None` if all are empty.
    pub(super) fn from_paths<'a>(paths: impl Iterator<Item = &'a Path>) -> Option<Extent> {
        let mut extent: Option<Extent> = None;
        for path in paths {
            for position in path {
                let extent =
                    extent.get_or_insert(Extent { low: *position, high: *position, steps: 0 });
                for (axis, value) in position.iter().enumerate() {
                    extent.low[axis] = extent.low[axis].min(*value);
                    extent.high[axis] = extent.high[axis].max(*value);
                }
                extent.steps = extent.steps.max(path.len() - 1);
            }
        }
        extent
    }

    /// Returns the scale of the view from above, user units per metre.
    fn scale(&self) -> f64 {
        let [x, y] = [0, 1].map(|axis| self.high[axis] - self.low[axis]);
        VIEW_SIDE / x.max(y).max(MIN_EXTENT_M)
    }

    /// Projects a position to the view from above, the robot at the top: world x points down, y to
    /// the right.
    fn project_from_above(&self, [x, y, _]: [f64; 3]) -> [f64; 2] {
        let scale = self.scale();
        let middle = |axis: usize| f64::midpoint(self.low[axis], self.high[axis]);
        let half = VIEW_SIDE / 2.0;
        [2.0 + half + (y - middle(1)) * scale, TOP + half + (x - middle(0)) * scale]
    }

    /// Projects a height at a control step to the drawing of the height.
    fn project_height(&self, step: usize, z: f64) -> [f64; 2] {
        let across = step as f64 / self.steps.max(1) as f64;
        let span = (self.high[2] - self.low[2]).max(MIN_EXTENT_M);
        [
            LEFT + across * (WIDTH - LEFT - 4.0),
            TOP + VIEW_SIDE - (z - self.low[2]) / span * VIEW_SIDE,
        ]
    }
}

/// Renders the plot of a path, with the path of the nominal rollout, if given, beneath it.
pub(super) fn plot(path: &Path, nominal: Option<&Path>, extent: &Extent) -> Markup {
    let (above, height) = polylines(path, extent);
    let nominal_lines = nominal.map(|nominal| polylines(nominal, extent));
    let begin = path.first().map(|first| extent.project_from_above(*first));
    let end = path.last().map(|last| extent.project_from_above(*last));
    let bar = SCALE_BAR_M * extent.scale();
    let base = TOP + VIEW_SIDE + 12.0;
    html! {
        svg.panel.trace role="img" viewBox={ "0 0 " (WIDTH) " " (HEIGHT) } {
            title { (description(path)) }
            text.tiny.muted x="2" y="9" { "hand from above" }
            text.tiny.muted x=(LEFT) y="9" { "height" }
            line.grid x1=(LEFT) x2=(WIDTH - 4.0) y1=(TOP + VIEW_SIDE) y2=(TOP + VIEW_SIDE) {}
            @if let Some((above, height)) = &nominal_lines {
                polyline.under points=(above) {}
                polyline.under points=(height) {}
            }
            polyline.path points=(above) {}
            polyline.path points=(height) {}
            @if let Some([x, y]) = begin { circle.open cx=(px(x)) cy=(px(y)) r="3" {} }
            @if let Some([x, y]) = end { circle.mark cx=(px(x)) cy=(px(y)) r="3.5" {} }
            line.zero x1="2" x2=(px(2.0 + bar)) y1=(px(base - 4.0)) y2=(px(base - 4.0)) {}
            text.tiny.muted x=(px(8.0 + bar)) y=(px(base)) { "10 cm" }
            text.tiny.muted.end x=(WIDTH - 4.0) y=(px(base)) { (extent.steps) " steps" }
        }
    }
}

/// Returns the SVG points of a path's view from above and of its height.
fn polylines(path: &Path, extent: &Extent) -> (String, String) {
    let point = |[x, y]: [f64; 2]| format!("{},{}", px(x), px(y));
    let above = path.iter().map(|position| point(extent.project_from_above(*position)));
    let heights = path.iter().enumerate();
    let heights = heights.map(|(step, [_, _, z])| point(extent.project_height(step, *z)));
    (above.collect::<Vec<_>>().join(" "), heights.collect::<Vec<_>>().join(" "))
}

/// Describes the plot for screen readers.
fn description(path: &Path) -> String {
    let centimetres = |[x, y, z]: &[f64; 3]| {
        let [x, y, z] = [x, y, z].map(|metres| format!("{:.1}", 100.0 * metres).replace('-', "−"));
        format!("x {x}, y {y}, z {z} cm")
    };
    let length: f64 = path.windows(2).map(|pair| distance(pair[0], pair[1])).sum();
    match (path.first(), path.last()) {
        (Some(first), Some(last)) => format!(
            "The hand moves from {} to {} in {} control steps, on a path of {:.0} cm",
            centimetres(first),
            centimetres(last),
            path.len() - 1,
            100.0 * length
        ),
        _ => "The hand's path is empty".to_owned(),
    }
}

fn distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    (0..3).map(|i| (a[i] - b[i]).powi(2)).sum::<f64>().sqrt()
}

/// Formats a coordinate with one decimal.
fn px(value: f64) -> String {
    format!("{value:.1}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stored_paths_are_converted_to_metres() {
        let path = read(&Motion::pack(&[[-1_000, 20, 10_000], [0, 0, 12_345]], &[]));
        let expected = [[-0.1, 0.002, 1.0], [0.0, 0.0, 1.2345]];
        assert_eq!(path.len(), 2);
        for (found, expected) in path.iter().flatten().zip(expected.iter().flatten()) {
            assert!((found - expected).abs() < 1e-12, "{found}");
        }
    }

    #[test]
    fn every_path_stays_within_its_plot() {
        let paths = [
            read(&Motion::pack(
                &[[-3_000, 3_000, 8_000], [2_500, -1_000, 13_000], [0, 0, 9_000]],
                &[],
            )),
            read(&Motion::pack(&[[0, 0, 10_000]], &[])),
        ];
        let extent = Extent::from_paths(paths.iter()).expect("positions");
        assert_eq!(extent.steps, 2);
        for path in &paths {
            for (step, position) in path.iter().enumerate() {
                let within = |range: [f64; 2], value: f64| {
                    // A position on an edge may exceed it by a rounding error.
                    assert!(range[0] - 1e-6 <= value && value <= range[1] + 1e-6, "{value}");
                };
                let [x, y] = extent.project_from_above(*position);
                within([2.0, 2.0 + VIEW_SIDE], x);
                within([TOP, TOP + VIEW_SIDE], y);
                let [x, y] = extent.project_height(step, position[2]);
                within([LEFT, WIDTH], x);
                within([TOP, TOP + VIEW_SIDE], y);
            }
        }
        assert!(Extent::from_paths([Path::new()].iter()).is_none());
        let words = description(&paths[0]);
        assert!(words.contains("2 control steps") && words.contains("x −30.0"), "{words}");
    }
}
