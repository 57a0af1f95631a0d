//! Videos beside rollouts.

use proto::coordinator as wire;
use proto::coordinator::commit_response::Verdict;
use tonic::{Code, Status};

use crate::harness::{Bench, Worker, small_spec};

pub(crate) async fn put(
    worker: &mut Worker,
    lease: &wire::Lease,
    name: &str,
    pieces: &[Vec<u8>],
) -> Result<String, Status> {
    let mut chunks: Vec<wire::ArtifactChunk> = pieces
        .iter()
        .map(|data| wire::ArtifactChunk {
            data: data.clone(),
            ..wire::ArtifactChunk::default()
        })
        .collect();
    chunks[0].lease = Some(worker.held(lease));
    chunks[0].name = name.to_owned();
    let request = tokio_stream::iter(chunks);
    Ok(worker
        .service
        .put_artifact(request)
        .await?
        .into_inner()
        .path)
}

#[tokio::test]
async fn a_video_is_kept_for_who_holds_or_committed_the_rollout() {
    let bench = Bench::start().await;
    bench.create(&small_spec("filmed")).await.expect("created");
    let mut worker = bench.worker("a").await;
    let lease = worker.claim_one().await;
    let pieces = [vec![1; 1_000_000], vec![2; 500_000]];
    let path = put(&mut worker, &lease, "video.mp4", &pieces)
        .await
        .expect("kept");
    assert_eq!(path, "artifacts/filmed/object_t0_clean_i16.r0.mp4");
    let stored = std::fs::read(bench.folder.path().join(&path)).expect("a file");
    assert_eq!(stored, pieces.concat());

    assert_eq!(worker.commit(&lease, true).await, Verdict::Accepted);
    let again = put(&mut worker, &lease, "video.mp4", &[vec![3; 10]])
        .await
        .expect("replaced");
    assert_eq!(again, path);
    assert_eq!(
        std::fs::read(bench.folder.path().join(&path)).expect("a file"),
        [3; 10]
    );
    let recorded = "SELECT count(*) FROM artifact WHERE kind = 'video' AND size_bytes = 10";
    assert_eq!(bench.count(recorded).await, 1);
}

#[tokio::test]
async fn a_stranger_an_odd_name_and_too_much_are_refused_and_leave_nothing() {
    let bench = Bench::start().await;
    bench.create(&small_spec("filmed")).await.expect("created");
    let (mut worker, mut stranger) = (bench.worker("a").await, bench.worker("b").await);
    let lease = worker.claim_one().await;
    let small = [vec![1; 10]];

    let refused = put(&mut stranger, &lease, "video.mp4", &small).await;
    assert_eq!(
        refused.expect_err("not its own").code(),
        Code::PermissionDenied
    );
    for name in ["../../etc/passwd", "video.mp4/..", "", "notes.txt"] {
        let refused = put(&mut worker, &lease, name, &small).await;
        assert_eq!(refused.expect_err(name).code(), Code::InvalidArgument);
    }
    let pieces = vec![vec![0; 1 << 20]; 65];
    let refused = put(&mut worker, &lease, "video.mp4", &pieces).await;
    let refused = refused.expect_err("65 MiB");
    assert_eq!(refused.code(), Code::InvalidArgument);
    assert!(
        refused.message().contains("larger than 67108864 bytes"),
        "{refused}"
    );

    let folder = bench.folder.path().join("artifacts/filmed");
    assert_eq!(std::fs::read_dir(folder).expect("a folder").count(), 0);
    assert_eq!(bench.count("SELECT count(*) FROM artifact").await, 0);
}
