//! A coordinator that hands out what a test puts into it, and remembers what it
//! is told. Not the real one: that one cannot be told to lose a lease.

use std::collections::VecDeque;
use std::net::SocketAddr;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use proto::coordinator::worker_service_server::{WorkerService, WorkerServiceServer};
use proto::coordinator::{
    ArtifactChunk, ClaimRequest, ClaimResponse, CommitRequest, CommitResponse, Film,
    HeartbeatRequest, HeartbeatResponse, Lease, NextFilmRequest, NextFilmResponse, Progress,
    PutArtifactResponse, RegisterRequest, RegisterResponse, ReleaseRequest, ReleaseResponse,
    commit_response, release_request, release_response,
};
use tokio::net::TcpListener;
use tokio::runtime::Runtime;
use tokio::sync::watch;
use tokio_stream::StreamExt;
use tokio_stream::wrappers::TcpListenerStream;
use tonic::transport::Server;
use tonic::{Request, Response, Status, Streaming};

/// Longest wait for something that a test expects.
const PATIENCE: Duration = Duration::from_secs(60);

/// What a coordinator was told, in order.
#[derive(Clone, Debug)]
pub(crate) enum Told {
    Registered(Box<RegisterRequest>),
    Video { job: i64, bytes: Vec<u8> },
    Committed(Box<CommitRequest>),
    Released(Box<ReleaseRequest>),
}

impl Told {
    /// The commit that this is.
    pub(crate) fn commit(self) -> CommitRequest {
        match self {
            Self::Committed(commit) => *commit,
            other => panic!("expected a commit, got {other:?}"),
        }
    }

    /// The release that this is, for this reason.
    pub(crate) fn release(self, reason: release_request::Reason) -> ReleaseRequest {
        match self {
            Self::Released(release) if release.reason() == reason => *release,
            other => panic!("expected a release for {reason:?}, got {other:?}"),
        }
    }
}

#[derive(Debug, Default)]
struct State {
    leases: VecDeque<Lease>,
    films: VecDeque<Film>,
    lost_jobs: Vec<i64>,
    told: Vec<Told>,
    progress: Vec<Progress>,
    claims: u32,
    stop_leasing: String,
}

/// The service, on every connection the same.
#[derive(Clone, Debug)]
struct Service {
    progress_timeout: Duration,
    state: Arc<Mutex<State>>,
    changed: Arc<watch::Sender<()>>,
}

/// A running scripted coordinator.
pub(crate) struct ScriptedCoordinator {
    service: Service,
    address: SocketAddr,
    /// Of its own, so that its connections end with it.
    runtime: Option<Runtime>,
}

impl Drop for ScriptedCoordinator {
    fn drop(&mut self) {
        self.go_down();
    }
}

impl ScriptedCoordinator {
    /// One with a progress time-out that no test waits for.
    pub(crate) async fn start() -> Self {
        Self::with_progress_timeout(Duration::from_secs(600)).await
    }

    /// One with this progress time-out.
    pub(crate) async fn with_progress_timeout(progress_timeout: Duration) -> Self {
        let service = Service {
            progress_timeout,
            state: Arc::default(),
            changed: Arc::new(watch::Sender::new(())),
        };
        let listener = TcpListener::bind("127.0.0.1:0").await.expect("a port");
        let address = listener.local_addr().expect("an address");
        let runtime = Some(serve(service.clone(), listener));
        Self {
            service,
            address,
            runtime,
        }
    }

    pub(crate) fn url(&self) -> String {
        format!("http://{}", self.address)
    }

    /// Hands this out next.
    pub(crate) fn lease(&self, lease: Lease) {
        self.change(|state| state.leases.push_back(lease));
    }

    /// Has this filmed next.
    pub(crate) fn film(&self, film: Film) {
        self.change(|state| state.films.push_back(film));
    }

    /// Says from now on that this job's lease is lost.
    pub(crate) fn lose(&self, job: i64) {
        self.change(|state| state.lost_jobs.push(job));
    }

    /// Says with the next answer to a release that the worker must stop.
    pub(crate) fn stop_leasing(&self, reason: &str) {
        self.change(|state| reason.clone_into(&mut state.stop_leasing));
    }

    /// Goes away, with all connections, as if killed.
    pub(crate) fn go_down(&mut self) {
        if let Some(runtime) = self.runtime.take() {
            runtime.shutdown_background();
        }
    }

    /// Comes back at the same address.
    pub(crate) async fn come_back(&mut self) {
        // The port is free a moment after the runtime has gone.
        let listener = loop {
            match TcpListener::bind(self.address).await {
                Ok(listener) => break listener,
                Err(_) => tokio::time::sleep(Duration::from_millis(20)).await,
            }
        };
        self.runtime = Some(serve(self.service.clone(), listener));
    }

    /// Waits for the `number`-th thing to be told, registration being number 0.
    pub(crate) async fn told(&self, number: usize) -> Told {
        self.wait_for("to be told more", |state| state.told.get(number).cloned())
            .await
    }

    /// Waits until a heartbeat reports so many control steps of a job.
    pub(crate) async fn progressed(&self, job: i64, control_steps: u32) {
        self.wait_for("progress", |state| {
            let far = |it: &&Progress| it.job_id == job && it.control_steps >= control_steps;
            state.progress.iter().find(far).map(|_| ())
        })
        .await;
    }

    /// Waits until it was asked for work so many times.
    pub(crate) async fn claimed(&self, times: u32) {
        self.wait_for("claims", |state| (state.claims >= times).then_some(()))
            .await;
    }

    /// What it was told so far.
    pub(crate) fn everything_told(&self) -> Vec<Told> {
        self.service.state.lock().expect("unpoisoned").told.clone()
    }

    /// How often it was asked for work.
    pub(crate) fn claims(&self) -> u32 {
        self.service.state.lock().expect("unpoisoned").claims
    }

    fn change(&self, change: impl FnOnce(&mut State)) {
        self.service.change(change);
    }

    async fn wait_for<T>(&self, what: &str, mut seen: impl FnMut(&State) -> Option<T>) -> T {
        let mut changes = self.service.changed.subscribe();
        let waiting = async {
            loop {
                if let Some(seen) = seen(&self.service.state.lock().expect("unpoisoned")) {
                    return seen;
                }
                changes
                    .changed()
                    .await
                    .expect("the service holds the sender");
            }
        };
        match tokio::time::timeout(PATIENCE, waiting).await {
            Ok(seen) => seen,
            Err(_) => panic!(
                "waited {PATIENCE:?} for {what}; was told {:#?}",
                self.everything_told()
            ),
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

    fn tell(&self, told: Told) {
        self.change(|state| state.told.push(told));
    }
}

#[tonic::async_trait]
impl WorkerService for Service {
    async fn register(
        &self,
        request: Request<RegisterRequest>,
    ) -> Result<Response<RegisterResponse>, Status> {
        self.tell(Told::Registered(Box::new(request.into_inner())));
        Ok(Response::new(RegisterResponse {
            protocol_version: proto::COORDINATOR_PROTOCOL_VERSION,
            program_version: "scripted".to_owned(),
            lease_secs: 30.0,
            heartbeat_secs: 0.1,
            progress_timeout_secs: self.progress_timeout.as_secs_f64(),
        }))
    }

    async fn claim(
        &self,
        request: Request<ClaimRequest>,
    ) -> Result<Response<ClaimResponse>, Status> {
        let wait = Duration::from_secs_f64(request.into_inner().wait_secs);
        self.change(|state| state.claims += 1);
        let mut changes = self.changed.subscribe();
        let leasing = async {
            loop {
                let lease = self.state.lock().expect("unpoisoned").leases.pop_front();
                if let Some(lease) = lease {
                    return lease;
                }
                changes.changed().await.expect("this holds the sender");
            }
        };
        let lease = tokio::time::timeout(wait, leasing).await.ok();
        Ok(Response::new(ClaimResponse {
            leases: lease.into_iter().collect(),
            idle_reason: String::new(),
        }))
    }

    async fn heartbeat(
        &self,
        request: Request<HeartbeatRequest>,
    ) -> Result<Response<HeartbeatResponse>, Status> {
        let progress = request.into_inner().progress;
        let lost_jobs = self.change(|state| {
            state.progress = progress;
            state.lost_jobs.clone()
        });
        Ok(Response::new(HeartbeatResponse { lost_jobs }))
    }

    async fn commit(
        &self,
        request: Request<CommitRequest>,
    ) -> Result<Response<CommitResponse>, Status> {
        self.tell(Told::Committed(Box::new(request.into_inner())));
        Ok(Response::new(CommitResponse {
            verdict: commit_response::Verdict::Accepted as i32,
            detail: String::new(),
        }))
    }

    async fn release(
        &self,
        request: Request<ReleaseRequest>,
    ) -> Result<Response<ReleaseResponse>, Status> {
        self.tell(Told::Released(Box::new(request.into_inner())));
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
        Ok(Response::new(NextFilmResponse {
            film,
            left: left as u64,
        }))
    }

    async fn put_artifact(
        &self,
        request: Request<Streaming<ArtifactChunk>>,
    ) -> Result<Response<PutArtifactResponse>, Status> {
        let mut chunks = request.into_inner();
        let (mut job, mut bytes) = (0, Vec::new());
        while let Some(chunk) = chunks.next().await {
            let chunk = chunk?;
            job = chunk.lease.map_or(job, |lease| lease.job_id);
            bytes.extend(chunk.data);
        }
        self.tell(Told::Video { job, bytes });
        Ok(Response::new(PutArtifactResponse {
            path: "video.mp4".to_owned(),
        }))
    }
}
