//! Correction of stored instants when the coordinator starts, and restart of all leases at that
//! time and after the machine was suspended.

use super::context::Context;
use super::shared::Shared;
use crate::store::failpoint::Step;
use crate::store::{StoreError, backup, instants, jobs};

/// Restarts every lease, since no heartbeat could arrive while the coordinator was down, and
/// corrects instants that lie in the future.
pub(crate) async fn start(shared: &Shared) -> Result<(), StoreError> {
    backup::remove_leftover(shared.store.folder());
    let mut context = Context::begin(shared, vec![Step::Start]).await?;
    let now = context.now;
    let latest = now.plus(rollout_types::Waits::USUAL.longest);
    instants::set_back(&mut context.tx, now, latest).await?;
    restart_leases(&mut context).await?;
    context.commit().await
}

/// Restarts every lease with its full duration.
pub(super) async fn restart_leases(context: &mut Context<'_>) -> Result<(), StoreError> {
    let expires = context.now.plus(context.shared.timing.lease);
    jobs::restart_leases(&mut context.tx, expires).await
}
