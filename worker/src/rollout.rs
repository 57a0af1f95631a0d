//! One rollout: the scene settles, the policy is reset, looks and acts until
//! the goal holds or the budget is spent. Responsible for the order of these
//! steps (section 3 of the protocol) and for asking for a frame only when the
//! policy will look at it. Knows no coordinator: what a rollout is for, and who
//! is told about it, is the caller's.

use std::ops::ControlFlow;
use std::time::Instant;

use proto::policy as wire;
use sha2::{Digest, Sha256};
use sim::{CameraRequest, Observation, ObservationRequest, SimError, Simulator};

use crate::message::{Assignment, Evidence, Failure, FailureKind, Finished, IkResidual, Outcome};
use crate::observation;
use crate::policy::{self, Action, Description, PolicyClient, PolicyError};
use crate::recording::Recording;

/// Watches a rollout, and may end it.
pub trait Watcher {
    /// Told after the scene is made and after every control step, settling
    /// included. `Break` abandons the rollout.
    fn progress(&mut self, control_steps: u32) -> ControlFlow<()>;

    /// Told what the policy is about to look at.
    fn observed(&mut self, _query_index: u32, _observation: &Observation) {}
}

/// Why a rollout has no outcome.
#[derive(Debug, thiserror::Error)]
pub enum RolloutError {
    /// The simulator failed.
    #[error("simulate {id}")]
    Simulator {
        /// Which rollout.
        id: String,
        /// What happened.
        #[source]
        source: SimError,
    },
    /// The policy failed.
    #[error(transparent)]
    Policy(#[from] PolicyError),
    /// The watcher ended it.
    #[error("finish the rollout: it was abandoned")]
    Abandoned,
}

impl RolloutError {
    /// Whose fault it is, and the whole chain of causes in one line. None if
    /// the rollout was abandoned, which is nobody's.
    pub fn failure(&self) -> Option<Failure> {
        let kind = match self {
            Self::Simulator { .. } => FailureKind::Simulator,
            Self::Policy(error) if error.is_misbehaviour() => FailureKind::PolicyMisbehaved,
            Self::Policy(_) => FailureKind::PolicyUnavailable,
            Self::Abandoned => return None,
        };
        let mut error = self.to_string();
        let mut cause = std::error::Error::source(self);
        while let Some(source) = cause {
            error = format!("{error}: {source}");
            cause = source.source();
        }
        Some(Failure { kind, error })
    }
}

/// Runs one rollout to its outcome.
///
/// # Errors
/// If the simulator fails, the policy fails or the watcher ends it.
pub fn run(
    simulator: &mut Simulator,
    policy: &mut PolicyClient,
    assignment: &Assignment,
    watcher: &mut dyn Watcher,
) -> Result<Finished, RolloutError> {
    let started = Instant::now();
    // Asked every time: a policy that was replaced since the last rollout must
    // not go into the results under its predecessor's digest.
    let description = policy.describe(assignment.episode())?;
    let failed = |source| RolloutError::Simulator {
        id: assignment.row.id.to_string(),
        source,
    };
    let mut episode = simulator
        .begin(&assignment.row, assignment.realisation)
        .map_err(failed)?;
    let mut run = Run {
        assignment,
        description: &description,
        policy,
        recording: Recording::begin(assignment.video.as_deref()),
        tally: Tally::default(),
        first_frame_digest: None,
    };
    carry_on(watcher.progress(0))?;
    episode.settle().map_err(failed)?;
    carry_on(watcher.progress(assignment.row.settle_steps))?;
    run.policy.reset(
        assignment.episode(),
        assignment.row.id.task().suite().name(),
        &assignment.row.instruction,
        assignment.policy_seed,
    )?;
    let success = run.act(&mut episode, watcher)?;
    let outcome = Outcome {
        success,
        steps: run.tally.steps,
        wall_secs: started.elapsed().as_secs_f64(),
        ik: episode.ik().map(|ik| IkResidual {
            residual_mm: ik.residual_mm,
            residual_deg: ik.residual_deg,
            clamped_joints: ik.clamped_joints,
        }),
        clipped_actions: run.tally.clipped,
        policy_queries: run.tally.queries,
    };
    let digests = episode.digests().clone();
    let video = run.recording.finish();
    let first_frame_digest = run.first_frame_digest.unwrap_or_default();
    let drew = !first_frame_digest.is_empty() || video.is_some();
    let evidence = Evidence {
        gl_renderer: if drew {
            simulator.gl_renderer().map_err(failed)?
        } else {
            String::new()
        },
        scene_digest: digests.scene,
        init_state_digest: digests.init_state,
        perturbation_digest: digests.perturbation,
        first_frame_digest,
        policy_name: description.about.name,
        policy_checkpoint: description.about.checkpoint,
        policy_checkpoint_digest: description.about.checkpoint_digest,
        policy_privileged: description.about.privileged,
    };
    Ok(Finished {
        outcome,
        evidence,
        video,
    })
}

/// A rollout under way.
struct Run<'a> {
    assignment: &'a Assignment,
    description: &'a Description,
    policy: &'a mut PolicyClient,
    recording: Recording,
    tally: Tally,
    first_frame_digest: Option<String>,
}

#[derive(Default)]
struct Tally {
    steps: u32,
    clipped: u32,
    queries: u32,
}

impl Run<'_> {
    /// From the first query to the goal or the end of the budget.
    fn act(
        &mut self,
        episode: &mut sim::Episode<'_>,
        watcher: &mut dyn Watcher,
    ) -> Result<bool, RolloutError> {
        let row = &self.assignment.row;
        let failed = |source| RolloutError::Simulator {
            id: row.id.to_string(),
            source,
        };
        self.recording.add(episode).map_err(failed)?;
        while self.tally.steps < row.max_steps {
            let actions = self.query(episode, watcher)?;
            for action in actions.into_iter().take(self.description.execute) {
                let (action, clipped) = policy::clip(action);
                self.tally.clipped += u32::from(clipped);
                let success = episode.step(&action).map_err(failed)?;
                self.tally.steps += 1;
                self.recording.add(episode).map_err(failed)?;
                carry_on(watcher.progress(row.settle_steps + self.tally.steps))?;
                if success {
                    return Ok(true);
                }
                if self.tally.steps == row.max_steps {
                    break;
                }
            }
        }
        Ok(false)
    }

    /// Shows the policy the scene and gets its next actions.
    fn query(
        &mut self,
        episode: &mut sim::Episode<'_>,
        watcher: &mut dyn Watcher,
    ) -> Result<Vec<Action>, RolloutError> {
        let request = observation_request(self.description);
        let observation = episode
            .observe(&request)
            .map_err(|source| RolloutError::Simulator {
                id: self.assignment.row.id.to_string(),
                source,
            })?;
        watcher.observed(self.tally.queries, &observation);
        if self.tally.queries == 0 && !observation.frames.is_empty() {
            self.first_frame_digest = Some(frames_digest(&observation));
        }
        let shown = observation::to_wire(observation, &self.description.state);
        let actions = self.policy.infer(
            self.assignment.episode(),
            self.tally.queries,
            shown,
            self.description.horizon,
        )?;
        self.tally.queries += 1;
        Ok(actions)
    }
}

impl Assignment {
    fn episode(&self) -> policy::Episode<'_> {
        policy::Episode {
            policy: &self.policy,
            session: self.session.as_str(),
            deadline: self.policy_deadline,
        }
    }
}

fn carry_on(verdict: ControlFlow<()>) -> Result<(), RolloutError> {
    match verdict {
        ControlFlow::Continue(()) => Ok(()),
        ControlFlow::Break(()) => Err(RolloutError::Abandoned),
    }
}

fn observation_request(description: &Description) -> ObservationRequest {
    let camera = |camera: &wire::CameraRequest| CameraRequest {
        name: camera.name.clone(),
        width: camera.width,
        height: camera.height,
    };
    ObservationRequest {
        cameras: description.about.cameras.iter().map(camera).collect(),
        privileged: description.about.privileged,
    }
}

/// SHA-256 over the pixels of all frames, in the order that the policy sees
/// them in; hex.
fn frames_digest(observation: &Observation) -> String {
    let mut hash = Sha256::new();
    for frame in &observation.frames {
        hash.update(&frame.rgb);
    }
    hash.finalize()
        .iter()
        .map(|byte| format!("{byte:02x}"))
        .collect()
}
