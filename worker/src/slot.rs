//! A slot: a process that simulates one rollout after another. MuJoCo and OpenGL run on its only
//! simulation thread, so that a crash in native code ends the slot and not the worker. The slot
//! takes commands from its parent, sends events, and ends when the parent closes the connection or
//! dies.

use std::ops::ControlFlow;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::{fs, io, process, thread};

use benchmark::attempt::AttemptId;
use scene::SceneError;
use sim::{SceneFolder, SimError, Simulator, SimulatorConfig};
use tokio::signal::unix::{SignalKind, signal};
use transport::{Access, chain};

use crate::actor::PolicyError;
use crate::filming::film;
use crate::message::{Assignment, Failure, FailureKind, RolloutEvent, SlotCommand, SlotEvent};
use crate::parent::{FromParent, Parent};
use crate::pipe::SimulatorCommand;
use crate::policy::{CAMPAIGN_SETTINGS, PolicyClient};
use crate::rollout::{self, Drawn, RolloutError, Watcher};
use crate::simulated::{self, Simulators};
use crate::stage::Stage;
use crate::variants::Prepared;

/// Capacity of the queue of assignments: the parent never queues a second assignment.
const ASSIGNMENT_QUEUE: usize = 1;
/// Adjustment of the out-of-memory score, -1000 to 1000, see proc(5); higher than other
/// processes'.
const OOM_SCORE_ADJ: &str = "500";
/// Interval of progress reports, in control steps or video frames: half a second of the robot's
/// time.
const PROGRESS_EVERY: u32 = 10;

/// Reason why a slot's process ended on its own.
#[derive(Debug, thiserror::Error)]
pub enum SlotError {
    #[error("leave signals to the parent process")]
    Signals(#[source] io::Error),
    #[error("simulate and draw the fixed motion that a slot begins with")]
    Simulator(#[from] SimError),
    #[error("exchange messages with the parent process")]
    Parent(#[source] io::Error),
}

type Abandoned = Mutex<Option<AttemptId>>;

/// Serves the parent process until it closes the connection, with `access` to policies and the
/// commands of other simulators.
pub fn run(
    config: SimulatorConfig,
    simulators: Vec<SimulatorCommand>,
    access: &Access,
) -> Result<(), SlotError> {
    leave_signals_to_the_parent().map_err(SlotError::Signals)?;
    raise_oom_score();
    let parent = Parent::connect().map_err(SlotError::Parent)?;
    let abandoned = Arc::default();
    let assignments = listen(&parent, Arc::clone(&abandoned)).map_err(SlotError::Parent)?;
    let mut simulator = Simulator::new(config);
    let mut simulators = Simulators::new(simulators);
    let mut policy = None;
    let ready = SlotEvent::Ready {
        renderer: simulator.renderer_name()?,
        fingerprint: simulator.fingerprint()?,
    };
    parent.send(&ready).map_err(SlotError::Parent)?;
    while let Ok(assignment) = assignments.recv() {
        let mut reporter = Reporter {
            parent: &parent,
            attempt: assignment.attempt,
            abandoned: &abandoned,
            connection_error: None,
        };
        let policy = (&mut policy, access);
        match &assignment.row.simulator {
            None => run_assignment(&mut simulator, policy, &assignment, &mut reporter),
            Some(simulated) => {
                let (renderer, look) = (simulator.renderer_name()?, simulator.look());
                let drawn = Drawn { renderer, look, ..Drawn::default() };
                let policy = client(policy.0, &assignment.policy_endpoint, policy.1);
                let finished = policy.map_err(RolloutError::from).and_then(|policy| {
                    let simulators = &mut simulators;
                    simulated::run(simulators, simulated, drawn, policy, &assignment, &mut reporter)
                });
                reporter.report(match finished {
                    Ok(finished) => RolloutEvent::Finished(Box::new(finished)),
                    Err(error) => ended(&error),
                });
            }
        }
        if let Some(error) = reporter.connection_error {
            return Err(SlotError::Parent(error));
        }
        warn_of_scene_files();
    }
    Ok(())
}

/// Logs, once, the reason why this process keeps scenes in its own memory instead of in files; logs
/// nothing if there is no such reason.
pub fn warn_of_scene_files() {
    if let Some(problem) = SceneFolder::take_problem() {
        tracing::warn!("{problem}");
    }
}

/// Ignores SIGTERM and SIGINT: a service manager signals all processes of a service, and the
/// parent decides whether the current rollout is finished. Tokio's signal handlers stay installed
/// after their listener and runtime are dropped.
fn leave_signals_to_the_parent() -> io::Result<()> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_io().build()?;
    let _runtime_context = runtime.enter();
    drop(signal(SignalKind::terminate())?);
    drop(signal(SignalKind::interrupt())?);
    Ok(())
}

/// Makes the kernel kill a slot first if memory runs out: a slot can be replaced, its parent or a
/// coordinator on the same machine cannot. A failure is ignored.
pub(crate) fn raise_oom_score() {
    let _ = fs::write("/proc/self/oom_score_adj", OOM_SCORE_ADJ);
}

/// Simulates a rollout, reports its result, and then films it, so that a failure to film cannot
/// cost the result.
fn run_assignment(
    simulator: &mut Simulator,
    (policy, access): (&mut Option<PolicyClient>, &Access),
    assignment: &Assignment,
    reporter: &mut Reporter<'_>,
) {
    let prepared = match prepare(assignment, simulator) {
        Ok(prepared) => prepared,
        Err(error) => {
            let failure = Failure {
                kind: FailureKind::Machine,
                error: format!("failed to {}", chain(&error)),
            };
            return reporter.report(RolloutEvent::Failed(failure));
        }
    };
    let (mut stage, assignment) = match &prepared {
        None => (Stage::of_the_protocol(simulator), assignment),
        Some((prepared, completed)) => {
            let stage = Stage::of_files(simulator, prepared.files.clone());
            let stage = stage.with_variant(Some(prepared.start.clone()));
            (stage, completed)
        }
    };
    let simulated = client(policy, &assignment.policy_endpoint, access)
        .map_err(RolloutError::from)
        .and_then(|policy| rollout::run(&mut stage, policy, assignment, reporter));
    let simulated = match simulated {
        Ok(simulated) => simulated,
        Err(error) => return reporter.report(ended(&error)),
    };
    reporter.report(RolloutEvent::Finished(Box::new(simulated.finished.clone())));
    let mut progress = |pictures| reporter.advance(RolloutEvent::Filming, pictures);
    match film(&mut stage, assignment, &simulated, &mut progress) {
        Ok(None) => {}
        Ok(Some(_)) => reporter.report(RolloutEvent::Filmed),
        Err(error) => reporter.report(RolloutEvent::NotFilmed(chain(&error))),
    }
}

fn ended(error: &RolloutError) -> RolloutEvent {
    error.failure().map_or(RolloutEvent::Abandoned, RolloutEvent::Failed)
}

/// Prepares a rollout of LIBERO's family or of a suite file; also returns the assignment with the
/// completed row. `None` for any other rollout.
fn prepare(
    assignment: &Assignment,
    simulator: &Simulator,
) -> Result<Option<(Prepared, Assignment)>, SceneError> {
    let Some(own) = &assignment.row.own else { return Ok(None) };
    let prepared = Prepared::new(&assignment.row, own, simulator.sources())?;
    let completed = Assignment { row: prepared.row.clone(), ..assignment.clone() };
    Ok(Some((prepared, completed)))
}

/// Returns the client of an endpoint, reusing the last one if the endpoint is the same.
fn client<'a>(
    last: &'a mut Option<PolicyClient>,
    endpoint: &str,
    access: &Access,
) -> Result<&'a mut PolicyClient, PolicyError> {
    let client = match last.take() {
        Some(client) if client.endpoint() == endpoint => client,
        _ => PolicyClient::new(endpoint, access, CAMPAIGN_SETTINGS)?,
    };
    Ok(last.insert(client))
}

/// Reports the events of one attempt to the parent, and checks that the attempt is still wanted.
struct Reporter<'a> {
    parent: &'a Parent,
    attempt: AttemptId,
    abandoned: &'a Abandoned,
    /// Error that broke the connection to the parent.
    connection_error: Option<io::Error>,
}

impl Reporter<'_> {
    fn report(&mut self, event: RolloutEvent) {
        if self.connection_error.is_none() {
            let attempt = self.attempt;
            let sent = self.parent.send(&SlotEvent::Rollout { attempt, event });
            self.connection_error = sent.err();
        }
    }

    /// Reports progress every `PROGRESS_EVERY` steps or frames; returns `Break` if the attempt was
    /// abandoned or the connection broke.
    fn advance(&mut self, event: fn(u32) -> RolloutEvent, done: u32) -> ControlFlow<()> {
        if *lock(self.abandoned) == Some(self.attempt) {
            return ControlFlow::Break(());
        }
        if done.is_multiple_of(PROGRESS_EVERY) {
            self.report(event(done));
        }
        match self.connection_error {
            Some(_) => ControlFlow::Break(()),
            None => ControlFlow::Continue(()),
        }
    }
}

impl Watcher for Reporter<'_> {
    fn progress(&mut self, control_steps: u32) -> ControlFlow<()> {
        self.advance(RolloutEvent::Progress, control_steps)
    }
}

/// Locks the abandoned attempt. Poisoning is ignored, since no code panics while it holds the lock.
fn lock(abandoned: &Abandoned) -> std::sync::MutexGuard<'_, Option<AttemptId>> {
    abandoned.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Reads commands on a thread of their own, because the main thread simulates. Returns the receiver
/// of assignments.
fn listen(parent: &Parent, abandoned: Arc<Abandoned>) -> io::Result<Receiver<Assignment>> {
    let commands = parent.listen()?;
    let (sender, assignments) = sync_channel(ASSIGNMENT_QUEUE);
    thread::spawn(move || handle_commands(commands, &abandoned, &sender));
    Ok(assignments)
}

/// Handles the parent's commands, and ends the process when the parent has closed the connection,
/// even if native code hangs in the main thread.
fn handle_commands(
    commands: FromParent<SlotCommand>,
    abandoned: &Abandoned,
    assignments: &SyncSender<Assignment>,
) {
    for command in commands {
        match command {
            Ok(SlotCommand::Abandon(attempt)) => *lock(abandoned) = Some(attempt),
            Ok(SlotCommand::Run(assignment)) => {
                if assignments.send(*assignment).is_err() {
                    return;
                }
            }
            Err(error) => {
                eprintln!("failed to read a command of the parent process: {error}");
                process::exit(1);
            }
        }
    }
    process::exit(0);
}
