//! What the parent process and a slot's process say to each other: one JSON
//! value per line, orders on the child's standard input, reports on its
//! standard output. Videos go by file, so that lines stay short.

use std::fmt;
use std::path::PathBuf;
use std::time::Duration;

use proto::coordinator::release_request::Reason;
use protocol::{ManifestRow, Realisation, RolloutId};
use serde::{Deserialize, Serialize};

use crate::policy::Action;

/// Longest line that either side reads, bytes. A manifest row takes about one
/// thousand.
pub const MAX_LINE_BYTES: u64 = 1 << 20;

/// Names an episode to the policy: rollout, replicate and attempt.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Session(String);

impl Session {
    /// The session of one attempt at one replicate.
    pub fn new(id: &RolloutId, replicate: u32, attempt: u32) -> Self {
        Self(format!("{id}#r{replicate}#a{attempt}"))
    }

    /// As it goes over the wire.
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl fmt::Display for Session {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

/// From the parent to a slot.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Order {
    /// Do this rollout.
    Run(Box<Assignment>),
    /// Let go of the rollout in hand: nobody wants its outcome any more.
    Abandon,
}

/// One rollout to do.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Assignment {
    /// What to simulate.
    pub row: ManifestRow,
    /// Where the perturbation's random elements come from.
    pub realisation: Realisation,
    /// The policy's name at its endpoint.
    pub policy: String,
    /// URL of the policy or of a gateway.
    pub policy_endpoint: String,
    /// The policy's seed: that of the replicate.
    pub policy_seed: u64,
    /// How long the policy may take for one answer.
    pub policy_deadline: Duration,
    /// The episode's name to the policy.
    pub session: Session,
    /// The video, if one is wanted.
    pub video: Option<VideoOrder>,
    /// Whether the actions are wanted with the outcome.
    pub keep_actions: bool,
}

/// A video that somebody wants.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct VideoOrder {
    /// Where to write it.
    pub file: PathBuf,
    /// Of which outcomes.
    pub of: VideoOf,
}

/// The outcomes of which a video is wanted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum VideoOf {
    /// All.
    Everything,
    /// Failures.
    Failures,
}

/// From a slot to the parent.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Report {
    /// The process is up, can simulate and draw, and takes orders.
    Ready {
        /// The renderer's own name.
        renderer: String,
        /// See [`sim::fingerprint`].
        fingerprint: String,
    },
    /// Control steps done in this rollout, settling included.
    Progress(u32),
    /// The rollout has an outcome.
    Finished(Box<Finished>),
    /// The rollout ended without one.
    Failed(Failure),
    /// The rollout was let go, as ordered.
    Abandoned,
}

/// A rollout's outcome and where it came from, as far as the slot knows.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Finished {
    /// What came out.
    pub outcome: Outcome,
    /// Which simulator, scene and policy it came out of.
    pub evidence: Evidence,
    /// How the robot moved.
    pub motion: Motion,
    /// The video, if one was wanted and could be made.
    pub video: Option<PathBuf>,
}

/// How the robot of a rollout moved.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Motion {
    /// Where the site between the fingertips was, at rest and after every
    /// control step: world frame, tenths of a millimetre.
    pub path: Vec<[i16; 3]>,
    /// What the robot was told in every control step, if that is wanted.
    pub actions: Vec<Action>,
}

/// What came out of a rollout.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Outcome {
    /// Whether the goal was reached within the step budget.
    pub success: bool,
    /// The policy's control steps: up to the one that reached the goal, or all.
    pub steps: u32,
    /// From the start of composition to the last step, seconds.
    pub wall_secs: f64,
    /// What the robot axis' inverse kinematics left over, where it ran.
    pub ik: Option<IkResidual>,
    /// Executed actions that had to be clipped into [-1, 1].
    pub clipped_actions: u32,
    /// Observations that the policy answered.
    pub policy_queries: u32,
}

/// What inverse kinematics left over.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct IkResidual {
    /// Distance to the target position, mm.
    pub residual_mm: f64,
    /// Angle to the target orientation, degrees.
    pub residual_deg: f64,
    /// Arm joints that stand at a limit.
    pub clamped_joints: u32,
}

/// Which simulator, scene and policy an outcome came out of. Digests are
/// SHA-256, hex.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Evidence {
    /// The renderer's own name, in a campaign also where no frame was drawn;
    /// empty where none was opened.
    pub renderer: String,
    /// See [`sim::fingerprint`]; empty where no renderer was opened.
    pub fingerprint: String,
    /// Of the composed MJCF.
    pub scene_digest: String,
    /// Of the initial state's bytes.
    pub init_state_digest: String,
    /// Of the perturbation's values and drawn elements, axis by axis:
    /// `camera:…,robot:…`; empty where nothing is perturbed.
    pub perturbation_digest: String,
    /// Of the first frames that the policy saw; empty where it looks at none.
    pub first_frame_digest: String,
    /// The policy's own name.
    pub policy_name: String,
    /// Its checkpoint, as the publisher writes it.
    pub policy_checkpoint: String,
    /// Digest of its weights, as the policy gives it.
    pub policy_checkpoint_digest: String,
    /// Whether it sees the simulator's own state.
    pub policy_privileged: bool,
    /// Whether it is told the canonical instruction whatever the condition.
    pub policy_canonical_only: bool,
    /// How a gateway asks it: "single" unless one says otherwise.
    pub batch_mode: String,
}

/// Why a rollout has no outcome.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Failure {
    /// Whose fault it was.
    pub kind: FailureKind,
    /// In words, with the names that are needed to look further.
    pub error: String,
}

/// Whose fault it was that a rollout has no outcome.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FailureKind {
    /// The simulator's: a file, the physics, the renderer.
    Simulator,
    /// The slot's process died.
    SlotCrashed,
    /// The slot's process stood still and was killed.
    SlotStuck,
    /// The policy answered something that no robot can execute.
    PolicyMisbehaved,
    /// The policy did not answer. Not charged to the rollout.
    PolicyUnavailable,
    /// The worker is going down. Not charged to the rollout.
    Draining,
}

impl FailureKind {
    /// As the coordinator is told.
    pub fn reason(self) -> Reason {
        match self {
            Self::Simulator => Reason::SimulatorError,
            Self::SlotCrashed => Reason::SlotCrashed,
            Self::SlotStuck => Reason::SlotStuck,
            Self::PolicyMisbehaved => Reason::PolicyMisbehaved,
            Self::PolicyUnavailable => Reason::PolicyUnavailable,
            Self::Draining => Reason::Draining,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_session_names_rollout_replicate_and_attempt() {
        let id = "spatial/t0/camera/L2/c00".parse().expect("an id");
        let session = Session::new(&id, 2, 3);
        assert_eq!(session.as_str(), "spatial/t0/camera/L2/c00#r2#a3");
    }

    #[test]
    fn orders_and_reports_are_single_lines_that_read_back() {
        let row = ManifestRow::new(
            "goal/t0/clean/i06".parse().expect("an id"),
            6,
            6,
            protocol::Perturbation::default(),
        );
        let order = Order::Run(Box::new(Assignment {
            session: Session::new(&row.id, 0, 1),
            row,
            realisation: Realisation::Matched,
            policy: "noop".to_owned(),
            policy_endpoint: "grpc://localhost:7000".to_owned(),
            policy_seed: 5,
            policy_deadline: Duration::from_secs(60),
            video: Some(VideoOrder {
                file: "videos/1.mp4".into(),
                of: VideoOf::Failures,
            }),
            keep_actions: true,
        }));
        let line = serde_json::to_string(&order).expect("JSON");
        assert!(!line.contains('\n'));
        assert!((line.len() as u64) < MAX_LINE_BYTES);
        assert_eq!(serde_json::from_str::<Order>(&line).expect("JSON"), order);

        let report = Report::Failed(Failure {
            kind: FailureKind::PolicyUnavailable,
            error: "two\nlines".to_owned(),
        });
        let line = serde_json::to_string(&report).expect("JSON");
        assert!(!line.contains('\n'));
        assert_eq!(serde_json::from_str::<Report>(&line).expect("JSON"), report);
    }
}
