//! Correction of stored instants when the coordinator starts, and of leases also after it was
//! suspended.

use super::context::Context;
use super::shared::Shared;
use crate::store::failpoint::Step;
use crate::store::{StoreError, backup, instants, jobs};

/// Gives every lease its full time again, since no heartbeat could arrive while the
/// coordinator was down, and sets instants back that lie ahead of the clock.
pub(crate) async fn start(shared: &Shared) -> Result<(), StoreError> {
    backup::remove_leftover(shared.store.folder());
    let mut context = Context::begin(shared, vec![Step::Start]).await?;
    let now = context.now;
    let latest = now.plus(rollout_types::Waits::USUAL.longest);
    instants::set_back(&mut context.tx, now, latest).await?;
    restart_leases(&mut context).await?;
    context.commit().await
}

/// Gives every lease its full time again.
pub(super) async fn restart_leases(context: &mut Context<'_>) -> Result<(), StoreError> {
    let expires = context.now.plus(context.shared.timing.lease);
    jobs::restart_leases(&mut context.tx, expires).await
}
