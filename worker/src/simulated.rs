//! Runs a rollout in another simulator, behind the pipe: sensor and actuation are perturbed here, and
//! the instruction is the row's; other axes act in the simulator.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use benchmark::attempt::{
    Digests, GoalProgress, MAX_PROMPT_BYTES, Motion, Parts, Realised, RolloutResult, shortened,
};
use benchmark::streams::Randomness;
use benchmark::{Action, Axis, ManifestRow, Query, Realisation, Schedule, SimulatedTask};
use proto::policy as wire;
use proto::resize::resize;
use serde_json::json;
use sha2::{Digest, Sha256};
use sim::episode::clip;
use sim::perturb::{self, ActuationStage, FrameSource, SensorStage};
use sim::{CameraRequest, Frame};

use crate::actor::{Actor, Description};
use crate::message::{Assignment, Finished};
use crate::observation;
use crate::pipe::{self, Pipe, PipeError, SimulatorCommand, State};
use crate::rollout::{
    Drawn, RolloutError, Watcher, check_execution, continue_unless_abandoned, frames_digest,
    packed_motion, provenance, tenths_of_mm,
};
use crate::stopwatch::add_elapsed_time;

/// Camera whose noise has a stream of its own; all others share that of `agentview`.
const WRIST_CAMERA: &str = "robot0_eye_in_hand";
/// Reading of the end-effector's position, m.
const POSITION: &str = "eef_pos";

/// The simulators that a slot can start, and those that run.
#[derive(Debug)]
pub(crate) struct Simulators {
    commands: Vec<SimulatorCommand>,
    running: BTreeMap<String, Pipe>,
}

impl Simulators {
    pub(crate) fn new(commands: Vec<SimulatorCommand>) -> Self {
        Self { commands, running: BTreeMap::new() }
    }

    /// Returns a running simulator, which is taken out, so that one that fails is not used again.
    fn take(&mut self, name: &str, deadline: Duration) -> Result<Pipe, PipeError> {
        if let Some(pipe) = self.running.remove(name) {
            return Ok(pipe);
        }
        let command = self.commands.iter().find(|command| command.name == name);
        let command = command.ok_or_else(|| PipeError::Unusable {
            simulator: name.to_owned(),
            problem: "this worker does not serve it: start it with `--simulator NAME=COMMAND`"
                .to_owned(),
        })?;
        Pipe::start(command, deadline)
    }
}

/// Runs the rollout of a row of `simulated`. A simulator that answers, and be it with an error, goes
/// on running; another one is ended, and started again for the next rollout.
pub(crate) fn run(
    simulators: &mut Simulators,
    simulated: &SimulatedTask,
    drawn: Drawn,
    actor: &mut dyn Actor,
    assignment: &Assignment,
    watcher: &mut dyn Watcher,
) -> Result<Finished, RolloutError> {
    let description = actor.describe(assignment.policy_session())?;
    check_execution(assignment, &description)?;
    let mut pipe = simulators.take(&simulated.name, assignment.simulator_deadline)?;
    let finished = run_in(&mut pipe, simulated, drawn, &description, actor, assignment, watcher);
    let has_answered = match &finished {
        Err(RolloutError::Pipe(error)) => matches!(error, PipeError::Failed { .. }),
        _ => true,
    };
    if has_answered {
        simulators.running.insert(simulated.name.clone(), pipe);
    }
    finished
}

fn run_in(
    pipe: &mut Pipe,
    simulated: &SimulatedTask,
    drawn: Drawn,
    description: &Description,
    actor: &mut dyn Actor,
    assignment: &Assignment,
    watcher: &mut dyn Watcher,
) -> Result<Finished, RolloutError> {
    let task = task(pipe, simulated)?;
    let readings = readings(pipe, description)?;
    let row = &assignment.row;
    let scene = json!([simulated.name, simulated.task, pipe.about.packages]);
    let about = &pipe.about;
    let origin = json!([about.packages, about.driver, about.reused]);
    let mut packages = about.packages.clone();
    packages.insert("simulator".to_owned(), simulated.name.clone());
    packages.insert("driver".to_owned(), about.driver.clone());
    let mut run = Run {
        readings,
        stages: Stages::new(row, assignment.realisation),
        state: State::new(),
        pipe,
        description,
        actor,
        assignment,
        watcher,
        commands: Vec::new(),
        path: Vec::new(),
        clipped_actions: 0,
        queries: 0,
        parts: Parts::default(),
        first_frame: String::new(),
    };
    let (result, motion) = run.simulate(&task, simulated, digest(&scene))?;
    let drawn = Drawn { fingerprint: digest(&origin), ..drawn };
    let mut provenance = provenance(assignment, description, drawn);
    provenance.simulator = packages;
    Ok(Finished { result, provenance, motion, is_filmed_next: false })
}

fn digest(of: &serde_json::Value) -> String {
    hex::encode(Sha256::digest(of.to_string()))
}

fn task(pipe: &Pipe, simulated: &SimulatedTask) -> Result<pipe::Task, PipeError> {
    let axes = &pipe.about.axes;
    if let Some(axis) = simulated.perturb.keys().find(|axis| !axes.contains(axis.name())) {
        return Err(unknown(pipe, "axis", axis.name(), axes.iter()));
    }
    let tasks = &pipe.about.tasks;
    let task = tasks.iter().find(|task| task.name == simulated.task).cloned();
    task.ok_or_else(|| unknown(pipe, "task", &simulated.task, tasks.iter().map(|task| &task.name)))
}

fn unknown<'a>(
    pipe: &Pipe,
    kind: &str,
    given: &str,
    known: impl Iterator<Item = &'a String>,
) -> PipeError {
    let known: Vec<&str> = known.map(String::as_str).collect();
    let known = if known.is_empty() { "none".to_owned() } else { known.join(", ") };
    pipe.failed("reset", format!("it has no {kind} `{given}`; it has: {known}"))
}

/// Returns the names of the readings that the policy requests, in its order.
fn readings(pipe: &Pipe, description: &Description) -> Result<Vec<String>, PipeError> {
    if description.about.privileged {
        let problem = "the policy requests the state of LIBERO's simulator, which this one does not \
                       have";
        return Err(pipe.failed("reset", problem.to_owned()));
    }
    let fields = description.state.iter().map(|field| {
        let name = field.as_str_name();
        name.strip_prefix("STATE_FIELD_").unwrap_or(name).to_lowercase()
    });
    let names: Vec<String> = fields.chain(description.about.readings.iter().cloned()).collect();
    let known = &pipe.about.state;
    match names.iter().find(|name| !known.contains_key(*name)) {
        Some(name) => Err(unknown(pipe, "reading, which the policy requests,", name, known.keys())),
        None => Ok(names),
    }
}

/// Perturbations that act in the worker.
struct Stages {
    sensor: Option<SensorStage>,
    actuation: Option<ActuationStage>,
    realised: Realised,
}

impl Stages {
    fn new(row: &ManifestRow, realisation: Realisation) -> Self {
        let randomness = |axis| Randomness::of(&row.id, axis, realisation);
        let mut realised = Realised::default();
        let mut realise = |axis, elements| {
            realised.add(axis, row.perturbation.values(axis), elements);
        };
        let sensor = row.perturbation.sensor.map(|corruption| {
            let stage = SensorStage::new(&corruption, &randomness(Axis::Sensor));
            realise(Axis::Sensor, stage.realised());
            stage
        });
        let actuation = row.perturbation.actuation.map(|distortion| {
            let rms = row.id.task().suite().demo_action_rms();
            let stage = ActuationStage::new(&distortion, rms, &randomness(Axis::Actuation));
            realise(Axis::Actuation, stage.realised());
            stage
        });
        Self { sensor, actuation, realised }
    }

    fn corrupt(&mut self, frame: &mut Frame, step: u32) {
        if let Some(stage) = &mut self.sensor {
            stage.apply(&mut perturb::Frame {
                source: match &*frame.camera {
                    WRIST_CAMERA => FrameSource::Wrist,
                    _ => FrameSource::Agentview,
                },
                step,
                width: frame.width as usize,
                height: frame.height as usize,
                rgb: &mut frame.rgb,
            });
        }
    }
}

struct Run<'a> {
    pipe: &'a mut Pipe,
    description: &'a Description,
    actor: &'a mut dyn Actor,
    assignment: &'a Assignment,
    watcher: &'a mut dyn Watcher,
    stages: Stages,
    /// Names of the readings that the policy gets.
    readings: Vec<String>,
    /// Readings after the last control step.
    state: State,
    commands: Vec<Action>,
    /// End-effector positions, tenths of a millimetre; empty if the simulator has no such reading.
    path: Vec<[i16; 3]>,
    clipped_actions: u32,
    queries: u32,
    /// Time spent so far; the simulator's includes its drawing.
    parts: Parts,
    first_frame: String,
}

impl Run<'_> {
    fn simulate(
        &mut self,
        task: &pipe::Task,
        simulated: &SimulatedTask,
        scene: String,
    ) -> Result<(RolloutResult, Motion), RolloutError> {
        let started = Instant::now();
        let Assignment { row, simulator_deadline: deadline, .. } = self.assignment;
        let is_canonical_only = self.description.about.language() == wire::Language::CanonicalOnly;
        let worded = match is_canonical_only {
            true => &simulated.instruction,
            false => &row.instruction,
        };
        let instruction = if worded.is_empty() { &task.instruction } else { worded };
        let cameras = self.cameras()?;
        let reset = add_elapsed_time(&mut self.parts.physics_secs, || {
            let begin = (&*simulated.task, row.init_id);
            self.pipe.reset(begin, cameras, &simulated.perturb, *deadline)
        })?;
        self.moved(reset.state);
        continue_unless_abandoned(self.watcher.progress(0))?;
        let session = self.assignment.policy_session();
        add_elapsed_time(&mut self.parts.policy_secs, || {
            self.actor.reset(session, instruction, self.assignment.policy_seed)
        })?;
        let outcome = self.act(row.max_steps.min(task.max_steps));
        add_elapsed_time(&mut self.parts.policy_secs, || self.actor.end(session));
        let success = outcome?;
        let mut goal = GoalProgress::default();
        goal.record(&[success]);
        let prompt = shortened(instruction, MAX_PROMPT_BYTES);
        let result = RolloutResult {
            success,
            steps: self.steps(),
            wall_secs: started.elapsed().as_secs_f64(),
            ik: None,
            clipped_actions: self.clipped_actions,
            policy_queries: self.queries,
            parts: self.parts,
            goal,
            prompt: Some(prompt.to_owned()).filter(|prompt| !prompt.is_empty()),
            digests: Digests {
                scene,
                init_state: reset.digest,
                first_frame: std::mem::take(&mut self.first_frame),
            },
            realised: self.stages.realised.clone(),
        };
        let recorded = if self.assignment.keep_actions { &*self.commands } else { &[] };
        Ok((result, packed_motion(self.commands.len(), &self.path, recorded)))
    }

    /// Returns the frames to draw: in the size that the policy requests if the simulator draws any.
    fn cameras(&self) -> Result<Vec<CameraRequest>, PipeError> {
        let offered = &self.pipe.about.cameras;
        let camera = |requested: &wire::CameraRequest| {
            let own = offered.iter().find(|own| own.name == requested.name).ok_or_else(|| {
                let names = offered.iter().map(|own| &own.name);
                let kind = "camera, which the policy requests,";
                unknown(self.pipe, kind, &requested.name, names)
            })?;
            let (width, height) = match own.any_size {
                true => (requested.width, requested.height),
                false => (own.width, own.height),
            };
            Ok(CameraRequest { name: own.name.clone(), width, height })
        };
        self.description.about.cameras.iter().map(camera).collect()
    }

    /// Alternates queries and steps until success, the simulator's end or the end of the budget.
    fn act(&mut self, budget: u32) -> Result<bool, RolloutError> {
        let row = &self.assignment.row;
        let (execution, execute) = (row.execution.clone(), self.description.execute);
        let mut schedule = Schedule::new(execution, execute, row.id.task(), row.init_id);
        while self.steps() < budget {
            if let Some(query) = schedule.due() {
                schedule.answer(self.query(&query)?);
            }
            let command = schedule.advance();
            let sent = command.action;
            let is_answered = command.source.is_some();
            self.clipped_actions += u32::from(is_answered && clip(&sent) != sent);
            let draws = schedule.due().is_some();
            let step = self.step(clip(&sent), draws)?;
            if step.success || step.ended {
                return Ok(step.success);
            }
        }
        Ok(false)
    }

    fn step(&mut self, command: Action, draws: bool) -> Result<pipe::Step, RolloutError> {
        let action = match &mut self.stages.actuation {
            Some(stage) => stage.apply(&command),
            None => command,
        };
        let deadline = self.assignment.simulator_deadline;
        let mut step = add_elapsed_time(&mut self.parts.physics_secs, || {
            self.pipe.step(&action, draws, deadline)
        })?;
        self.commands.push(command);
        self.moved(std::mem::take(&mut step.state));
        continue_unless_abandoned(self.watcher.progress(self.steps()))?;
        Ok(step)
    }

    fn moved(&mut self, state: State) {
        self.state = state;
        if let Some(&[x, y, z]) = self.state.get(POSITION).map(Vec::as_slice) {
            self.path.push(tenths_of_mm([x, y, z]));
        }
    }

    fn query(&mut self, query: &Query) -> Result<Vec<Action>, RolloutError> {
        let frames = self.observe()?;
        if self.queries == 0 && !frames.is_empty() {
            self.first_frame = frames_digest(&frames);
        }
        let fields = self.description.state.iter().map(|&field| field as i32);
        let fields = fields.map(|field| (field, String::new()));
        let named = self.description.about.readings.iter();
        let fields = fields.chain(named.map(|name| (0, name.clone())));
        let state = self.readings.iter().zip(fields).map(|(reading, (field, name))| {
            wire::StateReading { field, values: self.state[reading].clone(), name }
        });
        let observation = wire::Observation {
            images: frames.into_iter().map(observation::image).collect(),
            state: state.collect(),
            privileged: None,
        };
        let actions = add_elapsed_time(&mut self.parts.policy_secs, || {
            let session = self.assignment.policy_session();
            let horizon = self.description.horizon;
            let under_way = self.assignment.row.execution.is_rtc().then_some(query);
            self.actor.infer(session, self.queries, observation, horizon, under_way)
        })?;
        self.queries += 1;
        Ok(actions)
    }

    /// Returns the frames in the sizes that the policy requests, corrupted by the sensor axis.
    fn observe(&mut self) -> Result<Vec<Frame>, PipeError> {
        let mut frames = self.pipe.frames()?;
        for (frame, requested) in frames.iter_mut().zip(&self.description.about.cameras) {
            let (from, to) = ([frame.width, frame.height], [requested.width, requested.height]);
            if from != to {
                frame.rgb = resize(
                    &frame.rgb,
                    from.map(|side| side as usize),
                    to.map(|side| side as usize),
                );
                [frame.width, frame.height] = to;
            }
            let step = self.commands.len() as u32;
            self.stages.corrupt(frame, step);
        }
        Ok(frames)
    }

    fn steps(&self) -> u32 {
        // Bounded by the step budget, a u32.
        self.commands.len() as u32
    }
}
