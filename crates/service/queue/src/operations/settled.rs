//! Count of transactions that settled jobs, and of those that have been looked at: while some have
//! not, further jobs may follow from their outcomes.

use std::sync::atomic::{AtomicU64, Ordering};

use tokio::sync::watch;

/// Counts the transactions that settle jobs, before and after they are committed.
pub(crate) struct Settled {
    begun: AtomicU64,
    ended: watch::Sender<u64>,
    looked_at: AtomicU64,
}

/// A transaction that settles jobs, until it has ended.
pub(crate) struct Settling<'a>(&'a Settled);

impl Settled {
    /// Starts one transaction ahead of the looks: jobs settled before the start have not been
    /// looked at.
    pub(crate) fn new() -> Self {
        Self {
            begun: AtomicU64::new(1),
            ended: watch::Sender::new(1),
            looked_at: AtomicU64::new(0),
        }
    }

    /// Counts a transaction that is about to be committed.
    pub(crate) fn begin(&self) -> Settling<'_> {
        self.begun.fetch_add(1, Ordering::SeqCst);
        Settling(self)
    }

    /// Rung when such a transaction has ended; how many have.
    pub(crate) fn subscribe(&self) -> watch::Receiver<u64> {
        self.ended.subscribe()
    }

    /// Notes that everything was looked at that the first so many transactions settled, and
    /// that what follows is committed.
    pub(crate) fn look_ended(&self, ended: u64) {
        self.looked_at.store(ended, Ordering::SeqCst);
    }

    /// Returns the number of transactions that have been looked at.
    pub(crate) fn looked_at(&self) -> u64 {
        self.looked_at.load(Ordering::SeqCst)
    }

    /// Whether that is all that one can have read of, if `looked_at` was asked before
    /// reading and this after.
    pub(crate) fn is_all(&self, looked_at: u64) -> bool {
        self.begun.load(Ordering::SeqCst) == looked_at
    }
}

impl Drop for Settling<'_> {
    fn drop(&mut self) {
        // Also of one that failed: who looks then finds nothing new.
        self.0.ended.send_modify(|ended| *ended += 1);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_being_settled_is_not_looked_at() {
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
