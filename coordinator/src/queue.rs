//! The queue: reads a job's state, lets the pure modules decide, and executes
//! the decision, in one transaction each. Not responsible for SQL (`store`),
//! for decisions (`lease`, `outage`, `plan`, `pairing`) or for the wire
//! (`grpc`).

mod campaigns;
mod claim;
mod commit;
mod films;
mod known;
mod operate;
mod release;
mod writer;

use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use rand_chacha::ChaCha8Rng;
use sqlx::SqliteConnection;
use tokio::sync::{Notify, mpsc, watch};
use tokio::task::JoinSet;

use crate::clock::{Clock, UnixMillis};
use crate::ids::{CampaignName, JobId, LeaseRef, WorkerId};
use crate::plan::{Decision, ExpiredLease, SweepState, plan};
use crate::store::failpoint::Step;
use films::HandedOut;
use known::Known;
use writer::Operation;

use crate::store::workers::WorkerInfo;
use crate::store::{Store, StoreError, jobs, policies, workers};

pub use campaigns::{CampaignStatus, Created, RATE_WINDOW};
pub use claim::{ClaimRequest, Claimed, ClaimedJob, MAX_CLAIM_JOBS, MAX_CLAIM_WAIT};
pub use commit::{CommitReply, CommitReport, CommitVerdict};
pub use films::Film;
pub use operate::{
    BackupInHand, JobFilter, JobName, MAX_JOBS_LISTED, MAX_JOBS_RETRIED, MAX_WORKERS_LISTED, Retry,
    WorkerStatus,
};
pub use release::{ReleaseReply, ReleaseVerdict};

/// Leases that one sweep takes away.
const MAX_EXPIRED_PER_SWEEP: u32 = 1_024;

/// How long things last.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Timing {
    /// A lease, from its grant or its last heartbeat.
    pub lease: Duration,
    /// Between two heartbeats.
    pub heartbeat: Duration,
    /// A rollout whose progress stands still for so long is killed by its
    /// worker.
    pub progress_timeout: Duration,
    /// A worker counts as alive for so long after it was last heard of; longer
    /// than the longest wait of a claim.
    pub worker_alive: Duration,
    /// Between two looks for expired leases.
    pub sweep: Duration,
}

impl Default for Timing {
    fn default() -> Timing {
        Timing {
            lease: Duration::from_secs(30),
            heartbeat: Duration::from_secs(5),
            progress_timeout: Duration::from_secs(180),
            worker_alive: Duration::from_secs(60),
            sweep: Duration::from_secs(1),
        }
    }
}

/// A request that cannot be met.
#[derive(Debug, thiserror::Error)]
pub enum QueueError {
    /// The worker never announced itself here.
    #[error("serve worker `{worker}`: it is not registered with this coordinator; register first")]
    UnknownWorker {
        /// Who.
        worker: WorkerId,
    },
    /// The worker may lease no more.
    #[error("lease to worker `{worker}`: {reason}")]
    WorkerStopped {
        /// Who.
        worker: WorkerId,
        /// Why.
        reason: String,
    },
    /// There is no such job.
    #[error("find job {job}: this coordinator has no such job")]
    UnknownJob {
        /// Which.
        job: JobId,
    },
    /// There is no such campaign.
    #[error(
        "find campaign `{campaign}`: this coordinator has no such campaign; `coordinator campaign list` shows what it has"
    )]
    UnknownCampaign {
        /// Which.
        campaign: CampaignName,
    },
    /// Another specification has the name.
    #[error(
        "create campaign `{campaign}`: it exists with another specification (they differ in {differs}); choose another name"
    )]
    CampaignDiffers {
        /// Which.
        campaign: CampaignName,
        /// The fields that differ.
        differs: String,
    },
    /// A cancelled campaign was to go on.
    #[error("change campaign `{campaign}`: it is cancelled, which is final; create another")]
    Cancelled {
        /// Which.
        campaign: CampaignName,
    },
    /// A campaign with leased rollouts was to be deleted.
    #[error(
        "delete campaign `{campaign}`: {leased} of its rollouts are being run; cancel it first, or pause it and wait"
    )]
    CampaignInUse {
        /// Which.
        campaign: CampaignName,
        /// How many.
        leased: u64,
    },
    /// There is no such rollout in the campaign.
    #[error(
        "find `{job}`: campaign `{campaign}` has no such rollout; `coordinator jobs list {campaign}` shows what it has"
    )]
    UnknownRollout {
        /// Where.
        campaign: CampaignName,
        /// Which.
        job: JobName,
    },
    /// A job that was not set aside was to be retried.
    #[error("retry `{job}`: it is {state}; only what was set aside can be retried")]
    NotSetAside {
        /// Which.
        job: JobName,
        /// Its state.
        state: String,
    },
    /// A backup is being made.
    #[error("make a backup: another one is being made; try again when it is done")]
    BackupInHand,
    /// The coordinator is shutting down.
    #[error("lease jobs: the coordinator is shutting down")]
    ShuttingDown,
    /// The database failed.
    #[error(transparent)]
    Store(#[from] StoreError),
}

/// The campaign's memory in operation.
pub struct Queue {
    store: Store,
    clock: Arc<dyn Clock>,
    rng: Mutex<ChaCha8Rng>,
    timing: Timing,
    last_sweep: Mutex<UnixMillis>,
    /// What workers ask for, on its way into the next transaction.
    operations: mpsc::Sender<Operation>,
    /// The task that executes it; ends with the queue.
    writer: Mutex<JoinSet<()>>,
    /// What the writer need not read again. Locked within the writing
    /// transaction only.
    known: tokio::sync::Mutex<Known>,
    /// What is being filmed.
    handed_out: Mutex<HandedOut>,
    /// Rung when jobs may have become leasable.
    work: Notify,
    draining: watch::Sender<bool>,
    /// Why nothing is leased for now, if that is so.
    hold: watch::Sender<Option<String>>,
    /// Held while a campaign comes or goes: its files must not be removed
    /// under a new one of the same name.
    campaigns: tokio::sync::Mutex<()>,
    /// Held while a backup is made.
    backing_up: Arc<tokio::sync::Mutex<()>>,
}

impl Queue {
    /// Starts on an open store. Every lease gets its full time again: while
    /// nobody listened, no heartbeat could arrive.
    ///
    /// # Errors
    /// When the database cannot be written.
    pub async fn start(
        store: Store,
        clock: Arc<dyn Clock>,
        rng: ChaCha8Rng,
        timing: Timing,
    ) -> Result<Arc<Queue>, StoreError> {
        let now = clock.now();
        let mut tx = store.write(Step::Start).await?;
        jobs::extend_leases(&mut tx, now.plus(timing.lease)).await?;
        tx.commit().await?;
        let (operations, asked) = writer::line();
        let queue = Arc::new(Queue {
            store,
            clock,
            rng: Mutex::new(rng),
            timing,
            last_sweep: Mutex::new(now),
            operations,
            writer: Mutex::default(),
            known: tokio::sync::Mutex::default(),
            handed_out: Mutex::default(),
            work: Notify::new(),
            draining: watch::Sender::new(false),
            hold: watch::Sender::new(None),
            campaigns: tokio::sync::Mutex::default(),
            backing_up: Arc::default(),
        });
        let writer = writer::run(Arc::downgrade(&queue), asked);
        queue.tasks().spawn(writer);
        queue.finish_removals().await?;
        Ok(queue)
    }

    /// How long things last here.
    pub fn timing(&self) -> Timing {
        self.timing
    }

    /// The store, for readers.
    pub(crate) fn store(&self) -> &Store {
        &self.store
    }

    /// The present instant.
    pub(crate) fn now(&self) -> UnixMillis {
        self.clock.now()
    }

    /// Registers a worker.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn register(&self, worker: &WorkerInfo) -> Result<(), QueueError> {
        let mut tx = self.store.write(Step::Register).await?;
        workers::upsert(&mut tx, worker, self.now()).await?;
        tx.commit().await?;
        // One more live worker may free a job that the others failed on.
        self.work.notify_waiters();
        Ok(())
    }

    /// Renews leases and stores progress. Returns the jobs that this worker no
    /// longer holds.
    ///
    /// # Errors
    /// When the worker is unknown or the database fails.
    pub async fn heartbeat(
        &self,
        worker: &WorkerId,
        progress: &[(LeaseRef, u32)],
    ) -> Result<Vec<JobId>, QueueError> {
        let (worker, progress) = (worker.clone(), progress.to_vec());
        self.ask(|pending| Operation::Heartbeat(worker, progress, pending))
            .await
    }

    async fn heartbeat_in(
        &self,
        tx: &mut SqliteConnection,
        worker: &WorkerId,
        progress: &[(LeaseRef, u32)],
    ) -> Result<Vec<JobId>, QueueError> {
        let now = self.now();
        if workers::seen(tx, &[worker], now).await? == 0 {
            return Err(QueueError::UnknownWorker {
                worker: worker.clone(),
            });
        }
        let probes = policies::probes(tx).await?;
        let held = jobs::renew(tx, progress, now.plus(self.timing.lease)).await?;
        let mut lost = Vec::new();
        for (lease, control_steps) in progress {
            if !held.contains(&lease.job) {
                lost.push(lease.job);
                continue;
            }
            let answered = probes.iter().find(|probe| {
                (probe.job, probe.attempt) == (lease.job, lease.attempt)
                    && *control_steps > probe.settle_steps
            });
            if let Some(probe) = answered {
                let before = policies::health(tx, probe.policy).await?;
                let after = before.after_answer((probe.job, probe.attempt), now);
                self.set_health(tx, probe.policy, (&before, &after), now)
                    .await?;
            }
        }
        Ok(lost)
    }

    /// Takes away leases that ran out and wakes claims that wait for a back-off
    /// or a pause to end. Called every [`Timing::sweep`].
    ///
    /// # Errors
    /// When the database fails; the next sweep tries again.
    pub async fn sweep(&self) -> Result<(), QueueError> {
        let now = self.now();
        let last_sweep = self.last_sweep();
        let mut tx = self.store.write(Step::Sweep).await?;
        let state = SweepState {
            last_sweep,
            lease: self.timing.lease,
            expired: self.expired(&mut tx, now).await?,
        };
        let decisions = self.decide(|rng| plan(&state, now, rng));
        for decision in &decisions {
            self.execute(&mut tx, decision, now).await?;
        }
        let fell_due = jobs::fell_due(&mut tx, last_sweep, now).await?;
        tx.commit().await?;
        *self
            .last_sweep
            .lock()
            .unwrap_or_else(PoisonError::into_inner) = now;
        if fell_due || !decisions.is_empty() {
            self.work.notify_waiters();
        }
        Ok(())
    }

    /// Leases nothing from now on; claims that wait are answered at once.
    pub fn drain(&self) {
        self.draining.send_replace(true);
    }

    /// Leases nothing while there is a reason not to, and goes on when there is
    /// none any more; tells both, once. What is under way goes on.
    pub fn hold_leasing(&self, reason: Option<String>) {
        let changed = self.hold.send_if_modified(|held| {
            // The words may change with every look at a disk that fills.
            let changed = held.is_some() != reason.is_some();
            held.clone_from(&reason);
            changed
        });
        match reason {
            Some(reason) if changed => tracing::error!("leasing nothing: {reason}"),
            None if changed => {
                tracing::info!("leasing again");
                self.work.notify_waiters();
            }
            _ => {}
        }
    }

    /// Why nothing is leased for now, if that is so.
    pub(crate) fn held(&self) -> Option<String> {
        self.hold.borrow().clone()
    }

    /// Closes the database.
    ///
    /// # Errors
    /// When the write-ahead log cannot be moved into the database.
    pub async fn close(&self) -> Result<(), StoreError> {
        self.store.close().await
    }

    async fn expired(
        &self,
        tx: &mut SqliteConnection,
        now: UnixMillis,
    ) -> Result<Vec<ExpiredLease>, StoreError> {
        let mut expired = Vec::new();
        for row in jobs::expired(tx, now, MAX_EXPIRED_PER_SWEEP).await? {
            let suspicion = self
                .suspicion(tx, row.job.id, row.campaign, &row.owner, now)
                .await?;
            expired.push(ExpiredLease {
                lease: LeaseRef {
                    worker: row.owner,
                    job: row.job.id,
                    attempt: row.job.attempt,
                },
                job: row.job,
                control_steps: row.control_steps,
                owner_failures_in_a_row: row.owner_failures_in_a_row,
                suspicion,
            });
        }
        Ok(expired)
    }

    async fn execute(
        &self,
        tx: &mut SqliteConnection,
        decision: &Decision,
        now: UnixMillis,
    ) -> Result<(), StoreError> {
        match decision {
            Decision::ExtendLeases { until } => {
                tracing::warn!("the coordinator slept: every lease gets its full time again");
                jobs::extend_leases(tx, *until).await
            }
            Decision::Fail {
                lease,
                reason,
                error,
                then,
            } => {
                tracing::warn!(job = %lease.job, attempt = %lease.attempt, "lease lost: {error}");
                jobs::fail(tx, lease, *reason, error, *then, now).await?;
                self.lease_told_nothing_of_its_policy(tx, lease, now).await
            }
            Decision::Strike { worker, strike } => {
                self.strike(tx, worker, *strike, "its leases ran out")
                    .await?;
                Ok(())
            }
        }
    }

    fn tasks(&self) -> std::sync::MutexGuard<'_, JoinSet<()>> {
        self.writer.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn handed_out(&self) -> std::sync::MutexGuard<'_, HandedOut> {
        self.handed_out
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
    }

    fn last_sweep(&self) -> UnixMillis {
        *self
            .last_sweep
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
    }

    /// Runs a pure decision with this queue's generator.
    fn decide<T>(&self, decision: impl FnOnce(&mut ChaCha8Rng) -> T) -> T {
        decision(&mut self.rng.lock().unwrap_or_else(PoisonError::into_inner))
    }
}

impl std::fmt::Debug for Queue {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Queue")
            .field("folder", &self.store.folder())
            .field("timing", &self.timing)
            .finish_non_exhaustive()
    }
}
