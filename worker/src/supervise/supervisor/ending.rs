//! Ends a worker: on request, after a fault, or for lack of work.

use std::time::Duration;

use terminal::counted;
use tokio::time::Instant;

use super::{Slot, Supervisor};
use crate::message::{Failure, FailureKind};
use crate::supervise::deliver::Ending;
use crate::supervise::error::SuperviseError;
use crate::supervise::slot_state::{Mode, ProcessState, Work};

/// A second shutdown request within this time is a duplicate of the first.
const DUPLICATE_REQUEST: Duration = Duration::from_millis(500);
/// Longest time that an abandoning worker spends on giving its jobs back.
const GIVE_BACK_DEADLINE: Duration = Duration::from_secs(10);

impl Supervisor {
    /// Starts to drain because of a fault. A worker that drains already ignores the fault.
    pub(super) fn stop(&mut self, fault: SuperviseError) {
        if self.mode == Mode::Serving {
            self.start_to_drain();
            self.fault = Some(fault);
        }
    }

    pub(super) fn start_to_drain(&mut self) {
        self.mode = Mode::Draining;
        self.drain.send_replace(true);
        if let Some(provider) = &self.config.provider {
            provider.end();
        }
    }

    pub(super) fn shut_down(&mut self, now: Instant) {
        if self.mode == Mode::Serving {
            self.start_to_drain();
            self.shutdown_requested_at = Some(now);
            let running = self.slots.iter().filter_map(|slot| slot.state.progress());
            tracing::info!(
                "draining: {} in flight to be finished; a second signal gives them back instead",
                counted(running.count() as u64, "rollout")
            );
        } else if self.mode == Mode::Draining && !self.is_duplicate(now) {
            tracing::info!("giving the rollouts in flight back");
            self.give_up(now);
        }
    }

    /// Gives the rollouts back if a drain exceeds its limit, and ends a worker that has been idle
    /// for too long.
    pub(super) fn end_in_time(&mut self, now: Instant) {
        let is_over = |since: Instant, limit: Option<Duration>| {
            limit.filter(|limit| now.duration_since(since) >= *limit)
        };
        if self.mode == Mode::Draining
            && let Some(since) = self.shutdown_requested_at
            && let Some(limit) = is_over(since, self.config.drain)
        {
            tracing::info!(
                "giving the rollouts in flight back: they were not finished within {} s",
                limit.as_secs_f64()
            );
            self.give_up(now);
        }
        let is_idle = |slot: &Slot| {
            slot.state.process == ProcessState::Up && slot.state.work == Work::Claiming
        };
        // While the coordinator is unreachable, the worker cannot know that there is no work.
        if !self.is_registered || self.link.is_down() || !self.slots.iter().all(is_idle) {
            self.idle_since = now;
        }
        if self.mode == Mode::Serving
            && let Some(limit) = is_over(self.idle_since, self.config.idle)
        {
            tracing::info!("ending: no work for {} s", limit.as_secs_f64());
            self.start_to_drain();
        }
    }

    /// Returns true if a shutdown request duplicates the first: some service managers signal both
    /// the process and its group.
    fn is_duplicate(&self, now: Instant) -> bool {
        self.shutdown_requested_at
            .is_some_and(|first| now.duration_since(first) < DUPLICATE_REQUEST)
    }

    /// Gives the rollouts in flight back, and limits the time until the worker exits.
    pub(super) fn give_up(&mut self, now: Instant) {
        self.mode = Mode::Abandoning { until: now + GIVE_BACK_DEADLINE };
        for slot in 0..self.slots.len() {
            let given_back = self.slots[slot].state.give_up();
            if let Some(process) = &self.slots[slot].process {
                process.kill();
            }
            if let Some(attempt) = given_back {
                let error =
                    "the rollout did not end: its worker gave it back while ending".to_owned();
                let kind = FailureKind::Draining;
                let label = self.label(slot);
                let ending = Ending::Failed(Failure { kind, error });
                self.send_delivery(slot, attempt, label, ending);
            }
        }
    }
}
