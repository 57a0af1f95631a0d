//! Upload and storage of the videos of committed and failed attempts.

use std::time::Duration;

use proto::coordinator as wire;
use proto::coordinator::commit_response::Verdict;
use proto::coordinator::release_request::Reason;
use tokio_stream::wrappers::ReceiverStream;
use tonic::{Code, Status};

use crate::assertions::assert_refused;
use crate::harness::{Bench, Worker, small_spec};

/// Uploads a file for the attempt of `lease`, one chunk per piece; returns the path of the stored
/// file.
pub(crate) async fn put(
    worker: &mut Worker,
    lease: &wire::Lease,
    name: &str,
    pieces: &[Vec<u8>],
) -> Result<String, Status> {
    let mut chunks: Vec<wire::ArtifactChunk> = pieces
        .iter()
        .map(|data| wire::ArtifactChunk { data: data.clone(), ..wire::ArtifactChunk::default() })
        .collect();
    chunks[0].attempt_id = lease.attempt_id.clone();
    chunks[0].name = name.to_owned();
    let request = tokio_stream::iter(chunks);
    Ok(worker.service.put_artifact(request).await?.into_inner().path)
}

async fn committed() -> (Bench, Worker, wire::Lease) {
    let bench = Bench::with(&small_spec("filmed")).await;
    let (mut worker, lease) = bench.worker_with_lease("a").await;
    assert_eq!(worker.commit(&lease, true).await, Verdict::Accepted);
    (bench, worker, lease)
}

#[tokio::test]
async fn a_video_is_stored_with_the_outcome_of_its_attempt() {
    let bench = Bench::with(&small_spec("filmed")).await;
    let (mut worker, lease) = bench.worker_with_lease("a").await;
    let pieces = [vec![1; 1_000_000], vec![2; 500_000]];
    assert_refused(
        put(&mut worker, &lease, "video.mp4", &pieces).await,
        Code::PermissionDenied,
        &[],
    );

    assert_eq!(worker.commit(&lease, true).await, Verdict::Accepted);
    let path = put(&mut worker, &lease, "video.mp4", &pieces).await.expect("stored");
    let attempt = &lease.attempt_id;
    let expected = format!("artifacts/filmed/object_t0_nominal_i16.r0.{attempt}.mp4");
    assert_eq!(path, expected);
    let stored = std::fs::read(bench.folder.path().join(&path)).expect("a file");
    assert_eq!(stored, pieces.concat());
    let second_path =
        put(&mut worker, &lease, "video.mp4", &[vec![3; 10]]).await.expect("replaced");
    assert_eq!(second_path, path);
    assert_eq!(std::fs::read(bench.folder.path().join(&path)).expect("a file"), [3; 10]);
    let recorded = "SELECT count(*) FROM artifact WHERE kind = 'video' AND size_bytes = 10";
    assert_eq!(bench.count(recorded).await, 1);
}

#[tokio::test]
async fn films_leave_the_space_that_results_need() {
    let (bench, _, lease) = committed().await;
    let clock = bench.clock.clone();
    // No disk has this much free space.
    let bench = Bench::start_with(bench.stop().await, clock, u64::MAX).await;
    let film = put(&mut bench.worker("a").await, &lease, "video.mp4", &[vec![1]]).await;
    assert_refused(film, Code::ResourceExhausted, &["make room"]);
}

/// Regression: a failed attempt's film was shown beside the next attempt's outcome.
#[tokio::test]
async fn the_film_of_a_failed_attempt_is_never_shown_with_another_attempts_outcome() {
    let bench = Bench::with(&small_spec("filmed")).await;
    let mut worker = bench.worker("a").await;
    let failed = worker.claim_one().await;
    worker.release(&failed, Reason::Draining).await;
    let second = worker.claim_one().await;
    assert_eq!(second.job_id, failed.job_id);
    assert_eq!(worker.commit(&second, true).await, Verdict::Accepted);
    assert_refused(
        put(&mut worker, &failed, "video.mp4", &[vec![1; 10]]).await,
        Code::PermissionDenied,
        &[],
    );
    assert_eq!(bench.count("SELECT count(*) FROM artifact").await, 0);
}

/// Regression: two uploads under one lease shared a partial file, so that a published
/// video was overwritten.
#[tokio::test]
async fn concurrent_uploads_of_one_attempt_leave_one_complete_video() {
    let (bench, mut worker, lease) = committed().await;
    let attempt_id = lease.attempt_id.clone();
    let chunk = move |byte: u8| wire::ArtifactChunk {
        attempt_id: attempt_id.clone(),
        name: "video.mp4".to_owned(),
        data: vec![byte; 1_000],
    };
    let (sender, receiver) = tokio::sync::mpsc::channel(1);
    let mut slow = worker.clone();
    let slow = slow.service.put_artifact(ReceiverStream::new(receiver));
    let quick = async move {
        sender.send(chunk(1)).await.expect("received");
        let path = put(&mut worker, &lease, "video.mp4", &[vec![2; 500]]).await;
        let file = bench.folder.path().join(path.expect("stored"));
        assert_eq!(std::fs::read(&file).expect("a file"), [2; 500]);
        // The second chunk of the slow upload does not change the published file.
        sender.send(chunk(1)).await.expect("received");
        tokio::time::sleep(Duration::from_millis(200)).await;
        assert_eq!(std::fs::read(&file).expect("a file"), [2; 500]);
        (bench, file)
    };
    let (slow, (_bench, file)) = tokio::join!(slow, quick);
    slow.expect("stored");
    assert_eq!(std::fs::read(&file).expect("a file"), [1; 2_000]);
}

#[tokio::test]
async fn uploads_with_unknown_attempt_invalid_name_or_excess_size_are_refused() {
    let (bench, mut worker, lease) = committed().await;
    let small = [vec![1; 10]];

    let unknown = wire::Lease { attempt_id: "0".repeat(32), ..lease.clone() };
    let refused = put(&mut worker, &unknown, "video.mp4", &small).await;
    assert_refused(refused, Code::PermissionDenied, &[]);
    for name in ["../../etc/passwd", "video.mp4/..", "", "notes.txt"] {
        let refused = put(&mut worker, &lease, name, &small).await;
        assert_eq!(refused.expect_err(name).code(), Code::InvalidArgument);
    }
    let pieces = vec![vec![0; 1 << 20]; 65];
    assert_refused(
        put(&mut worker, &lease, "video.mp4", &pieces).await,
        Code::InvalidArgument,
        &["larger than 67108864 bytes"],
    );

    let folder = bench.folder.path().join("artifacts/filmed");
    assert_eq!(std::fs::read_dir(folder).expect("a folder").count(), 0);
    assert_eq!(bench.count("SELECT count(*) FROM artifact").await, 0);
}
