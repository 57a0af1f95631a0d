//! Delays measured from a policy server, and a campaign that draws its delays from them, through
//! real processes.

use std::process::Command;

use benchmark::Delays;
use serde_json::Value;
use tests::programs::{Campaigns, Process, program};

/// A server built with the package `rollout_policies`, whose batches take 120 ms each.
const SLOW_SERVER: &str = "\
import time
import numpy as np
from rollout_policies import Description, Policy, serve

class Slow(Policy):
    description = Description(name='slow', horizon=40, execute=10, max_batch=8)

    def reset(self, episode):
        pass

    def infer(self, observation):
        return self.infer_batch([observation])[0]

    def infer_batch(self, observations):
        time.sleep(0.12)
        return [np.zeros((40, 7), np.float32) for _ in observations]

serve(Slow())
";
/// Fewest control steps of 50 ms that an answer of that server takes.
const MIN_DELAY_STEPS: u16 = 3;
/// Answers that are measured: 20 rounds of 8 episodes of 5 queries.
const ANSWERS: u64 = 800;

#[test]
fn a_campaign_draws_its_delays_from_a_servers_measured_latencies() {
    let Some(python) = std::env::var_os("ROLLOUT_PYTHON") else {
        let test = "a_campaign_draws_its_delays_from_a_servers_measured_latencies";
        eprintln!("SKIPPED {test}: `cargo xtask test` sets ROLLOUT_PYTHON");
        return;
    };
    let data = tempfile::tempdir().unwrap();
    let policy = Process::serve(Command::new(python).args(["-u", "-c", SLOW_SERVER]));
    let mut campaigns = Campaigns::start(data.path());
    let route = format!("slow={}", policy.url.replacen("http://", "grpc://", 1));
    let mut gateway = Command::new(program("policy-gateway"));
    gateway.args(["--listen", "127.0.0.1:0", "--route", &route]);
    campaigns.gateway = Process::serve(&mut gateway);
    let endpoint = campaigns.gateway.url.clone();

    let file = data.path().join("slow.json");
    let path = file.to_str().expect("UTF-8");
    let url = endpoint.replacen("http://", "grpc://", 1);
    let checked = Command::new(program("policy-gateway"))
        .args(["check", &format!("{url}/slow"), "--latency", path])
        .output()
        .expect("the check runs");
    let printed = String::from_utf8_lossy(&checked.stdout);
    let errors = String::from_utf8_lossy(&checked.stderr);
    assert!(checked.status.success(), "{printed}\n{errors}");
    let text = std::fs::read_to_string(&file).expect("a file of latencies");
    let written: Value = serde_json::from_str(&text).expect("JSON");
    assert_eq!(written["policy"], "slow");
    let counts = written["delay_steps"].as_object().expect("counts");
    let counted: u64 = counts.values().filter_map(Value::as_u64).sum();
    assert_eq!((counted, &written["answers"]), (ANSWERS, &ANSWERS.into()));
    let delays = Delays::from_json(&text).expect("delays");
    assert!(delays.shortest() >= MIN_DELAY_STEPS, "{text}");
    for part in [
        "latency with 8 rollouts at once: median ".to_owned(),
        format!(
            "--execution overlap:@{path}` draws delays from this distribution: overlap:{delays}"
        ),
    ] {
        assert!(printed.contains(&part), "{part}: {printed}");
    }

    #[rustfmt::skip]
    let created = campaigns.succeed(&[
        "campaign", "create", "--name", "measured", "--policy", "slow", "--endpoint", &endpoint,
        "--tasks", "libero_object/0", "--axes", "none", "--configs", "0",
        "--execution", &format!("overlap:@{path}"),
    ]);
    let model = format!("overlap:{delays}");
    let line = format!("execution model {model}: an answer takes effect after ");
    assert!(created.contains(&line), "{created}");
    assert!(!created.contains("is unknown"), "{created}");
    let _worker = Process::worker(&campaigns.coordinator.url, 1, "primitives");
    campaigns.wait_for_commits("measured", None);
    let outcomes = campaigns.outcomes("measured");
    assert_eq!(outcomes.len(), 1);
    let row: Value = serde_json::from_str(&outcomes[0]).expect("JSON");
    assert_eq!(row["execution"], model, "{row}");
}
