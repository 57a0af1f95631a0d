//! Workers announce themselves.

use super::context::Context;
use super::error::QueueError;
use crate::queue::Queue;
use crate::store::failpoint::Step;
use crate::store::workers::{self, WorkerInfo};

impl Queue {
    /// Registers a worker; one that does so again starts with a clean record.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn register(&self, worker: &WorkerInfo) -> Result<(), QueueError> {
        let mut context = Context::begin(&self.shared, vec![Step::Register]).await?;
        workers::upsert(&mut context.tx, worker, context.now).await?;
        context.commit().await?;
        // One more live worker may free a job that the others failed on.
        self.shared.work.notify_waiters();
        Ok(())
    }
}
