//! `worker`: see `worker --help`.

#![forbid(unsafe_code)]

use std::convert::Infallible;
use std::ffi::OsString;
use std::io::IsTerminal as _;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::Context;
use clap::Parser;
use protocol::TaskRef;
use scene::{AssetPack, Sources};
use sim::{Simulator, SimulatorConfig};
use tokio::signal::unix::{Signal, SignalKind, signal};
use tokio::sync::mpsc;
use tracing_subscriber::EnvFilter;
use transport::{ClientArguments, Role};
use worker::actor::Actor;
use worker::args::{
    Arguments, Command, FilmArguments, PreviewArguments, RolloutArguments, ServeArguments,
    SimulatorArguments, SlotArguments,
};
use worker::ids::{WorkerId, host_name, random_number};
use worker::message::{Assignment, VideoOf, VideoOrder};
use worker::policy::{POLICY_CALL_DEADLINE, PolicyClient};
use worker::single::{OwnTask, RecordedActions};
use worker::supervise::{self, Config, Identity, SlotCommand};
use worker::{assets, film, preview, single, slot};

/// Compiled scenes that a slot keeps. Jobs of one task come together, so two
/// are enough; each takes some hundred MB with the real assets.
const CACHED_SCENES: usize = 2;
/// Requests to end that wait for the supervisor: the third changes nothing.
const SHUTDOWN_QUEUE: usize = 2;

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| EnvFilter::new("info"));
    tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(std::io::stderr)
        .with_ansi(std::io::stderr().is_terminal())
        .with_target(false)
        .init();
    let result = match (arguments.command, arguments.serve, arguments.simulator) {
        (Some(Command::Slot(slot)), ..) => run_slot(&slot),
        (Some(Command::Rollout(rollout)), ..) => run_rollout(*rollout),
        (Some(Command::Preview(preview)), ..) => run_preview(&preview),
        (Some(Command::Film(arguments)), ..) => run_film(arguments),
        (Some(Command::Assets(arguments)), ..) => {
            assets::run(&arguments).map_err(anyhow::Error::from)
        }
        (None, Some(serve), Some(simulator)) => run_worker(serve, &arguments.access, &simulator),
        (None, ..) => unreachable!("clap asks for --connect and --assets"),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("worker: failed to {error:#}");
            ExitCode::FAILURE
        }
    }
}

fn open(arguments: &SimulatorArguments) -> anyhow::Result<SimulatorConfig> {
    let dir = arguments.sources.clone();
    let sources = Sources::open(&dir.unwrap_or_else(Sources::default_dir))?;
    let pack = AssetPack::open(&arguments.assets, &sources)?;
    Ok(SimulatorConfig {
        sources,
        pack,
        renderer: arguments.renderer,
        cached_scenes: CACHED_SCENES,
    })
}

fn run_slot(arguments: &SlotArguments) -> anyhow::Result<()> {
    let access = arguments.access.access(&[Role::Worker])?;
    Ok(slot::run(open(&arguments.simulator)?, &access)?)
}

fn run_preview(arguments: &PreviewArguments) -> anyhow::Result<()> {
    let mut simulator = Simulator::new(open(&arguments.simulator)?);
    let request = preview::Request {
        task: TaskRef::new(arguments.suite, arguments.task)?,
        config: arguments.config,
        level: arguments.level,
        realisation: arguments.realisation,
    };
    for path in preview::write(&mut simulator, &request, &arguments.output)? {
        println!("{}", path.display());
    }
    Ok(())
}

fn run_film(arguments: FilmArguments) -> anyhow::Result<()> {
    let simulator = open(&arguments.simulator)?;
    let config = film::Config {
        coordinator: arguments.connect,
        access: arguments.access.access(&[Role::Worker])?,
        asset_pack_digest: simulator.pack.digest().to_owned(),
        seed: random_number(),
    };
    let pack = simulator.pack.name().to_owned();
    let filmed = film::run(&config, &mut Simulator::new(simulator))?;
    println!(
        "{} videos stored; no more is left to film with asset pack {pack} and MuJoCo {}",
        filmed.stored,
        Simulator::mujoco_version()
    );
    anyhow::ensure!(
        filmed.failed == 0,
        "film {} rollouts more: the log says why",
        filmed.failed
    );
    Ok(())
}

fn run_rollout(arguments: RolloutArguments) -> anyhow::Result<()> {
    let own_task = own_task(&arguments);
    let mut row = match (&own_task, arguments.id) {
        (Some(task), _) => task.row()?,
        (None, Some(id)) => single::row_of(id)?,
        (None, None) => unreachable!("clap asks for --id or --bddl"),
    };
    let mut actor: Box<dyn Actor> = match (&arguments.actions, &arguments.endpoint) {
        (Some(file), _) => {
            let recorded = RecordedActions::read(file)?;
            row.max_steps = row.max_steps.min(recorded.count());
            Box::new(recorded)
        }
        (None, Some(endpoint)) => Box::new(PolicyClient::new(
            endpoint,
            &arguments.access.access(&[Role::Worker, Role::Operator])?,
        )?),
        (None, None) => unreachable!("clap asks for --endpoint or --actions"),
    };
    let mut simulator = Simulator::new(open(&arguments.simulator)?);
    let assignment = Assignment {
        session: single::session(&row.id, arguments.replicate),
        policy_seed: protocol::seeds::policy_seed(&row.id, arguments.replicate),
        row,
        realisation: arguments.realisation,
        policy: arguments.policy,
        policy_endpoint: arguments.endpoint.unwrap_or_default(),
        policy_deadline: POLICY_CALL_DEADLINE,
        video: (!arguments.no_video).then(|| VideoOrder {
            file: arguments.output.join("video.mp4"),
            of: VideoOf::Everything,
        }),
        keep_actions: false,
    };
    let order = single::Order {
        assignment: &assignment,
        files: own_task.as_ref().map(OwnTask::files),
        draw: !arguments.no_video,
        output: &arguments.output,
    };
    let outcome = single::run(&mut simulator, actor.as_mut(), &order)?.outcome;
    println!(
        "{}: {} after {} steps in {:.1} s; see {}",
        own_task.map_or_else(
            || assignment.row.id.to_string(),
            |task| task.bddl.display().to_string()
        ),
        if outcome.success {
            "success"
        } else {
            "failure"
        },
        outcome.steps,
        outcome.wall_secs,
        arguments.output.display()
    );
    Ok(())
}

fn own_task(arguments: &RolloutArguments) -> Option<OwnTask> {
    let given = &arguments.own_task;
    Some(OwnTask {
        bddl: given.bddl.clone()?,
        init: given.init.clone()?,
        init_id: given.init_id.unwrap_or_default(),
        instruction: given.instruction.clone(),
        max_steps: given.max_steps,
        id: arguments.id,
    })
}

fn run_worker(
    arguments: ServeArguments,
    client: &ClientArguments,
    simulator_arguments: &SimulatorArguments,
) -> anyhow::Result<()> {
    // Opened here too, so that what is missing is said once and at once.
    let access = client.access(&[Role::Worker])?;
    let simulator = open(simulator_arguments)?;
    let host = host_name();
    let seed = random_number();
    let identity = Identity {
        worker: WorkerId::new(&host, seed),
        host,
        asset_pack: simulator.pack.name().to_owned(),
        asset_pack_digest: simulator.pack.digest().to_owned(),
        mujoco_version: Simulator::mujoco_version(),
    };
    println!(
        "worker {}: {} slots, assets {} ({}), MuJoCo {}, coordinator {}",
        identity.worker,
        arguments.slots,
        identity.asset_pack,
        identity.asset_pack_digest.get(..12).unwrap_or_default(),
        identity.mujoco_version,
        arguments.connect
    );
    let scratch = tempfile::tempdir().context("make a folder for videos")?;
    let config = Config {
        coordinator: arguments.connect,
        access,
        identity,
        slots: arguments.slots.get(),
        slot_command: slot_command(
            arguments.slot_program,
            simulator_arguments,
            client,
            simulator.sources.dir(),
        )?,
        policy_endpoint: arguments.policy_endpoint,
        scratch: scratch.path().to_owned(),
        seed,
    };
    let runtime = tokio::runtime::Runtime::new().context("start the runtime")?;
    runtime.block_on(async {
        let (requests, shutdown) = mpsc::channel(SHUTDOWN_QUEUE);
        let signals = [SignalKind::terminate(), SignalKind::interrupt()].map(signal);
        let [terminate, interrupt] = signals;
        let (terminate, interrupt) = (
            terminate.context("listen for SIGTERM")?,
            interrupt.context("listen for SIGINT")?,
        );
        tokio::select! {
            ended = supervise::run(config, shutdown) => Ok(ended?),
            never = forward(terminate, interrupt, requests) => match never {},
        }
    })
}

/// One request to end per signal.
async fn forward(
    mut terminate: Signal,
    mut interrupt: Signal,
    requests: mpsc::Sender<()>,
) -> Infallible {
    loop {
        tokio::select! {
            _ = terminate.recv() => {}
            _ = interrupt.recv() => {}
        }
        // A third one finds the queue full, and nothing left to change.
        let _ = requests.try_send(());
    }
}

/// This program again, as a slot, on the same files; or `instead`.
fn slot_command(
    instead: Option<PathBuf>,
    arguments: &SimulatorArguments,
    access: &ClientArguments,
    sources: &Path,
) -> anyhow::Result<SlotCommand> {
    let program = match instead {
        Some(program) => program,
        None => std::env::current_exe().context("find this program's own file")?,
    };
    let mut slot: Vec<OsString> = vec!["slot".into(), "--assets".into()];
    slot.extend([arguments.assets.clone().into(), "--sources".into()]);
    slot.extend([sources.into(), "--renderer".into()]);
    slot.push(arguments.renderer.to_string().into());
    // Files only: a token in an argument could be read in every process list.
    for (flag, file) in [("--token-file", &access.token_file), ("--ca", &access.ca)] {
        if let Some(file) = file {
            slot.extend([flag.into(), file.into()]);
        }
    }
    Ok(SlotCommand {
        program,
        arguments: slot,
    })
}
