use std::borrow::Cow;

/// Replaces control characters other than line feeds and tabs, and Unicode's bidirectional
/// embeddings, overrides and isolates, by `\u{fffd}`.
///
/// An error of a policy or worker, or text from a foreign archive, could contain escape sequences
/// that set the clipboard, change the window title, or overwrite the line above.
pub fn printable(text: &str) -> Cow<'_, str> {
    match text.contains(is_control_mark) {
        true => Cow::Owned(text.replace(is_control_mark, "\u{fffd}")),
        false => Cow::Borrowed(text),
    }
}

fn is_control_mark(character: char) -> bool {
    match character {
        '\n' | '\t' => false,
        // Embeddings, overrides and isolates of Unicode's bidirectional algorithm.
        '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}' => true,
        // C0, DEL, and C1, whose U+009B begins sequences as ESC [ does.
        other => other.is_control(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn control_characters_are_replaced() {
        for (given, expected) in [
            ("\x1b]52;c;cm0gLXJm\x07", "\u{fffd}]52;c;cm0gLXJm\u{fffd}"),
            ("\x1b[2K\rpassed", "\u{fffd}[2K\u{fffd}passed"),
            ("\u{9b}31m", "\u{fffd}31m"),
            ("a\u{202e}cod.exe", "a\u{fffd}cod.exe"),
            ("\x7f\0\x08", "\u{fffd}\u{fffd}\u{fffd}"),
        ] {
            assert_eq!(printable(given), expected, "{given:?}");
        }
    }

    #[test]
    fn text_in_any_language_is_unchanged() {
        let text = "π₀.₅ nimmt\tdie Schüssel\nund 碗 und وعاء";
        assert!(matches!(printable(text), Cow::Borrowed(same) if same == text));
    }
}
