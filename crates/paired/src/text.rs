//! Words of sentences: numbers and lists.

/// Mark of an absent value.
pub(crate) const ABSENT: &str = "-";

/// Formats a rate in percent with one decimal, `87.5`, or `-` for `None`.
pub(crate) fn percent(value: Option<f64>) -> String {
    let text = value.map(|value| format!("{:.1}", 100.0 * value));
    text.unwrap_or_else(|| ABSENT.to_owned())
}

/// Formats a difference in percentage points with one decimal: `+0.3`.
pub(crate) fn points(value: f64) -> String {
    format!("{:+.1}", 100.0 * value)
}

/// Joins parts as a list: `a`, `a and b`, `a, b and c`.
pub(crate) fn listed(parts: &[String]) -> String {
    match parts {
        [] => String::new(),
        [only] => only.clone(),
        [first @ .., last] => format!("{} and {last}", first.join(", ")),
    }
}
