//! `cargo xtask bench compare`: times a rollout in this simulator and in the original LIBERO, in
//! turn. `tests/src/bin/bench_rollout.rs` and docs/dev/PERFORMANCE.md describe the measurement.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result};
use serde_json::Value;

use crate::cargo::build_program;
use crate::original::Original;
use crate::process::{capture, command_line};
use crate::setup;
use crate::step::step;

/// Program that runs and times rollouts.
const PROGRAM: &str = "bench_rollout";

/// Options of `cargo xtask bench compare`.
#[derive(clap::Args)]
pub(crate) struct Compare {
    /// The task, SUITE/N; the reference data must have recorded actions of it.
    #[arg(long)]
    task: String,
    /// Control steps between two queries of the policy.
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..))]
    execute: u32,
    /// Control steps of each rollout.
    #[arg(long, default_value_t = 120, value_parser = clap::value_parser!(u32).range(1..))]
    steps: u32,
    /// Number of rounds; each round runs every program in turn.
    #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..))]
    rounds: u32,
    /// Rollouts that each program times in a round, after an untimed rollout; the median of their
    /// times is the round's result.
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..))]
    rollouts: u32,
    /// Renderer of this simulator: `software` or `gl`. The original draws through OpenGL.
    #[arg(long, default_value = "software")]
    renderer: String,
    /// Folder of the reference data, with the subfolders `tools` and `contact`. [default:
    /// ../shared/oracle beside this checkout]
    #[arg(long)]
    oracle: Option<PathBuf>,
    /// LIBERO's assets folder. [default: the folder of `worker assets fetch`]
    #[arg(long)]
    assets: Option<PathBuf>,
}

/// Durations of a rollout's parts, milliseconds.
#[derive(Clone, Copy)]
struct Parts {
    reset: f64,
    settle: f64,
    steps: f64,
    whole: f64,
}

/// Runs the same rollout in this simulator and in the original, in turn, and prints their times
/// and the ratios.
pub(crate) fn compare(root: &Path, options: &Compare) -> Result<()> {
    let cache = setup::run(root)?;
    let shared_folder = |folder: &str| root.join("../shared").join(folder);
    let oracle = options.oracle.clone().unwrap_or_else(|| shared_folder("oracle"));
    let actions = actions_of(&oracle, &options.task)?;
    if !actions.is_file() {
        println!(
            "skipped: no recorded actions of {} at {}; choose a task of the reference data, or \
             give the data's folder with --oracle",
            options.task,
            actions.display()
        );
        return Ok(());
    }
    let assets = setup::assets_or(root, options.assets.as_deref(), &options.task)?;
    let original = match Original::provide(&cache, &oracle, &assets) {
        Ok(original) => original,
        Err(error) => {
            println!("skipped: the original cannot be run here: failed to {error:#}");
            return Ok(());
        }
    };
    let program = step(PROGRAM, || build_program(root, PROGRAM).map(Built))?.0;
    let ours = || -> Result<Parts> {
        let mut command = Command::new(&program);
        command.args(["--task", &options.task, "--renderer", &options.renderer]);
        command.arg("--assets").arg(&assets);
        command.arg("--actions").arg(&actions);
        command.args(["--execute", &options.execute.to_string()]);
        command.args(["--steps", &options.steps.to_string()]);
        command.args(["--rollouts", &options.rollouts.to_string()]);
        // The original's script measures wall-clock time only.
        command.arg("--wall");
        our_parts(&last_json(&mut command)?)
    };
    let theirs = |render_every: u32| -> Result<Parts> {
        let mut command = original.command("baseline.py");
        command.arg(&options.task);
        command.args(["--steps", &options.steps.to_string()]);
        command.args(["--rollouts", &options.rollouts.to_string()]);
        command.args(["--render-every", &render_every.to_string()]);
        their_parts(&last_json(&mut command)?)
    };
    println!(
        "Comparing on {}, {} steps, {} rounds in turn",
        machine()?,
        options.steps,
        options.rounds
    );
    let (mut our_runs, mut released_runs, mut fewer_frames_runs) =
        (Vec::new(), Vec::new(), Vec::new());
    for round in 1..=options.rounds {
        let name = |title: &str| format!("round {round}: {title}");
        our_runs.push(step(&name("this simulator"), || ours().map(RolloutTime))?.0);
        released_runs.push(step(&name("original as released"), || theirs(1).map(RolloutTime))?.0);
        if options.execute > 1 {
            let title = name("original with fewer frames");
            fewer_frames_runs.push(step(&title, || theirs(options.execute).map(RolloutTime))?.0);
        }
    }
    print_ratios("as released, both cameras drawn at every step", &our_runs, &released_runs);
    if options.execute > 1 {
        let title = format!(
            "drawing only every {}th step, which the released version cannot do",
            options.execute
        );
        print_ratios(&title, &our_runs, &fewer_frames_runs);
    }
    Ok(())
}

fn actions_of(oracle: &Path, task: &str) -> Result<PathBuf> {
    let parts = task.split_once('/');
    let parts = parts.and_then(|(suite, index)| Some((suite, index.parse::<u32>().ok()?)));
    let (suite, index) = parts.with_context(|| format!("read task `{task}`: write SUITE/N"))?;
    Ok(oracle.join(format!("contact/{suite}_{index:02}.npz")))
}

fn our_parts(report: &Value) -> Result<Parts> {
    let phase = |name: &str| number(&report["phases_ms"][name], name);
    let (reset, settle) = (phase("reset")?, phase("settle")?);
    let whole = number(&report["rollout_ms"], "rollout_ms")?;
    Ok(Parts {
        reset,
        settle,
        // Sum of the parts, because medians of parts do not add up to the median of the whole.
        steps: ["physics", "control", "frames", "encode", "policy", "other"]
            .into_iter()
            .map(phase)
            .sum::<Result<f64>>()?,
        whole,
    })
}

fn their_parts(report: &Value) -> Result<Parts> {
    let millis = |name: &str| number(&report[name], name).map(|secs| secs * 1e3);
    Ok(Parts {
        reset: millis("reset_s")?,
        settle: millis("settle_s")?,
        steps: millis("steps_s")?,
        whole: millis("rollout_s")?,
    })
}

pub(crate) fn number(value: &Value, name: &str) -> Result<f64> {
    let number = value.as_f64();
    number.with_context(|| format!("read the report: `{name}` is {value}, not a number"))
}

/// Selects the duration of one part of a rollout, milliseconds.
type Part = fn(&Parts) -> f64;

/// Prints the median durations and ratios. A ratio divides the original's time by ours in the same
/// round.
fn print_ratios(title: &str, ours: &[Parts], theirs: &[Parts]) {
    println!("the original {title}:");
    println!("  {:<8} {:>12} {:>14} {:>8}  spread", "", "here, ms", "original, ms", "ratio");
    let parts: [(&str, Part); 4] = [
        ("reset", |parts| parts.reset),
        ("settle", |parts| parts.settle),
        ("steps", |parts| parts.steps),
        ("rollout", |parts| parts.whole),
    ];
    for (name, part) in parts {
        let all = |runs: &[Parts]| runs.iter().map(part).collect::<Vec<_>>();
        let (ours, theirs) = (all(ours), all(theirs));
        let ratios: Vec<f64> = theirs.iter().zip(&ours).map(|(a, b)| a / b).collect();
        let (middle, least, most) = spread(&ratios);
        println!(
            "  {name:<8} {:>12.2} {:>14.1} {middle:>8.1}  {least:.1}–{most:.1}",
            spread(&ours).0,
            spread(&theirs).0,
        );
    }
}

/// Returns median, smallest and largest value.
pub(crate) fn spread(values: &[f64]) -> (f64, f64, f64) {
    let mut values = values.to_vec();
    values.sort_by(f64::total_cmp);
    let at = |index: usize| values.get(index).copied().unwrap_or(f64::NAN);
    let (middle, last) = (values.len() / 2, values.len().saturating_sub(1));
    let median = (at(last / 2) + at(middle)) / 2.0;
    (median, at(0), at(last))
}

/// Path of a built program. Displayed as "built" in the step's line.
struct Built(PathBuf);

impl std::fmt::Display for Built {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("built")
    }
}

/// Durations of a rollout. The step's line displays the whole duration.
struct RolloutTime(Parts);

impl std::fmt::Display for RolloutTime {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{:.0} ms", self.0.whole)
    }
}

pub(crate) fn last_json(command: &mut Command) -> Result<Value> {
    let printed = capture(command)?;
    let line = printed.lines().next_back().unwrap_or_default();
    serde_json::from_str(line)
        .with_context(|| format!("read the output of `{}`", command_line(command)))
}

fn cores() -> Result<u32> {
    let cores = std::thread::available_parallelism().context("count the cores")?;
    Ok(u32::try_from(cores.get())?)
}

/// Describes the processor and its cores, to be printed with the measured times.
pub(crate) fn machine() -> Result<String> {
    let cpuinfo = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let model = cpuinfo
        .lines()
        .find_map(|line| line.strip_prefix("model name"))
        .map_or("an unnamed processor", |rest| rest.trim_start_matches([' ', '\t', ':']));
    Ok(format!("{} cores of {model}", cores()?))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reports_of_our_and_the_original_program_are_converted_to_milliseconds() {
        let ours = serde_json::json!({
            "rollout_ms": 21.0,
            "phases_ms": {
                "reset": 1.0, "settle": 2.0, "physics": 3.0, "control": 4.0,
                "frames": 5.0, "encode": 6.0, "policy": 0.0, "other": 0.5,
            },
        });
        let parts = our_parts(&ours).unwrap();
        assert_eq!((parts.reset, parts.steps, parts.whole), (1.0, 18.5, 21.0));
        let theirs = serde_json::json!({
            "reset_s": 1.5, "settle_s": 0.25, "steps_s": 2.0, "rollout_s": 3.75,
        });
        let parts = their_parts(&theirs).unwrap();
        assert_eq!((parts.settle, parts.whole), (250.0, 3750.0));
        assert!(their_parts(&ours).is_err(), "a report of `bench_rollout`");
    }

    #[test]
    fn a_spread_is_median_minimum_and_maximum() {
        assert_eq!(spread(&[3.0, 1.0, 7.0]), (3.0, 1.0, 7.0));
        assert_eq!(spread(&[4.0, 1.0, 2.0, 9.0]), (3.0, 1.0, 9.0));
        assert_eq!(spread(&[5.0]), (5.0, 5.0, 5.0));
    }

    #[test]
    fn recorded_actions_are_found_by_task() {
        let path = actions_of(Path::new("oracle"), "libero_goal/8").unwrap();
        assert_eq!(path, Path::new("oracle/contact/libero_goal_08.npz"));
        assert!(actions_of(Path::new("oracle"), "libero_goal").is_err());
    }
}
