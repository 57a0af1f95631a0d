//! Text for a terminal of 80 columns: rows, paragraphs, numbers.

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

/// Formats a rate in percent with one decimal, `87.5`, or `-` for `None`.
pub(crate) fn percent(value: Option<f64>) -> String {
    let text = value.map(|value| format!("{:.1}", 100.0 * value));
    text.unwrap_or_else(|| ABSENT.to_owned())
}

/// Formats a difference in percentage points with two decimals: `+0.25`.
pub(crate) fn points(value: f64) -> String {
    format!("{:+.2}", 100.0 * value)
}

/// Joins parts as a list: `a`, `a and b`, `a, b and c`.
pub(crate) fn listed(parts: &[String]) -> String {
    match parts {
        [] => String::new(),
        [only] => only.clone(),
        [first @ .., last] => format!("{} and {last}", first.join(", ")),
    }
}
