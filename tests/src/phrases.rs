//! Phrases that no message of this project may contain: raw library errors, which do not help
//! readers, and artefacts of sentences assembled from parts.

/// Phrases of libraries, in lower case.
const LIBRARY_PHRASES: [&str; 33] = [
    "h2 protocol error",
    "http2 error",
    "transport error",
    "tcp connect error",
    "operation was canceled",
    "error trying to connect",
    "client error (connect)",
    "dns error",
    "invalid peer certificate",
    "unknownissuer",
    "corrupt message",
    "grpc-status header",
    "deadline has elapsed",
    "requested entity was not found",
    "currently unavailable",
    "was not authenticated",
    "not implemented or not supported",
    "invalid digit found in string",
    "number too large to fit",
    "number too small to fit",
    "invalid float literal",
    "cannot parse integer",
    "non-zero type",
    "unknown variant",
    "unknown field",
    "missing field",
    "duplicate field",
    "invalid type:",
    "invalid value:",
    "toml parse error",
    "provided string was not `true` or `false`",
    "some(",
    "invalid socket address syntax",
];

/// Artefacts of sentences assembled from parts, in lower case.
const ASSEMBLY_ARTEFACTS: [&str; 5] = ["failed to failed", "failed to cannot", "``", ": :", "; ;"];

/// Returns the fault of a message, if it has one: a listed phrase, an error number without a
/// description, a range in Rust syntax, a repeated word, or nothing after "failed to".
pub fn raw_phrase(message: &str) -> Option<String> {
    let lower = message.to_lowercase();
    let raw = LIBRARY_PHRASES.into_iter().chain(ASSEMBLY_ARTEFACTS);
    if let Some(phrase) = raw.into_iter().find(|phrase| lower.contains(phrase)) {
        return Some(phrase.to_owned());
    }
    if message.trim().is_empty() || message.trim_end().ends_with("failed to") {
        return Some("nothing".to_owned());
    }
    if let Some(place) = bare_system_error(&lower).or_else(|| bare_range(&lower)) {
        return Some(place);
    }
    doubled_word(&lower)
}

/// Finds an error number such as "os error 2" without the system's description.
fn bare_system_error(lower: &str) -> Option<String> {
    let at = lower.find("os error")?;
    let before = lower[..at].trim_end_matches(['(', ' ']);
    let has_words = before.ends_with(char::is_alphabetic);
    (!has_words).then(|| lower[at..].to_owned())
}

/// Finds a range in Rust syntax, such as in "10 is not in 0..10".
fn bare_range(lower: &str) -> Option<String> {
    let at = lower.find("is not in ")?;
    let range = lower[at..].split_whitespace().nth(3)?;
    range.contains("..").then(|| lower[at..].to_owned())
}

/// Finds a repeated word. "That that" can be correct.
fn doubled_word(lower: &str) -> Option<String> {
    let words: Vec<&str> = lower.split_whitespace().collect();
    let pair = words.windows(2).find(|pair| {
        pair[0] == pair[1] && pair[0].chars().all(char::is_alphabetic) && pair[0] != "that"
    });
    pair.map(|pair| pair.join(" "))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn raw_phrases_are_found_and_good_messages_are_not() {
        for raw in [
            "failed to ",
            "failed to operation was canceled",
            "error: failed to failed to read it",
            "read the the file",
            "describe policy `` at grpc://h:1",
            "open it: (os error 2)",
            "10 is not in 0..10",
        ] {
            assert!(raw_phrase(raw).is_some(), "{raw}");
        }
        for plain in [
            "failed to read a.json: No such file or directory (os error 2)",
            "reach the coordinator at http://h:1: nothing listens there; start it",
        ] {
            assert_eq!(raw_phrase(plain), None, "{plain}");
        }
    }
}
