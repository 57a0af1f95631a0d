//! Group commit: what workers ask for is gathered while one transaction runs and
//! goes into the next together, so that many answers wait for one `fsync`.
//!
//! An operation that fails does not fail the others: the transaction is undone
//! and each of its operations is tried in one of its own. A transaction that cannot
//! even begin fails all of them at once.

use std::sync::Arc;

use attempt::AttemptId;
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

/// Most operations of one transaction.
const MAX_BATCH: usize = 256;
/// Operations that wait for the next transactions; while there are so many,
/// callers wait to hand in theirs.
pub(crate) const MAX_WAITING: usize = 4_096;

/// What a worker asks for.
pub(crate) enum Operation {
    /// Leases a job. The flag says whether the claim has just come, and not only
    /// been woken while it waited.
    Claim(Pending<(ClaimRequest, bool), Claimed>),
    /// Renews leases.
    Heartbeat(Pending<Heartbeat, Vec<AttemptId>>),
    /// Stores a result.
    Commit(Pending<Box<CommitReport>, CommitReply>),
    /// Ends an attempt without one.
    Release(Pending<Release, ReleaseReply>),
}

/// A request, and its answer, which is given when the transaction is on the disk.
pub(crate) struct Pending<Q, A> {
    request: Q,
    answer: Option<Result<A, QueueError>>,
    reply: oneshot::Sender<Result<A, QueueError>>,
}

/// Executes operations until all senders are gone.
pub(crate) async fn run(shared: Arc<Shared>, mut asked: mpsc::Receiver<Operation>) {
    let mut batch = Vec::with_capacity(MAX_BATCH);
    while asked.recv_many(&mut batch, MAX_BATCH).await > 0 {
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
            for alone in batch.chunks_mut(1) {
                Box::pin(write(shared, alone)).await;
            }
        }
    }
}

/// Executes operations in one transaction: each has its answer then, or nothing
/// at all happened. A worker waits for each answer before it asks for the next
/// thing, so their order is free: what makes jobs leasable goes first.
async fn transact(
    mut context: Context<'_>,
    operations: &mut [Operation],
) -> Result<(), StoreError> {
    let (mut claims, mut heartbeats, mut commits) = (Vec::new(), Vec::new(), Vec::new());
    for operation in operations {
        match operation {
            // A lease for a worker that has gone would only expire.
            Operation::Claim(pending) if pending.reply.is_closed() => {}
            Operation::Claim(pending) => claims.push(pending),
            Operation::Heartbeat(pending) => heartbeats.push(pending),
            Operation::Commit(pending) => commits.push(pending),
            Operation::Release(pending) => {
                pending.answer = Some(context.release(&pending.request).await?);
            }
        }
    }
    let reports: Vec<_> = commits.iter().map(|it| &*it.request).collect();
    answer(context.store_results(&reports).await?, commits);
    let beats: Vec<_> = heartbeats.iter().map(|it| &it.request).collect();
    answer(context.heartbeat(&beats).await?, heartbeats);
    let requests: Vec<_> = claims
        .iter()
        .map(|it| (&it.request.0, it.request.1))
        .collect();
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
    /// A request, and where its answer will come.
    pub(crate) fn new(request: Q) -> (Pending<Q, A>, oneshot::Receiver<Result<A, QueueError>>) {
        let (reply, answer) = oneshot::channel();
        let pending = Pending {
            request,
            answer: None,
            reply,
        };
        (pending, answer)
    }

    fn reply(self) {
        if let Some(answer) = self.answer {
            // The caller may have gone.
            let _ = self.reply.send(answer);
        }
    }
}
