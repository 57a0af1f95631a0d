//! Messages between the parent process and a slot's process: one JSON value per line, commands to
//! the slot and events from it, over the socket that is the slot's standard input. Videos are
//! passed as files, so that lines stay short.
//!
//! Every message about a rollout names its attempt: an event that crosses a command in transit may
//! concern an attempt that the receiver has already dropped.

use std::fmt;
use std::path::PathBuf;
use std::time::Duration;

use benchmark::attempt::{AttemptId, Motion, Provenance, RolloutResult};
use benchmark::{ManifestRow, Realisation, RolloutId};
use proto::coordinator::release_request::Reason;
use serde::{Deserialize, Serialize};

use crate::actor::{PolicyError, PolicySession};
use crate::ids::random_id;
use crate::policy::POLICY_CALL_DEADLINE;
use crate::supervise::START_DEADLINE;

/// Longest line that either side reads, bytes. A manifest row takes about 1,000 bytes, the longest
/// motion about 700,000.
pub const MAX_LINE_BYTES: u64 = 1 << 20;

/// Identifies an episode to the policy. The attempt alone makes the identifier unique; rollout and
/// replicate are for display.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Session(String);

impl Session {
    pub fn new(id: &RolloutId, replicate: u32, attempt: AttemptId) -> Self {
        Self(format!("{id}#r{replicate}#{attempt}"))
    }

    /// Returns the session's name as sent to the policy.
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl fmt::Display for Session {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SlotCommand {
    Run(Box<Assignment>),
    /// Stops work on an attempt whose result or video is no longer wanted.
    Abandon(AttemptId),
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Assignment {
    pub attempt: AttemptId,
    pub row: ManifestRow,
    /// Source of the perturbation's random elements.
    pub realisation: Realisation,
    /// The policy's name at its endpoint.
    pub policy: String,
    /// URL of the policy or of a gateway.
    pub policy_endpoint: String,
    /// Seed of the policy, from the rollout's id and the replicate.
    pub policy_seed: u64,
    /// Longest time that the policy may take for one answer.
    pub policy_deadline: Duration,
    /// Longest time that another simulator may take for one answer.
    pub simulator_deadline: Duration,
    /// Name of the episode at the policy.
    pub session: Session,
    /// Requested video; `None` if no video is requested.
    pub video: Option<VideoRequest>,
    /// True if the result includes the actions.
    pub keep_actions: bool,
}

/// A requested video: its file, and the outcomes for which it is made.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct VideoRequest {
    pub file: PathBuf,
    pub of: VideoOf,
}

/// Rollouts that are filmed, by outcome.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum VideoOf {
    Everything,
    Failures,
}

impl Assignment {
    /// Creates an assignment outside any campaign, without a policy, video or stored actions.
    pub fn standalone(row: ManifestRow, replicate: u32, realisation: Realisation) -> Self {
        let attempt = random_id();
        Self {
            attempt,
            session: Session::new(&row.id, replicate, attempt),
            policy_seed: benchmark::seeds::policy_seed(&row.id, replicate),
            row,
            realisation,
            policy: String::new(),
            policy_endpoint: String::new(),
            policy_deadline: POLICY_CALL_DEADLINE,
            simulator_deadline: START_DEADLINE,
            video: None,
            keep_actions: false,
        }
    }

    pub fn policy_session(&self) -> PolicySession<'_> {
        PolicySession {
            policy: &self.policy,
            session: self.session.as_str(),
            suite: self.row.suite_name(),
            deadline: self.policy_deadline,
        }
    }

    /// Returns the video to make of a rollout with this outcome; `None` if no video is requested.
    pub fn video_of(&self, success: bool) -> Option<&VideoRequest> {
        self.video.as_ref().filter(|video| match video.of {
            VideoOf::Everything => true,
            VideoOf::Failures => !success,
        })
    }
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SlotEvent {
    /// The process has started, can simulate and render, and accepts commands.
    Ready {
        /// The renderer's own name.
        renderer: String,
        /// See [`sim::fingerprint`].
        fingerprint: String,
    },
    Rollout {
        attempt: AttemptId,
        event: RolloutEvent,
    },
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RolloutEvent {
    /// Control steps so far, including settling.
    Progress(u32),
    /// The rollout has a result. Sent before filming starts.
    Finished(Box<Finished>),
    /// The rollout ended without a result.
    Failed(Failure),
    Abandoned,
    /// Number of frames so far of the video that was announced with the result.
    Filming(u32),
    /// The video that was announced with the result is in its file.
    Filmed,
    /// The video could not be made. The reason completes the phrase "failed to …".
    NotFilmed(String),
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Finished {
    pub result: RolloutResult,
    /// Provenance without host, asset pack, simulator's version and program, which the parent has
    /// registered with and adds.
    pub provenance: Provenance,
    /// Path of the end-effector and actions of the robot.
    pub motion: Motion,
    /// True if the slot films the rollout next, and reports `Filmed` or `NotFilmed` afterwards.
    pub is_filmed_next: bool,
}

/// Reason why a rollout has no result.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Failure {
    /// Party at fault.
    pub kind: FailureKind,
    /// Message with the names that are needed for further diagnosis.
    pub error: String,
}

/// Party at fault for a rollout without a result.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FailureKind {
    /// The simulator: its physics or a scene.
    Simulator,
    /// The machine: a file, memory or graphics.
    Machine,
    /// The slot's process died.
    SlotCrashed,
    /// The slot's process made no progress and was killed.
    SlotStuck,
    /// The policy answered with an error, or with actions that cannot be executed.
    PolicyMisbehaved,
    /// The policy cannot be reached, is overloaded or has an unusable description, or the execution
    /// model would drop every answer. Not charged to the rollout.
    PolicyUnavailable,
    /// The policy described itself, but did not answer a later call of the attempt. Not charged to
    /// the rollout, unless the rollout loses its policy repeatedly.
    PolicyLost {
        /// Number of queries that the policy had answered.
        answered: u32,
    },
    /// The worker did not begin or did not finish the rollout: it is shutting down, the slot's
    /// process had ended, or files could not be fetched. Not charged to the rollout.
    Draining,
}

impl FailureKind {
    /// Returns the reason as sent to the coordinator.
    pub fn reason(self) -> Reason {
        match self {
            Self::Simulator => Reason::SimulatorError,
            Self::Machine => Reason::MachineError,
            Self::SlotCrashed => Reason::SlotCrashed,
            Self::SlotStuck => Reason::SlotStuck,
            Self::PolicyMisbehaved => Reason::PolicyMisbehaved,
            Self::PolicyUnavailable | Self::PolicyLost { .. } => Reason::PolicyUnavailable,
            Self::Draining => Reason::Draining,
        }
    }
}

impl From<&PolicyError> for FailureKind {
    /// Charges the rollout for an invalid answer or an error of the policy, but not for a missing
    /// answer. An unusable policy description is not charged either, because it would be charged to
    /// every rollout of the policy.
    fn from(error: &PolicyError) -> Self {
        match *error {
            PolicyError::InvalidAnswer { .. }
            | PolicyError::Failed { .. }
            | PolicyError::RecordingEnded { .. } => Self::PolicyMisbehaved,
            PolicyError::Unavailable { answered: Some(answered), .. } => {
                Self::PolicyLost { answered }
            }
            _ => Self::PolicyUnavailable,
        }
    }
}

impl FailureKind {
    pub(crate) fn answered_queries(self) -> Option<u32> {
        match self {
            Self::PolicyLost { answered } => Some(answered),
            _ => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn attempt() -> AttemptId {
        AttemptId::from_random([7; 16])
    }

    #[test]
    fn a_session_names_rollout_replicate_and_attempt() {
        let id = "spatial/t0/camera/L2/c00".parse().expect("an id");
        let session = Session::new(&id, 2, attempt());
        let expected = format!("spatial/t0/camera/L2/c00#r2#{}", "07".repeat(16));
        assert_eq!(session.as_str(), expected);
    }

    #[test]
    fn commands_and_events_round_trip_as_single_lines() {
        let row = ManifestRow::new(
            "goal/t0/nominal/i06".parse().expect("an id"),
            6,
            6,
            benchmark::Perturbation::default(),
        );
        let row = row.under(&"overlap:3*812+4*188,rtc".parse().expect("a model"));
        let command = SlotCommand::Run(Box::new(Assignment {
            attempt: attempt(),
            session: Session::new(&row.id, 0, attempt()),
            row,
            realisation: Realisation::Matched,
            policy: "noop".to_owned(),
            policy_endpoint: "grpc://localhost:7000".to_owned(),
            policy_seed: 5,
            policy_deadline: Duration::from_secs(60),
            simulator_deadline: Duration::from_secs(60),
            video: Some(VideoRequest { file: "videos/1.mp4".into(), of: VideoOf::Failures }),
            keep_actions: true,
        }));
        let line = serde_json::to_string(&command).expect("JSON");
        assert!(!line.contains('\n'));
        assert!((line.len() as u64) < MAX_LINE_BYTES);
        let read: SlotCommand = serde_json::from_str(&line).expect("JSON");
        assert_eq!(read, command);

        let event = SlotEvent::Rollout {
            attempt: attempt(),
            event: RolloutEvent::Failed(Failure {
                kind: FailureKind::PolicyUnavailable,
                error: "two\nlines".to_owned(),
            }),
        };
        let line = serde_json::to_string(&event).expect("JSON");
        assert!(!line.contains('\n'));
        let read: SlotEvent = serde_json::from_str(&line).expect("JSON");
        assert_eq!(read, event);
    }

    #[test]
    fn the_longest_motion_fits_into_a_line() {
        let steps = proto::MAX_MOTION_STEPS;
        let motion = Motion::pack(&vec![[-1; 3]; steps + 1], &vec![[-0.3; 7]; steps]);
        let line = serde_json::to_string(&motion).expect("JSON");
        assert!((line.len() as u64) < MAX_LINE_BYTES * 9 / 10, "{}", line.len());
    }
}
