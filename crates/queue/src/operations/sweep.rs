//! What the queue does by itself: expired leases are taken away, and claims that
//! wait for a back-off or a pause are woken when it ends.

use std::collections::BTreeSet;

use super::context::Context;
use super::error::QueueError;
use super::shared::Shared;
use crate::clock::UnixMillis;
use crate::ids::WorkerId;
use crate::rules::lease::{FailureReason, JobState, Lease, was_asleep};
use crate::store::failpoint::Step;
use crate::store::{StoreError, jobs};

/// Leases that one sweep takes away.
const MAX_EXPIRED_PER_SWEEP: u32 = 1_024;

/// Sweeps, `last` being when it was last done. Returns when it was done now.
pub(crate) async fn sweep(shared: &Shared, last: UnixMillis) -> Result<UnixMillis, QueueError> {
    let mut context = Context::begin(shared, vec![Step::Sweep]).await?;
    let now = context.now;
    let mut is_news = false;
    if was_asleep(now.since(last), shared.timing.lease) {
        tracing::warn!("the coordinator was asleep: every lease gets its full time again");
        restart_clocks(&mut context).await?;
    } else {
        is_news = context.take_expired().await?;
    }
    is_news |= jobs::fell_due(&mut context.tx, last, now).await?;
    context.commit().await?;
    if is_news {
        shared.work.notify_waiters();
    }
    Ok(now)
}

/// Gives every lease its full time again: while nobody listened, no heartbeat
/// could arrive.
pub(crate) async fn start(shared: &Shared) -> Result<(), StoreError> {
    let mut context = Context::begin(shared, vec![Step::Start]).await?;
    restart_clocks(&mut context).await?;
    context.commit().await
}

async fn restart_clocks(context: &mut Context<'_>) -> Result<(), StoreError> {
    let expires = context.now.plus(context.shared.timing.lease);
    let latest = context.now.plus(attempt::Waits::USUAL.longest);
    jobs::restart_clocks(&mut context.tx, expires, latest).await
}

impl Context<'_> {
    /// Takes expired leases away. A worker that falls silent loses all its
    /// slots' leases at once; that is one strike against it, however many slots
    /// it has. Answers whether there were any.
    async fn take_expired(&mut self) -> Result<bool, StoreError> {
        let expired = jobs::expired(&mut self.tx, self.now, MAX_EXPIRED_PER_SWEEP).await?;
        let mut to_strike: BTreeSet<WorkerId> = BTreeSet::new();
        for row in &expired {
            let JobState::Leased(lease) = &row.job.state else {
                continue;
            };
            let reason = lease.why_expired(self.now);
            let error = explain(reason, lease, row.control_steps);
            tracing::warn!(job = %row.job.id, attempt = %lease.attempt, "lease lost: {error}");
            self.end_attempt((&row.job, lease), row.campaign_id, (reason, &error))
                .await?;
            if reason.is_charged() {
                to_strike.insert(lease.owner.clone());
            }
        }
        for worker in &to_strike {
            self.strike(worker, "its leases expired").await?;
        }
        Ok(!expired.is_empty())
    }
}

fn explain(reason: FailureReason, lease: &Lease, control_steps: u32) -> String {
    let owner = &lease.owner;
    match reason {
        FailureReason::NeverAcknowledged => {
            format!("worker `{owner}` never acknowledged the lease: was the answer lost?")
        }
        FailureReason::Overdue => format!(
            "worker `{owner}` was at control step {control_steps} when the attempt reached its \
             ceiling after {} s",
            lease.ceiling.since(lease.granted).as_secs()
        ),
        _ => format!("worker `{owner}` fell silent after control step {control_steps}"),
    }
}
