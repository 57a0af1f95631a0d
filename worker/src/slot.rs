//! A slot: the process that simulates one rollout after the other. It owns
//! MuJoCo and OpenGL on one thread, so that what native code breaks is this
//! process and not the worker. Takes orders on standard input and reports on
//! standard output; ends when its input does, which is what happens when the
//! parent dies.

use std::io::{self, BufRead, Read, Write};
use std::ops::ControlFlow;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::{fs, process, thread};

use sim::{SimError, Simulator, SimulatorConfig};
use tokio::signal::unix::{SignalKind, signal};
use transport::Access;

use crate::message::{Assignment, MAX_LINE_BYTES, Order, Report};
use crate::policy::{PolicyClient, PolicyError};
use crate::rollout::{self, RolloutError, Stage, Watcher};

/// Rollouts that wait while another one is simulated: the parent never sends
/// more than one.
const ASSIGNMENT_QUEUE: usize = 1;
/// Of -1000 to 1000, see proc(5); more than other processes have.
const OOM_SCORE_ADJ: &str = "500";
/// A report of progress every so many control steps: half a second of the
/// robot's time.
const PROGRESS_EVERY: u32 = 10;

/// Why a slot's process ended by itself.
#[derive(Debug, thiserror::Error)]
pub enum SlotError {
    /// Signals cannot be caught.
    #[error("leave signals to the parent process")]
    Signals(#[source] io::Error),
    /// Nothing can be simulated or drawn.
    #[error("simulate and draw the fixed motion that a slot begins with")]
    Simulator(#[from] SimError),
    /// The parent no longer listens.
    #[error("report to the parent process")]
    Report(#[source] io::Error),
}

/// Serves the parent process, with `access` to policies, until it closes this process's standard input.
///
/// # Errors
/// If nothing can be simulated or drawn, or the parent stops listening.
pub fn run(config: SimulatorConfig, access: &Access) -> Result<(), SlotError> {
    leave_signals_to_the_parent().map_err(SlotError::Signals)?;
    die_first();
    let abandoned = Arc::new(AtomicBool::new(false));
    let assignments = listen(Arc::clone(&abandoned));
    let mut simulator = Simulator::new(config);
    let mut policy = None;
    report(&Report::Ready {
        renderer: simulator.renderer_name()?,
        fingerprint: simulator.fingerprint()?,
    })?;
    while let Ok(assignment) = assignments.recv() {
        let mut watcher = Reporter {
            abandoned: &abandoned,
            broken: None,
        };
        let ending = attempt(
            &mut simulator,
            (&mut policy, access),
            &assignment,
            &mut watcher,
        );
        if let Some(error) = watcher.broken {
            return Err(error);
        }
        report(&ending)?;
    }
    Ok(())
}

/// What ends a service signals all of its processes, and the rollout in hand
/// is to be finished: the parent decides. A handler of tokio's stays installed
/// for good, also without its listener and its runtime.
fn leave_signals_to_the_parent() -> io::Result<()> {
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_io()
        .build()?;
    let _inside = runtime.enter();
    drop(signal(SignalKind::terminate())?);
    drop(signal(SignalKind::interrupt())?);
    Ok(())
}

/// Where memory runs out, the kernel is to take a slot, which is replaced, and
/// not its parent or a coordinator on the same machine. Where it does not let
/// itself be told, nothing is lost but that.
pub(crate) fn die_first() {
    let _ = fs::write("/proc/self/oom_score_adj", OOM_SCORE_ADJ);
}

fn attempt(
    simulator: &mut Simulator,
    (policy, access): (&mut Option<PolicyClient>, &Access),
    assignment: &Assignment,
    watcher: &mut Reporter<'_>,
) -> Report {
    let outcome = client(policy, &assignment.policy_endpoint, access)
        .map_err(RolloutError::from)
        .and_then(|policy| {
            rollout::run(
                Stage::of_the_protocol(simulator),
                policy,
                assignment,
                watcher,
            )
        });
    match outcome {
        Ok(finished) => Report::Finished(Box::new(finished)),
        Err(error) => match error.failure() {
            Some(failure) => Report::Failed(failure),
            None => Report::Abandoned,
        },
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
        _ => PolicyClient::new(endpoint, access)?,
    };
    Ok(last.insert(client))
}

/// Reports progress, and sees whether the rollout is still wanted.
struct Reporter<'a> {
    abandoned: &'a AtomicBool,
    /// Why the parent can no longer be told anything.
    broken: Option<SlotError>,
}

impl Watcher for Reporter<'_> {
    fn progress(&mut self, control_steps: u32) -> ControlFlow<()> {
        if self.abandoned.load(Ordering::Relaxed) {
            return ControlFlow::Break(());
        }
        if !control_steps.is_multiple_of(PROGRESS_EVERY) {
            return ControlFlow::Continue(());
        }
        match report(&Report::Progress(control_steps)) {
            Ok(()) => ControlFlow::Continue(()),
            Err(error) => {
                self.broken = Some(error);
                ControlFlow::Break(())
            }
        }
    }
}

fn report(report: &Report) -> Result<(), SlotError> {
    let mut line = serde_json::to_vec(report).map_err(|error| SlotError::Report(error.into()))?;
    line.push(b'\n');
    let mut stdout = io::stdout().lock();
    let written = stdout.write_all(&line).and_then(|()| stdout.flush());
    written.map_err(SlotError::Report)
}

/// Reads orders on a thread of their own, because the other one is simulating.
fn listen(abandoned: Arc<AtomicBool>) -> Receiver<Assignment> {
    let (sender, assignments) = sync_channel(ASSIGNMENT_QUEUE);
    thread::spawn(move || take_orders(&abandoned, &sender));
    assignments
}

/// Ends the process at the end of its input: nobody would be told what it finds
/// out any more. Native code that hangs cannot stop this.
fn take_orders(abandoned: &AtomicBool, assignments: &SyncSender<Assignment>) {
    let mut stdin = io::stdin().lock();
    loop {
        let mut line = Vec::new();
        let read = stdin
            .by_ref()
            .take(MAX_LINE_BYTES)
            .read_until(b'\n', &mut line);
        match (read, serde_json::from_slice(&line)) {
            (Ok(0) | Err(_), _) => process::exit(0),
            (Ok(_), Ok(Order::Abandon)) => abandoned.store(true, Ordering::Relaxed),
            (Ok(_), Ok(Order::Run(assignment))) => {
                abandoned.store(false, Ordering::Relaxed);
                if assignments.send(*assignment).is_err() {
                    return;
                }
            }
            (Ok(_), Err(error)) => {
                eprintln!("failed to read an order of the parent process: {error}");
                process::exit(1);
            }
        }
    }
}
