//! Results that may not stand beside each other are kept apart.

use proto::coordinator as wire;
use proto::coordinator::commit_response::Verdict;
use serde_json::json;
use tonic::Code;

use crate::harness::{Bench, Worker, sha, small_spec, with};

/// Two committed siblings, and the lease of a third.
async fn with_siblings() -> (Bench, Worker, wire::Lease) {
    let bench = Bench::start().await;
    bench.create(&small_spec("paired")).await.expect("created");
    let mut worker = bench.worker("a").await;
    let mut leases = worker.claim(3).await;
    for lease in leases.drain(..2) {
        assert_eq!(worker.commit(&lease, true).await, Verdict::Accepted);
    }
    (bench, worker, leases.remove(0))
}

/// Commits with an altered provenance; it must be refused in these words.
async fn check_unpaired(alter: impl FnOnce(&mut wire::Provenance), words: &[&str]) {
    let (bench, mut worker, lease) = with_siblings().await;
    let mut report = worker.report(&lease, true);
    alter(report.provenance.as_mut().expect("provenance"));
    let (verdict, detail) = worker.commit_request(report).await;
    assert_eq!(verdict, Verdict::Unpaired);
    for word in words {
        assert!(detail.contains(word), "{detail} lacks {word}");
    }
    assert_eq!(bench.status("paired").await.committed, 2);
    let charged = "SELECT count(*) FROM failure WHERE reason = 'unpaired' AND charged = 1";
    assert_eq!(bench.count(charged).await, 1);
}

#[tokio::test]
async fn another_scene_than_the_siblings_is_refused_with_the_difference_named() {
    let other = sha("another scene");
    let words = ["scene digest", &other, "object/t0/clean", "worker `a`"];
    check_unpaired(|p| p.scene_digest = other.clone(), &words).await;
}

#[tokio::test]
async fn another_initial_state_than_the_siblings_is_refused() {
    let other = sha("another state");
    let words = ["initial-state digest", &other];
    check_unpaired(|p| p.init_state_digest = other.clone(), &words).await;
}

#[tokio::test]
async fn another_pack_simulator_or_realisation_than_the_campaigns_is_refused() {
    let other = sha("libero");
    check_unpaired(
        |p| p.asset_pack_digest = other.clone(),
        &["asset-pack", &other],
    )
    .await;
    check_unpaired(
        |p| p.mujoco_version = "3.4.0".to_owned(),
        &["MuJoCo", "3.4.0", "3.3.7"],
    )
    .await;
    check_unpaired(
        |p| p.realisation = "reference".to_owned(),
        &["realisation mode", "reference", "matched"],
    )
    .await;
}

#[tokio::test]
async fn other_initial_states_are_no_siblings_and_replicates_are() {
    let bench = Bench::start().await;
    let spec = with(
        small_spec("twice"),
        json!({"axes": ["camera"], "nominal": "none", "configs": [0, 1], "replicates": 2}),
    );
    bench.create(&spec).await.expect("created");
    let mut worker = bench.worker("a").await;
    let leases = worker.claim(4).await;
    assert_eq!(worker.commit(&leases[0], true).await, Verdict::Accepted);
    // Another initial state of the same task: nothing to agree with.
    let mut other = worker.report(&leases[1], true);
    other.provenance.as_mut().expect("some").scene_digest = sha("moved");
    assert_eq!(worker.commit_request(other).await.0, Verdict::Accepted);
    // Replicate 1 of the first rollout.
    let mut replicate = worker.report(&leases[2], true);
    replicate.provenance.as_mut().expect("some").scene_digest = sha("moved");
    assert_eq!(worker.commit_request(replicate).await.0, Verdict::Unpaired);
}

#[tokio::test]
async fn an_outcome_without_its_origin_or_with_nonsense_is_refused_unread() {
    let (bench, mut worker, lease) = with_siblings().await;
    let good = worker.report(&lease, true);
    let mut check = async |alter: &dyn Fn(&mut wire::CommitRequest), word: &str| {
        let mut request = good.clone();
        alter(&mut request);
        let refused = worker.service.commit(request).await.expect_err(word);
        assert_eq!(refused.code(), Code::InvalidArgument);
        assert!(refused.message().contains(word), "{refused}");
    };
    check(&|r| r.provenance = None, "provenance").await;
    check(&|r| r.outcome = None, "outcome").await;
    check(&|r| r.lease = None, "lease").await;
    check(
        &|r| r.provenance.as_mut().unwrap().scene_digest.clear(),
        "scene_digest",
    )
    .await;
    check(
        &|r| r.provenance.as_mut().unwrap().init_state_digest = "0".repeat(63),
        "SHA-256",
    )
    .await;
    check(
        &|r| r.provenance.as_mut().unwrap().host = "x".repeat(1 << 20),
        "`host`",
    )
    .await;
    check(
        &|r| r.outcome.as_mut().unwrap().wall_secs = f64::NAN,
        "not finite",
    )
    .await;
    check(
        &|r| r.outcome.as_mut().unwrap().ik_residual_mm = Some(-1.0),
        "negative",
    )
    .await;
    assert_eq!(bench.status("paired").await.leased, 1, "nothing changed");
}
