//! Verdicts of the conformance check, as pure functions of a server's answers.

use std::time::Duration;

use proto::checks::DescriptionFault;
use proto::policy::{DescribeResponse, InferResponse};
use tonic::Status;
use transport::status_text;

use crate::doctor::verdict::{self, Verdict, fail, pass};

/// Largest difference between the actions for a query in a batch and for the same query alone.
/// Kernels for other batch sizes sum in another order, which changes low-order bits.
pub(crate) const BATCH_TOLERANCE: f32 = 1e-3;

pub(crate) fn refused(status: &Status) -> Verdict {
    fail(format!("the server refused: {}", status_text(status)))
}

pub(crate) fn description(
    described: &DescribeResponse,
    checked: Result<(), DescriptionFault>,
) -> Verdict {
    match checked {
        Ok(()) => pass(format!(
            "{:?}, checkpoint {:?}, horizon {}, execute {}",
            described.name, described.checkpoint, described.horizon, described.execute
        )),
        Err(fault) => fail(fault.to_string()),
    }
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
    verdict::range(&numbers(answers).map(f64::from).collect::<Vec<_>>())
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
    let ms = |percent| verdict::percentile(&sorted, percent).as_secs_f64() * 1e3;
    format!("p50 {:.2} ms, p99 {:.2} ms", ms(50), ms(99))
}

#[cfg(test)]
mod tests {
    use super::*;

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
    fn answers_must_depend_on_the_seed_as_declared() {
        let (one, other) = (answers(&[0.1]), answers(&[0.2]));
        assert_eq!(seeds(true, &one, &other), pass(""));
        assert_eq!(seeds(false, &one, &one), pass(""));
        assert!(fails(&seeds(true, &one, &one), "declares itself stochastic"));
        assert!(fails(&seeds(false, &one, &other), "declares itself deterministic"));
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
