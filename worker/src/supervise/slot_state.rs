//! State machine of a slot. Pure functions: the supervisor carries out the decisions.
//!
//! A slot consists of a process, its work, and the video of the last rollout, with separate life
//! cycles: the work of a dead process is still delivered, an idle process waits for work, and a
//! video is made while the result is delivered.

use std::time::Duration;

use benchmark::attempt::{AttemptId, Backoff, Waits};
use tokio::time::Instant;

use crate::message::FailureKind;

/// Longest start of a slot's process, which loads libraries, opens the renderer, and simulates and
/// draws a fixed motion.
pub const START_DEADLINE: Duration = Duration::from_secs(120);
/// Longest time to abandon a rollout before the process is killed. The process checks for the
/// command at every control step.
pub(crate) const ABANDON_DEADLINE: Duration = Duration::from_secs(5);
/// Failed starts of a slot's process in a row, without a rollout between them, after which the
/// worker gives up.
pub(crate) const MAX_FAILED_STARTS: u32 = 5;

/// Phase of the worker, which determines whether it claims work.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Mode {
    /// Claims work.
    Serving,
    /// Finishes the rollouts in flight and claims no more.
    Draining,
    /// Has given up its rollouts, and only delivers reports.
    Abandoning {
        /// Time at which the worker exits even if reports are undelivered.
        until: Instant,
    },
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum ProcessState {
    /// No process is running.
    Down {
        /// Earliest time of the next start.
        until: Instant,
    },
    Starting {
        /// Time at which the process is killed unless it is ready.
        deadline: Instant,
    },
    /// The process accepts commands.
    Up,
    /// The process was killed and has not exited yet.
    Dying,
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Work {
    Nothing,
    /// A job is being claimed from the coordinator.
    Claiming,
    /// The files of the job's task are being fetched.
    Preparing {
        attempt: AttemptId,
    },
    /// A rollout is being simulated.
    Running {
        attempt: AttemptId,
        /// Control steps so far, including settling.
        control_steps: u32,
        /// Time of the last reported progress.
        progressed_at: Instant,
    },
    /// The rollout made no progress and its process was killed.
    Stuck {
        attempt: AttemptId,
        control_steps: u32,
    },
    /// The lease was lost; the process has been asked to abandon the rollout.
    Abandoning {
        attempt: AttemptId,
        /// Time at which the process is killed unless it has abandoned the rollout.
        deadline: Instant,
    },
    /// The end of the rollout is being reported to the coordinator.
    Delivering {
        attempt: AttemptId,
        control_steps: u32,
    },
}

/// The video of the rollout that a slot simulated last.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Video {
    /// No video is being made, and none waits for its result.
    None,
    /// The slot's process makes the video, and does no other work meanwhile.
    Filming {
        attempt: AttemptId,
        /// Frames of the video so far.
        pictures: u32,
        /// Time of the last reported progress.
        progressed_at: Instant,
        /// State of the result to which the video belongs.
        result: ResultState,
    },
    /// The video is finished, and its result is still being delivered.
    Made { attempt: AttemptId },
}

/// State of a filmed rollout's result.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum ResultState {
    Delivering,
    Committed,
    /// The coordinator refused the result, or the rollout's lease was lost.
    Unwanted,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum VideoDecision {
    Upload(AttemptId),
    /// Remove the video's file, if there is one.
    Drop(AttemptId),
    Abandon(AttemptId),
}

/// Work lost with the end of a slot's process.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Loss {
    /// Attempt that was under way, to be reported as failed, with the party at fault.
    pub(crate) rollout: Option<(AttemptId, FailureKind)>,
    /// The attempt that was being filmed.
    pub(crate) video: Option<AttemptId>,
}

#[derive(Clone, Debug)]
pub(crate) struct SlotState {
    pub(crate) process: ProcessState,
    pub(crate) work: Work,
    pub(crate) video: Video,
    restarts: Backoff,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Decision {
    Start,
    Claim,
    Kill(Kill),
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Kill {
    /// The process did not become ready in time.
    NotReady,
    Stuck,
    StuckFilming,
    /// The process did not abandon its rollout in time.
    NotAbandoned,
}

impl SlotState {
    /// Creates a slot whose first process may start at once.
    pub(crate) fn new(now: Instant, seed: u64) -> Self {
        Self {
            process: ProcessState::Down { until: now },
            work: Work::Nothing,
            video: Video::None,
            restarts: Backoff::new(Waits::USUAL, seed),
        }
    }

    /// Returns the action that is due, which the caller carries out and records in the state.
    pub(crate) fn decide(
        &self,
        mode: Mode,
        progress_timeout: Duration,
        now: Instant,
    ) -> Option<Decision> {
        let is_serving = mode == Mode::Serving;
        let is_stuck =
            |progressed_at: Instant| now.duration_since(progressed_at) >= progress_timeout;
        match (&self.process, &self.work, &self.video) {
            (ProcessState::Down { until }, Work::Nothing, _) if is_serving && now >= *until => {
                Some(Decision::Start)
            }
            (ProcessState::Starting { deadline }, ..) if now >= *deadline => {
                Some(Decision::Kill(Kill::NotReady))
            }
            (ProcessState::Up, Work::Running { progressed_at, .. }, _)
                if is_stuck(*progressed_at) =>
            {
                Some(Decision::Kill(Kill::Stuck))
            }
            (ProcessState::Up, Work::Abandoning { deadline, .. }, _) if now >= *deadline => {
                Some(Decision::Kill(Kill::NotAbandoned))
            }
            (ProcessState::Up, _, Video::Filming { progressed_at, .. }) => {
                is_stuck(*progressed_at).then_some(Decision::Kill(Kill::StuckFilming))
            }
            (ProcessState::Up, Work::Nothing, _) if is_serving => Some(Decision::Claim),
            _ => None,
        }
    }

    /// Returns true if a draining worker has nothing left to wait for in this slot.
    pub(crate) fn is_done(&self) -> bool {
        self.work == Work::Nothing && self.video == Video::None
    }

    /// Returns the attempt whose lease a heartbeat renews, with its control steps so far.
    pub(crate) fn progress(&self) -> Option<(AttemptId, u32)> {
        match self.work {
            Work::Running { attempt, control_steps, .. }
            | Work::Stuck { attempt, control_steps }
            | Work::Delivering { attempt, control_steps } => Some((attempt, control_steps)),
            Work::Preparing { attempt } => Some((attempt, 0)),
            Work::Nothing | Work::Claiming | Work::Abandoning { .. } => None,
        }
    }

    /// Returns true if a video is being made or waits for its result.
    pub(crate) fn has_video(&self) -> bool {
        self.video != Video::None
    }

    pub(crate) fn became_ready(&mut self) {
        if matches!(self.process, ProcessState::Starting { .. }) {
            self.process = ProcessState::Up;
        }
    }

    pub(crate) fn advanced(&mut self, id: AttemptId, steps: u32, now: Instant) {
        if let Work::Running { attempt, control_steps, progressed_at } = &mut self.work
            && *attempt == id
            && steps > *control_steps
        {
            *control_steps = steps;
            *progressed_at = now;
        }
    }

    pub(crate) fn filming_advanced(&mut self, id: AttemptId, frames: u32, now: Instant) {
        if let Video::Filming { attempt, pictures, progressed_at, .. } = &mut self.video
            && *attempt == id
            && frames > *pictures
        {
            *pictures = frames;
            *progressed_at = now;
        }
    }

    pub(crate) fn killed(&mut self, reason: Kill) {
        self.process = ProcessState::Dying;
        if let (Kill::Stuck, &Work::Running { attempt, control_steps, .. }) = (reason, &self.work) {
            self.work = Work::Stuck { attempt, control_steps };
        }
    }

    /// Records that the process has ended; returns the rollout and the video that were lost with
    /// it. A lost video costs no result: a slot films only after it has handed over the result.
    pub(crate) fn ended(&mut self, now: Instant) -> Loss {
        self.process = ProcessState::Down { until: now + self.restarts.next_wait() };
        let mut loss = Loss::default();
        if let Video::Filming { attempt, .. } = self.video {
            self.video = Video::None;
            loss.video = Some(attempt);
        }
        let (attempt, control_steps, kind) = match self.work {
            Work::Running { attempt, control_steps, .. } => {
                (attempt, control_steps, FailureKind::SlotCrashed)
            }
            Work::Stuck { attempt, control_steps } => {
                (attempt, control_steps, FailureKind::SlotStuck)
            }
            Work::Abandoning { .. } => {
                self.work = Work::Nothing;
                return loss;
            }
            // The fetch continues; when it ends, the job is given back.
            Work::Preparing { .. } | Work::Nothing | Work::Claiming | Work::Delivering { .. } => {
                return loss;
            }
        };
        self.work = Work::Delivering { attempt, control_steps };
        loss.rollout = Some((attempt, kind));
        loss
    }

    /// Records the end of an attempt, which is filmed next if `is_filmed`. Returns true if the end
    /// must be reported; false if the lease was lost or the slot no longer has the attempt. A
    /// process that was killed as stuck may still have sent this end.
    pub(crate) fn rollout_ended(&mut self, id: AttemptId, is_filmed: bool, now: Instant) -> bool {
        let (result, control_steps) = match self.work {
            Work::Running { attempt, control_steps, .. }
            | Work::Stuck { attempt, control_steps }
                if attempt == id =>
            {
                (ResultState::Delivering, control_steps)
            }
            Work::Abandoning { attempt, .. } if attempt == id => (ResultState::Unwanted, 0),
            _ => return false,
        };
        self.restarts.reset();
        if is_filmed {
            self.video = Video::Filming { attempt: id, pictures: 0, progressed_at: now, result };
        }
        let is_wanted = result == ResultState::Delivering;
        self.work = match is_wanted {
            true => Work::Delivering { attempt: id, control_steps },
            false => Work::Nothing,
        };
        is_wanted
    }

    /// Records that an attempt's video is finished or cannot be made. Returns the action on the
    /// video that is due now.
    pub(crate) fn filming_ended(&mut self, id: AttemptId, is_made: bool) -> Option<VideoDecision> {
        let Video::Filming { attempt, result, .. } = self.video else {
            return None;
        };
        if attempt != id {
            return None;
        }
        self.video = Video::None;
        match (is_made, result) {
            (true, ResultState::Committed) => Some(VideoDecision::Upload(attempt)),
            (true, ResultState::Delivering) => {
                self.video = Video::Made { attempt };
                None
            }
            (true, ResultState::Unwanted) | (false, _) => Some(VideoDecision::Drop(attempt)),
        }
    }

    /// Records the coordinator's answer to the slot's report; `is_committed` is true if the
    /// coordinator has the result. Returns the action on the video that is due now.
    pub(crate) fn delivered(&mut self, is_committed: bool) -> Option<VideoDecision> {
        self.work = Work::Nothing;
        match &mut self.video {
            Video::None => None,
            Video::Filming { result, .. } if is_committed => {
                *result = ResultState::Committed;
                None
            }
            Video::Filming { result, attempt, .. } => {
                *result = ResultState::Unwanted;
                Some(VideoDecision::Abandon(*attempt))
            }
            &mut Video::Made { attempt } => {
                self.video = Video::None;
                Some(match is_committed {
                    true => VideoDecision::Upload(attempt),
                    false => VideoDecision::Drop(attempt),
                })
            }
        }
    }

    /// Records that the process is killed and its video dropped. Returns the attempt under way,
    /// which must be given back; `None` without one.
    pub(crate) fn give_up(&mut self) -> Option<AttemptId> {
        self.process = ProcessState::Dying;
        self.video = Video::None;
        let (Work::Preparing { attempt }
        | Work::Running { attempt, .. }
        | Work::Stuck { attempt, .. }) = self.work
        else {
            return None;
        };
        self.work = Work::Delivering { attempt, control_steps: 0 };
        Some(attempt)
    }

    /// Returns true if the slot's process has failed `MAX_FAILED_STARTS` times in a row.
    pub(crate) fn cannot_start(&self) -> bool {
        self.restarts.failures() >= MAX_FAILED_STARTS
    }
}

#[cfg(test)]
mod tests;
