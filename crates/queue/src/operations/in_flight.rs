//! The rollouts that are being filmed: remembered in memory only. Should that be
//! lost, a rollout is filmed twice, with the same frames.

use std::collections::BTreeMap;
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use crate::clock::UnixMillis;
use crate::ids::JobId;

/// Longest time to film a rollout before it is handed out again: drawing the
/// longest one in software takes a few minutes.
const FILMING_TIMEOUT: Duration = Duration::from_secs(15 * 60);

/// The rollouts that are being filmed, and until when.
#[derive(Debug, Default)]
pub(crate) struct InFlight(Mutex<BTreeMap<JobId, UnixMillis>>);

impl InFlight {
    /// The first that is not being filmed.
    pub(super) fn take(&self, wanting: &[JobId], now: UnixMillis) -> Option<JobId> {
        let mut in_flight = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        in_flight.retain(|_, until| *until > now);
        let job = *wanting.iter().find(|job| !in_flight.contains_key(job))?;
        in_flight.insert(job, now.plus(FILMING_TIMEOUT));
        Some(job)
    }
}
