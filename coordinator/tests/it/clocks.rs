//! Effects of a clock that jumps between two starts of a coordinator, on every column that stores
//! an instant.
//!
//! While a coordinator runs, its clock never goes back (`queue::clock`).

use std::sync::Arc;
use std::time::Duration;

use proto::coordinator::commit_response::Verdict;
use proto::coordinator::release_request::Reason;
use queue::clock::{Clock, ManualClock, UnixMillis};
use serde_json::json;
use sqlx::AssertSqlSafe;

use crate::harness::{Bench, assert_sound, small_spec, with};

const DAY_MS: i64 = 24 * 3_600 * 1_000;
const LEASE_MS: i64 = 30_000;

/// Every column that stores an instant, as table and column, and whether the instant was the
/// present one when it was stored; the others are ends of leases, back-offs and pauses. Instants may
/// lie in the past by any amount: a clock that jumped ahead ends back-offs and pauses, makes workers
/// silent until they call, and leaves leases their full time.
const INSTANTS: [(&str, &str, bool); 20] = [
    ("artifact", "stored_ms", true),
    ("campaign", "created_ms", true),
    // A result that does not fit the pin is not charged if its lease is older than this instant.
    ("campaign", "pinned_ms", true),
    ("campaign", "state_since_ms", true),
    ("divergence", "reported_ms", true),
    // After this instant, a disconnected worker can no longer report a result.
    ("failure", "ceiling_ms", false),
    ("failure", "failed_ms", true),
    ("failure", "leased_ms", true),
    // `leased_ms` plus the longest duration of the attempt; at a start of the coordinator, at least
    // the end of the renewed lease.
    ("job", "ceiling_ms", false),
    ("job", "lease_expires_ms", false),
    ("job", "leased_ms", true),
    ("job", "not_before_ms", false),
    // Failures of leases that were granted before this instant are no evidence of an outage.
    ("policy", "available_ms", true),
    ("policy", "resume_ms", false),
    ("result", "committed_ms", true),
    ("stop", "stopped_ms", true),
    // Decides whether a lease expired because its worker was silent, which is not charged.
    ("worker", "heartbeat_ms", true),
    // Decides whether a worker is alive.
    ("worker", "last_seen_ms", true),
    ("worker", "registered_ms", true),
    ("worker", "signed_off_ms", true),
];

/// Stores an instant in every column of `INSTANTS`.
async fn store_every_instant(bench: &Bench) {
    let spec = with(small_spec("times"), json!({"configs": [0, 1]}));
    bench.create(&spec).await.expect("created");
    let mut worker = bench.worker("a").await;
    let leases = worker.claim(4).await;
    assert_eq!(worker.commit(&leases[0], true).await, Verdict::Accepted);
    assert_eq!(worker.commit(&leases[0], false).await, Verdict::Divergent);
    worker.release(&leases[1], Reason::SlotCrashed).await;
    worker.release(&leases[2], Reason::PolicyUnavailable).await;
    bench.create(&small_spec("over")).await.expect("created");
    let pool = bench.database().await;
    sqlx::raw_sql(
        "INSERT INTO artifact SELECT attempt_id, 'video', 'artifacts/x', 1, committed_ms FROM result;
         INSERT INTO stop SELECT id, 3, 1, created_ms FROM campaign WHERE name = 'over';
         UPDATE worker SET signed_off_ms = last_seen_ms, heartbeat_ms = last_seen_ms;
         UPDATE failure SET leased_ms = failed_ms, ceiling_ms = failed_ms + 60000",
    )
    .execute(&pool)
    .await
    .expect("stored");
    pool.close().await;
}

async fn latest(bench: &Bench, table: &str, column: &str) -> Option<i64> {
    let pool = bench.database().await;
    let statement = format!("SELECT max({column}) FROM {table}");
    let latest = sqlx::query_scalar(AssertSqlSafe(statement)).fetch_one(&pool).await;
    pool.close().await;
    latest.expect("an instant")
}

#[tokio::test]
async fn every_column_with_an_instant_is_listed() {
    let bench = Bench::start().await;
    let pool = bench.database().await;
    let columns: Vec<(String, String)> = sqlx::query_as(
        "SELECT m.name, c.name FROM sqlite_schema m JOIN pragma_table_info(m.name) c
         WHERE m.type = 'table' AND c.name LIKE '%\\_ms' ESCAPE '\\' ORDER BY 1, 2",
    )
    .fetch_all(&pool)
    .await
    .expect("columns");
    pool.close().await;
    let columns_in_schema = columns.iter().map(|(table, column)| (&**table, &**column));
    let named = INSTANTS.map(|(table, column, _)| (table, column));
    assert_eq!(columns_in_schema.collect::<Vec<_>>(), named, "list new columns in INSTANTS");
}

/// Returns the latest instant in every column of `INSTANTS`, except those that a start renews.
async fn unrenewed(bench: &Bench) -> Vec<(&'static str, &'static str, Option<i64>)> {
    let mut instants = Vec::new();
    for (table, column, _) in INSTANTS {
        if table != "job" || !["lease_expires_ms", "ceiling_ms"].contains(&column) {
            instants.push((table, column, latest(bench, table, column).await));
        }
    }
    instants
}

/// Regression: one start with a wrong clock moved the times of all results to that start.
#[tokio::test]
async fn a_clock_set_back_alters_no_stored_instant() {
    let bench = Bench::start().await;
    store_every_instant(&bench).await;
    let before = unrenewed(&bench).await;
    let now = bench.queue.now();
    let folder = bench.stop().await;
    let bench = Bench::start_in(folder, Arc::new(ManualClock::at(UnixMillis(10_000)))).await;
    assert_eq!(unrenewed(&bench).await, before);
    assert_eq!(bench.queue.now(), now, "the clock continues");
    // The clock goes on from there, and a right one takes over.
    bench.advance(5).await;
    assert_eq!(bench.queue.now().0, now.0 + 5_000);
    let right = UnixMillis(now.0 + 60_000);
    let folder = bench.stop().await;
    let bench = Bench::start_in(folder, Arc::new(ManualClock::at(right))).await;
    assert_eq!(bench.queue.now(), right);
    assert_eq!(unrenewed(&bench).await, before);
    assert_sound(bench.stop().await.path()).await;
}

#[tokio::test]
async fn the_clock_begins_at_the_newest_instant_of_every_column() {
    let mut bench = Bench::start().await;
    store_every_instant(&bench).await;
    for (table, column, _) in INSTANTS.into_iter().filter(|(.., is_present)| *is_present) {
        let newest = bench.queue.now().0 + DAY_MS;
        let pool = bench.database().await;
        // A stop is final, so its row is replaced.
        let statement = match table {
            "stop" => format!(
                "REPLACE INTO stop SELECT campaign_id, configurations, used, {newest} FROM stop"
            ),
            _ => format!("UPDATE {table} SET {column} = {newest} WHERE {column} IS NOT NULL"),
        };
        sqlx::raw_sql(AssertSqlSafe(statement)).execute(&pool).await.expect("stored");
        pool.close().await;
        bench = bench.restart().await;
        assert_eq!(bench.queue.now().0, newest, "{table}.{column}");
    }
}

#[tokio::test]
async fn a_clock_set_back_hides_neither_an_outage_nor_a_dead_worker() {
    let bench = Bench::with(&small_spec("back")).await;
    let mut worker = bench.worker("a").await;
    // The policy counts as available from today on.
    let lease = worker.claim_one().await;
    worker.release(&lease, Reason::PolicyUnavailable).await;
    bench.advance(5).await;
    let probe = worker.claim_one().await;
    assert_eq!(worker.commit(&probe, true).await, Verdict::Accepted);
    let yesterday = UnixMillis(bench.clock.now().0 - DAY_MS);
    let folder = bench.stop().await;
    let bench = Bench::start_in(folder, Arc::new(ManualClock::at(yesterday))).await;
    assert_eq!(bench.status("back").await.live_workers, 1, "the worker has just called");
    bench.advance(60).await;
    assert_eq!(bench.status("back").await.live_workers, 0);
    let (mut worker, lease) = bench.worker_with_lease("b").await;
    worker.release(&lease, Reason::PolicyUnavailable).await;
    assert!(bench.status("back").await.policy_outage.is_some(), "a new outage");
}

#[tokio::test]
async fn a_clock_jump_ahead_leaves_all_instants_in_the_past_and_leases_their_full_time() {
    let bench = Bench::start().await;
    store_every_instant(&bench).await;
    let before = unrenewed(&bench).await;
    bench.clock.advance(Duration::from_secs(24 * 3_600));
    let now = bench.clock.now().0;
    let bench = bench.restart().await;
    assert_eq!(unrenewed(&bench).await, before);
    assert!(before.iter().all(|(.., latest)| *latest < Some(now)));
    for column in ["lease_expires_ms", "ceiling_ms"] {
        assert_eq!(latest(&bench, "job", column).await, Some(now + LEASE_MS), "{column}");
    }
    // A worker is silent until it calls; back-offs and pauses are over.
    assert_eq!(bench.status("times").await.live_workers, 0);
    let mut worker = bench.worker("b").await;
    let probe = worker.claim_one().await;
    assert_eq!(worker.commit(&probe, true).await, Verdict::Accepted);
    assert_eq!(worker.claim(64).await.len(), 5, "failed jobs are leased again, too");
    assert_sound(bench.stop().await.path()).await;
}
