//! What happens to leases when the coordinator starts, and when it was
//! suspended.

use super::context::Context;
use super::shared::Shared;
use crate::store::failpoint::Step;
use crate::store::{StoreError, backup, jobs};

/// Gives every lease its full time again: while the coordinator was down, no
/// heartbeat could arrive.
pub(crate) async fn start(shared: &Shared) -> Result<(), StoreError> {
    backup::remove_leftover(shared.store.folder());
    let mut context = Context::begin(shared, vec![Step::Start]).await?;
    restart_clocks(&mut context).await?;
    context.commit().await
}

pub(super) async fn restart_clocks(context: &mut Context<'_>) -> Result<(), StoreError> {
    let expires = context.now.plus(context.shared.timing.lease);
    let latest = context.now.plus(attempt::Waits::USUAL.longest);
    jobs::restart_clocks(&mut context.tx, expires, latest).await
}
