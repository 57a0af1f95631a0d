//! `worker`: see `worker --help`.

#![forbid(unsafe_code)]

use std::convert::Infallible;
use std::iter;
use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use anyhow::{Context, bail};
use benchmark::attempt::Capsule;
use benchmark::family::protocol::Protocol;
use benchmark::{Execution, Look, ManifestRow, Realisation, RolloutId, TaskRef};
use scene::{AssetPack, Sources, TaskFiles};
use sim::{Renderer, SceneFolder, Simulator, SimulatorConfig};
use terminal::counted;
use tokio::signal::unix::{Signal, SignalKind, signal};
use tokio::sync::mpsc;
use transport::{ClientArguments, Role};
use worker::actor::Actor;
use worker::args::{
    Arguments, Command, FilmArguments, PreviewArguments, RescueArguments, RolloutArguments,
    ServeArguments, SimulatorArguments, SlotArguments, SlotCount, VariantsArguments,
};
use worker::assets::Provider;
use worker::child::SlotProgram;
use worker::ids::{WorkerId, host_name, machine, random_number};
use worker::message::{Assignment, Finished, VideoOf, VideoRequest};
use worker::pipe::SimulatorCommand;
use worker::policy::{PolicyClient, ROLLOUT_SETTINGS};
use worker::single::{OwnTask, RecordedActions};
use worker::slot::warn_of_scene_files;
use worker::supervise::{self, Config, Identity, START_DEADLINE};
use worker::{assets, film, pipe, preview, rescue, single, slot, slots, variants};

/// Compiled scenes that a slot caches. The coordinator leases jobs of one task together, so two
/// are enough; with LIBERO's assets each scene takes some hundred MB unless mapped from a file.
const CACHED_SCENES: usize = 2;
/// Capacity of the queue of shutdown requests: a third request has no effect.
const SHUTDOWN_QUEUE: usize = 2;
/// Longest wait for a running fetch after the worker has ended.
const FETCH_GRACE: Duration = Duration::from_secs(1);
/// Release and commit, as printed by `--version`.
const VERSION: &str = version::version!();

fn main() -> ExitCode {
    terminal::end_with_parent();
    let arguments = Arguments::read(VERSION, std::env::args_os());
    let arguments = arguments.unwrap_or_else(|error| error.exit());
    terminal::log("info");
    let result = match (arguments.command, arguments.serve) {
        (Some(Command::Slot(slot)), _) => run_slot(&slot),
        (Some(Command::Rollout(rollout)), _) => run_rollout(*rollout),
        (Some(Command::Rescue(rescue)), _) => run_rescue(*rescue),
        (Some(Command::Variants(arguments)), _) => run_variants(*arguments),
        (Some(Command::Preview(preview)), _) => run_preview(&preview),
        (Some(Command::Film(arguments)), _) => run_film(arguments),
        (Some(Command::Manual { folder }), _) => manual(&folder),
        (Some(Command::Assets(arguments)), _) => {
            assets::run(&arguments).map_err(anyhow::Error::from)
        }
        (None, Some(serve)) => run_worker(serve, &arguments.access, &arguments.simulator),
        (None, _) => unreachable!("clap requires --connect"),
    };
    warn_of_scene_files();
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) if terminal::reader_is_gone(&*error) => ExitCode::SUCCESS,
        Err(error) => {
            terminal::complain(&format!("worker: failed to {}", transport::chain(&*error)));
            ExitCode::FAILURE
        }
    }
}

fn print_line(line: &str) -> anyhow::Result<()> {
    terminal::print_line(line).context("print to standard output")
}

fn manual(folder: &Path) -> anyhow::Result<()> {
    let written =
        terminal::write_manual(terminal::with_variables(Arguments::parser(VERSION)), folder);
    written.with_context(|| format!("write into {}", folder.display()))
}

fn open_simulator(arguments: &SimulatorArguments) -> anyhow::Result<SimulatorConfig> {
    if let Some(scenes) = &arguments.scenes {
        SceneFolder::choose(scenes);
    }
    let dir = arguments.sources.clone();
    let sources = Sources::open(&dir.unwrap_or_else(Sources::default_dir))?;
    let pack = match &arguments.pack_digest {
        Some(digest) => AssetPack::open_known(&arguments.assets, &sources, digest)?,
        None => AssetPack::open(&arguments.assets, &sources)?,
    };
    if arguments.pack_digest.is_none()
        && let Some(differences) = assets::describe_differences(&pack, arguments.assets.as_ref())
    {
        tracing::warn!("{differences}");
    }
    Ok(SimulatorConfig {
        sources,
        pack: pack.with_look(arguments.look),
        renderer: arguments.renderer,
        cached_scenes: CACHED_SCENES,
    })
}

fn run_slot(arguments: &SlotArguments) -> anyhow::Result<()> {
    let access = arguments.access.access(&[Role::Worker])?;
    let simulator = open_simulator(&arguments.scenes)?;
    Ok(slot::run(simulator, arguments.simulator.clone(), &access)?)
}

fn run_preview(arguments: &PreviewArguments) -> anyhow::Result<()> {
    let task = TaskRef::new(arguments.suite, arguments.task)?;
    let simulator = open_simulator(&arguments.simulator)?;
    assets::provide(&simulator.pack, &simulator.sources, [task])?;
    let mut simulator = Simulator::new(simulator);
    let request = preview::Request {
        task,
        config: arguments.config,
        level: arguments.level,
        realisation: arguments.realisation,
    };
    for path in preview::write(&mut simulator, &request, &arguments.output)? {
        print_line(&path.display().to_string())?;
    }
    Ok(())
}

fn run_film(arguments: FilmArguments) -> anyhow::Result<()> {
    let simulator = open_simulator(&arguments.simulator)?;
    let at_a_time = match (arguments.at_a_time, arguments.simulator.renderer) {
        (Some(number), _) => number,
        (None, Renderer::Software) => slots::fitting(1)?,
        // All rollouts share one graphics device.
        (None, _) => NonZeroUsize::MIN,
    };
    tracing::info!("filming {} at a time", counted(at_a_time.get() as u64, "rollout"));
    let config = film::Config {
        coordinator: arguments.connect,
        campaign: arguments.campaign,
        at_a_time,
        access: arguments.access.access(&[Role::Worker])?,
        asset_pack_digest: simulator.pack.digest().to_owned(),
        look: simulator.pack.look(),
        seed: random_number(),
    };
    let pack = simulator.pack.name().to_owned();
    let files = Mutex::new((simulator.pack.clone(), simulator.sources.clone()));
    // The lock serialises fetches of the tasks' files.
    let provide = |task: TaskRef| {
        let files = files.lock().unwrap_or_else(PoisonError::into_inner);
        let (assets, sources) = &*files;
        let provided = assets::provide(assets, sources, [task]);
        provided.map_err(|error| transport::chain(&error))
    };
    let filmed = film::run(&config, &simulator, &provide)?;
    print_line(&format!(
        "{} stored; no rollout is left to film with asset pack {pack}, MuJoCo {} and look {}",
        counted(filmed.stored, "video"),
        Simulator::mujoco_version(),
        config.look
    ))?;
    anyhow::ensure!(
        filmed.failed == 0,
        "film {}: the log says why",
        counted(filmed.failed, "rollout")
    );
    Ok(())
}

fn run_rollout(mut arguments: RolloutArguments) -> anyhow::Result<()> {
    let own_task = own_task(&arguments);
    let capsule = arguments.capsule.as_deref().map(read_capsule).transpose()?;
    let mut row = match (&own_task, arguments.id, &capsule) {
        (.., Some(capsule)) => {
            (arguments.realisation, arguments.replicate, arguments.simulator.look) =
                settings_of(capsule)?;
            // The actions are those that were executed while answers were under way, too.
            ManifestRow { execution: Execution::Wait, ..capsule.manifest_row.clone() }
        }
        (Some(task), ..) => task.row()?,
        (None, Some(id), None) => row(id, arguments.protocol, arguments.suite_file.as_deref())?,
        (None, None, None) => unreachable!("clap requires --id, --bddl or --capsule"),
    };
    if row.id.condition().sets_execution() && !arguments.execution.is_wait() {
        bail!(
            "run {} under execution model {}: its axis is the policy's delay, {}; leave out \
             --execution",
            row.id,
            arguments.execution,
            row.execution
        );
    }
    let recorded = match (&arguments.actions, &arguments.capsule, &capsule) {
        (_, Some(file), Some(capsule)) => {
            let actions = capsule.actions.iter().map(|action| action.map(f64::from));
            Some(RecordedActions::new(file, actions.collect())?)
        }
        (Some(file), ..) => Some(RecordedActions::read(file)?),
        _ => None,
    };
    let mut actor: Box<dyn Actor> = match (recorded, &arguments.endpoint) {
        (Some(recorded), _) => {
            row.max_steps = row.max_steps.min(recorded.count());
            Box::new(recorded)
        }
        (None, Some(endpoint)) => Box::new(PolicyClient::new(
            endpoint,
            &arguments.access.access(&[Role::Worker, Role::Operator])?,
            ROLLOUT_SETTINGS,
        )?),
        (None, None) => unreachable!("clap requires --endpoint, --actions or --capsule"),
    };
    let mut simulator = open_simulator(&arguments.simulator)?;
    let (mut files, mut start) = (own_task.as_ref().map(OwnTask::files), None);
    if let Some(own) = &row.own {
        let prepared = variants::Prepared::new(&row, own, &simulator.sources)?;
        (files, start, row) = (Some(prepared.files), Some(prepared.start), prepared.row);
    }
    let of_task = || TaskFiles::of_task(&simulator.sources, row.id.task());
    let of_scene = files.clone().unwrap_or_else(of_task);
    simulator.pack = wide_enough(simulator.pack, iter::once(of_scene.clone()))?;
    simulator.pack.provide_with_bar(&[of_scene])?;
    let pack = simulator.pack.digest().to_owned();
    let mut simulator = Simulator::new(simulator);
    let assignment = Assignment {
        policy: arguments.policy.unwrap_or_default(),
        policy_endpoint: arguments.endpoint.unwrap_or_default(),
        video: (!arguments.no_video).then(|| VideoRequest {
            file: arguments.output.join("video.mp4"),
            of: VideoOf::Everything,
        }),
        ..Assignment::standalone(
            row.under(&arguments.execution),
            arguments.replicate,
            arguments.realisation,
        )
    };
    let request = single::Request {
        assignment: &assignment,
        files,
        variant: start,
        renders_ends: !arguments.no_video,
        output: &arguments.output,
    };
    let finished = single::run(&mut simulator, actor.as_mut(), &request)?;
    let result = &finished.result;
    print_line(&format!(
        "{}: {} after {} in {:.1} s; see {}",
        own_task
            .map_or_else(|| assignment.row.id.to_string(), |task| task.bddl.display().to_string()),
        if result.success { "success" } else { "failure" },
        counted(result.steps.into(), "step"),
        result.wall_secs,
        arguments.output.display()
    ))?;
    capsule.map_or(Ok(()), |capsule| compare(&capsule, &finished, &pack))
}

fn read_capsule(file: &Path) -> anyhow::Result<Capsule> {
    let read = || Ok::<_, anyhow::Error>(Capsule::read(&std::fs::read_to_string(file)?)?);
    read().with_context(|| {
        format!("read {}; `coordinator jobs --capsule` writes capsules", file.display())
    })
}

fn settings_of(capsule: &Capsule) -> anyhow::Result<(Realisation, u32, Look)> {
    let provenance = &capsule.measurement.provenance;
    Ok((provenance.realisation.parse()?, capsule.replicate, provenance.pin.look))
}

/// Compares a repetition with its capsule; fails if anything differs that the actions determine.
fn compare(capsule: &Capsule, repeated: &Finished, asset_pack: &str) -> anyhow::Result<()> {
    let pins = capsule.other_pins(asset_pack, &Simulator::mujoco_version());
    let differences = capsule.differences(&repeated.result, &repeated.motion);
    if !pins.is_empty() {
        terminal::complain(&format!("simulated with {}", pins.join("; ")));
    }
    anyhow::ensure!(
        differences.is_empty(),
        "repeat the rollout of campaign {}: {}",
        capsule.campaign,
        differences.join("; ")
    );
    let minimal: Vec<String> = capsule.minimal_axes.iter().map(ToString::to_string).collect();
    if !minimal.is_empty() {
        print_line(&format!("smallest sets of axes with this outcome: {}", minimal.join(", ")))?;
    }
    if let Some(step) = capsule.saved_until {
        print_line(&format!("saved if its perturbations end at step {step}, and not later"))?;
    }
    print_line("the same outcome, scene, initial state and path of the robot as in the capsule")
}

/// Returns the row of a rollout of LIBERO-CTRL, of LIBERO's family or of a suite file.
fn row(
    id: RolloutId,
    protocol: Option<Protocol>,
    suite_file: Option<&Path>,
) -> anyhow::Result<ManifestRow> {
    let benchmark = id.variant().and_then(|name| name.benchmark());
    match (benchmark, protocol, suite_file) {
        (_, _, Some(file)) => {
            let row = variants::read_suite_file(file)?.row_of(id);
            row.with_context(|| format!("run {id} of {}", file.display()))
        }
        (Some(benchmark), ..) => Ok(variants::row(id, benchmark, protocol)?),
        (None, Some(_), _) => {
            bail!("run {id}: it is of none of LIBERO's family; leave out --protocol")
        }
        (None, None, _) => Ok(benchmark::row_of(id)?),
    }
}

fn run_variants(arguments: VariantsArguments) -> anyhow::Result<()> {
    let VariantsArguments { choice, list, simulator } = &arguments;
    let rollouts = choice.rollouts()?;
    let simulator = open_simulator(simulator)?;
    let owns = rollouts.iter().filter_map(|(_, row)| row.own.as_deref());
    let files = owns.map(|own| TaskFiles::of_own(&simulator.sources, own));
    let pack = wide_enough(simulator.pack, files)?;
    let audit = variants::Audit::new(rollouts, &pack, &simulator.sources)?;
    let text = if *list { audit.list() } else { audit.report() };
    terminal::print(&text).context("print to standard output")
}

/// Opens a folder of the user's with all its files, if tasks need files beside LIBERO's.
fn wide_enough(
    pack: AssetPack,
    tasks: impl Iterator<Item = TaskFiles>,
) -> anyhow::Result<AssetPack> {
    Ok(match pack.is_too_narrow(tasks) {
        true => AssetPack::open_whole(pack.dir())?.with_look(pack.look()),
        false => pack,
    })
}

fn run_rescue(mut arguments: RescueArguments) -> anyhow::Result<()> {
    let mut capsule = arguments.capsule.as_deref().map(read_capsule).transpose()?;
    if let Some(file) = &arguments.capsule {
        let count = std::fs::read_to_string(file)?.lines().count();
        anyhow::ensure!(
            count == 1,
            "write a step into {}: it holds {count} rollouts; name one to `coordinator jobs`",
            file.display()
        );
    }
    let row = match (&capsule, arguments.id) {
        (Some(capsule), _) => {
            anyhow::ensure!(
                capsule.is_of_libero(),
                "rescue {}: name a rollout of LIBERO's own forty tasks",
                capsule.manifest_row.id
            );
            (arguments.realisation, arguments.replicate, arguments.simulator.look) =
                settings_of(capsule)?;
            capsule.manifest_row.clone()
        }
        (None, Some(id)) => benchmark::row_of(id)?,
        (None, None) => unreachable!("clap requires --id or --capsule"),
    };
    let access = arguments.access.access(&[Role::Worker, Role::Operator])?;
    let mut actor = PolicyClient::new(&arguments.endpoint, &access, ROLLOUT_SETTINGS)?;
    let simulator = open_simulator(&arguments.simulator)?;
    assets::provide(&simulator.pack, &simulator.sources, [row.id.task()])?;
    let mut simulator = Simulator::new(simulator);
    let assignment = Assignment {
        policy: arguments.policy.unwrap_or_default(),
        policy_endpoint: arguments.endpoint,
        ..Assignment::standalone(row, arguments.replicate, arguments.realisation)
    };
    let request = rescue::Request {
        assignment: &assignment,
        capsule: capsule.as_ref(),
        films: !arguments.no_video,
        output: &arguments.output,
    };
    let rescued = rescue::run(&mut simulator, &mut actor, &request)?;
    if let (Some(capsule), Some(file)) = (&mut capsule, &arguments.capsule) {
        capsule.saved_until = rescued.saved_until;
        let text = serde_json::to_string(capsule)? + "\n";
        let part = file.with_extension("part");
        let written = std::fs::write(&part, text).and_then(|()| std::fs::rename(&part, file));
        written.with_context(|| format!("write {}", file.display()))?;
    }
    let summary = match (rescued.saved_until, rescued.lost_from) {
        (None, _) => "not saved by ending its perturbations at any tried step".to_owned(),
        (Some(step), None) => {
            format!("saved if its perturbations end at step {step}, the policy's last query")
        }
        (Some(saved), Some(lost)) => {
            format!("saved if its perturbations end at step {saved}, lost from step {lost} on")
        }
    };
    let exception = match rescued.is_monotone {
        true => "",
        false => ", but lost if they end at an earlier tried step",
    };
    print_line(&format!(
        "{}: {summary}{exception} ({} tried); see {}",
        rescued.rollout_id,
        counted(rescued.tried.len() as u64, "step"),
        arguments.output.display()
    ))?;
    match rescued.saved_by_placebo.len() as u64 {
        0 => Ok(()),
        times => print_line(&format!(
            "at {}, the placebo (nothing lifted, the robot nudged by a thousandth of a millimetre) \
             also saves the rollout: its outcome was marginal there, and these steps do not \
             count as rescues",
            counted(times, "step")
        )),
    }
}

fn own_task(arguments: &RolloutArguments) -> Option<OwnTask> {
    let options = &arguments.own_task;
    Some(OwnTask {
        bddl: options.bddl.clone()?,
        init: options.init.clone()?,
        init_id: options.init_id.unwrap_or_default(),
        instruction: options.instruction.clone(),
        max_steps: options.max_steps,
        id: arguments.id,
    })
}

fn run_worker(
    arguments: ServeArguments,
    client: &ClientArguments,
    simulator_arguments: &SimulatorArguments,
) -> anyhow::Result<()> {
    let access = client.access(&[Role::Worker])?;
    // The parent opens the simulator too, so that missing files are reported once, before any slot
    // starts.
    let simulator = open_simulator(simulator_arguments)?;
    let mut simulator_arguments = simulator_arguments.clone();
    if let Some(Err(error)) = SceneFolder::of_process().map(SceneFolder::check) {
        // The warning is logged once by the parent, instead of by every slot.
        let problem = transport::chain(&error);
        tracing::warn!("scenes are kept in the memory of each slot: failed to {problem}");
        simulator_arguments.scenes = Some("off".into());
    }
    let lacking_tasks = assets::check(&simulator.pack, &simulator.sources)?;
    let has_custom_slot_program = arguments.slot_program.is_some();
    let program = match arguments.slot_program {
        Some(program) => program,
        None => this_program()?,
    };
    let slots = match arguments.slots {
        SlotCount::Given(slots) => {
            // The memory needs of a custom slot program are unknown.
            if !has_custom_slot_program && let Some(warning) = slots::check(slots.get())? {
                tracing::warn!("{warning}");
            }
            slots
        }
        SlotCount::Auto => {
            let slots = slots::fitting(CACHED_SCENES)?;
            tracing::info!("--slots auto: {slots}, one per core, if memory allows");
            slots
        }
    };
    let simulators = pipe::usable(arguments.simulator, START_DEADLINE);
    let host = host_name();
    let seed = random_number();
    let identity = Identity {
        worker: WorkerId::new(&host, seed),
        host,
        machine: arguments.machine.unwrap_or_else(machine),
        asset_pack: simulator.pack.name().to_owned(),
        asset_pack_digest: simulator.pack.digest().to_owned(),
        mujoco_version: Simulator::mujoco_version(),
        look: simulator.pack.look(),
    };
    print_line(&format!(
        "worker {}: {}, assets {} ({}), MuJoCo {}, look {}, coordinator {}",
        identity.worker,
        counted(slots.get() as u64, "slot"),
        identity.asset_pack,
        identity.asset_pack_digest.get(..12).unwrap_or_default(),
        identity.mujoco_version,
        identity.look,
        arguments.connect
    ))?;
    let scratch = tempfile::tempdir().context("make a folder for videos")?;
    let config = Config {
        coordinator: arguments.connect,
        access,
        identity,
        slots: slots.get(),
        slot_program: slot_program(program, &simulator_arguments, client, &simulator, &simulators),
        provider: Some(Provider::new(&simulator.pack, &simulator.sources)),
        lacking_tasks,
        simulators: simulators.iter().map(|simulator| simulator.name.clone()).collect(),
        policy_endpoint: arguments.policy_endpoint,
        drain: arguments.drain_secs.map(Duration::from_secs_f64),
        idle: arguments.idle_secs.map(Duration::from_secs_f64),
        scratch: scratch.path().to_owned(),
        seed,
    };
    let runtime = tokio::runtime::Runtime::new().context("start the runtime")?;
    let ended = runtime.block_on(async {
        let (requests, shutdown) = mpsc::channel(SHUTDOWN_QUEUE);
        let signals = [SignalKind::terminate(), SignalKind::interrupt()].map(signal);
        let [terminate, interrupt] = signals;
        let (terminate, interrupt) =
            (terminate.context("listen for SIGTERM")?, interrupt.context("listen for SIGINT")?);
        tokio::select! {
            ended = supervise::run(config, shutdown) => Ok(ended?),
            never = forward(terminate, interrupt, requests) => match never {},
        }
    });
    // A cancelled fetch may still wait for its server.
    runtime.shutdown_timeout(FETCH_GRACE);
    ended
}

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
        // A third request has no effect, so it may be dropped if the queue is full.
        let _ = requests.try_send(());
    }
}

fn this_program() -> anyhow::Result<PathBuf> {
    std::env::current_exe().context("find this program's own file")
}

/// Returns the command line of a slot's process, with the worker's files and credentials.
fn slot_program(
    program: PathBuf,
    arguments: &SimulatorArguments,
    access: &ClientArguments,
    simulator: &SimulatorConfig,
    simulators: &[SimulatorCommand],
) -> SlotProgram {
    let mut slot = SlotProgram {
        program,
        arguments: vec![
            "slot".into(),
            "--assets".into(),
            arguments.assets.clone().into(),
            "--pack-digest".into(),
            simulator.pack.digest().into(),
            "--sources".into(),
            simulator.sources.dir().into(),
            "--renderer".into(),
            arguments.renderer.to_string().into(),
            "--look".into(),
            arguments.look.name().into(),
        ],
    };
    if let Some(scenes) = &arguments.scenes {
        slot.arguments.extend(["--scenes".into(), scenes.clone()]);
    }
    for SimulatorCommand { name, command } in simulators {
        slot.arguments.extend(["--simulator".into(), format!("{name}={command}").into()]);
    }
    // Credentials are passed as files only: a token in an argument would show in process lists.
    for (flag, file) in [("--token-file", &access.token_file), ("--ca", &access.ca)] {
        if let Some(file) = file {
            slot.arguments.extend([flag.into(), file.into()]);
        }
    }
    slot
}
