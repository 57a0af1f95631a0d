//! Entry point for the requests of workers and operators. Answers are sent only after their
//! transaction is on disk.

use std::sync::Arc;
use std::sync::atomic::AtomicI64;
use std::time::Duration;

use benchmark::attempt::AttemptId;
use rand_chacha::ChaCha8Rng;
use tokio::sync::{mpsc, oneshot};
use tokio::time::Instant;

use crate::clock::{self, Clock, UnixMillis};
use crate::ids::WorkerId;
use crate::operations::claim::{ClaimRequest, Claimed, MAX_CLAIM_WAIT};
use crate::operations::commit::{CommitReply, CommitReport, CommitVerdict};
use crate::operations::error::QueueError;
use crate::operations::filming::Filming;
use crate::operations::heartbeat::Heartbeat;
use crate::operations::release::{Release, ReleaseReply, ReleaseVerdict};
use crate::operations::shared::Shared;
use crate::operations::writer::{self, MAX_WAITING, Operation, Pending};
use crate::operations::{batches, stop};
use crate::operations::{removals, start};
use crate::read::{Changes, View};
use crate::remote_storage::RemoteStorage;
use crate::rules::lease::FailureReason;
use crate::store::{Store, StoreError, instants};
use crate::tasks::Tasks;
use crate::timing::Timing;

/// Interval between checkpoints of the write-ahead log.
const CHECKPOINT_INTERVAL: Duration = Duration::from_secs(1);

/// The job table of a running coordinator.
pub struct Queue {
    pub(crate) shared: Arc<Shared>,
    /// Operations of workers, waiting for the next transaction.
    operations: mpsc::Sender<Operation>,
    /// Tasks that execute operations, checkpoint the log, and stop campaigns as outcomes arrive;
    /// they end with the queue.
    tasks: tokio::sync::Mutex<Tasks>,
    pub(crate) last_sweep: AtomicI64,
    pub(crate) filming: Filming,
    /// Held while a campaign is created, imported, altered or deleted, so that deleting one does
    /// not remove the files of a new one of the same name. Never held across a network call.
    pub(crate) campaigns: tokio::sync::Mutex<()>,
    /// Held while files of deleted campaigns are removed, locally and remotely.
    pub(crate) removing: tokio::sync::Mutex<()>,
    pub(crate) backups: Arc<tokio::sync::Mutex<()>>,
}

/// Checkpoints the write-ahead log outside the writer, so that transactions do not wait for it.
async fn checkpoint_log(shared: Arc<Shared>) {
    loop {
        tokio::time::sleep(CHECKPOINT_INTERVAL).await;
        // A full disk may have room later; the log stays readable in any case.
        if let Err(error) = shared.store.checkpoint().await {
            tracing::debug!("failed to {}", error.with_cause());
        }
    }
}

impl Queue {
    /// Starts on an open store. Every lease is restarted with its full duration, since no heartbeat
    /// could arrive while the coordinator was down.
    pub async fn start(
        store: Store,
        clock: Arc<dyn Clock>,
        rng: ChaCha8Rng,
        timing: Timing,
    ) -> Result<Arc<Queue>, StoreError> {
        Queue::start_with(store, clock, rng, timing, None).await
    }

    /// Starts like [`start`](Self::start), with remote storage for videos if it is given.
    pub async fn start_with(
        store: Store,
        clock: Arc<dyn Clock>,
        rng: ChaCha8Rng,
        timing: Timing,
        remote_storage: Option<Arc<dyn RemoteStorage>>,
    ) -> Result<Arc<Queue>, StoreError> {
        let newest = instants::newest(&mut *store.read().await?).await?;
        let clock = clock::beginning_at(newest, clock);
        let shared = Arc::new(Shared::new(store, clock, rng, timing, remote_storage));
        start::start(&shared).await?;
        // Remote storage may be unavailable; removals are then retried in the background.
        if shared.remote_storage.is_none() {
            for folder in removals::pending(&shared).await? {
                removals::remove(&shared, &folder).await?;
            }
        }
        let (operations, received) = mpsc::channel(MAX_WAITING);
        let interrupted = batches::interrupted(&shared).await?;
        let mut tasks = Tasks::default();
        let removal = batches::run(shared.clone(), interrupted);
        tasks.spawn("the deletion of incomplete campaigns", removal);
        tasks.spawn("the database's writer", writer::run(shared.clone(), received));
        tasks.spawn("the checkpointer", checkpoint_log(shared.clone()));
        tasks.spawn("the early stop", stop::run(shared.clone()));
        Ok(Arc::new(Queue {
            last_sweep: AtomicI64::new(shared.now().0),
            shared,
            operations,
            tasks: tokio::sync::Mutex::new(tasks),
            filming: Filming::default(),
            campaigns: tokio::sync::Mutex::default(),
            removing: tokio::sync::Mutex::default(),
            backups: Arc::default(),
        }))
    }

    pub fn timing(&self) -> Timing {
        self.shared.timing
    }

    pub fn now(&self) -> UnixMillis {
        self.shared.now()
    }

    pub fn store(&self) -> &Store {
        &self.shared.store
    }

    pub async fn view(&self) -> Result<View, StoreError> {
        let filming = self.filming.by_worker();
        let shared = &*self.shared;
        let (now, timing, means) = (shared.now(), shared.timing, shared.means.clone());
        View::begin(&shared.store, now, timing, self.held(), filming, means).await
    }

    pub async fn changes(&self) -> Result<Changes, StoreError> {
        Changes::begin(&self.shared.store).await
    }

    /// Leases a job, waiting up to `wait` for one, at most `MAX_CLAIM_WAIT`.
    pub async fn claim(
        &self,
        request: &ClaimRequest,
        wait: Duration,
    ) -> Result<Claimed, QueueError> {
        let deadline = Instant::now() + wait.min(MAX_CLAIM_WAIT);
        let mut draining = self.shared.draining.subscribe();
        let mut is_new = true;
        loop {
            if *draining.borrow_and_update() {
                return Err(QueueError::ShuttingDown);
            }
            // Subscribes before the query, so that a job queued in between wakes this claim.
            let mut work = std::pin::pin!(self.shared.work.notified());
            work.as_mut().enable();
            let (pending, answer) = Pending::new((request.clone(), is_new));
            let claimed = self.submit(Operation::Claim(Box::new(pending)), answer).await?;
            is_new = false;
            if claimed.job.is_some() {
                return Ok(claimed);
            }
            tokio::select! {
                () = &mut work => {}
                _ = draining.changed() => {}
                () = tokio::time::sleep_until(deadline) => return Ok(claimed),
            }
        }
    }

    /// Renews and acknowledges leases, and stores progress in control steps.
    /// Returns the attempts whose leases this worker no longer holds.
    pub async fn heartbeat(
        &self,
        worker: &WorkerId,
        progress: &[(AttemptId, u32)],
    ) -> Result<Vec<AttemptId>, QueueError> {
        let (pending, answer) =
            Pending::new(Heartbeat { worker: worker.clone(), progress: progress.to_vec() });
        self.submit(Operation::Heartbeat(pending), answer).await
    }

    /// Records the number of videos that a worker renders or uploads, as reported by its accepted
    /// heartbeat.
    pub fn note_filming(&self, worker: &WorkerId, videos: u32) {
        let now = self.now();
        let alive_since = now.minus(self.timing().worker_alive);
        self.filming.record(worker, videos, now, alive_since);
    }

    /// Stores a result and ends its lease, or answers with the reason for refusing it.
    pub async fn commit(&self, report: &CommitReport) -> Result<CommitReply, QueueError> {
        let (pending, answer) = Pending::new(Box::new(report.clone()));
        let reply = self.submit(Operation::Commit(pending), answer).await?;
        if reply.verdict != CommitVerdict::Accepted {
            tracing::warn!(attempt = %report.attempt, verdict = ?reply.verdict, "{}", reply.detail);
        }
        Ok(reply)
    }

    /// Ends a lease without a result.
    pub async fn release(
        &self,
        attempt: AttemptId,
        reason: FailureReason,
        error: &str,
    ) -> Result<ReleaseReply, QueueError> {
        self.release_after(attempt, reason, error, None).await
    }

    /// Ends a lease like [`release`](Self::release). `answered` is the number of queries that the
    /// policy answered before it became unreachable; `None` if it was never reached, or the attempt
    /// failed for another reason.
    pub async fn release_after(
        &self,
        attempt: AttemptId,
        reason: FailureReason,
        error: &str,
        answered: Option<u32>,
    ) -> Result<ReleaseReply, QueueError> {
        let (pending, answer) =
            Pending::new(Release { attempt, reason, error: error.to_owned(), answered });
        let reply = self.submit(Operation::Release(pending), answer).await?;
        if reply.verdict != ReleaseVerdict::Stale {
            let reason = reason.as_str();
            tracing::info!(%attempt, verdict = ?reply.verdict, "released ({reason}): {error}");
        }
        Ok(reply)
    }

    /// Stops leasing for good; waiting claims are answered at once.
    pub fn drain(&self) {
        self.shared.draining.send_replace(true);
    }

    /// Suspends leasing while `reason` is given, and resumes it when `reason` is `None`; logs each
    /// change once. Attempts in progress continue.
    pub fn hold_leasing(&self, reason: Option<String>) {
        let has_changed = self.shared.hold.send_if_modified(|held| {
            // Compares only whether there is a reason: its text may change with every measurement
            // of a filling disk's free space.
            let is_changed = held.is_some() != reason.is_some();
            held.clone_from(&reason);
            is_changed
        });
        match reason {
            Some(reason) if has_changed => tracing::error!("leasing is suspended: {reason}"),
            None if has_changed => {
                tracing::info!("leasing is resumed");
                self.shared.work.notify_waiters();
            }
            _ => {}
        }
    }

    /// Returns the reason why leasing is suspended; `None` while jobs are leased.
    pub fn held(&self) -> Option<String> {
        self.shared.held()
    }

    /// Waits until one of the queue's tasks ends, which only a panic can cause, and returns its
    /// name.
    pub async fn broken(&self) -> &'static str {
        self.tasks.lock().await.next_ended().await
    }

    pub async fn close(&self) -> Result<(), StoreError> {
        self.shared.store.close().await
    }

    /// Submits an operation and waits until it is committed to disk.
    async fn submit<T>(
        &self,
        operation: Operation,
        answer: oneshot::Receiver<Result<T, QueueError>>,
    ) -> Result<T, QueueError> {
        let sent = self.operations.send(operation).await;
        sent.map_err(|_| QueueError::ShuttingDown)?;
        answer.await.map_err(|_| QueueError::ShuttingDown)?
    }
}

impl std::fmt::Debug for Queue {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Queue")
            .field("folder", &self.store().folder())
            .field("timing", &self.timing())
            .finish_non_exhaustive()
    }
}
