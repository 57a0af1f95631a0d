//! Helpers for tests of searches: workers that report planted outcomes, that is, outcomes
//! given by a function of the rollout's id, and coordinators that are killed.

use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use benchmark::RolloutId;
use paired::Outcome;
use proto::coordinator::commit_response::Verdict;
use queue::{FAILPOINT_VARIABLE, Side, Step, invariants};
use serde_json::Value;
use sha2::{Digest, Sha256};

use crate::harness::{Worker, rollout_id};
use crate::process::{Serve, coordinator, succeed, succeed_in_json};

/// Longest time that a campaign with planted outcomes may take.
pub(crate) const PATIENCE: Duration = Duration::from_secs(60);

pub(crate) type Planted = fn(&RolloutId) -> Outcome;

/// Runs waiting jobs until none is left.
pub(crate) async fn run_all(worker: &mut Worker, planted: Planted) {
    loop {
        let leases = worker.claim(64).await;
        if leases.is_empty() {
            return;
        }
        for lease in &leases {
            let id = rollout_id(lease).parse().expect("an id");
            let success = planted(&id) == Outcome::Success;
            assert_eq!(worker.commit(lease, success).await, Verdict::Accepted);
        }
    }
}

pub(crate) fn findings(serve: &Serve, command: &str, arguments: &[&str]) -> Value {
    succeed_in_json(serve.command(&[&[command, "first", "--json"], arguments].concat()))
}

pub(crate) async fn searched(
    serve: &Serve,
    worker: &mut Worker,
    arguments: &[&str],
    planted: Planted,
) -> Value {
    let arguments = [arguments, &["--create", "--json", "--connect", &serve.url]].concat();
    let arguments: Vec<String> = arguments.into_iter().map(str::to_owned).collect();
    let search = tokio::task::spawn_blocking(move || {
        coordinator(&arguments.iter().map(String::as_str).collect::<Vec<_>>())
    });
    let began = Instant::now();
    while !search.is_finished() {
        run_all(worker, planted).await;
        assert!(began.elapsed() < PATIENCE, "the search does not end");
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
    let findings = succeed_in_json(search.await.expect("runs"));
    assert_eq!(findings["complete"], true);
    findings
}

pub(crate) async fn complete_findings(
    serve: &Serve,
    command: &str,
    arguments: &[&str],
    planted: Planted,
) -> Value {
    let mut worker = serve.worker("w").await;
    searched(serve, &mut worker, &[&[command, "first"], arguments].concat(), planted).await
}

/// Asserts the rollouts that a search has chosen: their number, and the first digits of a SHA-256.
pub(crate) fn assert_rows(serve: &Serve, name: &str, expected: (usize, &str)) {
    let exported = succeed(serve.command(&["export", name, "--format", "jsonl"]));
    let rows = exported.lines().map(|line| serde_json::from_str::<Value>(line).expect("JSON"));
    let id = |row: Value| {
        let id: RolloutId = serde_json::from_value(row["rollout_id"].clone()).expect("an id");
        format!("{}#{}", id.published(), row["replicate"])
    };
    let mut rows: Vec<String> = rows.map(id).collect();
    rows.sort();
    let digest = hex::encode(&Sha256::digest(rows.join("\n"))[..8]);
    assert_eq!((rows.len(), digest.as_str()), expected, "{name}");
}

/// Asserts that a search has the same findings whether or not its coordinator and its command are
/// killed, around transactions of each kind. `create` makes the source campaign `first`.
pub(crate) async fn assert_kills_change_nothing(
    create: fn(&Serve),
    command: &str,
    planted: Planted,
) {
    let undisturbed = tempfile::tempdir().expect("a temporary folder");
    let serve = Serve::start(undisturbed.path());
    create(&serve);
    let expected = complete_findings(&serve, command, &[], planted).await;
    drop(serve);

    let (folder, serve) = Serve::anew();
    create(&serve);
    let mut worker = serve.worker("first").await;
    run_all(&mut worker, planted).await;
    drop(serve);
    kill_around_every_transaction(folder.path(), &[command, "first", "--create"], planted).await;
    let serve = Serve::start_with(folder.path(), &["--lease-secs", "3"], Stdio::null());
    let findings = complete_findings(&serve, command, &[], planted).await;
    assert_eq!(findings, expected);
}

/// Kills the coordinator of a folder before or after a transaction of each kind that a search
/// needs, and the search with it, in consecutive runs, each of which continues where the previous
/// run was killed. Asserts after each run that every invariant holds.
async fn kill_around_every_transaction(folder: &Path, search: &[&str], planted: Planted) {
    for (side, step, occurrence) in [
        (Side::Before, Step::CreateCampaign, 1),
        (Side::Before, Step::AppendRows, 1),
        (Side::After, Step::AppendRows, 1),
        (Side::Before, Step::Claim, 5),
        (Side::After, Step::Claim, 5),
        (Side::Before, Step::Commit, 9),
        (Side::After, Step::Commit, 9),
        (Side::Before, Step::AppendRows, 1),
        (Side::After, Step::AppendRows, 1),
    ] {
        let point = format!("{side:?}:{step:?}:{occurrence}");
        kill_at_failpoint(folder, &point, search, planted).await;
        let violations = invariants::check(folder).await.expect("a database");
        assert_eq!(violations, [], "{point}");
    }
}

/// Serves a folder until the process is killed at a failpoint, while a command runs and a worker
/// runs jobs, except those without a planted outcome. Then kills the command.
pub(crate) async fn kill_at_failpoint(
    folder: &Path,
    point: &str,
    command: &[&str],
    planted: impl Fn(&RolloutId) -> Outcome,
) {
    let program = || Command::new(env!("CARGO_BIN_EXE_coordinator"));
    let child = program()
        .args(["serve", "--listen", "127.0.0.1:0", "--lease-secs", "3", "--data"])
        .arg(folder)
        .env(FAILPOINT_VARIABLE, point)
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .expect("starts");
    let mut serve = Serve::wait_until_listening(child);
    let began = Instant::now();
    if serve.is_ready() {
        let (url, mut silent) = (["--connect", &serve.url], program());
        silent.args(command).args(url).stdout(Stdio::null()).stderr(Stdio::null());
        let mut command = silent.spawn().expect("starts");
        if let Ok(mut worker) = serve.try_worker("dying").await {
            while serve.ended().is_none() {
                assert!(began.elapsed() < PATIENCE, "{point} was never reached");
                let Ok(claim) = worker.try_claim(0.05, "").await else {
                    continue;
                };
                if let Some(lease) = claim.lease {
                    let id = rollout_id(&lease).parse().expect("an id");
                    if let Some(success) = planted(&id).success() {
                        let _ = worker.try_commit(&lease, success).await;
                    }
                }
            }
        }
        let _ = command.kill();
        command.wait().expect("a child");
    }
}
