//! Verdicts on the points of an examination.

use std::fmt;
use std::time::Duration;

/// Largest absolute value of an action that a worker clips without harm; a larger value means that
/// the policy answers in other units.
const LARGEST_PLAUSIBLE: f64 = 2.0;

#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Verdict {
    Pass {
        /// Remark on the result; may be empty.
        note: String,
    },
    Fail {
        reason: String,
    },
    Skip {
        reason: String,
    },
}

impl Verdict {
    /// Returns the name and the remark or reason.
    pub(crate) fn parts(&self) -> (&'static str, &str) {
        match self {
            Verdict::Pass { note } => ("pass", note),
            Verdict::Fail { reason } => ("fail", reason),
            Verdict::Skip { reason } => ("skip", reason),
        }
    }

    pub fn has_failed(&self) -> bool {
        matches!(self, Verdict::Fail { .. })
    }
}

pub(crate) fn pass(note: impl Into<String>) -> Verdict {
    Verdict::Pass { note: note.into() }
}

pub(crate) fn fail(reason: impl Into<String>) -> Verdict {
    Verdict::Fail { reason: reason.into() }
}

pub(crate) fn skip(reason: impl Into<String>) -> Verdict {
    Verdict::Skip { reason: reason.into() }
}

/// Verdict on a point of the conformance check or of the diagnosis.
#[derive(Clone, Debug)]
pub struct Finding<P> {
    pub point: P,
    pub verdict: Verdict,
}

impl<P: fmt::Display> fmt::Display for Finding<P> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (word, text) = self.verdict.parts();
        let word = if self.verdict.has_failed() { "FAIL" } else { word };
        let separator = if text.is_empty() { "" } else { ": " };
        write!(f, "{word}  {}{separator}{text}", self.point)
    }
}

/// Defines the points of an examination, in the order of the checks, each with a sentence that is
/// true of a sound server.
macro_rules! points {
    ($($(#[$note:meta])* $point:ident $sentence:literal,)*) => {
        #[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
        #[serde(rename_all = "lowercase")]
        pub enum Point {
            $($(#[$note])* $point,)*
        }

        impl Point {
            pub const ALL: &[Point] = &[$(Point::$point,)*];
        }

        impl std::fmt::Display for Point {
            fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                f.write_str(match self {
                    $(Point::$point => $sentence,)*
                })
            }
        }
    };
}
pub(crate) use points;

/// Checks that the numbers of actions are in the simulator's units.
pub(crate) fn range(numbers: &[f64]) -> Verdict {
    let largest = numbers.iter().fold(0.0, |largest: f64, number| largest.max(number.abs()));
    let beyond = numbers.iter().filter(|number| number.abs() > 1.0).count();
    let found = format!("{beyond} of {} numbers lie beyond it, up to {largest:.2}", numbers.len());
    if largest <= 1.0 {
        pass("")
    } else if largest <= LARGEST_PLAUSIBLE {
        pass(format!("{found}: workers clip and count them"))
    } else {
        fail(format!(
            "{found}. Usually the actions are not un-normalised, or are un-normalised with \
             another data set's statistics: compare the files that the server loads with those \
             that its authors' evaluation loads."
        ))
    }
}

/// Returns the smallest duration that this percentage of the sorted durations do not exceed.
pub(crate) fn percentile(sorted: &[Duration], percent: usize) -> Duration {
    let rank = (sorted.len() * percent).div_ceil(100).max(1);
    sorted.get(rank - 1).copied().unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_just_beyond_one_pass_and_implausible_values_fail() {
        assert_eq!(range(&[-1.0, 1.0]), pass(""));
        assert_eq!(
            range(&[-1.02, 0.5]),
            pass("1 of 2 numbers lie beyond it, up to 1.02: workers clip and count them")
        );
        let (name, reason) = (range(&[1e9]), "not un-normalised");
        assert!(name.has_failed() && name.parts().1.contains(reason), "{name:?}");
    }

    #[test]
    fn percentiles_are_those_of_the_sorted_sample() {
        let sorted: Vec<_> = (1..=100).map(Duration::from_millis).collect();
        assert_eq!(
            [50, 99, 100].map(|percent| percentile(&sorted, percent).as_millis()),
            [50, 99, 100]
        );
        assert_eq!(percentile(&[], 50), Duration::ZERO);
    }
}
