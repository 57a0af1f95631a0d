//! A coordinator on a free port with a manual clock, and simulated workers that call it.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use benchmark::Axis;
use benchmark::attempt::{
    Digests, GoalProgress, Measurement, Parts, Pin, Provenance, Realised, RolloutResult,
};
use coordinator::{Config, Coordinator};
use proto::coordinator as wire;
use proto::coordinator::change_campaign_request::Change;
use proto::coordinator::commit_response::Verdict;
use proto::coordinator::operator_service_client::OperatorServiceClient;
use proto::coordinator::release_request::Reason;
use proto::coordinator::worker_service_client::WorkerServiceClient;
use queue::clock::{Clock, ManualClock, UnixMillis};
use queue::read::{CampaignStatus, Counts};
use queue::rules::campaign::CampaignState;
use queue::{Created, Queue, Timing};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use serde::de::DeserializeOwned;
use serde_json::{Value, json};
use sqlx::sqlite::{SqliteConnectOptions, SqlitePool};
use tempfile::TempDir;
use tokio::net::TcpListener;
use tokio::sync::oneshot;
use tokio::task::JoinSet;
use tonic::transport::Channel;
use tonic::{Response, Status};

/// Interval between two sweeps while time passes. It is less than half a lease, since the
/// coordinator would otherwise conclude that it was suspended.
const SWEEP_SECS: u64 = 10;

/// Number of coordinators started so far.
static STARTS: AtomicU64 = AtomicU64::new(0);

pub(crate) struct Bench {
    pub(crate) folder: TempDir,
    pub(crate) clock: Arc<ManualClock>,
    pub(crate) queue: Arc<Queue>,
    pub(crate) url: String,
    stop: oneshot::Sender<()>,
    served: JoinSet<()>,
}

/// A worker that runs no rollouts and reports the results that the test specifies.
#[derive(Clone)]
pub(crate) struct Worker {
    pub(crate) id: String,
    pub(crate) pack: String,
    pub(crate) renderer: String,
    pub(crate) look: String,
    pub(crate) fingerprint: String,
    pub(crate) service: WorkerServiceClient<Channel>,
}

/// Returns the value in an operator's answer.
pub(crate) fn value<T: DeserializeOwned>(
    answer: Result<Response<wire::Answer>, Status>,
) -> Result<T, Status> {
    let json = answer?.into_inner().json;
    Ok(serde_json::from_str(&json).unwrap_or_else(|error| panic!("{error}: {json}")))
}

/// Returns the configuration of a coordinator with a clock that the test controls.
pub(crate) fn config(data: &Path, clock: Arc<dyn Clock>) -> Config {
    Config {
        data: data.to_owned(),
        timing: Timing {
            // Tests call the sweep themselves.
            sweep: Duration::from_secs(3_600),
            ..Timing::default()
        },
        clock,
        // No two starts may draw the same attempt ids.
        rng: ChaCha8Rng::seed_from_u64(STARTS.fetch_add(1, Ordering::Relaxed)),
        security: transport::Security::loopback(),
        min_free_bytes: 0,
        storage: None,
    }
}

impl Bench {
    pub(crate) async fn start() -> Bench {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let clock = Arc::new(ManualClock::at(UnixMillis(1_700_000_000_000)));
        Bench::start_in(folder, clock).await
    }

    pub(crate) async fn with(spec: &Value) -> Bench {
        let bench = Bench::start().await;
        bench.create(spec).await.expect("created");
        bench
    }

    /// Starts a coordinator on a folder that may have a database.
    pub(crate) async fn start_in(folder: TempDir, clock: Arc<ManualClock>) -> Bench {
        Bench::start_with(folder, clock, 0).await
    }

    /// Starts a coordinator that keeps this much of the disk for results.
    pub(crate) async fn start_with(
        folder: TempDir,
        clock: Arc<ManualClock>,
        min_free_bytes: u64,
    ) -> Bench {
        let config = Config { min_free_bytes, ..config(folder.path(), clock.clone()) };
        let listener = TcpListener::bind("127.0.0.1:0").await.expect("a free port");
        let address = listener.local_addr().expect("an address");
        let coordinator = Coordinator::open(config).await.expect("a coordinator");
        let queue = coordinator.queue().clone();
        let (stop, stopped) = oneshot::channel();
        let mut served = JoinSet::new();
        served.spawn(async move {
            let shutdown = async {
                stopped.await.expect("a sender");
            };
            coordinator.serve(listener, shutdown).await.expect("serves");
        });
        Bench { folder, clock, queue, url: format!("http://{address}"), stop, served }
    }

    pub(crate) async fn stop(self) -> TempDir {
        self.stop.send(()).expect("a running coordinator");
        self.served.join_all().await;
        self.folder
    }

    /// Shuts the coordinator down and starts another on the same folder.
    pub(crate) async fn restart(self) -> Bench {
        let clock = self.clock.clone();
        let folder = self.stop().await;
        Bench::start_in(folder, clock).await
    }

    /// Advances the clock, with regular sweeps.
    pub(crate) async fn advance(&self, secs: u64) {
        let mut remaining_secs = secs;
        while remaining_secs > 0 {
            let step = remaining_secs.min(SWEEP_SECS);
            self.clock.advance(Duration::from_secs(step));
            self.queue.sweep().await.expect("a sweep");
            remaining_secs -= step;
        }
    }

    /// Registers a worker of the `primitives` pack.
    pub(crate) async fn worker(&self, id: &str) -> Worker {
        self.worker_of_pack(id, "primitives").await
    }

    /// Registers a worker that claims one job, which must be available.
    pub(crate) async fn worker_with_lease(&self, id: &str) -> (Worker, wire::Lease) {
        let mut worker = self.worker(id).await;
        let lease = worker.claim_one().await;
        (worker, lease)
    }

    /// Registers a worker of an asset pack.
    pub(crate) async fn worker_of_pack(&self, id: &str, pack: &str) -> Worker {
        self.worker_with_renderer(id, pack, "llvmpipe").await
    }

    /// Registers a worker of the `primitives` pack on a named machine.
    pub(crate) async fn worker_on_machine(&self, machine: &str, id: &str) -> Worker {
        let machine = machine.to_owned();
        self.register(wire::RegisterRequest { machine, ..registration(id, "primitives") }).await
    }

    pub(crate) async fn worker_with_renderer(
        &self,
        id: &str,
        pack: &str,
        renderer: &str,
    ) -> Worker {
        let renderer = renderer.to_owned();
        self.register(wire::RegisterRequest { renderer, ..registration(id, pack) }).await
    }

    pub(crate) async fn register(&self, request: wire::RegisterRequest) -> Worker {
        let channel = Channel::from_shared(self.url.clone())
            .expect("a URL")
            .connect()
            .await
            .expect("a connection");
        let mut worker = Worker {
            id: request.worker_id.clone(),
            pack: request.asset_pack.clone(),
            renderer: request.renderer.clone(),
            look: request.look.clone(),
            fingerprint: "bits".to_owned(),
            service: WorkerServiceClient::new(channel),
        };
        worker.service.register(request).await.expect("registers");
        worker
    }

    pub(crate) async fn operator(&self) -> OperatorServiceClient<Channel> {
        OperatorServiceClient::connect(self.url.clone()).await.expect("a connection")
    }

    pub(crate) async fn create(&self, spec: &Value) -> Result<Created, Status> {
        self.create_with_priority(spec, 0).await
    }

    pub(crate) async fn create_with_priority(
        &self,
        spec: &Value,
        priority: i32,
    ) -> Result<Created, Status> {
        let request = wire::CreateCampaignRequest { spec: spec.to_string(), priority };
        value(self.operator().await.create_campaign(request).await)
    }

    pub(crate) async fn status(&self, campaign: &str) -> CampaignStatus {
        let request = wire::GetCampaignRequest { campaign: campaign.to_owned() };
        let response = self.operator().await.get_campaign(request).await;
        value(response).expect("a status")
    }

    /// Pauses, resumes or cancels a campaign; returns the name of its state.
    pub(crate) async fn change(
        &self,
        campaign: &str,
        change: Change,
    ) -> Result<&'static str, Status> {
        let request =
            wire::ChangeCampaignRequest { campaign: campaign.to_owned(), change: change.into() };
        let state: CampaignState = value(self.operator().await.change_campaign(request).await)?;
        Ok(state.name())
    }

    /// Deletes a campaign; returns the number of its results.
    pub(crate) async fn delete(&self, campaign: &str, confirm: &str) -> Result<u64, Status> {
        let request = wire::DeleteCampaignRequest {
            campaign: campaign.to_owned(),
            confirm: confirm.to_owned(),
        };
        let deleted: Counts = value(self.operator().await.delete_campaign(request).await)?;
        Ok(deleted.committed)
    }

    pub(crate) async fn assert_sound(&self) {
        assert_sound(self.folder.path()).await;
    }

    /// Opens the database directly, bypassing the coordinator.
    pub(crate) async fn database(&self) -> SqlitePool {
        open_database(self.folder.path()).await
    }

    pub(crate) async fn count(&self, sql: &'static str) -> i64 {
        let pool = self.database().await;
        let count = sqlx::query_scalar(sql).fetch_one(&pool).await;
        pool.close().await;
        count.expect("a count")
    }
}

impl Worker {
    /// Claims up to `jobs` jobs one after the other, without waiting, and
    /// acknowledges their leases.
    pub(crate) async fn claim(&mut self, jobs: u32) -> Vec<wire::Lease> {
        self.claim_warm(jobs, "").await
    }

    pub(crate) async fn claim_warm(&mut self, jobs: u32, warm: &str) -> Vec<wire::Lease> {
        let mut leases = Vec::new();
        while leases.len() < jobs as usize {
            let Some(lease) = self.claim_response(warm).await.lease else {
                break;
            };
            leases.push(lease);
        }
        let granted: Vec<&wire::Lease> = leases.iter().collect();
        if !granted.is_empty() {
            assert_eq!(self.heartbeat(&granted, 0).await, [""; 0]);
        }
        leases
    }

    /// Claims once, without waiting, and acknowledges nothing.
    pub(crate) async fn claim_response(&mut self, warm: &str) -> wire::ClaimResponse {
        let claim = self.try_claim(0.0, warm).await;
        claim.expect("an answer")
    }

    pub(crate) async fn try_claim(
        &mut self,
        wait_secs: f64,
        warm: &str,
    ) -> Result<wire::ClaimResponse, Status> {
        let request = self.claim_request(wait_secs, warm);
        Ok(self.service.claim(request).await?.into_inner())
    }

    pub(crate) fn claim_request(&self, wait_secs: f64, warm: &str) -> wire::ClaimRequest {
        static CLAIMS: AtomicU64 = AtomicU64::new(1);
        wire::ClaimRequest {
            worker_id: self.id.clone(),
            claim_id: format!("{:032x}", CLAIMS.fetch_add(1, Ordering::Relaxed)),
            wait_secs,
            warm_task: warm.to_owned(),
            ..wire::ClaimRequest::default()
        }
    }

    pub(crate) async fn claim_one(&mut self) -> wire::Lease {
        let mut leases = self.claim(1).await;
        assert_eq!(leases.len(), 1, "a job is available");
        leases.remove(0)
    }

    /// Reports a consistent outcome of `lease`.
    pub(crate) async fn commit(&mut self, lease: &wire::Lease, success: bool) -> Verdict {
        self.commit_request(self.report(lease, success)).await.0
    }

    /// Reports outcomes of `leases`, which must be accepted.
    pub(crate) async fn commit_all<'a>(
        &mut self,
        leases: impl IntoIterator<Item = &'a wire::Lease>,
        success: bool,
    ) {
        for lease in leases {
            assert_eq!(self.commit(lease, success).await, Verdict::Accepted);
        }
    }

    /// Like [`commit`](Self::commit), but returns an error if the coordinator refuses the call or
    /// does not answer.
    pub(crate) async fn try_commit(
        &mut self,
        lease: &wire::Lease,
        success: bool,
    ) -> Result<Verdict, Status> {
        let response = self.service.commit(self.report(lease, success)).await?;
        Ok(response.into_inner().verdict())
    }

    pub(crate) async fn commit_request(
        &mut self,
        request: wire::CommitRequest,
    ) -> (Verdict, String) {
        let response = self.service.commit(request).await.expect("a verdict");
        let response = response.into_inner();
        (response.verdict(), response.detail)
    }

    /// Returns the report of an outcome as a worker with this pack would send it.
    pub(crate) fn report(&self, lease: &wire::Lease, success: bool) -> wire::CommitRequest {
        self.report_altered(lease, success, |_| {})
    }

    /// Like [`report`](Self::report), with an altered result.
    pub(crate) fn report_altered(
        &self,
        lease: &wire::Lease,
        success: bool,
        alter: impl FnOnce(&mut Measurement),
    ) -> wire::CommitRequest {
        let row: Value = serde_json::from_str(&lease.manifest_row).expect("a manifest row");
        // A success holds both predicates of the goal at once.
        let held = |count: u32| if success { 2 } else { count };
        let execution = row["execution"].as_str();
        let mut measurement = Measurement {
            result: RolloutResult {
                success,
                steps: if success { 120 } else { 280 },
                wall_secs: 1.5,
                policy_queries: 30,
                parts: Parts { physics_secs: 0.5, drawing_secs: 0.25, policy_secs: 0.5 },
                goal: GoalProgress { predicates: 2, at_end: held(0), at_most: held(1) },
                digests: Digests {
                    scene: sha(&format!("{}/{}", row["suite"], row["task_id"])),
                    init_state: sha(&format!(
                        "{}/{}/{}",
                        row["suite"], row["task_id"], row["init_id"]
                    )),
                    first_frame: String::new(),
                },
                realised: realised(&row),
                ..RolloutResult::default()
            },
            provenance: Provenance {
                host: "bench".to_owned(),
                pin: Pin {
                    asset_pack: self.pack.clone(),
                    asset_pack_digest: sha(&self.pack),
                    mujoco_version: "3.3.7".to_owned(),
                    renderer: self.renderer.clone(),
                    look: self.look.parse().expect("a look"),
                },
                fingerprint: sha(&self.fingerprint),
                realisation: lease.realisation.clone(),
                policy_name: lease.policy.clone(),
                policy_checkpoint: "none".to_owned(),
                policy_settings: execution
                    .map(|model| ("execution model".to_owned(), model.to_owned()))
                    .into_iter()
                    .collect(),
                batch_mode: "deterministic".to_owned(),
                program_version: "0.1.0".to_owned(),
                ..Provenance::default()
            },
        };
        alter(&mut measurement);
        wire::CommitRequest {
            attempt_id: lease.attempt_id.clone(),
            measurement: serde_json::to_string(&measurement).expect("JSON"),
            motion: Some(wire::Motion {
                path: vec![1; 6],
                actions: vec![2; if lease.keep_actions { 28 } else { 0 }],
            }),
        }
    }

    pub(crate) async fn release(
        &mut self,
        lease: &wire::Lease,
        reason: Reason,
    ) -> wire::ReleaseResponse {
        self.release_with_answers(lease, reason, None).await
    }

    pub(crate) async fn lose_policy(
        &mut self,
        lease: &wire::Lease,
        answered: u32,
    ) -> wire::ReleaseResponse {
        let reason = Reason::PolicyUnavailable;
        self.release_with_answers(lease, reason, Some(answered)).await
    }

    async fn release_with_answers(
        &mut self,
        lease: &wire::Lease,
        reason: Reason,
        answered_queries: Option<u32>,
    ) -> wire::ReleaseResponse {
        let request = wire::ReleaseRequest {
            attempt_id: lease.attempt_id.clone(),
            reason: reason.into(),
            error: "simulated failure".to_owned(),
            answered_queries,
        };
        let response = self.service.release(request).await;
        response.expect("a verdict").into_inner()
    }

    /// Sends a heartbeat without leases that reports the number of videos being made.
    pub(crate) async fn report_filming(&mut self, filming: u32) {
        let request = wire::HeartbeatRequest {
            worker_id: self.id.clone(),
            filming,
            ..wire::HeartbeatRequest::default()
        };
        self.service.heartbeat(request).await.expect("an answer");
    }

    /// Sends a heartbeat; returns the attempts whose leases are lost.
    pub(crate) async fn heartbeat(&mut self, leases: &[&wire::Lease], steps: u32) -> Vec<String> {
        let progress = leases.iter().map(|lease| wire::Progress {
            attempt_id: lease.attempt_id.clone(),
            control_steps: steps,
        });
        let request = wire::HeartbeatRequest {
            worker_id: self.id.clone(),
            progress: progress.collect(),
            ..wire::HeartbeatRequest::default()
        };
        let response = self.service.heartbeat(request).await;
        response.expect("an answer").into_inner().lost_attempts
    }
}

/// Returns a specification of four rollouts: `libero_object/0` in configuration 0, nominally, and
/// at L1 under `camera`, under `sensor` and under both simultaneously.
pub(crate) fn small_spec(name: &str) -> Value {
    json!({
        "name": name,
        "policy": {"name": "expert", "endpoint": "http://127.0.0.1:50051"},
        "tasks": ["libero_object/0"],
        "axes": ["camera", "sensor"],
        "levels": ["L1"],
        "configs": [0],
        "nominal": "eval",
    })
}

pub(crate) fn with(mut spec: Value, changes: Value) -> Value {
    let changes = changes.as_object().expect("fields");
    for (field, value) in changes {
        spec[field] = value.clone();
    }
    spec
}

pub(crate) fn registration(id: &str, pack: &str) -> wire::RegisterRequest {
    wire::RegisterRequest {
        protocol_version: proto::COORDINATOR_PROTOCOL_VERSION,
        program_version: "0.1.0".to_owned(),
        worker_id: id.to_owned(),
        host: "bench".to_owned(),
        slots: 2,
        asset_pack: pack.to_owned(),
        asset_pack_digest: sha(pack),
        mujoco_version: "3.3.7".to_owned(),
        renderer: "llvmpipe".to_owned(),
        look: "mujoco-3.3.2".to_owned(),
        cores: 2,
        ..wire::RegisterRequest::default()
    }
}

pub(crate) fn rollout_id(lease: &wire::Lease) -> String {
    let row: Value = serde_json::from_str(&lease.manifest_row).expect("a manifest row");
    row["rollout_id"].as_str().expect("an id").to_owned()
}

/// Returns the perturbation that the simulated worker realises: the parameters and one constant
/// element, so that both realisation modes give the same values.
fn realised(row: &Value) -> Realised {
    let mut realised = Realised::default();
    for axis in Axis::METRIC {
        let values = match row["axis"] == axis.name() {
            true => Some(&row["perturb"]),
            false => row["perturb"].get(axis.name()),
        };
        let Some(values) = values.and_then(Value::as_object) else { continue };
        let parameters = values.values().map(|value| value.as_f64().expect("a number"));
        realised.add(axis, parameters.collect(), vec![0.5]);
    }
    realised
}

pub(crate) async fn open_database(folder: &Path) -> SqlitePool {
    let options = SqliteConnectOptions::new().filename(folder.join("coordinator.sqlite"));
    SqlitePool::connect_with(options).await.expect("a database")
}

pub(crate) async fn report_json(
    operator: &mut OperatorServiceClient<Channel>,
    campaign: &str,
) -> Vec<u8> {
    let request = wire::ReportRequest { campaign: campaign.to_owned() };
    let mut parts = operator.report(request).await.expect("a report").into_inner();
    let mut json = Vec::new();
    while let Some(part) = parts.message().await.expect("a part") {
        json.extend(part.json);
    }
    json
}

pub(crate) async fn assert_sound(folder: &Path) {
    let violations = queue::invariants::check(folder).await.expect("a database");
    assert_eq!(violations, []);
}

/// Returns all rows of a data folder's database, each prefixed with the name of its table.
pub(crate) async fn rows(folder: &Path) -> Vec<String> {
    let pool = open_database(folder).await;
    let tables = "SELECT name FROM sqlite_schema WHERE type = 'table'
                      AND name NOT LIKE 'sqlite_%' ORDER BY name";
    let tables: Vec<String> = sqlx::query_scalar(tables).fetch_all(&pool).await.expect("tables");
    let mut rows = Vec::new();
    for table in tables {
        let columns = format!(
            "SELECT group_concat('quote(' || name || ')', ' || '','' || ')
             FROM pragma_table_info('{table}')"
        );
        let columns: String = sqlx::query_scalar(sqlx::AssertSqlSafe(columns))
            .fetch_one(&pool)
            .await
            .expect("columns");
        let query = format!("SELECT '{table}: ' || {columns} FROM {table} ORDER BY 1");
        let table_rows: Vec<String> =
            sqlx::query_scalar(sqlx::AssertSqlSafe(query)).fetch_all(&pool).await.expect("rows");
        rows.extend(table_rows);
    }
    pool.close().await;
    rows
}

pub(crate) fn sha(text: &str) -> String {
    use sha2::{Digest, Sha256};
    hex::encode(Sha256::digest(text.as_bytes()))
}
