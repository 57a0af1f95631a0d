//! Workers announce themselves.

use super::context::Context;
use super::shared::Shared;
use crate::store::failpoint::Step;
use crate::store::workers::WorkerInfo;
use crate::store::{StoreError, workers};

/// Registers a worker; one that does so again starts with a clean record.
pub(crate) async fn register(shared: &Shared, worker: &WorkerInfo) -> Result<(), StoreError> {
    let mut context = Context::begin(shared, vec![Step::Register]).await?;
    workers::upsert(&mut context.tx, worker, context.now).await?;
    context.commit().await?;
    // One more live worker may free a job that the others failed on.
    shared.work.notify_waiters();
    Ok(())
}
