//! Policies that answer nonsense, through the whole chain of real processes:
//! nothing of it becomes an outcome.

use std::process::Command;
use std::time::{Duration, Instant};

use tests::programs::{Campaigns, Process, program};

/// Longest that the first attempts may take.
const PATIENCE: Duration = Duration::from_secs(120);
/// A server whose actions are of no robot's units, made with the package that
/// policies' authors use.
const CROOKED: &str = "\
import numpy as np
from rollout_policies import Description, Policy, serve

class Crooked(Policy):
    description = Description(name='crooked')

    def reset(self, episode):
        pass

    def infer(self, observation):
        return np.full(7, 1e9)

serve(Crooked())
";

#[test]
fn actions_of_a_thousand_million_are_nobodys_failure() {
    let Some(python) = std::env::var_os("ROLLOUT_PYTHON") else {
        eprintln!(
            "SKIPPED actions_of_a_thousand_million_are_nobodys_failure: \
             `cargo xtask test` names the interpreter"
        );
        return;
    };
    let policy = Process::serve(Command::new(python).args(["-u", "-c", CROOKED]));
    let route = format!("crooked={}", policy.url.replacen("http://", "grpc://", 1));
    let data = tempfile::tempdir().unwrap();
    let mut campaigns = Campaigns::start(data.path());
    let mut gateway = Command::new(program("policy-gateway"));
    gateway.args(["--listen", "127.0.0.1:0", "--route", &route]);
    campaigns.gateway = Process::serve(&mut gateway);
    campaigns.create("crooked", "crooked", "libero_object/0", "0");
    let _worker = Process::worker(&campaigns.coordinator.url, 1, "primitives");
    let named = "component 0 of action 0 is 1e9, and actions lie within -1..1";
    let deadline = Instant::now() + PATIENCE;
    loop {
        let job = campaigns.succeed(&["jobs", "show", "crooked", "object/t0/camera/L3/c00"]);
        if job.contains(named) {
            break;
        }
        assert!(Instant::now() < deadline, "{job}");
        std::thread::sleep(Duration::from_millis(200));
    }
    assert!(campaigns.outcomes("crooked").is_empty());
}
