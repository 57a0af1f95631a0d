//! Tasks whose files workers lack, as reported by their last claims. Kept in memory only: after a
//! restart, a worker counts as able to run every task until it claims again, so that no rollout is
//! quarantined too early.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Mutex, PoisonError};

use crate::ids::WorkerId;
use crate::store::workers::Live;

/// Keys of the lacking tasks, by worker; workers that lack none are absent.
#[derive(Debug, Default)]
pub(crate) struct LackingTasks(Mutex<BTreeMap<WorkerId, BTreeSet<String>>>);

impl LackingTasks {
    /// Records the tasks that a worker's claim reports. Returns true if they have changed.
    pub(super) fn record(&self, worker: &WorkerId, tasks: &BTreeSet<String>) -> bool {
        let mut lacking = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        match tasks.is_empty() {
            true => lacking.remove(worker).is_some(),
            false if lacking.get(worker) == Some(tasks) => false,
            false => {
                lacking.insert(worker.clone(), tasks.clone());
                true
            }
        }
    }

    pub(super) fn retain(&self, live: &[Live]) {
        let mut lacking = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        lacking.retain(|id, _| live.iter().any(|live| live.id == *id));
    }

    pub(crate) fn has_files(&self, worker: &WorkerId, task: &str) -> bool {
        let lacking = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        !lacking.get(worker).is_some_and(|tasks| tasks.contains(task))
    }
}
