//! Rollouts with an outcome.

use benchmark::ManifestRow;
use benchmark::attempt::{GoalProgress, Realised};
use proto::coordinator::release_request::Reason;

use crate::scripted_coordinator::{ScriptedCoordinator, WorkerMessage};
use crate::scripted_policy::{FRAME_SIDE, HORIZON, ScriptedPolicy};
use crate::worker_process::{MAX_STEPS, WorkerProcess, attempt_id, lease, ready, run};

#[tokio::test(flavor = "multi_thread")]
async fn a_result_carries_its_provenance() {
    if !ready("a_result_carries_its_provenance") {
        return;
    }
    let coordinator = ScriptedCoordinator::start().await;
    let policy = ScriptedPolicy::start().await;
    coordinator.lease(lease(1, "observing", &policy.url()));
    let _worker = WorkerProcess::start(&coordinator.url());

    let WorkerMessage::Registered(registered) = coordinator.message(0).await else {
        panic!("a worker registers first");
    };
    let commit = coordinator.message(1).await.commit();
    assert_eq!(commit.attempt_id, attempt_id(1));

    let (result, provenance) = (commit.result, commit.provenance);
    assert_eq!((result.success, result.steps), (false, MAX_STEPS));
    assert_eq!(result.policy_queries, MAX_STEPS / HORIZON);
    assert_eq!((result.clipped_actions, result.ik), (0, None));
    assert_eq!(result.goal, GoalProgress { predicates: 1, at_end: 0, at_most: 0 });
    assert_eq!(result.digests.first_frame.len(), 64, "{result:#?}");
    assert_eq!(result.realised, Realised::default());
    let pin = &provenance.pin;
    assert_eq!(pin.asset_pack, "primitives");
    assert_eq!(pin.asset_pack_digest, registered.asset_pack_digest);
    assert_eq!(pin.mujoco_version, "3.3.7");
    assert_eq!(provenance.policy_name, "observing");
    assert_eq!(provenance.policy_checkpoint, "scripted");
    assert_eq!((&pin.renderer, &provenance.host), (&registered.renderer, &registered.host));
    assert!(!provenance.policy_privileged);
    assert_eq!(provenance.batch_mode, "single");
    assert_eq!(provenance.realisation, "matched");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_policy_gets_the_requested_observation_once_per_query() {
    if !ready("a_policy_gets_the_requested_observation_once_per_query") {
        return;
    }
    let coordinator = ScriptedCoordinator::start().await;
    let policy = ScriptedPolicy::start().await;
    coordinator.lease(lease(1, "observing", &policy.url()));
    let _worker = WorkerProcess::start(&coordinator.url());
    coordinator.message(1).await.commit();

    let received = policy.received.lock().expect("unpoisoned");
    let [reset] = received.resets.as_slice() else { panic!("{:?}", received.resets) };
    let session = format!("object/t0/nominal/i03#r0#{}", attempt_id(1));
    assert_eq!(reset.session, session);
    assert_eq!((reset.suite.as_str(), reset.seed), ("libero_object", 7));
    assert_eq!(reset.instruction, "pick up the alphabet soup and place it in the basket");
    let indices: Vec<u32> = received.queries.iter().map(|query| query.query_index).collect();
    assert_eq!(indices, [0, 1, 2]);
    for query in &received.queries {
        let sent_observation = query.observation.as_ref().expect("an observation");
        let frames: Vec<_> = sent_observation.images.iter().map(|image| image.rgb.len()).collect();
        assert_eq!(frames, [(FRAME_SIDE * FRAME_SIDE * 3) as usize; 2]);
        let widths: Vec<_> =
            sent_observation.state.iter().map(|reading| reading.values.len()).collect();
        assert_eq!(widths, [3, 3, 2]);
        assert!(sent_observation.privileged.is_none());
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_canonical_only_policy_gets_no_paraphrase() {
    if !ready("a_canonical_only_policy_gets_no_paraphrase") {
        return;
    }
    let coordinator = ScriptedCoordinator::start().await;
    let policy = ScriptedPolicy::start().await;
    for (job, name) in [(1, "observing"), (2, "by-heart")] {
        let mut lease = lease(job, name, &policy.url());
        let mut row: ManifestRow = serde_json::from_str(&lease.manifest_row).expect("a row");
        row.instruction = "kindly put the soup into the basket".to_owned();
        lease.manifest_row = serde_json::to_string(&row).expect("JSON");
        coordinator.lease(lease);
    }
    let _worker = WorkerProcess::start(&coordinator.url());
    for number in 1..=2 {
        coordinator.message(number).await.commit();
    }
    let received = policy.received.lock().expect("unpoisoned");
    let instructions: Vec<_> = received
        .resets
        .iter()
        .map(|reset| (reset.policy.as_str(), reset.instruction.as_str()))
        .collect();
    assert_eq!(
        instructions,
        [
            ("observing", "kindly put the soup into the basket"),
            ("by-heart", "pick up the alphabet soup and place it in the basket"),
        ]
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn actions_beyond_the_range_are_clipped_and_counted() {
    if !ready("actions_beyond_the_range_are_clipped_and_counted") {
        return;
    }
    let coordinator = ScriptedCoordinator::start().await;
    let policy = ScriptedPolicy::start().await;
    coordinator.lease(lease(1, "wild", &policy.url()));
    let _worker = WorkerProcess::start(&coordinator.url());
    let result = coordinator.message(1).await.commit().result;
    assert_eq!(result.clipped_actions, MAX_STEPS);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_rollout_without_frames_names_its_slots_renderer_too() {
    if !ready("a_rollout_without_frames_names_its_slots_renderer_too") {
        return;
    }
    let coordinator = ScriptedCoordinator::start().await;
    let policy = ScriptedPolicy::start().await;
    for (job, name) in [(1, "still"), (2, "observing")] {
        coordinator.lease(lease(job, name, &policy.url()));
    }
    let _worker = WorkerProcess::start(&coordinator.url());
    let without_frames = coordinator.message(1).await.commit();
    let observing = coordinator.message(2).await.commit();
    assert_eq!(without_frames.result.digests.first_frame, "");
    assert_eq!(observing.result.digests.first_frame.len(), 64);
    let (without_frames, observing) = (without_frames.provenance, observing.provenance);
    assert_eq!(without_frames.pin.renderer, observing.pin.renderer);
    assert_eq!(without_frames.fingerprint, observing.fingerprint);
}

#[tokio::test(flavor = "multi_thread")]
async fn the_same_rollout_has_the_same_outcome_and_frames_every_time() {
    if !ready("the_same_rollout_has_the_same_outcome_and_frames_every_time") {
        return;
    }
    let coordinator = ScriptedCoordinator::start().await;
    let policy = ScriptedPolicy::start().await;
    for job in 1..=2 {
        coordinator.lease(lease(job, "observing", &policy.url()));
    }
    let _worker = WorkerProcess::start(&coordinator.url());
    let [first, second] = [coordinator.message(1).await, coordinator.message(2).await];
    let [first, second] = [first.commit(), second.commit()];
    assert_eq!(first.provenance, second.provenance);
    assert_eq!(first.result.digests, second.result.digests);
    let received = policy.received.lock().expect("unpoisoned");
    let (first, second) = received.queries.split_at(received.queries.len() / 2);
    for (first, second) in first.iter().zip(second) {
        assert!(first.observation == second.observation, "query {}", first.query_index);
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn an_outcome_is_kept_until_the_coordinator_is_back() {
    if !ready("an_outcome_is_kept_until_the_coordinator_is_back") {
        return;
    }
    let mut coordinator = ScriptedCoordinator::start().await;
    let policy = ScriptedPolicy::start().await;
    coordinator.lease(lease(1, "slow", &policy.url()));
    let worker = WorkerProcess::start(&coordinator.url());
    coordinator.wait_for_progress(1, 10).await;
    coordinator.stop();
    // Three answers take 200 ms each, so the rollout ends during the outage.
    tokio::time::sleep(std::time::Duration::from_secs(3)).await;
    assert_eq!(coordinator.messages().len(), 1);
    coordinator.restart().await;
    coordinator.message(1).await.commit();

    let log = worker.terminated();
    assert_eq!(log.matches("cannot be reached").count(), 1, "{log}");
    assert_eq!(log.matches("answers again").count(), 1, "{log}");
}

#[tokio::test(flavor = "multi_thread")]
async fn worker_rollout_writes_its_result_and_frames() {
    if !ready("worker_rollout_writes_its_result_and_frames") {
        return;
    }
    let policy = ScriptedPolicy::start().await;
    let folder = tempfile::tempdir().expect("a folder");
    let output = folder.path().to_str().expect("UTF-8").to_owned();
    let url = policy.url();
    let ran = tokio::task::spawn_blocking(move || {
        run(&[
            "rollout",
            "--id",
            "spatial/t0/sensor/L3/c00",
            "--assets",
            "primitives",
            "--policy",
            "observing",
            "--endpoint",
            &url,
            "--output",
            &output,
            "--no-video",
        ])
    });
    let ran = ran.await.expect("runs");
    assert!(ran.status.success(), "{}", String::from_utf8_lossy(&ran.stderr));
    let result = std::fs::read(folder.path().join("result.json")).expect("a result");
    let result: serde_json::Value = serde_json::from_slice(&result).expect("JSON");
    assert_eq!(result["finished"]["outcome"]["steps"], 220);
    let realised = &result["finished"]["outcome"]["realised"]["sensor"];
    assert!(realised["parameters"].is_array(), "{result}");
    for picture in ["query-000-agentview.png", "query-027-robot0_eye_in_hand.png"] {
        let picture = image::open(folder.path().join("frames").join(picture)).expect(picture);
        assert_eq!((picture.width(), picture.height()), (FRAME_SIDE, FRAME_SIDE));
    }
}

/// Recorded actions need no observations, so nothing is rendered without a video, and a missing
/// renderer does not matter.
#[test]
fn a_replay_without_pictures_opens_no_renderer() {
    if !ready("a_replay_without_pictures_opens_no_renderer") {
        return;
    }
    let folder = tempfile::tempdir().expect("a folder");
    let actions = folder.path().join("actions.jsonl");
    std::fs::write(&actions, "[0, 0, 0, 0, 0, 0, -1]\n".repeat(3)).expect("written");
    let (actions, output) = (actions.to_str(), folder.path().to_str());
    let (actions, output) = (actions.expect("UTF-8"), output.expect("UTF-8"));
    let line = format!(
        "rollout --id object/t0/nominal/i03 --assets primitives --actions {actions} \
         --output {output} --renderer gl:99"
    );
    let line: Vec<&str> = line.split_whitespace().collect();
    let ran = run(&line);
    let stderr = String::from_utf8_lossy(&ran.stderr);
    assert_eq!(ran.status.code(), Some(1), "a video needs a renderer: {stderr}");
    let ran = run(&[&line[..], &["--no-video"]].concat());
    let stderr = String::from_utf8_lossy(&ran.stderr);
    assert!(ran.status.success(), "{stderr}");
    let result = std::fs::read(folder.path().join("result.json")).expect("a result");
    let result: serde_json::Value = serde_json::from_slice(&result).expect("JSON");
    assert_eq!(result["finished"]["outcome"]["steps"], 3);
    let provenance = &result["finished"]["provenance"];
    assert_eq!((&provenance["renderer"], &provenance["fingerprint"]), (&"".into(), &"".into()));
}

/// A row that this version cannot read comes from another version. The attempt is released with the
/// reason and has no outcome.
#[tokio::test(flavor = "multi_thread")]
async fn an_unreadable_row_is_released_with_the_reason() {
    if !ready("an_unreadable_row_is_released_with_the_reason") {
        return;
    }
    let coordinator = ScriptedCoordinator::start().await;
    let mut unreadable = lease(1, "still", "http://127.0.0.1:9");
    unreadable.manifest_row = unreadable.manifest_row.replace("object/t0", "object/t1");
    coordinator.lease(unreadable);
    let _worker = WorkerProcess::start(&coordinator.url());
    let release = coordinator.message(1).await.release(Reason::SimulatorError);
    assert!(release.error.contains("`task_id` is 0"), "{}", release.error);
}
