//! A violation of each invariant is reported by the invariant's name, and `check` changes nothing.

use std::path::Path;

use proto::coordinator::commit_response::Verdict;
use proto::coordinator::release_request::Reason;
use queue::DATABASE_FILE;
use queue::invariants::{INVARIANTS, Invariant, check};
use serde_json::json;
use sqlx::sqlite::SqliteConnectOptions;
use sqlx::{ConnectOptions, Connection};
use tempfile::TempDir;

use crate::harness::{Bench, small_spec, with};
use crate::process::{coordinator, text};

/// For each invariant: its name, a statement that violates it, and a part of the violation's
/// description.
const BREACHES: [(&str, &str, &str); 20] = [
    (
        "file_is_whole",
        "PRAGMA writable_schema = 1; DELETE FROM sqlite_schema WHERE name = 'job_queued'",
        "never used",
    ),
    ("schema_is_the_programs", "DROP INDEX job_queued", "index job_queued is missing"),
    ("references_hold", "UPDATE campaign SET policy_id = 99", "refers to no row of policy"),
    (
        "expansion_is_whole",
        "DELETE FROM job WHERE state = 'queued'",
        "expanded into 8 jobs and has",
    ),
    (
        "tallies_are_true",
        "UPDATE tally SET queued = queued + 1",
        "the tally of campaign sound counts",
    ),
    (
        "committed_has_one_result",
        "DELETE FROM result",
        "is committed at attempt 1 and its result is of attempt none",
    ),
    (
        "quarantine_has_its_failure",
        "UPDATE job SET last_error = 'another' WHERE state = 'quarantined'",
        "ended with slot_crashed",
    ),
    (
        "attempts_are_accounted_for",
        "UPDATE job SET attempt = attempt + 1 WHERE state = 'leased'",
        "is leased: 2 attempts",
    ),
    (
        "charges_are_accounted_for",
        "UPDATE job SET charged_attempts = 1 WHERE state = 'leased'",
        "1 charged attempts",
    ),
    ("losses_are_accounted_for", "UPDATE job SET losses = 1 WHERE state = 'leased'", "1 losses"),
    (
        "attempts_only_rise",
        "UPDATE failure SET attempt = attempt + 10",
        "has a failure of attempt 11",
    ),
    (
        "results_pin_the_campaign",
        "UPDATE campaign SET pinned_ms = NULL, asset_pack = NULL, asset_pack_digest = NULL,
             mujoco_version = NULL, renderer = NULL",
        "pinned to nothing and has results",
    ),
    (
        "cancelled_leases_nothing",
        "UPDATE campaign SET state = 'cancelled'",
        "campaign sound is cancelled",
    ),
    (
        "stopped_leases_nothing",
        "INSERT INTO stop SELECT id, 2, 1, 0 FROM campaign",
        "campaign sound has stopped",
    ),
    (
        "probe_is_out",
        "UPDATE policy SET state = 'probing', outages = 1, pause_reason = 'down',
             probe_attempt_id = hex(zeroblob(16))",
        "which holds no lease",
    ),
    (
        "results_are_of_the_pin",
        "UPDATE provenance SET origin = json_set(origin, '$.mujoco_version', '3.4.0')",
        "not of the assets, simulator",
    ),
    (
        "results_fit_their_rows",
        "UPDATE result SET outcome = json_set(outcome, '$.steps', 281)
         WHERE job_id = (SELECT min(job_id) FROM result)",
        "has 281 control steps",
    ),
    (
        "configurations_agree",
        "UPDATE result SET outcome = json_set(outcome, '$.digests.scene',
             'ffffffffffffffffffffffffffffffffffffffffffffffffffffffffffffffff')
         WHERE job_id = (SELECT min(job_id) FROM result)",
        "has 2 scenes",
    ),
    (
        "divergences_differ",
        "INSERT INTO divergence (job_id, attempt, worker_id, reported_ms, provenance_id, outcome)
         SELECT job_id, attempt, worker_id, 0, provenance_id, outcome FROM result LIMIT 1",
        "no committed outcome",
    ),
    (
        "removals_are_of_no_campaign",
        "INSERT INTO removal VALUES ('artifacts/sound')",
        "artifacts/sound",
    ),
];

pub(crate) async fn valid_database() -> TempDir {
    let spec = with(small_spec("sound"), json!({"configs": [0, 1]}));
    let bench = Bench::with(&spec).await;
    let mut worker = bench.worker("a").await;
    for _ in 0..3 {
        let lease = worker.claim_one().await;
        worker.release(&lease, Reason::SlotCrashed).await;
        bench.advance(61).await;
    }
    for lease in worker.claim(2).await {
        assert_eq!(worker.commit(&lease, true).await, Verdict::Accepted);
    }
    worker.claim_one().await;
    bench.stop().await
}

/// Alters a copy of a database in a way that no coordinator would.
async fn altered_copy(folder: &Path, statement: &'static str) -> TempDir {
    let copy = tempfile::tempdir().expect("a temporary folder");
    let file = copy.path().join(DATABASE_FILE);
    std::fs::copy(folder.join(DATABASE_FILE), &file).expect("copied");
    let options = SqliteConnectOptions::new().filename(&file);
    let mut connection = options
        .foreign_keys(false)
        .pragma("ignore_check_constraints", "1")
        .connect()
        .await
        .expect("a database");
    let triggers: Vec<(String, String)> =
        sqlx::query_as("SELECT name, sql FROM sqlite_schema WHERE type = 'trigger'")
            .fetch_all(&mut connection)
            .await
            .expect("triggers");
    let run = async |connection: &mut _, sql: String| {
        sqlx::raw_sql(sqlx::AssertSqlSafe(sql)).execute(connection).await.expect("done")
    };
    for (name, _) in &triggers {
        run(&mut connection, format!("DROP TRIGGER {name}")).await;
    }
    let result = run(&mut connection, statement.to_owned()).await;
    assert!(statement.starts_with("DROP") || result.rows_affected() > 0, "{statement}");
    for (_, sql) in triggers {
        run(&mut connection, sql).await;
    }
    connection.close().await.expect("closes");
    copy
}

#[tokio::test]
async fn each_violated_invariant_is_reported_by_name() {
    let folder = valid_database().await;
    assert_eq!(check(folder.path()).await.expect("a database"), []);
    for (invariant, statement, word) in BREACHES {
        let copy = altered_copy(folder.path(), statement).await;
        let file = copy.path().join(DATABASE_FILE);
        let before = std::fs::read(&file).expect("a file");
        let violations = check(copy.path()).await.expect("a database");
        let violation = violations.iter().find(|violation| violation.invariant == invariant);
        let violation = violation.unwrap_or_else(|| panic!("{invariant}: {violations:?}"));
        assert!(violation.examples[0].contains(word), "{violation:?}");
        assert_eq!(std::fs::read(&file).expect("a file"), before, "`check` changed the database");
        let files = std::fs::read_dir(copy.path()).expect("a folder").count();
        assert_eq!(files, 1, "`check` left files");
    }
    let violated: Vec<&str> = BREACHES.iter().map(|(invariant, ..)| *invariant).collect();
    assert!(
        violated.into_iter().eq(INVARIANTS.map(|invariant| invariant.name)),
        "each invariant is violated once"
    );
}

#[tokio::test]
async fn the_program_names_violations_and_fails() {
    let folder = valid_database().await;
    let path = |folder: &TempDir| folder.path().to_str().expect("UTF-8").to_owned();
    let output = coordinator(&["check", &path(&folder)]);
    assert_eq!(text(&output.stdout), "all 20 invariants hold\n");
    let copy = altered_copy(folder.path(), "DELETE FROM result").await;
    let output = coordinator(&["check", &path(&copy)]);
    assert_eq!(output.status.code(), Some(1));
    let printed = text(&output.stdout);
    assert!(printed.contains("committed_has_one_result: 2\n"), "{printed}");
    assert!(text(&output.stderr).contains("3 of 20 invariants"));
    let output = coordinator(&["check", "/nowhere"]);
    assert_eq!(output.status.code(), Some(2));
    let text_file = folder.path().join("notes.txt");
    std::fs::write(&text_file, "no database").expect("written");
    let output = coordinator(&["check", text_file.to_str().expect("UTF-8")]);
    let printed = text(&output.stderr);
    let count = printed.matches("file is not a database").count();
    assert_eq!((output.status.code(), count), (Some(1), 1), "{printed}");
}

#[test]
fn the_architecture_page_documents_every_invariant() {
    let page = include_str!("../../../docs/dev/ARCHITECTURE.md");
    for Invariant { name, .. } in INVARIANTS {
        assert!(page.contains(&format!("`{name}`")), "{name}");
    }
}
