//! The process of one measured slot: compiles its scene and reports that it is ready. For every
//! number of seconds that the parent sends, it runs rollouts for that long and reports the counts.
//! It ends when the parent closes the connection or dies.

use std::ops::ControlFlow;
use std::path::Path;
use std::sync::mpsc::{Receiver, sync_channel};
use std::time::{Duration, Instant};
use std::{fs, process, thread};

use libero_ctrl::{ManifestRow, Perturbation, Query, RolloutId, TaskRef};
use proto::policy::Observation;
use serde::{Deserialize, Serialize};
use sim::{Episode, Simulator, SimulatorConfig};

use super::MeasureError;
use super::open_loop::{assignment, description, smooth_action};
use crate::actor::{Action, Actor, Description, PolicyError, PolicySession};
use crate::message::Assignment;
use crate::parent::{FromParent, Parent};
use crate::rollout::{self, RolloutError, Step, Watcher};
use crate::slot::raise_oom_score;
use crate::stage::Stage;

/// Control steps of a measured rollout: about as many as a successful rollout takes, so that
/// loading and settling take their usual share of the time.
const ROLLOUT_STEPS: u32 = 120;

/// Message of a measured slot to its parent, one JSON value per line.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum SlotReport {
    /// The scene is compiled and was rendered once.
    Ready {
        /// The renderer's own name.
        renderer: String,
    },
    Counted(Count),
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Count {
    /// Duration, seconds.
    pub(super) secs: f64,
    /// Control steps after settling.
    pub(super) steps: u32,
    pub(super) frames: u32,
    /// Memory use of the process at the end.
    pub(super) memory: SlotMemory,
}

/// Memory of a slot's process, bytes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct SlotMemory {
    /// Resident bytes (VmRSS).
    pub(super) resident: u64,
    /// Resident bytes, with shared pages divided among their processes (PSS).
    pub(super) proportional: u64,
    /// Resident bytes that no other process can share: the cost of a further slot.
    pub(super) own: u64,
    /// Resident pages of files, which all slots share: programs, libraries, scenes.
    pub(super) files: u64,
    /// Part of `own` that the one compiled scene takes.
    pub(super) scene: u64,
    /// Part of `files` that the scene takes.
    pub(super) scene_files: u64,
}

/// Counts control steps of `task` for the parent process until the parent closes the connection.
/// The simulated policy is queried every `execute` steps and answers after `answer_after`.
pub fn count(
    config: SimulatorConfig,
    task: TaskRef,
    execute: u32,
    answer_after: Duration,
) -> Result<(), MeasureError> {
    raise_oom_score();
    let parent = Parent::connect()?;
    let mut slot = MeasuredSlot {
        simulator: Simulator::new(config),
        actor: OpenLoop { description: description(execute), answer_after },
        assignment: assignment(ManifestRow::new(
            RolloutId::clean(task, 0),
            0,
            0,
            Perturbation::default(),
        )),
    };
    let without_scene = SlotMemory::read()?;
    let mut first = Counter::until(Instant::now());
    slot.roll_out(1, &mut first)?;
    let with_scene = SlotMemory::read()?;
    let renderer = slot.simulator.renderer_name();
    parent.send(&SlotReport::Ready {
        renderer: renderer.map_err(|source| RolloutError::Simulator {
            title: slot.assignment.row.id.to_string(),
            source,
        })?,
    })?;
    let periods = receive_periods(parent.listen()?);
    while let Ok(secs) = periods.recv() {
        let started = Instant::now();
        let mut counter = Counter::until(started + Duration::from_secs_f64(secs));
        while !counter.is_over() {
            slot.roll_out(ROLLOUT_STEPS, &mut counter)?;
        }
        parent.send(&SlotReport::Counted(Count {
            // The last step began in time and is counted, so its whole duration counts too.
            secs: started.elapsed().as_secs_f64(),
            steps: counter.steps,
            frames: counter.frames,
            memory: SlotMemory {
                scene: with_scene.own.saturating_sub(without_scene.own),
                scene_files: with_scene.files.saturating_sub(without_scene.files),
                ..SlotMemory::read()?
            },
        }))?;
    }
    Ok(())
}

/// Reads the lengths of the periods to count, in seconds, on a thread of its own. Ends the process
/// when the parent closes the connection, because no one is left to report to.
fn receive_periods(requests: FromParent<f64>) -> Receiver<f64> {
    let (sender, periods) = sync_channel(1);
    thread::spawn(move || {
        for secs in requests.map_while(Result::ok) {
            if sender.send(secs).is_err() {
                return;
            }
        }
        process::exit(0);
    });
    periods
}

struct MeasuredSlot {
    simulator: Simulator,
    actor: OpenLoop,
    assignment: Assignment,
}

impl MeasuredSlot {
    /// Simulates one rollout, or the part of it that fits into the counter's time.
    fn roll_out(&mut self, max_steps: u32, counter: &mut Counter) -> Result<(), RolloutError> {
        self.assignment.row.max_steps = max_steps;
        let mut stage = Stage::of_the_protocol(&mut self.simulator);
        match rollout::run(&mut stage, &mut self.actor, &self.assignment, counter) {
            Ok(_) | Err(RolloutError::Abandoned) => Ok(()),
            Err(error) => Err(error),
        }
    }
}

/// Policy with a fixed sequence of actions.
struct OpenLoop {
    description: Description,
    /// Simulated duration of a real policy's inference on another machine.
    answer_after: Duration,
}

impl Actor for OpenLoop {
    fn describe(&mut self, _: PolicySession<'_>) -> Result<Description, PolicyError> {
        Ok(self.description.clone())
    }

    fn infer(
        &mut self,
        _: PolicySession<'_>,
        query_index: u32,
        _observation: Observation,
        horizon: usize,
        _: Option<&Query>,
    ) -> Result<Vec<Action>, PolicyError> {
        thread::sleep(self.answer_after);
        let first = query_index as usize * horizon;
        Ok((first..first + horizon).map(smooth_action).collect())
    }
}

/// Counts steps and frames until a deadline.
struct Counter {
    until: Instant,
    steps: u32,
    frames: u32,
}

impl Counter {
    fn until(until: Instant) -> Self {
        Self { until, steps: 0, frames: 0 }
    }

    /// Returns true after the deadline, but not before the first step, so that the rate is never
    /// zero.
    fn is_over(&self) -> bool {
        self.steps > 0 && Instant::now() >= self.until
    }
}

impl Watcher for Counter {
    fn progress(&mut self, _control_steps: u32) -> ControlFlow<()> {
        match self.is_over() {
            true => ControlFlow::Break(()),
            false => ControlFlow::Continue(()),
        }
    }

    fn observed(&mut self, _query_index: u32, observation: &sim::Observation) {
        // The number of cameras fits into 32 bits.
        self.frames += observation.frames.len() as u32;
    }

    fn moved(&mut self, step: Option<&Step>, _episode: &mut Episode<'_>) {
        self.steps += u32::from(step.is_some());
    }
}

impl SlotMemory {
    /// Reads the memory use of this process; the parts that the scene takes are left at zero.
    fn read() -> Result<Self, MeasureError> {
        let read = |file: &'static str, fields: &[&'static str]| {
            let file = Path::new(file);
            let text = fs::read_to_string(file)?;
            let bytes = |field: &&'static str| {
                super::room::bytes(&text, field)
                    .ok_or_else(|| MeasureError::Memory { field, file: file.to_owned() })
            };
            fields.iter().map(bytes).collect::<Result<Vec<u64>, _>>()
        };
        let status = read("/proc/self/status", &["VmRSS:", "RssFile:"])?;
        let rollup = read("/proc/self/smaps_rollup", &["Pss:"])?;
        let (resident, files) = (status[0], status[1]);
        Ok(Self {
            resident,
            proportional: rollup[0],
            own: resident.saturating_sub(files),
            files,
            ..Self::default()
        })
    }
}
