//! The confidence sequence of two policies' difference.

use std::fmt;

use libero_ctrl::Measure;

use crate::outcomes::Outcome;
use crate::sequential::look::Look;
use crate::sequential::order::Order;
use crate::sequential::prefix::NotInOrder;
use crate::sequential::simultaneous::SimultaneousSequences;

/// The confidence sequence of success rate A − success rate B over the same
/// rollouts: those of one condition at one level, in the strata of the drawn order.
///
/// Rollouts may complete in any order and are used in the drawn order, like the
/// configurations of [`SequentialMeasures`](crate::SequentialMeasures).
#[derive(Clone, Debug)]
pub struct SequentialDifference<U>(SimultaneousSequences<U, 1>);

impl<U: Ord + Clone + fmt::Debug> SequentialDifference<U> {
    /// Creates the sequence before the first rollout. The interval holds at all looks with a
    /// probability of at least 1 − `alpha`; the protocol's `alpha` is 0.05.
    ///
    /// # Panics
    /// If `alpha` is not between 0 and 1, or the order has no unit.
    pub fn new(order: &Order<U>, alpha: f64) -> Self {
        let measures = [(Measure::Difference, [-1, 1])];
        Self(SimultaneousSequences::new(order, measures, alpha))
    }

    /// Adds a rollout's outcomes under A and under B; ignored while either is missing. If an
    /// outcome is quarantined, the interval is valid whether it is a success or a failure. Only the
    /// first outcomes given for a rollout count.
    ///
    /// # Errors
    /// If the rollout is not in the order.
    pub fn complete(&mut self, unit: &U, a: Outcome, b: Outcome) -> Result<(), NotInOrder> {
        let (Some(a), Some(b)) = (a.possible_successes(), b.possible_successes()) else {
            return Ok(());
        };
        self.0.complete(unit, [[a[0] - b[1], a[1] - b[0]]])
    }

    /// Returns the current interval.
    pub fn look(&self) -> Look {
        self.0.look()
    }
}
