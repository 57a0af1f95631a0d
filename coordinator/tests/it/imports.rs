//! Archives with altered rows that satisfy the database's own constraints, and campaigns that are
//! imported in several transactions.

use std::path::Path;
use std::time::{Duration, Instant};

use proto::coordinator::commit_response::Verdict;
use queue::DATABASE_FILE;
use queue::invariants::check;
use serde_json::{Value, json};

use crate::artifacts::put;
use crate::failpoints::serve;
use crate::harness::{open_database, rollout_id, small_spec, with};
use crate::moving::{Bench, members, write};
use crate::process::Serve;

/// Alters the database of an archive, and recomputes the archive's table of contents.
async fn alter(archive: &Path, into: &Path, sql: &'static str) {
    let mut altered = members(archive);
    let folder = tempfile::tempdir().expect("a folder");
    let database = folder.path().join(DATABASE_FILE);
    let rows = altered.iter_mut().find(|(name, _)| name == DATABASE_FILE);
    let (_, rows) = rows.expect("a database");
    std::fs::write(&database, &rows).expect("written");
    let pool = open_database(folder.path()).await;
    let result = sqlx::raw_sql(sql).execute(&pool).await.expect("altered");
    assert!(result.rows_affected() > 0, "{sql}");
    sqlx::raw_sql("PRAGMA wal_checkpoint(TRUNCATE)").execute(&pool).await.expect("one file");
    pool.close().await;
    *rows = std::fs::read(&database).expect("a database");
    write(into, &altered, true);
}

/// Each of these rows would cause every claim, commit or page that reads the row to fail.
#[tokio::test(flavor = "multi_thread")]
async fn imported_rows_that_violate_an_invariant_are_refused_by_name() {
    let mut source = Bench::with(&with(small_spec("moved"), json!({"replicates": 2}))).await;
    source.run(2, "").await;
    let file = source.archive("moved");
    let target = Bench::empty().await;
    let before = target.rows().await;
    let bad = target.folder.path().join("bad.tar.gz");
    let path = bad.display().to_string();
    for (sql, words) in [
        (
            "UPDATE job SET manifest_row = json_set(manifest_row, '$.max_steps',
                 9223372036854775807) WHERE id = (SELECT max(id) FROM job)",
            &["manifest row cannot be read", "9223372036854775807"][..],
        ),
        (
            "UPDATE job SET manifest_row = json_remove(manifest_row, '$.suite')
             WHERE id = (SELECT max(id) FROM job)",
            &["manifest row cannot be read", "`suite`"],
        ),
        (
            "UPDATE job SET manifest_row = json_set(manifest_row, '$.max_steps', 279)
             WHERE id = (SELECT max(id) FROM job)",
            &["the campaign's specification gives it another `max_steps`"],
        ),
        (
            "UPDATE job SET manifest_row = json_set(manifest_row, '$.num_steps_wait', 4294967295)
             WHERE id = (SELECT max(id) FROM job)",
            &["the campaign's specification gives it another `num_steps_wait`"],
        ),
        (
            "INSERT INTO campaign_task SELECT id, 'libero_object/1' FROM campaign;
             UPDATE job SET task = 'libero_object/1' WHERE id = (SELECT max(id) FROM job)",
            &["its `task` is not that of its manifest row"],
        ),
        (
            "UPDATE job SET init_id = init_id + 1 WHERE id = (SELECT max(id) FROM job)",
            &["its `init_id` is not that of its manifest row"],
        ),
        (
            "UPDATE job SET policy_seed = 7 WHERE id = (SELECT max(id) FROM job)",
            &["its `policy_seed` is not that of its manifest row"],
        ),
        (
            "UPDATE job SET replicate = 1099511627776 WHERE id = (SELECT max(id) FROM job)",
            &["its `replicate` is not that of its manifest row"],
        ),
        (
            "UPDATE job SET rollout_id = 'object/t0/nominal/i49'
             WHERE id = (SELECT max(id) FROM job)",
            &["its `rollout_id` is not that of its manifest row"],
        ),
        (
            "DELETE FROM job WHERE unit_order = (SELECT max(unit_order) FROM job);
             UPDATE campaign SET jobs = jobs - 1",
            &["find the campaign's rollouts", "it holds 7", "has 8"],
        ),
        (
            "UPDATE result SET outcome = json_set(outcome, '$.realised.camera', 7)
             WHERE job_id = (SELECT min(job_id) FROM result)",
            &["results_fit_their_rows", "the result of job", "`7` is given where"],
        ),
        (
            "UPDATE provenance SET origin = json_set(origin, '$.host', 7)",
            &["results_fit_their_rows", "provenance 1: `7` is given where"],
        ),
        (
            "PRAGMA writable_schema = ON;
             UPDATE sqlite_schema SET sql = replace(sql, 'outcome ->> ''steps''', '1')
             WHERE name = 'result';
             PRAGMA writable_schema = RESET;
             UPDATE result SET attempt = attempt;
             PRAGMA writable_schema = ON;
             UPDATE sqlite_schema SET sql = replace(sql, 'AS (1)', 'AS (outcome ->> ''steps'')')
             WHERE name = 'result';
             PRAGMA writable_schema = RESET",
            &["results_fit_their_rows", "has 1 control steps"],
        ),
        (
            "UPDATE worker SET slots = 1099511627776",
            &["its `slots` is 1099511627776", "1 to 65536"],
        ),
        ("UPDATE worker SET cores = 65537", &["its `cores` is 65537", "1 to 65536"]),
        (
            "PRAGMA foreign_keys = OFF; UPDATE result SET worker_id = 'a b';
             UPDATE worker SET id = 'a b'",
            &["read worker id `a b`"],
        ),
        (
            "UPDATE result SET outcome = json_set(outcome, '$.policy_queries', 9223372036854775807)
             WHERE job_id = (SELECT min(job_id) FROM result)",
            &["results_fit_their_rows", "9223372036854775807"],
        ),
        (
            "UPDATE result SET outcome = json_set(outcome, '$.wall_secs', 1e300)
             WHERE job_id = (SELECT min(job_id) FROM result)",
            &["results_fit_their_rows", "`wall_secs`"],
        ),
        (
            "UPDATE result SET outcome = json_set(outcome, '$.clipped_actions', steps + 1)
             WHERE job_id = (SELECT min(job_id) FROM result)",
            &["results_fit_their_rows"],
        ),
    ] {
        alter(&file, &bad, sql).await;
        let message = target.refused(&["campaign", "import", &path]);
        for word in words.iter().chain(&["bad.tar.gz"]) {
            assert!(message.contains(word), "{message} lacks {word} after {sql}");
        }
    }
    check_unchanged(&target, &before, &file).await;
}

/// Checks that refusals changed nothing, and that the unaltered archive is imported afterwards.
async fn check_unchanged(target: &Bench, before: &[String], file: &Path) {
    assert_eq!(target.rows().await, before, "a refused import changed rows");
    target.import(file);
    target.assert_invariants().await;
}

/// The clock of the next start would begin at such a time.
#[tokio::test(flavor = "multi_thread")]
async fn an_archive_whose_times_lie_days_ahead_is_refused() {
    let mut source = Bench::with(&small_spec("moved")).await;
    source.run(2, "").await;
    let file = source.archive("moved");
    let target = Bench::empty().await;
    let before = target.rows().await;
    let bad = target.folder.path().join("bad.tar.gz");
    let ahead = "UPDATE result SET committed_ms = 9223372036854775807
                 WHERE job_id = (SELECT min(job_id) FROM result)";
    alter(&file, &bad, ahead).await;
    let message = target.refused(&["campaign", "import", &bad.display().to_string()]);
    assert!(message.contains("s ahead of this coordinator's"), "{message}");
    check_unchanged(&target, &before, &file).await;
}

/// Rewrites an archive as earlier releases wrote it, with the reference's names of conditions.
async fn with_published_names(archive: &Path) {
    let published = "UPDATE job SET manifest_row = replace(replace(replace(replace(manifest_row,
                '/nominal/', '/clean/'), '/simultaneous/', '/combination/'),
                '\"nominal\"', '\"clean\"'), '\"simultaneous\"', '\"combination\"');
         UPDATE job SET rollout_id = manifest_row ->> 'rollout_id'";
    alter(archive, archive, published).await;
    let mut members = members(archive);
    for (name, bytes) in &mut members {
        if ["provenance.json", "report.json"].contains(&name.as_str()) {
            let text = String::from_utf8(std::mem::take(bytes)).expect("JSON");
            let text = text.replace("\"simultaneous\": {", "\"combination\": {");
            let text = text.replace("nominal_relative_loss", "clean_relative_loss");
            let text = text.replace("/nominal/", "/clean/");
            *bytes = text.replace("/simultaneous/", "/combination/").into_bytes();
        }
    }
    write(archive, &members, true);
}

#[tokio::test(flavor = "multi_thread")]
async fn archives_with_the_references_names_are_imported_and_continue() {
    let mut source = Bench::with(&with(small_spec("moved"), json!({"levels": ["L2"]}))).await;
    source.run(4, "").await;
    let half = source.archive("moved");
    with_published_names(&half).await;
    let mut target = Bench::empty().await;
    target.import(&half);
    target.assert_invariants().await;
    for bench in [&mut source, &mut target] {
        bench.run(64, "").await;
    }
    for command in [&["report", "moved", "--json"][..], &["export", "moved", "--format", "jsonl"]] {
        assert_eq!(target.succeed(command), source.succeed(command));
    }
    source.begin(&["thresholds", "moved", "--create"]).await;
    let search = source.archive("moved-thresholds");
    with_published_names(&search).await;
    target.import(&search);
    target.assert_invariants().await;
}

/// The step budgets of derived rollouts must equal those of the source campaign's rollouts.
#[tokio::test(flavor = "multi_thread")]
async fn a_derived_rollout_with_another_step_budget_than_its_source_is_refused() {
    let mut source = Bench::with(&with(small_spec("moved"), json!({"levels": ["L2"]}))).await;
    while let Some(lease) = source.worker.claim(1).await.pop() {
        let success = rollout_id(&lease).contains("nominal");
        let verdict = source.worker.commit(&lease, success).await;
        assert_eq!(verdict, Verdict::Accepted);
    }
    let name = "moved-thresholds";
    source.begin(&["thresholds", "moved", "--create"]).await;
    let (source_archive, file) = (source.archive("moved"), source.archive(name));
    let target = Bench::empty().await;
    target.import(&source_archive);
    let before = target.rows().await;
    let bad = target.folder.path().join("bad.tar.gz");
    let longer = "UPDATE job SET manifest_row = json_set(manifest_row, '$.max_steps', 281)
                  WHERE id = (SELECT max(id) FROM job)";
    alter(&file, &bad, longer).await;
    let message = target.refused(&["campaign", "import", &bad.display().to_string()]);
    assert!(message.contains("other step budgets"), "{message}");
    check_unchanged(&target, &before, &file).await;
}

/// Returns the specification of a campaign that has more than 1,000 rollouts, the number that two
/// transactions of an import add.
fn large_spec() -> Value {
    let configs: Vec<u32> = (0..10).collect();
    with(
        small_spec("large"),
        json!({
            "tasks": ["libero_object"], "levels": ["L1", "L2", "L3"], "configs": configs,
            "replicates": 2,
        }),
    )
}

/// Returns the numbers of campaigns and of jobs in a data folder.
async fn counts(folder: &Path) -> (i64, i64) {
    let pool = open_database(folder).await;
    let counts = "SELECT (SELECT count(*) FROM campaign), (SELECT count(*) FROM job)";
    let counts = sqlx::query_as(counts).fetch_one(&pool).await;
    pool.close().await;
    counts.expect("counts")
}

#[tokio::test(flavor = "multi_thread")]
async fn a_large_import_takes_several_transactions_and_leaves_nothing_if_interrupted() {
    let mut source = Bench::with(&large_spec()).await;
    // Some results belong to the second part of the jobs.
    source.run(520, "").await;
    let filmed = source.worker.claim_one().await;
    assert_eq!(source.worker.commit(&filmed, true).await, Verdict::Accepted);
    put(&mut source.worker, &filmed, "video.mp4", &[vec![7; 99]]).await.expect("stored");
    let (_, jobs) = counts(source.folder.path()).await;
    assert!(jobs > 1_000, "{jobs}");
    let file = source.archive("large");
    let path = file.display().to_string();

    let target = tempfile::tempdir().expect("a folder");
    // The third transaction of the import adds the second part of the jobs.
    let mut killed = Serve::wait_until_listening(serve(target.path(), "After:ImportCampaign:3"));
    let output = killed.command(&["campaign", "import", &path, "--retry-secs", "0"]);
    assert!(!output.status.success(), "the interrupted import succeeded");
    let began = Instant::now();
    while killed.ended().is_none() {
        assert!(began.elapsed() < Duration::from_secs(30), "the coordinator still runs");
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    drop(killed);
    assert_eq!(counts(target.path()).await, (1, 1_000));
    let films = target.path().join("artifacts/large");
    assert!(films.exists(), "films are stored before rows");
    assert_eq!(check(target.path()).await.expect("a database"), []);

    let restarted = Serve::start(target.path());
    let listed = restarted.command(&["campaign", "status", "--json"]);
    let listed: Value = serde_json::from_slice(&listed.stdout).expect("JSON");
    assert_eq!(listed["campaigns"], json!([]), "an incomplete campaign is listed");
    while counts(target.path()).await != (0, 0) {
        assert!(began.elapsed() < Duration::from_secs(60), "jobs are left");
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
    assert!(!films.exists(), "films are left");
    let imported = restarted.command(&["campaign", "import", &path]);
    assert!(imported.status.success());
    assert_eq!(std::fs::read_dir(&films).expect("films").count(), 1);
    for arguments in [&["export", "large", "--format", "jsonl"][..], &["report", "large", "--json"]]
    {
        assert_eq!(
            crate::process::text(&restarted.command(arguments).stdout),
            source.succeed(arguments)
        );
    }
    let mut worker = restarted.worker("another").await;
    let lease = worker.claim_one().await;
    assert_eq!(worker.commit(&lease, true).await, Verdict::Accepted);
    drop(restarted);
    assert_eq!(counts(target.path()).await, (1, jobs));
    assert_eq!(check(target.path()).await.expect("a database"), []);
}
