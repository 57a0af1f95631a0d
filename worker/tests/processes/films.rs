//! Videos of finished rollouts, made from their actions. In these tests, the worker takes the
//! address of the coordinator from the environment.

use std::process::Output;

use benchmark::ManifestRow;
use proto::coordinator::{Film, Lease};

use crate::scripted_coordinator::{ScriptedCoordinator, WorkerMessage};
use crate::scripted_policy::ScriptedPolicy;
use crate::worker_process::{MAX_STEPS, WorkerProcess, attempt_id, lease, program};

/// Size of a point: three 16-bit numbers.
const POINT_BYTES: usize = 6;
/// Size of an action: seven 32-bit numbers.
const ACTION_BYTES: usize = 28;

/// Runs a rollout that stores its actions; returns the film to be made of it.
async fn filmable_rollout(coordinator: &ScriptedCoordinator) -> Film {
    film_of(coordinator, lease(1, "still", "")).await
}

/// Runs a leased rollout that stores its actions; returns the film to be made of it.
async fn film_of(coordinator: &ScriptedCoordinator, mut job_lease: Lease) -> Film {
    let policy = ScriptedPolicy::start().await;
    job_lease.policy_endpoint = policy.url();
    job_lease.keep_actions = true;
    coordinator.lease(job_lease.clone());
    let has_video = job_lease.record_video;
    let mut serve = program();
    serve.env("COORDINATOR_URL", coordinator.url());
    let _worker = WorkerProcess::start_command(serve.args(["--assets", "primitives"]));
    let commit = coordinator.message(1).await.commit();
    if has_video {
        coordinator.message(2).await;
    }
    let motion = commit.motion;
    assert_eq!(motion.path.len(), (MAX_STEPS as usize + 1) * POINT_BYTES);
    assert_eq!(motion.actions.len(), MAX_STEPS as usize * ACTION_BYTES);
    Film {
        attempt_id: commit.attempt_id,
        campaign: job_lease.campaign,
        replicate: job_lease.replicate,
        manifest_row: job_lease.manifest_row,
        realisation: job_lease.realisation,
        actions: motion.actions,
        success: commit.result.success,
    }
}

/// Runs `worker film` until it exits.
fn film_all(coordinator: &ScriptedCoordinator) -> Output {
    let mut film = program();
    film.env("COORDINATOR_URL", coordinator.url());
    film.args(["film", "--assets", "primitives"]);
    tokio::task::block_in_place(|| film.output().expect("runs"))
}

/// Returns the video that is the coordinator's `number`-th message, with its attempt.
async fn video(coordinator: &ScriptedCoordinator, number: usize) -> (String, Vec<u8>) {
    let WorkerMessage::Video { attempt, bytes } = coordinator.message(number).await else {
        panic!("{:?}", coordinator.messages());
    };
    (attempt, bytes)
}

#[tokio::test(flavor = "multi_thread")]
async fn a_rollout_is_filmed_from_its_actions_without_its_policy() {
    let coordinator = ScriptedCoordinator::start().await;
    let film = filmable_rollout(&coordinator).await;
    coordinator.film(film);
    let output = film_all(&coordinator);
    assert!(output.status.success(), "{output:?}");
    let summary = String::from_utf8(output.stdout).expect("text");
    assert_eq!(
        summary,
        "1 video stored; no rollout is left to film with asset pack primitives, MuJoCo 3.3.7 and look mujoco-3.3.2\n"
    );
    let (attempt, bytes) = video(&coordinator, 2).await;
    assert_eq!((attempt, &bytes[4..8]), (attempt_id(1), &b"ftyp"[..]));
}

#[tokio::test(flavor = "multi_thread")]
async fn several_rollouts_are_filmed_in_parallel_with_progress_in_the_log() {
    let coordinator = ScriptedCoordinator::start().await;
    let film = filmable_rollout(&coordinator).await;
    for number in 1..=3 {
        coordinator.film(Film { attempt_id: attempt_id(number), ..film.clone() });
    }
    let mut command = program();
    command.env("COORDINATOR_URL", coordinator.url());
    command.args(["film", "--assets", "primitives", "--at-a-time", "2"]);
    let output = tokio::task::block_in_place(|| command.output().expect("runs"));
    let log = String::from_utf8(output.stderr).expect("text");
    assert!(output.status.success(), "{log}");
    let summary = String::from_utf8(output.stdout).expect("text");
    assert!(summary.starts_with("3 videos stored; "), "{summary}");
    assert!(log.contains("filming 2 rollouts at a time"), "{log}");
    assert!(log.contains("(2 left)") && log.contains("(0 left)"), "{log}");
    assert_eq!(log.matches("filmed test object/t0/nominal/i03#r0 in ").count(), 3, "{log}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_film_that_ends_differently_from_its_rollout_is_not_stored() {
    let coordinator = ScriptedCoordinator::start().await;
    let mut film = filmable_rollout(&coordinator).await;
    film.success = !film.success;
    coordinator.film(film);
    let output = film_all(&coordinator);
    assert_eq!(output.status.code(), Some(1), "{output:?}");
    let log = String::from_utf8(output.stderr).expect("text");
    let expected = "its outcome differs from the first time";
    assert!(log.contains(expected), "{log}");
    assert_eq!(coordinator.messages().len(), 2, "no video");
}

/// Returns two films of one rollout: the film by the slot that simulated it, and the film by
/// `worker film`.
async fn films_of(row: &ManifestRow) -> [Vec<u8>; 2] {
    let coordinator = ScriptedCoordinator::start().await;
    let mut filmed = lease(1, "still", "");
    filmed.manifest_row = serde_json::to_string(row).expect("JSON");
    filmed.record_video = true;
    let film = film_of(&coordinator, filmed).await;
    coordinator.film(film);
    let output = film_all(&coordinator);
    assert!(output.status.success(), "{output:?}");
    let (_, by_the_slot) = video(&coordinator, 2).await;
    let (_, afterwards) = video(&coordinator, 3).await;
    [by_the_slot, afterwards]
}

#[tokio::test(flavor = "multi_thread")]
async fn a_later_film_equals_the_slots_film_and_shows_sensor_corruption() {
    let row = |id: String| {
        let row = benchmark::row_of(id.parse().expect("an id"));
        ManifestRow { max_steps: MAX_STEPS, ..row.expect("a row") }
    };
    let sensor = row("object/t0/sensor/L3/c03".to_owned());
    let nominal = row(format!("object/t0/nominal/i{:02}", sensor.init_id));
    let [by_the_slot, afterwards] = films_of(&sensor).await;
    assert!(by_the_slot == afterwards, "equal pictures give equal bytes");
    let [unperturbed, unperturbed_afterwards] = films_of(&nominal).await;
    assert!(unperturbed == unperturbed_afterwards, "equal pictures give equal bytes");
    assert!(by_the_slot != unperturbed, "the corruption is visible");
}
