//! The way in: everything that workers and operators ask for. Their answers are
//! on the disk when they are given.

use std::collections::HashMap;
use std::future::Future;
use std::sync::Arc;
use std::sync::atomic::AtomicI64;
use std::time::Duration;

use rand_chacha::ChaCha8Rng;
use rollout_types::AttemptId;
use tokio::sync::{mpsc, oneshot};
use tokio::task::JoinSet;
use tokio::time::Instant;

use crate::clock::{Clock, UnixMillis};
use crate::elsewhere::Elsewhere;
use crate::ids::WorkerId;
use crate::operations::claim::{ClaimRequest, Claimed, MAX_CLAIM_WAIT};
use crate::operations::commit::{CommitReply, CommitReport, CommitVerdict};
use crate::operations::error::QueueError;
use crate::operations::filming::Filming;
use crate::operations::heartbeat::Heartbeat;
use crate::operations::release::{Release, ReleaseReply, ReleaseVerdict};
use crate::operations::shared::Shared;
use crate::operations::writer::{self, MAX_WAITING, Operation, Pending};
use crate::operations::{derive, passages, stop};
use crate::operations::{removals, start};
use crate::read::{Changes, View};
use crate::rules::lease::FailureReason;
use crate::store::{Store, StoreError};
use crate::timing::Timing;

/// Between two checkpoints of the write-ahead log.
const CHECKPOINT_INTERVAL: Duration = Duration::from_secs(1);

/// The job table in operation.
pub struct Queue {
    pub(crate) shared: Arc<Shared>,
    /// Operations of workers, on their way into the next transaction.
    operations: mpsc::Sender<Operation>,
    /// Tasks that execute operations, keep the log short, and add jobs or stop campaigns as
    /// outcomes come; they end with the queue.
    tasks: tokio::sync::Mutex<Tasks>,
    pub(crate) last_sweep: AtomicI64,
    pub(crate) filming: Filming,
    /// Held while a campaign comes or goes: its files must not be removed
    /// under a new one of the same name. Never across the network.
    pub(crate) campaigns: tokio::sync::Mutex<()>,
    /// Held while files of deleted campaigns are removed, here and elsewhere.
    pub(crate) removing: tokio::sync::Mutex<()>,
    pub(crate) backups: Arc<tokio::sync::Mutex<()>>,
}

/// Checkpoints the write-ahead log beside the writer, whose transactions would
/// wait for it otherwise.
async fn keep_log_short(shared: Arc<Shared>) {
    loop {
        tokio::time::sleep(CHECKPOINT_INTERVAL).await;
        // A disk that is full may have room again; the log is read on in any case.
        if let Err(error) = shared.store.checkpoint().await {
            tracing::debug!("failed to {}", error.with_cause());
        }
    }
}

/// The tasks that a queue owns, with their names.
#[derive(Default)]
struct Tasks {
    running: JoinSet<()>,
    names: HashMap<tokio::task::Id, &'static str>,
}

impl Tasks {
    fn spawn(&mut self, name: &'static str, work: impl Future<Output = ()> + Send + 'static) {
        let task = self.running.spawn(work);
        self.names.insert(task.id(), name);
    }

    async fn next_ended(&mut self) -> &'static str {
        let ended = match self.running.join_next_with_id().await {
            Some(Ok((id, ()))) => Some(id),
            Some(Err(error)) => Some(error.id()),
            None => None,
        };
        let name = ended.and_then(|id| self.names.get(&id));
        name.copied().unwrap_or("a task of the queue")
    }
}

impl Queue {
    /// Starts on an open store. Every lease gets its full time again: while the
    /// coordinator was down, no heartbeat could arrive.
    ///
    /// # Errors
    /// When the database cannot be written.
    pub async fn start(
        store: Store,
        clock: Arc<dyn Clock>,
        rng: ChaCha8Rng,
        timing: Timing,
    ) -> Result<Arc<Queue>, StoreError> {
        Queue::start_with(store, clock, rng, timing, None).await
    }

    /// As [`start`](Self::start), with films that are kept elsewhere in the end.
    ///
    /// # Errors
    /// When the database cannot be written.
    pub async fn start_with(
        store: Store,
        clock: Arc<dyn Clock>,
        rng: ChaCha8Rng,
        timing: Timing,
        elsewhere: Option<Arc<dyn Elsewhere>>,
    ) -> Result<Arc<Queue>, StoreError> {
        let shared = Arc::new(Shared::new(store, clock, rng, timing, elsewhere));
        start::start(&shared).await?;
        // Elsewhere may not answer: then it is tried again and again, beside the rest.
        if shared.elsewhere.is_none() {
            for folder in removals::pending(&shared).await? {
                removals::remove(&shared, &folder).await?;
            }
        }
        let (operations, asked) = mpsc::channel(MAX_WAITING);
        let left = passages::left(&shared).await?;
        let mut tasks = Tasks::default();
        let removal = passages::run(shared.clone(), left);
        tasks.spawn("the removal of what was left on the way", removal);
        tasks.spawn("the database's writer", writer::run(shared.clone(), asked));
        tasks.spawn("the checkpointer", keep_log_short(shared.clone()));
        tasks.spawn("the derivation of rollouts", derive::run(shared.clone()));
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

    /// Returns the durations of leases, heartbeats and timeouts.
    pub fn timing(&self) -> Timing {
        self.shared.timing
    }

    /// The present instant.
    pub fn now(&self) -> UnixMillis {
        self.shared.now()
    }

    /// The store.
    pub fn store(&self) -> &Store {
        &self.shared.store
    }

    /// Begins a view of the committed database.
    ///
    /// # Errors
    /// If the database cannot be read.
    pub async fn view(&self) -> Result<View, StoreError> {
        let filming = self.filming.by_worker();
        let shared = &*self.shared;
        let (now, timing, settled) = (shared.now(), shared.timing, shared.settled.clone());
        View::begin(&shared.store, now, timing, settled, self.held(), filming).await
    }

    /// Reports when something was committed.
    ///
    /// # Errors
    /// When the database cannot be read.
    pub async fn changes(&self) -> Result<Changes, StoreError> {
        Changes::begin(&self.shared.store).await
    }

    /// Leases a job; waits up to `wait` for one.
    ///
    /// # Errors
    /// When the worker is unknown or must stop, while shutting down, or when
    /// the database fails.
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
            // Listening begins before looking: what is queued in between rings.
            let mut work = std::pin::pin!(self.shared.work.notified());
            work.as_mut().enable();
            let (pending, answer) = Pending::new((request.clone(), is_new));
            let claimed = self.ask(Operation::Claim(pending), answer).await?;
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
    ///
    /// # Errors
    /// When the worker is unknown or the database fails.
    pub async fn heartbeat(
        &self,
        worker: &WorkerId,
        progress: &[(AttemptId, u32)],
    ) -> Result<Vec<AttemptId>, QueueError> {
        let (pending, answer) = Pending::new(Heartbeat {
            worker: worker.clone(),
            progress: progress.to_vec(),
        });
        self.ask(Operation::Heartbeat(pending), answer).await
    }

    /// Notes how many videos a worker draws or sends, as said by a heartbeat that
    /// was accepted.
    pub fn note_filming(&self, worker: &WorkerId, videos: u32) {
        let now = self.now();
        let alive_since = now.minus(self.timing().worker_alive);
        self.filming.heard(worker, videos, now, alive_since);
    }

    /// Stores a result and ends its lease, or says why not.
    ///
    /// # Errors
    /// When the attempt is unknown or the database fails.
    pub async fn commit(&self, report: &CommitReport) -> Result<CommitReply, QueueError> {
        let (pending, answer) = Pending::new(Box::new(report.clone()));
        let reply = self.ask(Operation::Commit(pending), answer).await?;
        if reply.verdict != CommitVerdict::Accepted {
            tracing::warn!(attempt = %report.attempt, verdict = ?reply.verdict, "{}", reply.detail);
        }
        Ok(reply)
    }

    /// Ends a lease without a result.
    ///
    /// # Errors
    /// When the attempt is unknown or the database fails.
    pub async fn release(
        &self,
        attempt: AttemptId,
        reason: FailureReason,
        error: &str,
    ) -> Result<ReleaseReply, QueueError> {
        self.release_after(attempt, reason, error, None).await
    }

    /// As [`release`](Self::release), of a policy that cannot be reached any more and had
    /// answered so many queries; none if it was not there at the first.
    ///
    /// # Errors
    /// When the attempt is unknown or the database fails.
    pub async fn release_after(
        &self,
        attempt: AttemptId,
        reason: FailureReason,
        error: &str,
        answered: Option<u32>,
    ) -> Result<ReleaseReply, QueueError> {
        let (pending, answer) = Pending::new(Release {
            attempt,
            reason,
            error: error.to_owned(),
            answered,
        });
        let reply = self.ask(Operation::Release(pending), answer).await?;
        if reply.verdict != ReleaseVerdict::Stale {
            let reason = reason.as_str();
            tracing::info!(%attempt, verdict = ?reply.verdict, "released ({reason}): {error}");
        }
        Ok(reply)
    }

    /// Leases nothing from now on; claims that wait are answered at once.
    pub fn drain(&self) {
        self.shared.draining.send_replace(true);
    }

    /// Leases nothing while there is a reason not to, and goes on when there is
    /// none any more; logs both, once. What is under way goes on.
    pub fn hold_leasing(&self, reason: Option<String>) {
        let changed = self.shared.hold.send_if_modified(|held| {
            // The words may change with every look at a disk that fills.
            let changed = held.is_some() != reason.is_some();
            held.clone_from(&reason);
            changed
        });
        match reason {
            Some(reason) if changed => tracing::error!("leasing nothing: {reason}"),
            None if changed => {
                tracing::info!("leasing again");
                self.shared.work.notify_waiters();
            }
            _ => {}
        }
    }

    /// Why nothing is leased at the moment; none while jobs are leased.
    pub fn held(&self) -> Option<String> {
        self.shared.held()
    }

    /// Waits until one of the queue's own tasks ends, which only a panic can bring about, and
    /// names it.
    pub async fn broken(&self) -> &'static str {
        self.tasks.lock().await.next_ended().await
    }

    /// Closes the database.
    ///
    /// # Errors
    /// When the write-ahead log cannot be moved into the database.
    pub async fn close(&self) -> Result<(), StoreError> {
        self.shared.store.close().await
    }

    /// Hands an operation in and waits until it is on the disk.
    async fn ask<T>(
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

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn a_task_that_panics_is_named() {
        for panics in ["first", "second"] {
            let mut tasks = Tasks::default();
            for name in ["first", "second"] {
                tasks.spawn(name, async move {
                    assert_ne!(name, panics, "a defect");
                    std::future::pending().await
                });
            }
            assert_eq!(tasks.next_ended().await, panics);
        }
    }
}
