//! Shortens texts of policy servers to one line for messages and the log. Pure function.

/// Length limit of a server's text in a message, bytes: as much as a coordinator stores of an
/// error.
pub const MAX_SHORTENED_BYTES: usize = 4_096;
const CUT: &str = " …";

/// Returns a text in one line of at most [`MAX_SHORTENED_BYTES`]. A line feed in a server's text
/// could forge a line of the log.
pub fn shorten(text: &str) -> String {
    let mut joined = String::new();
    let lines = text.lines().flat_map(|line| line.split('\r')).map(str::trim);
    for line in lines.filter(|line| !line.is_empty()) {
        if !joined.is_empty() {
            joined.push_str(" | ");
        }
        joined.push_str(line);
        if joined.len() > MAX_SHORTENED_BYTES {
            let mut ends = (0..=MAX_SHORTENED_BYTES - CUT.len()).rev();
            let end = ends.find(|end| joined.is_char_boundary(*end));
            joined.truncate(end.unwrap_or_default());
            joined.push_str(CUT);
            break;
        }
    }
    joined
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_shortened_text_is_one_line_of_bounded_length() {
        assert_eq!(shorten("no"), "no");
        let traceback = "Traceback:\n  line 1\r\n\nValueError: no\n";
        assert_eq!(shorten(traceback), "Traceback: | line 1 | ValueError: no");
        assert_eq!(shorten("a\r2026 INFO b"), "a | 2026 INFO b");
        for letter in ["x", "ü", "碗"] {
            let long = shorten(&letter.repeat(1 << 20));
            assert!(long.len() <= MAX_SHORTENED_BYTES && long.ends_with(CUT));
            assert!(long.len() > MAX_SHORTENED_BYTES - 8);
        }
        let lines = shorten(&"x\n".repeat(1 << 20));
        assert!(lines.len() <= MAX_SHORTENED_BYTES);
    }
}
