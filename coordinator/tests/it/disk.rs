//! A disk that is nearly full, and one that is: nothing is leased that could
//! not be written down, and nothing that was accepted or is under way is lost.

use std::process::Stdio;
use std::time::{Duration, Instant};

use proto::coordinator::commit_response::Verdict;
use proto::coordinator::release_request::Reason;

use crate::process::{CREATE, Serve, text};

#[tokio::test(flavor = "multi_thread")]
async fn nothing_is_leased_while_the_disk_is_nearly_full_and_the_status_says_so() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    // More than any disk has.
    let needed = ["--min-free-mib", "1099511627776"];
    let serve = Serve::start_with(folder.path(), &needed, Stdio::null());
    assert!(serve.command(&CREATE).status.success());
    let mut worker = serve.worker("a").await;
    // The first look at the disk comes with the first sweep.
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
}

#[tokio::test(flavor = "multi_thread")]
async fn a_coordinator_that_cannot_write_leases_nothing_and_goes_on_when_it_can() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let serve = Serve::start(folder.path());
    assert!(serve.command(&CREATE).status.success());
    let mut worker = serve.worker("a").await;
    let lease = worker.claim_one().await;
    serve.limit_files("0:unlimited");
    let refused = worker.try_claim(0.0, "").await.expect_err("no room");
    assert_eq!(refused.code(), tonic::Code::Unavailable);
    let refused = worker.try_commit(&lease, true).await.expect_err("no room");
    assert_eq!(refused.code(), tonic::Code::Unavailable);
    serve.limit_files("unlimited:unlimited");
    // Nothing was lost: neither the lease nor the outcome that it brings.
    assert_eq!(worker.commit(&lease, true).await, Verdict::Accepted);
    let started = Instant::now();
    while worker.claim(1).await.is_empty() {
        assert!(started.elapsed() < Duration::from_secs(20), "still held");
    }
}
