//! Equivalence test: shows that two rates differ by less than a margin, which a merely
//! non-significant difference does not.

use crate::inference::estimate::Estimate;
use crate::inference::student_t::upper_tail;

/// Largest difference that counts as equivalent, a fraction: 5 points, the tolerance of the
/// reproduction gate.
pub const EQUIVALENCE_MARGIN: f64 = 0.05;

/// Returns the p-value of the two one-sided tests (TOST) that a difference lies beyond
/// ±[`EQUIVALENCE_MARGIN`], for new tasks: the greater of P(T > (Δ + v)/s) and
/// P(T > (Δ − v)/s), with Δ the margin, v the difference, s its standard error and T of Student's
/// t distribution. `None` without a standard error.
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
