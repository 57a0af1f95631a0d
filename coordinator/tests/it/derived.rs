//! Helpers for tests of derived campaigns: workers that report planted outcomes, that is, outcomes
//! given by a function of the rollout's id, and coordinators that are killed.

use std::path::Path;
use std::process::Stdio;
use std::time::{Duration, Instant};

use libero_ctrl::RolloutId;
use paired::Outcome;
use proto::coordinator::CreateCampaignRequest;
use proto::coordinator::commit_response::Verdict;
use proto::coordinator::operator_service_client::OperatorServiceClient;
use queue::{Side, Step};
use serde_json::{Value, json};

use crate::failpoints;
use crate::harness::{Worker, assert_sound, rollout_id};
use crate::process::{Serve, succeed_in_json};

/// Longest time that a campaign with planted outcomes may take.
pub(crate) const PATIENCE: Duration = Duration::from_secs(60);

/// Function that gives the planted outcome of a rollout.
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

/// Returns the findings of the campaign that `command` derives from the campaign `first`.
pub(crate) fn findings(serve: &Serve, command: &str, arguments: &[&str]) -> Value {
    let derive = [command, "first", "--create", "--json"];
    succeed_in_json(serve.command(&[&derive, arguments].concat()))
}

/// Runs all derived rollouts and returns the complete findings.
pub(crate) async fn complete_findings(
    serve: &Serve,
    command: &str,
    arguments: &[&str],
    planted: Planted,
) -> Value {
    let mut worker = serve.worker("w").await;
    let began = Instant::now();
    loop {
        run_all(&mut worker, planted).await;
        let findings = findings(serve, command, arguments);
        if findings["complete"] == json!(true) {
            return findings;
        }
        let waiting = &findings["waiting"];
        assert!(began.elapsed() < PATIENCE, "{waiting} rollouts still wait");
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
}

/// Asserts that a derived campaign has the same findings whether or not its coordinator is killed
/// around transactions of each kind. `create` makes the source campaign `first`; `key` is the field
/// of the derived campaign's specification that names the source.
pub(crate) async fn assert_kills_change_nothing(
    create: fn(&Serve),
    [command, name, key]: [&str; 3],
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
    let spec = json!({
        "name": name, key: {"campaign": "first"},
        "policy": {"name": "p", "endpoint": "http://127.0.0.1:50051"},
    });
    kill_around_every_transaction(folder.path(), &spec, planted).await;
    let serve = Serve::start_with(folder.path(), &["--lease-secs", "3"], Stdio::null());
    let findings = complete_findings(&serve, command, &[], planted).await;
    assert_eq!(findings, expected);
}

/// Kills the coordinator of a folder before or after a transaction of each kind that a campaign of
/// the specification needs, in consecutive runs, each of which continues where the previous run was
/// killed. Asserts after each run that every invariant holds.
async fn kill_around_every_transaction(folder: &Path, spec: &Value, planted: Planted) {
    for (side, step, occurrence) in [
        (Side::Before, Step::CreateCampaign, 1),
        (Side::Before, Step::Derive, 1),
        (Side::After, Step::Derive, 1),
        (Side::Before, Step::Claim, 5),
        (Side::After, Step::Claim, 5),
        (Side::Before, Step::Commit, 9),
        (Side::After, Step::Commit, 9),
        (Side::Before, Step::Derive, 2),
        (Side::After, Step::Derive, 2),
    ] {
        let point = format!("{side:?}:{step:?}:{occurrence}");
        kill_at_failpoint(folder, &point, spec, planted).await;
        assert_sound(folder).await;
    }
}

/// Serves a folder until the process is killed at a failpoint, while a campaign is created and a
/// worker runs its jobs, except those without a planted outcome.
pub(crate) async fn kill_at_failpoint(
    folder: &Path,
    point: &str,
    spec: &Value,
    planted: impl Fn(&RolloutId) -> Outcome,
) {
    let mut serve = Serve::wait_until_listening(failpoints::serve(folder, point));
    let began = Instant::now();
    if serve.is_ready() {
        // Calls the service directly, since the command would retry while the coordinator is down.
        let request = CreateCampaignRequest { spec: spec.to_string(), priority: 0 };
        if let Ok(mut operator) = OperatorServiceClient::connect(serve.url.clone()).await {
            let _ = operator.create_campaign(request).await;
        }
        let Ok(mut worker) = serve.try_worker("dying").await else {
            return;
        };
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
}
