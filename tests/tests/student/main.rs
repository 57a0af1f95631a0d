//! The student under all six axes on LIBERO's own assets, through real processes: every outcome,
//! step count and first frame equals `golden.jsonl` on every machine.

use std::fmt::Write;
use std::path::Path;

use serde_json::json;
use sqlx::Connection;
use sqlx::sqlite::{SqliteConnectOptions, SqliteConnection};
use tests::programs::{Campaigns, Process};

const NAME: &str = "golden";
const GOLDEN: &str = include_str!("golden.jsonl");
/// One task of the suite with the smallest step budget, and one of ten tasks that only their
/// instructions distinguish.
const TASKS: &str = "libero_spatial/2,libero_goal/8";

#[test]
fn a_campaign_of_all_axes_has_the_golden_results() {
    let data = tempfile::tempdir().unwrap();
    let campaigns = Campaigns::with_student(data.path(), "builtin:student");
    let endpoint = &campaigns.gateway.url;
    #[rustfmt::skip]
    campaigns.succeed(&[
        "campaign", "create", "--name", NAME, "--policy", "student", "--endpoint", endpoint,
        "--tasks", TASKS, "--axes", "all", "--levels", "L2", "--configs", "0", "--nominal", "eval",
    ]);
    let _worker = Process::worker(&campaigns.coordinator.url, 2, "libero");
    campaigns.wait_for_commits(NAME, None);

    let found = results(data.path());
    assert!(
        found == GOLDEN,
        "the student acts differently from other machines; if its weights, a scene or the \
         renderer were changed on purpose, this is the new golden.jsonl:\n{found}"
    );
}

/// Returns a line of JSON per rollout.
fn results(data: &Path) -> String {
    let runtime = tokio::runtime::Runtime::new().unwrap();
    let rows: Vec<(String, bool, i64, String)> = runtime.block_on(async {
        let options =
            SqliteConnectOptions::new().filename(data.join("coordinator.sqlite")).read_only(true);
        let mut database = SqliteConnection::connect_with(&options).await.unwrap();
        let rows = sqlx::query_as(
            "SELECT j.rollout_id, r.success, r.steps, r.outcome ->> '$.digests.first_frame'
             FROM result r JOIN job j ON j.id = r.job_id ORDER BY j.rollout_id",
        );
        rows.fetch_all(&mut database).await.unwrap()
    });
    let mut lines = String::new();
    for (id, success, steps, first_frame) in rows {
        let line = json!({
            "rollout_id": id, "success": success, "steps": steps, "first_frame": first_frame,
        });
        writeln!(lines, "{line}").unwrap();
    }
    lines
}
