//! State that every operation of a queue shares.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use benchmark::attempt::AttemptId;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::Rng;
use tokio::sync::{Notify, watch};

use super::cache::Cache;
use super::means::MeansOfWorkers;
use super::unfilmed::UnfilmedRollouts;
use crate::clock::{Clock, UnixMillis};
use crate::remote_storage::RemoteStorage;
use crate::store::Store;
use crate::timing::Timing;

/// State that every operation of a queue shares.
pub(crate) struct Shared {
    pub(crate) store: Store,
    pub(crate) clock: Arc<dyn Clock>,
    rng: Mutex<ChaCha8Rng>,
    pub(crate) timing: Timing,
    /// Cache of rows. Locked only inside the writing transaction.
    pub(super) cache: tokio::sync::Mutex<Cache>,
    /// Held while a video is added to the data folder or removed from it.
    pub(crate) files: tokio::sync::Mutex<()>,
    pub(super) films: UnfilmedRollouts,
    /// Tasks that workers can run.
    pub(crate) means: Arc<MeansOfWorkers>,
    /// Remote storage of videos, if configured.
    pub(crate) remote_storage: Option<Arc<dyn RemoteStorage>>,
    /// Notified when jobs may have become leasable.
    pub(crate) work: Notify,
    /// True if waiting claims were not notified of a job.
    pub(super) passed_over: AtomicBool,
    /// Notified when jobs are settled, since a campaign's stop rule may be met.
    pub(crate) settled: watch::Sender<()>,
    /// True once the coordinator is shutting down and leases no more jobs.
    pub(crate) draining: watch::Sender<bool>,
    /// Reason why leasing is suspended; `None` while jobs are leased.
    pub(crate) hold: watch::Sender<Option<String>>,
}

impl Shared {
    pub(crate) fn new(
        store: Store,
        clock: Arc<dyn Clock>,
        rng: ChaCha8Rng,
        timing: Timing,
        remote_storage: Option<Arc<dyn RemoteStorage>>,
    ) -> Shared {
        Shared {
            store,
            clock,
            rng: Mutex::new(rng),
            timing,
            cache: tokio::sync::Mutex::default(),
            files: tokio::sync::Mutex::default(),
            films: UnfilmedRollouts::default(),
            means: Arc::default(),
            remote_storage,
            work: Notify::new(),
            passed_over: AtomicBool::new(false),
            settled: watch::Sender::new(()),
            draining: watch::Sender::new(false),
            hold: watch::Sender::new(None),
        }
    }

    /// Wakes one waiting claim for one job, and the others at the next sweep, in case that claim
    /// cannot run it. Thousands of claims would cost more than the job if each looked for it.
    pub(super) fn wake_one(&self) {
        self.work.notify_one();
        self.passed_over.store(true, Ordering::Relaxed);
    }

    pub(crate) fn now(&self) -> UnixMillis {
        self.clock.now()
    }

    /// Returns the reason why leasing is suspended; `None` while jobs are leased.
    pub(crate) fn held(&self) -> Option<String> {
        self.hold.borrow().clone()
    }

    pub(crate) fn decide<T>(&self, decision: impl FnOnce(&mut ChaCha8Rng) -> T) -> T {
        decision(&mut self.rng.lock().unwrap_or_else(PoisonError::into_inner))
    }

    pub(crate) fn new_attempt(&self) -> AttemptId {
        let mut bits = [0; 16];
        self.decide(|rng| rng.fill_bytes(&mut bits));
        AttemptId::from_random(bits)
    }
}
