//! Simulated workers: tasks of this process, with one connection per worker. A slot claims, sleeps
//! for the duration of a rollout, and commits an outcome that depends on a hash of the rollout's
//! configuration. Failed calls are retried.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, Ordering};
use std::time::{Duration, Instant};

use libero_ctrl::{Axis, ManifestRow};
use proto::coordinator as wire;
use proto::coordinator::commit_response::Verdict;
use proto::coordinator::worker_service_client::WorkerServiceClient;
use tokio::task::JoinSet;
use tonic::transport::Endpoint;
use tonic::{Code, Status};
use transport::Connection;

use super::server::CoordinatorAccess;
use super::{Arguments, Shared, hash_fraction};

/// Heartbeat interval of a worker.
const HEARTBEAT: Duration = Duration::from_secs(5);
/// Timeout of a call.
const CALL_TIMEOUT: Duration = Duration::from_secs(60);
/// Pause after an empty claim or a failed call.
const PAUSE: Duration = Duration::from_secs(1);
/// Time without running rollouts after which the campaigns count as finished. Longer than a lease,
/// since a restored backup brings leases back.
const IDLE_TIME: Duration = Duration::from_secs(45);
/// Number of filming tasks, and the size of the films that they upload.
const FILMERS: u32 = 8;
const FILM_BYTES: usize = 16 << 10;
/// Share of configurations with an emergent failure.
const EMERGENT: f64 = 0.02;
const PACK: &str = "primitives";
const MUJOCO: &str = "3.3.7";

type Client = WorkerServiceClient<Connection>;

/// Simulated workers and the counts of their calls.
pub(crate) struct Crowd {
    coordinator: CoordinatorAccess,
    /// Mean duration of a rollout.
    rollout_duration: Duration,
    /// Latencies of claims since the last [`Crowd::take_claims`], seconds.
    claims: Shared<Vec<f64>>,
    accepted: AtomicU64,
    refused: AtomicU64,
    films: AtomicU64,
    failed: AtomicU64,
    running: AtomicU32,
    last_busy: Shared<Instant>,
    is_stopped: AtomicBool,
    tasks: tokio::sync::Mutex<JoinSet<()>>,
}

/// Simulated worker, which restarts when the coordinator no longer leases to it.
struct Worker {
    number: u32,
    slots: u32,
    starts: AtomicU32,
    is_registered: AtomicBool,
    client: Client,
    /// Attempt ids of the leases that heartbeats renew.
    held: Shared<BTreeSet<String>>,
}

impl Worker {
    fn id(&self, start: u32) -> String {
        format!("worker-{:04}.{start}", self.number)
    }

    /// Restarts the worker under a new id, unless another of its slots has already done so.
    /// `start` is the number of restarts that the caller knows of.
    fn start_again(&self, start: u32) {
        let order = Ordering::SeqCst;
        let started = self.starts.compare_exchange(start, start + 1, order, order);
        if started.is_ok() {
            self.is_registered.store(false, order);
        }
    }
}

impl Crowd {
    pub(crate) fn start(coordinator: CoordinatorAccess, arguments: &Arguments) -> Arc<Crowd> {
        let crowd = Arc::new(Crowd {
            coordinator,
            rollout_duration: arguments.rollout_duration(),
            claims: Shared::default(),
            accepted: AtomicU64::new(0),
            refused: AtomicU64::new(0),
            films: AtomicU64::new(0),
            failed: AtomicU64::new(0),
            running: AtomicU32::new(0),
            last_busy: Arc::new(std::sync::Mutex::new(Instant::now())),
            is_stopped: AtomicBool::new(false),
            tasks: tokio::sync::Mutex::default(),
        });
        let mut tasks = JoinSet::new();
        for number in 0..arguments.workers {
            let slots = arguments.slots / arguments.workers
                + u32::from(number < arguments.slots % arguments.workers);
            let worker = Arc::new(Worker {
                number,
                slots,
                starts: AtomicU32::new(0),
                is_registered: AtomicBool::new(false),
                client: crowd.client(),
                held: Shared::default(),
            });
            tasks.spawn(crowd.clone().send_heartbeats(worker.clone()));
            for slot in 0..slots {
                tasks.spawn(crowd.clone().run_slot(worker.clone(), slot));
            }
        }
        for _ in 0..FILMERS {
            tasks.spawn(crowd.clone().film(crowd.client()));
        }
        *crowd.tasks.try_lock().expect("an unlocked mutex") = tasks;
        crowd
    }

    fn client(&self) -> Client {
        let endpoint = Endpoint::from_shared(self.coordinator.url.clone()).expect("a URL");
        let connection = self.coordinator.worker.connect_lazy(endpoint.timeout(CALL_TIMEOUT));
        WorkerServiceClient::new(connection.expect("a host"))
    }

    /// Takes the latencies of the claims since the last call, seconds.
    pub(crate) fn take_claims(&self) -> Vec<f64> {
        std::mem::take(&mut *self.claims.lock().expect("no panic"))
    }

    pub(crate) fn accepted(&self) -> u64 {
        self.accepted.load(Ordering::Relaxed)
    }

    /// Returns the numbers of refused results, failed calls and stored films.
    pub(crate) fn other_counts(&self) -> [u64; 3] {
        [&self.refused, &self.failed, &self.films].map(|count| count.load(Ordering::Relaxed))
    }

    /// Returns true if during the last [`IDLE_TIME`] no rollout has run and no call has failed.
    pub(crate) fn is_finished(&self) -> bool {
        let idle = self.last_busy.lock().expect("no panic").elapsed();
        self.running.load(Ordering::Relaxed) == 0 && idle > IDLE_TIME
    }

    pub(crate) async fn stop(&self) {
        self.is_stopped.store(true, Ordering::Relaxed);
        self.tasks.lock().await.shutdown().await;
    }

    fn is_stopped(&self) -> bool {
        self.is_stopped.load(Ordering::Relaxed)
    }

    /// Counts a failed call and pauses, since the coordinator may be down.
    async fn count_failure(&self, _: &Status) {
        self.failed.fetch_add(1, Ordering::Relaxed);
        *self.last_busy.lock().expect("no panic") = Instant::now();
        tokio::time::sleep(PAUSE).await;
    }

    async fn send_heartbeats(self: Arc<Self>, worker: Arc<Worker>) {
        let mut client = worker.client.clone();
        let held = &worker.held;
        let mut last_sent = Instant::now();
        while !self.is_stopped() {
            let start = worker.starts.load(Ordering::SeqCst);
            let id = worker.id(start);
            if !worker.is_registered.load(Ordering::SeqCst) {
                match client.register(registration(&id, worker.slots)).await {
                    Ok(_) => worker.is_registered.store(true, Ordering::SeqCst),
                    Err(status) => self.count_failure(&status).await,
                }
                continue;
            }
            if last_sent.elapsed() < HEARTBEAT {
                tokio::time::sleep(PAUSE / 4).await;
                continue;
            }
            last_sent = Instant::now();
            let attempts = held.lock().expect("no panic").clone();
            let progress = attempts
                .into_iter()
                .map(|attempt_id| wire::Progress { attempt_id, control_steps: 1 });
            let request = wire::HeartbeatRequest {
                worker_id: id.clone(),
                progress: progress.collect(),
                ..wire::HeartbeatRequest::default()
            };
            match client.heartbeat(request).await {
                Ok(answer) => {
                    let lost = answer.into_inner().lost_attempts;
                    let mut held = held.lock().expect("no panic");
                    held.retain(|attempt| !lost.contains(attempt));
                }
                Err(status) => {
                    if is_refused(&status) {
                        worker.start_again(start);
                    }
                    self.count_failure(&status).await;
                }
            }
        }
    }

    async fn run_slot(self: Arc<Self>, worker: Arc<Worker>, slot: u32) {
        let mut client = worker.client.clone();
        let held = &worker.held;
        // The slots start one after the other, as in a cluster.
        let name = format!("{} {slot}", worker.number);
        tokio::time::sleep(self.rollout_duration.mul_f64(hash_fraction(&name))).await;
        let mut claims = 0_u64;
        let mut warm = String::new();
        while !self.is_stopped() {
            if !worker.is_registered.load(Ordering::SeqCst) {
                tokio::time::sleep(PAUSE / 4).await;
                continue;
            }
            claims += 1;
            let start = worker.starts.load(Ordering::SeqCst);
            let id = worker.id(start);
            let request = wire::ClaimRequest {
                worker_id: id.clone(),
                claim_id: format!("{:016x}{:016x}", hash_bits(&id) ^ u64::from(slot), claims),
                wait_secs: 0.0,
                warm_task: warm.clone(),
                lacking_tasks: Vec::new(),
            };
            let sent_at = Instant::now();
            let lease = match client.claim(request).await {
                Ok(answer) => answer.into_inner().lease,
                Err(status) => {
                    if is_refused(&status) {
                        worker.start_again(start);
                    }
                    self.count_failure(&status).await;
                    continue;
                }
            };
            let latency = sent_at.elapsed().as_secs_f64();
            self.claims.lock().expect("no panic").push(latency);
            match lease {
                Some(lease) => {
                    self.running.fetch_add(1, Ordering::Relaxed);
                    held.lock().expect("no panic").insert(lease.attempt_id.clone());
                    warm = self.roll_out(&mut client, &lease).await;
                    held.lock().expect("no panic").remove(&lease.attempt_id);
                    self.running.fetch_sub(1, Ordering::Relaxed);
                    *self.last_busy.lock().expect("no panic") = Instant::now();
                }
                None => tokio::time::sleep(PAUSE).await,
            }
        }
    }

    /// Simulates a rollout and commits it, with retries until the coordinator responds; returns the
    /// rollout's task.
    async fn roll_out(&self, client: &mut Client, lease: &wire::Lease) -> String {
        let row: ManifestRow = serde_json::from_str(&lease.manifest_row).expect("a row");
        // The rollout takes 0.5 to 1.5 times the mean duration.
        let share = 0.5 + hash_fraction(&lease.attempt_id);
        tokio::time::sleep(self.rollout_duration.mul_f64(share)).await;
        let report = report(lease, &row);
        while !self.is_stopped() {
            match client.commit(report.clone()).await {
                Ok(answer) => {
                    let count = match answer.into_inner().verdict() {
                        Verdict::Accepted | Verdict::Duplicate => &self.accepted,
                        _ => &self.refused,
                    };
                    count.fetch_add(1, Ordering::Relaxed);
                    break;
                }
                // The lease was granted after the backup that has been restored since.
                Err(status) if status.code() == Code::NotFound => {
                    self.refused.fetch_add(1, Ordering::Relaxed);
                    break;
                }
                Err(status) => self.count_failure(&status).await,
            }
        }
        row.id.task().to_string()
    }

    /// Simulates `worker film`: requests films to make, and uploads videos.
    async fn film(self: Arc<Self>, mut client: Client) {
        while !self.is_stopped() {
            let request = wire::NextFilmRequest {
                asset_pack_digest: sha(PACK),
                mujoco_version: MUJOCO.to_owned(),
                look: libero_ctrl::Look::default().to_string(),
                campaign: String::new(),
            };
            let film = match client.next_film(request).await {
                Ok(answer) => answer.into_inner().film,
                Err(status) => {
                    self.count_failure(&status).await;
                    continue;
                }
            };
            let Some(film) = film else {
                tokio::time::sleep(PAUSE * 5).await;
                continue;
            };
            let chunk = wire::ArtifactChunk {
                attempt_id: film.attempt_id,
                name: "video.mp4".to_owned(),
                data: vec![7; FILM_BYTES],
            };
            let sent = client.put_artifact(tokio_stream::iter([chunk])).await;
            match sent {
                Ok(_) => drop(self.films.fetch_add(1, Ordering::Relaxed)),
                Err(status) => self.count_failure(&status).await,
            }
        }
    }
}

/// Returns true if the coordinator does not know the worker or no longer leases to it, as after a
/// restored backup, when the worker's leases count as lost.
fn is_refused(status: &Status) -> bool {
    matches!(status.code(), Code::NotFound | Code::FailedPrecondition)
}

fn registration(id: &str, slots: u32) -> wire::RegisterRequest {
    wire::RegisterRequest {
        protocol_version: proto::COORDINATOR_PROTOCOL_VERSION,
        program_version: "0.1.0".to_owned(),
        worker_id: id.to_owned(),
        host: "soak".to_owned(),
        slots,
        asset_pack: PACK.to_owned(),
        asset_pack_digest: sha(PACK),
        mujoco_version: MUJOCO.to_owned(),
        renderer: "none".to_owned(),
        look: libero_ctrl::Look::default().to_string(),
        cores: slots,
        ..wire::RegisterRequest::default()
    }
}

/// Returns the outcome of a rollout. The share [`EMERGENT`] of the configurations fails if camera
/// and sensor are both perturbed; all other rollouts succeed.
fn succeeds(row: &ManifestRow) -> bool {
    let Some(config) = row.id.config() else {
        return true;
    };
    let axes = row.axes();
    let name = format!("{} {} {config}", row.id.task(), row.id.level());
    let has_both_axes = axes.contains(Axis::Camera) && axes.contains(Axis::Sensor);
    !(has_both_axes && hash_fraction(&name) < EMERGENT)
}

fn report(lease: &wire::Lease, row: &ManifestRow) -> wire::CommitRequest {
    let task = row.id.task().to_string();
    let success = succeeds(row);
    wire::CommitRequest {
        attempt_id: lease.attempt_id.clone(),
        // 20 positions of 6 bytes, and 20 actions of 28 bytes.
        motion: Some(wire::Motion {
            path: vec![1; 6 * 20],
            actions: vec![2; if lease.keep_actions { 28 * 20 } else { 0 }],
        }),
        result: Some(wire::RolloutResult {
            success,
            steps: if success { 120 } else { 220 },
            wall_secs: 1.5,
            policy_queries: 30,
            parts: Some(wire::Parts::default()),
            goal: Some(wire::GoalProgress {
                predicates: 1,
                at_end: success.into(),
                at_most: success.into(),
            }),
            ..wire::RolloutResult::default()
        }),
        provenance: Some(wire::Provenance {
            host: "soak".to_owned(),
            renderer: "none".to_owned(),
            look: libero_ctrl::Look::default().to_string(),
            fingerprint: sha("bits"),
            mujoco_version: MUJOCO.to_owned(),
            asset_pack: PACK.to_owned(),
            asset_pack_digest: sha(PACK),
            scene_digest: sha(&task),
            init_state_digest: sha(&format!("{task} {}", row.init_id)),
            realised: realised(&lease.manifest_row),
            realisation: lease.realisation.clone(),
            policy_name: lease.policy.clone(),
            policy_checkpoint: "none".to_owned(),
            batch_mode: "deterministic".to_owned(),
            program_version: "0.1.0".to_owned(),
            ..wire::Provenance::default()
        }),
    }
}

/// Returns the parameters of each perturbed axis but language, each with one constant element.
fn realised(row: &str) -> Vec<wire::RealisedAxis> {
    let row: serde_json::Value = serde_json::from_str(row).expect("a row");
    let parameters = &row["perturb"];
    let axis = |name: &str, values: &serde_json::Value| {
        let values: BTreeMap<String, f64> =
            serde_json::from_value(values.clone()).unwrap_or_default();
        wire::RealisedAxis {
            axis: name.to_owned(),
            parameters: values.into_values().collect(),
            elements: vec![0.5],
        }
    };
    let names = ["camera", "lighting", "robot", "sensor", "actuation"];
    match row["axis"].as_str().unwrap_or_default() {
        "clean" | "language" => Vec::new(),
        name if names.contains(&name) => vec![axis(name, parameters)],
        _ => names.iter().filter_map(|name| Some(axis(name, parameters.get(name)?))).collect(),
    }
}

/// Hashes a text and the id of this process to 64 bits, so that two runs of the test make different
/// claim ids.
fn hash_bits(text: &str) -> u64 {
    (hash_fraction(text) * 2_f64.powi(32)) as u64 ^ u64::from(std::process::id()) << 32
}

fn sha(text: &str) -> String {
    use sha2::{Digest, Sha256};
    let digest = Sha256::digest(text.as_bytes());
    digest.iter().map(|byte| format!("{byte:02x}")).collect()
}
