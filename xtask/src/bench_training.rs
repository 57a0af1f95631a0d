//! `cargo xtask bench training`: times rollouts for reinforcement learning in this project's
//! environments and in the original LIBERO's, in turn. `python/bench/rl/compare.py` and
//! docs/dev/PERFORMANCE.md describe the measurement.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::Result;

use crate::clients;
use crate::original::Original;
use crate::process::run as run_command;
use crate::setup;
use crate::venv::site_packages;
use crate::wheel::{self, Profile};

/// Options of `cargo xtask bench training`.
#[derive(clap::Args)]
pub(crate) struct Options {
    /// The task: SUITE/N.
    #[arg(long, default_value = "libero_goal/8")]
    task: String,
    /// Folder of the reference data. [default: ../shared/oracle beside this checkout]
    #[arg(long)]
    oracle: Option<PathBuf>,
    /// LIBERO's assets folder. [default: the folder of `worker assets fetch`]
    #[arg(long)]
    assets: Option<PathBuf>,
    /// Folder of the results.
    #[arg(long, default_value = "target/bench-training")]
    out: PathBuf,
    /// Options of `python/bench/rl/compare.py`, such as `--environments 8 --rounds 3`.
    #[arg(last = true)]
    arguments: Vec<String>,
}

/// Runs the comparison. RLinf is omitted if the packages of its clients cannot be installed, and
/// the original if it cannot be run on this machine.
pub(crate) fn run(root: &Path, options: &Options) -> Result<()> {
    let cache = setup::run(root)?;
    let oracle = options.oracle.clone();
    let oracle = oracle.unwrap_or_else(|| root.join("../shared/oracle"));
    let assets = setup::assets_or(root, options.assets.as_deref(), &options.task)?;
    let original = Original::provide(&cache, &oracle, &assets);
    let shim = wheel::installed(root, &cache, Profile::Release, None)?;
    let clients = clients::provide(root, &cache);
    let clients = clients.as_deref().map(site_packages).transpose()?;
    // PYTHONPATH of a simulator: its own packages precede those of LeRobot, RLinf and vla-eval.
    let path = |simulator: &Path| -> Result<String> {
        let clients = clients.iter().map(|folder| folder.display().to_string());
        let all = std::iter::once(simulator.display().to_string()).chain(clients);
        Ok(all.collect::<Vec<_>>().join(":"))
    };
    let script = root.join("python/bench/rl/compare.py");
    let mut command = match original {
        Ok(original) => {
            let mut command = original.script(&script);
            command.args(["--original", &path(original.packages())?]);
            command
        }
        Err(error) => {
            println!("without the original, which cannot be run here: failed to {error:#}");
            let mut command = Command::new(&shim);
            command.arg(&script);
            // The arms of compare.py that run this project's environments.
            command.args(["--arms", "S", "V"]);
            command
        }
    };
    command.args(["--shim", &path(&site_packages(&shim)?)?, "--shim-python"]);
    command.arg(&shim).args(["--task", &options.task, "--out"]);
    command.arg(root.join(&options.out));
    if clients.is_none() {
        command.args(["--frameworks", "simplevla"]);
    }
    command.args(&options.arguments).env("ROLLOUT_ASSETS", &assets);
    run_command(&mut command)
}
