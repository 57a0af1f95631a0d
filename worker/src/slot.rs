//! A slot: the process that simulates one rollout after the other. It owns
//! MuJoCo and OpenGL on one thread, so that what native code breaks is this
//! process and not the worker. Takes commands from its parent and sends it
//! events; ends when the parent closes the connection, which is what happens
//! when the parent dies.

use std::ops::ControlFlow;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::{fs, io, process, thread};

use rollout_types::AttemptId;
use sim::{SceneFolder, SimError, Simulator, SimulatorConfig};
use tokio::signal::unix::{SignalKind, signal};
use transport::{Access, chain};

use crate::actor::PolicyError;
use crate::filming::film;
use crate::message::{Assignment, RolloutEvent, SlotCommand, SlotEvent};
use crate::parent::{FromParent, Parent};
use crate::policy::{OF_A_CAMPAIGN, PolicyClient};
use crate::rollout::{self, RolloutError, Watcher};
use crate::stage::Stage;

/// Rollouts that wait while another one is simulated: the parent never sends
/// more than one.
const ASSIGNMENT_QUEUE: usize = 1;
/// Score from -1000 to 1000, see proc(5); more than other processes have.
const OOM_SCORE_ADJ: &str = "500";
/// Progress is reported every so many control steps, and pictures of a video:
/// half a second of the robot's time.
const PROGRESS_EVERY: u32 = 10;

/// Reason for which a slot's process ended by itself.
#[derive(Debug, thiserror::Error)]
pub enum SlotError {
    /// Signals cannot be caught.
    #[error("leave signals to the parent process")]
    Signals(#[source] io::Error),
    /// Nothing can be simulated or drawn.
    #[error("simulate and draw the fixed motion that a slot begins with")]
    Simulator(#[from] SimError),
    /// The parent no longer listens.
    #[error("talk to the parent process")]
    Parent(#[source] io::Error),
}

/// The attempt that the parent abandoned last.
type Abandoned = Mutex<Option<AttemptId>>;

/// Serves the parent process, with `access` to policies, until it closes the
/// connection.
///
/// # Errors
/// If nothing can be simulated or drawn, or the parent stops listening.
pub fn run(config: SimulatorConfig, access: &Access) -> Result<(), SlotError> {
    leave_signals_to_the_parent().map_err(SlotError::Signals)?;
    die_first();
    let parent = Parent::connect().map_err(SlotError::Parent)?;
    let abandoned = Arc::default();
    let assignments = listen(&parent, Arc::clone(&abandoned)).map_err(SlotError::Parent)?;
    let mut simulator = Simulator::new(config);
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
            broken: None,
        };
        work(
            &mut simulator,
            (&mut policy, access),
            &assignment,
            &mut reporter,
        );
        if let Some(error) = reporter.broken {
            return Err(SlotError::Parent(error));
        }
        warn_of_scene_files();
    }
    Ok(())
}

/// Logs why this process keeps a scene in memory of its own, if it does; once.
pub fn warn_of_scene_files() {
    if let Some(problem) = SceneFolder::take_problem() {
        tracing::warn!("{problem}");
    }
}

/// Ignores SIGTERM and SIGINT: a service manager signals all processes of a
/// service, and the parent decides whether the rollout in hand is finished. A
/// handler of tokio's stays installed for good, also without its listener and
/// its runtime.
fn leave_signals_to_the_parent() -> io::Result<()> {
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_io()
        .build()?;
    let _inside = runtime.enter();
    drop(signal(SignalKind::terminate())?);
    drop(signal(SignalKind::interrupt())?);
    Ok(())
}

/// Asks the kernel to kill a slot first if memory runs out: a slot is replaced,
/// its parent or a coordinator on the same machine is not. If the kernel
/// refuses, nothing else is lost.
pub(crate) fn die_first() {
    let _ = fs::write("/proc/self/oom_score_adj", OOM_SCORE_ADJ);
}

/// Simulates a rollout, tells its result, and films it afterwards: what goes
/// wrong there cannot cost the result.
fn work(
    simulator: &mut Simulator,
    (policy, access): (&mut Option<PolicyClient>, &Access),
    assignment: &Assignment,
    reporter: &mut Reporter<'_>,
) {
    let mut stage = Stage::of_the_protocol(simulator);
    let simulated = client(policy, &assignment.policy_endpoint, access)
        .map_err(RolloutError::from)
        .and_then(|policy| rollout::run(&mut stage, policy, assignment, reporter));
    let simulated = match simulated {
        Ok(simulated) => simulated,
        Err(error) => {
            let event = error.failure().map(RolloutEvent::Failed);
            return reporter.tell(event.unwrap_or(RolloutEvent::Abandoned));
        }
    };
    reporter.tell(RolloutEvent::Finished(Box::new(simulated.finished.clone())));
    let mut progress = |pictures| reporter.advance(RolloutEvent::Filming, pictures);
    match film(&mut stage, assignment, &simulated, &mut progress) {
        Ok(None) => {}
        Ok(Some(_)) => reporter.tell(RolloutEvent::Filmed),
        Err(error) => reporter.tell(RolloutEvent::NotFilmed(chain(&error))),
    }
}

/// The client of an endpoint: the last one, as a rule.
fn client<'a>(
    last: &'a mut Option<PolicyClient>,
    endpoint: &str,
    access: &Access,
) -> Result<&'a mut PolicyClient, PolicyError> {
    let client = match last.take() {
        Some(client) if client.endpoint() == endpoint => client,
        _ => PolicyClient::new(endpoint, access, OF_A_CAMPAIGN)?,
    };
    Ok(last.insert(client))
}

/// Tells the parent about one attempt, and sees whether it is still wanted.
struct Reporter<'a> {
    parent: &'a Parent,
    attempt: AttemptId,
    abandoned: &'a Abandoned,
    /// Error after which the parent can no longer be reached.
    broken: Option<io::Error>,
}

impl Reporter<'_> {
    fn tell(&mut self, event: RolloutEvent) {
        if self.broken.is_none() {
            let attempt = self.attempt;
            let told = self.parent.send(&SlotEvent::Rollout { attempt, event });
            self.broken = told.err();
        }
    }

    /// Tells now and then how far a stage of the attempt has come; `Break` once
    /// the attempt is no longer wanted.
    fn advance(&mut self, event: fn(u32) -> RolloutEvent, done: u32) -> ControlFlow<()> {
        if *lock(self.abandoned) == Some(self.attempt) {
            return ControlFlow::Break(());
        }
        if done.is_multiple_of(PROGRESS_EVERY) {
            self.tell(event(done));
        }
        match self.broken {
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

/// Nothing panics while it holds the lock.
fn lock(abandoned: &Abandoned) -> std::sync::MutexGuard<'_, Option<AttemptId>> {
    abandoned.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Reads commands on a thread of their own, because this one simulates.
fn listen(parent: &Parent, abandoned: Arc<Abandoned>) -> io::Result<Receiver<Assignment>> {
    let commands = parent.listen()?;
    let (sender, assignments) = sync_channel(ASSIGNMENT_QUEUE);
    thread::spawn(move || take_commands(commands, &abandoned, &sender));
    Ok(assignments)
}

/// Ends the process when the parent has gone: there is no one left to report to.
/// Native code that hangs cannot stop this.
fn take_commands(
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
