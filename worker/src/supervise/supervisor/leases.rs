//! Registers the worker, renews its leases by heartbeats, and abandons the rollouts of lost
//! leases.

use std::time::Duration;

use benchmark::attempt::AttemptId;
use proto::coordinator::{
    HeartbeatRequest, HeartbeatResponse, Progress, RegisterRequest, RegisterResponse,
};
use tokio::time::Instant;
use tonic::Status;
use transport::chain;

use super::{Slot, Supervisor};
use crate::message::SlotCommand;
use crate::supervise::config::Timing;
use crate::supervise::error::SuperviseError;
use crate::supervise::event::Event;
use crate::supervise::slot_state::{ABANDON_DEADLINE, Work};

impl Supervisor {
    pub(super) fn register(&mut self, registration: RegisterRequest) {
        self.registration = Some(registration.clone());
        let (link, events) = (self.link.clone(), self.events.clone());
        self.calls.spawn(async move {
            let answer = link.register(registration).await;
            let _ = events.send(Event::Registered(answer)).await;
        });
    }

    pub(super) fn registered(&mut self, answer: Result<RegisterResponse, Status>) {
        let url = &self.config.coordinator;
        match answer {
            Ok(answer) => {
                tracing::info!("registered with the coordinator at {url}");
                self.timing = Timing::from(&answer);
                self.is_registered = true;
                self.log_idle_reason(answer.idle_reason);
            }
            Err(status) => {
                let (url, answer) = (url.clone(), chain(&status));
                self.stop(SuperviseError::Refused { url, answer });
            }
        }
    }

    /// Returns the number of videos that are being made, wait for their results, or are being
    /// sent.
    fn unfinished_videos(&self) -> u32 {
        let made = self.slots.iter().filter(|slot| slot.state.has_video());
        u32::try_from(made.count() + self.uploads.len()).unwrap_or(u32::MAX)
    }

    pub(super) fn send_heartbeat(&mut self) {
        if self.is_heartbeat_in_flight || !self.is_registered {
            return;
        }
        self.is_heartbeat_in_flight = true;
        self.has_unacknowledged_lease = false;
        let under_way = self.slots.iter().filter_map(|slot| slot.state.progress());
        let progress = under_way.map(|(attempt, control_steps)| Progress {
            attempt_id: attempt.to_string(),
            control_steps,
        });
        let request = HeartbeatRequest {
            worker_id: self.config.identity.worker.to_string(),
            progress: progress.collect(),
            filming: self.unfinished_videos(),
        };
        let (link, events) = (self.link.clone(), self.events.clone());
        let deadline = self.timing.heartbeat.max(Duration::from_secs(1));
        self.calls.spawn(async move {
            let answer = link.heartbeat(request, deadline).await;
            let _ = events.send(Event::Renewed(answer)).await;
        });
    }

    pub(super) fn renewed(&mut self, answer: Result<HeartbeatResponse, Status>, now: Instant) {
        self.is_heartbeat_in_flight = false;
        // The link logs the failure, and the next heartbeat follows soon.
        let Ok(answer) = answer else { return };
        for lost in &answer.lost_attempts {
            match lost.parse() {
                Ok(attempt) => self.abandon(attempt, now),
                Err(error) => tracing::warn!("invalid id of a lost attempt: {error}"),
            }
        }
    }

    /// Abandons an attempt whose lease is lost, if its files are still being fetched or it is still
    /// being simulated.
    fn abandon(&mut self, lost: AttemptId, now: Instant) {
        let is_preparing = |slot: &Slot| slot.state.work == Work::Preparing { attempt: lost };
        if let Some(slot) = self.slots.iter_mut().find(|slot| is_preparing(slot)) {
            slot.state.work = Work::Nothing;
            if let Some((assignment, campaign)) = slot.preparing.take() {
                let session = assignment.session;
                tracing::warn!(
                    "the lease of {campaign}: {session} was lost while its files were fetched"
                );
            }
            return;
        }
        let is_running = |slot: &Slot| {
            let work = &slot.state.work;
            matches!(work, Work::Running { attempt, .. } if *attempt == lost)
        };
        let Some(slot) = self.slots.iter().position(is_running) else {
            return;
        };
        tracing::warn!("the lease of {} was lost; the rollout is abandoned", self.label(slot));
        let slot = &mut self.slots[slot];
        if let Some(process) = &slot.process {
            process.send(SlotCommand::Abandon(lost));
        }
        slot.state.work = Work::Abandoning { attempt: lost, deadline: now + ABANDON_DEADLINE };
    }
}
