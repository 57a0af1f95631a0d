//! Soak test of one coordinator under thousands of slots, which detects leaks: memory, files, logs
//! or latencies that keep growing. Slots are simulated by tasks of this process that claim, sleep
//! and commit; gRPC, TLS, tokens, sockets and the coordinator process are real.
//!
//! Four campaigns share the jobs: one is only measured, one may stop early, one films the
//! configurations whose outcome changes, and one explains the outcomes of the filmed campaign.
//! Page, metrics and status are requested throughout. The coordinator is killed once, and its
//! database is replaced once by a backup.
//!
//! Prints a line every few seconds, draws a figure, and exits with code 1 if something grew or a
//! rollout was lost.

mod crowd;
mod figure;
mod server;
mod watch;

use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, ensure};
use clap::Parser;
use serde_json::json;

use crowd::Crowd;
use server::Server;
use watch::Watch;

/// Rollouts of one replicate of a campaign of this test: the 8,400 perturbed rollouts of
/// LIBERO-CTRL v0.1, and 400 nominal ones from the initial states of its configurations.
const DESIGN: u64 = 8_800;
/// Times of the kill, the backup and its restoration, as fractions of the planned duration.
const KILL: f64 = 0.4;
const BACK_UP: f64 = 0.6;
const RESTORE: f64 = 0.7;
/// Longest duration of the test, as a multiple of the planned duration.
const PATIENCE: f64 = 3.0;

/// Run a crowd of slots against one coordinator, and detect resources that keep growing.
#[derive(Parser)]
pub(crate) struct Arguments {
    /// Approximate number of jobs of all campaigns.
    #[arg(long, default_value_t = 1_000_000)]
    jobs: u64,
    /// Number of concurrent slots.
    #[arg(long, default_value_t = 2_000)]
    slots: u32,
    /// Number of workers that share the slots, each with its own connection.
    #[arg(long, default_value_t = 200)]
    workers: u32,
    /// Planned duration of all jobs, minutes; it determines the duration of a rollout.
    #[arg(long, default_value_t = 30.0)]
    minutes: f64,
    /// File of the figure, SVG.
    #[arg(long, default_value = "soak.svg")]
    figure: PathBuf,
}

impl Arguments {
    fn planned_duration(&self) -> Duration {
        Duration::from_secs_f64(self.minutes * 60.0)
    }

    /// Returns the mean duration of a rollout with which all jobs take as long as planned.
    fn rollout_duration(&self) -> Duration {
        self.planned_duration().mul_f64(f64::from(self.slots) / self.jobs as f64)
    }
}

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    let runtime = tokio::runtime::Runtime::new().expect("a runtime");
    match runtime.block_on(run(&arguments)) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: failed to {error:#}");
            ExitCode::FAILURE
        }
    }
}

async fn run(arguments: &Arguments) -> Result<()> {
    let folder = tempfile::tempdir().context("make a folder")?;
    let mut server = Server::start(folder.path())?;
    create(&server, arguments)?;
    println!(
        "{} slots of {} workers, rollouts of {:.2} s",
        arguments.slots,
        arguments.workers,
        arguments.rollout_duration().as_secs_f64()
    );
    let crowd = Crowd::start(server.access(), arguments);
    let watch = Watch::start(server.access(), crowd.clone());
    let began = Instant::now();
    let elapsed_fraction =
        || began.elapsed().as_secs_f64() / arguments.planned_duration().as_secs_f64();
    let wait_until = async |fraction: f64| {
        while elapsed_fraction() < fraction && !crowd.is_finished() {
            tokio::time::sleep(Duration::from_millis(200)).await;
        }
    };
    watch.follow(server.process_id(), &server.log());
    wait_until(KILL).await;
    watch.record_event("killed");
    server.kill_and_start()?;
    watch.follow(server.process_id(), &server.log());
    wait_until(BACK_UP).await;
    watch.record_event("backed up");
    let backup = server.back_up()?;
    wait_until(RESTORE).await;
    watch.record_event("restored");
    server.restore(&backup)?;
    watch.follow(server.process_id(), &server.log());
    wait_until(PATIENCE).await;
    let took = began.elapsed();
    let is_finished = crowd.is_finished();
    let samples = watch.stop().await;
    crowd.stop().await;

    std::fs::write(&arguments.figure, figure::draw(&samples))
        .with_context(|| format!("write {}", arguments.figure.display()))?;
    println!(
        "{} results accepted in {:.0} s; figure in {}",
        crowd.accepted(),
        took.as_secs_f64(),
        arguments.figure.display()
    );
    let unfinished = server.unfinished(&["measured", "stops", "filmed", "explains"])?;
    server.stop()?;
    println!("{}", server.check()?);
    ensure!(is_finished, "finish in {:.0} s", took.as_secs_f64());
    ensure!(unfinished.is_empty(), "finish everything: {}", unfinished.join("; "));
    watch::check_growth(&samples)
}

/// Creates the campaigns: 55 % of the jobs are only measured, 30 % are filmed, and 15 % belong to
/// the campaign that may stop early, which has a single replicate.
fn create(server: &Server, arguments: &Arguments) -> Result<()> {
    let spec = |name: &str, share: f64| {
        let designs = (arguments.jobs as f64 * share / DESIGN as f64).round();
        // If the share is less than half a design, the campaign has two tasks only.
        let tasks = match designs {
            0.0 => json!(["libero_object/0", "libero_object/1"]),
            _ => json!(["libero_spatial", "libero_object", "libero_goal", "libero_10"]),
        };
        json!({
            "name": name,
            "policy": {"name": name, "endpoint": "http://127.0.0.1:1"},
            "tasks": tasks,
            "axes": ["camera", "lighting", "robot", "sensor", "actuation", "language"],
            "levels": ["L1", "L2", "L3"],
            "configs": (0..10).collect::<Vec<_>>(),
            "nominal": "eval",
            "replicates": designs.clamp(1.0, 100.0) as u32,
        })
    };
    let measured = spec("measured", 0.55);
    let mut stops = spec("stops", 0.15);
    // Ten configurations replace each replicate; a design has at most 1,000 configurations.
    let configs = (stops["replicates"].as_u64().unwrap_or(1) * 10).min(1_000);
    stops["configs"] = json!((0..configs).collect::<Vec<_>>());
    stops["replicates"] = json!(1);
    stops["stop"] = json!({"rule": "width(S_sim) < 0.02", "seed": 7});
    let mut filmed = spec("filmed", 0.3);
    filmed["record"] = json!("transitions");
    let explains = json!({
        "name": "explains",
        "policy": {"name": "filmed", "endpoint": "http://127.0.0.1:1"},
        "explains": {"campaign": "filmed"},
    });
    for (spec, priority) in [(measured, 0), (stops, -1), (filmed, 1), (explains, 1)] {
        let began = Instant::now();
        let printed = server.create(&spec, priority)?;
        println!("{printed} ({:.1} s)", began.elapsed().as_secs_f64());
    }
    Ok(())
}

/// Hashes a text to a number in [0, 1).
pub(crate) fn hash_fraction(text: &str) -> f64 {
    use sha2::{Digest, Sha256};
    let digest = Sha256::digest(text.as_bytes());
    let bits = digest.iter().take(4).fold(0_u32, |bits, byte| bits << 8 | u32::from(*byte));
    f64::from(bits) / 2_f64.powi(32)
}

pub(crate) type Shared<T> = Arc<std::sync::Mutex<T>>;
