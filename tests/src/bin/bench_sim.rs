//! Benchmark of the simulator on one task, compared with bare MuJoCo on the same
//! states in the same process. Prints one JSON object. Run by `cargo xtask bench sim`.

use std::path::PathBuf;
use std::time::Instant;

use anyhow::{Context, Result};
use clap::Parser;
use libero_ctrl::TaskRef;
use libero_ctrl::presets::ENV_SEED;
use scene::pack::LIBERO;
use scene::{InitialStates, Sources, TaskFiles, compose};
use serde_json::json;
use sim::controller::SUBSTEPS;
use sim::episode::NO_OP;
use sim::mujoco::Data;
use sim::{Drawer, Environment, Renderer};
use tests::files::open_pack;
use worker::measure::open_loop::smooth_action;

/// Time the simulator on one task.
#[derive(Parser)]
struct Arguments {
    /// The task: SUITE/N.
    #[arg(long)]
    task: TaskRef,
    /// `libero`, `primitives`, or the path of a LIBERO assets folder.
    #[arg(long, default_value = LIBERO)]
    assets: String,
    /// Control steps of each rollout.
    #[arg(long, default_value_t = 120)]
    steps: usize,
    /// Rollouts that are timed.
    #[arg(long, default_value_t = 5)]
    rollouts: usize,
    /// Folder with the unpacked packages of robosuite and LIBERO.
    #[arg(long)]
    sources: Option<PathBuf>,
}

const SETTLE_STEPS: usize = 10;
/// Side of a frame, pixels.
const FRAME: u32 = 256;
/// Number of frames timed per camera.
const FRAMES: usize = 20;

fn main() -> Result<()> {
    let arguments = Arguments::parse();
    let sources = Sources::open(&arguments.sources.clone().unwrap_or_else(Sources::default_dir))?;
    let pack = open_pack(&arguments.assets, &sources, [arguments.task])?;
    let files = TaskFiles::of_task(&sources, arguments.task);
    let states = InitialStates::read(&files.init)?;
    let build = || -> Result<Environment> {
        let scene = compose(&files.problem()?, &pack, &sources, ENV_SEED)?;
        Ok(Environment::new(scene, &pack, &sources)?)
    };
    let (cold, environment) = timed(build);
    drop(environment?);
    let (warm, environment) = timed(build);
    let mut environment = environment?;
    let state = states.get(0).context("find initial state 0")?;

    let (mut reset, mut settle, mut steps, mut bare) = (vec![], vec![], vec![], vec![]);
    let mut copy = Data::new(environment.model())?;
    for _ in 0..arguments.rollouts {
        reset.push(timed(|| environment.load(state)).0);
        let start = Instant::now();
        for _ in 0..SETTLE_STEPS {
            environment.step(&NO_OP)?;
        }
        settle.push(start.elapsed().as_secs_f64() * 1e3);
        for step in 0..arguments.steps {
            copy.copy_from(environment.model(), environment.data());
            let model = environment.model();
            bare.push(timed(|| (0..SUBSTEPS).for_each(|_| copy.step(model))).0);
            let (millis, outcome) = timed(|| environment.step(&smooth_action(step)));
            outcome?;
            steps.push(millis);
        }
    }
    let drawer = Drawer::open(Renderer::default())?;
    let mut frames = serde_json::Map::new();
    for camera in ["agentview", "robot0_eye_in_hand"] {
        environment.draw(&drawer, camera, FRAME, FRAME)?;
        let millis = (0..FRAMES).map(|_| {
            let (millis, frame) = timed(|| environment.draw(&drawer, camera, FRAME, FRAME));
            frame.map(|_| millis)
        });
        frames.insert(camera.to_owned(), json!(median(millis.collect::<Result<_, _>>()?)));
    }
    let (step_ms, bare_ms) = (median(steps), median(bare));
    println!(
        "{}",
        json!({
            "system": "rollout",
            "task": arguments.task.to_string(),
            "assets": pack.name(),
            "mujoco": sim::mujoco::version(),
            "renderer": drawer.name(),
            "rollouts": arguments.rollouts,
            "steps": arguments.steps,
            "compile_cold_ms": round(cold),
            "compile_warm_ms": round(warm),
            "reset_ms": median(reset),
            "settle_ms": median(settle),
            "control_step_ms": step_ms,
            "bare_mj_step_x25_ms": bare_ms,
            "control_step_over_bare": round(step_ms / bare_ms),
            "frame_ms": frames,
        })
    );
    Ok(())
}

/// Runs work and returns its duration, milliseconds, and its result.
fn timed<T>(work: impl FnOnce() -> T) -> (f64, T) {
    let start = Instant::now();
    let result = work();
    (start.elapsed().as_secs_f64() * 1e3, result)
}

fn median(mut millis: Vec<f64>) -> f64 {
    millis.sort_by(f64::total_cmp);
    round(millis.get(millis.len() / 2).copied().unwrap_or_default())
}

fn round(value: f64) -> f64 {
    (value * 1e4).round() / 1e4
}
