//! Assets, simulator and renderer that a campaign requires of its workers, by its specification or
//! after its first result pinned it.

use benchmark::attempt::Provenance;
use proto::coordinator as wire;
use proto::coordinator::commit_response::Verdict;
use serde_json::json;

use crate::assertions::assert_contains;
use crate::harness::{Bench, registration, small_spec, with};

/// A software renderer and an OpenGL renderer, as workers name them.
const SOFTWARE: &str = "rollout-raster 1";
const GL: &str = "llvmpipe";

/// Registers a worker with this pack and renderer. Returns the reason in the response why the
/// worker gets no jobs; empty if it may have jobs.
async fn refusal_reason(bench: &Bench, pack: &str, renderer: &str) -> String {
    let mut worker = bench.worker_with_renderer("candidate", pack, renderer).await;
    let mut request = registration("candidate", pack);
    renderer.clone_into(&mut request.renderer);
    let answer = worker.service.register(request).await;
    answer.expect("registered").into_inner().idle_reason
}

#[tokio::test]
async fn a_campaign_is_pinned_to_the_pack_of_its_first_result() {
    let bench = Bench::with(&small_spec("pinned")).await;
    let mut first = bench.worker_of_pack("a", "primitives").await;
    let mut second = bench.worker_of_pack("b", "libero").await;
    // Both workers may run jobs until a result pins the campaign; leases alone pin nothing.
    let (lease, other_lease) = (first.claim_one().await, second.claim_one().await);
    assert_eq!(bench.status("pinned").await.live_workers, 2);
    assert_eq!(first.commit(&lease, true).await, Verdict::Accepted);
    assert_eq!(bench.status("pinned").await.live_workers, 1);
    // The other worker's result is refused without a charge to its job or worker.
    let (verdict, detail) = second.commit_request(second.report(&other_lease, true)).await;
    assert_eq!(verdict, Verdict::Unpaired);
    let response = second.claim_response("").await;
    assert!(response.lease.is_none());
    for word in ["pinned", "primitives", "libero", "MuJoCo 3.3.7"] {
        assert!(detail.contains(word), "{detail}");
        assert!(response.idle_reason.contains(word), "{response:?}");
    }
    let charged = "SELECT (SELECT max(charged_attempts) FROM job)
        + (SELECT max(charged_in_a_row) FROM worker)";
    assert_eq!(bench.count(charged).await, 0);
    assert_eq!(first.claim(4).await.len(), 3);
}

#[tokio::test]
async fn a_campaign_is_pinned_to_the_renderer_of_its_first_result() {
    let bench = Bench::with(&small_spec("pinned")).await;
    let mut first = bench.worker_with_renderer("a", "primitives", "one").await;
    let mut second = bench.worker_with_renderer("b", "primitives", "another").await;
    let lease = first.claim_one().await;
    assert_eq!(first.commit(&lease, true).await, Verdict::Accepted);
    for warm in ["", "libero_object/0"] {
        let response = second.claim_response(warm).await;
        assert!(response.lease.is_none());
        assert_contains(
            &response.idle_reason,
            &["`pinned` is pinned", "renderer `one`", "renderer `another`"],
        );
    }
    assert_eq!(bench.status("pinned").await.live_workers, 1);
    assert_eq!(first.claim_warm(4, "libero_object/0").await.len(), 3);
}

#[tokio::test]
async fn a_campaign_of_one_look_refuses_a_worker_of_the_other() {
    let with_look = |id: &str, look: &str| wire::RegisterRequest {
        look: look.to_owned(),
        ..registration(id, "primitives")
    };
    let bench = Bench::with(&small_spec("pinned")).await;
    let mut first = bench.register(with_look("a", "mujoco-3.3.2")).await;
    let mut second = bench.register(with_look("b", "mujoco-3.3.3")).await;
    let (lease, other_lease) = (first.claim_one().await, second.claim_one().await);
    let wanted = with(small_spec("wanted"), json!({ "look": "mujoco-3.3.3" }));
    bench.create(&wanted).await.expect("created");
    assert_eq!(first.commit(&lease, true).await, Verdict::Accepted);
    let (verdict, detail) = second.commit_request(second.report(&other_lease, true)).await;
    assert_eq!(verdict, Verdict::Unpaired);
    assert!(detail.contains("and look `mujoco-3.3.2` and this result is of"), "{detail}");
    assert!(detail.ends_with("and look `mujoco-3.3.3`"), "{detail}");
    assert_eq!(second.claim_one().await.campaign, "wanted");
    assert_eq!(first.claim(4).await.len(), 3);
    let response = first.claim_response("").await;
    assert!(response.idle_reason.contains("wants look `mujoco-3.3.3`"), "{response:?}");
    let charged = "SELECT max(charged_attempts) FROM job";
    assert_eq!(bench.count(charged).await, 0);
}

#[tokio::test]
async fn a_result_that_is_refused_pins_nothing() {
    let bench = Bench::with(&small_spec("open")).await;
    let mut worker = bench.worker_of_pack("a", "primitives").await;
    let lease = worker.claim_one().await;
    let report = worker.report_altered(&lease, true, |of| {
        "reference".clone_into(&mut of.provenance.realisation);
    });
    let (verdict, _) = worker.commit_request(report).await;
    assert_eq!(verdict, Verdict::Unpaired);
    let pinned = "SELECT count(*) FROM campaign WHERE pinned_ms IS NOT NULL";
    assert_eq!(bench.count(pinned).await, 0);
    assert_eq!(refusal_reason(&bench, "libero", GL).await, "");
}

/// Replaced weights or another `--execute` make a different policy: the campaign's jobs wait until
/// the measured policy is back, and no attempt is charged.
#[tokio::test]
async fn a_replaced_policy_counts_as_an_outage_of_the_measured_policy() {
    for (difference, replace) in [
        ("execute is `1` now and was `8`", replace_execute as Replace),
        ("image slots is `not given` now and was `image=agentview`", remove_image_slots),
        ("digest of the weights is `other` now and was ``", replace_weights),
        (
            "checkpoint is `other` now and was `none`",
            replace_checkpoint_of_a_policy_without_settings,
        ),
    ] {
        let bench = Bench::with(&small_spec("pinned")).await;
        let mut worker = bench.worker_of_pack("a", "primitives").await;
        let leases = worker.claim(3).await;
        let report = |lease: usize, replace: Replace| {
            worker.report_altered(&leases[lease], true, |of| {
                let settings = &mut of.provenance.policy_settings;
                settings.clear();
                if !difference.starts_with("checkpoint") {
                    for (name, value) in [("execute", "8"), ("image slots", "image=agentview")] {
                        settings.insert(name.to_owned(), value.to_owned());
                    }
                }
                replace(&mut of.provenance);
            })
        };
        let keep: Replace = |_| {};
        let [first, replaced, restored] = [report(0, keep), report(1, replace), report(2, keep)];
        assert_eq!(worker.commit_request(first).await.0, Verdict::Accepted);
        let (verdict, detail) = worker.commit_request(replaced).await;
        assert_eq!(verdict, Verdict::Unpaired);
        assert_contains(&detail, &["`pinned`", difference, "create another campaign"]);
        let reason = bench.status("pinned").await.policy_outage.expect("an outage");
        assert!(reason.contains(difference), "{reason}");
        let charged = "SELECT (SELECT max(charged_attempts) FROM job)
            + (SELECT max(charged_in_a_row) FROM worker)";
        assert_eq!(bench.count(charged).await, 0);
        assert_eq!(worker.commit_request(restored).await.0, Verdict::Accepted);
    }
}

/// A worker of a release without execution models waits for answers and reports no execution model.
#[tokio::test]
async fn a_result_under_another_execution_model_than_the_campaigns_is_refused() {
    for (campaign_model, result_model, expected) in [
        (Some("overlap:4"), Some("overlap:4"), Verdict::Accepted),
        (Some("overlap:4"), None, Verdict::Unpaired),
        (Some("overlap:4"), Some("overlap:4,rtc"), Verdict::Unpaired),
        (None, None, Verdict::Accepted),
        (None, Some("hold:1"), Verdict::Unpaired),
    ] {
        let spec = match campaign_model {
            Some(model) => with(small_spec("late"), json!({ "execution": model })),
            None => small_spec("late"),
        };
        let bench = Bench::with(&spec).await;
        let mut worker = bench.worker_of_pack("a", "primitives").await;
        let lease = worker.claim_one().await;
        assert_eq!(lease.execution, campaign_model.unwrap_or("wait"));
        let report = worker.report_altered(&lease, true, |of| {
            let model = result_model.map(|model| ("execution model".to_owned(), model.to_owned()));
            let settings = &mut of.provenance.policy_settings;
            settings.retain(|name, _| name != "execution model");
            settings.extend(model);
        });
        let (verdict, detail) = worker.commit_request(report).await;
        assert_eq!(verdict, expected, "{campaign_model:?} {result_model:?}: {detail}");
        if expected == Verdict::Unpaired {
            assert!(detail.contains("update the worker's program"), "{detail}");
        }
        let follows = json!({
            "name": "why", "policy": spec["policy"], "rows": [],
            "purpose": {"explanation": {"campaign": "late"}},
            "execution": "hold:7",
        });
        let error = bench.create(&follows).await.expect_err("another model");
        assert!(error.message().contains("`execution` is hold:7"), "{error}");
    }
}

/// A policy's description has 64 settings at most; under real-time chunking a worker adds four.
#[tokio::test]
async fn all_settings_of_a_description_are_stored_with_those_of_the_worker() {
    let bench = Bench::start().await;
    let execution = "overlap:4,rtc";
    let spec = with(small_spec("many"), json!({ "execution": execution }));
    bench.create(&spec).await.expect("created");
    let mut worker = bench.worker_of_pack("a", "primitives").await;
    let lease = worker.claim_one().await;
    let worker_settings = ["execute", "horizon", "real-time chunking"].map(str::to_owned);
    let policy_settings = (0..proto::MAX_SETTINGS).map(|number| format!("setting {number}"));
    let names = worker_settings.into_iter().chain(policy_settings);
    let report = worker.report_altered(&lease, true, |of| {
        let settings = &mut of.provenance.policy_settings;
        *settings = names.map(|name| (name, "1".to_owned())).collect();
        settings.insert("execution model".to_owned(), execution.to_owned());
    });
    let (verdict, detail) = worker.commit_request(report).await;
    assert_eq!(verdict, Verdict::Accepted, "{detail}");
}

/// Function that changes a provenance as a replaced policy would.
type Replace = fn(&mut Provenance);

fn replace_execute(policy: &mut Provenance) {
    let settings = &mut policy.policy_settings;
    settings.insert("execute".to_owned(), "1".to_owned());
}

fn remove_image_slots(policy: &mut Provenance) {
    policy.policy_settings.remove("image slots");
}

fn replace_weights(policy: &mut Provenance) {
    "other".clone_into(&mut policy.policy_checkpoint_digest);
}

fn replace_checkpoint_of_a_policy_without_settings(policy: &mut Provenance) {
    "other".clone_into(&mut policy.policy_checkpoint);
}

#[tokio::test]
async fn an_unsuitable_worker_learns_the_requirements_at_registration() {
    let bench = Bench::start().await;
    let wanted = json!({"assets": "libero", "renderer": "software"});
    let spec = with(small_spec("choosy"), wanted);
    bench.create(&spec).await.expect("created");
    for (pack, renderer) in [("primitives", SOFTWARE), ("libero", GL)] {
        let reason = refusal_reason(&bench, pack, renderer).await;
        assert_contains(
            &reason,
            &["`choosy` wants assets `libero` and renderer `software`", pack, renderer],
        );
        // The campaign's status shows the same reason.
        let waiting_reason = bench.status("choosy").await.waiting_reason.expect("a reason");
        assert_contains(&waiting_reason, &["wants assets `libero`", pack, renderer]);
    }
    assert_eq!(refusal_reason(&bench, "libero", SOFTWARE).await, "");
    assert_eq!(bench.status("choosy").await.waiting_reason, None);
    let mut worker = bench.worker_with_renderer("a", "libero", SOFTWARE).await;
    assert_eq!(worker.claim(4).await.len(), 4);
}

#[tokio::test]
async fn a_pack_can_be_required_by_a_digest_prefix() {
    let bench = Bench::start().await;
    let digest = registration("a", "libero").asset_pack_digest;
    let wanted = json!({"assets": digest[..10], "renderer": "gl"});
    let spec = with(small_spec("exact"), wanted);
    bench.create(&spec).await.expect("created");
    assert_eq!(refusal_reason(&bench, "libero", GL).await, "");
    let reason = refusal_reason(&bench, "primitives", GL).await;
    assert!(reason.contains(&digest[..10]), "{reason}");
}
