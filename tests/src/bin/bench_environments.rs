//! Benchmark of environments of one compiled scene on threads, without Python: the baseline
//! for `python/bench/speed.py threads`.

use std::num::NonZero;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, MutexGuard};
use std::thread;
use std::time::Instant;

use anyhow::Result;
use clap::Parser;
use libero_ctrl::{ManifestRow, Realisation, RolloutId, TaskRef};
use policy_protocol::CAMERAS;
use scene::pack::LIBERO;
use scene::{Sources, TaskFiles};
use sim::{Conditions, Drawer, Environment, ReadyScene};
use tests::files::open_pack;

/// Side of a frame, pixels.
const SIDE: u32 = 256;
/// Number of steps before the timing starts.
const WARM_UP: usize = 3;

/// Measure how fast environments of one scene step on threads.
#[derive(Parser)]
struct Arguments {
    /// The task: SUITE/N.
    #[arg(long)]
    task: TaskRef,
    /// `libero`, `primitives`, or the path of a LIBERO assets folder.
    #[arg(long, default_value = LIBERO)]
    assets: String,
    /// Folder with the unpacked packages of robosuite and LIBERO.
    #[arg(long)]
    sources: Option<PathBuf>,
    /// Environments that step, on one thread per core.
    #[arg(long, default_value_t = 16)]
    environments: usize,
    /// Control steps of each environment that are timed.
    #[arg(long, default_value_t = 30)]
    steps: usize,
}

fn main() -> Result<()> {
    let arguments = Arguments::parse();
    let sources = Sources::open(&arguments.sources.unwrap_or_else(Sources::default_dir))?;
    let pack = open_pack(&arguments.assets, &sources, [arguments.task])?;
    let files = TaskFiles::of_task(&sources, arguments.task);
    let ready = ReadyScene::compile(files, &pack, &sources)?;
    let id = RolloutId::clean(arguments.task, 0);
    let row = ManifestRow::new(id, 0, 0, Default::default());
    let begin = |_| -> Result<Mutex<Environment>> {
        let mut environment = Environment::from_compiled(Arc::clone(ready.compiled()))?;
        let conditions = Conditions::begin(&ready, &mut environment, &row, Realisation::Matched)?;
        conditions.settle(&mut environment)?;
        Ok(Mutex::new(environment))
    };
    let environments = (0..arguments.environments).map(begin).collect::<Result<Vec<_>>>()?;
    let threads = thread::available_parallelism().map_or(1, NonZero::get);
    let actions = actions(arguments.steps + WARM_UP);
    for action in &actions[..WARM_UP] {
        step_all(&environments, threads, action)?;
    }
    let start = Instant::now();
    for action in &actions[WARM_UP..] {
        step_all(&environments, threads, action)?;
    }
    let observations = (arguments.steps * environments.len()) as f64;
    let rate = observations / start.elapsed().as_secs_f64();
    println!("{}", serde_json::json!({ "observations_per_second": rate }));
    Ok(())
}

/// Returns actions of a smooth motion in the air, as in `speed.py`.
fn actions(count: usize) -> Vec<[f64; 7]> {
    let at = |step: usize, axis: usize| {
        let phase = 3.0 * step as f64 / (count - 1) as f64 + axis as f64;
        0.3 * phase.sin()
    };
    (0..count).map(|step| std::array::from_fn(|axis| at(step, axis))).collect()
}

/// Steps all environments once, reads the robot's state, and renders each camera into its buffer,
/// which holds the frames of all environments. Each thread takes the next pending environment.
fn step_all(environments: &[Mutex<Environment>], threads: usize, action: &[f64; 7]) -> Result<()> {
    let bytes = (SIDE * SIDE * 3) as usize;
    let pictures = CAMERAS.map(|_| Mutex::new(vec![0_u8; environments.len() * bytes]));
    let next = AtomicUsize::new(0);
    let work = || -> Result<()> {
        loop {
            let at = next.fetch_add(1, Ordering::Relaxed);
            let Some(environment) = environments.get(at) else {
                return Ok(());
            };
            let mut environment = lock(environment);
            environment.step(action)?;
            std::hint::black_box(environment.robot_state());
            for (camera, pictures) in CAMERAS.iter().zip(&pictures) {
                let frame = environment.draw(&Drawer::Software, camera, SIDE, SIDE)?;
                lock(pictures)[at * bytes..][..bytes].copy_from_slice(&frame.rgb);
            }
        }
    };
    thread::scope(|scope| {
        let helpers: Vec<_> = (1..threads).map(|_| scope.spawn(work)).collect();
        work()?;
        helpers.into_iter().try_for_each(|thread| thread.join().expect("no panic"))
    })
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().expect("no thread panics while it holds the lock")
}
