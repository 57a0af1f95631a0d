//! Text for a terminal of 80 columns: rows, paragraphs, numbers.

use std::fmt::Write;

use crate::bootstrap::Interval;
use crate::interval::NoInterval;

/// Columns of the terminal.
pub(crate) const WIDTH: usize = 80;

/// Mark of an absent value.
pub(crate) const ABSENT: &str = "-";

/// Appends words wrapped to the terminal's width: the first line after `prefix`, all further
/// lines indented to align with the first.
pub fn push_wrapped(text: &mut String, prefix: &str, words: &str) {
    let indent = " ".repeat(prefix.chars().count());
    let mut line = prefix.to_owned();
    let mut is_empty = true;
    for word in words.split_whitespace() {
        let needed = line.chars().count() + usize::from(!is_empty) + word.chars().count();
        if !is_empty && needed > WIDTH {
            text.push_str(&line);
            text.push('\n');
            line.clone_from(&indent);
            is_empty = true;
        }
        if !is_empty {
            line.push(' ');
        }
        line.push_str(word);
        is_empty = false;
    }
    text.push_str(&line);
    text.push('\n');
}

/// Starts a block: appends an empty line unless the text is empty or ends with one.
pub(crate) fn separate(text: &mut String) {
    if !text.is_empty() && !text.ends_with("\n\n") {
        text.push('\n');
    }
}

/// Appends a row: a label, and values right-aligned in columns of the same width.
pub(crate) fn push_row<T: AsRef<str>>(
    text: &mut String,
    label_width: usize,
    column_width: usize,
    label: &str,
    values: impl Iterator<Item = T>,
) {
    let mut row = format!("{label:<label_width$}");
    for value in values {
        let _ = write!(row, "{:>column_width$}", value.as_ref());
    }
    text.push_str(row.trim_end());
    text.push('\n');
}

/// Appends a table whose first row holds the heads. Every other row has as many values as there are
/// heads, or none; each column is as wide as its widest cell.
pub(crate) fn push_columns(text: &mut String, rows: &[(String, Vec<String>)]) {
    let width = |cell: &String| cell.chars().count();
    let label = rows.iter().map(|(label, _)| width(label)).max();
    let label = label.unwrap_or_default();
    let columns = rows.first().map_or(0, |(_, values)| values.len());
    let column_width = |column: usize| {
        let cells = rows.iter().filter_map(|(_, values)| values.get(column));
        cells.map(width).max().unwrap_or_default()
    };
    let widths: Vec<usize> = (0..columns).map(column_width).collect();
    let needed = label + widths.iter().sum::<usize>();
    // Uses a wider gap if the table still fits.
    let gap = match needed + 2 * columns <= WIDTH {
        true => 2,
        false => 1,
    };
    for (name, values) in rows {
        let mut row = format!("{name:<label$}");
        for (value, width) in values.iter().zip(&widths) {
            let _ = write!(row, "{value:>width$}", width = width + gap);
        }
        text.push_str(row.trim_end());
        text.push('\n');
    }
}

/// Appends the entries of a legend: each symbol with its meaning beside it.
pub(crate) fn push_legend(text: &mut String, entries: &[(&str, String)]) {
    let widths = entries.iter().map(|(symbol, _)| symbol.chars().count());
    let width = widths.max().unwrap_or_default();
    for (symbol, meaning) in entries {
        push_wrapped(text, &format!("{symbol:<width$}  "), meaning);
    }
}

/// Formats a rate in percent with two decimals: `87.50`.
pub(crate) fn rate(value: f64) -> String {
    format!("{:.2}", 100.0 * value)
}

/// Formats a rate in percent with one decimal, `87.5`, or `-` for `None`.
pub(crate) fn percent(value: Option<f64>) -> String {
    let text = value.map(|value| format!("{:.1}", 100.0 * value));
    text.unwrap_or_else(|| ABSENT.to_owned())
}

/// Formats a difference in percentage points with two decimals: `+0.25`.
pub(crate) fn points(value: f64) -> String {
    format!("{:+.2}", 100.0 * value)
}

/// Formats an interval of rates, or the reason why it is absent.
pub(crate) fn rate_interval(interval: Option<Interval>, reason: Option<NoInterval>) -> String {
    format_interval(rate, interval, reason)
}

/// Formats an interval of differences, or the reason why it is absent.
pub(crate) fn points_interval(interval: Option<Interval>, reason: Option<NoInterval>) -> String {
    format_interval(points, interval, reason)
}

fn format_interval(
    number: fn(f64) -> String,
    interval: Option<Interval>,
    reason: Option<NoInterval>,
) -> String {
    match (interval, reason) {
        (Some([low, high]), _) => format!("[{}, {}]", number(low), number(high)),
        (None, Some(reason)) => reason.to_string(),
        (None, None) => ABSENT.to_owned(),
    }
}

/// Formats a p-value: `0.003`, `5.1e-9`.
pub(crate) fn p_value(p: f64) -> String {
    match p < 1e-3 {
        true => format!("{p:.1e}"),
        false => format!("{p:.3}"),
    }
}

/// Joins parts as a list: `a`, `a and b`, `a, b and c`.
pub(crate) fn listed(parts: &[String]) -> String {
    match parts {
        [] => String::new(),
        [only] => only.clone(),
        [first @ .., last] => format!("{} and {last}", first.join(", ")),
    }
}
