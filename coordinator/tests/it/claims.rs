//! Choice of the job for each claim, and the time at which each job is leased.

use std::collections::BTreeSet;
use std::time::{Duration, Instant};

use proto::coordinator as wire;
use proto::coordinator::change_campaign_request::Change;
use proto::coordinator::commit_response::Verdict;
use queue::read::JobLine;
use serde_json::json;
use tokio::task::JoinSet;
use tonic::Code;

use crate::assertions::{assert_contains, assert_refused};
use crate::harness::{Bench, registration, rollout_id, small_spec, value, with};
use crate::process::plus_spec;

#[tokio::test(flavor = "multi_thread")]
async fn claim_is_exclusive_under_concurrency() {
    let bench = Bench::start().await;
    let spec =
        with(small_spec("busy"), json!({"tasks": ["libero_object"], "configs": [0, 1, 2, 3]}));
    let jobs = bench.create(&spec).await.expect("created").jobs_total;
    let mut claimants = JoinSet::new();
    for number in 0..8_u32 {
        let mut worker = bench.worker(&format!("w{number}")).await;
        claimants.spawn(async move {
            let mut claimed = Vec::new();
            loop {
                let leases = worker.claim(1 + number % 3).await;
                if leases.is_empty() {
                    return claimed;
                }
                claimed.extend(leases.into_iter().map(|lease| (lease.job_id, lease.attempt)));
            }
        });
    }
    let claimed_jobs: Vec<(i64, u32)> = claimants.join_all().await.concat();
    assert_eq!(claimed_jobs.len() as u64, jobs);
    assert!(claimed_jobs.iter().all(|(_, attempt)| *attempt == 1));
    let distinct: BTreeSet<i64> = claimed_jobs.iter().map(|(job, _)| *job).collect();
    assert_eq!(distinct.len() as u64, jobs, "no job was leased twice");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_waiting_claim_is_woken_by_new_work_and_by_a_resumed_campaign() {
    let bench = Bench::start().await;
    let mut waiting = JoinSet::new();
    for resumed in [false, true] {
        let mut worker = bench.worker("a").await;
        waiting.spawn(async move { worker.try_claim(25.0, "").await });
        tokio::time::sleep(Duration::from_millis(200)).await;
        let began = Instant::now();
        match resumed {
            false => drop(bench.create(&small_spec("late")).await.expect("created")),
            true => drop(bench.change("late", Change::Resume).await.expect("resumed")),
        }
        let claimed = waiting.join_next().await.expect("a claim").expect("no panic");
        assert!(claimed.expect("an answer").lease.is_some());
        assert!(began.elapsed() < Duration::from_secs(5), "woken, not timed out");
        bench.change("late", Change::Pause).await.expect("paused");
    }
}

#[tokio::test]
async fn a_claim_without_work_waits_for_the_requested_time() {
    let bench = Bench::start().await;
    let mut worker = bench.worker("a").await;
    let began = Instant::now();
    let claimed = worker.try_claim(0.3, "").await.expect("an answer");
    assert!(claimed.lease.is_none() && claimed.idle_reason.is_empty());
    assert!(began.elapsed() >= Duration::from_millis(290));
}

#[tokio::test]
async fn a_configuration_is_leased_together_with_its_nominal_rollout() {
    let spec = with(small_spec("units"), json!({"configs": [0, 1]}));
    let bench = Bench::with(&spec).await;
    let mut worker = bench.worker("a").await;
    let ids: Vec<String> = worker.claim(8).await.iter().map(rollout_id).collect();
    let conditions: Vec<&str> =
        ids.iter().map(|id| id.split('/').nth(2).expect("a condition")).collect();
    let unit = ["nominal", "camera", "sensor", "simultaneous"];
    assert_eq!(conditions, [unit, unit].concat());
    assert!(ids[1..4].iter().all(|id| id.ends_with("c00")), "{ids:?}");
    assert!(ids[5..].iter().all(|id| id.ends_with("c01")), "{ids:?}");
}

#[tokio::test]
async fn a_worker_gets_jobs_of_its_warm_task_or_else_of_a_task_without_leases() {
    let spec = with(
        small_spec("spread"),
        json!({"tasks": ["libero_object/0", "libero_object/1", "libero_object/2"]}),
    );
    let bench = Bench::with(&spec).await;
    let (mut first, mut second) = (bench.worker("a").await, bench.worker("b").await);
    let task = |id: &str| id.split('/').nth(1).expect("a task").to_owned();
    let first_rollout = rollout_id(&first.claim_one().await);
    assert_eq!(task(&first_rollout), "t0");
    let second_rollout = rollout_id(&second.claim_one().await);
    assert_eq!(task(&second_rollout), "t1", "another worker holds t0");
    let warm = first.claim_warm(1, "libero_object/2").await;
    assert_eq!(task(&rollout_id(&warm[0])), "t2", "the worker has compiled the scene of t2");
    let remaining = first.claim_warm(64, "libero_object/2").await;
    assert_eq!(remaining.len(), 9, "the warm task is preferred, not required");
}

/// Checks a campaign that is leased task by task, and one with a stop rule, which is leased in a
/// random order.
#[tokio::test]
async fn jobs_of_tasks_without_assets_are_left_to_other_workers() {
    let bench = Bench::start().await;
    let tasks = json!(["libero_object/0", "libero_object/1"]);
    let spec = with(small_spec("partial"), json!({ "tasks": tasks }));
    bench.create(&spec).await.expect("created");
    let stop = json!({"rule": "width(I) < 0.001", "seed": 7});
    let drawn = with(spec, json!({"name": "drawn", "stop": stop}));
    bench.create(&drawn).await.expect("created");
    let mut partial = bench.worker("a").await;
    let mut claimed = Vec::new();
    loop {
        let mut request = partial.claim_request(0.0, "libero_object/0");
        request.lacking_tasks = vec!["libero_object/0".to_owned()];
        let answer = partial.service.claim(request).await.expect("an answer");
        let Some(lease) = answer.into_inner().lease else {
            break;
        };
        claimed.push(lease);
    }
    for campaign in ["partial", "drawn"] {
        assert!(claimed.iter().any(|lease| lease.campaign == campaign));
    }
    assert!(claimed.iter().all(|lease| rollout_id(lease).contains("/t1/")));
    let mut complete = bench.worker("b").await;
    let remaining = complete.claim(64).await;
    assert_eq!(remaining.len(), claimed.len(), "the jobs of t0 are still queued");
    assert!(remaining.iter().all(|lease| rollout_id(lease).contains("/t0/")));
}

/// Regression: a worker without LIBERO-Plus' task files was offered rollouts of these files again
/// and again.
#[tokio::test]
async fn variants_whose_task_files_a_worker_lacks_are_left_to_others() {
    let bench = Bench::start().await;
    let variants = [
        "put_the_bowl_on_the_plate_view_0_0_100_0_0_initstate_0_noise_30",
        "put_the_bowl_on_the_plate_language_1_view_0_0_100_0_0_initstate_0",
        "put_the_bowl_on_the_plate_moved_level1_sample1",
    ];
    bench.create(&plus_spec(&variants.join(","))).await.expect("created");
    let mut partial = bench.worker("a").await;
    let mut claimed = Vec::new();
    let idle_reason = loop {
        let mut request = partial.claim_request(0.0, "");
        request.lacking_tasks = vec!["libero_goal/8+libero-plus".to_owned()];
        let answer = partial.service.claim(request).await.expect("an answer");
        let answer = answer.into_inner();
        match answer.lease {
            Some(lease) => claimed.push(rollout_id(&lease)),
            None => break answer.idle_reason,
        }
    };
    claimed.sort();
    assert_eq!(claimed, ["goal/t8/plus:noise_30/i00", "goal/t8/plus:unperturbed/i00"]);
    assert_contains(&idle_reason, &["campaign `plus`", "worker assets fetch --suite libero-plus"]);
    let listed = wire::ListJobsRequest {
        campaign: "plus".to_owned(),
        task: "libero_goal/8".to_owned(),
        limit: 64,
        ..wire::ListJobsRequest::default()
    };
    let listed: Vec<JobLine> = value(bench.operator().await.list_jobs(listed).await).expect("jobs");
    assert_eq!(listed.len(), 4);
    let mut complete = bench.worker("b").await;
    let mut remaining: Vec<String> = complete.claim(64).await.iter().map(rollout_id).collect();
    remaining.sort();
    assert_eq!(remaining, ["goal/t8/plus:language_1/i00", "goal/t8/plus:level1_sample1/i00"]);
}

#[tokio::test]
async fn a_worker_that_names_no_renderer_is_not_registered() {
    let bench = Bench::start().await;
    let mut worker = bench.worker("a").await;
    let mut nameless = registration("b", "primitives");
    nameless.renderer.clear();
    assert_refused(worker.service.register(nameless).await, Code::InvalidArgument, &["`renderer`"]);
    assert_eq!(bench.count("SELECT count(*) FROM worker").await, 1);
}

/// Regression: the oldest campaign got all workers until it was finished.
#[tokio::test]
async fn campaigns_of_one_priority_progress_together() {
    let bench = Bench::with(&small_spec("older")).await;
    bench.create(&small_spec("newer")).await.expect("created");
    let mut worker = bench.worker("a").await;
    let mut names = Vec::new();
    // Simulates a single slot, which never holds two leases.
    for _ in 0..4 {
        let lease = worker.claim_one().await;
        assert_eq!(worker.commit(&lease, true).await, Verdict::Accepted);
        names.push(lease.campaign);
    }
    assert_eq!(names, ["older", "newer", "older", "newer"]);
    // Simulates several slots, which keep their leases.
    let leases = worker.claim(8).await;
    let count = |name: &str| leases.iter().filter(|lease| lease.campaign == name).count();
    assert_eq!((count("older"), count("newer")), (2, 2));
}

#[tokio::test]
async fn the_campaign_with_the_fewest_leases_is_next() {
    let bench = Bench::start().await;
    let spec = |name| with(small_spec(name), json!({"configs": [0, 1, 2, 3]}));
    bench.create(&spec("begun")).await.expect("created");
    let mut worker = bench.worker("a").await;
    let begun = worker.claim(4).await;
    bench.create(&spec("new")).await.expect("created");
    let campaigns: Vec<String> =
        worker.claim(6).await.into_iter().map(|lease| lease.campaign).collect();
    assert_eq!(campaigns[..4], ["new"; 4], "the new campaign until both hold four leases");
    assert_eq!(campaigns[4..], ["begun", "new"], "then the campaigns alternate");
    // After a commit, the rollout's campaign has the fewest leases, so that the slot continues with
    // this campaign, whose scene it holds.
    assert_eq!(worker.commit(&begun[0], true).await, Verdict::Accepted);
    assert_eq!(worker.claim_one().await.campaign, "begun");
}

#[tokio::test]
async fn higher_priorities_are_leased_first_and_can_be_changed() {
    let bench = Bench::with(&small_spec("usual")).await;
    let urgent = bench.create_with_priority(&small_spec("urgent"), 7).await;
    assert_eq!(urgent.expect("created").priority, 7);
    let mut worker = bench.worker("a").await;
    assert_eq!(worker.claim_one().await.campaign, "urgent");
    assert_eq!(worker.claim_one().await.campaign, "urgent");
    // Creating the same campaign again keeps its priority.
    let again = bench.create(&small_spec("urgent")).await.expect("an existing campaign");
    assert_eq!((again.jobs_added, again.priority), (0, 7));

    let request = wire::AlterCampaignRequest {
        campaign: "usual".to_owned(),
        priority: Some(8),
        ..wire::AlterCampaignRequest::default()
    };
    let mut operator = bench.operator().await;
    operator.alter_campaign(request.clone()).await.expect("altered");
    assert_eq!(bench.status("usual").await.priority, 8);
    assert_eq!(worker.claim_one().await.campaign, "usual");
    for priority in [-101, 101] {
        let request = wire::AlterCampaignRequest { priority: Some(priority), ..request.clone() };
        assert_refused(
            operator.alter_campaign(request).await,
            Code::InvalidArgument,
            &["from -100 to 100"],
        );
        assert_refused(
            bench.create_with_priority(&small_spec("new"), priority).await,
            Code::InvalidArgument,
            &[],
        );
    }
    // Jobs of lower priority are leased once all jobs of higher priority are leased.
    assert_eq!(worker.claim(64).await.len(), 5);
}

/// A worker cannot run campaigns that are pinned to other assets or wait for their policy. They do
/// not delay campaigns of lower priority.
#[tokio::test]
async fn a_campaign_that_a_worker_cannot_run_delays_no_other() {
    let bench = Bench::start().await;
    let policy = |name: &str| json!({"policy": {"name": name, "endpoint": "http://127.0.0.1:1"}});
    let foreign = bench.create_with_priority(&small_spec("foreign"), 9).await;
    foreign.expect("created");
    let mut other = bench.worker_of_pack("other", "libero").await;
    let lease = other.claim_one().await;
    assert_eq!(other.commit(&lease, true).await, Verdict::Accepted);
    let down = with(small_spec("down"), policy("fragile"));
    bench.create_with_priority(&down, 5).await.expect("created");
    let (mut worker, lease) = bench.worker_with_lease("a").await;
    assert_eq!(lease.campaign, "down");
    let reason = wire::release_request::Reason::PolicyUnavailable;
    worker.release(&lease, reason).await;
    let sound = with(small_spec("sound"), policy("sound"));
    bench.create(&sound).await.expect("created");
    let leases = worker.claim(64).await;
    assert_eq!(leases.len(), 4);
    assert!(leases.iter().all(|lease| lease.campaign == "sound"));
}

#[tokio::test]
async fn an_unregistered_worker_must_register_and_another_protocol_version_is_refused() {
    let bench = Bench::start().await;
    let mut worker = bench.worker("a").await;
    worker.id = "stranger".to_owned();
    assert_refused(worker.try_claim(0.0, "").await, Code::NotFound, &["register first"]);

    let mut request = registration("b", "primitives");
    request.protocol_version = 99;
    let refused = worker.service.register(request).await.expect_err("too new");
    assert_eq!(refused.code(), Code::FailedPrecondition);
    assert!(refused.message().contains("version 99"), "{refused}");
    let own_version = format!("version {};", proto::COORDINATOR_PROTOCOL_VERSION);
    assert!(refused.message().contains(&own_version), "{refused}");
}

/// Regression: a claim whose answer was lost left a lease of which the worker did not know.
#[tokio::test]
async fn a_repeated_claim_returns_its_existing_lease() {
    let bench = Bench::with(&small_spec("again")).await;
    let mut worker = bench.worker("a").await;
    let request = worker.claim_request(0.0, "");
    let mut leases = Vec::new();
    for _ in 0..3 {
        let claimed = worker.service.claim(request.clone()).await;
        leases.push(claimed.expect("an answer").into_inner().lease);
    }
    let first = leases[0].as_ref().expect("a lease");
    assert_eq!(leases[1].as_ref(), Some(first));
    assert_eq!(leases[2].as_ref(), Some(first));
    assert_eq!(bench.status("again").await.rollouts.leased, 1);
    // Claim ids are local to a worker: the same id from another worker is another claim.
    let mut other = bench.worker("b").await;
    let request = wire::ClaimRequest { worker_id: other.id.clone(), ..request };
    let claimed = other.service.claim(request).await.expect("an answer");
    let lease = claimed.into_inner().lease.expect("a lease");
    assert_ne!(lease.attempt_id, first.attempt_id);
    assert_ne!(lease.job_id, first.job_id);
}

#[tokio::test]
async fn leases_that_were_never_acknowledged_expire_uncharged_and_count_against_no_worker() {
    let bench = Bench::with(&small_spec("lost")).await;
    let mut worker = bench.worker("a").await;
    // More failures than would stop a worker if they counted.
    for _ in 0..8 {
        let claimed = worker.claim_response("").await;
        assert!(claimed.lease.is_some(), "{}", claimed.idle_reason);
        bench.advance(40).await;
        assert_eq!(bench.status("lost").await.rollouts.leased, 0);
    }
    let failures = "SELECT count(*) FROM failure
                    WHERE reason = 'never_acknowledged' AND charged = 0";
    assert_eq!(bench.count(failures).await, 8);
    assert_eq!(bench.count("SELECT count(*) FROM failure").await, 8);
    assert_eq!(worker.claim(4).await.len(), 4);
}
