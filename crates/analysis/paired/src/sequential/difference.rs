//! The confidence sequence of two policies' difference.

use std::fmt;

use libero_ctrl::Measure;

use crate::outcomes::Outcome;
use crate::sequential::look::Look;
use crate::sequential::order::Order;
use crate::sequential::prefix::NotInOrder;
use crate::sequential::together::Together;

/// The confidence sequence of success rate A − success rate B over the same
/// rollouts: those of one condition at one level, in strata of tasks.
///
/// Rollouts may be given in any order, and are used in the drawn order, as
/// [`SequentialMeasures`](crate::SequentialMeasures) uses configurations.
#[derive(Clone, Debug)]
pub struct SequentialDifference<U>(Together<U, 1>);

impl<U: Ord + Clone + fmt::Debug> SequentialDifference<U> {
    /// Before the first rollout. The interval holds at all looks with a
    /// probability of at least 1 − `alpha`; the protocol's is 0.05.
    ///
    /// # Panics
    /// If `alpha` is not between 0 and 1, or the order has no unit.
    pub fn new(order: &Order<U>, alpha: f64) -> Self {
        let measures = [(Measure::Difference, [-1, 1])];
        Self(Together::new(order, measures, alpha))
    }

    /// Takes a rollout's outcomes under A and under B. While one of them is
    /// missing, nothing is taken. Where one is in quarantine, the interval holds
    /// whichever it would have been. The first outcomes of a rollout count.
    ///
    /// # Errors
    /// If the rollout is not in the order.
    pub fn complete(&mut self, unit: &U, a: Outcome, b: Outcome) -> Result<(), NotInOrder> {
        let (Some(a), Some(b)) = (a.possible_successes(), b.possible_successes()) else {
            return Ok(());
        };
        self.0.complete(unit, [[a[0] - b[1], a[1] - b[0]]])
    }

    /// The interval now.
    pub fn look(&self) -> Look {
        self.0.look()
    }
}
