//! Restart of all leases when the coordinator starts, and after the machine was suspended.

use super::context::Context;
use super::shared::Shared;
use crate::store::failpoint::Step;
use crate::store::{StoreError, backup, jobs};

/// Restarts every lease, since no heartbeat could arrive while the coordinator was down.
pub(crate) async fn start(shared: &Shared) -> Result<(), StoreError> {
    backup::remove_leftover(shared.store.folder());
    let mut context = Context::begin(shared, vec![Step::Start]).await?;
    restart_leases(&mut context).await?;
    context.commit().await
}

pub(super) async fn restart_leases(context: &mut Context<'_>) -> Result<(), StoreError> {
    let expires = context.now.plus(context.shared.timing.lease);
    jobs::restart_leases(&mut context.tx, expires).await
}
