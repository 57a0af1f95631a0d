//! Outcomes of rollouts, read from a campaign's database and from the files of `worker rollout`.

use std::collections::BTreeMap;
use std::path::Path;
use std::process::Command;

use benchmark::attempt::{Digests, RolloutResult};
use serde_json::Value;
use sqlx::Connection;

use crate::programs::program;

/// Outcome, digests and prompt of a rollout.
#[derive(Debug, PartialEq, Eq)]
pub struct Outcome {
    pub success: bool,
    pub steps: i64,
    /// Digests of the scene, the initial state and the policy's first frames.
    pub digests: [String; 3],
    pub prompt: String,
}

impl Outcome {
    fn of(result: RolloutResult) -> Outcome {
        let Digests { scene, init_state, first_frame } = result.digests;
        Outcome {
            success: result.success,
            steps: result.steps.into(),
            digests: [scene, init_state, first_frame],
            prompt: result.prompt.expect("a prompt"),
        }
    }
}

pub type Outcomes = BTreeMap<String, Outcome>;

/// Reads the outcomes of a campaign from a coordinator's data.
pub async fn stored(data: &Path, campaign: &str) -> Outcomes {
    let path = data.join("coordinator.sqlite");
    let options = sqlx::sqlite::SqliteConnectOptions::new().filename(path).read_only(true);
    let mut database = sqlx::SqliteConnection::connect_with(&options).await.expect("a database");
    let rows: Vec<(String, String)> = sqlx::query_as(
        "SELECT j.rollout_id, r.outcome
         FROM result r JOIN job j ON j.id = r.job_id JOIN campaign c ON c.id = j.campaign_id
         WHERE c.name = ?",
    )
    .bind(campaign)
    .fetch_all(&mut database)
    .await
    .expect("results");
    let rows = rows
        .into_iter()
        .map(|(id, outcome)| (id, Outcome::of(serde_json::from_str(&outcome).expect("a result"))));
    rows.collect()
}

/// Runs a rollout with `worker rollout` and a gateway's `student`.
pub fn alone(gateway: &str, id: &str, more: &[&str]) -> Outcome {
    let folder = tempfile::tempdir().expect("a folder");
    let mut command = Command::new(program("worker"));
    command.args(["rollout", "--id", id, "--policy", "student", "--endpoint", gateway]);
    let command = command.args(["--no-video", "--output"]).arg(folder.path()).args(more);
    let run = command.output().expect("the worker runs");
    assert!(run.status.success(), "{id}: {}", String::from_utf8_lossy(&run.stderr));
    let text = std::fs::read(folder.path().join("result.json")).expect("a result");
    let result: Value = serde_json::from_slice(&text).expect("JSON");
    let outcome = result["finished"]["outcome"].clone();
    Outcome::of(serde_json::from_value(outcome).expect("a result"))
}
