//! `cargo xtask bench python`: times this project's Python environments and the original LIBERO's,
//! in turn. `python/bench/speed.py` and docs/PYTHON.md describe the measurement.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::Result;
use serde_json::Value;

use crate::bench::{last_json, machine, number, spread};
use crate::cargo::build_released_program;
use crate::original::Original;
use crate::setup;
use crate::wheel::{self, Profile};

/// Program that steps the same environments from Rust; the difference in speed is Python's
/// overhead.
const WITHOUT_PYTHON: &str = "bench_environments";
/// Number of pairs of runs per round, one run from Python and one from Rust. Both kinds of runs
/// alternate, because the difference in their speed is smaller than the change of a shared
/// machine's speed within a minute.
const PAIRS: usize = 5;

/// Options of `cargo xtask bench python`.
#[derive(clap::Args)]
pub(crate) struct Options {
    /// The task: SUITE/N.
    #[arg(long, default_value = "libero_goal/8")]
    task: String,
    /// Number of rounds; each round runs every program in turn.
    #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..))]
    rounds: u32,
    /// Environments that step together.
    #[arg(long, default_value_t = 16, value_parser = clap::value_parser!(u32).range(1..))]
    environments: u32,
    /// Control steps that are timed.
    #[arg(long, default_value_t = 30, value_parser = clap::value_parser!(u32).range(1..))]
    steps: u32,
    /// Folder of the reference data. [default: ../shared/oracle beside this checkout]
    #[arg(long)]
    oracle: Option<PathBuf>,
    /// LIBERO's assets folder. [default: the folder of `worker assets fetch`]
    #[arg(long)]
    assets: Option<PathBuf>,
}

/// Row of the table. The last row compares with a program without Python, in the column of the
/// original.
struct Row {
    name: &'static str,
    /// Target of the ratio or, if the target has a unit, of this project's value.
    target: &'static str,
    unit: &'static str,
    /// Returns this project's value, the original's, and their ratio.
    values_of: fn(&Round) -> Result<[f64; 3]>,
}

/// Outputs of the programs of one round.
struct Round {
    /// A single environment of this project.
    ours: Value,
    /// A single environment of the original.
    theirs: Value,
    /// Environments of the original, each in its own process.
    processes: Value,
    pairs: Vec<Pair>,
}

/// Outputs of two runs of the same environments of this project.
struct Pair {
    /// Environments in threads of one Python process.
    threads: Value,
    /// Environments in a program without Python.
    without_python: Value,
}

const ROWS: [Row; 6] = [
    Row {
        name: "control step without frames",
        target: ">= 4",
        unit: "ms",
        values_of: |round| compare_values(&round.theirs, &round.ours, "step_ms"),
    },
    Row {
        name: "reset",
        target: ">= 500",
        unit: "ms",
        values_of: |round| compare_values(&round.theirs, &round.ours, "reset_ms"),
    },
    Row {
        name: "step with both frames",
        target: ">= 8",
        unit: "ms",
        values_of: |round| compare_values(&round.theirs, &round.ours, "frames_ms"),
    },
    Row {
        name: "environments together",
        target: ">= 8",
        unit: "obs/s",
        values_of: |round| {
            let ours = median(round, |pair| rate(&pair.threads))?;
            let theirs = rate(&round.processes)?;
            Ok([ours, theirs, ours / theirs])
        },
    },
    Row {
        name: "memory of a further environment",
        target: "<= 15 MiB",
        unit: "MiB",
        values_of: |round| compare_values(&round.processes, &round.pairs[0].threads, "further_mib"),
    },
    Row {
        name: "environments without Python",
        target: ">= 0.95",
        unit: "obs/s",
        values_of: |round| {
            Ok([
                median(round, |pair| rate(&pair.threads))?,
                median(round, |pair| rate(&pair.without_python))?,
                median(round, |pair| Ok(rate(&pair.threads)? / rate(&pair.without_python)?))?,
            ])
        },
    },
];

/// Returns our value, the original's, and the original's divided by ours.
fn compare_values(theirs: &Value, ours: &Value, name: &str) -> Result<[f64; 3]> {
    let [ours, theirs] = [number(&ours[name], name)?, number(&theirs[name], name)?];
    Ok([ours, theirs, theirs / ours])
}

fn rate(run: &Value) -> Result<f64> {
    const RATE: &str = "observations_per_second";
    number(&run[RATE], RATE)
}

fn median(round: &Round, value_of: impl Fn(&Pair) -> Result<f64>) -> Result<f64> {
    let values = round.pairs.iter().map(value_of).collect::<Result<Vec<_>>>()?;
    Ok(spread(&values).0)
}

/// Runs all measurements in turn and prints the table.
pub(crate) fn run(root: &Path, options: &Options) -> Result<()> {
    let cache = setup::run(root)?;
    let shared_folder = |folder: &str| root.join("../shared").join(folder);
    let oracle = options.oracle.clone().unwrap_or_else(|| shared_folder("oracle"));
    let assets = setup::assets_or(root, options.assets.as_deref(), &options.task)?;
    let original = match Original::provide(&cache, &oracle, &assets) {
        Ok(original) => original,
        Err(error) => {
            println!("skipped: the original cannot be run here: failed to {error:#}");
            return Ok(());
        }
    };
    let python = wheel::installed(root, &cache, Profile::Release)?;
    let program = build_released_program(root, WITHOUT_PYTHON)?;
    let script = root.join("python/bench/speed.py");
    let [count, steps] = [options.environments, options.steps].map(|number| number.to_string());
    let run_mode = |mut command: Command, mode: &str| {
        command.args([mode, &options.task, "--environments", &count, "--steps", &steps]);
        command.env("ROLLOUT_ASSETS", &assets);
        // A single thread renders a frame of the original, as in this project.
        command.env("LP_NUM_THREADS", "1");
        last_json(&mut command)
    };
    let ours = |mode: &str| {
        let mut command = Command::new(&python);
        command.arg(&script);
        run_mode(command, mode)
    };
    let theirs = |mode: &str| run_mode(original.script(&script), mode);
    println!(
        "{} of {} together, {} steps, {} rounds in turn, on {}",
        options.environments,
        options.task,
        options.steps,
        options.rounds,
        machine()?
    );
    let mut rounds = Vec::new();
    for number in 1..=options.rounds {
        let pair = |_| {
            let threads = ours("threads")?;
            let mut command = Command::new(&program);
            command.args(["--task", &options.task, "--environments", &count]);
            command.args(["--steps", &steps, "--assets"]).arg(&assets);
            let without_python = last_json(&mut command)?;
            Ok(Pair { threads, without_python })
        };
        rounds.push(Round {
            pairs: (0..PAIRS).map(pair).collect::<Result<_>>()?,
            ours: ours("one")?,
            theirs: theirs("one")?,
            processes: theirs("processes")?,
        });
        // A round takes minutes. Printing after each round leaves results if the run is
        // interrupted.
        println!("after round {number}");
        print(&rounds)?;
    }
    Ok(())
}

fn print(rounds: &[Round]) -> Result<()> {
    println!(
        "{:<32} {:>10} {:>10} {:<6} {:>8} {:<13} target",
        "", "here", "original", "", "ratio", "  spread"
    );
    for row in &ROWS {
        let all = rounds.iter().map(row.values_of).collect::<Result<Vec<_>>>()?;
        let column = |at: usize| all.iter().map(|values| values[at]).collect::<Vec<_>>();
        let (ratio, least, most) = spread(&column(2));
        println!(
            "{:<32} {:>10.2} {:>10.2} {:<6} {ratio:>8.2} {:<13} {}",
            row.name,
            spread(&column(0)).0,
            spread(&column(1)).0,
            row.unit,
            format!("  {least:.2}-{most:.2}"),
            row.target,
        );
    }
    Ok(())
}
