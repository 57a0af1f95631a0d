//! Output of `--json`. docs/JSON.md documents its keys; tests/it/json_keys.rs compares
//! them with the output.

use serde::Serialize;

use super::command::{CommandError, failure, print_line};

pub(super) fn print(answer: &impl Serialize) -> Result<(), CommandError> {
    let text = serde_json::to_string_pretty(answer).map_err(failure)?;
    Ok(print_line(&text)?)
}

/// Prints an answer as JSON if `--json` is given, otherwise as text.
pub(super) fn print_or(
    is_json: bool,
    answer: &impl Serialize,
    text: impl FnOnce() -> String,
) -> Result<(), CommandError> {
    if is_json { print(answer) } else { Ok(print_line(text().trim_end())?) }
}
