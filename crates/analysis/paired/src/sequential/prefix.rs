//! Reorder buffer: releases units, which complete in any order, in the drawn order.

use std::collections::BTreeMap;
use std::fmt;

use crate::sequential::order::{Drawn, Order};

/// Error: the unit is not in the drawn order.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("outcome of {unit}: the unit is not in the drawn order of {units} configurations")]
pub struct NotInOrder {
    /// The unit given.
    pub unit: String,
    /// Number of units in the order.
    pub units: usize,
}

/// Values of units, released up to the first gap in the drawn order.
#[derive(Clone, Debug)]
pub(crate) struct Prefix<U, V> {
    order: Vec<Drawn<U>>,
    /// Position of each unit in the order.
    positions: BTreeMap<U, usize>,
    values: Vec<Option<V>>,
    /// Number of released units.
    used: usize,
    /// Number of units with a value.
    stored: usize,
}

impl<U: Ord + Clone + fmt::Debug, V: Copy> Prefix<U, V> {
    pub(crate) fn new(order: &Order<U>) -> Self {
        let order: Vec<Drawn<U>> = order.rounds().iter().flatten().cloned().collect();
        let positions = order.iter().enumerate();
        Self {
            positions: positions.map(|(i, drawn)| (drawn.unit.clone(), i)).collect(),
            values: vec![None; order.len()],
            order,
            used: 0,
            stored: 0,
        }
    }

    /// Stores the value of a unit. Later values for the same unit are ignored.
    pub(crate) fn store(&mut self, unit: &U, value: V) -> Result<(), NotInOrder> {
        let position = self
            .positions
            .get(unit)
            .ok_or_else(|| NotInOrder { unit: format!("{unit:?}"), units: self.order.len() })?;
        let slot = &mut self.values[*position];
        if slot.is_none() {
            *slot = Some(value);
            self.stored += 1;
        }
        Ok(())
    }

    /// Releases the next unit of the drawn order: its stratum and value; `None` if it has no value
    /// yet.
    pub(crate) fn next(&mut self) -> Option<(usize, V)> {
        let value = (*self.values.get(self.used)?)?;
        self.used += 1;
        Some((self.order[self.used - 1].stratum, value))
    }

    /// Returns the number of released units.
    pub(crate) fn used(&self) -> usize {
        self.used
    }

    /// Returns the number of units with a value that wait for an earlier unit.
    pub(crate) fn waiting(&self) -> usize {
        self.stored - self.used
    }

    /// Returns the number of units in the order.
    pub(crate) fn units(&self) -> usize {
        self.order.len()
    }
}
