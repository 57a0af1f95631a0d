//! Workers announce themselves, and say good-bye.

use super::context::Context;
use super::error::QueueError;
use crate::ids::WorkerId;
use crate::queue::Queue;
use crate::rules::lease::inherited;
use crate::store::failpoint::Step;
use crate::store::workers::{self, WorkerInfo};

impl Queue {
    /// Registers a worker. It begins with the failures of the worker before it on its
    /// machine, and with none if it does not say on which it runs.
    /// Answers why jobs wait that it cannot have; empty if none do.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn register(&self, worker: &WorkerInfo) -> Result<String, QueueError> {
        let mut context = Context::begin(&self.shared, vec![Step::Register]).await?;
        let in_a_row = match &worker.machine {
            Some(machine) => workers::last_on_machine(&mut context.tx, machine, &worker.id).await?,
            None => 0,
        };
        workers::upsert(&mut context.tx, worker, inherited(in_a_row), context.now).await?;
        let idle_reason = context.idle_reason(&worker.pin).await?;
        context.commit().await?;
        // One more live worker may free a job that the others failed on.
        self.shared.work.notify_waiters();
        Ok(idle_reason)
    }

    /// A worker ended in good order: it counts as gone at once, until it registers
    /// again.
    ///
    /// # Errors
    /// When the worker is unknown or the database fails.
    pub async fn sign_off(&self, worker: &WorkerId) -> Result<(), QueueError> {
        let mut context = Context::begin(&self.shared, vec![Step::Register]).await?;
        if !workers::sign_off(&mut context.tx, worker, context.now).await? {
            return Err(QueueError::UnknownWorker {
                worker: worker.clone(),
            });
        }
        Ok(context.commit().await?)
    }
}
