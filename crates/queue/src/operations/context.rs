//! The writing transaction with the context of an operation: cached rows and the current instant.
//! Also holds the actions that several operations share, such as the end of an attempt.

use std::borrow::Cow;
use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::Duration;

use benchmark::attempt::Waits;
use tokio::sync::MutexGuard;

use super::cache::Cache;
use super::shared::Shared;
use crate::clock::UnixMillis;
use crate::ids::{CampaignId, WorkerId};
use crate::rules::lease::{
    AfterFailure, FailureReason, Job, Lease, MAX_WORKER_FAILURES_IN_A_ROW, Suspicion, strike,
};
use crate::rules::outage::{Allowance, PolicyHealth, PolicyState};
use crate::store::campaigns::Campaign;
use crate::store::failpoint::Step;
use crate::store::jobs::NamedAttempt;
use crate::store::workers::Live;
use crate::store::{StoreError, Tx, jobs, policies, workers};

/// Longest time after a policy's pause for which a job that could not reach the policy yields to
/// other jobs, whose workers may claim them only a few seconds after the pause ends.
const MAX_YIELD: Duration = Duration::from_secs(10);

/// The writing transaction, rolled back on drop.
pub(crate) struct Context<'a> {
    pub(super) shared: &'a Shared,
    pub(super) tx: Tx<'a>,
    pub(super) cache: MutexGuard<'a, Cache>,
    pub(super) now: UnixMillis,
    /// True if a campaign may stop early after the transaction, for example because it settles a
    /// job.
    pub(super) settles: bool,
}

/// Rewrites an error for a sentence that already names the policy: replaces a leading "policy `bad`
/// at ADDRESS" by "it".
fn without_policy_name<'e>(policy: &str, error: &'e str) -> Cow<'e, str> {
    let address_first = error.strip_prefix(&format!("policy `{policy}` at "));
    match address_first.and_then(|rest| rest.split_once(' ')) {
        Some((_, rest)) => format!("it {rest}").into(),
        None => error.into(),
    }
}

/// End of an attempt without a result.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Ended {
    /// Next step of the attempt's job.
    pub(super) next_step: AfterFailure,
    /// Time until the policy may be tried again; zero unless the attempt could not reach the
    /// policy, or lost it.
    pub(super) policy_wait: Duration,
}

impl<'a> Context<'a> {
    /// Waits until the preceding writing transaction has ended, and begins the one that carries out
    /// `steps`.
    pub(super) async fn begin(
        shared: &'a Shared,
        steps: Vec<Step>,
    ) -> Result<Context<'a>, StoreError> {
        Ok(Context::within(shared, shared.store.write(steps).await?).await)
    }

    /// Wraps a transaction that has already begun.
    pub(super) async fn within(shared: &'a Shared, tx: Tx<'a>) -> Context<'a> {
        let mut cache = shared.cache.lock().await;
        cache.begin();
        Context { tx, cache, now: shared.now(), settles: false, shared }
    }

    pub(super) async fn commit(mut self) -> Result<(), StoreError> {
        self.tx.commit().await?;
        self.cache.committed();
        if self.settles {
            self.shared.settled.send_replace(());
        }
        Ok(())
    }

    pub(super) async fn campaign(&mut self, id: CampaignId) -> Result<Arc<Campaign>, StoreError> {
        self.cache.campaign(&mut self.tx, id).await
    }

    /// Returns the workers that are alive and may lease.
    pub(super) async fn live(&mut self) -> Result<Arc<Vec<Live>>, StoreError> {
        let since = self.now.minus(self.shared.timing.worker_alive);
        self.cache.live(&mut self.tx, since).await
    }

    /// Returns the machines with a live worker that could run the campaign's jobs of a task.
    pub(super) async fn able_machines(
        &mut self,
        campaign: &Campaign,
        task: &str,
    ) -> Result<BTreeSet<String>, StoreError> {
        let live = self.live().await?;
        let able = live.iter().filter(|worker| {
            campaign.accepts(&worker.pin) && self.shared.means.suffice_for(&worker.id, task)
        });
        Ok(able.map(|worker| worker.machine.clone()).collect())
    }

    /// Restores the lease of an attempt whose worker was cut off and has reconnected. Returns the
    /// lease; `None` if the attempt cannot be resumed.
    pub(super) async fn resume(
        &mut self,
        attempt: &NamedAttempt,
    ) -> Result<Option<Lease>, StoreError> {
        let cut_off = attempt.cut_off.as_ref();
        let Some(lease) = cut_off.and_then(|cut_off| attempt.job.resumable(cut_off, self.now))
        else {
            return Ok(None);
        };
        if self.campaign(attempt.initial_state.campaign).await?.state.is_over() {
            return Ok(None);
        }
        let expires = self.now.plus(self.shared.timing.lease);
        jobs::resume(&mut self.tx, attempt.job.id, lease, expires).await?;
        let owner = &lease.owner;
        tracing::info!(attempt = %attempt.id.0, "worker `{owner}` resumes the attempt");
        Ok(Some(Lease { expires: expires.min(lease.ceiling), ..lease.clone() }))
    }

    /// Ends an attempt that holds its lease, without a result: requeues or quarantines its job and
    /// updates its policy's health.
    pub(super) async fn end_attempt(
        &mut self,
        (job, lease): (&Job, &Lease),
        campaign: CampaignId,
        (reason, error): (FailureReason, &str),
    ) -> Result<Ended, StoreError> {
        let campaign = self.campaign(campaign).await?;
        let jobs::History { task, mut failed_on, mut silent_on } =
            jobs::history(&mut self.tx, job.id).await?;
        // Includes the attempt that ends now, whatever its failure: only the fields that concern
        // this failure are used.
        let standings = workers::standings(&mut self.tx, &[&lease.owner]).await?;
        for machine in standings.into_values().map(|worker| worker.machine) {
            failed_on.push(machine.clone());
            silent_on.push(machine);
        }
        let suspicion = Suspicion {
            silences: u32::try_from(silent_on.len()).unwrap_or(u32::MAX),
            failed_on: failed_on.into_iter().collect(),
            silent_on: silent_on.into_iter().collect(),
            able: self.able_machines(&campaign, &task).await?,
        };
        let now = self.now;
        let before = &campaign.health;
        let id = lease.attempt;
        let is_outage =
            matches!(reason, FailureReason::PolicyUnavailable | FailureReason::PolicyLost);
        let cause = without_policy_name(&campaign.policy, error);
        let after = self.shared.decide(|rng| match reason {
            _ if is_outage => before.after_outage(id, lease.granted, &cause, now, rng),
            FailureReason::PolicyMisbehaved => before.after_misbehaviour(id, &cause, now, rng),
            _ => before.after_other_failure(id, now),
        });
        let mut next_step =
            self.shared.decide(|rng| job.after_failure(reason, &suspicion, now, rng));
        if let (true, PolicyState::Paused { resume, .. }, AfterFailure::Requeue { not_before }) =
            (is_outage && before.is_probe(id), &after.state, &mut next_step)
        {
            // Lets another waiting job be the policy's next probe.
            let wait = resume.since(now).clamp(Waits::USUAL.first, MAX_YIELD);
            *not_before = (*not_before).max(resume.plus(wait));
        }
        let reason = reason.stored_reason(next_step);
        let error = &reason.stored_error(error, job.losses + 1, suspicion.silences);
        jobs::fail(&mut self.tx, job, lease, reason, error, next_step, now).await?;
        if next_step == AfterFailure::Quarantine {
            self.settles = true;
            match reason {
                FailureReason::Skipped => tracing::info!(job = %job.id, "quarantined: {error}"),
                _ => tracing::error!(job = %job.id, "quarantined after its last attempt: {error}"),
            }
        } else if !reason.is_charged() {
            // The job may be leased again at once.
            self.shared.wake_one();
        }
        self.set_health(&campaign, &after).await?;
        let policy_wait = match after.state {
            PolicyState::Paused { resume, .. } if is_outage => resume.since(now),
            _ => Duration::ZERO,
        };
        Ok(Ended { next_step, policy_wait })
    }

    /// Counts one more failure of a worker's machine. Returns the reason why the worker must stop
    /// leasing; `None` if it may continue.
    pub(super) async fn strike(
        &mut self,
        worker: &WorkerId,
        last_error: &str,
    ) -> Result<Option<String>, StoreError> {
        let standings = workers::standings(&mut self.tx, &[worker]).await?;
        let strike = strike(
            standings.get(worker).map_or(0, |worker_standing| worker_standing.charged_in_a_row),
        );
        let stop = strike.stop.then(|| {
            format!(
                "its machine has failed {} times in a row (the limit is \
                 {MAX_WORKER_FAILURES_IN_A_ROW}), the last time with: {last_error}; repair the \
                 machine, then start the worker again",
                strike.in_a_row
            )
        });
        workers::set_strike(&mut self.tx, worker, strike, stop.as_deref()).await?;
        if let Some(reason) = &stop {
            tracing::error!(%worker, "this worker must stop leasing: {reason}");
        }
        Ok(stop)
    }

    /// Stores the health of a campaign's policy if it changed, and wakes waiting claims if its jobs
    /// may be leased now. Woken claims run after this transaction, since there is only one writer.
    pub(super) async fn set_health(
        &mut self,
        campaign: &Campaign,
        after: &PolicyHealth,
    ) -> Result<(), StoreError> {
        let before = &campaign.health;
        if after == before {
            return Ok(());
        }
        if let (PolicyState::Available, PolicyState::Paused { reason, .. }) =
            (&before.state, &after.state)
        {
            tracing::warn!("policy `{}` is paused, its jobs wait: {reason}", campaign.policy);
        }
        if after.allowance(self.now) != Allowance::Nothing {
            self.shared.work.notify_waiters();
        }
        self.cache.clear_campaigns();
        policies::set_health(&mut self.tx, campaign.policy_id, after).await
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Regression: a message read "policy `bad` is paused: policy `bad` at … refused …".
    #[test]
    fn a_reason_after_the_policys_name_does_not_repeat_the_name() {
        for (error, expected) in [
            ("policy `bad` at http://h:1 refused query 0: no", "it refused query 0: no"),
            ("policy `badly` at http://h:1 refused", "policy `badly` at http://h:1 refused"),
            ("connection refused", "connection refused"),
        ] {
            assert_eq!(without_policy_name("bad", error), expected);
        }
    }
}
