//! Nearly full and full disks: no job is leased whose result could not be stored, and neither
//! accepted results nor attempts in progress are lost. A limit of the coordinator's file sizes
//! (soft:hard, bytes) stands in for a full disk: its writes fail.

use std::fs::File;
use std::process::Stdio;
use std::time::{Duration, Instant};

use proto::coordinator::commit_response::Verdict;
use proto::coordinator::release_request::Reason;

use crate::artifacts::put;
use crate::assertions::assert_refused;
use crate::process::{CREATE, NAME, Serve, coordinator, succeed, text};

#[tokio::test(flavor = "multi_thread")]
async fn nothing_is_leased_while_the_disk_is_nearly_full_and_the_status_says_so() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    // Requires more free space than any disk has.
    let needed = ["--min-free-mib", "1099511627776"];
    let serve = Serve::start_with(folder.path(), &needed, Stdio::null());
    serve.run(&CREATE, 0, &[]);
    let mut worker = serve.worker("a").await;
    // The disk is first measured by the first sweep.
    let started = Instant::now();
    loop {
        let claim = worker.try_claim(1.0, "").await.expect("an answer");
        if claim.idle_reason.contains("MiB left") {
            assert!(claim.lease.is_none());
            break;
        }
        if let Some(lease) = &claim.lease {
            worker.release(lease, Reason::Draining).await;
        }
        assert!(started.elapsed() < Duration::from_secs(20), "{claim:?}");
    }
    let status = serve.command(&["campaign", "status", "demo"]);
    let status = text(&status.stdout);
    assert!(status.contains("--min-free-mib"), "{status}");
    // A campaign whose rows take much of the remaining space is not added.
    let mut large = CREATE.to_vec();
    large[NAME] = "large";
    large.extend(["--replicates", "100"]);
    serve.run(&large, 1, &["add the campaign's rollouts", "which results need", "make room"]);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_coordinator_that_cannot_write_suspends_leasing_until_it_can() {
    let (_folder, serve) = Serve::with_demo();
    let mut worker = serve.worker("a").await;
    let lease = worker.claim_one().await;
    serve.limit_files("0:unlimited");
    assert_refused(worker.try_claim(0.0, "").await, tonic::Code::Unavailable, &[]);
    assert_refused(worker.try_commit(&lease, true).await, tonic::Code::Unavailable, &[]);
    serve.limit_files("unlimited:unlimited");
    // Nothing was lost: neither the lease nor its outcome.
    assert_eq!(worker.commit(&lease, true).await, Verdict::Accepted);
    let started = Instant::now();
    while worker.claim(1).await.is_empty() {
        assert!(started.elapsed() < Duration::from_secs(20), "leasing is still suspended");
    }
}

/// Regression: SQLite wrote to the removed file, so that `create` printed "created" and all rows
/// were lost.
#[tokio::test(flavor = "multi_thread")]
async fn a_removed_data_folder_refuses_writes_and_can_be_backed_up() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let data = folder.path().join("data");
    let serve = Serve::start(&data);
    serve.run(&CREATE, 0, &[]);
    let mut worker = serve.worker("a").await;
    let leases = worker.claim(2).await;
    assert_eq!(worker.commit(&leases[0], true).await, Verdict::Accepted);
    std::fs::remove_dir_all(&data).expect("removed");

    let mut create = CREATE;
    create[NAME] = "other";
    serve.run(&create, 1, &["is gone"]);
    let refused = worker.try_commit(&leases[1], true).await;
    assert_refused(refused, tonic::Code::Internal, &[]);

    let copy = folder.path().join("saved.sqlite");
    let copy = copy.to_str().expect("UTF-8");
    succeed(serve.command(&["backup", "--output", copy]));
    succeed(coordinator(&["check", copy]));

    // Another coordinator makes a database at the same path, to which the first one must not write.
    drop(Serve::start(&data));
    let refused = serve.command(&create);
    assert_eq!(refused.status.code(), Some(1), "{refused:?}");
}

/// The log is on the disk of the database. While the disk is full, log lines are lost.
#[tokio::test(flavor = "multi_thread")]
async fn a_log_on_a_full_disk_does_not_end_the_coordinator() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let log = File::create(folder.path().join("log")).expect("a file");
    let arguments = ["--min-free-mib", "0"];
    let mut serve = Serve::start_with(&folder.path().join("data"), &arguments, log.into());
    serve.run(&CREATE, 0, &[]);
    serve.limit_files("0:unlimited");
    // Each registration is a line in the log.
    for worker in ["a", "b"] {
        let refused = serve.try_worker(worker).await.err().expect("no room");
        assert_eq!(refused.code(), tonic::Code::Unavailable);
    }
    serve.limit_files("unlimited:unlimited");
    assert!(serve.ended().is_none(), "the coordinator ended");
    serve.worker("a").await.claim_one().await;
}

/// Regression: videos were sent before outcomes, so that an artifacts folder on a full disk held
/// outcomes back forever; and the error of a video's last write was ignored, so that a truncated
/// video counted as complete.
#[tokio::test(flavor = "multi_thread")]
async fn a_full_artifacts_disk_loses_the_video_but_not_the_outcome() {
    /// Limit on the size of each file, bytes.
    const ROOM: usize = 2_000_000;
    let (folder, serve) = Serve::with_demo();
    let mut worker = serve.worker("a").await;
    let lease = worker.claim_one().await;
    // The database is smaller than this limit; the videos are not.
    serve.limit_files(&format!("{ROOM}:unlimited"));
    assert_eq!(worker.commit(&lease, true).await, Verdict::Accepted);
    let artifacts = folder.path().join("artifacts/demo");
    let last_write_fails = [vec![1; ROOM / 2], vec![2; ROOM / 2], vec![3; 1]];
    let second_write_fails = [vec![1; ROOM / 2], vec![2; ROOM], vec![3; ROOM]];
    for pieces in [last_write_fails, second_write_fails] {
        assert_refused(
            put(&mut worker, &lease, "video.mp4", &pieces).await,
            tonic::Code::Unavailable,
            &["room on the disk"],
        );
        let file_count = std::fs::read_dir(&artifacts).expect("a folder").count();
        assert_eq!(file_count, 0, "a part of the video is left");
    }
    // Leasing continues, and the video can be uploaded when there is room again.
    let next = worker.claim_one().await;
    assert_eq!(worker.commit(&next, true).await, Verdict::Accepted);
    serve.limit_files("unlimited:unlimited");
    let pieces = [vec![1; ROOM / 2], vec![2; ROOM / 2], vec![3; 1]];
    let path = put(&mut worker, &lease, "video.mp4", &pieces).await;
    let stored = folder.path().join(path.expect("stored"));
    let size = std::fs::metadata(stored).expect("a file").len();
    assert_eq!(size, ROOM as u64 + 1);
}
