//! Number formats for people: percent and percentage points with one decimal, a
//! typographic minus sign, intervals in brackets.

use std::collections::BTreeSet;

use paired::adaptive::radii::{Curve, HalfSuccess, Point};
use paired::{Interval, NoInterval};

/// Formats a rate or a loss in percent: `87.5`, `−0.3`.
pub(crate) fn percent(rate: f64) -> String {
    minus(format!("{:.1}", 100.0 * rate))
}

/// Formats a number of control steps: `113.5`, `−4.0`.
pub(crate) fn steps(steps: f64) -> String {
    minus(format!("{steps:.1}"))
}

/// Formats a difference in percentage points: `+0.3`, `−6.0`.
pub(crate) fn points(difference: f64) -> String {
    minus(format!("{:+.1}", 100.0 * difference))
}

/// Replaces hyphens by minus signs and drops the sign of zero.
fn minus(text: String) -> String {
    match text.as_str() {
        "-0.0" | "+0.0" => "0.0".to_owned(),
        _ => text.replace('-', "−"),
    }
}

/// Replaces the hyphens before a sentence's numbers by minus signs.
pub(crate) fn minus_signs(sentence: &str) -> String {
    sentence.replace(" -", " −").replace("(-", "(−")
}

/// Formats the interval of a rate, ` [9.8, 17.8]`, or the reason why there is none,
/// ` (too few tasks)`.
pub(crate) fn rate_interval(interval: Option<Interval>, reason: Option<NoInterval>) -> String {
    interval_of(percent, interval, reason)
}

/// Formats the interval of a difference, ` [−6.0, +6.5]`, or the reason why there is none,
/// ` (too few tasks)`.
pub(crate) fn points_interval(interval: Option<Interval>, reason: Option<NoInterval>) -> String {
    interval_of(points, interval, reason)
}

fn interval_of(
    number: fn(f64) -> String,
    interval: Option<Interval>,
    reason: Option<NoInterval>,
) -> String {
    match (interval, reason) {
        (Some([low, high]), _) => format!(" [{}, {}]", number(low), number(high)),
        (None, Some(reason)) => format!(" ({reason})"),
        (None, None) => String::new(),
    }
}

/// Formats the range of several counts: `n = 400`, or `n = 396 to 400`.
pub(crate) fn counts(counts: impl IntoIterator<Item = u64>) -> String {
    let counts: BTreeSet<u64> = counts.into_iter().collect();
    match (counts.first(), counts.last()) {
        (Some(low), Some(high)) if low < high => format!("n = {low} to {high}"),
        (Some(n), _) => format!("n = {n}"),
        _ => "n = 0".to_owned(),
    }
}

/// Formats a p-value: `0.003`, `5e−9`.
pub(crate) fn p_value(p: f64) -> String {
    match p < 1e-3 {
        true => format!("{p:.0e}").replace('-', "−"),
        false => format!("{p:.3}"),
    }
}

/// Formats the radius at which half of the configurations still succeed: `4.25`; `2 to 4` if
/// success is known at these radii only; `> 16`; or `none` if fewer than half succeed nominally, or
/// there is no configuration.
pub(crate) fn half_success(curve: &Curve) -> String {
    let share = |point: Option<&Point>| point.map_or(0.0, |point| point.survival);
    match (curve.half_success.radius, curve.half_success.bounds) {
        (Some(radius), _) => format!("{radius:.2}"),
        _ if share(curve.points.first()) < 0.5 => "none".to_owned(),
        (None, Some([low, high])) if share(curve.points.last()) <= 0.5 => {
            format!("{low} to {high}")
        }
        _ => format!("> {}", curve.largest_radius),
    }
}

/// Formats the interval of a half-success radius, or the reason why there is none.
pub(crate) fn half_success_interval(half: &HalfSuccess) -> String {
    match (half.ci95, half.no_interval) {
        (Some([low, high]), _) => format!("[{low:.2}, {high:.2}]"),
        (None, Some(reason)) => reason.name().to_owned(),
        (None, None) => String::new(),
    }
}
