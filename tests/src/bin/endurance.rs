//! Leak test: measures memory over many short rollouts in one process. There are more
//! tasks than cached scenes, so that scenes and their textures are constantly created
//! and dropped. Exits with 1 if memory grows by more than 5 % after the warm-up, or the number of
//! threads or open files changes.
//!
//! With a software renderer, textures and buffers are in this process's memory and
//! are counted; with a GPU driver, check the memory that the driver reports.

use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Instant;

use anyhow::{Context, Result, ensure};
use clap::error::ErrorKind;
use clap::{CommandFactory, Parser};
use libero_ctrl::presets::apply_preset;
use libero_ctrl::{
    Axis, Condition, Level, ManifestRow, Perturbation, Realisation, RolloutId, TaskRef,
};
use scene::Sources;
use scene::pack::LIBERO;
use sim::{CameraRequest, ObservationRequest, Renderer, Simulator, SimulatorConfig};
use tests::files::open_pack;
use worker::measure::open_loop::smooth_action;

/// Run short rollouts and watch this process's memory.
#[derive(Parser)]
struct Arguments {
    /// Total number of rollouts, at least three rounds over the tasks.
    #[arg(long, default_value_t = 500)]
    rollouts: usize,
    /// Number of tasks, spread evenly over the protocol's 40.
    #[arg(long, default_value_t = 10, value_parser = clap::value_parser!(u8).range(1..=40))]
    tasks: u8,
    /// `libero`, `primitives`, or the path of a LIBERO assets folder.
    #[arg(long, default_value = LIBERO)]
    assets: String,
    /// Compiled scenes that are kept.
    #[arg(long, default_value_t = 3)]
    cached_scenes: usize,
    /// Folder with the unpacked packages of robosuite and LIBERO.
    #[arg(long)]
    sources: Option<PathBuf>,
}

/// Control steps of the policy in a rollout.
const STEPS: usize = 20;
/// Side of the one frame drawn, pixels.
const FRAME: u32 = 64;
/// Number of the protocol's configurations, through which the rounds cycle.
const CONFIGS: usize = 10;
/// Divisor of the number of rounds that gives the length of the warm-up.
const WARM_UP_PART: usize = 3;
/// Relative growth from the warm-up to the end that does not count as a leak.
const ALLOWED_GROWTH: f64 = 0.05;

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    let tasks: Vec<TaskRef> = TaskRef::all()
        .step_by(TaskRef::all().count() / usize::from(arguments.tasks))
        .take(usize::from(arguments.tasks))
        .collect();
    let rounds = arguments.rollouts / tasks.len();
    if rounds < WARM_UP_PART {
        let problem = format!(
            "{} rollouts make {rounds} rounds over {} tasks; {WARM_UP_PART} rounds are needed to \
             measure growth: raise --rollouts or lower --tasks",
            arguments.rollouts,
            tasks.len()
        );
        let error = Arguments::command().error(ErrorKind::ValueValidation, problem);
        error.exit();
    }
    match run(&arguments, &tasks, rounds) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: failed to {error:#}");
            ExitCode::FAILURE
        }
    }
}

fn run(arguments: &Arguments, tasks: &[TaskRef], rounds: usize) -> Result<()> {
    let mut simulator = simulator(arguments, tasks)?;
    println!("renderer: {}", simulator.renderer_name()?);
    let start = Instant::now();
    // Memory is measured at the ends of rounds, when the cache always holds the same scenes.
    let mut memory = Vec::new();
    for round in 0..rounds {
        for task in tasks {
            roll_out(&mut simulator, *task, round % CONFIGS)
                .with_context(|| format!("run {task}"))?;
        }
        let used = Memory::now()?;
        println!(
            "{:5} rollouts, {:6.0} s: {:7.1} MiB resident, {} threads, {} files open",
            (round + 1) * tasks.len(),
            start.elapsed().as_secs_f64(),
            used.resident_mib,
            used.threads,
            used.open_files
        );
        memory.push(used);
    }
    check_growth(&memory, tasks.len())
}

/// Compares the median of the last third of the rounds with that of the first, the warm-up. A
/// maximum would grow with the number of rounds even without a leak, because allocators return
/// pages at arbitrary times.
fn check_growth(memory: &[Memory], tasks: usize) -> Result<()> {
    let part = memory.len() / WARM_UP_PART;
    let (warm_up, last) = (&memory[..part], &memory[memory.len() - part..]);
    let median = |used: &[Memory]| {
        let mut values: Vec<f64> = used.iter().map(|m| m.resident_mib).collect();
        values.sort_by(f64::total_cmp);
        values[values.len() / 2]
    };
    let growth = median(last) / median(warm_up) - 1.0;
    println!(
        "resident: {:.1} MiB in the first {rollouts} rollouts, {:.1} MiB in the last {rollouts}: {:+.1} %",
        median(warm_up),
        median(last),
        growth * 100.0,
        rollouts = part * tasks,
    );
    ensure!(
        growth <= ALLOWED_GROWTH,
        "keep memory level: it grew by {:.1} %, {:.0} % are allowed",
        growth * 100.0,
        ALLOWED_GROWTH * 100.0
    );
    let counts = |used: &Memory| (used.threads, used.open_files);
    if let (Some(before), Some(after)) = (warm_up.last(), last.last()) {
        ensure!(
            counts(before) == counts(after),
            "keep threads and open files level: {:?} became {:?}",
            counts(before),
            counts(after)
        );
    }
    Ok(())
}

fn simulator(arguments: &Arguments, tasks: &[TaskRef]) -> Result<Simulator> {
    let dir = arguments.sources.clone();
    let sources = Sources::open(&dir.unwrap_or_else(Sources::default_dir))?;
    Ok(Simulator::new(SimulatorConfig {
        pack: open_pack(&arguments.assets, &sources, tasks.iter().copied())?,
        sources,
        renderer: Renderer::default(),
        cached_scenes: arguments.cached_scenes,
    }))
}

/// Runs one short rollout with all metric axes perturbed (all but language), as in a campaign.
fn roll_out(simulator: &mut Simulator, task: TaskRef, config: usize) -> Result<()> {
    const LEVEL: Level = Level::L2;
    let init_id = task.eval_init_ids()[config];
    let config = u16::try_from(config)?;
    let mut perturbation = Perturbation::default();
    for axis in Axis::METRIC {
        apply_preset(&mut perturbation, axis, LEVEL, config);
    }
    let id = RolloutId::perturbed(task, Condition::Combination, LEVEL, config)?;
    let row = ManifestRow::new(id, config, init_id, perturbation);
    let mut episode = simulator.begin(&row, Realisation::Matched)?;
    episode.settle()?;
    for step in 0..STEPS {
        episode.step(&smooth_action(step))?;
    }
    let camera = CameraRequest { name: "agentview".to_owned(), width: FRAME, height: FRAME };
    episode.observe(&ObservationRequest { cameras: vec![camera], privileged: true })?;
    Ok(())
}

/// Resource usage of this process.
struct Memory {
    resident_mib: f64,
    threads: usize,
    open_files: usize,
}

impl Memory {
    fn now() -> Result<Self> {
        let path = "/proc/self/status";
        let status = std::fs::read_to_string(path).with_context(|| format!("read {path}"))?;
        let field = |name: &str| -> Result<usize> {
            status
                .lines()
                .find_map(|line| line.strip_prefix(name)?.split_whitespace().next())
                .and_then(|value| value.parse().ok())
                .with_context(|| format!("find `{name}` in {path}"))
        };
        Ok(Self {
            resident_mib: field("VmRSS:")? as f64 / 1024.0,
            threads: field("Threads:")?,
            open_files: std::fs::read_dir("/proc/self/fd")?.count(),
        })
    }
}
