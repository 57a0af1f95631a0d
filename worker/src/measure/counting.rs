//! The process of one measured slot: compiles its scene, says that it is ready,
//! and for every number of seconds that it receives runs rollouts for so long
//! and reports what it did. Ends when the parent closes the connection, which is
//! what happens when the parent dies.

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
use crate::slot::die_first;
use crate::stage::Stage;

/// Control steps of a rollout: about what a successful one takes. Then comes the
/// next one, which loads its initial state and settles.
const ROLLOUT_STEPS: u32 = 120;

/// Message of a measured slot to its parent, one JSON value per line.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Said {
    /// The scene is compiled and was drawn once.
    Ready {
        /// The renderer's own name.
        renderer: String,
    },
    /// The time is over.
    Counted(Count),
}

/// Work of one slot.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Count {
    /// Duration, seconds.
    pub(super) secs: f64,
    /// Control steps of the policy.
    pub(super) steps: u32,
    /// Frames drawn.
    pub(super) frames: u32,
    /// Memory use of the process at the end.
    pub(super) memory: SlotMemory,
}

/// Memory of a slot's process, bytes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct SlotMemory {
    /// All that is resident.
    pub(super) resident: u64,
    /// The same, with what several processes share divided among them.
    pub(super) proportional: u64,
    /// Part of it that no other process can share: a further slot adds so much.
    pub(super) own: u64,
    /// Part of it in pages of files, which all slots share: programs, libraries,
    /// scenes.
    pub(super) files: u64,
    /// Share of `own` that the one compiled scene takes.
    pub(super) scene: u64,
    /// Share of `files` that the scene takes.
    pub(super) scene_files: u64,
}

/// Counts control steps of `task` for the parent process, until it closes the
/// connection. The policy looks every `execute` steps and answers `answer_after` so
/// long.
///
/// # Errors
/// If the task cannot be simulated or drawn, or the parent stops listening.
pub fn count(
    config: SimulatorConfig,
    task: TaskRef,
    execute: u32,
    answer_after: Duration,
) -> Result<(), MeasureError> {
    die_first();
    let parent = Parent::connect()?;
    let mut slot = Counting {
        simulator: Simulator::new(config),
        actor: OpenLoop {
            description: description(execute),
            answer_after,
        },
        assignment: assignment(ManifestRow::new(
            RolloutId::clean(task, 0),
            0,
            0,
            Perturbation::default(),
        )),
    };
    let without_scene = SlotMemory::now()?;
    let mut first = Counter::until(Instant::now());
    slot.roll_out(1, &mut first)?;
    let with_scene = SlotMemory::now()?;
    let renderer = slot.simulator.renderer_name();
    parent.send(&Said::Ready {
        renderer: renderer.map_err(|source| RolloutError::Simulator {
            title: slot.assignment.row.id.to_string(),
            source,
        })?,
    })?;
    let times = listen(parent.listen()?);
    while let Ok(secs) = times.recv() {
        let started = Instant::now();
        let mut counter = Counter::until(started + Duration::from_secs_f64(secs));
        while !counter.is_over() {
            slot.roll_out(ROLLOUT_STEPS, &mut counter)?;
        }
        parent.send(&Said::Counted(Count {
            // The last step began in time and is counted, so all that it took is, too.
            secs: started.elapsed().as_secs_f64(),
            steps: counter.steps,
            frames: counter.frames,
            memory: SlotMemory {
                scene: with_scene.own.saturating_sub(without_scene.own),
                scene_files: with_scene.files.saturating_sub(without_scene.files),
                ..SlotMemory::now()?
            },
        }))?;
    }
    Ok(())
}

/// Reads how long to count, in seconds, on a thread of its own: when the parent
/// is gone, there is no one left to report to, and the process ends at once.
fn listen(said: FromParent<f64>) -> Receiver<f64> {
    let (tell, times) = sync_channel(1);
    thread::spawn(move || {
        for secs in said.map_while(Result::ok) {
            if tell.send(secs).is_err() {
                return;
            }
        }
        process::exit(0);
    });
    times
}

struct Counting {
    simulator: Simulator,
    actor: OpenLoop,
    assignment: Assignment,
}

impl Counting {
    /// One rollout, or as much of it as there is time for.
    fn roll_out(&mut self, max_steps: u32, counter: &mut Counter) -> Result<(), RolloutError> {
        self.assignment.row.max_steps = max_steps;
        let mut stage = Stage::of_the_protocol(&mut self.simulator);
        match rollout::run(&mut stage, &mut self.actor, &self.assignment, counter) {
            Ok(_) | Err(RolloutError::Abandoned) => Ok(()),
            Err(error) => Err(error),
        }
    }
}

/// Acts without looking.
struct OpenLoop {
    description: Description,
    /// Stands for what a real policy computes, elsewhere.
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

/// Counts until the time is over.
struct Counter {
    until: Instant,
    steps: u32,
    frames: u32,
}

impl Counter {
    fn until(until: Instant) -> Self {
        Self {
            until,
            steps: 0,
            frames: 0,
        }
    }

    /// Not before the first step: a rate of none could be compared with nothing.
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
        // A policy wants a few cameras.
        self.frames += observation.frames.len() as u32;
    }

    fn moved(&mut self, step: Option<&Step>, _episode: &mut Episode<'_>) {
        self.steps += u32::from(step.is_some());
    }
}

impl SlotMemory {
    /// Reads the memory use of this process, without that of its scene.
    fn now() -> Result<Self, MeasureError> {
        let read = |file: &'static str, fields: &[&'static str]| {
            let file = Path::new(file);
            let text = fs::read_to_string(file)?;
            let bytes = |field: &&'static str| {
                super::room::bytes(&text, field).ok_or_else(|| MeasureError::Memory {
                    field,
                    file: file.to_owned(),
                })
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
