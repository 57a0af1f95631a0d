//! Group commit: what workers ask for is gathered while one transaction runs and
//! goes into the next together, so that many answers wait for one `fsync`.
//!
//! An operation that fails spoils nobody else's: the transaction is undone and
//! each of its operations is tried in one of its own. Not responsible for what
//! the operations do (`claim`, `commit`, `release`).

use std::sync::Weak;

use sqlx::SqliteConnection;
use tokio::sync::{mpsc, oneshot};

use super::known::Known;
use super::release::Release;
use super::{ClaimRequest, Claimed, CommitReply, CommitReport, Queue, QueueError, ReleaseReply};
use crate::ids::{JobId, LeaseRef, WorkerId};
use crate::store::StoreError;
use crate::store::failpoint::Step;

/// Most operations of one transaction.
const MAX_BATCH: usize = 256;
/// Operations that wait for the next transactions; who comes then, waits.
const MAX_WAITING: usize = 4_096;

/// What a worker asks for, and who waits for the answer.
#[derive(Debug)]
pub(super) enum Operation {
    /// Leases jobs.
    Claim(ClaimRequest, Presence, Pending<Claimed>),
    /// Renews leases.
    Heartbeat(WorkerId, Vec<(LeaseRef, u32)>, Pending<Vec<JobId>>),
    /// Stores an outcome.
    Commit(Box<CommitReport>, Pending<CommitReply>),
    /// Ends an attempt without one.
    Release(Release, Pending<ReleaseReply>),
}

/// Whether a claim says that its worker is there.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Presence {
    /// It has just come.
    Noted,
    /// It was woken while it waited: nobody knows whether its worker is there.
    Unknown,
}

/// An answer that is given when its transaction is on the disk.
#[derive(Debug)]
pub(super) struct Pending<T> {
    answer: Option<Result<T, QueueError>>,
    reply: oneshot::Sender<Result<T, QueueError>>,
}

/// Where operations are handed in, and where they come out.
pub(super) fn line() -> (mpsc::Sender<Operation>, mpsc::Receiver<Operation>) {
    mpsc::channel(MAX_WAITING)
}

/// Executes operations until the queue has gone.
pub(super) async fn run(queue: Weak<Queue>, mut asked: mpsc::Receiver<Operation>) {
    let mut batch = Vec::with_capacity(MAX_BATCH);
    while asked.recv_many(&mut batch, MAX_BATCH).await > 0 {
        let Some(queue) = queue.upgrade() else {
            return;
        };
        queue.write(&mut batch).await;
        for operation in batch.drain(..) {
            operation.reply();
        }
    }
}

impl Queue {
    /// Hands an operation in and waits until it is on the disk.
    pub(super) async fn ask<T>(
        &self,
        operation: impl FnOnce(Pending<T>) -> Operation,
    ) -> Result<T, QueueError> {
        let (reply, answer) = oneshot::channel();
        let pending = Pending {
            answer: None,
            reply,
        };
        let sent = self.operations.send(operation(pending)).await;
        sent.map_err(|_| QueueError::ShuttingDown)?;
        answer.await.map_err(|_| QueueError::ShuttingDown)?
    }

    async fn write(&self, batch: &mut [Operation]) {
        let Err(error) = self.transact(batch).await else {
            return;
        };
        if let [alone] = batch {
            return alone.fail(error);
        }
        for operation in batch.chunks_mut(1) {
            if let Err(error) = self.transact(operation).await {
                operation[0].fail(error);
            }
        }
    }

    /// Executes operations in one transaction: each has its answer then, or
    /// nothing at all happened. Who asks for several things waits for each
    /// answer, so that their order is free: what makes jobs leasable goes first,
    /// and what can be done at once is done together.
    async fn transact(&self, operations: &mut [Operation]) -> Result<(), StoreError> {
        let mut steps: Vec<Step> = operations.iter().map(Operation::step).collect();
        steps.sort_unstable();
        steps.dedup();
        let mut tx = self.store.write_many(steps).await?;
        let mut known = self.known.lock().await;
        known.begin();
        let executed = self.execute_all(&mut tx, &mut known, operations).await;
        let ended = match executed {
            Ok(()) => tx.commit().await,
            Err(error) => Err(error),
        };
        if ended.is_err() {
            known.forget();
        }
        ended
    }

    async fn execute_all(
        &self,
        tx: &mut SqliteConnection,
        known: &mut Known,
        operations: &mut [Operation],
    ) -> Result<(), StoreError> {
        let mut commits = Vec::new();
        let mut claims = Vec::new();
        for operation in operations {
            match operation {
                Operation::Commit(report, pending) => commits.push((&**report, pending)),
                Operation::Claim(request, presence, pending) => {
                    // A lease for somebody who has gone would only run out.
                    if !pending.reply.is_closed() {
                        claims.push((&*request, *presence, pending));
                    }
                }
                Operation::Heartbeat(worker, progress, pending) => {
                    pending.put(self.heartbeat_in(tx, worker, progress).await)?;
                }
                Operation::Release(release, pending) => {
                    pending.put(self.release_in(tx, release).await)?;
                }
            }
        }
        let reports: Vec<&CommitReport> = commits.iter().map(|(report, _)| *report).collect();
        let replies = self.commit_in(tx, known, &reports).await?;
        for ((_, pending), reply) in commits.into_iter().zip(replies) {
            pending.put(reply)?;
        }
        let requests: Vec<(&ClaimRequest, Presence)> = claims
            .iter()
            .map(|(request, presence, _)| (*request, *presence))
            .collect();
        let claimed = self.claim_in(tx, known, &requests).await?;
        for ((.., pending), claimed) in claims.into_iter().zip(claimed) {
            pending.put(claimed)?;
        }
        Ok(())
    }
}

impl Operation {
    fn step(&self) -> Step {
        match self {
            Operation::Claim(..) => Step::Claim,
            Operation::Heartbeat(..) => Step::Heartbeat,
            Operation::Commit(..) => Step::Commit,
            Operation::Release(..) => Step::Release,
        }
    }

    fn fail(&mut self, error: StoreError) {
        match self {
            Operation::Claim(.., pending) => pending.answer = Some(Err(error.into())),
            Operation::Heartbeat(.., pending) => pending.answer = Some(Err(error.into())),
            Operation::Commit(.., pending) => pending.answer = Some(Err(error.into())),
            Operation::Release(.., pending) => pending.answer = Some(Err(error.into())),
        }
    }

    fn reply(self) {
        match self {
            Operation::Claim(.., pending) => pending.reply(),
            Operation::Heartbeat(.., pending) => pending.reply(),
            Operation::Commit(.., pending) => pending.reply(),
            Operation::Release(.., pending) => pending.reply(),
        }
    }
}

impl<T> Pending<T> {
    /// Keeps an answer until the transaction ends. A database that fails ends
    /// the whole transaction.
    fn put(&mut self, answer: Result<T, QueueError>) -> Result<(), StoreError> {
        match answer {
            Err(QueueError::Store(error)) => Err(error),
            answer => {
                self.answer = Some(answer);
                Ok(())
            }
        }
    }

    fn reply(self) {
        if let Some(answer) = self.answer {
            // Who asked may have gone.
            let _ = self.reply.send(answer);
        }
    }
}
