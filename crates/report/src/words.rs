//! How numbers are written for people: percent and percentage points with one
//! decimal, a proper minus sign, intervals in brackets.

use std::collections::BTreeSet;

use paired::Interval;

/// A rate, or a loss, in percent: `87.5`, `−0.3`.
pub(crate) fn percent(rate: f64) -> String {
    minus(format!("{:.1}", 100.0 * rate))
}

/// A difference in points: `+0.3`, `−6.0`.
pub(crate) fn points(difference: f64) -> String {
    minus(format!("{:+.1}", 100.0 * difference))
}

/// With a proper minus sign; what rounds to nought has none.
fn minus(text: String) -> String {
    match text.as_str() {
        "-0.0" | "+0.0" => "0.0".to_owned(),
        _ => text.replace('-', "−"),
    }
}

/// ` [9.8, 17.8]`; empty where there is none.
pub(crate) fn rate_interval(interval: Option<Interval>) -> String {
    interval.map_or_else(String::new, |[low, high]| {
        format!(" [{}, {}]", percent(low), percent(high))
    })
}

/// ` [−6.0, +6.5]`; empty where there is none.
pub(crate) fn points_interval(interval: Option<Interval>) -> String {
    interval.map_or_else(String::new, |[low, high]| {
        format!(" [{}, {}]", points(low), points(high))
    })
}

/// `n = 400`, or `n = 396 to 400`.
pub(crate) fn counts(counts: impl IntoIterator<Item = u64>) -> String {
    let counts: BTreeSet<u64> = counts.into_iter().collect();
    match (counts.first(), counts.last()) {
        (Some(low), Some(high)) if low < high => format!("n = {low} to {high}"),
        (Some(n), _) => format!("n = {n}"),
        _ => "n = 0".to_owned(),
    }
}

/// A p-value: `0.003`, `5e-9`.
pub(crate) fn p_value(p: f64) -> String {
    match p < 1e-3 {
        true => format!("{p:.0e}").replace('-', "−"),
        false => format!("{p:.3}"),
    }
}

/// How a condition is called beside its peers.
pub(crate) fn condition(condition: protocol::Condition) -> &'static str {
    match condition {
        protocol::Condition::Clean => "nominal",
        protocol::Condition::Combination => "all at once",
        single => single.name(),
    }
}
