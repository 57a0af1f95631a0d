//! Time limit of a job in Slurm's format.

use std::fmt;
use std::str::FromStr;

/// Time limit of a job, such as `4:00:00`; keeps the text as it was given.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct TimeLimit {
    text: String,
    /// `None` if unlimited.
    secs: Option<u64>,
}

impl TimeLimit {
    /// Returns the limit in seconds; `None` if unlimited.
    pub(super) fn secs(&self) -> Option<u64> {
        self.secs
    }
}

impl fmt::Display for TimeLimit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.text)
    }
}

impl FromStr for TimeLimit {
    type Err = &'static str;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let limit = |secs| TimeLimit { text: text.to_owned(), secs };
        if text.eq_ignore_ascii_case("unlimited") {
            return Ok(limit(None));
        }
        let secs = seconds(text).filter(|secs| *secs > 0);
        let remedy = "write a time limit in Slurm's format: minutes (90), hours:minutes:seconds \
                      (4:00:00), days-hours (2-12), or unlimited";
        secs.map(|secs| limit(Some(secs))).ok_or(remedy)
    }
}

/// Parses `m`, `m:s`, `h:m:s`, `d-h`, `d-h:m` or `d-h:m:s` into seconds.
fn seconds(text: &str) -> Option<u64> {
    let (days, rest) = match text.split_once('-') {
        Some((days, rest)) => (Some(number(days)?), rest),
        None => (None, text),
    };
    let parts: Option<Vec<u64>> = rest.split(':').map(number).collect();
    let (h, m, s) = match (days, parts?.as_slice()) {
        (None, [m]) => (0, *m, 0),
        (None, [m, s]) => (0, *m, *s),
        (Some(_), [h]) => (*h, 0, 0),
        (Some(_), [h, m]) => (*h, *m, 0),
        (_, [h, m, s]) => (*h, *m, *s),
        _ => return None,
    };
    Some(((days.unwrap_or(0) * 24 + h) * 60 + m) * 60 + s)
}

/// Parses at most six digits, so that the sum of seconds cannot overflow.
fn number(text: &str) -> Option<u64> {
    let digits = (1..=6).contains(&text.len()) && text.bytes().all(|byte| byte.is_ascii_digit());
    digits.then(|| text.parse().ok()).flatten()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn time_limits_are_parsed_in_slurms_formats() {
        let secs = |text: &str| text.parse::<TimeLimit>().map(|limit| limit.secs());
        for (text, expected) in [
            ("90", 5_400),
            ("1:30", 90),
            ("4:00:00", 14_400),
            ("2-12", 216_000),
            ("1-0:30", 88_200),
            ("1-00:00:01", 86_401),
        ] {
            assert_eq!(secs(text), Ok(Some(expected)), "{text}");
        }
        assert_eq!(secs("UNLIMITED"), Ok(None));
        for invalid in ["", "0", "4h", "1:2:3:4", "-1", "1-", "1-1:1:1:1", "9999999"] {
            assert!(secs(invalid).is_err(), "{invalid}");
        }
    }
}
