//! One rollout: the scene settles, the policy is reset, looks and acts until
//! the goal holds or the budget is spent. Responsible for the order of these
//! steps (section 3 of the protocol) and for asking for a frame only when the
//! policy will look at it. Knows no coordinator: what a rollout is for, who acts
//! in it and who is told about it, is the caller's.

use std::borrow::Cow;
use std::ops::ControlFlow;
use std::path::PathBuf;
use std::time::Instant;

use proto::policy as wire;
use protocol::{ManifestRow, Realisation};
use scene::TaskFiles;
use sha2::{Digest, Sha256};
use sim::{CameraRequest, Digests, Episode, Observation, ObservationRequest, SimError, Simulator};

use crate::actor::Actor;
use crate::digest::hex;
use crate::message::{
    Assignment, Evidence, Failure, FailureKind, Finished, IkResidual, Motion, Outcome, VideoOf,
    VideoOrder,
};
use crate::observation;
use crate::policy::{self, Action, Description, PolicyError};
use crate::recording::{RecordError, Take, record};

/// Where rollouts take place: a simulator, and the files of the task.
pub struct Stage<'a> {
    simulator: &'a mut Simulator,
    /// In place of those of the row's task.
    files: Option<TaskFiles>,
    /// Whether a rollout that nothing is drawn of names the renderer too.
    always_names_renderer: bool,
}

impl<'a> Stage<'a> {
    /// For the protocol's own tasks: each row says which.
    pub fn of_the_protocol(simulator: &'a mut Simulator) -> Self {
        Self {
            simulator,
            files: None,
            always_names_renderer: true,
        }
    }

    /// For a task of somebody's own, which stands in for the row's.
    pub fn of_files(simulator: &'a mut Simulator, files: TaskFiles) -> Self {
        Self {
            simulator,
            files: Some(files),
            always_names_renderer: true,
        }
    }

    /// Leaves the renderer unopened, and unnamed in the evidence, if nothing is
    /// drawn of a rollout. Not for campaigns, which are pinned to a renderer.
    pub fn with_a_renderer_only_if_needed(self) -> Self {
        Self {
            always_names_renderer: false,
            ..self
        }
    }

    /// What draws, by its own name, and the fingerprint, which is of its pictures
    /// too; both empty where they are not needed.
    fn drawing(&mut self, draws: bool) -> Result<(String, String), SimError> {
        if !draws && !self.always_names_renderer {
            return Ok(Default::default());
        }
        let renderer = self.simulator.renderer_name()?;
        Ok((renderer, self.simulator.fingerprint()?))
    }

    /// Prepares a rollout up to its loaded, perturbed initial state.
    pub(crate) fn begin(
        &mut self,
        row: &ManifestRow,
        realisation: Realisation,
    ) -> Result<Episode<'_>, SimError> {
        match &self.files {
            None => self.simulator.begin(row, realisation),
            Some(files) => self.simulator.begin_with(files.clone(), row, realisation),
        }
    }

    /// What a policy is told to do: the row's words. One that knows the canonical
    /// instructions by heart, and no other wording, is told those: the language
    /// axis is the identity for it, and not an error in every rollout.
    fn instruction<'r>(&self, row: &'r ManifestRow, description: &Description) -> Cow<'r, str> {
        let by_heart = description.about.language() == wire::Language::CanonicalOnly;
        match &self.files {
            None if by_heart => Cow::Owned(row.id.task().instruction()),
            _ => Cow::Borrowed(&row.instruction),
        }
    }

    /// What messages call a rollout here.
    fn title(&self, row: &ManifestRow) -> String {
        match &self.files {
            None => row.id.to_string(),
            Some(files) => format!("{} from state {}", files.bddl.display(), row.init_id),
        }
    }
}

/// One control step of the policy.
pub struct Step {
    /// As the policy answered.
    pub sent: Action,
    /// The same, every number in [-1, 1]: what the robot is told, before the
    /// actuation axis distorts it.
    pub executed: Action,
}

/// Watches a rollout, and may end it.
pub trait Watcher {
    /// Told after the scene is made and after every control step, settling
    /// included. `Break` abandons the rollout.
    fn progress(&mut self, control_steps: u32) -> ControlFlow<()>;

    /// Told what the policy is about to look at.
    fn observed(&mut self, _query_index: u32, _observation: &Observation) {}

    /// Shown the scene after it has come to rest, without a step, and after
    /// every control step of the policy.
    fn moved(&mut self, _step: Option<&Step>, _episode: &mut Episode<'_>) {}

    /// Shown the scene after the last control step.
    fn ended(&mut self, _episode: &mut Episode<'_>) {}
}

/// Why a rollout has no outcome.
#[derive(Debug, thiserror::Error)]
pub enum RolloutError {
    /// The simulator failed.
    #[error("simulate {title}")]
    Simulator {
        /// Which rollout.
        title: String,
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
        let error = chain(self);
        Some(Failure { kind, error })
    }
}

/// An error and what lies behind it, in one line.
pub(crate) fn chain(error: &dyn std::error::Error) -> String {
    let mut text = error.to_string();
    let mut cause = error.source();
    while let Some(source) = cause {
        text = format!("{text}: {source}");
        cause = source.source();
    }
    text
}

/// How a query reaches a policy that no gateway says more of: alone, not in a
/// batch of several rollouts.
const UNBATCHED: &str = "single";

/// Runs one rollout to its outcome, and records it if that is wanted.
///
/// # Errors
/// If the simulator fails, the policy fails or the watcher ends it.
pub fn run(
    mut stage: Stage<'_>,
    actor: &mut dyn Actor,
    assignment: &Assignment,
    watcher: &mut dyn Watcher,
) -> Result<Finished, RolloutError> {
    // Asked every time: a policy that was replaced since the last rollout must
    // not go into the results under its predecessor's digest.
    let description = actor.describe(assignment.episode())?;
    let mut run = Run {
        assignment,
        title: stage.title(&assignment.row),
        description: &description,
        actor,
        watcher,
        executed: Vec::new(),
        path: Vec::new(),
        clipped_actions: 0,
        queries: 0,
        first_frame_digest: String::new(),
    };
    // First, so that a renderer that cannot draw costs no rollout.
    let draws = !description.about.cameras.is_empty() || assignment.video.is_some();
    let (renderer, fingerprint) = stage
        .drawing(draws)
        .map_err(|source| run.simulator_failed(source))?;
    let (outcome, digests) = run.simulate(&mut stage)?;
    let evidence = Evidence {
        renderer,
        fingerprint,
        scene_digest: digests.scene,
        init_state_digest: digests.init_state,
        perturbation_digest: digests.perturbation,
        first_frame_digest: std::mem::take(&mut run.first_frame_digest),
        policy_name: description.about.name.clone(),
        policy_checkpoint: description.about.checkpoint.clone(),
        policy_checkpoint_digest: description.about.checkpoint_digest.clone(),
        policy_privileged: description.about.privileged,
        policy_canonical_only: description.about.language() == wire::Language::CanonicalOnly,
        batch_mode: match description.about.batch_mode.as_str() {
            "" => UNBATCHED.to_owned(),
            mode => mode.to_owned(),
        },
    };
    let video = run.record(&mut stage, &outcome)?;
    Ok(Finished {
        outcome,
        evidence,
        motion: run.into_motion(),
        video,
    })
}

/// A rollout under way.
struct Run<'a> {
    assignment: &'a Assignment,
    /// What messages call it.
    title: String,
    description: &'a Description,
    actor: &'a mut dyn Actor,
    watcher: &'a mut dyn Watcher,
    /// What the policy did, clipped: the rollout can be simulated again.
    executed: Vec<Action>,
    /// Where the end-effector was, tenths of a millimetre.
    path: Vec<[i16; 3]>,
    clipped_actions: u32,
    queries: u32,
    first_frame_digest: String,
}

impl Run<'_> {
    /// From the composed scene to the goal or the end of the budget.
    fn simulate(&mut self, stage: &mut Stage<'_>) -> Result<(Outcome, Digests), RolloutError> {
        let Assignment {
            row, realisation, ..
        } = self.assignment;
        let started = Instant::now();
        let instruction = stage.instruction(row, self.description);
        let mut episode = stage
            .begin(row, *realisation)
            .map_err(|source| self.simulator_failed(source))?;
        carry_on(self.watcher.progress(0))?;
        episode
            .settle()
            .map_err(|source| self.simulator_failed(source))?;
        carry_on(self.watcher.progress(row.settle_steps))?;
        self.path.push(whereabouts(&mut episode));
        self.watcher.moved(None, &mut episode);
        let suite = row.id.task().suite();
        self.actor.reset(
            self.assignment.episode(),
            suite.name(),
            &instruction,
            self.assignment.policy_seed,
        )?;
        let success = self.act(&mut episode)?;
        self.watcher.ended(&mut episode);
        let outcome = Outcome {
            success,
            steps: self.steps(),
            wall_secs: started.elapsed().as_secs_f64(),
            ik: episode.ik().map(|ik| IkResidual {
                residual_mm: ik.residual_mm,
                residual_deg: ik.residual_deg,
                clamped_joints: ik.clamped_joints,
            }),
            clipped_actions: self.clipped_actions,
            policy_queries: self.queries,
        };
        Ok((outcome, episode.digests().clone()))
    }

    /// From the first query to the goal or the end of the budget.
    fn act(&mut self, episode: &mut Episode<'_>) -> Result<bool, RolloutError> {
        let row = &self.assignment.row;
        while self.steps() < row.max_steps {
            let room = (row.max_steps - self.steps()) as usize;
            let actions = self.query(episode)?;
            for sent in actions.into_iter().take(self.description.execute.min(room)) {
                let (executed, clipped) = policy::clip(sent);
                self.clipped_actions += u32::from(clipped);
                let success = episode
                    .step(&executed)
                    .map_err(|source| self.simulator_failed(source))?;
                self.executed.push(executed);
                self.path.push(whereabouts(episode));
                self.watcher.moved(Some(&Step { sent, executed }), episode);
                carry_on(self.watcher.progress(row.settle_steps + self.steps()))?;
                if success {
                    return Ok(true);
                }
            }
        }
        Ok(false)
    }

    /// Shows the policy the scene and gets its next actions.
    fn query(&mut self, episode: &mut Episode<'_>) -> Result<Vec<Action>, RolloutError> {
        let observation = episode
            .observe(&observation_request(self.description))
            .map_err(|source| self.simulator_failed(source))?;
        self.watcher.observed(self.queries, &observation);
        if self.queries == 0 && !observation.frames.is_empty() {
            self.first_frame_digest = frames_digest(&observation);
        }
        let actions = self.actor.infer(
            self.assignment.episode(),
            self.queries,
            observation::to_wire(observation, &self.description.state),
            self.description.horizon,
        )?;
        self.queries += 1;
        Ok(actions)
    }

    /// Makes the video, if one of this outcome is wanted; returns its file.
    fn record(
        &mut self,
        stage: &mut Stage<'_>,
        outcome: &Outcome,
    ) -> Result<Option<PathBuf>, RolloutError> {
        let wanted = |video: &&VideoOrder| match video.of {
            VideoOf::Everything => true,
            VideoOf::Failures => !outcome.success,
        };
        let Some(video) = self.assignment.video.as_ref().filter(wanted) else {
            return Ok(None);
        };
        let done = self.assignment.row.settle_steps + self.steps();
        let mut step = |again| self.watcher.progress(done + again);
        let take = Take {
            row: &self.assignment.row,
            realisation: self.assignment.realisation,
            actions: &self.executed,
            success: outcome.success,
        };
        match record(stage, take, &video.file, &mut step) {
            Ok(()) => Ok(Some(video.file.clone())),
            Err(RecordError::Abandoned) => Err(RolloutError::Abandoned),
            Err(error) => {
                let session = &self.assignment.session;
                tracing::warn!("no video of {session}: failed to {}", chain(&error));
                Ok(None)
            }
        }
    }

    /// How the robot moved, as far as it is wanted.
    fn into_motion(self) -> Motion {
        if self.executed.len() > proto::MAX_MOTION_STEPS {
            return Motion::default();
        }
        Motion {
            path: self.path,
            actions: match self.assignment.keep_actions {
                true => self.executed,
                false => Vec::new(),
            },
        }
    }

    /// Control steps of the policy so far.
    fn steps(&self) -> u32 {
        // Bounded by the budget, which is a u32.
        self.executed.len() as u32
    }

    fn simulator_failed(&self, source: SimError) -> RolloutError {
        RolloutError::Simulator {
            title: self.title.clone(),
            source,
        }
    }
}

impl Assignment {
    fn episode(&self) -> policy::Episode<'_> {
        policy::Episode {
            policy: &self.policy,
            session: self.session.as_str(),
            suite: self.row.id.task().suite().name(),
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

/// Where the end-effector is, in tenths of a millimetre.
fn whereabouts(episode: &mut Episode<'_>) -> [i16; 3] {
    const TENTHS_OF_MM_PER_M: f64 = 10_000.0;
    let position = episode.environment().robot_state().eef_pos;
    // A cast stops at the ends of its range, three metres away.
    position.map(|metres| (metres * TENTHS_OF_MM_PER_M).round() as i16)
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
    hex(&hash.finalize())
}
