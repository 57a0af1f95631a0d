//! Renewal of leases. All heartbeats that arrive together are served by the same statements.

use std::collections::BTreeSet;

use benchmark::attempt::AttemptId;

use super::context::Context;
use super::error::QueueError;
use crate::ids::WorkerId;
use crate::store::jobs::{self, Progress};
use crate::store::policies::{self, Probe};
use crate::store::{StoreError, workers};

#[derive(Clone, Debug)]
pub(crate) struct Heartbeat {
    pub(crate) worker: WorkerId,
    /// Attempts of the worker, and the control steps that each has done.
    pub(crate) progress: Vec<(AttemptId, u32)>,
}

impl Context<'_> {
    /// Renews and acknowledges leases, and stores progress. Returns, for each heartbeat, the
    /// attempts whose leases the worker no longer holds.
    pub(super) async fn heartbeat(
        &mut self,
        heartbeats: &[&Heartbeat],
    ) -> Result<Vec<Result<Vec<AttemptId>, QueueError>>, StoreError> {
        if heartbeats.is_empty() {
            return Ok(Vec::new());
        }
        let workers: Vec<_> = heartbeats.iter().map(|heartbeat| &heartbeat.worker).collect();
        let standings = workers::standings(&mut self.tx, &workers).await?;
        workers::record_heartbeats(&mut self.tx, &workers, self.now).await?;
        let progress = heartbeats.iter().flat_map(|heartbeat| {
            let attempts = heartbeat.progress.iter();
            attempts.map(|(attempt, control_steps)| Progress {
                worker: &heartbeat.worker.0,
                attempt: *attempt,
                control_steps: *control_steps,
            })
        });
        let progress: Vec<Progress<'_>> = progress.collect();
        let expires = self.now.plus(self.shared.timing.lease);
        let mut held = jobs::renew(&mut self.tx, &progress, expires).await?;
        if self.resume_cut_off_leases(&progress, &held).await? {
            held = jobs::renew(&mut self.tx, &progress, expires).await?;
        }
        self.mark_answered_policies(&progress, &held).await?;
        let answer = |heartbeat: &&Heartbeat| {
            if !standings.contains_key(&heartbeat.worker) {
                return Err(QueueError::UnknownWorker { worker: heartbeat.worker.clone() });
            }
            let attempts = heartbeat.progress.iter().map(|(attempt, _)| *attempt);
            Ok(attempts.filter(|attempt| !held.contains(attempt)).collect())
        };
        Ok(heartbeats.iter().map(answer).collect())
    }

    /// Restores leases of workers that were cut off and whose heartbeats now report the leased
    /// attempts again. Returns true if any lease was restored.
    async fn resume_cut_off_leases(
        &mut self,
        progress: &[Progress<'_>],
        held: &BTreeSet<AttemptId>,
    ) -> Result<bool, StoreError> {
        let lost = progress.iter().filter(|report| !held.contains(&report.attempt));
        let lost: Vec<(AttemptId, &str)> =
            lost.map(|report| (report.attempt, report.worker)).collect();
        if lost.is_empty() {
            return Ok(false);
        }
        let ids: Vec<AttemptId> = lost.iter().map(|(attempt, _)| *attempt).collect();
        let named = jobs::attempts_by_id(&mut self.tx, &ids).await?;
        let mut has_resumed = false;
        for (attempt, worker) in lost {
            let named = named.get(&attempt);
            if let Some(named) = named.filter(|attempt| attempt.worker.0 == worker) {
                has_resumed |= self.resume(named).await?.is_some();
            }
        }
        Ok(has_resumed)
    }

    /// Marks the policy of a probe as available once the probe is past the settling steps, because
    /// later steps need an answer of the policy.
    async fn mark_answered_policies(
        &mut self,
        progress: &[Progress<'_>],
        held: &BTreeSet<AttemptId>,
    ) -> Result<(), StoreError> {
        for probe in policies::probes(&mut self.tx).await? {
            let is_past = |report: &Progress<'_>| is_past_settling(report, &probe);
            if held.contains(&probe.attempt) && progress.iter().any(is_past) {
                let campaign = self.campaign(probe.campaign).await?;
                let after = campaign.health.after_answer(probe.attempt.0, self.now);
                self.set_health(&campaign, &after).await?;
            }
        }
        Ok(())
    }
}

/// Returns true if `progress` reports that the attempt of `probe` is past its settling steps.
fn is_past_settling(progress: &Progress<'_>, probe: &Probe) -> bool {
    progress.attempt == probe.attempt.0 && progress.control_steps > probe.settle_steps
}
