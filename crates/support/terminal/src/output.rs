//! Output of programs: results on standard output, and a log on standard error.

use std::env::var_os;
use std::error::Error;
use std::ffi::OsString;
use std::io::{self, IsTerminal as _, Write as _};

use tracing_subscriber::EnvFilter;

use crate::printable::printable;

/// Logs to standard error from now on, at this level unless RUST_LOG says
/// otherwise, and in colour just if a terminal shows it and NO_COLOR is not set.
pub fn log(default_level: &str) {
    let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| default_level.into());
    tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(io::stderr)
        // A log on a full disk must not end the program: this would print an
        // error to the same place, and panic.
        .log_internal_errors(false)
        .with_ansi(in_colour(io::stderr().is_terminal(), var_os("NO_COLOR")))
        .with_target(false)
        .init();
}

/// As no-color.org has it: any value but the empty one wants none.
fn in_colour(is_terminal: bool, no_color: Option<OsString>) -> bool {
    is_terminal && no_color.is_none_or(|value| value.is_empty())
}

/// Prints a line to standard output.
///
/// # Errors
/// If it cannot be written; see [`reader_is_gone`].
pub fn print_line(text: &str) -> io::Result<()> {
    print(&format!("{text}\n"))
}

/// Prints to standard output, without what a terminal would obey (see [`printable`]). Unlike
/// `print!` it does not panic when nobody reads it any more.
///
/// # Errors
/// If it cannot be written; see [`reader_is_gone`].
pub fn print(text: &str) -> io::Result<()> {
    let mut stdout = io::stdout().lock();
    stdout.write_all(printable(text).as_bytes())?;
    stdout.flush()
}

/// Moves a terminal's cursor up to the first of these lines and clears what is below. It shows
/// with what is printed next.
///
/// # Errors
/// If it cannot be written; see [`reader_is_gone`].
pub fn clear_lines(count: usize) -> io::Result<()> {
    write!(io::stdout().lock(), "\x1b[{count}A\r\x1b[J")
}

/// Prints a line to standard error, without what a terminal would obey. A log that cannot be
/// written does not matter to what a program does.
pub fn complain(text: &str) {
    let _ = writeln!(io::stderr().lock(), "{}", printable(text));
}

/// Whether what was printed failed because its reader has enough, as with
/// `| head`: then the program ends well, and says nothing.
pub fn reader_is_gone(error: &(dyn Error + 'static)) -> bool {
    let mut cause = Some(error);
    while let Some(error) = cause {
        let kind = error.downcast_ref::<io::Error>().map(io::Error::kind);
        if kind == Some(io::ErrorKind::BrokenPipe) {
            return true;
        }
        cause = error.source();
    }
    false
}

/// A number of things: `1 rollout`, `2 rollouts`.
pub fn counted(count: u64, thing: &str) -> String {
    match count {
        1 => format!("1 {thing}"),
        count => format!("{count} {thing}s"),
    }
}

/// Columns of a terminal.
const WIDTH: usize = 80;

/// Words over as many lines of 80 columns as they need, the first after `prefix`, the
/// others `indent` columns from the left.
pub fn wrapped(prefix: &str, indent: usize, words: &str) -> String {
    let mut text = prefix.to_owned();
    let mut column = prefix.chars().count();
    for word in words.split_whitespace() {
        let width = word.chars().count();
        if column > indent && column + 1 + width > WIDTH {
            text.push('\n');
            text.push_str(&" ".repeat(indent));
            column = indent;
        } else if column > 0 && !text.ends_with(' ') {
            text.push(' ');
            column += 1;
        }
        text.push_str(word);
        column += width;
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn who_wants_no_colour_gets_none() {
        assert!(in_colour(true, None) && in_colour(true, Some("".into())));
        assert!(!in_colour(true, Some("1".into())) && !in_colour(false, None));
    }

    #[test]
    fn words_are_wrapped_at_80_columns_below_their_indent() {
        let words = "seven letters ".repeat(12);
        let text = wrapped("FAIL  it answers:", 6, &words);
        let lines: Vec<&str> = text.lines().collect();
        assert!(lines.len() > 1 && lines.iter().all(|line| line.chars().count() <= 80));
        assert!(lines[0].starts_with("FAIL  it answers: seven"));
        assert!(lines[1..].iter().all(|line| line.starts_with("      ")));
        let again: Vec<&str> = text.split_whitespace().skip(3).collect();
        assert_eq!(again, words.split_whitespace().collect::<Vec<_>>());
        let long = "x".repeat(100);
        assert_eq!(wrapped("", 2, &long), long);
    }

    #[test]
    fn one_thing_is_no_plural() {
        let counts = [0, 1, 2].map(|count| counted(count, "rollout"));
        assert_eq!(counts, ["0 rollouts", "1 rollout", "2 rollouts"]);
    }
}
