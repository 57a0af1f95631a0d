//! Gauges for the metrics, counted as calls come and go.

use std::sync::atomic::{AtomicUsize, Ordering};

/// Gauges for the metrics.
#[derive(Debug, Default)]
pub(crate) struct Gauges {
    claims: AtomicUsize,
}

/// A claim that is in flight until this is dropped.
#[derive(Debug)]
pub(crate) struct ClaimInFlight<'a>(&'a Gauges);

impl Gauges {
    /// Counts a claim for as long as what is returned lives.
    pub(crate) fn claim(&self) -> ClaimInFlight<'_> {
        self.claims.fetch_add(1, Ordering::Relaxed);
        ClaimInFlight(self)
    }

    /// Claims in flight.
    pub(crate) fn claims(&self) -> usize {
        self.claims.load(Ordering::Relaxed)
    }
}

impl Drop for ClaimInFlight<'_> {
    fn drop(&mut self) {
        self.0.claims.fetch_sub(1, Ordering::Relaxed);
    }
}
