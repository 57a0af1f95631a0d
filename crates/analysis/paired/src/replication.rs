//! Comparison of further replicates with the first: the same configurations and realised
//! perturbations with a different policy seed.

use std::collections::BTreeMap;

use libero_ctrl::Condition;
use serde::{Deserialize, Serialize};

use crate::outcomes::Records;

/// Number of rollouts whose outcome differs between two policy seeds. Source: section 6 of the
/// protocol.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Flips {
    /// Rollouts with an outcome in a further replicate and in the first.
    pub compared: u64,
    /// Rollouts whose outcomes differ.
    pub flipped: u64,
}

impl Flips {
    /// Returns `flipped` / `compared`; `None` without a rollout.
    pub fn rate(&self) -> Option<f64> {
        (self.compared > 0).then(|| self.flipped as f64 / self.compared as f64)
    }
}

/// Compares every further replicate with the first, by condition.
pub(crate) fn flips(records: &Records) -> BTreeMap<Condition, Flips> {
    let mut flips: BTreeMap<Condition, Flips> = BTreeMap::new();
    for (&(replicate, id), outcome) in &records.outcomes {
        let pair = (outcome.success(), records.outcome(0, id).success());
        if let (1.., (Some(later), Some(first))) = (replicate, pair) {
            let of_condition = flips.entry(id.condition()).or_default();
            of_condition.compared += 1;
            of_condition.flipped += u64::from(later != first);
        }
    }
    flips
}
