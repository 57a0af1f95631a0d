//! Videos of rollouts that are over, from their actions.

use proto::coordinator::Film;

use crate::scripted_coordinator::{ScriptedCoordinator, Told};
use crate::scripted_policy::ScriptedPolicy;
use crate::worker_process::{MAX_STEPS, WorkerProcess, attempt_id, lease, ready, run};

/// Three numbers of 16 bits.
const POINT_BYTES: usize = 6;
/// Seven numbers of 32 bits.
const ACTION_BYTES: usize = 28;

/// Runs a rollout whose actions are kept; what is to be filmed of it.
async fn a_film(coordinator: &ScriptedCoordinator) -> Film {
    let policy = ScriptedPolicy::start().await;
    let mut kept = lease(1, "still", &policy.url());
    kept.keep_actions = true;
    coordinator.lease(kept.clone());
    let _worker = WorkerProcess::start(&coordinator.url());
    let commit = coordinator.told(1).await.commit();
    let motion = commit.motion.expect("a motion");
    assert_eq!(motion.path.len(), (MAX_STEPS as usize + 1) * POINT_BYTES);
    assert_eq!(motion.actions.len(), MAX_STEPS as usize * ACTION_BYTES);
    Film {
        attempt_id: commit.attempt_id,
        campaign: kept.campaign,
        replicate: kept.replicate,
        manifest_row: kept.manifest_row,
        realisation: kept.realisation,
        actions: motion.actions,
        success: commit.result.expect("a result").success,
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_rollout_is_filmed_from_its_actions_when_its_policy_has_gone() {
    if !ready("a_rollout_is_filmed_from_its_actions_when_its_policy_has_gone") {
        return;
    }
    let coordinator = ScriptedCoordinator::start().await;
    let film = a_film(&coordinator).await;
    coordinator.film(film);
    let url = coordinator.url();
    let filming = || run(&["film", "--connect", &url, "--assets", "primitives"]);
    let output = tokio::task::block_in_place(filming);
    assert!(output.status.success(), "{output:?}");
    let said = String::from_utf8(output.stdout).expect("text");
    assert_eq!(
        said,
        "1 videos stored; no more is left to film with asset pack primitives and MuJoCo 3.3.7\n"
    );
    let Told::Video { attempt, bytes } = coordinator.told(2).await else {
        panic!("{:?}", coordinator.everything_told());
    };
    assert_eq!((attempt, &bytes[4..8]), (attempt_id(1), &b"ftyp"[..]));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_film_that_ends_otherwise_than_its_rollout_is_not_stored() {
    if !ready("a_film_that_ends_otherwise_than_its_rollout_is_not_stored") {
        return;
    }
    let coordinator = ScriptedCoordinator::start().await;
    let mut film = a_film(&coordinator).await;
    film.success = !film.success;
    coordinator.film(film);
    let url = coordinator.url();
    let filming = || run(&["film", "--connect", &url, "--assets", "primitives"]);
    let output = tokio::task::block_in_place(filming);
    assert_eq!(output.status.code(), Some(1), "{output:?}");
    let said = String::from_utf8(output.stderr).expect("text");
    assert!(said.contains("its goal held at another step"), "{said}");
    assert_eq!(coordinator.everything_told().len(), 2, "no video");
}
