//! End of an attempt with a result. Results that arrive together are judged one after the other,
//! and the accepted results are stored by the same statements.

use benchmark::attempt::{AttemptId, Measurement, Motion, RolloutResult};

use super::context::Context;
use super::error::QueueError;
use crate::rules::lease::{CommitJudgement, FailureReason, Job, JobState, OutcomeKey, Party};
use crate::rules::pairing::{self, Demand, Sibling};
use crate::store::jobs::NamedAttempt;
use crate::store::results::NewResult;
use crate::store::{StoreError, campaigns, jobs, results, workers};

#[derive(Clone, Debug)]
pub struct CommitReport {
    pub attempt: AttemptId,
    pub measurement: Measurement,
    pub motion: Motion,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CommitVerdict {
    Accepted,
    /// The same outcome of the job is already stored.
    Duplicate,
    /// Refused and counted, because the attempt no longer holds the lease.
    Stale,
    /// A different outcome of the job is already stored; this one is recorded separately.
    Divergent,
    /// Refused, because the result is inconsistent with its siblings, its campaign or its manifest
    /// row. The attempt is charged, unless the worker is not to blame: the campaign was pinned only
    /// after the lease was granted, another policy answered, or the siblings cannot be read.
    Unpaired,
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CommitReply {
    pub verdict: CommitVerdict,
    /// Explanation in words; empty if the result was accepted.
    pub detail: String,
}

impl Context<'_> {
    pub(super) async fn store_results(
        &mut self,
        reports: &[&CommitReport],
    ) -> Result<Vec<Result<CommitReply, QueueError>>, StoreError> {
        if reports.is_empty() {
            return Ok(Vec::new());
        }
        let attempts: Vec<AttemptId> = reports.iter().map(|report| report.attempt).collect();
        let mut named = jobs::attempts_by_id(&mut self.tx, &attempts).await?;
        let mut accepted = Vec::new();
        let mut replies = Vec::with_capacity(reports.len());
        for report in reports {
            let Some(attempt) = named.get_mut(&report.attempt) else {
                let attempt = report.attempt;
                replies.push(Err(QueueError::UnknownAttempt { attempt }));
                continue;
            };
            if let Some(lease) = self.resume(attempt).await? {
                attempt.job.state = JobState::Leased(lease);
            }
            let reply = self.judge(attempt, report, &mut accepted).await?;
            // A second report of the same attempt must find the result of the first.
            if reply.verdict == CommitVerdict::Accepted {
                attempt.stored = Some(key(&report.measurement.result));
                attempt.job.state = JobState::Committed;
            }
            replies.push(Ok(reply));
        }
        if !accepted.is_empty() {
            results::insert(&mut self.tx, &accepted, self.now).await?;
            let attempts: Vec<_> = accepted.iter().map(|new| new.attempt).collect();
            jobs::mark_committed(&mut self.tx, &attempts).await?;
            let reporters: Vec<_> = accepted.iter().map(|new| &new.worker).collect();
            workers::record_successes(&mut self.tx, &reporters, self.now).await?;
            self.settles = true;
        }
        Ok(replies)
    }

    /// Judges one result and appends it to `accepted` if it is to be stored.
    async fn judge<'r>(
        &mut self,
        attempt: &NamedAttempt,
        report: &'r CommitReport,
        accepted: &mut Vec<NewResult<'r>>,
    ) -> Result<CommitReply, StoreError> {
        let Measurement { result, provenance } = &report.measurement;
        let reported = key(result);
        let job = &attempt.job;
        Ok(match job.judge_commit(attempt.id.0, reported, attempt.stored) {
            CommitJudgement::Accept => return self.accept(attempt, report, accepted).await,
            CommitJudgement::Duplicate => CommitReply {
                verdict: CommitVerdict::Duplicate,
                detail: "this outcome is already stored".to_owned(),
            },
            CommitJudgement::Divergent => {
                let (origin, _) = self.cache.origin(&mut self.tx, provenance).await?;
                let by = (attempt.number, &attempt.worker);
                results::insert_divergence(&mut self.tx, job.id, by, result, origin, self.now)
                    .await?;
                divergent(attempt, reported)
            }
            CommitJudgement::Stale => {
                jobs::count_stale_report(&mut self.tx, job.id).await?;
                stale(attempt)
            }
        })
    }

    /// Accepts the result of an attempt that holds the lease, unless the result disagrees with its
    /// campaign, its manifest row or its siblings.
    async fn accept<'r>(
        &mut self,
        attempt: &NamedAttempt,
        report: &'r CommitReport,
        accepted: &mut Vec<NewResult<'r>>,
    ) -> Result<CommitReply, StoreError> {
        let campaign = self.campaign(attempt.initial_state.campaign).await?;
        let Measurement { result, provenance } = &report.measurement;
        let from = &provenance.pin;
        if !campaign.accepts(from) {
            let (name, demand) = (&campaign.name, campaign.demand());
            let detail = format!("campaign `{name}` {demand} and this result is of {from}");
            // Not charged if another result pinned the campaign after this lease was granted.
            let lease = attempt.job.lease_of(attempt.id.0);
            let reason = match lease.is_some_and(|lease| campaign.pinned_ms >= Some(lease.granted))
            {
                true => FailureReason::Unsuited,
                false => FailureReason::Unpaired,
            };
            return self.refuse(attempt, reason, detail).await;
        }
        let wanted = match attempt.row.id.condition().sets_execution() {
            true => attempt.row.execution.to_string(),
            false => campaign.execution.clone(),
        };
        let reported = provenance.execution();
        if reported != wanted {
            let (name, id) = (&campaign.name, attempt.row.id);
            let detail = format!(
                "{id} of campaign `{name}` runs under execution model `{wanted}` and this result \
                 under `{reported}`: update the worker's program"
            );
            return self.refuse(attempt, FailureReason::Unpaired, detail).await;
        }
        let suite = attempt.row.id.task().suite();
        let measured = self.cache.measured(&mut self.tx, campaign.id, suite).await?;
        let difference = measured.and_then(|pinned| provenance.policy_difference(&pinned));
        if let Some(difference) = difference {
            let name = &campaign.name;
            let detail = format!(
                "the policy is not the one that campaign `{name}` has measured in {suite}: its \
                 {difference}; serve that policy again, or create another campaign"
            );
            let reason = FailureReason::PolicyUnavailable;
            return self.refuse(attempt, reason, detail).await;
        }
        if let Some(detail) = pairing::impossible_count(&attempt.row, result) {
            return self.refuse(attempt, FailureReason::Unpaired, detail).await;
        }
        let demand = Demand { realisation: campaign.mode()?, row: &attempt.row };
        let (number, origin) = self.cache.origin(&mut self.tx, provenance).await?;
        let sibling = Sibling {
            rollout: attempt.row.id,
            worker: attempt.worker.clone(),
            digests: result.digests.clone(),
            realised: result.realised.clone(),
            origin,
        };
        // A variant is compared with no other rollout, and a task may have hundreds of variants.
        let has_siblings = attempt.row.id.variant().is_none();
        let siblings = match has_siblings {
            true => self.cache.siblings(&mut self.tx, &attempt.initial_state).await,
            false => Ok(&[][..]),
        };
        let siblings = match siblings {
            Err(error) if error.is_undecodable() => {
                // No result of this initial state can be compared, so the worker is not charged.
                let detail = format!(
                    "the results of its siblings cannot be read (failed to {}); restore the \
                     database from a backup, or skip the rollout",
                    error.with_cause()
                );
                return self.refuse(attempt, FailureReason::Unsuited, detail).await;
            }
            siblings => siblings?,
        };
        if let Some(detail) = pairing::difference(&demand, siblings, &sibling) {
            return self.refuse(attempt, FailureReason::Unpaired, detail).await;
        }
        if !campaign.is_pinned() {
            campaigns::pin(&mut self.tx, campaign.id, from, self.now).await?;
            self.cache.clear_campaigns();
        }
        // Later results are compared with this one.
        self.cache.add_measured(campaign.id, suite, &sibling.origin);
        if has_siblings {
            self.cache.add_sibling(&attempt.initial_state, sibling);
        }
        let after = campaign.health.after_commit(attempt.id.0, self.now);
        self.set_health(&campaign, &after).await?;
        accepted.push(NewResult {
            attempt: attempt.id.0,
            job: attempt.job.id,
            number: attempt.number,
            worker: attempt.worker.clone(),
            campaign: attempt.initial_state.campaign,
            result,
            origin: number,
            motion: &report.motion,
        });
        Ok(CommitReply { verdict: CommitVerdict::Accepted, detail: String::new() })
    }

    async fn refuse(
        &mut self,
        attempt: &NamedAttempt,
        reason: FailureReason,
        detail: String,
    ) -> Result<CommitReply, StoreError> {
        if let Some(lease) = attempt.job.lease_of(attempt.id.0) {
            let failure = (reason, detail.as_str());
            self.end_attempt((&attempt.job, lease), attempt.initial_state.campaign, failure)
                .await?;
            if reason.blames() == Some(Party::Machine) {
                self.strike(&lease.owner, &detail).await?;
            }
        }
        Ok(CommitReply { verdict: CommitVerdict::Unpaired, detail })
    }
}

fn key(result: &RolloutResult) -> OutcomeKey {
    OutcomeKey { success: result.success, steps: result.steps }
}

fn divergent(attempt: &NamedAttempt, outcome: OutcomeKey) -> CommitReply {
    let describe = |outcome: OutcomeKey| {
        let word = if outcome.success { "success" } else { "failure" };
        format!("{word} after {} steps", outcome.steps)
    };
    CommitReply {
        verdict: CommitVerdict::Divergent,
        detail: format!(
            "job {} is committed with {} and was reported again with {}: both are kept",
            attempt.job.id,
            attempt.stored.map_or_else(String::new, describe),
            describe(outcome)
        ),
    }
}

fn stale(attempt: &NamedAttempt) -> CommitReply {
    let Job { id, attempt: newest, .. } = attempt.job;
    CommitReply {
        verdict: CommitVerdict::Stale,
        detail: format!(
            "attempt {} of job {id} by worker `{}` does not hold the lease (the newest attempt \
             is {newest})",
            attempt.number, attempt.worker
        ),
    }
}
