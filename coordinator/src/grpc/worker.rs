//! The worker's gRPC service.

use std::sync::Arc;
use std::time::Duration;

use proto::coordinator::worker_service_server::WorkerService;
use proto::coordinator::{
    self as wire, ClaimRequest, ClaimResponse, CommitRequest, CommitResponse, HeartbeatRequest,
    HeartbeatResponse, NextFilmRequest, NextFilmResponse, PutArtifactResponse, RegisterRequest,
    RegisterResponse, ReleaseRequest, ReleaseResponse, SignOffRequest, SignOffResponse,
};
use queue::{Assigned, CommitVerdict, Film, Queue, ReleaseVerdict};
use tokio_stream::StreamExt;
use tonic::{Request, Response, Status, Streaming};

use super::failure::{Answer, artifact_failed, check_room, failed, invalid};
use super::operator::campaign_name;
use super::read;
use crate::gauges::Gauges;

/// Most leases that one heartbeat renews.
const MAX_PROGRESS: usize = 1_024;
/// Longest wait for the next chunk of an upload.
const MAX_CHUNK_WAIT: Duration = Duration::from_secs(30);
/// Longest task name of a claim, bytes; longer ones are ignored.
const MAX_TASK_BYTES: usize = 80;
/// Most tasks accepted in a claim's `lacking_tasks`: LIBERO's forty tasks, each with its own files
/// and those of three further benchmarks, take 160, and a suite file has up to 256 tasks.
const MAX_TASKS: usize = 1024;
/// Name of the only accepted artifact.
const VIDEO: &str = "video.mp4";

#[derive(Debug)]
pub(super) struct WorkerApi {
    pub(super) queue: Arc<Queue>,
    pub(super) gauges: Arc<Gauges>,
    pub(super) min_free_bytes: u64,
}

#[tonic::async_trait]
impl WorkerService for WorkerApi {
    async fn register(&self, request: Request<RegisterRequest>) -> Answer<RegisterResponse> {
        let request = request.into_inner();
        let program_version = env!("CARGO_PKG_VERSION");
        if request.protocol_version != proto::COORDINATOR_PROTOCOL_VERSION {
            return Err(Status::failed_precondition(format!(
                "the worker (program {}) uses protocol version {} and this coordinator \
                 (program {program_version}) version {}; run the same release on both",
                queue::ids::shortened(&request.program_version, 40),
                request.protocol_version,
                proto::COORDINATOR_PROTOCOL_VERSION,
            )));
        }
        let worker = read::worker_info(request)?;
        let idle_reason = self.queue.register(&worker).await.map_err(failed)?;
        tracing::info!(worker = %worker.id, host = worker.host, slots = worker.slots,
            assets = worker.pin.asset_pack, "worker registered");
        let timing = self.queue.timing();
        Ok(Response::new(RegisterResponse {
            protocol_version: proto::COORDINATOR_PROTOCOL_VERSION,
            program_version: program_version.to_owned(),
            lease_secs: timing.lease.as_secs_f64(),
            heartbeat_secs: timing.heartbeat.as_secs_f64(),
            progress_timeout_secs: timing.progress_timeout.as_secs_f64(),
            idle_reason,
        }))
    }

    async fn claim(&self, request: Request<ClaimRequest>) -> Answer<ClaimResponse> {
        let _counted = self.gauges.claim();
        let request = request.into_inner();
        let warm = Some(request.warm_task);
        let lacking = request.lacking_tasks.into_iter().take(MAX_TASKS);
        let claim = queue::ClaimRequest {
            worker: read::worker_id(&request.worker_id)?,
            claim: read::claim_id(request.claim_id)?,
            warm_task: warm.filter(|task| (1..=MAX_TASK_BYTES).contains(&task.len())),
            means: queue::Means {
                lacking_tasks: lacking.filter(|task| task.len() <= MAX_TASK_BYTES).collect(),
                simulators: request.simulators.into_iter().take(MAX_TASKS).collect(),
            },
        };
        let wait = read::wait(request.wait_secs);
        let claimed = self.queue.claim(&claim, wait).await.map_err(failed)?;
        Ok(Response::new(ClaimResponse {
            lease: claimed.job.map(write_lease),
            idle_reason: claimed.idle_reason,
        }))
    }

    async fn heartbeat(&self, request: Request<HeartbeatRequest>) -> Answer<HeartbeatResponse> {
        let request = request.into_inner();
        let worker = read::worker_id(&request.worker_id)?;
        if request.progress.len() > MAX_PROGRESS {
            return Err(invalid(format!("more than {MAX_PROGRESS} leases in one heartbeat")));
        }
        let progress = request.progress.iter().map(|progress| {
            let attempt = read::attempt(&progress.attempt_id)?;
            Ok((attempt, progress.control_steps))
        });
        let progress: Vec<_> = progress.collect::<Result<_, Status>>()?;
        let lost = self.queue.heartbeat(&worker, &progress).await;
        let lost = lost.map_err(failed)?;
        self.queue.note_filming(&worker, read::filming(request.filming));
        Ok(Response::new(HeartbeatResponse {
            lost_attempts: lost.iter().map(ToString::to_string).collect(),
        }))
    }

    async fn commit(&self, request: Request<CommitRequest>) -> Answer<CommitResponse> {
        use wire::commit_response::Verdict;
        let report = read::commit(request.into_inner())?;
        let reply = self.queue.commit(&report).await.map_err(failed)?;
        let verdict = match reply.verdict {
            CommitVerdict::Accepted => Verdict::Accepted,
            CommitVerdict::Duplicate => Verdict::Duplicate,
            CommitVerdict::Stale => Verdict::Stale,
            CommitVerdict::Divergent => Verdict::Divergent,
            CommitVerdict::Unpaired => Verdict::Unpaired,
        };
        Ok(Response::new(CommitResponse { verdict: verdict.into(), detail: reply.detail }))
    }

    async fn release(&self, request: Request<ReleaseRequest>) -> Answer<ReleaseResponse> {
        use wire::release_response::Verdict;
        let request = request.into_inner();
        let attempt = read::attempt(&request.attempt_id)?;
        let reason = read::failure_reason(request.reason)?;
        let error = read::error_text(&request.error);
        let answered = request.answered_queries;
        let released = self.queue.release_after(attempt, reason, &error, answered);
        let released = released.await;
        let reply = released.map_err(failed)?;
        let verdict = match reply.verdict {
            ReleaseVerdict::Requeued => Verdict::Requeued,
            ReleaseVerdict::Quarantined => Verdict::Quarantined,
            ReleaseVerdict::Stale => Verdict::Stale,
        };
        Ok(Response::new(ReleaseResponse {
            verdict: verdict.into(),
            backoff_secs: reply.backoff.as_secs_f64(),
            stop_leasing: reply.stop_leasing.unwrap_or_default(),
        }))
    }

    async fn sign_off(&self, request: Request<SignOffRequest>) -> Answer<SignOffResponse> {
        let worker = read::worker_id(&request.into_inner().worker_id)?;
        self.queue.sign_off(&worker).await.map_err(failed)?;
        tracing::info!(%worker, "worker signed off");
        Ok(Response::new(SignOffResponse {}))
    }

    async fn next_film(&self, request: Request<NextFilmRequest>) -> Answer<NextFilmResponse> {
        let request = request.into_inner();
        let only = match request.campaign.as_str() {
            "" => None,
            name => {
                let mut view = self.queue.view().await.map_err(failed)?;
                Some(view.campaign(&campaign_name(name)?).await.map_err(failed)?.name)
            }
        };
        let pin = read::film_pin(request)?;
        let next = self.queue.next_film(&pin, only.as_ref()).await.map_err(failed)?;
        let (film, left) = next.unzip();
        Ok(Response::new(NextFilmResponse { film: film.map(write_film), left: left.unwrap_or(0) }))
    }

    async fn put_artifact(
        &self,
        request: Request<Streaming<wire::ArtifactChunk>>,
    ) -> Answer<PutArtifactResponse> {
        let mut chunks = request.into_inner();
        let first = next_chunk(&mut chunks).await?;
        let first = first.ok_or_else(|| invalid("store the artifact: the upload is empty"))?;
        let attempt = read::attempt(&first.attempt_id)?;
        if first.name != VIDEO {
            return Err(invalid(format!(
                "store artifact `{}`: only `{VIDEO}` is accepted",
                queue::ids::shortened(&first.name, MAX_TASK_BYTES)
            )));
        }
        let mut upload = self.queue.upload(attempt).await.map_err(artifact_failed)?;
        let mut data = first.data;
        loop {
            check_room(self.queue.store().folder(), self.min_free_bytes, "store the film")?;
            upload.write(&data).await.map_err(artifact_failed)?;
            match next_chunk(&mut chunks).await? {
                Some(chunk) => data = chunk.data,
                None => break,
            }
        }
        let path = upload.finish().await.map_err(artifact_failed)?;
        Ok(Response::new(PutArtifactResponse { path }))
    }
}

async fn next_chunk(
    chunks: &mut Streaming<wire::ArtifactChunk>,
) -> Result<Option<wire::ArtifactChunk>, Status> {
    match tokio::time::timeout(MAX_CHUNK_WAIT, chunks.next()).await {
        Ok(chunk) => chunk.transpose(),
        Err(_) => Err(Status::deadline_exceeded(format!(
            "receive the artifact: no chunk arrived within {MAX_CHUNK_WAIT:?}"
        ))),
    }
}

fn write_film(film: Film) -> wire::Film {
    wire::Film {
        attempt_id: film.attempt.to_string(),
        campaign: film.campaign.as_str().to_owned(),
        replicate: film.replicate,
        manifest_row: film.manifest_row,
        realisation: film.realisation,
        actions: film.actions,
        success: film.success,
    }
}

fn write_lease(job: Assigned) -> wire::Lease {
    wire::Lease {
        attempt_id: job.attempt.to_string(),
        job_id: job.job.0,
        attempt: job.number.0,
        campaign: job.campaign.as_str().to_owned(),
        replicate: job.replicate,
        manifest_row: job.manifest_row,
        policy_seed: job.policy_seed,
        policy: job.policy,
        policy_endpoint: job.policy_endpoint,
        realisation: job.realisation,
        execution: job.execution,
        record_video: job.record == "all" || job.record == "failures",
        record_failures_only: job.record == "failures",
        keep_actions: job.record == "transitions",
    }
}
