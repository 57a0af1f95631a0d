//! Progress output: one line per step, with its title and its result.

use std::fmt::Display;
use std::io::{IsTerminal, Write};
use std::time::Instant;

use anyhow::Result;

/// Width of the column with the title.
const WIDTH: usize = 34;

/// Runs a step, and prints its title, its result in a few words, and its duration.
pub(crate) fn step<T: Display>(title: &str, work: impl FnOnce() -> Result<T>) -> Result<T> {
    let mut out = std::io::stdout();
    // A terminal shows the title while the step runs.
    if out.is_terminal() {
        let _ = write!(out, "  {title:<WIDTH$} …");
        let _ = out.flush();
    }
    let start = Instant::now();
    let outcome = work();
    let begin = if out.is_terminal() { "\r" } else { "" };
    match &outcome {
        Ok(result) => {
            let secs = start.elapsed().as_secs();
            let time = if secs > 0 { format!(" ({secs} s)") } else { String::new() };
            println!("{begin}  {title:<WIDTH$} {result}{time}");
        }
        Err(_) => println!("{begin}  {title:<WIDTH$} failed"),
    }
    outcome
}
