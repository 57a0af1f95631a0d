//! How an attempt ends that brought a result. What is reported at the same time
//! is stored at once, by the same few statements, as far as it is plain: the
//! reporter holds the lease, the result agrees with its siblings, and the
//! policy's health stays what it is. The rest is looked at one by one, after.

use sqlx::SqliteConnection;

use super::known::{Known, Owner};
use super::writer::Operation;
use super::{Queue, QueueError};
use crate::clock::UnixMillis;
use crate::ids::{JobId, LeaseRef};
use crate::lease::{CommitJudgement, FailureReason, Job, OutcomeKey};
use crate::pairing::{self, Demand};
use crate::store::jobs::ReportedJob;
use crate::store::motions::Motion;
use crate::store::results::{Digests, NewResult, Outcome, Provenance, Sibling};
use crate::store::{StoreError, jobs, motions, results, workers};

/// An outcome as a worker reports it.
#[derive(Clone, Debug)]
pub struct CommitReport {
    /// Under which lease.
    pub lease: LeaseRef,
    /// What came out.
    pub outcome: Outcome,
    /// Where it came from.
    pub provenance: Provenance,
    /// What makes it comparable.
    pub digests: Digests,
    /// How the robot moved.
    pub motion: Motion,
}

/// What became of a reported outcome.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CommitVerdict {
    /// Stored.
    Accepted,
    /// Stored before with this outcome.
    Duplicate,
    /// A newer attempt owns the job: refused and counted.
    Stale,
    /// Stored before with another outcome: kept apart.
    Divergent,
    /// Disagrees with its configuration's siblings: refused and charged.
    Unpaired,
}

/// The answer to a reported outcome.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CommitReply {
    /// What became of it.
    pub verdict: CommitVerdict,
    /// In words, unless it was accepted.
    pub detail: String,
}

/// What speaks about a result that its reporter may store.
enum Finding {
    /// Nothing against it.
    Plain,
    /// It ends its policy's outage.
    Heals,
    /// It disagrees with its siblings, in words.
    Unpaired(String),
}

impl Queue {
    /// Stores an outcome and ends its lease, or says why not.
    ///
    /// # Errors
    /// When the job is unknown or the database fails.
    pub async fn commit(&self, report: &CommitReport) -> Result<CommitReply, QueueError> {
        let lease = &report.lease;
        let report = Box::new(report.clone());
        let reply = self
            .ask(|pending| Operation::Commit(report, pending))
            .await?;
        if reply.verdict != CommitVerdict::Accepted {
            tracing::warn!(job = %lease.job, worker = %lease.worker, verdict = ?reply.verdict,
                "{}", reply.detail);
        }
        Ok(reply)
    }

    /// What becomes of outcomes that were reported at the same time.
    pub(super) async fn commit_in(
        &self,
        tx: &mut SqliteConnection,
        known: &mut Known,
        reports: &[&CommitReport],
    ) -> Result<Vec<Result<CommitReply, QueueError>>, StoreError> {
        if reports.is_empty() {
            return Ok(Vec::new());
        }
        let now = self.now();
        let ids: Vec<JobId> = reports.iter().map(|report| report.lease.job).collect();
        let mut reported = jobs::reported(tx, &ids).await?;
        let mut plain = Vec::new();
        let mut others = Vec::new();
        for report in reports {
            // Taken out: of two reports of one job, the second finds the first
            // one's result.
            let job = reported.remove(&report.lease.job);
            let job = job.filter(|job| judge(job, report, true) == CommitJudgement::Accept);
            match &job {
                Some(job) if self.finding(tx, known, job, report, now).await?.is_plain() => {
                    plain.push(self.new_result(tx, known, job, report).await?);
                }
                _ => others.push(*report),
            }
        }
        store(tx, &plain, now).await?;
        let mut replies = Vec::with_capacity(reports.len());
        let mut others = others.into_iter().peekable();
        for report in reports {
            let is_other = others.next_if(|other| std::ptr::eq(*other, *report));
            replies.push(match is_other {
                None => Ok(CommitReply::accepted()),
                Some(_) => match self.commit_alone(tx, known, report, now).await {
                    Err(QueueError::Store(error)) => return Err(error),
                    reply => reply,
                },
            });
        }
        Ok(replies)
    }

    /// What becomes of an outcome that may be anything.
    async fn commit_alone(
        &self,
        tx: &mut SqliteConnection,
        known: &mut Known,
        report: &CommitReport,
        now: UnixMillis,
    ) -> Result<CommitReply, QueueError> {
        let lease = &report.lease;
        let reported = jobs::reported(tx, &[lease.job]).await?.remove(&lease.job);
        let reported = reported.ok_or(QueueError::UnknownJob { job: lease.job })?;
        let granted = reported.stored.is_some() && jobs::was_granted(tx, lease).await?;
        let judgement = judge(&reported, report, granted);
        if judgement == CommitJudgement::Accept {
            return Ok(self.accept(tx, known, &reported, report, now).await?);
        }
        workers::seen(tx, &[&lease.worker], now).await?;
        Ok(match judgement {
            CommitJudgement::Accept | CommitJudgement::Duplicate => CommitReply {
                verdict: CommitVerdict::Duplicate,
                detail: "this outcome is stored already".to_owned(),
            },
            CommitJudgement::Divergent => {
                let (outcome, provenance) = (&report.outcome, &report.provenance);
                results::insert_divergence(tx, lease, outcome, provenance, now).await?;
                divergent(&reported, key(&report.outcome))
            }
            CommitJudgement::Stale => {
                jobs::count_stale_report(tx, lease.job).await?;
                stale(&reported.job, lease)
            }
        })
    }

    /// The reporter holds the lease: stores the result, unless it disagrees
    /// with its siblings.
    async fn accept(
        &self,
        tx: &mut SqliteConnection,
        known: &mut Known,
        reported: &ReportedJob,
        report: &CommitReport,
        now: UnixMillis,
    ) -> Result<CommitReply, StoreError> {
        let lease = &report.lease;
        let finding = self.finding(tx, known, reported, report, now).await?;
        if let Finding::Unpaired(detail) = finding {
            known.forget_owners();
            workers::seen(tx, &[&lease.worker], now).await?;
            let failure = (FailureReason::Unpaired, detail.as_str());
            let (job, campaign) = (&reported.job, reported.of.campaign);
            self.end_attempt(tx, job, campaign, lease, failure, now)
                .await?;
            return Ok(CommitReply {
                verdict: CommitVerdict::Unpaired,
                detail,
            });
        }
        let result = self.new_result(tx, known, reported, report).await?;
        store(tx, &[result], now).await?;
        let owner = known.owner(tx, reported.of.campaign).await?;
        let after = owner.health.after_commit((lease.job, lease.attempt), now);
        if after != owner.health {
            known.forget_owners();
            self.set_health(tx, owner.policy, (&owner.health, &after), now)
                .await?;
        }
        Ok(CommitReply::accepted())
    }

    /// What speaks about a result whose reporter holds the lease.
    async fn finding(
        &self,
        tx: &mut SqliteConnection,
        known: &mut Known,
        reported: &ReportedJob,
        report: &CommitReport,
        now: UnixMillis,
    ) -> Result<Finding, StoreError> {
        let owner = known.owner(tx, reported.of.campaign).await?;
        let Owner {
            campaign, health, ..
        } = &*owner;
        let demand = Demand {
            pin: campaign.pin(),
            realisation: campaign.mode()?,
            row: &reported.row,
        };
        let siblings = known.siblings(tx, &reported.of).await?;
        let (provenance, digests) = (&report.provenance, &report.digests);
        if let Some(detail) = pairing::difference(&demand, siblings, provenance, digests) {
            return Ok(Finding::Unpaired(detail));
        }
        let after = health.after_commit((report.lease.job, report.lease.attempt), now);
        Ok(if after == *health {
            Finding::Plain
        } else {
            Finding::Heals
        })
    }

    /// A result that goes in; from now on its siblings are compared with it.
    async fn new_result<'a>(
        &self,
        tx: &mut SqliteConnection,
        known: &mut Known,
        reported: &ReportedJob,
        report: &'a CommitReport,
    ) -> Result<NewResult<'a>, StoreError> {
        let (provenance, digests) = (&report.provenance, &report.digests);
        let origin = known.origin(tx, provenance).await?;
        let rollout = reported.row.id;
        let sibling = Sibling::new(rollout, &report.lease.worker, provenance, digests);
        known.add_sibling(&reported.of, sibling);
        Ok(NewResult {
            lease: &report.lease,
            campaign: reported.of.campaign,
            outcome: &report.outcome,
            origin,
            digests,
            motion: &report.motion,
        })
    }
}

/// Stores results and ends their leases.
async fn store(
    tx: &mut SqliteConnection,
    results: &[NewResult<'_>],
    now: UnixMillis,
) -> Result<(), StoreError> {
    if results.is_empty() {
        return Ok(());
    }
    results::insert(tx, results, now).await?;
    motions::insert(tx, results).await?;
    let leases: Vec<&LeaseRef> = results.iter().map(|result| result.lease).collect();
    jobs::mark_committed(tx, &leases).await?;
    let workers: Vec<_> = leases.iter().map(|lease| &lease.worker).collect();
    workers::succeeded(tx, &workers, now).await
}

fn judge(reported: &ReportedJob, report: &CommitReport, granted: bool) -> CommitJudgement {
    let (job, stored) = (&reported.job, reported.stored);
    job.judge_commit(&report.lease, granted, key(&report.outcome), stored)
}

fn key(outcome: &Outcome) -> OutcomeKey {
    OutcomeKey {
        success: outcome.success,
        steps: outcome.steps,
    }
}

impl Finding {
    fn is_plain(&self) -> bool {
        matches!(self, Finding::Plain)
    }
}

impl CommitReply {
    fn accepted() -> CommitReply {
        CommitReply {
            verdict: CommitVerdict::Accepted,
            detail: String::new(),
        }
    }
}

fn divergent(reported: &ReportedJob, outcome: OutcomeKey) -> CommitReply {
    let say = |outcome: OutcomeKey| {
        let word = if outcome.success {
            "success"
        } else {
            "failure"
        };
        format!("{word} after {} steps", outcome.steps)
    };
    CommitReply {
        verdict: CommitVerdict::Divergent,
        detail: format!(
            "job {} is committed with {} and was reported again with {}: both are kept",
            reported.job.id,
            reported.stored.map_or_else(String::new, say),
            say(outcome)
        ),
    }
}

fn stale(job: &Job, lease: &LeaseRef) -> CommitReply {
    CommitReply {
        verdict: CommitVerdict::Stale,
        detail: format!(
            "attempt {} of job {} by worker `{}` does not hold the lease (the newest attempt is {})",
            lease.attempt, job.id, lease.worker, job.attempt
        ),
    }
}
