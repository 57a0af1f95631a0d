//! Timing for benchmarks: clocks, and summaries of measurements.

use std::fmt;

use rustix::time::{ClockId, clock_gettime};

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Clock {
    /// CPU time of the calling thread, hardly affected by other programs. Only for work that
    /// runs entirely on that thread.
    ThreadCpu,
    Wall,
}

/// Describes the clock in a report.
impl fmt::Display for Clock {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::ThreadCpu => "milliseconds of processor time of the drawing thread, medians",
            Self::Wall => {
                "milliseconds of wall clock, medians: a graphics card renders, so that processor \
                 time is meaningless; keep the machine free of other work"
            }
        })
    }
}

impl Clock {
    pub fn name(self) -> &'static str {
        match self {
            Self::ThreadCpu => "processor time of the thread",
            Self::Wall => "wall clock",
        }
    }

    /// Returns the milliseconds since an arbitrary origin.
    pub fn now_millis(self) -> f64 {
        let clock = match self {
            Self::ThreadCpu => ClockId::ThreadCPUTime,
            Self::Wall => ClockId::Monotonic,
        };
        let time = clock_gettime(clock);
        time.tv_sec as f64 * 1e3 + time.tv_nsec as f64 / 1e6
    }

    pub fn time<T>(self, work: impl FnOnce() -> T) -> (f64, T) {
        let start = self.now_millis();
        let result = work();
        (self.now_millis() - start, result)
    }
}

/// Median and range of several measurements.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Spread {
    /// Median; for an even number, the mean of the two in the middle.
    pub median: f64,
    pub least: f64,
    pub most: f64,
}

impl Spread {
    /// Summarises measurements in any order; `None` without a measurement.
    pub fn from_values(values: &[f64]) -> Option<Self> {
        let mut values = values.to_vec();
        values.sort_by(f64::total_cmp);
        let (least, most) = (*values.first()?, *values.last()?);
        let (below, above) = (values[(values.len() - 1) / 2], values[values.len() / 2]);
        Some(Self { median: (below + above) / 2.0, least, most })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_spread_has_the_median_the_least_and_the_most() {
        let spread = Spread::from_values(&[3.0, 1.0, 7.0]).unwrap();
        assert_eq!((spread.median, spread.least, spread.most), (3.0, 1.0, 7.0));
        assert_eq!(Spread::from_values(&[4.0, 1.0, 2.0, 9.0]).unwrap().median, 3.0);
        assert_eq!(Spread::from_values(&[]), None);
    }

    #[test]
    fn sleep_takes_time_and_no_processor() {
        let pause = || std::thread::sleep(std::time::Duration::from_millis(60));
        assert!(Clock::Wall.time(pause).0 >= 60.0);
        assert!(Clock::ThreadCpu.time(pause).0 < 30.0);
    }

    #[test]
    fn work_takes_processor_time() {
        let work = || (0..20_000_000_u64).map(std::hint::black_box).sum::<u64>();
        assert!(Clock::ThreadCpu.time(work).0 > 0.5);
    }
}
