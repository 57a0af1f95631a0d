//! Databases of every released schema are upgraded to the current schema without losing rows, and
//! their campaigns continue.

use std::path::Path;
use std::sync::Arc;

use proto::coordinator::commit_response::Verdict;
use proto::coordinator::release_request::Reason;
use queue::DATABASE_FILE;
use queue::clock::{ManualClock, UnixMillis};
use queue::expand::NewCampaign;
use queue::invariants::check;
use serde_json::Value;
use sqlx::migrate::Migrator;
use sqlx::sqlite::{SqliteConnectOptions, SqlitePool};

use crate::harness::{Bench, open_database, sha, small_spec};
use crate::process::{coordinator, text};

/// SQL dumps of databases, one per earlier schema, with jobs of every state, charged and uncharged
/// failures, an unavailable policy, and films. The dumps from the third on hold the database of the
/// second dump, upgraded by later releases. Each new migration adds a dump of the previous schema.
const RELEASED: [&str; 12] = [
    include_str!("../databases/schema_1.sql"),
    include_str!("../databases/schema_2.sql"),
    include_str!("../databases/schema_3.sql"),
    include_str!("../databases/schema_4.sql"),
    include_str!("../databases/schema_5.sql"),
    include_str!("../databases/schema_6.sql"),
    include_str!("../databases/schema_7.sql"),
    include_str!("../databases/schema_8.sql"),
    include_str!("../databases/schema_9.sql"),
    include_str!("../databases/schema_10.sql"),
    include_str!("../databases/schema_11.sql"),
    include_str!("../databases/schema_12.sql"),
];

const FIRST_MIGRATION: &str = "0001_campaigns_jobs_results.sql";
const NOW_MS: i64 = 1_700_000_000_000;

/// Returns an empty database of schema 1.
async fn first_schema(folder: &Path) -> SqlitePool {
    let migrations = tempfile::tempdir().expect("a temporary folder");
    let released = Path::new(env!("CARGO_MANIFEST_DIR")).join("../migrations");
    std::fs::copy(released.join(FIRST_MIGRATION), migrations.path().join(FIRST_MIGRATION))
        .expect("copied");
    let options =
        SqliteConnectOptions::new().filename(folder.join(DATABASE_FILE)).create_if_missing(true);
    let pool = SqlitePool::connect_with(options).await.expect("a database");
    let migrator = Migrator::new(migrations.path()).await.expect("a migration");
    migrator.run(&pool).await.expect("schema 1");
    pool
}

/// Stores a pinned campaign of four rollouts. The first two are committed, each under its entry of
/// `renderers`, which is empty if no frame was drawn.
async fn insert_campaign(pool: &SqlitePool, id: i64, name: &str, renderers: [&str; 2]) {
    let spec = small_spec(name).to_string();
    let campaign = NewCampaign::from_json(&spec).expect("a campaign");
    let run = async |statement: String| {
        sqlx::raw_sql(sqlx::AssertSqlSafe(statement)).execute(pool).await.expect("stored")
    };
    run(format!(
        "INSERT OR IGNORE INTO policy (id, endpoint, name, available_ms)
             VALUES (1, 'http://127.0.0.1:50051', 'expert', 0);
         INSERT OR IGNORE INTO worker (id, host, slots, asset_pack, asset_pack_digest,
             mujoco_version, gl_renderer, program_version, registered_ms, last_seen_ms)
             VALUES ('old', 'bench', 1, 'primitives', '{pack}', '3.3.7', '', '0.1.0', 0, 0);
         INSERT INTO campaign (id, name, spec, spec_digest, policy_id, realisation, record,
             jobs, created_ms, state_since_ms, pinned_ms, asset_pack, asset_pack_digest,
             mujoco_version)
             VALUES ({id}, '{name}', '{spec}', '{digest}', 1, 'matched', 'none', 4, 0, 0, 0,
             'primitives', '{pack}', '3.3.7');
         INSERT INTO campaign_task VALUES ({id}, 'libero_object/0');",
        pack = sha("primitives"),
        spec = campaign.spec,
        digest = campaign.spec_digest,
    ))
    .await;
    for (index, job) in campaign.jobs.iter().enumerate() {
        sqlx::query(
            "INSERT INTO job (campaign_id, rollout_id, replicate, task, init_id, unit_order,
                 manifest_row, policy_seed) VALUES (?, ?, ?, ?, ?, ?, ?, 5)",
        )
        .bind(id)
        .bind(&job.rollout_id)
        .bind(job.replicate)
        .bind(&job.task)
        .bind(job.init_id)
        .bind(job.unit_order)
        .bind(&job.manifest_row)
        .execute(pool)
        .await
        .expect("a job");
        let Some(renderer) = renderers.get(index) else {
            continue;
        };
        let row: Value = serde_json::from_str(&job.manifest_row).expect("a row");
        let task = format!("{}/{}", row["suite"], row["task_id"]);
        run(format!(
            "UPDATE job SET state = 'leased', attempt = 1, not_before_ms = NULL,
                 lease_owner = 'old', leased_ms = 0, lease_expires_ms = 0, control_steps = 0
             WHERE campaign_id = {id} AND unit_order = {index};
             INSERT OR IGNORE INTO provenance (host, gl_renderer, mujoco_version, asset_pack,
                 asset_pack_digest, realisation, policy_name, policy_checkpoint,
                 policy_checkpoint_digest, policy_privileged, policy_canonical_only, batch_mode,
                 program_version)
             VALUES ('bench', '{renderer}', '3.3.7', 'primitives', '{pack}', 'matched', 'expert',
                 'none', '', 1, 0, 'single', '0.1.0');
             INSERT INTO result SELECT j.id, {id}, 1, 'old', {index}, 1, 120, 1.5, NULL, NULL,
                 NULL, 0, 30, p.id, '{scene}', '{state}', '{perturbation}', ''
             FROM job j JOIN provenance p ON p.gl_renderer = '{renderer}'
             WHERE j.campaign_id = {id} AND j.unit_order = {index};
             INSERT INTO motion SELECT id, x'000000000000', x'' FROM job
             WHERE campaign_id = {id} AND unit_order = {index};
             UPDATE job SET state = 'committed', lease_owner = NULL, leased_ms = NULL,
                 lease_expires_ms = NULL, control_steps = NULL
             WHERE campaign_id = {id} AND unit_order = {index};",
            pack = sha("primitives"),
            scene = sha(&task),
            state = sha(&format!("{task}/{}", row["init_id"])),
            perturbation = match row["axis"].as_str() {
                Some("clean") => String::new(),
                axis => format!("{}:{}", axis.expect("an axis"), sha(&row["perturb"].to_string())),
            },
        ))
        .await;
    }
}

#[tokio::test]
async fn a_database_of_schema_1_is_upgraded_and_its_campaigns_continue() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let pool = first_schema(folder.path()).await;
    insert_campaign(&pool, 1, "drawn", ["", "llvmpipe"]).await;
    insert_campaign(&pool, 2, "blind", ["", ""]).await;
    insert_campaign(&pool, 3, "mixed", ["NVIDIA", "llvmpipe"]).await;
    pool.close().await;

    let clock = Arc::new(ManualClock::at(UnixMillis(NOW_MS)));
    let bench = Bench::start_in(folder, clock).await;
    let pool = bench.database().await;
    let pins: Vec<(String, Option<String>, i64)> = sqlx::query_as(
        "SELECT c.name, c.renderer, (SELECT count(*) FROM result r JOIN provenance p
             ON p.id = r.provenance_id WHERE r.campaign_id = c.id AND p.fingerprint = '')
         FROM campaign c ORDER BY c.id",
    )
    .fetch_all(&pool)
    .await
    .expect("campaigns");
    let renderers: Vec<(Option<String>, i64)> = sqlx::query_as(
        "SELECT p.renderer, count(*) FROM result r JOIN provenance p ON p.id = r.provenance_id
         GROUP BY p.renderer ORDER BY p.renderer",
    )
    .fetch_all(&pool)
    .await
    .expect("renderers");
    pool.close().await;
    let pin = |name: &str, renderer: Option<&str>| (name.to_owned(), renderer.map(Into::into), 2);
    assert_eq!(
        pins,
        [pin("drawn", Some("llvmpipe")), pin("blind", None), pin("mixed", Some("NVIDIA")),],
        "pinned to the renderer of the first drawn result"
    );
    let renderer_count = |renderer: &str, results| (Some(renderer.to_owned()), results);
    assert_eq!(
        renderers,
        [renderer_count("", 3), renderer_count("NVIDIA", 1), renderer_count("llvmpipe", 2)]
    );
    assert_eq!(bench.count("SELECT count(*) FROM job").await, 12);
    assert_eq!(bench.count("SELECT count(*) FROM motion").await, 6);
    assert_eq!(bench.status("drawn").await.committed, 2);

    // Only the campaign for which no frame was drawn accepts any renderer.
    let mut worker = bench.worker_with_renderer("new", "primitives", "software").await;
    let leases = worker.claim(64).await;
    let campaigns: Vec<&str> = leases.iter().map(|lease| lease.campaign.as_str()).collect();
    assert_eq!(campaigns, ["blind"; 2]);
    for lease in &leases {
        assert_eq!(worker.commit(lease, true).await, Verdict::Accepted);
    }
    let idle = worker.claim_response("").await.idle_reason;
    for word in ["`drawn`", "renderer `llvmpipe`", "`mixed`", "renderer `NVIDIA`"] {
        assert!(idle.contains(word), "{idle}");
    }
    let mut older = bench.worker_with_renderer("gl", "primitives", "llvmpipe").await;
    let lease = older.claim_one().await;
    assert_eq!(lease.campaign, "drawn");
    assert_eq!(older.commit(&lease, true).await, Verdict::Accepted);
    assert_eq!(bench.count("SELECT count(*) FROM campaign WHERE renderer = 'software'").await, 1);

    let folder = bench.stop().await;
    assert_eq!(check(folder.path()).await.expect("a database"), []);
}

/// Returns the SQL of every table, index and trigger, as SQLite stores it.
async fn schema(folder: &Path) -> Vec<(String, String)> {
    let pool = open_database(folder).await;
    let schema = sqlx::query_as("SELECT name, coalesce(sql, '') FROM sqlite_schema ORDER BY name");
    let schema = schema.fetch_all(&pool).await.expect("a schema");
    pool.close().await;
    schema
}

/// Counts rows that an upgrade must not lose: jobs of each final state, results with their
/// outcomes, failures, motions.
async fn count_kept_rows(folder: &Path) -> Vec<(String, i64)> {
    let pool = open_database(folder).await;
    let counts = sqlx::query_as(
        "SELECT 'jobs', count(*) FROM job
         UNION ALL SELECT 'committed', count(*) FROM job WHERE state = 'committed'
         UNION ALL SELECT 'quarantined', count(*) FROM job WHERE state = 'quarantined'
         UNION ALL SELECT 'attempts', sum(attempt) FROM job
         UNION ALL SELECT 'results', count(*) FROM result
         UNION ALL SELECT 'steps', sum(steps + 1000 * success) FROM result
         UNION ALL SELECT 'charged', sum(charged) FROM failure
         UNION ALL SELECT 'failures or leases',
             (SELECT count(*) FROM failure) + (SELECT count(*) FROM job WHERE state = 'leased')
         UNION ALL SELECT 'motions', count(*) FROM motion
         UNION ALL SELECT 'campaigns', count(*) FROM campaign",
    );
    let counts = counts.fetch_all(&pool).await.expect("counts");
    pool.close().await;
    counts
}

#[tokio::test(flavor = "multi_thread")]
async fn the_database_of_every_released_schema_is_upgraded_with_its_rows() {
    let fresh = Bench::start().await.stop().await;
    let fresh = schema(fresh.path()).await;
    let migrations = fresh.iter().filter(|(name, _)| name == "_sqlx_migrations");
    assert_eq!(migrations.count(), 1);
    let newest = queue::newest_known_schema();
    assert_eq!(RELEASED.len(), usize::try_from(newest - 1).expect("few"));
    for (version, released) in (1..).zip(RELEASED) {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let options = SqliteConnectOptions::new()
            .filename(folder.path().join(DATABASE_FILE))
            .create_if_missing(true)
            // Dumps may insert rows before the rows that they refer to.
            .foreign_keys(false);
        let pool = SqlitePool::connect_with(options).await.expect("a database");
        sqlx::raw_sql(released).execute(&pool).await.expect("rows");
        let now: i64 = sqlx::query_scalar("SELECT max(last_seen_ms) FROM worker")
            .fetch_one(&pool)
            .await
            .expect("an instant");
        pool.close().await;
        // An archive with this database is refused for holding several campaigns, not for its
        // schema.
        let archived = tempfile::tempdir().expect("a temporary folder");
        let database = archived.path().join(DATABASE_FILE);
        std::fs::copy(folder.path().join(DATABASE_FILE), database).expect("copied");
        let refused = queue::Portable::open(archived.path()).await;
        let refused = refused.expect_err("several campaigns").to_string();
        assert!(refused.contains("campaigns, not one"), "schema {version}: {refused}");
        let before = count_kept_rows(folder.path()).await;
        assert!(before.iter().all(|(_, count)| *count > 0), "{before:?}");

        let clock = Arc::new(ManualClock::at(UnixMillis(now)));
        let bench = Bench::start_in(folder, clock.clone()).await;
        assert_eq!(count_kept_rows(bench.folder.path()).await, before, "schema {version}");
        // In the dumps from schema 5 on, one campaign explains another.
        let derived = bench.count("SELECT count(*) FROM derivation").await;
        assert_eq!(derived, i64::from(version >= 5), "schema {version}");
        let leased = "SELECT count(*) FROM job WHERE state = 'leased'";
        assert_eq!(bench.count(leased).await, 0, "schema {version}");
        let folder = bench.stop().await;
        let data = folder.path().to_str().expect("UTF-8");
        let output = coordinator(&["check", data]);
        assert!(output.status.success(), "{}", text(&output.stdout));
        assert_eq!(schema(folder.path()).await, fresh, "schema {version}");

        // Waiting jobs of running campaigns are leased again.
        let bench = Bench::start_in(folder, clock).await;
        let pool = bench.database().await;
        let renderer: String = sqlx::query_scalar("SELECT max(renderer) FROM campaign")
            .fetch_one(&pool)
            .await
            .expect("a renderer");
        pool.close().await;
        let mut worker = bench.worker_with_renderer("new", "primitives", &renderer).await;
        let open = "SELECT count(*) FROM job j JOIN campaign c ON c.id = j.campaign_id
             WHERE j.state = 'queued' AND c.state = 'running'";
        let open = usize::try_from(bench.count(open).await).expect("few");
        let leases = worker.claim(64).await;
        assert_eq!(leases.len(), open, "schema {version}");
        for lease in &leases {
            worker.release(lease, Reason::Draining).await;
        }
        let folder = bench.stop().await;
        assert_eq!(check(folder.path()).await.expect("a database"), []);
    }
}

/// Upgrades a database of a development version whose third migration included today's fourth.
#[tokio::test]
async fn a_development_database_with_a_combined_third_migration_is_upgraded() {
    let folder = Bench::start().await.stop().await;
    let expected = schema(folder.path()).await;
    let pool = open_database(folder.path()).await;
    sqlx::raw_sql(
        "DELETE FROM _sqlx_migrations WHERE version = 4;
         UPDATE _sqlx_migrations SET checksum = x'c72edb7d6ab23f7fec0c961407d9c3da302ba47620bd0b1fd51042840882470fdc2a626d4af01e92d7fbb7ec1df4a671'
         WHERE version = 3",
    )
    .execute(&pool)
    .await
    .expect("altered");
    pool.close().await;
    let clock = Arc::new(ManualClock::at(UnixMillis(NOW_MS)));
    let folder = Bench::start_in(folder, clock).await.stop().await;
    assert_eq!(schema(folder.path()).await, expected);
    assert_eq!(check(folder.path()).await.expect("a database"), []);
}
