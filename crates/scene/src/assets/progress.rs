//! Progress of a fetch, as a line on standard error.

use std::fmt;
use std::io::{self, IsTerminal, Write};
use std::time::{Duration, Instant};

const CELLS: u64 = 24;
/// Interval of progress lines without a terminal, per cent.
const QUIET_STEP_PERCENT: u64 = 10;
const RATE_DELAY: Duration = Duration::from_secs(1);

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Report {
    WaitingForAnotherFetch,
    Arriving(Progress),
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Progress {
    pub files: usize,
    pub of_files: usize,
    pub bytes: u64,
    pub of_bytes: u64,
}

impl Progress {
    pub fn percent(self) -> u64 {
        (self.bytes * 100).checked_div(self.of_bytes).unwrap_or(100)
    }

    fn line(self) -> String {
        let filled = (self.percent() * CELLS / 100).min(CELLS) as usize;
        format!(
            "[{}{}] {:3} %  {self}",
            "#".repeat(filled),
            ".".repeat(CELLS as usize - filled),
            self.percent(),
        )
    }

    /// `None` if too little has arrived for a rate, or all bytes have arrived.
    fn pace(self, first: Self, elapsed: Duration) -> Option<String> {
        let rate = (self.bytes - first.bytes.min(self.bytes)) as f64 / elapsed.as_secs_f64();
        if elapsed < RATE_DELAY || rate < 1.0 || self.bytes >= self.of_bytes {
            return None;
        }
        let remaining_secs = ((self.of_bytes - self.bytes) as f64 / rate).ceil() as u64;
        let remaining = match remaining_secs {
            0..60 => format!("{remaining_secs} s"),
            _ => format!("{} min {} s", remaining_secs / 60, remaining_secs % 60),
        };
        Some(format!("{}/s, {remaining} left", size_in_words(rate as u64)))
    }
}

impl fmt::Display for Progress {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "{} of {}, {} of {} files",
            size_in_words(self.bytes),
            size_in_words(self.of_bytes),
            self.files,
            self.of_files
        )
    }
}

/// Displays changed reports on standard error: as one updated line on a terminal, otherwise as
/// occasional lines.
#[derive(Debug)]
pub struct Bar {
    is_terminal: bool,
    /// Key of the last displayed line; see [`Bar::progress_line`].
    last: Option<String>,
    first: Option<(Progress, Instant)>,
    width: usize,
}

impl Default for Bar {
    fn default() -> Self {
        Self { is_terminal: io::stderr().is_terminal(), last: None, first: None, width: 0 }
    }
}

impl Bar {
    pub fn show(&mut self, report: Report) {
        let (key, line) = match report {
            Report::WaitingForAnotherFetch => {
                let line = "waiting for another process that fetches into the same folder";
                (line.to_owned(), line.to_owned())
            }
            Report::Arriving(progress) => self.progress_line(progress),
        };
        if self.last.as_ref() == Some(&key) {
            return;
        }
        self.last = Some(key);
        let text = if self.is_terminal {
            let width = self.width.max(line.len());
            self.width = line.len();
            format!("\r{line:width$}")
        } else {
            format!("{line}\n")
        };
        // A closed standard error must not stop the fetch.
        let _ = io::stderr().lock().write_all(text.as_bytes());
    }

    /// Returns a key that changes when a new line is due, and the line.
    fn progress_line(&mut self, progress: Progress) -> (String, String) {
        let (first, since) = *self.first.get_or_insert((progress, Instant::now()));
        let pace = progress.pace(first, since.elapsed());
        let pace = pace.map_or_else(String::new, |pace| format!("  {pace}"));
        let line = format!("{}{pace}", progress.line());
        match self.is_terminal {
            true => (line.clone(), line),
            false => {
                let step = progress.percent() / QUIET_STEP_PERCENT;
                let is_complete = progress.files == progress.of_files;
                (format!("{step} {is_complete}"), line)
            }
        }
    }

    pub fn finish(&self) {
        if self.is_terminal && self.last.is_some() {
            eprintln!();
        }
    }
}

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
    fn line_has_amount_rate_and_remaining_time() {
        let half = Progress { files: 3, of_files: 8, bytes: 1_500_000, of_bytes: 3_000_000 };
        assert_eq!(half.line(), "[############............]  50 %  1.5 MB of 3.0 MB, 3 of 8 files");
        let first = Progress { bytes: 500_000, ..half };
        let pace = |secs| half.pace(first, Duration::from_secs(secs));
        assert_eq!(pace(2).as_deref(), Some("500.0 kB/s, 3 s left"));
        assert_eq!(pace(100).as_deref(), Some("10.0 kB/s, 2 min 30 s left"));
        assert_eq!(pace(0), None);
        let nothing = Progress { files: 0, of_files: 0, bytes: 0, of_bytes: 0 };
        assert_eq!(nothing.percent(), 100);
    }
}
