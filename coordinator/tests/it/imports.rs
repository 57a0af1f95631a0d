//! Archives with altered rows, and campaigns that are imported in several transactions.

use std::path::Path;
use std::time::{Duration, Instant};

use proto::coordinator::commit_response::Verdict;
use queue::ROLLOUTS_FILE;
use queue::invariants::check;
use serde_json::{Value, json};

use crate::artifacts::put;
use crate::failpoints::serve;
use crate::harness::{open_database, rollout_id, small_spec, with};
use crate::process::Serve;
use crate::transfers::{Bench, members, write};

/// Alters the lines of an archive's rollouts, and recomputes the archive's table of contents.
pub(crate) fn alter(archive: &Path, into: &Path, alter: impl FnOnce(&mut Vec<Value>)) {
    let mut altered = members(archive);
    let rows = altered.iter_mut().find(|(name, _)| name == ROLLOUTS_FILE);
    let (_, rows) = rows.expect("rollouts");
    let text = std::str::from_utf8(rows).expect("text").lines();
    let mut lines: Vec<Value> =
        text.map(|line| serde_json::from_str(line).expect("JSON")).collect();
    let before = lines.clone();
    alter(&mut lines);
    assert_ne!(lines, before);
    *rows = lines.iter().flat_map(|line| format!("{line}\n").into_bytes()).collect();
    write(into, &altered, true);
}

/// Each of these rows would cause every claim, commit or page that reads the row to fail.
#[tokio::test(flavor = "multi_thread")]
async fn imported_rows_that_contradict_their_campaign_are_refused_by_line() {
    let mut source = Bench::with(&with(small_spec("moved"), json!({"replicates": 2}))).await;
    source.run(2, "").await;
    let file = source.archive("moved");
    let target = Bench::empty().await;
    let before = target.rows().await;
    let bad = target.folder.path().join("bad.tar.gz");
    let path = bad.display().to_string();
    // Line 1 has the campaign's state, lines 2 and 3 have results, and line 9 is the last.
    let huge = json!(9_223_372_036_854_775_807_i64);
    let result = |field: &str| format!("/result/measurement/result/{field}");
    for (line, field, value, words) in [
        (9, "/row/max_steps".to_owned(), huge.clone(), &["read line 9", "9223372036854775807"][..]),
        (9, "/row/suite".to_owned(), json!(null), &["read line 9", "null"]),
        (9, "/row/max_steps".to_owned(), json!(279), &["read line 9", "another row"]),
        (9, "/row/num_steps_wait".to_owned(), json!(4_294_967_295_u32), &["another row"]),
        (9, "/row/init_id".to_owned(), json!(48), &["another row"]),
        (9, "/row/rollout_id".to_owned(), json!("object/t0/nominal/i49"), &["read line 9", "/i49"]),
        (9, "/replicate".to_owned(), json!(1_099_511_627_776_i64), &["1099511627776"]),
        (9, "/replicate".to_owned(), json!(0), &["read line 9", "left in replicate 0"]),
        (9, "/charged_attempts".to_owned(), json!(1), &["contradicts the schema"]),
        (9, "/losses".to_owned(), json!(1), &["losses_are_accounted_for"]),
        (3, result("realised/camera"), json!(7), &["read line 3", "`7`"]),
        (2, result("policy_queries"), huge, &["read line 2", "9223372036854775807"]),
        (2, result("wall_secs"), json!(1e300), &["results_fit_their_rows", "`wall_secs`"]),
        (2, result("clipped_actions"), json!(121), &["results_fit_their_rows"]),
        (2, "/result/measurement/provenance/host".to_owned(), json!(7), &["line 2", "`7`"]),
        (2, "/result/worker".to_owned(), json!("a b"), &["read worker id `a b`"]),
        (2, "/result/path".to_owned(), json!("0"), &["rollouts.jsonl", "contradicts the schema"]),
        (2, "/result".to_owned(), json!(null), &["attempts_are_accounted_for"]),
        (1, "/pinned".to_owned(), json!(null), &["results_pin_the_campaign"]),
        (1, "/priority".to_owned(), json!(101), &["contradicts the schema"]),
        (1, "/state/is".to_owned(), json!("sold"), &["read line 1", "`sold`"]),
    ] {
        alter(&file, &bad, |lines| {
            *lines[line - 1].pointer_mut(&field).expect(&field) = value.clone();
        });
        let message = target.refused(&["campaign", "import", &path]);
        for word in words.iter().chain(&["bad.tar.gz"]) {
            assert!(message.contains(word), "{message} lacks {word} after {field} = {value}");
        }
    }
    alter(&file, &bad, |lines| drop(lines.pop()));
    let message = target.refused(&["campaign", "import", &path]);
    assert!(message.contains("find its 8 rollouts: it holds 7"), "{message}");
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
    alter(&file, &bad, |lines| lines[1]["result"]["committed_ms"] = json!(i64::MAX));
    let message = target.refused(&["campaign", "import", &bad.display().to_string()]);
    assert!(message.contains("s ahead of this coordinator's"), "{message}");
    check_unchanged(&target, &before, &file).await;
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
    alter(&file, &bad, |lines| {
        let last = lines.last_mut().expect("a rollout");
        last["row"]["max_steps"] = json!(281);
    });
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
