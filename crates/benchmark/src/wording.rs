//! Rewords errors of JSON and TOML parsers for authors of the text: replaces the names of
//! Rust types and keeps the field and the value.

use std::fmt;

#[derive(Clone, Debug, PartialEq, Eq)]
pub struct JsonError {
    problem: String,
    /// Line, from 1, and column, from 1 or, before the first character, 0; `None` if the error
    /// concerns the whole text.
    place: Option<(usize, usize)>,
}

impl JsonError {
    pub fn problem(&self) -> &str {
        &self.problem
    }

    pub fn place(&self) -> Option<(usize, usize)> {
        self.place
    }
}

impl From<serde_json::Error> for JsonError {
    fn from(error: serde_json::Error) -> Self {
        let message = error.to_string();
        let without_place = match message.rfind(" at line ") {
            Some(end) => &message[..end],
            None => &message,
        };
        Self {
            problem: plain_words(without_place),
            place: (error.line() > 0).then(|| (error.line(), error.column())),
        }
    }
}

impl fmt::Display for JsonError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.problem)?;
        match self.place {
            Some((line, column)) => write!(f, " (line {line}, column {column})"),
            None => Ok(()),
        }
    }
}

impl std::error::Error for JsonError {}

/// Rewords a message of a JSON or TOML parser in plain words; returns other messages
/// unchanged.
pub fn plain_words(message: &str) -> String {
    let after = |prefix: &str| message.strip_prefix(prefix);
    if let Some(field) = after("missing field ") {
        return format!("the field {field} is missing");
    }
    if let Some(field) = after("duplicate field ") {
        return format!("the field {field} occurs twice");
    }
    if let Some(rest) = after("unknown field ") {
        return match rest.split_once(", expected ") {
            Some((field, valid)) => {
                format!("there is no field {field}; {}", choice("the field", valid))
            }
            None => format!("there is no field {}", before_comma(rest)),
        };
    }
    if let Some(rest) = after("unknown variant ") {
        return match rest.split_once(", expected ") {
            Some((given, valid)) => format!("{given} is not valid; {}", choice("write", valid)),
            None => format!("{} is not valid", before_comma(rest)),
        };
    }
    for prefix in ["invalid type: ", "invalid value: ", "invalid length "] {
        if let Some((given, expected)) =
            after(prefix).and_then(|rest| rest.split_once(", expected "))
        {
            let count = if prefix == "invalid length " { "length " } else { "" };
            return format!(
                "{count}{} is given where {} is expected",
                value(given),
                kind(expected)
            );
        }
    }
    match message {
        "expected value" | "expected ident" => "a value is missing or malformed".to_owned(),
        message if message.starts_with("EOF while parsing") => "the text ends too early".to_owned(),
        "unexpected end of hex escape" => "an escaped character is incomplete".to_owned(),
        "trailing characters" => "there is text after the end".to_owned(),
        message => message.replace("expected ", "missing here: "),
    }
}

fn before_comma(text: &str) -> &str {
    text.split(',').next().unwrap_or(text)
}

/// Rewords serde's list of valid choices, such as "one of `a`, `b`" or "`a` or `b`", and writes
/// it after `word`.
fn choice(word: &str, valid: &str) -> String {
    match (word, valid.strip_prefix("one of ")) {
        ("write", Some(several)) => format!("write one of {several}"),
        (_, Some(several)) => format!("{word}s are {several}"),
        ("write", None) => format!("write {valid}"),
        (_, None) if valid.contains(" or ") => {
            format!("{word}s are {}", valid.replace(" or ", " and "))
        }
        (_, None) => format!("{word} is {valid}"),
    }
}

/// Rewords serde's description of the value given, which begins with the type of the value: string
/// "x", integer `7`, map or null.
fn value(given: &str) -> String {
    for kind in ["string ", "integer ", "floating point ", "boolean "] {
        if let Some(value) = given.strip_prefix(kind) {
            return value.to_owned();
        }
    }
    match given {
        "map" => "an object".to_owned(),
        "sequence" => "a list".to_owned(),
        other => other.to_owned(),
    }
}

fn kind(expected: &str) -> String {
    match expected {
        "u8" => "a whole number, 0 to 255,".to_owned(),
        "u16" => "a whole number, 0 to 65535,".to_owned(),
        "u32" | "u64" | "usize" => "a whole number, 0 or more,".to_owned(),
        "i8" | "i16" | "i32" | "i64" | "isize" => "a whole number".to_owned(),
        "f32" | "f64" => "a number".to_owned(),
        "a sequence" => "a list".to_owned(),
        "a map" => "an object".to_owned(),
        "a boolean" => "true or false".to_owned(),
        "string or map" => "a name".to_owned(),
        other if other.starts_with("struct ") || other.starts_with("internally tagged") => {
            "an object".to_owned()
        }
        other if other.starts_with("enum ") => "a name".to_owned(),
        other => match other.strip_prefix("an array of length ") {
            Some(count) => format!("a list of {count}"),
            None => other.to_owned(),
        },
    }
}

#[cfg(test)]
mod tests {
    use serde::Deserialize;

    use super::*;

    #[derive(Debug, Deserialize)]
    #[serde(deny_unknown_fields)]
    #[expect(dead_code, reason = "only read")]
    struct Request {
        count: u32,
        kind: Option<Kind>,
        flag: Option<bool>,
        pair: Option<[f64; 2]>,
    }

    #[derive(Debug, Deserialize)]
    #[serde(rename_all = "lowercase")]
    enum Kind {
        Small,
        Big,
        Huge,
    }

    #[test]
    fn errors_of_the_json_parser_are_reworded() {
        let check = |text: &str, expected: &str| {
            let error = serde_json::from_str::<Request>(text).expect_err(text);
            assert_eq!(JsonError::from(error).to_string(), expected, "{text}");
        };
        check("{}", "the field `count` is missing (line 1, column 2)");
        check(
            r#"{"counts": 1}"#,
            "there is no field `counts`; the fields are `count`, `kind`, `flag`, `pair` (line 1, \
             column 9)",
        );
        check(r#"{"count": 1, "count": 1}"#, "the field `count` occurs twice (line 1, column 20)");
        check(
            r#"{"count": -1}"#,
            "`-1` is given where a whole number, 0 or more, is expected (line 1, column 12)",
        );
        check(
            r#"{"count": "x"}"#,
            "\"x\" is given where a whole number, 0 or more, is expected (line 1, column 13)",
        );
        check(
            r#"{"count": 1, "kind": "vast"}"#,
            "`vast` is not valid; write one of `small`, `big`, `huge` (line 1, column 27)",
        );
        check(
            r#"{"count": 1, "flag": 3}"#,
            "`3` is given where true or false is expected (line 1, column 22)",
        );
        check(
            r#"{"count": 1, "pair": [1]}"#,
            "length 1 is given where a list of 2 is expected (line 1, column 24)",
        );
        check("", "the text ends too early (line 1, column 0)");
        check(r#"{"count": 1} x"#, "there is text after the end (line 1, column 14)");
        check("[1", "the text ends too early (line 1, column 2)");
        check("{1}", "key must be a string (line 1, column 2)");
        let half = serde_json::from_str::<Request>(r#"{"\ud800": 1}"#).expect_err("half a pair");
        assert_eq!(JsonError::from(half).problem(), "an escaped character is incomplete");
    }
}
