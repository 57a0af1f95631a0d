//! Equivalence: two rates certainly differ by less than a margin. A difference that is not
//! significant says only that the data are too few.

use crate::inference::estimate::Estimate;
use crate::inference::student_t::upper_tail;

/// Differences of less than this are said to be none, a fraction: 5 points, as the
/// reproduction gate tolerates.
pub const EQUIVALENCE_MARGIN: f64 = 0.05;

/// p-value of the two one-sided tests that a difference lies beyond
/// ±[`EQUIVALENCE_MARGIN`], for new tasks: the greater of P(T > (Δ + v)/s) and
/// P(T > (Δ − v)/s). Absent without a standard error.
///
/// Source: D. J. Schuirmann, A comparison of the two one-sided tests procedure and the
/// power approach for assessing the equivalence of average bioavailability, Journal of
/// Pharmacokinetics and Biopharmaceutics 15 (1987), 657–680.
pub fn equivalence_p(difference: &Estimate) -> Option<f64> {
    let (error, df) = (difference.standard_error?, difference.df?);
    let tail = |distance: f64| upper_tail(distance / error, df);
    let value = difference.value;
    Some(tail(EQUIVALENCE_MARGIN + value).max(tail(EQUIVALENCE_MARGIN - value)))
}
