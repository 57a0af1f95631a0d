//! Runs a rollout in another simulator, behind the pipe: sensor and actuation are perturbed here, and
//! the instruction is the row's; other axes act in the simulator.

use std::collections::BTreeMap;
use std::collections::btree_map::Entry;
use std::time::{Duration, Instant};

use benchmark::attempt::{
    Digests, GoalProgress, MAX_PROMPT_BYTES, Motion, Parts, Realised, RolloutResult, shortened,
    tenths_of_mm,
};
use benchmark::{Action, Query, Schedule, SimulatedTask};
use proto::MAX_MOTION_STEPS;
use proto::policy as wire;
use proto::resize::resize;
use serde_json::json;
use sha2::{Digest, Sha256};
use sim::episode::clip;
use sim::{CameraRequest, Frame, Interference};

use crate::actor::{Actor, Description};
use crate::message::{Assignment, Finished};
use crate::observation;
use crate::pipe::{self, Pipe, PipeError, SimulatorCommand, State};
use crate::rollout::{
    Drawn, RolloutError, Watcher, check_execution, continue_unless_abandoned, frames_digest,
    provenance,
};
use crate::stopwatch::add_elapsed_time;

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

    /// Returns a running simulator, which is started if need be.
    fn open(&mut self, name: &str, deadline: Duration) -> Result<&mut Pipe, PipeError> {
        match self.running.entry(name.to_owned()) {
            Entry::Occupied(running) => Ok(running.into_mut()),
            Entry::Vacant(vacant) => {
                let command = self.commands.iter().find(|command| command.name == name);
                let command = command.ok_or_else(|| PipeError::Unusable {
                    simulator: name.to_owned(),
                    problem: "start the worker with `--simulator NAME=COMMAND`".to_owned(),
                })?;
                Ok(vacant.insert(Pipe::start(command, deadline)?))
            }
        }
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
    let description = &actor.describe(assignment.policy_session())?;
    check_execution(assignment, description)?;
    let pipe = simulators.open(&simulated.name, assignment.simulator_deadline)?;
    let Some(task) = pipe.about.tasks.iter().find(|task| task.name == simulated.task).cloned()
    else {
        let known = pipe.about.tasks.iter().map(|task| &task.name);
        return Err(unknown(pipe, "task", &simulated.task, known).into());
    };
    let readings = readings(pipe, description)?;
    let mut packages = pipe.about.packages.clone();
    let scene = digest(&json!([simulated.name, simulated.task, packages]));
    let origin = json!([packages, pipe.about.driver, pipe.about.reused]);
    packages.insert("simulator".to_owned(), simulated.name.clone());
    packages.insert("driver".to_owned(), pipe.about.driver.clone());
    let mut realised = Realised::default();
    let mut run = Run {
        interference: Interference::new(&assignment.row, assignment.realisation, &mut realised),
        readings,
        state: State::new(),
        pipe,
        description,
        actor,
        assignment,
        watcher,
        steps: 0,
        path: Vec::new(),
        clipped_actions: 0,
        queries: 0,
        parts: Parts::default(),
        first_frame: String::new(),
    };
    let result = run.simulate(&task, simulated, scene);
    let path = std::mem::take(&mut run.path);
    if let Err(RolloutError::Pipe(error)) = &result
        && !matches!(error, PipeError::Failed { .. })
    {
        simulators.running.remove(&simulated.name);
    }
    let result = RolloutResult { realised, ..result? };
    let is_sent = path.len() <= MAX_MOTION_STEPS + 1;
    let motion = if is_sent { Motion::pack(&path, &[]) } else { Motion::default() };
    let mut provenance =
        provenance(assignment, description, Drawn { fingerprint: digest(&origin), ..drawn });
    provenance.simulator = packages;
    Ok(Finished { result, provenance, motion, is_filmed_next: false })
}

fn digest(of: &serde_json::Value) -> String {
    hex::encode(Sha256::digest(of.to_string()))
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

struct Run<'a> {
    pipe: &'a mut Pipe,
    description: &'a Description,
    actor: &'a mut dyn Actor,
    assignment: &'a Assignment,
    watcher: &'a mut dyn Watcher,
    interference: Interference,
    /// Names of the readings that the policy gets.
    readings: Vec<String>,
    /// Readings after the last control step.
    state: State,
    /// Control steps so far.
    steps: u32,
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
    ) -> Result<RolloutResult, RolloutError> {
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
        Ok(RolloutResult {
            success,
            steps: self.steps,
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
            realised: Realised::default(),
        })
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
        while self.steps < budget {
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
        let action = self.interference.distort(&command);
        let deadline = self.assignment.simulator_deadline;
        let mut step = add_elapsed_time(&mut self.parts.physics_secs, || {
            self.pipe.step(&action, draws, deadline)
        })?;
        self.steps += 1;
        self.moved(std::mem::take(&mut step.state));
        continue_unless_abandoned(self.watcher.progress(self.steps))?;
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
            self.interference.corrupt(frame, self.steps);
        }
        Ok(frames)
    }
}
