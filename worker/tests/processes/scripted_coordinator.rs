//! A coordinator that leases the jobs that a test gives it, and records every message. A test
//! cannot make the real coordinator lose a lease.

use std::collections::{HashMap, VecDeque};
use std::net::SocketAddr;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use benchmark::attempt::{Measurement, Provenance, RolloutResult};
use proto::coordinator::worker_service_server::{WorkerService, WorkerServiceServer};
use proto::coordinator::{
    ArtifactChunk, ClaimRequest, ClaimResponse, CommitRequest, CommitResponse, Film,
    HeartbeatRequest, HeartbeatResponse, Lease, Motion, NextFilmRequest, NextFilmResponse,
    Progress, PutArtifactResponse, RegisterRequest, RegisterResponse, ReleaseRequest,
    ReleaseResponse, SignOffRequest, SignOffResponse, commit_response, release_request,
    release_response,
};
use tokio::net::TcpListener;
use tokio::runtime::Runtime;
use tokio::sync::watch;
use tokio_stream::StreamExt;
use tokio_stream::wrappers::TcpListenerStream;
use tonic::transport::Server;
use tonic::{Request, Response, Status, Streaming};

use crate::worker_process::attempt_id;

/// Longest wait for something that a test expects.
const PATIENCE: Duration = Duration::from_secs(60);

/// Message of a worker, apart from claims, heartbeats and sign-offs.
#[derive(Clone, Debug)]
pub(crate) enum WorkerMessage {
    Registered(Box<RegisterRequest>),
    Video { attempt: String, bytes: Vec<u8> },
    Committed(Box<CommitRequest>),
    Released(Box<ReleaseRequest>),
}

pub(crate) struct Commit {
    pub(crate) attempt_id: String,
    pub(crate) result: RolloutResult,
    pub(crate) provenance: Provenance,
    pub(crate) motion: Motion,
}

impl WorkerMessage {
    pub(crate) fn commit(self) -> Commit {
        match self {
            Self::Committed(commit) => {
                let CommitRequest { attempt_id, measurement, motion } = *commit;
                let Measurement { result, provenance } =
                    serde_json::from_str(&measurement).expect("a result");
                let problem = result.problem().or_else(|| provenance.problem());
                assert_eq!(problem, None, "{measurement}");
                Commit { attempt_id, result, provenance, motion: motion.expect("a motion") }
            }
            unexpected => panic!("expected a commit, got {unexpected:?}"),
        }
    }

    pub(crate) fn release(self, reason: release_request::Reason) -> ReleaseRequest {
        match self {
            Self::Released(release) if release.reason() == reason => *release,
            unexpected => panic!("expected a release for {reason:?}, got {unexpected:?}"),
        }
    }
}

/// The coordinator's instructions from the test, and the messages that it received.
#[derive(Debug, Default)]
struct State {
    leases: VecDeque<Lease>,
    films: VecDeque<Film>,
    lost_attempts: Vec<String>,
    messages: Vec<WorkerMessage>,
    heartbeats: Vec<HeartbeatRequest>,
    signed_off: Vec<String>,
    claims: Vec<ClaimRequest>,
    /// Number of claims that were withdrawn before they were answered.
    claims_withdrawn: u32,
    /// Number of further claims whose answers are lost.
    answers_to_lose: u32,
    /// Leases granted to claims whose answers were lost, by claim id.
    unanswered_leases: HashMap<String, Lease>,
    stop_leasing: String,
    refuses_artifacts: bool,
    refused_artifacts: u32,
    commit_verdict: Option<commit_response::Verdict>,
}

/// The service, shared by all connections.
#[derive(Clone, Debug)]
struct Service {
    heartbeat: Duration,
    progress_timeout: Duration,
    state: Arc<Mutex<State>>,
    changed: Arc<watch::Sender<()>>,
}

pub(crate) struct ScriptedCoordinator {
    service: Service,
    address: SocketAddr,
    /// Separate runtime of the server: its shutdown closes all connections of the server.
    runtime: Option<Runtime>,
}

impl Drop for ScriptedCoordinator {
    fn drop(&mut self) {
        self.stop();
    }
}

impl ScriptedCoordinator {
    /// Starts a coordinator with a progress timeout that no test reaches.
    pub(crate) async fn start() -> Self {
        Self::with_progress_timeout(Duration::from_secs(600)).await
    }

    pub(crate) async fn with_progress_timeout(progress_timeout: Duration) -> Self {
        Self::with_times(Duration::from_millis(100), progress_timeout).await
    }

    pub(crate) async fn with_times(heartbeat: Duration, progress_timeout: Duration) -> Self {
        let service = Service {
            heartbeat,
            progress_timeout,
            state: Arc::default(),
            changed: Arc::new(watch::Sender::new(())),
        };
        let listener = TcpListener::bind("127.0.0.1:0").await.expect("a port");
        let address = listener.local_addr().expect("an address");
        let runtime = Some(serve(service.clone(), listener));
        Self { service, address, runtime }
    }

    pub(crate) fn url(&self) -> String {
        format!("http://{}", self.address)
    }

    pub(crate) fn lease(&self, lease: Lease) {
        self.change(|state| state.leases.push_back(lease));
    }

    pub(crate) fn film(&self, film: Film) {
        self.change(|state| state.films.push_back(film));
    }

    pub(crate) fn lose_lease(&self, job: i64) {
        self.change(|state| state.lost_attempts.push(attempt_id(job)));
    }

    /// Orders the worker to stop leasing, in the next answer to a release.
    pub(crate) fn stop_leasing(&self, reason: &str) {
        self.change(|state| reason.clone_into(&mut state.stop_leasing));
    }

    /// Answers the next claim that gets a lease with UNAVAILABLE, as if the answer were lost.
    pub(crate) fn lose_an_answer_to_a_claim(&self) {
        self.change(|state| state.answers_to_lose += 1);
    }

    pub(crate) fn refuse_artifacts(&self) {
        self.change(|state| state.refuses_artifacts = true);
    }

    /// Waits until this number of videos were refused.
    pub(crate) async fn wait_for_refused_artifacts(&self, times: u32) {
        self.wait_for("videos", |state| (state.refused_artifacts >= times).then_some(())).await;
    }

    pub(crate) fn answer_commits(&self, verdict: commit_response::Verdict) {
        self.change(|state| state.commit_verdict = Some(verdict));
    }

    /// Closes the server with all connections, as if it were killed.
    pub(crate) fn stop(&mut self) {
        if let Some(runtime) = self.runtime.take() {
            runtime.shutdown_background();
        }
    }

    /// Listens at the same address again.
    pub(crate) async fn restart(&mut self) {
        // The port becomes free a moment after the runtime has ended.
        let listener = loop {
            match TcpListener::bind(self.address).await {
                Ok(listener) => break listener,
                Err(_) => tokio::time::sleep(Duration::from_millis(20)).await,
            }
        };
        self.runtime = Some(serve(self.service.clone(), listener));
    }

    /// Waits until a claim was withdrawn before it was answered.
    pub(crate) async fn wait_for_withdrawn_claim(&self) {
        self.wait_for("a withdrawn claim", |state| (state.claims_withdrawn > 0).then_some(()))
            .await;
    }

    /// Waits for message `number`; the registration is message 0.
    pub(crate) async fn message(&self, number: usize) -> WorkerMessage {
        self.wait_for("a message", |state| state.messages.get(number).cloned()).await
    }

    /// Waits until a heartbeat reports at least this number of control steps of a job.
    pub(crate) async fn wait_for_progress(&self, job: i64, control_steps: u32) {
        self.wait_for("progress", |state| {
            let is_far_enough = |progress: &&Progress| {
                progress.attempt_id == attempt_id(job) && progress.control_steps >= control_steps
            };
            let last = state.heartbeats.last()?;
            last.progress.iter().find(is_far_enough).map(|_| ())
        })
        .await;
    }

    /// Waits until the last heartbeat reports that the worker is rendering or sending this number
    /// of videos.
    pub(crate) async fn wait_for_filming(&self, videos: u32) {
        self.wait_for("a heartbeat about videos", |state| {
            let last = state.heartbeats.last()?;
            (last.filming == videos).then_some(())
        })
        .await;
    }

    pub(crate) fn heartbeats(&self) -> Vec<HeartbeatRequest> {
        let state = self.service.state.lock();
        state.expect("unpoisoned").heartbeats.clone()
    }

    /// Waits until the worker has requested work this number of times.
    pub(crate) async fn wait_for_claims(&self, times: usize) {
        self.wait_for("claims", |state| (state.claims.len() >= times).then_some(())).await;
    }

    /// Returns all messages so far, in order.
    pub(crate) fn messages(&self) -> Vec<WorkerMessage> {
        self.service.state.lock().expect("unpoisoned").messages.clone()
    }

    pub(crate) fn signed_off(&self) -> Vec<String> {
        let state = self.service.state.lock();
        state.expect("unpoisoned").signed_off.clone()
    }

    pub(crate) fn claims(&self) -> Vec<ClaimRequest> {
        let state = self.service.state.lock();
        state.expect("unpoisoned").claims.clone()
    }

    fn change(&self, change: impl FnOnce(&mut State)) {
        self.service.change(change);
    }

    async fn wait_for<T>(
        &self,
        expectation: &str,
        mut probe: impl FnMut(&State) -> Option<T>,
    ) -> T {
        let mut changes = self.service.changed.subscribe();
        let waiting = async {
            loop {
                if let Some(found) = probe(&self.service.state.lock().expect("unpoisoned")) {
                    return found;
                }
                changes.changed().await.expect("the service holds the sender");
            }
        };
        match tokio::time::timeout(PATIENCE, waiting).await {
            Ok(found) => found,
            Err(_) => {
                panic!("waited {PATIENCE:?} for {expectation}; received {:#?}", self.messages())
            }
        }
    }
}

fn serve(service: Service, listener: TcpListener) -> Runtime {
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(1)
        .enable_all()
        .build()
        .expect("a runtime");
    let listener = listener.into_std().expect("a listener");
    runtime.spawn(async move {
        let listener = TcpListener::from_std(listener).expect("a listener");
        let served = Server::builder()
            .add_service(WorkerServiceServer::new(service))
            .serve_with_incoming(TcpListenerStream::new(listener));
        served.await.expect("serves");
    });
    runtime
}

impl Service {
    fn change<T>(&self, change: impl FnOnce(&mut State) -> T) -> T {
        let changed = change(&mut self.state.lock().expect("unpoisoned"));
        self.changed.send_replace(());
        changed
    }

    /// Changes the state without waking the tests that wait for a change.
    fn change_quietly<T>(&self, change: impl FnOnce(&mut State) -> T) -> T {
        change(&mut self.state.lock().expect("unpoisoned"))
    }

    fn record(&self, message: WorkerMessage) {
        self.change(|state| state.messages.push(message));
    }
}

/// Claim under way, which counts as withdrawn if it is dropped before its answer.
struct WaitingClaim<'a> {
    service: &'a Service,
    is_answered: bool,
}

impl Drop for WaitingClaim<'_> {
    fn drop(&mut self) {
        if !self.is_answered {
            self.service.change(|state| state.claims_withdrawn += 1);
        }
    }
}

#[tonic::async_trait]
impl WorkerService for Service {
    async fn register(
        &self,
        request: Request<RegisterRequest>,
    ) -> Result<Response<RegisterResponse>, Status> {
        self.record(WorkerMessage::Registered(Box::new(request.into_inner())));
        Ok(Response::new(RegisterResponse {
            protocol_version: proto::COORDINATOR_PROTOCOL_VERSION,
            program_version: "scripted".to_owned(),
            lease_secs: 30.0,
            heartbeat_secs: self.heartbeat.as_secs_f64(),
            progress_timeout_secs: self.progress_timeout.as_secs_f64(),
            idle_reason: String::new(),
        }))
    }

    async fn claim(
        &self,
        request: Request<ClaimRequest>,
    ) -> Result<Response<ClaimResponse>, Status> {
        let claim = request.into_inner();
        let wait = Duration::from_secs_f64(claim.wait_secs);
        self.change(|state| state.claims.push(claim.clone()));
        let mut waiting = WaitingClaim { service: self, is_answered: false };
        let mut changes = self.changed.subscribe();
        let leasing = async {
            loop {
                let lease = self.change_quietly(|state| {
                    let repeated = state.unanswered_leases.remove(&claim.claim_id);
                    repeated.or_else(|| state.leases.pop_front())
                });
                if let Some(lease) = lease {
                    return lease;
                }
                changes.changed().await.expect("the service holds the sender");
            }
        };
        let lease = tokio::time::timeout(wait, leasing).await.ok();
        waiting.is_answered = true;
        let is_lost = self.change_quietly(|state| {
            let is_lost = lease.is_some() && state.answers_to_lose > 0;
            state.answers_to_lose -= u32::from(is_lost);
            if is_lost && let Some(lease) = &lease {
                let leases = &mut state.unanswered_leases;
                leases.insert(claim.claim_id.clone(), lease.clone());
            }
            is_lost
        });
        match is_lost {
            true => Err(Status::unavailable("the answer was lost")),
            false => Ok(Response::new(ClaimResponse { lease, idle_reason: String::new() })),
        }
    }

    async fn heartbeat(
        &self,
        request: Request<HeartbeatRequest>,
    ) -> Result<Response<HeartbeatResponse>, Status> {
        let heartbeat = request.into_inner();
        let lost_attempts = self.change(|state| {
            state.heartbeats.push(heartbeat);
            state.lost_attempts.clone()
        });
        Ok(Response::new(HeartbeatResponse { lost_attempts }))
    }

    async fn commit(
        &self,
        request: Request<CommitRequest>,
    ) -> Result<Response<CommitResponse>, Status> {
        self.record(WorkerMessage::Committed(Box::new(request.into_inner())));
        Ok(Response::new(CommitResponse {
            verdict: self
                .change_quietly(|state| state.commit_verdict)
                .unwrap_or(commit_response::Verdict::Accepted) as i32,
            detail: String::new(),
        }))
    }

    async fn release(
        &self,
        request: Request<ReleaseRequest>,
    ) -> Result<Response<ReleaseResponse>, Status> {
        self.record(WorkerMessage::Released(Box::new(request.into_inner())));
        Ok(Response::new(ReleaseResponse {
            verdict: release_response::Verdict::Requeued as i32,
            backoff_secs: 0.0,
            stop_leasing: self.change(|state| std::mem::take(&mut state.stop_leasing)),
        }))
    }

    async fn next_film(
        &self,
        _request: Request<NextFilmRequest>,
    ) -> Result<Response<NextFilmResponse>, Status> {
        let (film, left) = self.change(|state| (state.films.pop_front(), state.films.len()));
        Ok(Response::new(NextFilmResponse { film, left: left as u64 }))
    }

    async fn sign_off(
        &self,
        request: Request<SignOffRequest>,
    ) -> Result<Response<SignOffResponse>, Status> {
        let worker = request.into_inner().worker_id;
        self.change(|state| state.signed_off.push(worker));
        Ok(Response::new(SignOffResponse {}))
    }

    async fn put_artifact(
        &self,
        request: Request<Streaming<ArtifactChunk>>,
    ) -> Result<Response<PutArtifactResponse>, Status> {
        let mut chunks = request.into_inner();
        let (mut attempt, mut bytes) = (String::new(), Vec::new());
        while let Some(chunk) = chunks.next().await {
            let chunk = chunk?;
            attempt.push_str(&chunk.attempt_id);
            bytes.extend(chunk.data);
        }
        let is_refused = self.change(|state| {
            state.refused_artifacts += u32::from(state.refuses_artifacts);
            state.refuses_artifacts
        });
        if is_refused {
            return Err(Status::internal("no space left on the device"));
        }
        self.record(WorkerMessage::Video { attempt, bytes });
        Ok(Response::new(PutArtifactResponse { path: "video.mp4".to_owned() }))
    }
}
