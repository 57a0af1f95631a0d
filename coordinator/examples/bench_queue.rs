//! Queue benchmark: simulated slots claim, sleep for the duration of a rollout and commit, on a
//! real SQLite file with `synchronous=FULL`. The queue runs in this process, without sockets.
//! Prints one JSON object; run by `cargo xtask bench queue`.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};
use benchmark::ManifestRow;
use benchmark::attempt::{
    Digests, GoalProgress, Measurement, Motion, Pin, Provenance, Realised, RolloutResult,
};
use clap::Parser;
use queue::clock::SystemClock;
use queue::expand::NewCampaign;
use queue::ids::WorkerId;
use queue::{
    Assigned, ClaimRequest, CommitReport, CommitVerdict, DATABASE_FILE, Queue, Store, Timing,
    WorkerInfo,
};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};
use serde_json::{Value, json};
use sha2::{Digest, Sha256};
use tokio::task::JoinSet;

/// Time the queue with simulated slots.
#[derive(Clone, Parser)]
struct Arguments {
    /// Minimum number of rollouts, rounded up to whole configurations of all tasks and levels.
    #[arg(long, default_value_t = 100_000)]
    jobs: u64,
    /// Number of slots.
    #[arg(long, default_value_t = 2_000)]
    slots: u32,
    /// Slots of one worker, which sends one heartbeat for all of them.
    #[arg(long, default_value_t = 8)]
    slots_per_worker: u32,
    /// Mean duration of a rollout, milliseconds, well below a lease of 30 s; each takes up to a fifth
    /// more or less.
    #[arg(long, default_value_t = 900)]
    rollout_millis: u64,
    /// Folder for the database; a temporary folder if omitted.
    #[arg(long)]
    data: Option<PathBuf>,
}

/// Rollouts per configuration number: 40 tasks, 7 conditions, 3 levels.
const ROLLOUTS_PER_CONFIG: u64 = 840;
/// Longest wait of a claim.
const CLAIM_WAIT: Duration = Duration::from_secs(30);

/// Measurements collected from all slots.
#[derive(Default)]
struct Measured {
    committed: AtomicU64,
    /// Latency of each slot's first claim, when it holds no compiled scene and all slots claim
    /// within the duration of a rollout.
    first_claim_micros: Mutex<Vec<u64>>,
    /// Latencies of all later claims.
    claim_micros: Mutex<Vec<u64>>,
    commit_micros: Mutex<Vec<u64>>,
}

#[tokio::main]
async fn main() -> Result<()> {
    let arguments = Arguments::parse();
    let temporary = tempfile::tempdir().context("make a temporary folder")?;
    let folder = arguments.data.clone().unwrap_or(temporary.path().into());
    let store = Store::open(&folder).await?;
    let rng = ChaCha8Rng::seed_from_u64(1);
    let queue = Queue::start(store, Arc::new(SystemClock::start()), rng, Timing::default()).await?;
    let began = Instant::now();
    let jobs = queue.create_campaign(&spec(arguments.jobs)?).await?.jobs_total;
    let expand_secs = began.elapsed().as_secs_f64();

    let mut background = JoinSet::new();
    for worker in 0..arguments.slots.div_ceil(arguments.slots_per_worker) {
        queue.register(&worker_info(worker, &arguments)).await?;
        background.spawn(send_heartbeats(queue.clone(), worker));
    }
    let swept_queue = queue.clone();
    background.spawn(async move {
        loop {
            tokio::time::sleep(swept_queue.timing().sweep).await;
            swept_queue.sweep().await?;
        }
    });

    let measured = Arc::new(Measured::default());
    let began = Instant::now();
    let mut slots = JoinSet::new();
    for slot in 0..arguments.slots {
        slots.spawn(run_slot(queue.clone(), measured.clone(), slot, arguments.clone(), jobs));
    }
    let committed_each_second = tokio::select! {
        counts = watch(&measured, jobs) => counts,
        failure = first_failure(&mut slots) => return Err(failure),
        failure = first_failure(&mut background) => return Err(failure),
    };
    let elapsed = began.elapsed();
    slots.abort_all();
    background.abort_all();
    let report = report(
        &arguments,
        (&measured, &committed_each_second, elapsed),
        jobs,
        expand_secs,
        &folder,
    )?;
    println!("{}", serde_json::to_string_pretty(&report)?);
    queue.close().await?;
    Ok(())
}

fn spec(jobs: u64) -> Result<NewCampaign> {
    let configs: Vec<u64> = (0..jobs.div_ceil(ROLLOUTS_PER_CONFIG)).collect();
    let spec = json!({
        "name": "bench",
        "policy": {"name": "simulated", "endpoint": "http://127.0.0.1:1"},
        "tasks": benchmark::select_tasks("all")?,
        "axes": benchmark::Axis::ALL,
        "levels": ["L1", "L2", "L3"],
        "configs": configs,
        "nominal": "none",
    });
    Ok(NewCampaign::from_json(&spec.to_string())?)
}

/// Simulates a slot, which claims, sleeps and commits until all jobs are committed.
async fn run_slot(
    queue: Arc<Queue>,
    measured: Arc<Measured>,
    slot: u32,
    arguments: Arguments,
    jobs: u64,
) -> Result<()> {
    let mut rng = ChaCha8Rng::seed_from_u64(u64::from(slot));
    let worker = worker_id(slot / arguments.slots_per_worker);
    let span = Duration::from_millis(arguments.rollout_millis);
    // Random start delay, so that the slots do not claim in lockstep.
    tokio::time::sleep(span.mul_f64(random_fraction(&mut rng))).await;
    let mut warm_task: Option<String> = None;
    while measured.committed.load(Ordering::Relaxed) < jobs {
        let request = ClaimRequest {
            worker: worker.clone(),
            claim: format!("{:016x}{:016x}", rng.next_u64(), slot),
            warm_task: warm_task.clone(),
            means: Default::default(),
        };
        let began = Instant::now();
        let claimed = queue.claim(&request, CLAIM_WAIT).await?;
        let Some(job) = claimed.job else {
            continue;
        };
        record_latency(
            match warm_task {
                None => &measured.first_claim_micros,
                Some(_) => &measured.claim_micros,
            },
            began,
        );
        let row: ManifestRow = serde_json::from_str(&job.manifest_row)?;
        warm_task = Some(row.id.task().to_string());
        tokio::time::sleep(span.mul_f64(0.8 + 0.4 * random_fraction(&mut rng))).await;
        let report = outcome(&worker, &job, &row, &mut rng);
        let began = Instant::now();
        let reply = queue.commit(&report).await?;
        record_latency(&measured.commit_micros, began);
        if reply.verdict != CommitVerdict::Accepted {
            bail!("a commit was not accepted: {}", reply.detail);
        }
        measured.committed.fetch_add(1, Ordering::Relaxed);
    }
    Ok(())
}

/// Sends a worker's heartbeats, which renew no leases: rollouts are shorter than a lease.
async fn send_heartbeats(queue: Arc<Queue>, worker: u32) -> Result<()> {
    loop {
        tokio::time::sleep(queue.timing().heartbeat).await;
        queue.heartbeat(&worker_id(worker), &[]).await?;
    }
}

/// Waits for the first failure of a slot; never returns if all succeed.
async fn first_failure(slots: &mut JoinSet<Result<()>>) -> anyhow::Error {
    while let Some(ended) = slots.join_next().await {
        if let Err(error) = ended.map_err(Into::into).and_then(|ended| ended) {
            return error;
        }
    }
    std::future::pending().await
}

/// Counts the rollouts committed in each second until all jobs are committed.
async fn watch(measured: &Measured, jobs: u64) -> Vec<u64> {
    let mut counts = Vec::new();
    let mut before = 0;
    let mut tick = tokio::time::interval(Duration::from_secs(1));
    tick.tick().await;
    while before < jobs {
        tick.tick().await;
        let now = measured.committed.load(Ordering::Relaxed);
        counts.push(now - before);
        before = now;
    }
    counts
}

fn report(
    arguments: &Arguments,
    (measured, committed_each_second, elapsed): (&Measured, &[u64], Duration),
    jobs: u64,
    expand_secs: f64,
    folder: &Path,
) -> Result<Value> {
    // Leaves out the first two seconds, in which the slots start, and the last three, in which the
    // jobs run out.
    let begin = 2.min(committed_each_second.len());
    let middle =
        &committed_each_second[begin..committed_each_second.len().saturating_sub(3).max(begin)];
    let mut sorted = middle.to_vec();
    sorted.sort_unstable();
    let database = std::fs::metadata(folder.join(DATABASE_FILE))?.len();
    let log = std::fs::metadata(folder.join(format!("{DATABASE_FILE}-wal")))?.len();
    Ok(json!({
        "queue": "in process, SQLite file with WAL and synchronous=FULL",
        "build": if cfg!(debug_assertions) { "dev" } else { "release" },
        "cores": std::thread::available_parallelism()?.get(),
        "jobs": jobs,
        "slots": arguments.slots,
        "rollout_millis": arguments.rollout_millis,
        "expand_secs": expand_secs,
        "elapsed_secs": elapsed.as_secs_f64(),
        "committed_per_sec": {
            "mean": middle.iter().sum::<u64>() as f64 / middle.len().max(1) as f64,
            "least": sorted.first(),
            "median": sorted.get(sorted.len() / 2),
            "most": sorted.last(),
        },
        "first_claim_millis": percentiles(&measured.first_claim_micros),
        "claim_millis": percentiles(&measured.claim_micros),
        "commit_millis": percentiles(&measured.commit_micros),
        "cpu_millis_per_rollout": cpu_secs()? * 1e3 / jobs as f64,
        "memory_peak_mib": memory_peak_mib()?,
        "database_mib": database as f64 / f64::from(1 << 20),
        "log_mib": log as f64 / f64::from(1 << 20),
    }))
}

fn percentiles(micros: &Mutex<Vec<u64>>) -> Value {
    let mut micros = micros.lock().expect("no slot panicked").clone();
    micros.sort_unstable();
    let quantile = |share: f64| {
        let index = (micros.len() as f64 * share) as usize;
        micros.get(index.min(micros.len().saturating_sub(1))).map(|micros| *micros as f64 / 1e3)
    };
    json!({
        "p50": quantile(0.5),
        "p90": quantile(0.9),
        "p99": quantile(0.99),
        "most": quantile(1.0),
    })
}

fn record_latency(micros: &Mutex<Vec<u64>>, began: Instant) {
    let span = began.elapsed().as_micros() as u64;
    micros.lock().expect("no slot panicked").push(span);
}

/// Returns the peak resident memory of this process, MiB.
fn memory_peak_mib() -> Result<f64> {
    let status = std::fs::read_to_string("/proc/self/status").context("read /proc/self/status")?;
    let peak = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
    let kib = peak.and_then(|peak| peak.split_whitespace().next());
    Ok(kib.context("find VmHWM")?.parse::<f64>()? / 1024.0)
}

/// Returns the CPU time of this process, including the campaign's expansion, seconds.
fn cpu_secs() -> Result<f64> {
    let stat = std::fs::read_to_string("/proc/self/stat").context("read /proc/self/stat")?;
    // The process name, which may contain spaces, ends with the last parenthesis. User and system
    // time are the 12th and 13th field after it, in hundredths of a second.
    let fields = stat.rsplit_once(')').map_or("", |(_, fields)| fields);
    let ticks = fields.split_whitespace().skip(11).take(2);
    let ticks = ticks.map(|field| field.parse::<f64>().context("read a processor time"));
    Ok(ticks.sum::<Result<f64>>()? / 100.0)
}

fn random_fraction(rng: &mut impl Rng) -> f64 {
    f64::from(rng.next_u32()) / f64::from(u32::MAX)
}

fn worker_id(number: u32) -> WorkerId {
    WorkerId(format!("simulated-{number}"))
}

fn worker_info(number: u32, arguments: &Arguments) -> WorkerInfo {
    WorkerInfo {
        id: worker_id(number),
        host: format!("simulated-{number}"),
        slots: arguments.slots_per_worker,
        machine: None,
        cores: None,
        pin: pin(),
        program_version: env!("CARGO_PKG_VERSION").to_owned(),
    }
}

fn pin() -> Pin {
    Pin {
        asset_pack: "simulated".to_owned(),
        asset_pack_digest: digest("pack"),
        mujoco_version: "simulated".to_owned(),
        renderer: "simulated".to_owned(),
        look: benchmark::Look::default(),
    }
}

/// Returns the report of a rollout with a random outcome. Its digests depend only on task and
/// initial state, and its realised values only on the perturbation, since the queue compares them.
fn outcome(
    worker: &WorkerId,
    job: &Assigned,
    row: &ManifestRow,
    rng: &mut impl Rng,
) -> CommitReport {
    let task = row.id.task();
    let mut realised = Realised::default();
    for axis in row.perturbation.axes() {
        let parameters = row.perturbation.values(axis);
        // Every axis gets about as many elements as the lighting axis has in a scene with four
        // lights.
        realised.add(axis, parameters, vec![0.1; 48]);
    }
    let success = rng.next_u32().is_multiple_of(2);
    CommitReport {
        attempt: job.attempt,
        // As long as a path of 220 control steps, so that rows have a real size: 6 bytes at rest and
        // after every step.
        motion: Motion { path: vec![1; 6 * 221], actions: Vec::new() },
        measurement: Measurement {
            result: RolloutResult {
                success,
                steps: rng.next_u32() % 220,
                wall_secs: 1.0,
                policy_queries: 100,
                goal: GoalProgress {
                    predicates: 1,
                    at_end: success.into(),
                    at_most: success.into(),
                },
                digests: Digests {
                    scene: digest(&task.to_string()),
                    init_state: digest(&format!("{task}/{}", row.init_id)),
                    first_frame: String::new(),
                },
                realised,
                ..RolloutResult::default()
            },
            provenance: Provenance {
                // Each worker counts as a machine.
                host: worker.0.clone(),
                pin: pin(),
                fingerprint: digest("fingerprint"),
                realisation: job.realisation.clone(),
                policy_name: job.policy.clone(),
                policy_settings: [("execute".to_owned(), "8".to_owned())].into(),
                program_version: env!("CARGO_PKG_VERSION").to_owned(),
                ..Provenance::default()
            },
        },
    }
}

fn digest(text: &str) -> String {
    hex::encode(Sha256::digest(text.as_bytes()))
}
