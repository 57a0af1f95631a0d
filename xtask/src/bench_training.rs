//! `cargo xtask bench training`: times rollouts of reinforcement learning here and in the original,
//! in turn.
//! `python/bench/training.py` and docs/PYTHON.md describe the measurement.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::Result;
use serde_json::Value;

use crate::bench::{last_json, machine, number, spread};
use crate::original::Original;
use crate::setup;
use crate::wheel::{self, Profile};

/// Options of `cargo xtask bench training`.
#[derive(clap::Args)]
pub(crate) struct Options {
    /// The task: SUITE/N.
    #[arg(long, default_value = "libero_goal/8")]
    task: String,
    /// Number of rounds; each round runs every program in turn.
    #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..))]
    rounds: u32,
    /// Environments that roll out together.
    #[arg(long, default_value_t = 16, value_parser = clap::value_parser!(u32).range(1..))]
    environments: u32,
    /// Control steps per query of the policy.
    #[arg(long, default_value_t = 8, value_parser = clap::value_parser!(u32).range(1..))]
    chunk: u32,
    /// Control steps of a rollout.
    #[arg(long, default_value_t = 200, value_parser = clap::value_parser!(u32).range(1..))]
    steps: u32,
    /// Rollouts of each environment that are timed.
    #[arg(long, default_value_t = 2, value_parser = clap::value_parser!(u32).range(1..))]
    rollouts: u32,
    /// Folder of the reference data. [default: ../shared/oracle beside this checkout]
    #[arg(long)]
    oracle: Option<PathBuf>,
    /// LIBERO's assets folder. [default: the one that LIBERO's assets are fetched into]
    #[arg(long)]
    assets: Option<PathBuf>,
}

/// A way to run rollouts.
struct Arm {
    name: &'static str,
    is_original: bool,
    arguments: &'static [&'static str],
}

/// Ratios are relative to the first arm of a scenario that runs, which is the original if possible.
const SCENARIOS: [(&str, &[Arm]); 2] = [
    (
        "each environment alone, one observation per chunk",
        &[
            Arm {
                name: "original",
                is_original: true,
                arguments: &["alone"],
            },
            Arm {
                name: "shim, every frame drawn",
                is_original: false,
                arguments: &["alone", "--every-frame"],
            },
            Arm {
                name: "shim",
                is_original: false,
                arguments: &["alone"],
            },
        ],
    ),
    (
        "all observations sent to one process",
        &[
            Arm {
                name: "original",
                is_original: true,
                arguments: &["sent"],
            },
            Arm {
                name: "shim",
                is_original: false,
                arguments: &["sent"],
            },
            Arm {
                name: "rows in one process",
                is_original: false,
                arguments: &["threads"],
            },
        ],
    ),
];
/// Printed quantities of a run.
const MEASURES: [(&str, &str); 3] = [
    ("steps_per_second", "steps/s"),
    ("rollouts_per_second", "rollouts/s"),
    ("reset_ms", "reset of all, ms"),
];

/// Runs all measurements in turn and prints the table.
pub(crate) fn run(root: &Path, options: &Options) -> Result<()> {
    let cache = setup::run(root)?;
    let oracle = options.oracle.clone();
    let oracle = oracle.unwrap_or_else(|| root.join("../shared/oracle"));
    let assets = setup::assets_or(root, options.assets.as_deref(), &options.task)?;
    let original = Original::provide(&cache, &oracle, &assets);
    if let Err(error) = &original {
        println!("without the original, which cannot be run here: failed to {error:#}");
    }
    let original = original.ok();
    let python = wheel::installed(root, &cache, Profile::Release)?;
    let script = root.join("python/bench/training.py");
    let sizes = [
        ("--environments", options.environments),
        ("--chunk", options.chunk),
        ("--steps", options.steps),
        ("--rollouts", options.rollouts),
    ];
    let measure = |arm: &Arm| {
        let mut command = match (&original, arm.is_original) {
            (Some(original), true) => original.script(&script),
            (None, true) => return Ok(None),
            (_, false) => {
                let mut command = Command::new(&python);
                command.arg(&script);
                command
            }
        };
        command.args(arm.arguments).arg(&options.task);
        for (name, size) in sizes {
            command.args([name, &size.to_string()]);
        }
        command.env("ROLLOUT_ASSETS", &assets);
        // One thread per environment, as users of the original set it.
        command.env("OMP_NUM_THREADS", "1");
        command.env("LP_NUM_THREADS", "1");
        last_json(&mut command).map(Some)
    };
    println!(
        "{} of {}, {} steps in chunks of {}, {} rounds in turn, on {}",
        options.environments,
        options.task,
        options.steps,
        options.chunk,
        options.rounds,
        machine()?
    );
    let mut measured: Vec<Vec<Vec<Value>>> = SCENARIOS
        .iter()
        .map(|(_, arms)| vec![Vec::new(); arms.len()])
        .collect();
    for round in 1..=options.rounds {
        for ((_, arms), measured) in SCENARIOS.iter().zip(&mut measured) {
            for (arm, measured) in arms.iter().zip(measured) {
                measured.extend(measure(arm)?);
            }
        }
        // Prints after every round, which takes minutes, so that an interrupted run has results.
        println!("after round {round}");
        print(&measured)?;
    }
    Ok(())
}

fn print(measured: &[Vec<Vec<Value>>]) -> Result<()> {
    for ((scenario, arms), measured) in SCENARIOS.iter().zip(measured) {
        for (name, unit) in MEASURES {
            println!("{scenario}: {unit}");
            let mut first = None;
            for (arm, runs) in arms
                .iter()
                .zip(measured)
                .filter(|(_, runs)| !runs.is_empty())
            {
                let values = runs.iter().map(|run| number(&run[name], name));
                let (middle, least, most) = spread(&values.collect::<Result<Vec<_>>>()?);
                let ratio = middle / *first.get_or_insert(middle);
                println!(
                    "  {:<26} {middle:>10.2} {ratio:>8.2}  {least:.2}-{most:.2}",
                    arm.name
                );
            }
        }
    }
    Ok(())
}
