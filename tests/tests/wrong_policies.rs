//! A policy with invalid answers, through the whole chain of real processes: no such answer becomes
//! an outcome, and no other campaign is affected.

use std::process::Command;
use std::time::{Duration, Instant};

use tests::programs::{Campaigns, Process, program};

/// Longest wait for words in the output of a command that is repeated.
const PATIENCE: Duration = Duration::from_secs(120);
/// A policy server built with the package `rollout_policies`, whose actions are no numbers.
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
        return np.full(7, np.nan)

serve(Invalid())
";

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
fn a_policy_that_answers_nan_delays_no_other_campaign() {
    let Some(python) = std::env::var_os("ROLLOUT_PYTHON") else {
        eprintln!(
            "SKIPPED a_policy_that_answers_nan_delays_no_other_campaign: `cargo xtask test` sets \
             ROLLOUT_PYTHON"
        );
        return;
    };
    let policy = Process::serve(Command::new(python).args(["-u", "-c", INVALID_POLICY]));
    let route = format!("invalid={}", policy.url.replacen("http://", "grpc://", 1));
    let data = tempfile::tempdir().unwrap();
    let mut campaigns = Campaigns::start(data.path());
    let mut gateway = Command::new(program("policy-gateway"));
    gateway.args(["--listen", "127.0.0.1:0", "--route", &route]);
    gateway.args(["--route", "noop=builtin:noop"]);
    campaigns.gateway = Process::serve(&mut gateway);
    campaigns.create("invalid", "invalid", "libero_object/0", "0");
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
