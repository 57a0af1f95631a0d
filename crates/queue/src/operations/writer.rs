//! Group commit: requests of workers are collected while one transaction runs and are executed
//! together in the next transaction, so that many answers share one `fsync`.
//!
//! A failing operation does not fail the others: the transaction is rolled back and each operation
//! is retried in its own transaction. If a transaction cannot begin, all its operations fail.

use std::sync::Arc;

use benchmark::attempt::AttemptId;
use tokio::sync::{mpsc, oneshot};

use super::claim::{ClaimRequest, Claimed};
use super::commit::{CommitReply, CommitReport};
use super::context::Context;
use super::error::QueueError;
use super::heartbeat::Heartbeat;
use super::release::{Release, ReleaseReply};
use super::shared::Shared;
use crate::store::StoreError;
use crate::store::failpoint::Step;

const MAX_BATCH: usize = 256;
/// Most operations that wait for a transaction; further callers wait to submit their operations.
pub(crate) const MAX_WAITING: usize = 4_096;

pub(crate) enum Operation {
    /// Leases a job. The flag is true for a new claim, and false for a retry of a waiting claim
    /// that was woken.
    Claim(Box<Pending<(ClaimRequest, bool), Claimed>>),
    Heartbeat(Pending<Heartbeat, Vec<AttemptId>>),
    Commit(Pending<Box<CommitReport>, CommitReply>),
    /// Ends an attempt without a result.
    Release(Pending<Release, ReleaseReply>),
}

/// A request and the channel for its answer, which is sent once the transaction is committed to
/// disk.
pub(crate) struct Pending<Q, A> {
    request: Q,
    answer: Option<Result<A, QueueError>>,
    reply: oneshot::Sender<Result<A, QueueError>>,
}

/// Executes operations until all senders are dropped.
pub(crate) async fn run(shared: Arc<Shared>, mut operations: mpsc::Receiver<Operation>) {
    let mut batch = Vec::with_capacity(MAX_BATCH);
    while operations.recv_many(&mut batch, MAX_BATCH).await > 0 {
        write(&shared, &mut batch).await;
        for operation in batch.drain(..) {
            operation.reply();
        }
    }
}

async fn write(shared: &Shared, batch: &mut [Operation]) {
    let fail_all = |batch: &mut [Operation], error: &StoreError| {
        for operation in batch {
            operation.fail(error.clone());
        }
    };
    let context = match Context::begin(shared, steps(batch)).await {
        Ok(context) => context,
        Err(error) => return fail_all(batch, &error),
    };
    match transact(context, batch).await {
        Ok(()) => {}
        Err(error) if batch.len() == 1 => fail_all(batch, &error),
        Err(_) => {
            for single in batch.chunks_mut(1) {
                Box::pin(write(shared, single)).await;
            }
        }
    }
}

/// Executes operations in one transaction, which has no effect if an error is returned. None of the
/// operations can depend on the answer of another, so they may be reordered: those that make jobs
/// leasable go first.
async fn transact(
    mut context: Context<'_>,
    operations: &mut [Operation],
) -> Result<(), StoreError> {
    let (mut claims, mut heartbeats, mut commits) = (Vec::new(), Vec::new(), Vec::new());
    for operation in operations {
        match operation {
            // A lease for a worker that has disconnected would only expire.
            Operation::Claim(pending) if pending.reply.is_closed() => {}
            Operation::Claim(pending) => claims.push(&mut **pending),
            Operation::Heartbeat(pending) => heartbeats.push(pending),
            Operation::Commit(pending) => commits.push(pending),
            Operation::Release(pending) => {
                pending.answer = Some(context.release(&pending.request).await?);
            }
        }
    }
    let reports: Vec<_> = commits.iter().map(|commit| &*commit.request).collect();
    answer(context.store_results(&reports).await?, commits);
    let requests: Vec<_> = heartbeats.iter().map(|heartbeat| &heartbeat.request).collect();
    answer(context.heartbeat(&requests).await?, heartbeats);
    let requests: Vec<_> = claims.iter().map(|claim| (&claim.request.0, claim.request.1)).collect();
    answer(context.claim(&requests).await?, claims);
    context.commit().await
}

fn answer<Q, A>(answers: Vec<Result<A, QueueError>>, pending: Vec<&mut Pending<Q, A>>) {
    for (pending, answer) in pending.into_iter().zip(answers) {
        pending.answer = Some(answer);
    }
}

fn steps(operations: &[Operation]) -> Vec<Step> {
    let mut steps: Vec<Step> = operations.iter().map(Operation::step).collect();
    steps.sort_unstable();
    steps.dedup();
    steps
}

impl Operation {
    fn step(&self) -> Step {
        match self {
            Operation::Claim(_) => Step::Claim,
            Operation::Heartbeat(_) => Step::Heartbeat,
            Operation::Commit(_) => Step::Commit,
            Operation::Release(_) => Step::Release,
        }
    }

    fn fail(&mut self, error: StoreError) {
        match self {
            Operation::Claim(pending) => pending.answer = Some(Err(error.into())),
            Operation::Heartbeat(pending) => pending.answer = Some(Err(error.into())),
            Operation::Commit(pending) => pending.answer = Some(Err(error.into())),
            Operation::Release(pending) => pending.answer = Some(Err(error.into())),
        }
    }

    fn reply(self) {
        match self {
            Operation::Claim(pending) => pending.reply(),
            Operation::Heartbeat(pending) => pending.reply(),
            Operation::Commit(pending) => pending.reply(),
            Operation::Release(pending) => pending.reply(),
        }
    }
}

impl<Q, A> Pending<Q, A> {
    pub(crate) fn new(request: Q) -> (Pending<Q, A>, oneshot::Receiver<Result<A, QueueError>>) {
        let (reply, answer) = oneshot::channel();
        let pending = Pending { request, answer: None, reply };
        (pending, answer)
    }

    fn reply(self) {
        if let Some(answer) = self.answer {
            // The caller may have disconnected.
            let _ = self.reply.send(answer);
        }
    }
}

#[cfg(test)]
mod tests {
    use std::time::{Duration, Instant};

    use rand_chacha::ChaCha8Rng;
    use rand_chacha::rand_core::SeedableRng;
    use sqlx::{ConnectOptions, Connection, sqlite::SqliteConnectOptions};

    use super::*;
    use crate::clock::SystemClock;
    use crate::ids::WorkerId;
    use crate::queue::Queue;
    use crate::store::{DATABASE_FILE, Store};
    use crate::timing::Timing;

    /// Regression: a transaction that could not begin was retried for each of its operations, up to
    /// 256 consecutive waits for the lock.
    #[tokio::test(flavor = "multi_thread")]
    async fn a_transaction_that_cannot_begin_fails_all_of_its_operations_at_once() {
        const OPERATIONS: u32 = 40;
        const BUSY: Duration = Duration::from_millis(400);
        let folder = tempfile::tempdir().expect("a temporary folder");
        let store = Store::open(folder.path()).await.expect("a store");
        store.set_lock_timeout(BUSY).await;
        let (clock, rng) = (Arc::new(SystemClock::start()), ChaCha8Rng::seed_from_u64(1));
        let queue = Queue::start(store, clock, rng, Timing::default()).await;
        let queue = queue.expect("a queue");
        let options = SqliteConnectOptions::new().filename(folder.path().join(DATABASE_FILE));
        let mut other = options.connect().await.expect("a connection");
        let lock = other.begin_with("BEGIN IMMEDIATE").await.expect("the lock");

        let began = Instant::now();
        let worker = WorkerId("a".to_owned());
        let beats = (0..OPERATIONS).map(|_| queue.heartbeat(&worker, &[]));
        for refused in futures_util::future::join_all(beats).await {
            let error = refused.expect_err("another connection holds the lock");
            assert!(matches!(error, QueueError::Store(_)), "{error:?}");
        }
        // One wait for the lock by the first operation, and one by those that arrived in the
        // meantime.
        assert!(began.elapsed() < BUSY * OPERATIONS / 4);
        lock.rollback().await.expect("a released lock");
        // Requests are answered again; no worker with this name is registered.
        let answer = queue.heartbeat(&worker, &[]).await;
        assert!(matches!(answer, Err(QueueError::UnknownWorker { .. })), "{answer:?}");
    }
}
