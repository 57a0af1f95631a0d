//! Benchmark of a rollout's phases: the worker's own loop runs whole rollouts with
//! predetermined actions, and every phase is timed. Prints one JSON object. Run by
//! `cargo xtask bench rollout` and `bench compare`; docs/dev/PERFORMANCE.md defines the
//! phases.

#![forbid(unsafe_code)]

use std::cell::RefCell;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::rc::Rc;

use anyhow::{Context, Result, ensure};
use benchmark::{ManifestRow, Query, Realisation, TaskRef};
use clap::Parser;
use prost::Message;
use proto::policy::Observation;
use scene::pack::LIBERO;
use scene::{InitialStates, Sources, TaskFiles};
use serde_json::{Value, json};
use sim::controller::SUBSTEPS;
use sim::episode::NO_OP;
use sim::mujoco::Data;
use sim::{Episode, Renderer, Simulator, SimulatorConfig};
use tests::fidelity::read_npz;
use tests::files::open_pack;
use tests::measure::{Clock, Spread};
use worker::actor::{Action, Actor, Description, PolicyError, PolicySession};
use worker::message::Assignment;
use worker::open_loop::{description, smooth_action};
use worker::policy::infer_request;
use worker::rollout::{Step, Watcher};
use worker::stage::Stage;

/// Time the phases of whole rollouts of one task.
#[derive(Parser)]
struct Arguments {
    /// The task: SUITE/N.
    #[arg(long)]
    task: TaskRef,
    /// `libero`, `primitives`, or the path of a LIBERO assets folder.
    #[arg(long, default_value = LIBERO)]
    assets: String,
    /// Control steps between two queries of the policy, each with frames of both cameras.
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..))]
    execute: u32,
    /// Control steps of each rollout.
    #[arg(long, default_value_t = 120, value_parser = clap::value_parser!(u32).range(1..))]
    steps: u32,
    /// Rollouts that are timed, after a first one that compiles the scene and is not timed.
    #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..))]
    rollouts: u32,
    /// Renderer: `software`, or `gl` for MuJoCo's renderer through OpenGL,
    /// `gl:N` on the N-th device, from 0.
    #[arg(long, default_value_t)]
    renderer: Renderer,
    /// Times by the wall clock even if processor time of the thread would suffice, to compare with
    /// programs that use the wall clock.
    #[arg(long)]
    wall: bool,
    /// A NumPy archive (.npz) with `actions`, repeated if they are too few, and
    /// the `state` that they start from. Without it: smooth motion from the
    /// first evaluation state.
    #[arg(long)]
    actions: Option<PathBuf>,
    /// Folder with the unpacked packages of robosuite and LIBERO.
    #[arg(long)]
    sources: Option<PathBuf>,
}

/// Milliseconds of one rollout.
#[derive(Debug, Clone, Copy, Default)]
struct Phases {
    /// Loading the initial state into the compiled scene.
    reset: f64,
    /// The control steps before the policy starts.
    settle: f64,
    /// The policy's control steps, including physics.
    steps: f64,
    /// Part of `steps`: bare `mj_step`s, timed on copies of the states.
    physics: f64,
    /// Drawing both cameras, and reading the robot.
    frames: f64,
    /// Encoding an observation into the message to a policy.
    encode: f64,
    /// Selecting the actions of an answer from the predetermined ones.
    policy: f64,
    /// Time of the rollout outside the phases above.
    other: f64,
}

impl Phases {
    fn total(&self) -> f64 {
        self.reset + self.settle + self.steps + self.frames + self.encode + self.policy + self.other
    }
}

/// Assigns the time since the last event to a phase.
struct Timer {
    clock: Clock,
    /// Reading of the clock at the last event, milliseconds.
    last: f64,
    phases: Phases,
    /// Time of the next control step's physics on a copy of the state, milliseconds.
    physics_millis: f64,
    /// Copy of the simulation's state on which physics is timed.
    copy: Option<Data>,
    /// True if physics is timed on copies, which takes time itself.
    times_physics: bool,
    progress_calls: u32,
    steps: u32,
    frames: u32,
    message_bytes: usize,
}

impl Timer {
    fn new(clock: Clock, times_physics: bool) -> Self {
        Self {
            clock,
            last: clock.now_millis(),
            phases: Phases::default(),
            physics_millis: 0.0,
            copy: None,
            times_physics,
            progress_calls: 0,
            steps: 0,
            frames: 0,
            message_bytes: 0,
        }
    }

    /// Returns the milliseconds since the last event and starts the next lap.
    fn lap(&mut self) -> f64 {
        let now = self.clock.now_millis();
        let millis = now - self.last;
        self.last = now;
        millis
    }

    /// Times the physics of the next control step on a copy of the state. This time is not
    /// part of the rollout.
    fn time_physics(&mut self, episode: &mut Episode<'_>) -> Result<(), sim::SimError> {
        if self.times_physics {
            let environment = episode.environment();
            if self.copy.is_none() {
                self.copy = Some(Data::new(environment.model())?);
            }
            if let Some(copy) = &mut self.copy {
                self.physics_millis = bare_millis(self.clock, copy, episode);
            }
        }
        self.last = self.clock.now_millis();
        Ok(())
    }
}

/// Times a control step's `mj_step`s on a copy of the state, milliseconds.
fn bare_millis(clock: Clock, copy: &mut Data, episode: &mut Episode<'_>) -> f64 {
    let environment = episode.environment();
    copy.copy_from(environment.model(), environment.data());
    let model = environment.model();
    let (millis, ()) = clock.time(|| (0..SUBSTEPS).for_each(|_| copy.step(model)));
    millis
}

type SharedTimer = Rc<RefCell<Timer>>;

/// Open-loop policy that replays actions. Observations are encoded as if they were sent.
struct OpenLoop<'a> {
    timer: SharedTimer,
    description: Description,
    actions: &'a [Action],
}

impl Actor for OpenLoop<'_> {
    fn describe(&mut self, _: PolicySession<'_>) -> Result<Description, PolicyError> {
        Ok(self.description.clone())
    }

    fn infer(
        &mut self,
        session: PolicySession<'_>,
        query_index: u32,
        observation: Observation,
        horizon: usize,
        _: Option<&Query>,
    ) -> Result<Vec<Action>, PolicyError> {
        let message = infer_request(session, query_index, observation).encode_to_vec();
        let mut timer = self.timer.borrow_mut();
        timer.phases.encode += timer.lap();
        timer.message_bytes = message.len();
        let first = query_index as usize * horizon;
        let actions = (first..first + horizon).map(|step| self.actions[step % self.actions.len()]);
        let actions = actions.collect();
        timer.phases.policy += timer.lap();
        Ok(actions)
    }
}

/// Watcher that times the worker's loop.
struct PhaseWatcher {
    timer: SharedTimer,
    problem: Option<sim::SimError>,
}

impl Watcher for PhaseWatcher {
    fn progress(&mut self, _control_steps: u32) -> ControlFlow<()> {
        let mut timer = self.timer.borrow_mut();
        let lap = timer.lap();
        match timer.progress_calls {
            0 => timer.phases.reset += lap,
            1 => timer.phases.settle += lap,
            _ => timer.phases.other += lap,
        }
        timer.progress_calls += 1;
        match self.problem {
            Some(_) => ControlFlow::Break(()),
            None => ControlFlow::Continue(()),
        }
    }

    fn observed(&mut self, _query_index: u32, observation: &sim::Observation) {
        let mut timer = self.timer.borrow_mut();
        timer.phases.frames += timer.lap();
        timer.frames += observation.frames.len() as u32;
    }

    fn moved(&mut self, step: Option<&Step>, episode: &mut Episode<'_>) {
        let mut timer = self.timer.borrow_mut();
        let lap = timer.lap();
        match step {
            None => timer.phases.other += lap,
            Some(_) => {
                timer.phases.steps += lap;
                timer.phases.physics += timer.physics_millis;
                timer.steps += 1;
            }
        }
        self.problem = timer.time_physics(episode).err();
    }
}

/// A simulator and the rollout to run in it.
struct Bench {
    simulator: Simulator,
    assignment: Assignment,
    description: Description,
    actions: Vec<Action>,
    clock: Clock,
}

fn main() -> ExitCode {
    match run(&Arguments::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: failed to {error:#}");
            ExitCode::FAILURE
        }
    }
}

fn run(arguments: &Arguments) -> Result<()> {
    let dir = arguments.sources.clone();
    let sources = Sources::open(&dir.unwrap_or_else(Sources::default_dir))?;
    let pack = open_pack(&arguments.assets, &sources, [arguments.task])?;
    let (row, actions) = motion(arguments, &sources)?;
    let pack_name = pack.name().to_owned();
    let mut bench = Bench {
        simulator: Simulator::new(SimulatorConfig {
            sources,
            pack,
            renderer: arguments.renderer,
            cached_scenes: 1,
        }),
        assignment: Assignment::standalone(row, 0, Realisation::Matched),
        description: description(arguments.execute),
        actions,
        clock: match arguments.renderer {
            Renderer::Software if !arguments.wall => Clock::ThreadCpu,
            // OpenGL renders on other threads or on a GPU.
            _ => Clock::Wall,
        },
    };
    // The first rollout compiles the scene and prepares meshes and textures.
    let first = bench.rollout(false)?;
    let mut report = json!({
        "system": "rollout",
        "task": arguments.task.to_string(),
        "assets": pack_name,
        "mujoco": sim::mujoco::version(),
        "renderer": bench.simulator.renderer_name()?,
        "clock": bench.clock.name(),
        "execute": arguments.execute,
        "policy": "none: open-loop actions",
        "compile_and_first_reset_ms": round(first.phases.reset),
    });
    let measured = bench.measure(arguments.rollouts, arguments.steps)?;
    merge(&mut report, measured);
    println!("{report}");
    Ok(())
}

fn motion(arguments: &Arguments, sources: &Sources) -> Result<(ManifestRow, Vec<Action>)> {
    let task = arguments.task;
    let id = format!("{}/t{}/nominal/i00", task.suite().short_name(), task.index());
    let mut row = benchmark::row_of(id.parse()?)?;
    row.max_steps = arguments.steps;
    let Some(path) = &arguments.actions else {
        let actions = (0..arguments.steps as usize).map(smooth_action);
        return Ok((row, actions.collect()));
    };
    let states = InitialStates::read(&TaskFiles::of_task(sources, task).init)?;
    let (init_id, actions) =
        recorded(path, &states).with_context(|| format!("read the actions {}", path.display()))?;
    row.init_id = init_id;
    Ok((row, actions))
}

/// Reads recorded actions and the index of the initial state that they start from.
fn recorded(path: &Path, states: &InitialStates) -> Result<(u16, Vec<Action>)> {
    let arrays = read_npz(path)?;
    let array = |name: &str| {
        let array = arrays.get(name);
        array.with_context(|| format!("it has no array `{name}`"))
    };
    let state = &array("state")?.values;
    let init_id = (0..states.count()).find(|id| states.get(*id) == Some(state.as_slice()));
    let init_id = init_id.context("its `state` is none of the task's released initial states")?;
    let actions = array("actions")?;
    let count = actions.shape.first().copied().unwrap_or_default();
    ensure!(
        count > 0 && actions.shape == [count, proto::checks::ACTION_WIDTH],
        "its `actions` are not rows of {} numbers",
        proto::checks::ACTION_WIDTH
    );
    let rows = (0..count).map(|step| Ok(actions.row(step).try_into()?));
    Ok((u16::try_from(init_id)?, rows.collect::<Result<_>>()?))
}

impl Bench {
    fn rollout(&mut self, times_physics: bool) -> Result<Timer> {
        let timer = Rc::new(RefCell::new(Timer::new(self.clock, times_physics)));
        let mut actor = OpenLoop {
            timer: Rc::clone(&timer),
            description: self.description.clone(),
            actions: &self.actions,
        };
        let mut watcher = PhaseWatcher { timer: Rc::clone(&timer), problem: None };
        let mut stage = Stage::of_the_protocol(&mut self.simulator);
        timer.borrow_mut().lap();
        let outcome = worker::rollout::run(&mut stage, &mut actor, &self.assignment, &mut watcher);
        if let Some(problem) = watcher.problem.take() {
            return Err(problem).context("time the physics on a copy");
        }
        outcome?;
        drop((actor, watcher));
        let mut timer = Rc::into_inner(timer)
            .context("end the rollout: its timer is still in use")?
            .into_inner();
        timer.phases.other += timer.lap();
        Ok(timer)
    }

    fn measure(&mut self, rollouts: u32, steps: u32) -> Result<Value> {
        let (mut timers, mut settling) = (Vec::new(), Vec::new());
        for _ in 0..rollouts {
            let timer = self.rollout(true)?;
            ensure!(
                timer.steps == steps,
                "time {steps} control steps: the goal was reached after {}; give fewer --steps",
                timer.steps
            );
            timers.push(timer);
            settling.push(self.settling_physics()?);
        }
        let median = |phase: &dyn Fn(&Phases) -> f64| {
            let values: Vec<f64> = timers.iter().map(|timer| phase(&timer.phases)).collect();
            Spread::from_values(&values).map_or(0.0, |spread| spread.median)
        };
        let settling_physics = Spread::from_values(&settling).map_or(0.0, |spread| spread.median);
        // Computed per rollout, so that the parts and the total of a share are of one rollout.
        let shares: Vec<f64> = timers
            .iter()
            .zip(&settling)
            .map(|(timer, settling)| {
                let phases = &timer.phases;
                let needed = phases.physics + settling + phases.frames + phases.policy;
                1.0 - needed / phases.total()
            })
            .collect();
        let shares =
            Spread::from_values(&shares).context("compute the shares: no rollout was timed")?;
        let last = timers.last().context("report the frames: no rollout was timed")?;
        Ok(json!({
            "rollouts": rollouts,
            "steps": steps,
            "frames": last.frames,
            "message_bytes": last.message_bytes,
            "rollout_ms": round(median(&Phases::total)),
            "phases_ms": {
                "reset": round(median(&|phases| phases.reset)),
                "settle": round(median(&|phases| phases.settle)),
                "physics": round(median(&|phases| phases.physics)),
                "control": round(median(&|phases| phases.steps - phases.physics)),
                "frames": round(median(&|phases| phases.frames)),
                "encode": round(median(&|phases| phases.encode)),
                "policy": round(median(&|phases| phases.policy)),
                "other": round(median(&|phases| phases.other)),
            },
            "settle_physics_ms": round(settling_physics),
            "control_step_over_bare": round(median(&|phases| phases.steps / phases.physics)),
            "frame_ms": round(median(&|phases| phases.frames) / f64::from(last.frames.max(1))),
            "neither_physics_nor_drawing_nor_policy": {
                "median": round(shares.median),
                "least": round(shares.least),
                "most": round(shares.most),
            },
        }))
    }

    /// Times the bare physics of the settling steps on copies of their states, in a separate
    /// episode because the worker's loop does not expose the scene before it has settled.
    fn settling_physics(&mut self) -> Result<f64> {
        let row = &self.assignment.row;
        let mut episode = self.simulator.begin(row, Realisation::Matched)?;
        let mut copy = Data::new(episode.environment().model())?;
        let mut millis = 0.0;
        for _ in 0..row.settle_steps {
            millis += bare_millis(self.clock, &mut copy, &mut episode);
            episode.environment().step(&NO_OP)?;
        }
        Ok(millis)
    }
}

fn merge(report: &mut Value, more: Value) {
    if let (Some(report), Value::Object(more)) = (report.as_object_mut(), more) {
        report.extend(more);
    }
}

fn round(value: f64) -> f64 {
    (value * 1e4).round() / 1e4
}
