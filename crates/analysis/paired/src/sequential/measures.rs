//! Confidence sequences of one policy's measures.

use std::fmt;

use libero_ctrl::Measure;

use crate::outcomes::Transition;
use crate::sequential::look::Look;
use crate::sequential::order::Order;
use crate::sequential::prefix::NotInOrder;
use crate::sequential::simultaneous::SimultaneousSequences;

/// Confidence sequences of `S_sim`, `R_e`, `R_c`, `R_d` and `I` over the
/// configurations of one level.
///
/// Configurations may be added as they complete, in any order. They are used in
/// the drawn order, up to the first incomplete one; later configurations wait. A successful
/// rollout ends sooner than a rollout that runs out of steps, so that the configurations
/// that happen to be complete are biased towards success.
#[derive(Clone, Debug)]
pub struct SequentialMeasures<U>(SimultaneousSequences<U, 5>);

impl<U: Ord + Clone + fmt::Debug> SequentialMeasures<U> {
    /// Creates the sequences before the first configuration. The five intervals hold
    /// simultaneously, at all looks, with a probability of at least 1 − `alpha`; the
    /// protocol's `alpha` is 0.05.
    ///
    /// # Panics
    /// If `alpha` is not between 0 and 1, or the order has no unit.
    pub fn new(order: &Order<U>, alpha: f64) -> Self {
        let measures =
            Measure::OF_ONE_POLICY.map(|measure| (measure, values(measure, &Transition::ALL)));
        Self(SimultaneousSequences::new(order, measures, alpha))
    }

    /// Adds a complete configuration with its possible transitions: exactly one, or several
    /// if a rollout is quarantined and its outcome will never be known
    /// ([`Matched::possible_transitions`]). The intervals are then valid for each of them.
    /// Only the first call for a configuration counts.
    ///
    /// # Errors
    /// If the configuration is not in the order.
    ///
    /// # Panics
    /// If no transition is possible.
    ///
    /// [`Matched::possible_transitions`]: crate::Matched::possible_transitions
    pub fn complete(&mut self, unit: &U, possible: &[Transition]) -> Result<(), NotInOrder> {
        let ranges = Measure::OF_ONE_POLICY.map(|measure| values(measure, possible));
        self.0.complete(unit, ranges)
    }

    /// Returns the current intervals.
    pub fn look(&self) -> Look {
        self.0.look()
    }
}

/// Returns the value of a measure for one configuration; the measure is the mean of the values.
pub(crate) fn value(measure: Measure, transition: Transition) -> i64 {
    let indicator = |other: Transition| i64::from(transition == other);
    let [emergent, compensated] = [Transition::Emergent, Transition::Compensated].map(indicator);
    match measure {
        Measure::SSim => indicator(Transition::StillSucceeds) + compensated,
        Measure::RE => emergent,
        Measure::RC => compensated,
        Measure::RD => emergent + compensated,
        Measure::I => compensated - emergent,
        Measure::Difference => unreachable!("a measure of one policy"),
    }
}

/// Returns the least and greatest value of a measure over some transitions.
pub(crate) fn values(measure: Measure, transitions: &[Transition]) -> [i64; 2] {
    let values = || {
        let transitions = transitions.iter();
        transitions.map(|&transition| value(measure, transition))
    };
    let ends = values().min().zip(values().max());
    let (least, greatest) = ends.expect("some transition is possible");
    [least, greatest]
}
