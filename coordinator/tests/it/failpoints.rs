//! Kills the process before and after the commit of each kind of transaction. Afterwards, every
//! invariant of the database holds, and the campaign ends with the same report.

use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use proto::coordinator as wire;
use proto::coordinator::change_campaign_request::Change;
use proto::coordinator::operator_service_client::OperatorServiceClient;
use proto::coordinator::release_request::Reason;
use queue::DATABASE_FILE;
use queue::read::{CampaignStatus, JobLine};
use queue::{FAILPOINT_VARIABLE, Side, Step};
use tempfile::TempDir;
use tokio::task::JoinSet;
use tonic::Status;

use crate::artifacts::put;
use crate::harness::{Worker, assert_sound, report_json, small_spec, value};
use crate::invariants::valid_database;
use crate::process::{Serve, coordinator, serve_command, succeed};

/// Number of processes that run, and are killed, at the same time.
const CONCURRENCY: usize = 4;
/// Duration of a lease, seconds, and number of the sweep that finds it expired.
const LEASE_SECS: u32 = 3;
const EXPIRING_SWEEP: u32 = 5;
/// Longest time until a process reaches its failpoint.
const PATIENCE: Duration = Duration::from_secs(60);

pub(crate) fn serve(folder: &Path, point: &str) -> Child {
    let mut command = serve_command(folder);
    let lease = ["--lease-secs", &LEASE_SECS.to_string()];
    command.args(lease).env(FAILPOINT_VARIABLE, point).spawn().expect("starts")
}

/// Performs every kind of write once, as long as the coordinator answers.
async fn call_everything(serve: &Serve) -> Result<(), Status> {
    let mut operator = OperatorServiceClient::connect(serve.url.clone())
        .await
        .map_err(|error| Status::unavailable(error.to_string()))?;
    let spec = small_spec("passing").to_string();
    operator.create_campaign(wire::CreateCampaignRequest { spec, priority: 0 }).await?;
    let mut worker = serve.try_worker("b").await?;
    let lease = worker.try_claim(0.0, "").await?.lease.expect("a lease");
    let beat = wire::HeartbeatRequest {
        worker_id: worker.id.clone(),
        progress: vec![wire::Progress { attempt_id: lease.attempt_id.clone(), control_steps: 5 }],
        ..wire::HeartbeatRequest::default()
    };
    worker.service.heartbeat(beat).await?;
    let release = wire::ReleaseRequest {
        attempt_id: lease.attempt_id.clone(),
        reason: Reason::SimulatorError.into(),
        error: "on purpose".to_owned(),
        ..wire::ReleaseRequest::default()
    };
    worker.service.release(release).await?;
    let lease = worker.try_claim(0.0, "").await?.lease.expect("a lease");
    let report = worker.report(&lease, true);
    worker.service.commit(report).await?;
    put(&mut worker, &lease, "video.mp4", &[vec![1; 1_000]]).await?;
    for (campaign, change) in
        [("sound", Change::Pause), ("sound", Change::Resume), ("passing", Change::Cancel)]
    {
        let request =
            wire::ChangeCampaignRequest { campaign: campaign.to_owned(), change: change.into() };
        operator.change_campaign(request).await?;
    }
    retry_all(&mut operator).await?;
    copy(&mut operator, "passing").await?;
    let request = wire::DeleteCampaignRequest {
        campaign: "passing".to_owned(),
        confirm: "passing".to_owned(),
    };
    operator.delete_campaign(request).await?;
    Ok(())
}

async fn retry_all(
    operator: &mut OperatorServiceClient<tonic::transport::Channel>,
) -> Result<(), Status> {
    let request = wire::RetryJobsRequest {
        campaign: "sound".to_owned(),
        all: true,
        ..wire::RetryJobsRequest::default()
    };
    operator.retry_jobs(request).await.map(|_| ())
}

async fn copy(
    operator: &mut OperatorServiceClient<tonic::transport::Channel>,
    campaign: &str,
) -> Result<(), Status> {
    let request = wire::ArchiveCampaignRequest { campaign: campaign.to_owned() };
    let mut archive = operator.archive_campaign(request).await?.into_inner();
    let mut chunks =
        vec![wire::ImportChunk { name: "imported".to_owned(), ..wire::ImportChunk::default() }];
    while let Some(chunk) = archive.message().await? {
        chunks.push(wire::ImportChunk { data: chunk.data, ..wire::ImportChunk::default() });
    }
    let chunks = tokio_stream::iter(chunks);
    operator.import_campaign(chunks).await.map(drop)
}

/// Finishes the campaign on a coordinator without failpoints. Returns the report.
async fn finish(folder: &Path) -> Vec<u8> {
    let serve = Serve::start(folder);
    let mut operator =
        OperatorServiceClient::connect(serve.url.clone()).await.expect("a connection");
    let resume =
        wire::ChangeCampaignRequest { campaign: "sound".to_owned(), change: Change::Resume.into() };
    operator.change_campaign(resume).await.expect("resumed");
    retry_all(&mut operator).await.expect("retried");
    // Leases that a worker with this id held before the restart belong to this worker.
    let mut worker = serve.worker("a").await;
    let began = Instant::now();
    loop {
        take_over(&mut worker, &mut operator).await;
        let request = wire::GetCampaignRequest { campaign: "sound".to_owned() };
        let status = value(operator.get_campaign(request).await);
        let status: CampaignStatus = status.expect("a status");
        if status.rollouts.committed == status.rollouts.total() {
            break;
        }
        assert!(began.elapsed() < PATIENCE, "{status:?}");
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
    report_json(&mut operator, "sound").await
}

/// Commits all jobs that can be leased, and releases those that an earlier process left leased.
async fn take_over(
    worker: &mut Worker,
    operator: &mut OperatorServiceClient<tonic::transport::Channel>,
) {
    for lease in worker.claim(64).await {
        worker.commit(&lease, true).await;
    }
    let request = wire::ListJobsRequest {
        campaign: "sound".to_owned(),
        state: "leased".to_owned(),
        limit: 64,
        ..wire::ListJobsRequest::default()
    };
    let leased: Vec<JobLine> = value(operator.list_jobs(request).await).expect("a list");
    for job in leased {
        let request = wire::ReleaseRequest {
            attempt_id: job.attempt_id.expect("a lease"),
            reason: Reason::Draining.into(),
            error: "left by an earlier process".to_owned(),
            ..wire::ReleaseRequest::default()
        };
        worker.service.release(request).await.expect("released");
    }
}

/// Returns a copy of a folder on which no coordinator runs.
fn copy_of(folder: &Path) -> TempDir {
    let copy = tempfile::tempdir().expect("a temporary folder");
    std::fs::copy(folder.join(DATABASE_FILE), copy.path().join(DATABASE_FILE)).expect("copied");
    copy
}

/// Runs a coordinator until it is killed at the failpoint, and then another that finishes the
/// campaign. Returns the report.
async fn kill_at_failpoint(folder: TempDir, side: Side, step: Step) -> Vec<u8> {
    let occurrence = if step == Step::Sweep { EXPIRING_SWEEP } else { 1 };
    let point = format!("{side:?}:{step:?}:{occurrence}");
    let child = serve(folder.path(), &point);
    let mut serve = Serve::wait_until_listening(child);
    if serve.is_ready() {
        // Fails at the call during which the process is killed.
        let _ = call_everything(&serve).await;
    }
    let began = Instant::now();
    let status = loop {
        if let Some(status) = serve.ended() {
            break status;
        }
        assert!(began.elapsed() < PATIENCE, "{point} was never reached");
        tokio::time::sleep(Duration::from_millis(20)).await;
    };
    assert!(!status.success(), "{point}: {status}");
    assert_sound(folder.path()).await;
    let report = finish(folder.path()).await;
    assert_sound(folder.path()).await;
    assert!(
        !folder.path().join("artifacts/passing").exists() || step != Step::FinishRemoval,
        "{point}: a deleted campaign's files are removed at the next start"
    );
    report
}

#[tokio::test(flavor = "multi_thread")]
async fn a_kill_around_any_transaction_keeps_the_invariants_and_the_report() {
    let folder = valid_database().await;
    let expected = finish(copy_of(folder.path()).path()).await;
    // Added rows are tested in `explain` and `thresholds`, and early stops in
    // `stops`.
    let tested_elsewhere = [Step::AppendRows, Step::Stop];
    let steps = Step::ALL.into_iter().filter(|step| !tested_elsewhere.contains(step));
    let mut points: Vec<(Side, Step)> =
        steps.flat_map(|step| [(Side::Before, step), (Side::After, step)]).collect();
    let mut processes = JoinSet::new();
    while !points.is_empty() || !processes.is_empty() {
        while let (true, Some((side, step))) = (processes.len() < CONCURRENCY, points.pop()) {
            let copy = copy_of(folder.path());
            processes.spawn(async move { (side, step, kill_at_failpoint(copy, side, step).await) });
        }
        let process = processes.join_next().await.expect("a running process");
        let (side, step, report) = process.expect("a process without failures");
        assert!(report == expected, "{side:?} {step:?}: another report");
    }
}

/// The coordinator is killed after the deletion is on the disk and before it answers.
#[tokio::test(flavor = "multi_thread")]
async fn a_deletion_that_a_kill_cut_off_is_repeated_by_its_command() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let point = format!("{:?}:{:?}:1", Side::After, Step::DeleteCampaign);
    let mut killed = Serve::wait_until_listening(serve(folder.path(), &point));
    let mut operator =
        OperatorServiceClient::connect(killed.url.clone()).await.expect("a connection");
    let spec = small_spec("passing").to_string();
    let create = wire::CreateCampaignRequest { spec, priority: 0 };
    operator.create_campaign(create).await.expect("created");
    let url = killed.url.clone();
    let deleting = std::thread::spawn(move || {
        let delete = ["campaign", "delete", "passing", "--confirm", "passing"];
        coordinator(&[&delete[..], &["--retry-secs", "60", "--connect", &url]].concat())
    });
    while killed.ended().is_none() {
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    let mut again = Command::new(env!("CARGO_BIN_EXE_coordinator"));
    again.args(["serve", "--listen", killed.url.trim_start_matches("http://"), "--data"]);
    let again = again.arg(folder.path()).stdout(Stdio::piped()).stderr(Stdio::null()).spawn();
    let _again = Serve::wait_until_listening(again.expect("starts"));
    let deleted = succeed(deleting.join().expect("it runs"));
    assert!(deleted.contains("deleted: 4 rollouts, 0 results"), "{deleted}");
}
