//! Alteration of an existing campaign: its policy's endpoint and its name.

use proto::coordinator as wire;
use proto::coordinator::change_campaign_request::Change;
use proto::coordinator::commit_response::Verdict;
use proto::coordinator::release_request::Reason;
use queue::read::CampaignStatus;
use serde_json::json;
use tonic::{Code, Status};

use crate::artifacts::put;
use crate::assertions::assert_refused;
use crate::harness::{Bench, Worker, small_spec, value, with};
use crate::page::http;
use crate::process::{CREATE, Serve};

const NEW_ENDPOINT: &str = "http://127.0.0.1:50099";

async fn alter(
    bench: &Bench,
    request: wire::AlterCampaignRequest,
) -> Result<(CampaignStatus, u64), Status> {
    value(bench.operator().await.alter_campaign(request).await)
}

fn to_endpoint(campaign: &str, url: &str) -> wire::AlterCampaignRequest {
    wire::AlterCampaignRequest {
        campaign: campaign.to_owned(),
        policy_endpoint: Some(url.to_owned()),
        ..wire::AlterCampaignRequest::default()
    }
}

fn to_name(campaign: &str, name: &str) -> wire::AlterCampaignRequest {
    wire::AlterCampaignRequest {
        campaign: campaign.to_owned(),
        name: Some(name.to_owned()),
        ..wire::AlterCampaignRequest::default()
    }
}

/// Stores a video beside a committed outcome; returns its path below the data folder.
async fn film(worker: &mut Worker, lease: &wire::Lease) -> String {
    put(worker, lease, "video.mp4", &[vec![1; 100]]).await.expect("stored")
}

/// Regression: a typo in the endpoint could only be corrected by creating another campaign.
#[tokio::test]
async fn a_campaign_continues_at_once_after_its_endpoint_is_corrected() {
    let bench = Bench::with(&small_spec("typo")).await;
    let mut worker = bench.worker("a").await;
    let held = worker.claim_one().await;
    let failed = worker.claim_one().await;
    worker.release(&failed, Reason::PolicyUnavailable).await;
    assert!(bench.status("typo").await.policy_outage.is_some());
    assert!(worker.claim(1).await.is_empty());

    let altered = alter(&bench, to_endpoint("typo", NEW_ENDPOINT)).await;
    let (status, taken_back) = altered.expect("altered");
    assert_eq!((status.endpoint.as_str(), taken_back), (NEW_ENDPOINT, 1));
    assert!(status.policy_outage.is_none(), "the policy at the new endpoint is available");

    // An attempt at the old endpoint no longer belongs to this campaign, and is no evidence about
    // the new endpoint.
    let lost_leases = worker.heartbeat(&[&held], 20).await;
    assert_eq!(lost_leases, std::slice::from_ref(&held.attempt_id));
    worker.release(&held, Reason::PolicyUnavailable).await;
    assert_eq!(worker.commit(&held, true).await, Verdict::Stale);
    assert!(bench.status("typo").await.policy_outage.is_none());
    let charged = "SELECT sum(charged_attempts) FROM job";
    assert_eq!(bench.count(charged).await, 0);
    let leases = worker.claim(8).await;
    assert_eq!(leases.len(), 4);
    assert!(leases.iter().all(|lease| lease.policy_endpoint == NEW_ENDPOINT));
    // No policy has the mistyped endpoint any more.
    assert_eq!(bench.count("SELECT count(*) FROM policy").await, 1);
    bench.assert_sound().await;
}

#[tokio::test]
async fn an_altered_campaign_is_recognised_by_its_new_specification_only() {
    let bench = Bench::start().await;
    let before = small_spec("typo");
    bench.create(&before).await.expect("created");
    let request = wire::AlterCampaignRequest {
        policy: Some("expart".to_owned()),
        ..to_endpoint("typo", NEW_ENDPOINT)
    };
    alter(&bench, request).await.expect("altered");
    let policy = json!({"policy": {"name": "expart", "endpoint": NEW_ENDPOINT}});
    let now = bench.create(&with(before.clone(), policy)).await;
    assert_eq!(now.expect("an existing campaign").jobs_added, 0);
    assert_refused(bench.create(&before).await, Code::AlreadyExists, &["`policy`"]);
}

#[tokio::test]
async fn an_invalid_alteration_is_refused_and_changes_nothing() {
    let bench = Bench::with(&small_spec("one")).await;
    bench.create(&small_spec("two")).await.expect("created");
    let (mut worker, lease) = bench.worker_with_lease("a").await;
    assert_eq!(worker.commit(&lease, true).await, Verdict::Accepted);
    assert_eq!(lease.campaign, "one");
    let held = worker.claim(8).await;
    let refusals = [
        (to_endpoint("one", "localhost"), Code::InvalidArgument, "http://"),
        (to_endpoint("none", NEW_ENDPOINT), Code::NotFound, "no such"),
        (to_name("one", "two"), Code::AlreadyExists, "another one is called `two`"),
        (to_name("one", "../up"), Code::InvalidArgument, "../up"),
        (
            wire::AlterCampaignRequest {
                policy: Some("another".to_owned()),
                priority: Some(3),
                ..to_name("one", "three")
            },
            Code::FailedPrecondition,
            "results of policy `expert`, 1 so far",
        ),
    ];
    for (request, code, words) in refusals {
        assert_refused(alter(&bench, request.clone()).await, code, &[words]);
    }
    let status = bench.status("one").await;
    assert_eq!((status.priority, status.rollouts.leased), (0, 3));
    let leases: Vec<&wire::Lease> = held.iter().collect();
    assert!(worker.heartbeat(&leases, 9).await.is_empty());
    let cancelled = bench.change("one", Change::Cancel).await;
    cancelled.expect("cancelled");
    let refused = alter(&bench, to_endpoint("one", NEW_ENDPOINT)).await;
    assert!(refused.expect_err("final").message().contains("final"));
    bench.assert_sound().await;
}

#[tokio::test]
async fn a_probe_is_replaced_if_its_campaign_changes_endpoint() {
    let bench = Bench::start().await;
    let leaves = bench.create_with_priority(&small_spec("leaves"), 1).await;
    leaves.expect("created");
    bench.create(&small_spec("stays")).await.expect("created");
    let (mut worker, lease) = bench.worker_with_lease("a").await;
    worker.release(&lease, Reason::PolicyUnavailable).await;
    bench.advance(61).await;
    let probe = worker.claim_one().await;
    assert_eq!(probe.campaign, "leaves");
    alter(&bench, to_endpoint("leaves", NEW_ENDPOINT)).await.expect("altered");
    bench.assert_sound().await;
    let next = worker.claim(2).await;
    let campaigns: Vec<&str> = next.iter().map(|lease| lease.campaign.as_str()).collect();
    assert_eq!(campaigns, ["leaves", "leaves"], "jobs are leased at once at the new endpoint");
    let later_leases = worker.claim(8).await;
    let probes = later_leases.iter().filter(|lease| lease.campaign == "stays");
    assert_eq!(probes.count(), 1, "another campaign probes the old endpoint");
}

#[tokio::test]
async fn a_renamed_campaign_keeps_everything_and_is_found_under_its_new_name() {
    let bench = Bench::with(&small_spec("old")).await;
    let mut worker = bench.worker("a").await;
    let (done, held) = (worker.claim_one().await, worker.claim_one().await);
    assert_eq!(worker.commit(&done, true).await, Verdict::Accepted);
    let video = film(&mut worker, &done).await;
    assert!(video.starts_with("artifacts/old/"), "{video}");

    alter(&bench, to_name("old", "new")).await.expect("renamed");
    assert_eq!(worker.commit(&held, true).await, Verdict::Accepted);
    let second = film(&mut worker, &held).await;
    assert!(second.starts_with("artifacts/old/"), "{second}");
    assert_eq!(bench.status("new").await.rollouts.committed, 2);
    let again = bench.create(&small_spec("new")).await.expect("an existing campaign");
    assert_eq!(again.jobs_added, 0);
    let request = wire::GetCampaignRequest { campaign: "old".to_owned() };
    assert_refused(
        bench.operator().await.get_campaign(request).await,
        Code::NotFound,
        &["is called `new`"],
    );
    bench.assert_sound().await;
}

/// A campaign's folder keeps the campaign's first name. A new campaign with the former name of a
/// renamed campaign must neither mix its files with those of the renamed campaign nor delete them.
#[tokio::test]
async fn a_reused_name_shares_no_files_with_its_former_campaign() {
    let bench = Bench::with(&small_spec("name")).await;
    let (mut worker, lease) = bench.worker_with_lease("a").await;
    assert_eq!(worker.commit(&lease, true).await, Verdict::Accepted);
    let first_path = film(&mut worker, &lease).await;
    alter(&bench, to_name("name", "first")).await.expect("renamed");
    let second = bench.create_with_priority(&small_spec("name"), 1).await;
    assert_eq!(second.expect("created").jobs_added, 4);
    let lease = worker.claim_one().await;
    assert_eq!(lease.campaign, "name");
    assert_eq!(worker.commit(&lease, true).await, Verdict::Accepted);
    let second_path = film(&mut worker, &lease).await;
    assert!(second_path.starts_with("artifacts/name~2/"), "{second_path}");
    bench.assert_sound().await;

    bench.delete("name", "name").await.expect("deleted");
    assert!(bench.folder.path().join(&first_path).is_file());
    assert!(!bench.folder.path().join(&second_path).exists());
    // No campaign has this name now, and the name no longer leads to the renamed campaign.
    let request = wire::GetCampaignRequest { campaign: "name".to_owned() };
    let refused = bench.operator().await.get_campaign(request).await;
    let refused = refused.expect_err("gone");
    assert!(refused.message().contains("no such campaign"), "{refused}");
    // The first campaign gets its first name back, and is then renamed once more.
    alter(&bench, to_name("first", "name")).await.expect("renamed");
    alter(&bench, to_name("name", "last")).await.expect("renamed");
    bench.assert_sound().await;
    bench.delete("last", "last").await.expect("deleted");
    assert!(!bench.folder.path().join(&first_path).exists());
    assert_eq!(bench.count("SELECT count(*) FROM former_name").await, 0);
    bench.assert_sound().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_operator_alters_a_campaign_from_the_command_line() {
    let (_folder, serve) = Serve::anew();
    let run = |arguments: &[&str], code, words: &str| serve.run(arguments, code, &[words]);
    run(&[&CREATE[..], &["--priority", "-3"]].concat(), 0, "14 rollouts");
    run(&CREATE, 0, "keeps priority -3");
    let mut worker = serve.worker("a").await;
    worker.claim_one().await;
    let set = |flag, value| vec!["campaign", "set", "demo", flag, value];
    run(&set("--priority", "-100"), 0, "demo has priority -100");
    run(&set("--priority", "101"), 2, "-100 to 100");
    run(&set("--endpoint", "localhost"), 2, "http://");
    run(&set("--endpoint", NEW_ENDPOINT), 0, "1 rollout taken back");
    run(&["campaign", "set", "demo"], 2, "--priority");
    run(&["campaign", "status", "demo"], 0, NEW_ENDPOINT);
    let new_url = "http://127.0.0.1:50053";
    let move_from = |from| ["campaign", "set", "--at", from, "--endpoint", new_url];
    run(&move_from("http://127.0.0.1:1"), 0, "no unfinished campaign measures");
    run(&move_from(NEW_ENDPOINT), 0, &format!("demo measures expert at {new_url}"));
    run(&["campaign", "status", "demo"], 0, new_url);
    run(&set("--name", "final"), 0, "demo is now called final");
    run(&["campaign", "status", "demo"], 1, "is called `final`");
    run(&["campaign", "status", "final"], 0, "final ░");
}

#[tokio::test(flavor = "multi_thread")]
async fn an_old_page_address_redirects_to_the_renamed_campaign() {
    let bench = Bench::with(&small_spec("old")).await;
    alter(&bench, to_name("old", "new")).await.expect("renamed");
    let page = async |path: &str| http(&bench.url, &format!("GET {path}")).await;
    for path in ["", "/rollouts?state=queued"] {
        let answer = page(&format!("/campaigns/old{path}")).await;
        assert_eq!(answer.code, 307);
        let location = answer.header("location").expect("a location");
        assert_eq!(location, format!("/campaigns/new{path}"));
        assert_eq!(page(location).await.code, 200);
    }
}
