//! Periodic work of the queue: ends expired leases, and wakes claims that wait for the end of a
//! back-off or pause.

use std::collections::BTreeSet;
use std::sync::atomic::Ordering;

use super::context::Context;
use super::error::QueueError;
use super::start::restart_leases;
use crate::clock::UnixMillis;
use crate::ids::WorkerId;
use crate::queue::Queue;
use crate::rules::lease::{FailureReason, JobState, Lease, was_suspended};
use crate::store::StoreError;
use crate::store::failpoint::Step;
use crate::store::jobs::{self, ExpiredRow};

/// Most leases that one sweep ends.
const MAX_EXPIRED_PER_SWEEP: u32 = 1_024;

impl Queue {
    /// Ends expired leases and wakes claims that wait for the end of a back-off or pause. Called
    /// every [`Timing::sweep`](crate::Timing::sweep). After an error, the next sweep tries again.
    pub async fn sweep(&self) -> Result<(), QueueError> {
        let shared = &*self.shared;
        let last = UnixMillis(self.last_sweep.load(Ordering::Relaxed));
        let mut context = Context::begin(shared, vec![Step::Sweep]).await?;
        let now = context.now;
        let mut has_new_work = false;
        if was_suspended(now.since(last), shared.timing.lease) {
            tracing::warn!(
                "the coordinator was suspended: every lease is restarted with its full duration"
            );
            restart_leases(&mut context).await?;
        } else {
            has_new_work = context.end_expired().await?;
        }
        has_new_work |= shared.passed_over.swap(false, Ordering::Relaxed);
        has_new_work |= jobs::has_ended_wait(&mut context.tx, last, now).await?;
        context.commit().await?;
        self.last_sweep.store(now.0, Ordering::Relaxed);
        if has_new_work {
            shared.work.notify_waiters();
        }
        Ok(())
    }
}

impl Context<'_> {
    /// Ends expired leases and returns true if any lease expired. A worker gets one strike, that
    /// is, one counted failure of its machine, for all leases that its heartbeats omitted or that
    /// reached their ceiling; a worker whose heartbeats stopped gets no strike.
    async fn end_expired(&mut self) -> Result<bool, StoreError> {
        let expired = jobs::expired(&mut self.tx, self.now, MAX_EXPIRED_PER_SWEEP).await?;
        let mut to_strike: BTreeSet<WorkerId> = BTreeSet::new();
        let duration = self.shared.timing.lease;
        for ExpiredRow { leased: row, heartbeat_ms } in &expired {
            let JobState::Leased(lease) = &row.job.state else {
                continue;
            };
            let reason = lease.expiry_reason(*heartbeat_ms, duration);
            let error = explain(reason, lease, row.control_steps);
            tracing::warn!(job = %row.job.id, attempt = %lease.attempt, "lease lost: {error}");
            self.end_attempt((&row.job, lease), row.campaign_id, (reason, &error)).await?;
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
            format!("worker `{owner}` never acknowledged the lease; the answer was probably lost")
        }
        FailureReason::Overdue => format!(
            "worker `{owner}` was at control step {control_steps} when the attempt reached its \
             ceiling after {} s",
            lease.ceiling.since(lease.granted).as_secs()
        ),
        FailureReason::WorkerSilent => {
            format!("worker `{owner}` sent no heartbeat after control step {control_steps}")
        }
        _ => format!(
            "worker `{owner}` sends heartbeats that have omitted this attempt since control step \
             {control_steps}"
        ),
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use futures_util::FutureExt;
    use rand_chacha::ChaCha8Rng;
    use rand_chacha::rand_core::SeedableRng;

    use super::*;
    use crate::clock::SystemClock;
    use crate::store::Store;
    use crate::timing::Timing;

    /// Regression: each returned job woke every waiting claim, and 2,000 slowed all calls sevenfold.
    #[tokio::test]
    async fn a_job_wakes_one_waiting_claim_and_the_others_at_the_next_sweep() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let store = Store::open(folder.path()).await.expect("a store");
        let (clock, rng) = (Arc::new(SystemClock::start()), ChaCha8Rng::seed_from_u64(1));
        let queue = Queue::start(store, clock, rng, Timing::default()).await.expect("a queue");
        let mut waiting: Vec<_> = (0..9).map(|_| Box::pin(queue.shared.work.notified())).collect();
        let mut woken = || {
            let before = waiting.len();
            waiting.retain_mut(|claim| claim.now_or_never().is_none());
            before - waiting.len()
        };
        assert_eq!(woken(), 0);
        queue.shared.wake_one();
        assert_eq!(woken(), 1);
        queue.sweep().await.expect("swept");
        assert_eq!(woken(), 8);
    }
}
