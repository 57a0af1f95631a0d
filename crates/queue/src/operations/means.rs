//! Tasks that workers can run, as reported by their last claims. Kept in memory only: after a
//! restart, a worker counts as able to run every task until it claims again, so that no rollout is
//! quarantined too early.

use std::collections::BTreeMap;
use std::sync::{Mutex, PoisonError};

use super::choose::Means;
use crate::ids::WorkerId;
use crate::store::workers::Live;

#[derive(Debug, Default)]
pub(crate) struct MeansOfWorkers(Mutex<BTreeMap<WorkerId, Means>>);

impl MeansOfWorkers {
    /// Records the means that a worker's claim reports. Returns true if they have changed.
    pub(super) fn record(&self, worker: &WorkerId, means: &Means) -> bool {
        let mut of_workers = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        match of_workers.get(worker) {
            Some(known) if known == means => false,
            known => {
                let has_changed = known.is_some() || *means != Means::default();
                of_workers.insert(worker.clone(), means.clone());
                has_changed
            }
        }
    }

    pub(super) fn retain(&self, live: &[Live]) {
        let mut of_workers = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        of_workers.retain(|id, _| live.iter().any(|live| live.id == *id));
    }

    pub(crate) fn suffice_for(&self, worker: &WorkerId, task: &str) -> bool {
        let of_workers = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        of_workers.get(worker).is_none_or(|means| means.suffice_for(task))
    }
}
