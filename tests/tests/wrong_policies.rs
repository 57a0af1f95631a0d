//! Policies with invalid answers, through the whole chain of real processes: no such answer becomes
//! an outcome, and no other campaign is affected.

use std::path::Path;
use std::process::Command;
use std::time::{Duration, Instant};

use tests::programs::{Campaigns, Process, program};

/// Longest wait for words in the output of a command that is repeated.
const PATIENCE: Duration = Duration::from_secs(120);
/// A policy server built with the package `rollout_policies`, whose actions repeat one number seven
/// times.
const INVALID_POLICY: &str = "\
import numpy as np
from rollout_policies import Description, Policy, serve

class Invalid(Policy):
    description = Description(name='invalid')

    def warm_up(self):
        pass  # A warm-up would detect the invalid answer before the first query.

    def reset(self, episode):
        pass

    def infer(self, observation):
        return np.full(7, NUMBER)

serve(Invalid())
";

/// Starts a gateway with the policies `invalid`, whose actions consist of `number`, and `noop`, and
/// creates a campaign of `invalid`. Returns the programs; `None` if no interpreter is configured.
fn start_campaigns(test: &str, number: &str, data: &Path) -> Option<(Campaigns, Process)> {
    let Some(python) = std::env::var_os("ROLLOUT_PYTHON") else {
        eprintln!("SKIPPED {test}: `cargo xtask test` sets ROLLOUT_PYTHON");
        return None;
    };
    let program_text = INVALID_POLICY.replace("NUMBER", number);
    let policy = Process::serve(Command::new(python).args(["-u", "-c", &program_text]));
    let route = format!("invalid={}", policy.url.replacen("http://", "grpc://", 1));
    let mut campaigns = Campaigns::start(data);
    let mut gateway = Command::new(program("policy-gateway"));
    gateway.args(["--listen", "127.0.0.1:0", "--route", &route]);
    gateway.args(["--route", "noop=builtin:noop"]);
    campaigns.gateway = Process::serve(&mut gateway);
    campaigns.create("invalid", "invalid", "libero_object/0", "0");
    Some((campaigns, policy))
}

/// Repeats a command until its output contains some words.
fn wait_for(campaigns: &Campaigns, arguments: &[&str], words: &str) {
    let deadline = Instant::now() + PATIENCE;
    loop {
        let printed = campaigns.succeed(arguments);
        if printed.contains(words) {
            return;
        }
        assert!(Instant::now() < deadline, "{printed}");
        std::thread::sleep(Duration::from_millis(200));
    }
}

#[test]
fn actions_of_1e9_become_no_outcome() {
    let data = tempfile::tempdir().unwrap();
    let test = "actions_of_1e9_become_no_outcome";
    let Some((campaigns, _policy)) = start_campaigns(test, "1e9", data.path()) else {
        return;
    };
    let _worker = Process::worker(&campaigns.coordinator.url, 1, "primitives");
    let show = ["jobs", "invalid", "object/t0/camera/L3/c00"];
    let named = "component 0 of action 0 is 1e9, and actions lie within -1..1";
    wait_for(&campaigns, &show, named);
    assert!(campaigns.outcomes("invalid").is_empty());
}

#[test]
fn a_policy_that_answers_nan_delays_no_other_campaign() {
    let data = tempfile::tempdir().unwrap();
    let test = "a_policy_that_answers_nan_delays_no_other_campaign";
    let Some((campaigns, _policy)) = start_campaigns(test, "np.nan", data.path()) else {
        return;
    };
    let worker = Process::worker(&campaigns.coordinator.url, 1, "primitives");
    // The policy is paused after five attempts; the worker must continue.
    let status = ["campaign", "status", "invalid"];
    wait_for(&campaigns, &status, "policy `invalid` is paused");
    campaigns.create("unaffected", "noop", "libero_object/0", "0");
    campaigns.wait_for_commits("unaffected", None);
    assert_eq!(campaigns.outcomes("unaffected").len(), 7);
    assert!(campaigns.outcomes("invalid").is_empty());
    // The same worker retries the policy until its rollouts are quarantined.
    let list = ["jobs", "invalid", "--state", "quarantined"];
    wait_for(&campaigns, &list, "object/t0/");
    let workers = campaigns.succeed(&["workers"]);
    assert!(workers.contains("slots busy"), "{workers}");
    drop(worker);
}
