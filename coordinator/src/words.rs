//! Formatting of durations, instants, rates and sizes, for terminal and page alike.

use queue::clock::UnixMillis;
use time::OffsetDateTime;

/// Formats a rate per second, minute or hour, in the shortest of these units in which it is at
/// least one: `2.1/s`, `25.2/min`.
pub fn rate_text(per_sec: f64) -> String {
    if per_sec >= 1.0 {
        format!("{per_sec:.1}/s")
    } else if per_sec * 60.0 >= 1.0 {
        format!("{:.1}/min", per_sec * 60.0)
    } else {
        format!("{:.1}/h", per_sec * 3600.0)
    }
}

/// Formats a duration in its two largest units: `42s`, `4m28s`, `3h05m`, `2d01h`.
pub fn duration_text(secs: f64) -> String {
    let secs = secs.round() as u64;
    match (secs / 86_400, secs / 3_600 % 24, secs / 60 % 60, secs % 60) {
        (0, 0, 0, s) => format!("{s}s"),
        (0, 0, m, s) => format!("{m}m{s:02}s"),
        (0, h, m, _) => format!("{h}h{m:02}m"),
        (d, h, _, _) => format!("{d}d{h:02}h"),
    }
}

/// Formats an instant to the second: `2026-11-21 15:36:09 UTC`; beyond the year 9999, in
/// milliseconds since 1970.
pub fn utc_text(at: UnixMillis) -> String {
    match OffsetDateTime::from_unix_timestamp(at.0.div_euclid(1_000)) {
        Ok(instant) => {
            let (h, m, s) = instant.to_hms();
            format!("{} {h:02}:{m:02}:{s:02} UTC", instant.date())
        }
        Err(_) => format!("{} ms", at.0),
    }
}

pub fn runs_on(pack: &str, mujoco: &str, renderer: &str, look: &str, program: &str) -> String {
    format!("{pack}, MuJoCo {mujoco}, {renderer}, look {look}, program {program}")
}

/// Formats a size in binary units: `812 B`, `3.4 MiB`.
pub fn size_text(bytes: u64) -> String {
    let units = ["KiB", "MiB", "GiB", "TiB"];
    let mut size = bytes as f64 / 1024.0;
    if size < 1.0 {
        return format!("{bytes} B");
    }
    let mut unit = 0;
    while size >= 1024.0 && unit + 1 < units.len() {
        size /= 1024.0;
        unit += 1;
    }
    format!("{size:.1} {}", units[unit])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_formatted_in_suitable_units() {
        assert_eq!(rate_text(2.1), "2.1/s");
        assert_eq!(rate_text(0.42), "25.2/min");
        assert_eq!(rate_text(0.001), "3.6/h");
        let spans = [42.0, 268.0, 11_100.0, 176_400.0].map(duration_text);
        assert_eq!(spans, ["42s", "4m28s", "3h05m", "2d01h"]);
        let instants =
            [0, 951_827_696_000, 1_795_275_369_999, -1].map(|ms| utc_text(UnixMillis(ms)));
        let texts = [
            "1970-01-01 00:00:00 UTC",
            "2000-02-29 12:34:56 UTC",
            "2026-11-21 15:36:09 UTC",
            "1969-12-31 23:59:59 UTC",
        ];
        assert_eq!(instants, texts);
        let sizes = [812, 3_565_158, u64::MAX].map(size_text);
        assert_eq!(sizes, ["812 B", "3.4 MiB", "16777216.0 TiB"]);
    }
}
