//! Simultaneous confidence sequences of several measures of the same units.

use std::fmt;

use libero_ctrl::Measure;

use crate::sequential::look::{Look, RateInterval};
use crate::sequential::order::Order;
use crate::sequential::prefix::{NotInOrder, Prefix};
use crate::sequential::sequence::ConfidenceSequence;

/// Confidence sequences of `N` measures, which hold simultaneously, at all looks, with
/// a probability of at least 1 − α.
#[derive(Clone, Debug)]
pub(crate) struct SimultaneousSequences<U, const N: usize> {
    prefix: Prefix<U, [[i64; 2]; N]>,
    /// Number of units after which each round ends.
    round_ends: Vec<usize>,
    sequences: [(Measure, ConfidenceSequence); N],
}

impl<U: Ord + Clone + fmt::Debug, const N: usize> SimultaneousSequences<U, N> {
    /// Creates the sequences; each measure comes with the range of a unit's values. The sequences
    /// share α equally (Bonferroni).
    pub(crate) fn new(order: &Order<U>, measures: [(Measure, [i64; 2]); N], alpha: f64) -> Self {
        assert!(alpha > 0.0 && alpha < 1.0, "α is between 0 and 1");
        assert!(!order.sizes().is_empty(), "the order has units");
        let mut end = 0;
        let rounds = order.rounds().iter();
        let round_ends = rounds.map(|round| {
            end += round.len();
            end
        });
        let sequence = |range| ConfidenceSequence::new(order.sizes(), range, alpha / N as f64);
        Self {
            prefix: Prefix::new(order),
            round_ends: round_ends.collect(),
            sequences: measures.map(|(measure, range)| (measure, sequence(range))),
        }
    }

    /// Adds a unit with the range of its value for each measure.
    pub(crate) fn complete(&mut self, unit: &U, values: [[i64; 2]; N]) -> Result<(), NotInOrder> {
        self.prefix.store(unit, values)?;
        while let Some((stratum, values)) = self.prefix.next() {
            let ends_round = self.round_ends.binary_search(&self.prefix.used()).is_ok();
            for ((_, sequence), value) in self.sequences.iter_mut().zip(values) {
                sequence.draw(stratum, value);
                if ends_round {
                    sequence.end_round();
                }
            }
        }
        Ok(())
    }

    pub(crate) fn look(&self) -> Look {
        let units = self.prefix.units();
        let interval = |sequence: &ConfidenceSequence| {
            let [least, greatest] = sequence.totals();
            RateInterval { least, greatest, units: units as u64 }
        };
        let sequences = self.sequences.iter();
        Look {
            used: self.prefix.used(),
            waiting: self.prefix.waiting(),
            units,
            intervals: sequences
                .map(|(measure, sequence)| (*measure, interval(sequence)))
                .collect(),
        }
    }
}
