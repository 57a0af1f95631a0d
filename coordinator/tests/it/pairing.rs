//! Results that are inconsistent with those of their siblings, the rollouts from the same initial
//! state of a task, are refused.

use benchmark::Axis;
use benchmark::attempt::{CONNECTED_SINCE, IkResidual, Measurement, Realised, RealisedAxis};
use proto::coordinator as wire;
use proto::coordinator::commit_response::Verdict;
use serde_json::{Value, json};
use tonic::Code;

use crate::assertions::{assert_contains, assert_refused};
use crate::harness::{Bench, Worker, sha, small_spec, with};

async fn commit_siblings() -> (Bench, Worker, wire::Lease) {
    let bench = Bench::with(&small_spec("paired")).await;
    let mut worker = bench.worker("a").await;
    for lease in worker.claim(2).await {
        assert_eq!(worker.commit(&lease, true).await, Verdict::Accepted);
    }
    bench.advance(1).await;
    let lease = worker.claim_one().await;
    (bench, worker, lease)
}

#[tokio::test]
async fn a_result_unlike_its_siblings_or_its_campaign_is_refused_with_the_difference_named() {
    let other = sha("other");
    let set = |field: fn(&mut Measurement) -> &mut String, value: &str| {
        let value = value.to_owned();
        move |measurement: &mut Measurement| *field(measurement) = value.clone()
    };
    type Alter<'a> = &'a dyn Fn(&mut Measurement);
    let cases: [(Alter<'_>, &[&str]); 7] = [
        (
            &set(|of| &mut of.result.digests.scene, &other),
            &["scene digest", &other, "object/t0/nominal", "worker `a`"],
        ),
        (&set(|of| &mut of.result.digests.init_state, &other), &["initial-state digest", &other]),
        (
            &set(|of| &mut of.provenance.pin.asset_pack_digest, &other),
            &["asset pack", &other[..12]],
        ),
        (&set(|of| &mut of.provenance.pin.mujoco_version, "3.4.0"), &["MuJoCo", "3.4.0", "3.3.7"]),
        (
            &set(|of| &mut of.provenance.pin.renderer, "NVIDIA H200"),
            &["renderer", "NVIDIA H200", "llvmpipe"],
        ),
        (
            &set(|of| &mut of.provenance.realisation, "reference"),
            &["realisation mode", "reference", "matched"],
        ),
        (
            &|of| of.result.realised = Realised::default(),
            &["set of perturbed axes", "`none` here", "`sensor` in its manifest row"],
        ),
    ];
    for (alter, words) in cases {
        let (bench, mut worker, lease) = commit_siblings().await;
        let (verdict, detail) = commit_altered(&mut worker, &lease, alter).await;
        assert_eq!(verdict, Verdict::Unpaired);
        assert_contains(&detail, words);
        assert_eq!(bench.status("paired").await.rollouts.committed, 2);
        let charged = "SELECT count(*) FROM failure WHERE reason = 'unpaired' AND charged = 1";
        assert_eq!(bench.count(charged).await, 1);
    }
}

#[tokio::test]
async fn siblings_share_the_initial_state_and_include_replicates() {
    let spec = with(
        small_spec("twice"),
        json!({"axes": ["camera"], "nominal": "none", "configs": [0, 1], "replicates": 2}),
    );
    let bench = Bench::with(&spec).await;
    let mut worker = bench.worker("a").await;
    let leases = worker.claim(4).await;
    assert_eq!(worker.commit(&leases[0], true).await, Verdict::Accepted);
    // A rollout from another initial state of the same task has no siblings with results yet.
    let moved = |of: &mut Measurement| of.result.digests.scene = sha("moved");
    let other = commit_altered(&mut worker, &leases[1], moved).await;
    assert_eq!(other.0, Verdict::Accepted);
    // Replicate 1 of the first rollout.
    let replicate = commit_altered(&mut worker, &leases[2], moved).await;
    assert_eq!(replicate.0, Verdict::Unpaired);
}

/// Returns the leases of a campaign of one configuration: nominal, single axes, simultaneous, and
/// then the same rollouts of the second replicate, if there is one.
async fn leases_of(changes: Value) -> (Bench, Worker, Vec<wire::Lease>) {
    let spec = with(small_spec("paired"), changes);
    let bench = Bench::with(&spec).await;
    let mut worker = bench.worker("a").await;
    let leases = worker.claim(64).await;
    (bench, worker, leases)
}

/// Commits an altered result; returns the verdict and its explanation.
async fn commit_altered(
    worker: &mut Worker,
    lease: &wire::Lease,
    alter: impl FnOnce(&mut Measurement),
) -> (Verdict, String) {
    worker.commit_request(worker.report_altered(lease, true, alter)).await
}

/// Shifts all realised elements of one axis by `by`.
fn shift_elements(measurement: &mut Measurement, axis: Axis, by: f64) {
    let realised = &mut measurement.result.realised;
    let RealisedAxis { parameters, mut elements } = realised.of(axis).expect("an axis").clone();
    elements.iter_mut().for_each(|value| *value += by);
    realised.add(axis, parameters, elements);
}

#[tokio::test]
async fn an_axis_realised_differently_in_simultaneous_is_refused_and_named() {
    let (_bench, mut worker, leases) = leases_of(json!({})).await;
    let [nominal, camera, sensor, simultaneous] = leases.as_slice() else {
        panic!("{} leases", leases.len());
    };
    worker.commit_all([nominal, camera, sensor], true).await;
    let shifted = |of: &mut Measurement| shift_elements(of, Axis::Sensor, 0.5);
    let (verdict, detail) = commit_altered(&mut worker, simultaneous, shifted).await;
    assert_eq!(verdict, Verdict::Unpaired);
    assert_contains(
        &detail,
        &["realisation of axis sensor", "object/t0/sensor/L1/c00", "worker `a`"],
    );
}

/// In reference mode, the sensor's random values are drawn anew in every rollout; the camera has no
/// random values.
#[tokio::test]
async fn in_reference_mode_the_sensor_may_differ_from_siblings_and_the_camera_may_not() {
    let verdict_of = async |axis: Axis| {
        let (_bench, mut worker, leases) = leases_of(json!({"realisation": "reference"})).await;
        worker.commit_all(&leases[..3], true).await;
        let shifted = |of: &mut Measurement| shift_elements(of, axis, 0.5);
        commit_altered(&mut worker, &leases[3], shifted).await.0
    };
    assert_eq!(verdict_of(Axis::Sensor).await, Verdict::Accepted);
    assert_eq!(verdict_of(Axis::Camera).await, Verdict::Unpaired);
}

#[tokio::test]
async fn a_replicate_with_other_realised_values_is_refused() {
    let twice = json!({"axes": ["camera"], "nominal": "none", "replicates": 2});
    let (_bench, mut worker, leases) = leases_of(twice).await;
    assert_eq!(worker.commit(&leases[0], true).await, Verdict::Accepted);
    let shifted = |of: &mut Measurement| shift_elements(of, Axis::Camera, 0.5);
    let (verdict, detail) = commit_altered(&mut worker, &leases[1], shifted).await;
    assert_eq!(verdict, Verdict::Unpaired);
    assert!(detail.contains("axis camera"), "{detail}");
}

#[tokio::test]
async fn a_replicate_with_another_first_frame_is_refused() {
    let twice = json!({"axes": ["camera"], "nominal": "none", "replicates": 2});
    let (_bench, mut worker, leases) = leases_of(twice).await;
    let with_first_frame = |frame: &str| {
        let frame = sha(frame);
        move |of: &mut Measurement| of.result.digests.first_frame = frame
    };
    let first = commit_altered(&mut worker, &leases[0], with_first_frame("one")).await;
    assert_eq!(first.0, Verdict::Accepted);
    let (verdict, detail) = commit_altered(&mut worker, &leases[1], with_first_frame("two")).await;
    assert_eq!(verdict, Verdict::Unpaired);
    assert_contains(&detail, &["first-frame digest", &sha("one"), &sha("two")]);
}

#[tokio::test]
async fn conditions_without_visual_perturbation_must_have_the_nominal_first_frame() {
    let (_bench, mut worker, leases) =
        leases_of(json!({"axes": ["camera", "actuation", "language"]})).await;
    let mut commit_frame = async |lease: &wire::Lease, frame: &str| {
        let frame = sha(frame);
        commit_altered(&mut worker, lease, |of| of.result.digests.first_frame = frame).await
    };
    let [nominal, camera, actuation, language, simultaneous] = leases.as_slice() else {
        panic!("{} leases", leases.len());
    };
    for (lease, frame) in [(nominal, "nominal"), (camera, "moved"), (actuation, "nominal")] {
        assert_eq!(commit_frame(lease, frame).await.0, Verdict::Accepted);
    }
    let (verdict, detail) = commit_frame(language, "moved").await;
    assert_eq!(verdict, Verdict::Unpaired);
    assert!(detail.contains("object/t0/nominal/i"), "{detail}");
    // In this simultaneous rollout, only the camera axis affects the first frame.
    let (verdict, detail) = commit_frame(simultaneous, "nominal").await;
    assert_eq!(verdict, Verdict::Unpaired);
    assert!(detail.contains("object/t0/camera/L1/c00"), "{detail}");
}

/// Regression: results from two kinds of processor, whose last bits differ, were refused
/// as inconsistent with each other.
#[tokio::test]
async fn last_bit_differences_of_processors_are_accepted_and_stored() {
    for (by, expected) in
        [(1e-9, Verdict::Accepted), (-1e-9, Verdict::Accepted), (1e-6, Verdict::Unpaired)]
    {
        let (bench, mut worker, leases) = leases_of(json!({})).await;
        worker.commit_all(&leases[..3], true).await;
        let shifted = |of: &mut Measurement| shift_elements(of, Axis::Camera, by);
        let (verdict, detail) = commit_altered(&mut worker, &leases[3], shifted).await;
        assert_eq!(verdict, expected, "{by}: {detail}");
        if verdict == Verdict::Accepted {
            let pool = bench.database().await;
            let stored: f64 = sqlx::query_scalar(
                "SELECT outcome ->> '$.realised.camera.elements[0]' FROM result WHERE job_id = ?",
            )
            .bind(leases[3].job_id)
            .fetch_one(&pool)
            .await
            .expect("a value");
            pool.close().await;
            assert_eq!(stored, 0.5 + by);
        }
    }
}

/// A result is stored as it was sent, to the last bit, and its origin with printable texts.
#[tokio::test]
async fn a_result_is_stored_as_it_was_sent() {
    let (bench, mut worker, lease) = commit_siblings().await;
    let report = worker.report_altered(&lease, true, |Measurement { result, provenance }| {
        (result.wall_secs, result.prompt) = (0.1 + 0.2, Some("pick\nup \u{1b}".to_owned()));
        result.ik =
            Some(IkResidual { residual_mm: 1.0 / 3.0, residual_deg: 5e-324, clamped_joints: 1 });
        result.digests.first_frame = sha("first frame");
        "e\u{9b}".clone_into(&mut provenance.host);
        let settings = &mut provenance.policy_settings;
        settings.insert(CONNECTED_SINCE.to_owned(), "\u{1b}[2K".to_owned());
    });
    let printed = report.measurement.replace('\u{9b}', "\u{fffd}").replace("\\u001b[", "\u{fffd}[");
    assert_eq!(worker.commit_request(report).await.0, Verdict::Accepted);
    let pool = bench.database().await;
    let stored: (String, String) = sqlx::query_as(
        "SELECT outcome, origin FROM result r JOIN provenance v ON v.id = r.provenance_id
         WHERE job_id = ?",
    )
    .bind(lease.job_id)
    .fetch_one(&pool)
    .await
    .expect("a result");
    pool.close().await;
    let (outcome, origin) = stored;
    assert_eq!(format!(r#"{{"result":{outcome},"provenance":{origin}}}"#), printed);
}

/// Wrong types, and fields that this program does not know, are named; `benchmark` tests the
/// bounds.
#[tokio::test]
async fn a_result_that_no_worker_of_this_protocol_sends_is_refused_by_field() {
    let (bench, mut worker, lease) = commit_siblings().await;
    let valid = worker.report(&lease, true);
    let replaced = |from: &str, to: &str| {
        let measurement = valid.measurement.replacen(from, to, 1);
        assert_ne!(measurement, valid.measurement, "{from}");
        wire::CommitRequest { measurement, ..valid.clone() }
    };
    for (request, word) in [
        (wire::CommitRequest { measurement: String::new(), ..valid.clone() }, "`measurement`"),
        (wire::CommitRequest { attempt_id: String::new(), ..valid.clone() }, "attempt id"),
        (replaced("\"success\":true,", ""), "`success`"),
        (replaced("\"steps\":120", "\"steps\":-1"), "`steps`"),
        (replaced("\"wall_secs\":1.5", "\"wall_secs\":null"), "`wall_secs`"),
        (replaced("\"scene\":", "\"colour\":1,\"scene\":"), "`colour`"),
        (replaced("\"host\":", "\"hostess\":1,\"host\":"), "`hostess`"),
        (replaced("\"sensor\":", "\"smell\":"), "smell"),
        (replaced("\"at_end\":2", "\"at_end\":1"), "`goal`"),
        (replaced("\"host\":\"", &format!("\"host\":\"{}", "x".repeat(1 << 20))), "`host`"),
    ] {
        assert_refused(worker.service.commit(request).await, Code::InvalidArgument, &[word]);
    }
    assert_eq!(bench.status("paired").await.rollouts.leased, 1, "the lease is kept");
}

/// Without this check, a result with more control steps than its row allows would be paired and
/// reported.
#[tokio::test]
async fn a_result_that_does_not_fit_its_row_is_refused_with_the_bound_named() {
    for (steps, clipped, verdict, words) in [
        (280, 280, Verdict::Accepted, ""),
        (281, 0, Verdict::Unpaired, "281 control steps, and its manifest row allows 280"),
        (280, 281, Verdict::Unpaired, "281 clipped actions in 280 control steps"),
    ] {
        let (bench, mut worker, lease) = commit_siblings().await;
        let report = worker.report_altered(&lease, false, |of| {
            (of.result.steps, of.result.clipped_actions) = (steps, clipped);
        });
        let (given, detail) = worker.commit_request(report).await;
        assert_eq!(given, verdict, "{detail}");
        assert!(detail.contains(words), "{detail}");
        let charged = "SELECT count(*) FROM failure WHERE reason = 'unpaired' AND charged = 1";
        let refused = i64::from(verdict == Verdict::Unpaired);
        assert_eq!(bench.count(charged).await, refused);
    }
}

/// Regression: an unreadable sibling failed every commit for its initial state, as if the database
/// were down.
#[tokio::test]
async fn an_unreadable_sibling_is_named_and_charges_no_attempt() {
    let (bench, _, _) = commit_siblings().await;
    let pool = bench.database().await;
    sqlx::query("UPDATE result SET outcome = json_set(outcome, '$.realised.camera', 7)")
        .execute(&pool)
        .await
        .expect("altered");
    pool.close().await;
    // A restart drops the cached results of running campaigns.
    let bench = bench.restart().await;
    bench.advance(61).await;
    let (mut worker, lease) = bench.worker_with_lease("b").await;
    let report = worker.report(&lease, true);
    let (verdict, detail) = worker.commit_request(report).await;
    assert_eq!(verdict, Verdict::Unpaired);
    assert!(detail.contains("siblings cannot be read"), "{detail}");
    let uncharged = "SELECT count(*) FROM failure WHERE reason = 'unsuited' AND charged = 0";
    assert_eq!(bench.count(uncharged).await, 1);
    // Other calls to the coordinator still succeed.
    assert_eq!(bench.status("paired").await.rollouts.committed, 2);
}
