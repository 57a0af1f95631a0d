//! Pausing, cancelling, deleting and backing up campaigns, and listing jobs and workers for
//! operators.

use proto::coordinator as wire;
use proto::coordinator::change_campaign_request::Change;
use proto::coordinator::commit_response::Verdict;
use proto::coordinator::release_request::Reason;
use proto::coordinator::release_response::Verdict as Released;
use queue::clock::Clock as _;
use queue::read::{JobDetails, JobLine, Stage, WorkerLine};
use serde_json::json;
use tonic::{Code, Status};

use crate::artifacts::put;
use crate::assertions::assert_refused;
use crate::harness::{Bench, Worker, small_spec, value, with};
use crate::process::{CREATE, Serve, coordinator, succeed, text};

async fn retry(bench: &Bench, campaign: &str, jobs: &[&str], all: bool) -> Result<u64, Status> {
    let name = |id: &&str| wire::JobName { rollout_id: (*id).to_owned(), replicate: 0 };
    let request = wire::RetryJobsRequest {
        campaign: campaign.to_owned(),
        jobs: jobs.iter().map(name).collect(),
        all,
    };
    value(bench.operator().await.retry_jobs(request).await)
}

/// Creates a campaign of one rollout, which fails on its only worker until it is quarantined.
async fn quarantined(bench: &Bench) -> Worker {
    let changes = json!({"axes": ["camera"], "nominal": "none"});
    let spec = with(small_spec("one"), changes);
    bench.create(&spec).await.expect("created");
    let mut worker = bench.worker("a").await;
    for expected in [Released::Requeued, Released::Requeued, Released::Quarantined] {
        let lease = worker.claim_one().await;
        let released = worker.release(&lease, Reason::SlotCrashed).await;
        assert_eq!(released.verdict(), expected);
        bench.advance(61).await;
    }
    worker
}

/// Id of the only rollout that [`quarantined`] creates.
const CAMERA: &str = "object/t0/camera/L1/c00";

#[tokio::test]
async fn a_paused_campaign_leases_nothing_and_accepts_running_attempts() {
    let bench = Bench::with(&small_spec("held")).await;
    bench.create(&small_spec("other")).await.expect("created");
    let (mut worker, lease) = bench.worker_with_lease("a").await;
    assert_eq!(lease.campaign, "held");
    let paused = bench.change("held", Change::Pause).await;
    assert_eq!(paused.expect("paused"), "paused");

    assert_eq!(worker.claim_one().await.campaign, "other");
    assert!(worker.heartbeat(&[&lease], 9).await.is_empty());
    assert_eq!(worker.commit(&lease, true).await, Verdict::Accepted);
    let status = bench.status("held").await;
    assert_eq!((status.rollouts.committed, status.rollouts.queued), (1, 3));
    assert_eq!((status.state, status.remaining_secs), (Stage::Paused, None));
    worker.claim(64).await;
    let idle = worker.claim_response("").await.idle_reason;
    assert!(idle.contains("`held` is paused"), "{idle}");

    let resumed = bench.change("held", Change::Resume).await;
    assert_eq!(resumed.expect("resumed"), "running");
    assert_eq!(worker.claim(64).await.len(), 3);
    bench.assert_sound().await;
}

#[tokio::test]
async fn cancelling_a_campaign_revokes_leases_and_keeps_results() {
    let bench = Bench::with(&small_spec("ended")).await;
    let mut worker = bench.worker("a").await;
    let (first, second) = (worker.claim_one().await, worker.claim_one().await);
    assert_eq!(worker.commit(&first, true).await, Verdict::Accepted);
    let cancelled = bench.change("ended", Change::Cancel).await;
    assert_eq!(cancelled.expect("cancelled"), "cancelled");

    let lost_leases = worker.heartbeat(&[&second], 9).await;
    assert_eq!(lost_leases, std::slice::from_ref(&second.attempt_id));
    assert_eq!(worker.commit(&second, true).await, Verdict::Stale);
    assert_eq!(worker.commit(&first, true).await, Verdict::Duplicate);
    assert!(worker.claim(4).await.is_empty());
    let status = bench.status("ended").await;
    assert_eq!(
        (status.rollouts.committed, status.rollouts.leased, status.rollouts.queued),
        (1, 0, 3)
    );
    assert_eq!(bench.count("SELECT sum(charged_attempts) FROM job").await, 0);
    assert_eq!(bench.count("SELECT charged_in_a_row FROM worker").await, 0);
    for change in [Change::Pause, Change::Resume] {
        assert_refused(bench.change("ended", change).await, Code::FailedPrecondition, &["final"]);
    }
    bench.change("ended", Change::Cancel).await.expect("cancelled again");
    bench.assert_sound().await;
}

#[tokio::test]
async fn cancelling_a_campaign_frees_the_policy_probe() {
    let bench = Bench::start().await;
    let first = small_spec("first");
    let first = bench.create_with_priority(&first, 1).await;
    first.expect("created");
    bench.create(&small_spec("second")).await.expect("created");
    let (mut worker, lease) = bench.worker_with_lease("a").await;
    worker.release(&lease, Reason::PolicyUnavailable).await;
    bench.advance(61).await;
    let probe = worker.claim_one().await;
    assert!(worker.claim(4).await.is_empty(), "one probe at a time");
    assert_eq!(probe.campaign, "first");
    bench.change("first", Change::Cancel).await.expect("cancelled");
    bench.assert_sound().await;
    assert_eq!(worker.claim_one().await.campaign, "second");
}

#[tokio::test]
async fn deleting_a_campaign_needs_its_name_twice_and_removes_its_files() {
    let bench = Bench::start().await;
    let old = bench.create_with_priority(&small_spec("old"), 1).await;
    old.expect("created");
    bench.create(&small_spec("kept")).await.expect("created");
    let mut worker = bench.worker("a").await;
    let (lease, held) = (worker.claim_one().await, worker.claim_one().await);
    assert_eq!(worker.commit(&lease, true).await, Verdict::Accepted);
    let video = put(&mut worker, &lease, "video.mp4", &[vec![1; 100]]).await.expect("stored");
    let video = bench.folder.path().join(video);
    assert!(video.is_file());

    assert_refused(bench.delete("old", "odl").await, Code::InvalidArgument, &[]);
    assert_refused(
        bench.delete("old", "old").await,
        Code::FailedPrecondition,
        &["1 of its rollouts"],
    );
    worker.release(&held, Reason::Draining).await;

    assert_eq!(bench.delete("old", "old").await.expect("deleted"), 1);
    assert!(!video.exists());
    for (query, left) in [
        ("SELECT count(*) FROM campaign", 1),
        ("SELECT count(*) FROM job", 4),
        ("SELECT count(*) FROM result", 0),
        ("SELECT count(*) FROM removal", 0),
    ] {
        assert_eq!(bench.count(query).await, left, "{query}");
    }
    bench.assert_sound().await;
    assert_refused(bench.delete("old", "old").await, Code::NotFound, &[]);
    assert_eq!(worker.claim(64).await.len(), 4);
}

#[tokio::test]
async fn retry_requeues_quarantined_jobs_without_their_charges() {
    let bench = Bench::start().await;
    let mut worker = quarantined(&bench).await;
    let unknown = retry(&bench, "one", &[CAMERA, "object/t0/camera/L1/c09"], false).await;
    assert_refused(unknown, Code::NotFound, &[]);
    assert_eq!(bench.status("one").await.rollouts.quarantined, 1, "neither or both are requeued");
    assert_eq!(
        retry(&bench, "one", &[CAMERA, CAMERA], false).await.expect("requeued"),
        1,
        "a job that is named twice counts once"
    );
    assert_refused(
        retry(&bench, "one", &[CAMERA], false).await,
        Code::FailedPrecondition,
        &["queued"],
    );
    assert_eq!(retry(&bench, "one", &[], true).await.expect("none left"), 0);

    for expected in [Released::Requeued, Released::Requeued] {
        let lease = worker.claim_one().await;
        let released = worker.release(&lease, Reason::Draining).await;
        assert_eq!(released.verdict(), expected);
        bench.assert_sound().await;
    }
    let mut fresh = bench.worker("b").await;
    let lease = fresh.claim_one().await;
    assert_eq!(lease.attempt, 6, "the attempt number keeps rising");
    // The three charges from before the retry no longer count: a crash requeues the job.
    let released = fresh.release(&lease, Reason::SlotCrashed).await;
    assert_eq!(released.verdict(), Released::Requeued);
    bench.advance(61).await;
    let lease = fresh.claim_one().await;
    assert_eq!(fresh.commit(&lease, true).await, Verdict::Accepted);
    bench.assert_sound().await;
}

#[tokio::test]
async fn a_job_is_shown_with_all_its_attempts() {
    let bench = Bench::start().await;
    let mut worker = quarantined(&bench).await;
    retry(&bench, "one", &[], true).await.expect("requeued");
    let lease = worker.claim_one().await;
    worker.heartbeat(&[&lease], 42).await;
    let job = || wire::GetJobRequest {
        campaign: "one".to_owned(),
        job: Some(wire::JobName { rollout_id: CAMERA.to_owned(), replicate: 0 }),
    };
    let shown: JobDetails = value(bench.operator().await.get_job(job()).await).expect("shown");
    let line = shown.job;
    assert_eq!(
        (line.state.as_str(), line.attempts, line.control_steps),
        ("leased", 4, Some(32)),
        "the policy's steps, without the ten in which the scene settles"
    );
    let worker_id = line.worker_id.expect("a worker").0;
    assert_eq!((worker_id.as_str(), line.lease_left_secs), ("a", Some(30.0)));
    let attempts: Vec<u32> = shown.failures.iter().map(|failure| failure.attempt.0).collect();
    assert_eq!(attempts, [3, 2, 1]);
    assert_eq!(shown.failures[0].reason, "slot_crashed");
    assert!(shown.failures.iter().all(|failure| failure.is_charged));

    assert_eq!(worker.commit(&lease, false).await, Verdict::Accepted);
    let shown: JobDetails = value(bench.operator().await.get_job(job()).await).expect("shown");
    assert_eq!(shown.job.outcome.as_deref(), Some("failure"));
    assert_eq!(shown.result.expect("an origin").worker_id.0, "a");
}

#[tokio::test]
async fn jobs_are_listed_page_by_page_and_by_state() {
    let bench = Bench::with(&small_spec("paged")).await;
    bench.worker("a").await.claim_one().await;
    let mut operator = bench.operator().await;
    let mut list = async |state: &str, after: i64, limit: u32| -> Vec<JobLine> {
        let request = wire::ListJobsRequest {
            campaign: "paged".to_owned(),
            state: state.to_owned(),
            after_job_id: after,
            limit,
            ..wire::ListJobsRequest::default()
        };
        value(operator.list_jobs(request).await).expect("a page")
    };
    let first = list("", 0, 3).await;
    assert_eq!(first.len(), 3);
    assert_eq!(list("", first[2].job_id.0, 3).await.len(), 1);
    assert_eq!(list("queued", 0, 64).await.len(), 3);
    assert_eq!(list("leased", 0, 64).await[0].rollout_id, "object/t0/nominal/i16");
    let request = wire::ListJobsRequest {
        campaign: "paged".to_owned(),
        state: "lost".to_owned(),
        ..wire::ListJobsRequest::default()
    };
    assert_refused(operator.list_jobs(request).await, Code::InvalidArgument, &[]);
}

#[tokio::test]
async fn workers_are_listed_with_their_leases_and_stop_reasons() {
    let spec = with(small_spec("many"), json!({"configs": [0, 1]}));
    let bench = Bench::with(&spec).await;
    bench.worker("gone").await;
    bench.advance(100).await;
    let mut broken = bench.worker("broken").await;
    let mut sound = bench.worker("sound").await;
    sound.claim(2).await;
    sound.report_filming(3).await;
    for lease in broken.claim(5).await {
        broken.release(&lease, Reason::SlotCrashed).await;
    }
    let request = wire::ListWorkersRequest {};
    let list = bench.operator().await.list_workers(request).await;
    let list: Vec<WorkerLine> = value(list).expect("a list");
    let worker = |id: &str| list.iter().find(|worker| worker.worker_id.0 == id).expect("listed");
    let silence = bench.clock.now().since(worker("gone").last_call_at);
    assert_eq!((worker("gone").is_alive, silence.as_secs()), (false, 100));
    assert_eq!((worker("sound").is_alive, worker("sound").leases), (true, 2));
    assert_eq!((worker("sound").filming, worker("broken").filming), (Some(3), None));
    assert_eq!((worker("broken").failures_in_a_row, worker("broken").leases), (5, 0));
    let reason = worker("broken").stopped_reason.as_deref();
    assert!(reason.expect("a reason").contains("5 times in a row"));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_backup_of_a_running_coordinator_is_valid_and_can_be_served() {
    let (folder, serve) = Serve::with_demo();
    let mut worker = serve.worker("a").await;
    let leases = worker.claim(3).await;
    assert_eq!(worker.commit(&leases[0], true).await, Verdict::Accepted);
    let restored = folder.path().join("restored");
    std::fs::create_dir(&restored).expect("a folder");
    let copy = restored.join("coordinator.sqlite");
    let copy = copy.to_str().expect("UTF-8");
    succeed(serve.command(&["backup", "--output", copy]));
    assert_eq!(worker.commit(&leases[1], true).await, Verdict::Accepted);
    let files = std::fs::read_dir(&restored).expect("a folder");
    assert_eq!(files.count(), 1, "the copy alone");

    let checked = coordinator(&["check", copy]);
    assert_eq!(text(&checked.stdout), "all 20 invariants hold\n");
    let second = Serve::start(&restored);
    let mut worker = second.worker("a").await;
    // The worker still holds the leases that the backup contains, so that a result committed after
    // the backup can be committed again.
    assert_eq!(worker.commit(&leases[0], true).await, Verdict::Duplicate);
    assert_eq!(worker.commit(&leases[1], true).await, Verdict::Accepted);
    assert_eq!(worker.commit(&leases[2], true).await, Verdict::Accepted);
}

#[tokio::test(flavor = "multi_thread")]
async fn an_operator_follows_and_ends_a_campaign_from_the_command_line() {
    let (_folder, serve) = Serve::anew();
    let run = |arguments: &[&str], code, words: &[&str]| serve.run(arguments, code, words);
    run(&["campaign", "status"], 0, &["no campaigns yet"]);
    run(&CREATE, 0, &["14 rollouts"]);
    run(&["workers"], 0, &["no worker is alive"]);
    let mut worker = serve.worker("slow-1").await;
    let lease = worker.claim_one().await;
    assert_eq!(worker.commit(&lease, true).await, Verdict::Accepted);
    worker.claim_one().await;
    worker.report_filming(2).await;
    let busy = ["slow-1 on bench: 1/2 slots busy", "\n  filming 2 rollouts\n"];
    run(&["workers"], 0, &busy);
    run(&["jobs", "demo", "--limit", "1"], 0, &["success after 120", "more: --limit"]);
    run(&["jobs", "demo", "--state", "leased"], 0, &["running on slow-1"]);
    let failed = worker.claim_one().await;
    worker.release(&failed, Reason::PolicyMisbehaved).await;
    let failing = ["failing      1 rollout not in quarantine yet", "simulated failure"];
    run(&["campaign", "status", "demo"], 0, &failing);
    run(&["jobs", "demo", "object/t0/nominal/i16"], 0, &["attempt 1 by slow-1 on bench"]);
    run(&["jobs", "demo", "object/t0/nominal/i16#rx"], 2, &["#r1"]);
    run(&["jobs", "demo", "object/t9/nominal/i1"], 1, &["no such rollout"]);
    run(&["jobs", "demo", "a", "b"], 2, &["one at a time"]);
    run(&["jobs", "demo", "--skip"], 2, &["ROLLOUT"]);
    run(&["jobs", "demo", "--retry"], 0, &["nothing is in quarantine"]);
    run(&["campaign", "pause", "demo"], 0, &["demo is paused"]);
    run(&["campaign", "status", "demo"], 0, &["paused, 1 running"]);
    run(&["campaign", "resume", "demo"], 0, &["demo is running"]);
    run(&["campaign", "delete", "demo"], 2, &["--confirm demo"]);
    run(&["campaign", "delete", "demo", "--confirm", "dmeo"], 2, &["nothing was deleted"]);
    run(&["campaign", "delete", "demo", "--confirm", "demo"], 1, &["cancel it first"]);
    run(&["campaign", "cancel", "demo"], 0, &["its results stay"]);
    run(&["campaign", "status", "--watch"], 0, &["ETA: ", "1/14 7%  cancelled"]);
    run(&["campaign", "resume", "demo"], 1, &["final"]);
    run(&["campaign", "delete", "demo", "--confirm", "demo"], 0, &["14 rollouts, 1 result and"]);
    run(&["campaign", "status"], 0, &["no campaigns yet"]);
}

/// Regression: new jobs reused the ids of deleted ones, and a lease was identified by
/// job and attempt number, so that a slot that still ran an old rollout committed it into the new
/// campaign. Now each lease has an attempt id, and job ids are never reused.
#[tokio::test]
async fn attempts_of_a_deleted_campaign_match_no_job_of_a_later_campaign() {
    let bench = Bench::with(&small_spec("before")).await;
    let mut slot = bench.worker("a").await;
    let old = slot.claim_one().await;
    let cancelled = bench.change("before", Change::Cancel).await;
    assert_eq!(cancelled.expect("cancelled"), "cancelled");
    bench.delete("before", "before").await.expect("deleted");
    bench.create(&small_spec("after")).await.expect("created");
    let new = slot.claim_one().await;
    assert!(new.job_id > old.job_id + 3, "job ids are not reused");

    let lost_leases = slot.heartbeat(&[&old, &new], 9).await;
    assert_eq!(lost_leases, std::slice::from_ref(&old.attempt_id));
    assert_refused(slot.try_commit(&old, true).await, Code::NotFound, &[]);
    let release = wire::ReleaseRequest {
        attempt_id: old.attempt_id.clone(),
        reason: Reason::SlotCrashed.into(),
        error: "too late".to_owned(),
        ..wire::ReleaseRequest::default()
    };
    assert_refused(slot.service.release(release).await, Code::NotFound, &[]);
    assert_eq!(bench.count("SELECT count(*) FROM failure").await, 0);
    assert_eq!(slot.commit(&new, false).await, Verdict::Accepted);
    assert_eq!(bench.status("after").await.rollouts.succeeded, 0);
}
