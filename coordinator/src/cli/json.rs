//! Output of `--json`. The schema is documented in docs/JSON.md, and a test compares the two.

use serde::Serialize;

use super::command::{CommandError, failure, print_line};

/// Declares structs of the output with their conversions from messages, so that each key is written
/// once.
macro_rules! forms {
    ($($name:ident from $value:ident: $from:ty {
        $($key:ident: $type:ty = $expression:expr,)*
    })*) => {$(
        #[derive(Serialize)]
        pub(super) struct $name {
            $($key: $type,)*
        }

        impl $name {
            pub(super) fn from_message($value: &$from) -> $name {
                $name { $($key: $expression,)* }
            }
        }
    )*};
}
pub(super) use forms;

/// Prints an answer as indented JSON.
pub(super) fn print(answer: &impl Serialize) -> Result<(), CommandError> {
    let text = serde_json::to_string_pretty(answer).map_err(failure)?;
    Ok(print_line(&text)?)
}
