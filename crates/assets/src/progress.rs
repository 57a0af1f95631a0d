//! How a fetch is coming on, in one line on standard error.

use std::io::{self, IsTerminal, Write};

/// Cells of the bar.
const CELLS: u64 = 30;
/// Where there is no terminal, a line is printed this often, per cent.
const QUIET_STEP_PERCENT: u64 = 10;

/// How far a fetch is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Progress {
    /// Files that are whole.
    pub files: usize,
    /// Files of the pack.
    pub of_files: usize,
    /// Bytes that are there.
    pub bytes: u64,
    /// Bytes of the pack.
    pub of_bytes: u64,
}

impl Progress {
    fn percent(self) -> u64 {
        (self.bytes * 100).checked_div(self.of_bytes).unwrap_or(100)
    }

    fn line(self) -> String {
        let filled = (self.percent() * CELLS / 100).min(CELLS) as usize;
        format!(
            "[{}{}] {:3} %  {} of {}  {} of {} files",
            "#".repeat(filled),
            ".".repeat(CELLS as usize - filled),
            self.percent(),
            size_in_words(self.bytes),
            size_in_words(self.of_bytes),
            self.files,
            self.of_files
        )
    }
}

/// Draws progress on standard error, and only what has changed: one line where that is a
/// terminal, else a line now and then.
#[derive(Debug)]
pub struct Bar {
    is_terminal: bool,
    last: Option<String>,
}

impl Default for Bar {
    fn default() -> Self {
        Self {
            is_terminal: io::stderr().is_terminal(),
            last: None,
        }
    }
}

impl Bar {
    /// Draws how far it is.
    pub fn show(&mut self, progress: Progress) {
        let (key, text) = if self.is_terminal {
            let line = progress.line();
            (line.clone(), format!("\r{line}  "))
        } else {
            let step = progress.percent() / QUIET_STEP_PERCENT;
            (step.to_string(), format!("{}\n", progress.line()))
        };
        if self.last.as_ref() == Some(&key) {
            return;
        }
        self.last = Some(key);
        // A closed standard error is no reason to stop fetching.
        let _ = io::stderr().lock().write_all(text.as_bytes());
    }

    /// Leaves the line.
    pub fn finish(&self) {
        if self.is_terminal && self.last.is_some() {
            eprintln!();
        }
    }
}

/// A size as people read it.
pub fn size_in_words(bytes: u64) -> String {
    match bytes {
        0..1_000 => format!("{bytes} bytes"),
        1_000..1_000_000 => format!("{:.1} kB", bytes as f64 / 1e3),
        1_000_000..1_000_000_000 => format!("{:.1} MB", bytes as f64 / 1e6),
        _ => format!("{:.2} GB", bytes as f64 / 1e9),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_says_how_far_it_is_and_how_far_it_goes() {
        let half = Progress {
            files: 3,
            of_files: 8,
            bytes: 1_500_000,
            of_bytes: 3_000_000,
        };
        assert_eq!(
            half.line(),
            "[###############...............]  50 %  1.5 MB of 3.0 MB  3 of 8 files"
        );
        let nothing = Progress {
            files: 0,
            of_files: 0,
            bytes: 0,
            of_bytes: 0,
        };
        assert_eq!(nothing.percent(), 100);
    }
}
