//! Counts the transactions that settle jobs (commit or quarantine them), and how many of these
//! derivation has processed. While some are unprocessed, further jobs may derive from their
//! outcomes.

use std::sync::atomic::{AtomicU64, Ordering};

use tokio::sync::watch;

/// Counts of the transactions that settle jobs.
pub(crate) struct SettlementWatch {
    /// Transactions that have started to commit.
    begun: AtomicU64,
    /// Transactions that have been committed or rolled back.
    ended: watch::Sender<u64>,
    /// Transactions that derivation has processed.
    processed: AtomicU64,
}

/// A transaction that settles jobs. Dropping this value marks its end.
pub(crate) struct Settling<'a>(&'a SettlementWatch);

impl SettlementWatch {
    /// Starts with one unprocessed transaction, since jobs settled before startup have not been
    /// processed.
    pub(crate) fn new() -> Self {
        Self {
            begun: AtomicU64::new(1),
            ended: watch::Sender::new(1),
            processed: AtomicU64::new(0),
        }
    }

    /// Counts a transaction that is about to commit.
    pub(crate) fn begin(&self) -> Settling<'_> {
        self.begun.fetch_add(1, Ordering::SeqCst);
        Settling(self)
    }

    /// Subscribes to the number of settling transactions that have ended.
    pub(crate) fn subscribe(&self) -> watch::Receiver<u64> {
        self.ended.subscribe()
    }

    /// Records that the first `ended` transactions are processed and that the derived jobs are
    /// committed.
    pub(crate) fn mark_processed(&self, ended: u64) {
        self.processed.store(ended, Ordering::SeqCst);
    }

    /// Returns the number of transactions that derivation has processed.
    pub(crate) fn processed(&self) -> u64 {
        self.processed.load(Ordering::SeqCst)
    }

    /// Returns true if `processed` counts all settling transactions that have begun so far. A view
    /// that began after `processed` was read then holds all jobs that derive from its outcomes.
    pub(crate) fn is_current(&self, processed: u64) -> bool {
        self.begun.load(Ordering::SeqCst) == processed
    }
}

impl Drop for Settling<'_> {
    fn drop(&mut self) {
        // Also runs after a rollback; subscribers then find nothing new.
        self.0.ended.send_modify(|ended| *ended += 1);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn uncommitted_settlements_count_as_unprocessed() {
        let settled = SettlementWatch::new();
        let ended = settled.subscribe();
        let is_current = || settled.is_current(settled.processed());
        let process = || settled.mark_processed(*ended.borrow());
        assert!(!is_current(), "jobs settled before the start are unprocessed");
        process();
        assert!(is_current());
        let settling = settled.begin();
        assert!(!is_current());
        process();
        assert!(!is_current(), "an uncommitted settlement cannot be processed");
        drop(settling);
        assert!(!is_current());
        process();
        assert!(is_current());
    }
}
