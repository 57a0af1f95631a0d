//! Output of `--json`. The schema is documented in docs/JSON.md, and a test compares the two.

use serde::Serialize;

use super::command::{CommandError, failure, print_line};

pub(super) fn print(answer: &impl Serialize) -> Result<(), CommandError> {
    let text = serde_json::to_string_pretty(answer).map_err(failure)?;
    Ok(print_line(&text)?)
}
