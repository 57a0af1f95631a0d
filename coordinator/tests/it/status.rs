//! Displayed states of workers and policies, rates of campaigns, and forecasts.

use std::time::Duration;

use proto::coordinator as wire;
use proto::coordinator::change_campaign_request::Change;
use proto::coordinator::commit_response::Verdict;
use queue::read::WorkerLine;
use serde_json::json;
use tonic::Code;

use crate::assertions::{assert_contains, assert_refused};
use crate::harness::{Bench, Worker, registration, small_spec, value, with};
use crate::process::{CREATE, Serve, coordinator, succeed, text};

async fn commit_after(worker: &mut Worker, lease: &wire::Lease, wall_secs: f64) {
    let report = worker.report_altered(lease, true, |of| of.result.wall_secs = wall_secs);
    assert_eq!(worker.commit_request(report).await.0, Verdict::Accepted);
}

/// Regression: workers that had shut down cleanly stayed "live" for a minute.
#[tokio::test]
async fn a_worker_that_signs_off_is_no_longer_live() {
    let bench = Bench::with(&small_spec("watched")).await;
    let mut worker = bench.worker("a").await;
    assert_eq!(bench.status("watched").await.live_workers, 1);
    let sign_off = wire::SignOffRequest { worker_id: "a".to_owned() };
    let signed_off_response = worker.service.sign_off(sign_off.clone()).await;
    signed_off_response.expect("an answer");
    let status = bench.status("watched").await;
    assert_eq!(status.live_workers, 0);
    assert!(status.waiting_reason.expect("a reason").contains("no worker"));
    let mut operator = bench.operator().await;
    let list = operator.list_workers(wire::ListWorkersRequest {}).await;
    let list: Vec<WorkerLine> = value(list).expect("a list");
    assert!(!list[0].is_alive && list[0].has_signed_off);

    // The worker may register again under the same id.
    let again = worker.service.register(registration("a", "primitives"));
    again.await.expect("registers");
    assert_eq!(bench.status("watched").await.live_workers, 1);
    let stranger = wire::SignOffRequest { worker_id: "b".to_owned() };
    let refused = worker.service.sign_off(stranger).await;
    assert_refused(refused, Code::NotFound, &[]);
}

#[tokio::test]
async fn a_worker_counts_as_alive_for_the_length_of_a_lease() {
    let bench = Bench::with(&small_spec("watched")).await;
    let mut worker = bench.worker("a").await;
    bench.advance(30).await;
    assert_eq!(bench.status("watched").await.live_workers, 1);
    bench.advance(1).await;
    assert_eq!(bench.status("watched").await.live_workers, 0);
    worker.heartbeat(&[], 0).await;
    assert_eq!(bench.status("watched").await.live_workers, 1);
}

/// Regression: `resume` was followed by "100.0/s ETA 16s", since rollouts from before the pause
/// were divided by the short time after it.
#[tokio::test]
async fn the_rate_excludes_rollouts_begun_before_a_pause() {
    let spec = with(small_spec("paced"), json!({"configs": [0, 1]}));
    let bench = Bench::with(&spec).await;
    let mut worker = bench.worker("a").await;
    let leases = worker.claim(2).await;
    bench.change("paced", Change::Pause).await.expect("changed");
    bench.advance(20).await;
    bench.change("paced", Change::Resume).await.expect("changed");
    bench.clock.advance(std::time::Duration::from_millis(10));
    for lease in &leases {
        commit_after(&mut worker, lease, 20.0).await;
    }
    let status = bench.status("paced").await;
    assert_eq!((status.rate_per_sec, status.remaining_secs), (None, None));

    let lease = worker.claim_one().await;
    bench.advance(20).await;
    commit_after(&mut worker, &lease, 20.0).await;
    let status = bench.status("paced").await;
    assert_eq!(status.rate_per_sec, Some(0.05));
    assert_eq!(status.remaining_secs, Some(5.0 / 0.05));
}

/// The rate of a campaign that waited for its first worker follows from its rollouts, not from the
/// wait.
#[tokio::test]
async fn the_rate_excludes_the_wait_for_the_first_worker() {
    let bench = Bench::with(&small_spec("late")).await;
    bench.advance(200).await;
    let (mut worker, lease) = bench.worker_with_lease("a").await;
    bench.advance(10).await;
    commit_after(&mut worker, &lease, 10.0).await;
    assert_eq!(bench.status("late").await.rate_per_sec, Some(0.1));
}

#[tokio::test]
async fn the_policy_of_a_deleted_campaign_is_no_longer_listed() {
    let bench = Bench::with(&small_spec("kept")).await;
    let policy = json!({"policy": {"name": "gone", "endpoint": "http://127.0.0.1:1"}});
    let deleted = with(small_spec("deleted"), policy);
    bench.create(&deleted).await.expect("created");
    let listed = async || {
        let policies = bench.queue.view().await.expect("a view").policies().await;
        let names = policies.expect("policies").into_iter().map(|policy| policy.name);
        names.collect::<Vec<_>>()
    };
    assert_eq!(listed().await, ["expert", "gone"]);
    let deletion = bench.delete("deleted", "deleted").await;
    deletion.expect("deleted");
    assert_eq!(listed().await, ["expert"]);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_dry_run_forecasts_from_the_speeds_of_connected_workers() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let dry = [&CREATE[..], &["--dry-run"]].concat();
    // Without a coordinator, everything but the forecast is printed, and the command succeeds.
    let nowhere = [&dry[..], &["--connect", "http://127.0.0.1:9"]].concat();
    let printed = &succeed(coordinator(&nowhere));
    assert!(printed.starts_with("campaign demo would have 14 rollouts\n"));
    assert_contains(printed, &["no forecast of its duration: failed to reach"]);

    // Workers must count as alive even if this machine is slow.
    let lease = ["--lease-secs", "3600"];
    let serve = Serve::start_with(folder.path(), &lease, std::process::Stdio::null());
    let forecast = || {
        let output = serve.command(&dry);
        assert!(output.status.success(), "{}", text(&output.stderr));
        // Line breaks may be anywhere.
        let words = text(&output.stdout).split_whitespace();
        words.collect::<Vec<_>>().join(" ")
    };
    assert!(forecast().contains("no worker is connected"));
    let mut worker = serve.worker("a").await;
    assert!(forecast().contains("on the 1 worker connected now no rollout was finished"));
    serve.run(&CREATE, 0, &[]);
    for wall_secs in [50.0, 70.0] {
        let lease = worker.claim_one().await;
        commit_after(&mut worker, &lease, wall_secs).await;
    }
    let _second = serve.worker("b").await;
    // 14 rollouts of a minute each on two workers with two slots each.
    let printed = forecast();
    assert!(printed.contains("about 3m30s on the 2 workers connected now (4 slots)"), "{printed}");
    assert!(printed.contains("2 recent rollouts of expert"), "{printed}");
    // Of 1.25 s, a rollout takes 0.75 s of a core and waits 0.5 s for the policy; four cores.
    assert_contains(&printed, &["more slots on their cores help up to 7"]);
}

/// The departed workers of a cluster would otherwise fill the list.
#[tokio::test(flavor = "multi_thread")]
async fn departed_workers_are_only_counted_unless_all_are_listed() {
    let bench = Bench::start().await;
    bench.worker("old").await;
    bench.clock.advance(Duration::from_secs(86_400));
    bench.worker("new").await;
    let list = |arguments: &[&str]| {
        let connection = ["--connect", bench.url.as_str()];
        succeed(coordinator(&[&["workers"], arguments, &connection].concat()))
    };
    let printed = list(&[]);
    assert!(!printed.contains("old on "), "{printed}");
    assert_contains(&printed, &["new on ", "1 departed: --all shows them"]);
    assert_contains(&list(&["--all"]), &["old on ", "new on "]);
}
