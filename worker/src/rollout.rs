//! Runs one rollout: the scene settles, the policy is reset, and queries and steps alternate until
//! the goal holds or the step budget is spent. docs/PROTOCOL.md, "One rollout, in order", describes
//! the order of these operations; frames are rendered only for the policy's queries. The caller
//! provides assignment and policy and handles the result; this module does not call the
//! coordinator.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::ops::ControlFlow;
use std::time::Instant;

use benchmark::attempt::{
    Digests, EXECUTION, GoalProgress, IkResidual, MAX_PROMPT_BYTES, Motion, Parts, Pin, Provenance,
    RolloutResult, shortened, tenths_of_mm,
};
use benchmark::{Execution, Look, Query, Schedule};
use proto::checks::CAMERAS;
use proto::policy as wire;
use sha2::{Digest, Sha256};
use sim::episode::clip;
use sim::{CameraRequest, Episode, Frame, Observation, ObservationRequest, SimError};
use transport::chain;

use crate::actor::{Action, Actor, Description, PolicyError};
use crate::message::{Assignment, Failure, FailureKind, Finished};
use crate::observation;
use crate::pipe::PipeError;
use crate::stage::Stage;
use crate::stopwatch::{add_elapsed_time, add_processor_time};

// A result holds whatever a policy's description may hold, and the settings that `settings` adds.
const _: () = assert!(
    proto::MAX_TEXT_BYTES <= benchmark::attempt::MAX_TEXT_BYTES
        && proto::MAX_SETTINGS + 4 <= benchmark::attempt::MAX_SETTINGS
);

/// Control step of the policy.
pub struct Step {
    /// Action as the policy sent it; the action that holds the arm still while no answer is in
    /// effect; or a command of an earlier rollout, repeated by a resumed one.
    pub sent: Action,
    /// Command to the robot before the actuation axis distorts it; see
    /// [`sim::Conditions::command`].
    pub executed: Action,
}

pub trait Watcher {
    /// Called after the scene is composed, after settling and after every later control step.
    /// `control_steps` includes the steps of settling. `Break` abandons the rollout.
    fn progress(&mut self, control_steps: u32) -> ControlFlow<()>;

    /// Called with each observation before the policy is queried.
    fn observed(&mut self, _query_index: u32, _observation: &Observation) {}

    /// Called once with the scene at rest and no step, then after every control step.
    fn moved(&mut self, _step: Option<&Step>, _episode: &mut Episode<'_>) {}

    /// Called with the scene after the last control step.
    fn ended(&mut self, _episode: &mut Episode<'_>) {}
}

/// Reason why a rollout has no result.
#[derive(Debug, thiserror::Error)]
pub enum RolloutError {
    #[error("simulate {title}")]
    Simulator { title: String, source: SimError },
    #[error("finish the rollout: {0}")]
    Pipe(#[from] PipeError),
    #[error("finish the rollout: {0}")]
    Policy(#[from] PolicyError),
    #[error("finish the rollout: it was abandoned")]
    Abandoned,
}

impl RolloutError {
    /// Returns the party at fault and all causes in one line; `None` if the rollout was abandoned.
    pub fn failure(&self) -> Option<Failure> {
        let kind = match self {
            Self::Simulator { source, .. } if source.is_machine_fault() => FailureKind::Machine,
            Self::Simulator { .. } => FailureKind::Simulator,
            Self::Pipe(PipeError::Unusable { .. }) => FailureKind::Machine,
            Self::Pipe(PipeError::Failed { .. } | PipeError::Invalid { .. }) => {
                FailureKind::Simulator
            }
            Self::Pipe(PipeError::Ended { .. }) => FailureKind::SlotCrashed,
            Self::Pipe(PipeError::Late { .. }) => FailureKind::SlotStuck,
            Self::Policy(error) => FailureKind::from(error),
            Self::Abandoned => return None,
        };
        let error = match self {
            Self::Policy(error) => chain(error),
            Self::Pipe(error) => error.to_string(),
            error => format!("failed to {}", chain(error)),
        };
        Some(Failure { kind, error })
    }
}

/// Name of the setting that records the server's treatment of real-time chunking.
const REAL_TIME_CHUNKING: &str = "real-time chunking";
/// Batch mode if no gateway reports one: each query is answered alone.
const UNBATCHED: &str = "single";

/// Result of a simulated rollout, with the commands to the robot.
#[derive(Clone, Debug)]
pub struct Simulated {
    pub finished: Finished,
    /// Commands to the robot, from which the rollout can be simulated again.
    pub actions: Vec<Action>,
}

pub fn run(
    stage: &mut Stage<'_>,
    actor: &mut dyn Actor,
    assignment: &Assignment,
    watcher: &mut dyn Watcher,
) -> Result<Simulated, RolloutError> {
    run_resumed(None, stage, actor, assignment, watcher)
}

/// Start of a rollout at a step of an earlier rollout, with a change at that step.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Resumed<'a> {
    /// Commands to the robot up to that step.
    pub(crate) commands: &'a [Action],
    pub(crate) change: Change,
}

/// Change at the step where a rollout resumes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Change {
    /// Lifts the perturbations; the instruction is canonical from then on.
    Lift,
    /// Placebo: lifts nothing, and nudges the robot ([`Episode::nudge`]).
    Nudge,
}

/// Runs a rollout. If `resumed` is given, the rollout starts from the state after the earlier
/// commands, with the change applied; the policy is reset there, and the commands count against the
/// step budget.
pub(crate) fn run_resumed(
    resumed: Option<Resumed<'_>>,
    stage: &mut Stage<'_>,
    actor: &mut dyn Actor,
    assignment: &Assignment,
    watcher: &mut dyn Watcher,
) -> Result<Simulated, RolloutError> {
    // The policy is described before every rollout: the results of a policy that replaced another
    // must not carry its predecessor's digest.
    let description = actor.describe(assignment.policy_session())?;
    check_execution(assignment, &description)?;
    if let Some(wanted) = foreign(&description.about) {
        return Err(PolicyError::Foreign { policy: assignment.policy.clone(), wanted }.into());
    }
    let mut run = Run {
        assignment,
        resumed,
        title: stage.title(&assignment.row),
        description: &description,
        actor,
        watcher,
        executed: Vec::new(),
        path: Vec::new(),
        clipped_actions: 0,
        queries: 0,
        parts: Parts::default(),
        goal: GoalProgress::default(),
        first_frame_digest: String::new(),
    };
    // The renderer is opened first, so that a failure to render costs no simulation.
    let needs_renderer = !description.about.cameras.is_empty() || assignment.video.is_some();
    let (renderer, fingerprint) = stage
        .renderer_and_fingerprint(needs_renderer)
        .map_err(|source| run.simulator_failed(source))?;
    let look = stage.look();
    let result = run.simulate(stage)?;
    let provenance = provenance(assignment, &description, Drawn { renderer, fingerprint, look });
    let finished = Finished {
        is_filmed_next: assignment.video_of(result.success).is_some(),
        result,
        provenance,
        motion: run.motion(),
    };
    Ok(Simulated { finished, actions: run.executed })
}

/// Returns a reading or a camera that a policy asks for and LIBERO does not have.
fn foreign(about: &wire::DescribeResponse) -> Option<String> {
    let reading = about.readings.first().map(|name| format!("reading `{name}` by name"));
    let mut cameras = about.cameras.iter().map(|camera| &*camera.name);
    let camera = cameras.find(|name| !CAMERAS.contains(name));
    reading.or(camera.map(|name| format!("camera `{name}` beside {}", CAMERAS.join(" and "))))
}

/// Rejects an execution model that drops all answers of the policy, which is a mistake in the
/// campaign. On the latency axis it is an outcome: the policy cannot cope with that delay, and its
/// arm holds still.
pub(crate) fn check_execution(
    assignment: &Assignment,
    description: &Description,
) -> Result<(), PolicyError> {
    let Assignment { row, policy, .. } = assignment;
    if row.id.condition().sets_execution() {
        return Ok(());
    }
    let checked = row.execution.check(description.horizon);
    checked.map_err(|problem| PolicyError::TooLate { policy: policy.clone(), problem })
}

/// Part of a provenance that a simulator knows.
#[derive(Default)]
pub(crate) struct Drawn {
    pub(crate) renderer: String,
    pub(crate) fingerprint: String,
    pub(crate) look: Look,
}

pub(crate) fn provenance(
    assignment: &Assignment,
    description: &Description,
    drawn: Drawn,
) -> Provenance {
    let Drawn { renderer, fingerprint, look } = drawn;
    let about = &description.about;
    Provenance {
        pin: Pin { renderer, look, ..Pin::default() },
        fingerprint,
        realisation: assignment.realisation.to_string(),
        policy_name: about.name.clone(),
        policy_checkpoint: about.checkpoint.clone(),
        policy_checkpoint_digest: about.checkpoint_digest.clone(),
        policy_privileged: about.privileged,
        policy_canonical_only: about.language() == wire::Language::CanonicalOnly,
        policy_settings: settings(description, &assignment.row.execution),
        batch_mode: match about.batch_mode.as_str() {
            "" => UNBATCHED.to_owned(),
            mode => mode.to_owned(),
        },
        ..Provenance::default()
    }
}

struct Run<'a> {
    assignment: &'a Assignment,
    /// Start at a step of an earlier rollout; `None` for a rollout from its initial state.
    resumed: Option<Resumed<'a>>,
    title: String,
    description: &'a Description,
    actor: &'a mut dyn Actor,
    watcher: &'a mut dyn Watcher,
    /// Commands to the robot, from which the rollout can be simulated again.
    executed: Vec<Action>,
    /// End-effector positions at rest and after every control step, world frame, tenths of a
    /// millimetre.
    path: Vec<[i16; 3]>,
    clipped_actions: u32,
    queries: u32,
    /// Time spent so far on physics, rendering and the policy.
    parts: Parts,
    goal: GoalProgress,
    first_frame_digest: String,
}

impl Run<'_> {
    /// Simulates from the composed scene to the goal or the end of the step budget.
    fn simulate(&mut self, stage: &mut Stage<'_>) -> Result<RolloutResult, RolloutError> {
        let Assignment { row, realisation, .. } = self.assignment;
        let started = Instant::now();
        let change = self.resumed.map(|resumed| resumed.change);
        let instruction = match change {
            None | Some(Change::Nudge) => stage.instruction(row, self.description),
            Some(Change::Lift) => Cow::Owned(row.canonical_instruction()),
        };
        let physics = &mut self.parts.physics_secs;
        let begun = add_processor_time(physics, || stage.begin(row, *realisation));
        let mut episode = begun.map_err(|source| self.simulator_failed(source))?;
        continue_unless_abandoned(self.watcher.progress(0))?;
        add_processor_time(&mut self.parts.physics_secs, || episode.settle())
            .map_err(|source| self.simulator_failed(source))?;
        continue_unless_abandoned(self.watcher.progress(row.settle_steps))?;
        self.path.push(end_effector_position(&mut episode));
        self.goal.record(&episode.environment().goal_truths());
        self.watcher.moved(None, &mut episode);
        for &command in self.resumed.map_or(&[][..], |resumed| resumed.commands) {
            self.step(&mut episode, command)?;
        }
        match change {
            None => {}
            Some(Change::Lift) => episode.lift(),
            Some(Change::Nudge) => episode.nudge(),
        }
        let session = self.assignment.policy_session();
        add_elapsed_time(&mut self.parts.policy_secs, || {
            let seed = self.assignment.policy_seed;
            self.actor.reset(session, &instruction, seed)
        })?;
        let outcome = self.act(&mut episode);
        add_elapsed_time(&mut self.parts.policy_secs, || self.actor.end(session));
        let success = outcome?;
        self.watcher.ended(&mut episode);
        let prompt = shortened(&instruction, MAX_PROMPT_BYTES);
        let sim::Digests { scene, init_state } = episode.digests().clone();
        let first_frame = std::mem::take(&mut self.first_frame_digest);
        Ok(RolloutResult {
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
            parts: self.parts,
            goal: self.goal,
            prompt: Some(prompt.to_owned()).filter(|prompt| !prompt.is_empty()),
            digests: Digests { scene, init_state, first_frame },
            realised: episode.realised().clone(),
        })
    }

    /// Alternates queries and steps until the goal holds or the step budget is spent.
    fn act(&mut self, episode: &mut Episode<'_>) -> Result<bool, RolloutError> {
        let row = &self.assignment.row;
        let (execution, execute) = (row.execution.clone(), self.description.execute);
        let mut schedule = Schedule::new(execution, execute, row.id.task(), row.init_id);
        if let Some([.., gripper]) = self.executed.last() {
            schedule = schedule.with_gripper(*gripper);
        }
        while self.steps() < row.max_steps {
            if let Some(query) = schedule.due() {
                schedule.answer(self.query(episode, &query)?);
            }
            let command = schedule.advance();
            let sent = command.action;
            let is_answered = command.source.is_some();
            self.clipped_actions += u32::from(is_answered && clip(&sent) != sent);
            if self.step(episode, sent)? {
                return Ok(true);
            }
        }
        Ok(false)
    }

    /// Executes one control step; returns true if the goal holds after it.
    fn step(&mut self, episode: &mut Episode<'_>, sent: Action) -> Result<bool, RolloutError> {
        let executed = episode.command(&sent);
        let stepped = add_processor_time(&mut self.parts.physics_secs, || episode.step(&executed));
        let success = stepped.map_err(|source| self.simulator_failed(source))?;
        self.executed.push(executed);
        self.path.push(end_effector_position(episode));
        self.goal.record(&episode.environment().goal_truths());
        self.watcher.moved(Some(&Step { sent, executed }), episode);
        let settled = self.assignment.row.settle_steps;
        continue_unless_abandoned(self.watcher.progress(settled + self.steps()))?;
        Ok(success)
    }

    fn query(
        &mut self,
        episode: &mut Episode<'_>,
        query: &Query,
    ) -> Result<Vec<Action>, RolloutError> {
        let request = observation_request(self.description);
        let observed =
            add_processor_time(&mut self.parts.drawing_secs, || episode.observe(&request));
        let observation = observed.map_err(|source| self.simulator_failed(source))?;
        self.watcher.observed(self.queries, &observation);
        if self.queries == 0 && !observation.frames.is_empty() {
            self.first_frame_digest = frames_digest(&observation.frames);
        }
        let observation = observation::to_wire(observation, &self.description.state);
        let actions = add_elapsed_time(&mut self.parts.policy_secs, || {
            let session = self.assignment.policy_session();
            let horizon = self.description.horizon;
            let under_way = self.assignment.row.execution.is_rtc().then_some(query);
            self.actor.infer(session, self.queries, observation, horizon, under_way)
        })?;
        self.queries += 1;
        Ok(actions)
    }

    /// Returns the robot's path and, if requested, its actions; empty for a rollout of more than
    /// [`proto::MAX_MOTION_STEPS`] steps.
    fn motion(&self) -> Motion {
        if self.executed.len() > proto::MAX_MOTION_STEPS {
            return Motion::default();
        }
        let recorded: &[Action] = if self.assignment.keep_actions { &self.executed } else { &[] };
        // Policies answer with 32-bit floats, so the conversion is exact.
        let actions: Vec<_> =
            recorded.iter().map(|action| action.map(|value| value as f32)).collect();
        Motion::pack(&self.path, &actions)
    }

    /// Returns the number of the policy's control steps so far.
    fn steps(&self) -> u32 {
        // Bounded by the step budget, a u32.
        self.executed.len() as u32
    }

    fn simulator_failed(&self, source: SimError) -> RolloutError {
        RolloutError::Simulator { title: self.title.clone(), source }
    }
}

pub(crate) fn continue_unless_abandoned(verdict: ControlFlow<()>) -> Result<(), RolloutError> {
    match verdict {
        ControlFlow::Continue(()) => Ok(()),
        ControlFlow::Break(()) => Err(RolloutError::Abandoned),
    }
}

/// Returns the settings that the policy's server resolved, the maximum number of actions per answer
/// and the number executed, and, unless it is `wait`, the execution model.
fn settings(description: &Description, execution: &Execution) -> BTreeMap<String, String> {
    let resolved = description.about.settings.iter();
    // A server's own setting of this name is dropped, since it would pass for the rollout's
    // execution model.
    let resolved = resolved.filter(|setting| setting.name != EXECUTION);
    let model = (!execution.is_wait()).then(|| (EXECUTION.to_owned(), execution.to_string()));
    let chunking = execution.is_rtc().then(|| {
        let treatment = match description.about.real_time_chunking {
            true => "heeded by the server",
            false => "ignored by the server",
        };
        (REAL_TIME_CHUNKING.to_owned(), treatment.to_owned())
    });
    resolved
        .map(|setting| (setting.name.clone(), setting.value.clone()))
        .chain([
            ("execute".to_owned(), description.execute.to_string()),
            ("horizon".to_owned(), description.horizon.to_string()),
        ])
        .chain(model)
        .chain(chunking)
        .collect()
}

/// Returns the end-effector's position, in tenths of a millimetre.
fn end_effector_position(episode: &mut Episode<'_>) -> [i16; 3] {
    tenths_of_mm(episode.environment().robot_state().eef_pos)
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

/// Returns the SHA-256 over the pixels of all frames, in the policy's order, hex.
pub(crate) fn frames_digest(frames: &[Frame]) -> String {
    let mut hash = Sha256::new();
    for frame in frames {
        hash.update(&frame.rgb);
    }
    hex::encode(hash.finalize())
}
