//! Output of programs: results on standard output, and a log on standard error.

use std::env::var_os;
use std::error::Error;
use std::ffi::OsString;
use std::io::{self, IsTerminal as _, Write as _};

use tracing_subscriber::EnvFilter;

use crate::printable::printable;

/// Starts logging to standard error, at this level unless RUST_LOG is set, and in colour only if
/// standard error is a terminal and NO_COLOR is not set.
pub fn log(default_level: &str) {
    let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| default_level.into());
    tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(io::stderr)
        // Otherwise, if the log is on a full disk, the subscriber would print its error to the same
        // log, and panic.
        .log_internal_errors(false)
        .with_ansi(in_colour(io::stderr().is_terminal(), var_os("NO_COLOR")))
        .with_target(false)
        .init();
}

/// Follows no-color.org: any non-empty value disables colour.
fn in_colour(is_terminal: bool, no_color: Option<OsString>) -> bool {
    is_terminal && no_color.is_none_or(|value| value.is_empty())
}

pub fn print_line(text: &str) -> io::Result<()> {
    print(&format!("{text}\n"))
}

/// Prints to standard output, without terminal control sequences (see [`printable`]). Unlike
/// `print!`, this function does not panic when the pipe is closed.
pub fn print(text: &str) -> io::Result<()> {
    let mut stdout = io::stdout().lock();
    stdout.write_all(printable(text).as_bytes())?;
    stdout.flush()
}

/// Moves the terminal's cursor up by `count` lines and clears everything below. Takes effect with
/// the next output.
pub fn clear_lines(count: usize) -> io::Result<()> {
    write!(io::stdout().lock(), "\x1b[{count}A\r\x1b[J")
}

/// Prints a line to standard error, without terminal control sequences. Errors are ignored.
pub fn complain(text: &str) {
    let _ = writeln!(io::stderr().lock(), "{}", printable(text));
}

/// Returns true if printing failed because the pipe is closed, as with `| head`. The program then
/// exits successfully without a message.
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

/// Formats a count with its noun: `1 rollout`, `2 rollouts`.
pub fn counted(count: u64, noun: &str) -> String {
    match count {
        1 => format!("1 {noun}"),
        count => format!("{count} {noun}s"),
    }
}

/// Width of the output, columns.
const WIDTH: usize = 80;

/// Wraps words into lines of at most 80 columns, or of one longer word. The first line starts with
/// `prefix`, the others with `indent` spaces.
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
    fn no_color_disables_colour() {
        assert!(in_colour(true, None) && in_colour(true, Some("".into())));
        assert!(!in_colour(true, Some("1".into())) && !in_colour(false, None));
    }

    #[test]
    fn text_is_wrapped_at_80_columns_and_indented_from_the_second_line_on() {
        let words = "seven letters ".repeat(12);
        let text = wrapped("FAIL  it answers:", 6, &words);
        let lines: Vec<&str> = text.lines().collect();
        assert!(lines.len() > 1 && lines.iter().all(|line| line.chars().count() <= 80));
        assert!(lines[0].starts_with("FAIL  it answers: seven"));
        assert!(lines[1..].iter().all(|line| line.starts_with("      ")));
        let wrapped_words: Vec<&str> = text.split_whitespace().skip(3).collect();
        assert_eq!(wrapped_words, words.split_whitespace().collect::<Vec<_>>());
        let long = "x".repeat(100);
        assert_eq!(wrapped("", 2, &long), long);
    }

    #[test]
    fn a_count_of_one_is_singular() {
        let counts = [0, 1, 2].map(|count| counted(count, "rollout"));
        assert_eq!(counts, ["0 rollouts", "1 rollout", "2 rollouts"]);
    }
}
