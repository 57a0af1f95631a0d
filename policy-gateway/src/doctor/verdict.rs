//! Verdicts on the points of a check, as pure functions of a server's answers.

use std::fmt;
use std::time::Duration;

use proto::policy::InferResponse;
use tonic::Status;
use transport::status_text;

use crate::doctor::check::Point;

/// Largest difference between the actions for a query in a batch and for the same query alone.
/// Kernels for other batch sizes sum in another order, which changes low-order bits.
pub(crate) const BATCH_TOLERANCE: f32 = 1e-3;
/// Largest absolute value of an action that a worker clips without harm; a larger value means that
/// the policy answers in other units.
const LARGEST_PLAUSIBLE: f64 = 2.0;

#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Verdict {
    Pass {
        /// Remark on the result; may be empty.
        note: String,
    },
    Warn {
        reason: String,
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
            Verdict::Warn { reason } => ("warn", reason),
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

#[derive(Clone, Debug)]
pub struct Finding {
    pub point: Point,
    pub verdict: Verdict,
}

impl Finding {
    pub fn is_warning(&self) -> bool {
        matches!(self.verdict, Verdict::Warn { .. })
    }
}

impl fmt::Display for Finding {
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
fn range_of(numbers: &[f64]) -> Verdict {
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

pub(crate) fn refused(status: &Status) -> Verdict {
    fail(format!("the server refused: {}", status_text(status)))
}

/// Checks the shape of every answer of an episode, in order of query index.
pub(crate) fn shapes(answers: &[InferResponse], horizon: u32) -> Verdict {
    let faults = answers.iter().enumerate();
    let mut faults = faults.filter_map(|(query, answer)| {
        Some((query, proto::checks::actions(answer, horizon).err()?))
    });
    match faults.next() {
        Some((query, fault)) => fail(format!("at query {query}, {fault}")),
        None => pass(""),
    }
}

pub(crate) fn range(answers: &[InferResponse]) -> Verdict {
    range_of(&numbers(answers).map(f64::from).collect::<Vec<_>>())
}

pub(crate) fn same(expected: &[InferResponse], found: &[InferResponse]) -> Verdict {
    match first_difference(expected, found) {
        None => pass(""),
        Some(query) => fail(format!("at query {query} the actions differ")),
    }
}

/// Checks that answers depend on the seed just as the policy declares.
pub(crate) fn seeds(
    stochastic: bool,
    seed_1: &[InferResponse],
    seed_2: &[InferResponse],
) -> Verdict {
    match (stochastic, first_difference(seed_1, seed_2)) {
        (true, Some(_)) | (false, None) => pass(""),
        (true, None) => {
            fail("it declares itself stochastic, but seeds 1 and 2 give the same actions")
        }
        (false, Some(query)) => fail(format!(
            "it declares itself deterministic, but seeds 1 and 2 differ at query {query}"
        )),
    }
}

pub(crate) fn batch(alone: &[InferResponse], batched: &[InferResponse]) -> Verdict {
    if first_difference(alone, batched).is_none() {
        return pass("bit for bit");
    }
    let is_comparable = alone.len() == batched.len()
        && alone.iter().zip(batched).all(|(a, b)| a.actions.len() == b.actions.len());
    let differences = numbers(alone).zip(numbers(batched)).map(|(a, b)| (a - b).abs());
    // `total_cmp` counts NaN as the largest number; `f32::max` would ignore it.
    let largest = differences.max_by(f32::total_cmp).unwrap_or_default();
    if is_comparable && largest <= BATCH_TOLERANCE {
        pass(format!("except by up to {largest:e}: actions depend on the batch in low-order bits"))
    } else {
        fail(format!("in a batch the actions differ by up to {largest}"))
    }
}

/// Reports the latencies of single queries, and those of `concurrency` concurrent episodes with a
/// total time of `wall`.
pub(crate) fn speed(
    alone: &[Duration],
    concurrency: u32,
    wall: Duration,
    concurrent: &[Duration],
) -> Verdict {
    pass(format!(
        "one by one {}; {concurrency} episodes at once {}, {:.0} queries/s",
        percentiles(alone),
        percentiles(concurrent),
        concurrent.len() as f64 / wall.as_secs_f64(),
    ))
}

fn numbers(answers: &[InferResponse]) -> impl Iterator<Item = f32> {
    answers.iter().flat_map(|answer| answer.actions.iter().copied())
}

fn first_difference(first: &[InferResponse], second: &[InferResponse]) -> Option<usize> {
    let bits = |answer: &InferResponse| -> Vec<u32> {
        answer.actions.iter().map(|number| number.to_bits()).collect()
    };
    let pairs = first.iter().zip(second);
    let differing = pairs.clone().position(|(a, b)| bits(a) != bits(b));
    differing.or((first.len() != second.len()).then_some(pairs.len()))
}

fn percentiles(latencies: &[Duration]) -> String {
    let mut sorted = latencies.to_vec();
    sorted.sort_unstable();
    let ms = |percent| percentile(&sorted, percent).as_secs_f64() * 1e3;
    format!("p50 {:.2} ms, p99 {:.2} ms", ms(50), ms(99))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_just_beyond_one_pass_and_implausible_values_fail() {
        assert_eq!(range_of(&[-1.0, 1.0]), pass(""));
        assert_eq!(
            range_of(&[-1.02, 0.5]),
            pass("1 of 2 numbers lie beyond it, up to 1.02: workers clip and count them")
        );
        let (name, reason) = (range_of(&[1e9]), "not un-normalised");
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

    fn answers(numbers: &[f32]) -> Vec<InferResponse> {
        let answer = |&number| InferResponse { actions: vec![number; 7], action_width: 7 };
        numbers.iter().map(answer).collect()
    }

    fn fails(verdict: &Verdict, expected: &str) -> bool {
        matches!(verdict, Verdict::Fail { reason } if reason.contains(expected))
    }

    #[test]
    fn a_difference_is_reported_with_its_query_even_between_zeros() {
        assert_eq!(same(&answers(&[1.0, 0.0]), &answers(&[1.0, 0.0])), pass(""));
        assert!(fails(&same(&answers(&[1.0, 0.0]), &answers(&[1.0, -0.0])), "query 1"));
        assert!(fails(&same(&answers(&[1.0, 0.0]), &answers(&[1.0])), "query 1"));
    }

    #[test]
    fn a_batch_may_change_only_low_order_bits() {
        let alone = answers(&[0.5]);
        assert_eq!(batch(&alone, &alone), pass("bit for bit"));
        let moved = batch(&alone, &answers(&[0.500_01]));
        assert!(matches!(moved, Verdict::Pass { note } if note.contains("low-order bits")));
        assert!(fails(&batch(&alone, &answers(&[0.6])), "differ by up to"));
        assert!(fails(&batch(&alone, &answers(&[f32::NAN])), "by up to NaN"));
        assert!(fails(&batch(&alone, &[]), "differ"));
    }
}
