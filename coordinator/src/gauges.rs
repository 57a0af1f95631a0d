//! In-process gauges for `/metrics`.

use std::sync::atomic::{AtomicUsize, Ordering};

/// Counts of calls in progress.
#[derive(Debug, Default)]
pub(crate) struct Gauges {
    claims: AtomicUsize,
}

/// Guard of a claim in progress, which is counted until the guard is dropped.
#[derive(Debug)]
pub(crate) struct ClaimInFlight<'a>(&'a Gauges);

impl Gauges {
    /// Counts a claim until the returned guard is dropped.
    pub(crate) fn claim(&self) -> ClaimInFlight<'_> {
        self.claims.fetch_add(1, Ordering::Relaxed);
        ClaimInFlight(self)
    }

    pub(crate) fn claims(&self) -> usize {
        self.claims.load(Ordering::Relaxed)
    }
}

impl Drop for ClaimInFlight<'_> {
    fn drop(&mut self) {
        self.0.claims.fetch_sub(1, Ordering::Relaxed);
    }
}
