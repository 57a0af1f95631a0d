//! Client of the coordinator's worker service: retries calls with back-off while the coordinator
//! is unreachable, and logs each outage once. Callers interpret the answers.

use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use benchmark::attempt::{AttemptId, Backoff, Waits};
use proto::coordinator::worker_service_client::WorkerServiceClient;
use proto::coordinator::{
    ArtifactChunk, ClaimRequest, ClaimResponse, CommitRequest, CommitResponse, HeartbeatRequest,
    HeartbeatResponse, NextFilmRequest, NextFilmResponse, PutArtifactResponse, RegisterRequest,
    RegisterResponse, ReleaseRequest, ReleaseResponse, SignOffRequest,
};
use tokio::sync::{Notify, watch};
use tokio::time::Instant;
use tonic::{Response, Status};
use transport::{
    Access, Connection, Peer, ServerKind, Settings, may_succeed_later, parse_endpoint,
};

use super::error::SuperviseError;
use crate::grpc::with_deadline;

/// Longest time that a claim may wait at the coordinator for a job.
const CLAIM_WAIT: Duration = Duration::from_secs(5);
/// Longest wait for a connection, and for the answer to a call without a limit of its own.
const CALL_DEADLINE: Duration = Duration::from_secs(30);
/// Longest wait for the answer to a sign-off.
const SIGN_OFF_DEADLINE: Duration = Duration::from_secs(2);
/// Longest wait for a video to be stored.
const UPLOAD_DEADLINE: Duration = Duration::from_secs(60);
/// Number of tries to send a video. They take up to about a minute if each is refused at once.
const UPLOAD_TRIES: u32 = 7;
/// Bytes of a video per message.
const CHUNK_BYTES: usize = 256 << 10;
/// Largest video that is sent, bytes; far above any rollout's.
const MAX_VIDEO_BYTES: u64 = 256 << 20;

/// Command-line options and URL schemes that error messages tell the worker's user to set.
const SETTINGS: Settings =
    Settings { address: "--connect", authority: "--ca", clear: "http://", encrypted: "https://" };

/// A connection to the coordinator, shared by all calls.
#[derive(Clone, Debug)]
pub(crate) struct Link {
    grpc: WorkerServiceClient<Connection>,
    state: Arc<LinkState>,
    /// True once the worker claims no more work.
    draining: watch::Receiver<bool>,
}

#[derive(Debug)]
struct LinkState {
    url: String,
    peer: Peer,
    seed: u64,
    /// True once a call has succeeded; a later failure then cannot be a mistake in the settings.
    has_answered: AtomicBool,
    /// Start of the current outage; `None` while the coordinator answers.
    outage: Mutex<Option<Instant>>,
    outage_ended: Notify,
}

/// Failed call, with an explanation in the status.
struct Failed {
    status: Status,
    is_transient: bool,
}

impl Link {
    /// Creates a link to the coordinator at `url`. The first call opens the connection.
    pub(crate) fn new(
        url: &str,
        access: &Access,
        seed: u64,
        draining: watch::Receiver<bool>,
    ) -> Result<Self, SuperviseError> {
        let endpoint = parse_endpoint(url)?.connect_timeout(CALL_DEADLINE).tcp_nodelay(true);
        let peer = Peer::new(&endpoint, ServerKind::Coordinator, SETTINGS);
        let connection = access.connect_lazy(endpoint)?;
        Ok(Self {
            grpc: WorkerServiceClient::new(connection),
            state: Arc::new(LinkState {
                url: url.to_owned(),
                peer,
                seed,
                has_answered: AtomicBool::new(false),
                outage: Mutex::new(None),
                outage_ended: Notify::new(),
            }),
            draining,
        })
    }

    /// Registers the worker; retries until the coordinator answers.
    pub(crate) async fn register(
        &self,
        request: RegisterRequest,
    ) -> Result<RegisterResponse, Status> {
        self.retry(CALL_DEADLINE, |mut grpc| {
            let request = request.clone();
            async move { grpc.register(request).await }
        })
        .await
    }

    /// Claims one job; returns an empty answer once the worker drains. Retries repeat the same
    /// claim id, so a lost answer loses no lease. Draining drops the claim; a lease that is granted
    /// at that moment expires without a charge.
    pub(crate) async fn claim(&self, mut request: ClaimRequest) -> Result<ClaimResponse, Status> {
        request.wait_secs = CLAIM_WAIT.as_secs_f64();
        let mut draining = self.draining.clone();
        let claiming = self.retry(CLAIM_WAIT + CALL_DEADLINE, |mut grpc| {
            let request = request.clone();
            async move { grpc.claim(request).await }
        });
        tokio::select! {
            biased;
            answer = claiming => answer,
            // The sender lives as long as the supervisor.
            _ = draining.wait_for(|draining| *draining) => Ok(ClaimResponse::default()),
        }
    }

    /// Renews leases. Not retried, because the next heartbeat follows soon.
    pub(crate) async fn heartbeat(
        &self,
        request: HeartbeatRequest,
        deadline: Duration,
    ) -> Result<HeartbeatResponse, Status> {
        let mut grpc = self.grpc.clone();
        let answer = with_deadline(deadline, grpc.heartbeat(request)).await;
        self.record_outcome(answer).await.map_err(|failed| failed.status)
    }

    /// Reports a result; retries until the coordinator answers.
    pub(crate) async fn commit(&self, request: CommitRequest) -> Result<CommitResponse, Status> {
        self.retry(CALL_DEADLINE, |mut grpc| {
            let request = request.clone();
            async move { grpc.commit(request).await }
        })
        .await
    }

    /// Gives a job back; retries until the coordinator answers.
    pub(crate) async fn release(&self, request: ReleaseRequest) -> Result<ReleaseResponse, Status> {
        self.retry(CALL_DEADLINE, |mut grpc| {
            let request = request.clone();
            async move { grpc.release(request).await }
        })
        .await
    }

    /// Signs the worker off. Not retried, because nothing depends on it.
    pub(crate) async fn sign_off(&self, request: SignOffRequest) -> Result<(), Status> {
        let mut grpc = self.grpc.clone();
        let answer = with_deadline(SIGN_OFF_DEADLINE, grpc.sign_off(request)).await;
        answer.map(drop)
    }

    /// Requests a rollout to film; retries until the coordinator answers.
    pub(crate) async fn next_film(
        &self,
        request: NextFilmRequest,
    ) -> Result<NextFilmResponse, Status> {
        self.retry(CALL_DEADLINE, |mut grpc| {
            let request = request.clone();
            async move { grpc.next_film(request).await }
        })
        .await
    }

    /// Sends a video, in at most `UPLOAD_TRIES` tries. A coordinator that cannot store videos
    /// does not count as an outage, because it may answer all other calls.
    pub(crate) async fn put_video(
        &self,
        attempt: AttemptId,
        file: &Path,
    ) -> Result<PutArtifactResponse, Status> {
        let chunks = chunks_of(attempt, file)
            .await
            .map_err(|error| Status::aborted(format!("read {}: {error}", file.display())))?;
        let mut backoff = Backoff::new(Waits::USUAL, self.state.seed);
        loop {
            let chunks = tokio_stream::iter(chunks.clone());
            let mut grpc = self.grpc.clone();
            let answer = with_deadline(UPLOAD_DEADLINE, grpc.put_artifact(chunks)).await;
            let wait = backoff.next_wait();
            match answer {
                Err(status) if may_succeed_later(&status) && backoff.failures() < UPLOAD_TRIES => {
                    tokio::time::sleep(wait).await;
                }
                Err(status) => return Err(self.explain(status).status),
                Ok(stored) => return Ok(stored),
            }
        }
    }

    /// Repeats a call until the coordinator answers or refuses permanently.
    async fn retry<T, F>(
        &self,
        deadline: Duration,
        call: impl Fn(WorkerServiceClient<Connection>) -> F,
    ) -> Result<T, Status>
    where
        F: Future<Output = Result<Response<T>, Status>>,
    {
        let mut backoff = Backoff::new(Waits::USUAL, self.state.seed);
        loop {
            let answer = with_deadline(deadline, call(self.grpc.clone())).await;
            match self.record_outcome(answer).await {
                Err(failed) if failed.is_transient => tokio::select! {
                    () = tokio::time::sleep(backoff.next_wait()) => {}
                    () = self.state.outage_ended.notified() => {}
                },
                answered => return answered.map_err(|failed| failed.status),
            }
        }
    }

    async fn record_outcome<T>(&self, answer: Result<T, Status>) -> Result<T, Failed> {
        let answer = match answer {
            Ok(answer) => {
                self.state.has_answered.store(true, Ordering::Relaxed);
                Ok(answer)
            }
            // The start of the outage was diagnosed and logged already.
            Err(status) if self.lock_outage().is_some() && self.has_answered() => {
                let is_transient = may_succeed_later(&status);
                Err(Failed { status, is_transient })
            }
            Err(status) => Err(self.explain(status)),
        };
        self.log_outage(&answer);
        answer
    }

    /// Explains a failure by a diagnosis of the peer. Until a call has succeeded, a mistake in the
    /// settings is not transient.
    fn explain(&self, status: Status) -> Failed {
        let is_transient = may_succeed_later(&status);
        match self.state.peer.diagnose(&status) {
            None => Failed { status, is_transient },
            Some(diagnosis) => Failed {
                status: Status::new(status.code(), diagnosis.to_string()),
                is_transient: is_transient && (self.has_answered() || !diagnosis.fault.is_final()),
            },
        }
    }

    fn has_answered(&self) -> bool {
        self.state.has_answered.load(Ordering::Relaxed)
    }

    fn log_outage<T>(&self, answer: &Result<T, Failed>) {
        let url = &self.state.url;
        let mut outage = self.lock_outage();
        match (answer, *outage) {
            (Err(failed), None) if failed.is_transient => {
                *outage = Some(Instant::now());
                tracing::warn!(
                    "coordinator {url} cannot be reached: {}; trying again every {} to {} s, \
                     rollouts in flight continue",
                    transport::status_text(&failed.status),
                    Waits::USUAL.first.as_secs(),
                    Waits::USUAL.longest.as_secs()
                );
            }
            (Err(failed), Some(_)) if failed.is_transient => {}
            // The returned error describes the failure and ends the program.
            (Err(_), Some(_)) if !self.has_answered() => {}
            (_, Some(since)) => {
                *outage = None;
                let secs = since.elapsed().as_secs_f64();
                tracing::info!("coordinator {url} answers again after {secs:.0} s");
                self.state.outage_ended.notify_waiters();
            }
            (_, None) => {}
        }
    }

    /// Returns true during an outage: since a call failed transiently, none has been answered.
    pub(crate) fn is_down(&self) -> bool {
        self.lock_outage().is_some()
    }

    fn lock_outage(&self) -> std::sync::MutexGuard<'_, Option<Instant>> {
        // Ignores poisoning: no code panics while it holds the lock.
        let outage = self.state.outage.lock();
        outage.unwrap_or_else(PoisonError::into_inner)
    }
}

async fn chunks_of(attempt: AttemptId, file: &Path) -> std::io::Result<Vec<ArtifactChunk>> {
    let size = tokio::fs::metadata(file).await?.len();
    if size > MAX_VIDEO_BYTES {
        let text = format!("{size} bytes exceed the limit of {MAX_VIDEO_BYTES} bytes");
        return Err(std::io::Error::other(text));
    }
    let bytes = tokio::fs::read(file).await?;
    let mut chunks: Vec<ArtifactChunk> = bytes
        .chunks(CHUNK_BYTES)
        .map(|data| ArtifactChunk { data: data.to_vec(), ..ArtifactChunk::default() })
        .collect();
    if let Some(first) = chunks.first_mut() {
        first.attempt_id = attempt.to_string();
        first.name = "video.mp4".to_owned();
    }
    Ok(chunks)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn only_the_first_chunk_of_a_video_names_its_attempt() {
        let file = tempfile::NamedTempFile::new().expect("a file");
        std::fs::write(file.path(), vec![7; CHUNK_BYTES + 1]).expect("written");
        let chunks = chunks_of(AttemptId::from_random([7; 16]), file.path()).await.expect("read");
        let sizes: Vec<usize> = chunks.iter().map(|chunk| chunk.data.len()).collect();
        assert_eq!(sizes, [CHUNK_BYTES, 1]);
        assert_eq!(chunks[0].name, "video.mp4");
        assert_eq!(chunks[0].attempt_id, "07".repeat(16));
        assert!(chunks[1].attempt_id.is_empty() && chunks[1].name.is_empty());
    }
}
