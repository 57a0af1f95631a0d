//! Claims jobs for idle slots and starts their rollouts.

use std::collections::BTreeSet;

use benchmark::attempt::AttemptId;
use benchmark::{ManifestRow, RolloutId, Suite, TaskKey};
use proto::coordinator::{ClaimRequest, ClaimResponse, Lease};
use scene::FileStamps;
use tokio::time::Instant;
use tonic::{Code, Status};
use transport::chain;

use super::Supervisor;
use crate::assets::{ProvideError, Provider};
use crate::ids::random_id;
use crate::message::{
    Assignment, Failure, FailureKind, Session, SlotCommand, VideoOf, VideoRequest,
};
use crate::policy::POLICY_CALL_DEADLINE;
use crate::supervise::deliver::Ending;
use crate::supervise::error::SuperviseError;
use crate::supervise::event::Event;
use crate::supervise::slot_state::{Mode, ProcessState, Work};

impl Supervisor {
    pub(super) fn claim(&mut self, slot: usize) {
        let Some(registration) = self.registration.clone() else {
            return;
        };
        self.slots[slot].state.work = Work::Claiming;
        let last = self.slots[slot].assignment.as_ref();
        let request = ClaimRequest {
            worker_id: self.config.identity.worker.to_string(),
            claim_id: random_id().to_string(),
            warm_task: last.map_or_else(String::new, |last| TaskKey::of_row(&last.row)),
            lacking_tasks: self.lacking_keys().into_iter().collect(),
            simulators: self.config.simulators.clone(),
            ..ClaimRequest::default()
        };
        let (link, events) = (self.link.clone(), self.events.clone());
        self.calls.spawn(async move {
            let mut answer = link.claim(request.clone()).await;
            if matches!(&answer, Err(status) if status.code() == Code::NotFound) {
                // A coordinator with a new data folder does not know this worker yet.
                answer = match link.register(registration).await {
                    Ok(_) => link.claim(request).await,
                    Err(status) => Err(status),
                };
            }
            let _ = events.send(Event::Claimed { slot, answer }).await;
        });
    }

    fn lacking_keys(&mut self) -> BTreeSet<String> {
        let mut keys = self.config.lacking_keys();
        let provider = self.config.provider.as_ref();
        let may_run = |row: &ManifestRow, files: &FileStamps| {
            provider.is_some_and(|provider| provider.has_changed(row, files))
        };
        self.lacks.retain(|_, (row, files)| !may_run(row, files));
        keys.extend(self.lacks.keys().cloned());
        keys
    }

    /// Starts the job that was granted to a slot, or gives it back.
    pub(super) fn claimed(
        &mut self,
        slot: usize,
        answer: Result<ClaimResponse, Status>,
        now: Instant,
    ) {
        self.slots[slot].state.work = Work::Nothing;
        let answer = match answer {
            Ok(answer) => answer,
            Err(status) => return self.stop(SuperviseError::Stopped(chain(&status))),
        };
        let Some(lease) = answer.lease else {
            return self.log_idle_reason(answer.idle_reason);
        };
        let attempt: AttemptId = match lease.attempt_id.parse() {
            Ok(attempt) => attempt,
            Err(source) => {
                let url = self.config.coordinator.clone();
                return self.stop(SuperviseError::Lease { url, source });
            }
        };
        let job = lease.job_id;
        let campaign = lease.campaign.clone();
        let failed = |kind, error: String| Ending::Failed(Failure { kind, error });
        let is_up = self.slots[slot].state.process == ProcessState::Up;
        let ending = match self.assignment(attempt, lease) {
            _ if self.mode != Mode::Serving => {
                let text = "the rollout did not begin: its worker is shutting down";
                failed(FailureKind::Draining, text.to_owned())
            }
            _ if !is_up => {
                let text = "the rollout did not begin: its slot's process had just ended";
                failed(FailureKind::Draining, text.to_owned())
            }
            Err(error) => failed(FailureKind::Simulator, format!("failed to {error}")),
            Ok(assignment) => return self.prepare(slot, assignment, campaign, now),
        };
        self.slots[slot].state.work = Work::Delivering { attempt, control_steps: 0 };
        let label = format!("{campaign}: job {job}");
        self.send_delivery(slot, attempt, label, ending);
    }

    /// Fetches the files of a job's task before the job starts.
    fn prepare(&mut self, slot: usize, assignment: Assignment, campaign: String, now: Instant) {
        let have_the_same_files = |last: &ManifestRow, row: &ManifestRow| {
            // Each variant of a task has its own files.
            let files = |id: RolloutId| (id.task(), id.variant());
            // A user may change the files of a suite file at any time.
            files(last.id) == files(row.id) && row.id.task().suite() != Suite::Own
        };
        let row = assignment.row.clone();
        let last = self.slots[slot].assignment.as_ref();
        let is_warm = last.is_some_and(|last| have_the_same_files(&last.row, &row));
        let provider = self.config.provider.clone();
        let is_needed =
            |provider: &Provider| row.simulator.is_none() && !is_warm && provider.is_needed(&row);
        let Some(provider) = provider.filter(is_needed) else {
            return self.begin(slot, assignment, campaign, now);
        };
        let attempt = assignment.attempt;
        self.slots[slot].state.work = Work::Preparing { attempt };
        self.slots[slot].preparing = Some((assignment, campaign));
        self.has_unacknowledged_lease = true;
        let events = self.events.clone();
        self.calls.spawn_blocking(move || {
            let outcome = provider.provide(&row);
            let _ = events.blocking_send(Event::Provided { slot, attempt, outcome });
        });
    }

    /// Starts a job whose files were fetched. If the fetch failed, gives the job back uncharged,
    /// because the network is not the job's fault. If the task lacks files that cannot be fetched,
    /// leaves the task to other workers until the files change.
    pub(super) fn provided(
        &mut self,
        slot: usize,
        attempt: AttemptId,
        outcome: Result<(), ProvideError>,
        now: Instant,
    ) {
        if self.slots[slot].state.work != (Work::Preparing { attempt }) {
            // The lease was lost meanwhile, or the job was given back.
            return;
        }
        let Some((assignment, campaign)) = self.slots[slot].preparing.take() else {
            return;
        };
        let is_up = self.slots[slot].state.process == ProcessState::Up;
        let error = match outcome {
            Ok(()) if is_up && self.mode == Mode::Serving => {
                self.fetches.reset();
                return self.begin(slot, assignment, campaign, now);
            }
            Ok(()) => "the rollout did not begin: its slot cannot run it any more".to_owned(),
            Err(ProvideError::Lack { error, files }) => {
                let key = TaskKey::of_row(&assignment.row);
                let row = assignment.row.clone();
                if self.lacks.insert(key, (row, files)).is_none() {
                    tracing::warn!(
                        "left to other workers until its files change: failed to {error}"
                    );
                }
                error
            }
            Err(ProvideError::Fetch(error)) => {
                let wait = self.fetches.next_wait();
                self.claims_from = now + wait;
                let secs = wait.as_secs_f64();
                tracing::warn!("no job is claimed for {secs:.0} s: failed to {error}");
                error
            }
        };
        self.slots[slot].state.work = Work::Delivering { attempt, control_steps: 0 };
        let kind = FailureKind::Draining;
        let label = format!("{campaign}: {}", assignment.session);
        self.send_delivery(slot, attempt, label, Ending::Failed(Failure { kind, error }));
    }

    /// Logs the coordinator's reason for granting no job although jobs wait, unless it was the last
    /// reason too.
    pub(super) fn log_idle_reason(&mut self, reason: String) {
        if reason != self.idle_reason {
            if !reason.is_empty() {
                tracing::info!("nothing to do: {reason}");
            }
            self.idle_reason = reason;
        }
    }

    /// Builds a slot's assignment from a lease. The error follows the words "failed to".
    fn assignment(&self, attempt: AttemptId, lease: Lease) -> Result<Assignment, String> {
        let mut row: benchmark::ManifestRow =
            serde_json::from_str(&lease.manifest_row).map_err(|error| {
                let problem = benchmark::JsonError::from(error);
                format!("read the manifest row of job {}: {problem}", lease.job_id)
            })?;
        let realisation = lease.realisation.parse();
        // Rows of older campaigns have no execution model; the lease has it instead.
        if row.execution.is_wait() && !lease.execution.is_empty() {
            let execution = lease.execution.parse();
            row.execution =
                execution.map_err(|error: benchmark::ExecutionError| error.to_string())?;
        }
        let endpoint = self.config.policy_endpoint.clone();
        let filmed_outcomes = match lease.record_failures_only {
            true => VideoOf::Failures,
            false => VideoOf::Everything,
        };
        let video = VideoRequest { file: self.video_file(attempt), of: filmed_outcomes };
        Ok(Assignment {
            attempt,
            session: Session::new(&row.id, lease.replicate, attempt),
            realisation: realisation.map_err(|error: benchmark::UnknownName| error.to_string())?,
            policy: lease.policy,
            policy_endpoint: endpoint.unwrap_or(lease.policy_endpoint),
            policy_seed: lease.policy_seed,
            // A policy that hangs must time out before its slot does.
            policy_deadline: POLICY_CALL_DEADLINE.min(self.timing.progress_timeout / 2),
            // So must a simulator, which may load its libraries first.
            simulator_deadline: self.timing.progress_timeout * 3 / 4,
            video: lease.record_video.then_some(video),
            keep_actions: lease.keep_actions,
            row,
        })
    }

    fn begin(&mut self, slot: usize, assignment: Assignment, campaign: String, now: Instant) {
        let slot = &mut self.slots[slot];
        if let Some(process) = &slot.process {
            process.send(SlotCommand::Run(Box::new(assignment.clone())));
        }
        slot.state.work =
            Work::Running { attempt: assignment.attempt, control_steps: 0, progressed_at: now };
        slot.assignment = Some(assignment);
        slot.campaign = campaign;
        self.has_unacknowledged_lease = true;
    }
}
