//! `cargo xtask demo`: a small campaign on LIBERO's own assets with the real programs: a
//! coordinator, a gateway, and a worker with several slots. It produces the report as text and as
//! a page, the results, and videos of the configurations whose outcome changes when several
//! perturbations are applied at once.
//!
//! The policy is the student: a small network that comes with the gateway and reads the frames of
//! both cameras and the instruction, so that every axis affects it.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Instant;

use anyhow::{Context, Result};

use crate::cargo::build_only;
use crate::process::{capture, run as run_command};
use crate::running::Running;
use crate::setup;
use crate::step::step;

pub(crate) const PROGRAMS: [&str; 3] = ["coordinator", "worker", "policy-gateway"];
const CAMPAIGN: &str = "demo";
/// Name of the demo's policy.
const POLICY: &str = "student";
/// At configuration 0, the first task fails emergently and the second succeeds compensated, each in
/// the fewest control steps of such tasks in `examples/student`.
const TASKS: &str = "libero_object/3,libero_goal/1";
const CONFIGURATIONS: &str = "0";
/// Task with an emergent failure, for the demo's own test.
const EMERGENT: &str = "libero_object/3";
/// Address of the live page when the demo's data is served again.
const PAGE_ADDRESS: &str = "127.0.0.1:7411";

/// Options of `cargo xtask demo`.
#[derive(clap::Args)]
pub(crate) struct Options {
    /// Simulator slots.
    #[arg(long, default_value_t = 2)]
    slots: u32,
    /// `libero`, `primitives`, or the path of a LIBERO assets folder.
    #[arg(long, default_value = "libero")]
    assets: String,
    /// Tasks, separated by commas.
    #[arg(long, default_value = TASKS)]
    tasks: String,
    /// Configurations of each task, each run under every condition.
    #[arg(long, default_value = CONFIGURATIONS)]
    configs: String,
}

pub(crate) fn run(root: &Path, options: &Options) -> Result<()> {
    let start = Instant::now();
    let cache = setup::for_building(root)?;
    // The build needs only the linker's library; the rest is downloaded meanwhile.
    let programs = std::thread::scope(|threads| {
        let downloads = threads.spawn(|| setup::sources(&cache));
        let programs = build_only(root, &PROGRAMS)?;
        downloads.join().expect("the thread does not panic").map(|()| programs)
    })?;
    let running = Instant::now();
    let dir = fresh_folder(&root.join("demo-data"))?;
    campaign(&programs, &dir, options)?;
    println!(
        "The campaign took {} s; with set-up and building {} s.",
        running.elapsed().as_secs(),
        start.elapsed().as_secs()
    );
    println!("Next: README.md, \"A campaign of your own\"; for one rollout:");
    println!("  '{}' rollout --help", programs.join("worker").display());
    Ok(())
}

/// Runs the demo with fewer rollouts, and removes its data.
pub(crate) fn check(root: &Path, programs: &Path) -> Result<()> {
    let options = Options {
        slots: 2,
        assets: "libero".to_owned(),
        tasks: EMERGENT.to_owned(),
        configs: CONFIGURATIONS.to_owned(),
    };
    let dir = fresh_folder(&root.join("demo-data"))?;
    campaign(programs, &dir, &options)?;
    std::fs::remove_dir_all(&dir).with_context(|| format!("remove {}", dir.display()))
}

fn campaign(programs: &Path, dir: &Path, options: &Options) -> Result<()> {
    println!("Running a campaign");
    let start_one = |name: &str, arguments: &[&str]| -> Result<Running> {
        let mut command = Command::new(programs.join(name));
        step(name, || Running::start(name, command.args(arguments), dir))
    };
    let data = dir.join("coordinator");
    let data_arg = data.to_string_lossy();
    let coordinator =
        start_one("coordinator", &["serve", "--data", &data_arg, "--listen", "127.0.0.1:0"])?;
    // Each student was trained on one asset pack.
    let builtin = match options.assets.as_str() {
        "primitives" => "builtin:student-boxes",
        _ => "builtin:student",
    };
    let route = format!("{POLICY}={builtin}");
    let gateway = start_one("policy-gateway", &["--listen", "127.0.0.1:0", "--route", &route])?;
    let call = |arguments: &[&str]| {
        let mut command = Command::new(programs.join("coordinator"));
        command.args(arguments).args(["--connect", &coordinator.url]);
        command
    };
    let slots = options.slots.to_string();
    let mut worker = start_one(
        "worker",
        &["--connect", &coordinator.url, "--slots", &slots, "--assets", &options.assets],
    )?;
    #[rustfmt::skip]
    run_command(&mut call(&[
        "campaign", "create", "--name", CAMPAIGN, "--policy", POLICY, "--endpoint", &gateway.url,
        "--tasks", &options.tasks, "--axes", "all", "--levels", "L2", "--configs", &options.configs,
        "--nominal", "eval", "--record", "transitions",
    ]))?;
    println!();
    worker.run_while_alive(&mut call(&["campaign", "status", CAMPAIGN, "--watch"]))?;
    println!();
    let page = dir.join("report.html");
    let page_arg = page.to_string_lossy();
    run_command(&mut call(&["report", CAMPAIGN, "--html", &page_arg]))?;

    let results = dir.join("results.jsonl");
    let results_arg = results.to_string_lossy();
    println!();
    run_command(&mut call(&["export", CAMPAIGN, "--format", "jsonl", "--output", &results_arg]))?;
    step("videos of transitions", || film(programs, &coordinator, options).map(|()| "made"))?;
    println!();
    println!("report    {}", page.display());
    println!("page      http://{PAGE_ADDRESS}/campaigns/{CAMPAIGN} while this command runs:");
    println!("          {}", serve_again(programs, &data));
    println!("results   {}", results.display());
    println!("database  {}", data.display());
    println!("logs      {}", dir.display());
    Ok(())
}

/// Returns the shell command that serves a demo's data again.
fn serve_again(programs: &Path, data: &Path) -> String {
    let program = programs.join("coordinator");
    format!("'{}' serve --data '{}' --listen {PAGE_ADDRESS}", program.display(), data.display())
}

/// Creates a new numbered folder, so that the results of earlier demos are kept.
fn fresh_folder(parent: &Path) -> Result<PathBuf> {
    std::fs::create_dir_all(parent).with_context(|| format!("make {}", parent.display()))?;
    for number in 1.. {
        let dir = parent.join(number.to_string());
        match std::fs::create_dir(&dir) {
            Ok(()) => return Ok(dir),
            Err(error) if error.kind() == std::io::ErrorKind::AlreadyExists => {}
            Err(error) => return Err(error).with_context(|| format!("make {}", dir.display())),
        }
    }
    unreachable!("there is always a larger number")
}

/// Makes the campaign's videos, at most `options.slots` at a time.
fn film(programs: &Path, coordinator: &Running, options: &Options) -> Result<()> {
    let mut worker = Command::new(programs.join("worker"));
    worker
        .args(["film", "--assets", &options.assets])
        .args(["--connect", &coordinator.url])
        .args(["--at-a-time", &options.slots.to_string()]);
    capture(&mut worker).map(drop)
}
