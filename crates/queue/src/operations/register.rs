//! Registration and sign-off of workers.

use super::context::Context;
use super::error::QueueError;
use crate::ids::WorkerId;
use crate::queue::Queue;
use crate::rules::lease::inherited_failures;
use crate::store::failpoint::Step;
use crate::store::workers::{self, WorkerInfo};

impl Queue {
    /// Registers a worker. The worker inherits the number of consecutive failures of the previous
    /// worker on its machine; without a machine's name it starts at zero. Returns the reason why
    /// waiting jobs cannot go to the worker; empty if there is none.
    pub async fn register(&self, worker: &WorkerInfo) -> Result<String, QueueError> {
        let mut context = Context::begin(&self.shared, vec![Step::Register]).await?;
        let in_a_row = match &worker.machine {
            Some(machine) => {
                workers::last_failures_on_machine(&mut context.tx, machine, &worker.id).await?
            }
            None => 0,
        };
        let inherited = inherited_failures(in_a_row);
        workers::upsert(&mut context.tx, worker, inherited, context.now).await?;
        let live = context.live().await?;
        context.shared.means.retain(&live);
        let idle_reason = context.idle_reason(&worker.pin).await?;
        context.commit().await?;
        // A job that failed on the other machines may suit the new worker.
        self.shared.work.notify_waiters();
        Ok(idle_reason)
    }

    /// Records a worker's clean shutdown: the worker counts as gone from now until it registers
    /// again.
    pub async fn sign_off(&self, worker: &WorkerId) -> Result<(), QueueError> {
        let mut context = Context::begin(&self.shared, vec![Step::Register]).await?;
        if !workers::sign_off(&mut context.tx, worker, context.now).await? {
            return Err(QueueError::UnknownWorker { worker: worker.clone() });
        }
        Ok(context.commit().await?)
    }
}
