//! Numbers of transactions that settled jobs, and of those that derivation has processed: while
//! some are unprocessed, further jobs may derive from their outcomes.

use std::sync::atomic::{AtomicU64, Ordering};

use tokio::sync::watch;

/// Counts the transactions that settle jobs, before and after they are committed.
pub(crate) struct Settled {
    begun: AtomicU64,
    ended: watch::Sender<u64>,
    looked_at: AtomicU64,
}

/// A transaction that settles jobs. Dropping this value marks its end.
pub(crate) struct Settling<'a>(&'a Settled);

impl Settled {
    /// Starts with one unprocessed transaction, since jobs settled before startup have not been
    /// processed.
    pub(crate) fn new() -> Self {
        Self {
            begun: AtomicU64::new(1),
            ended: watch::Sender::new(1),
            looked_at: AtomicU64::new(0),
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
    pub(crate) fn look_ended(&self, ended: u64) {
        self.looked_at.store(ended, Ordering::SeqCst);
    }

    /// Returns the number of transactions that derivation has processed.
    pub(crate) fn looked_at(&self) -> u64 {
        self.looked_at.load(Ordering::SeqCst)
    }

    /// Returns true if no transaction has settled jobs since `looked_at` was read, so that a view
    /// read in between is complete. Call it after reading.
    pub(crate) fn is_all(&self, looked_at: u64) -> bool {
        self.begun.load(Ordering::SeqCst) == looked_at
    }
}

impl Drop for Settling<'_> {
    fn drop(&mut self) {
        // Also runs after a rollback; the watcher then finds nothing new.
        self.0.ended.send_modify(|ended| *ended += 1);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn uncommitted_settlements_count_as_unprocessed() {
        let settled = Settled::new();
        let ended = settled.subscribe();
        let is_all = || settled.is_all(settled.looked_at());
        let look = || settled.look_ended(*ended.borrow());
        assert!(!is_all(), "what is there at the start");
        look();
        assert!(is_all());
        let settling = settled.begin();
        assert!(!is_all());
        look();
        assert!(!is_all(), "a look cannot see what is not committed");
        drop(settling);
        assert!(!is_all());
        look();
        assert!(is_all());
    }
}
