//! Query plans: the cost of workers' calls, pages, metrics and the queue's own tasks does not
//! depend on the size of a campaign. Every statement is captured, and SQLite's plan for it walks an
//! index or a table of a few rows, never all jobs or results. The tests run in a separate process,
//! so that no statements of other tests are captured.

use std::collections::BTreeSet;
use std::fmt::Debug;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use benchmark::ManifestRow;
use benchmark::attempt::{
    AttemptId, Digests, GoalProgress, Measurement, Motion, Pin, Provenance, RolloutResult,
};
use queue::clock::{ManualClock, UnixMillis};
use queue::expand::NewCampaign;
use queue::ids::{CampaignName, JobName, WorkerId};
use queue::rules::lease::FailureReason;
use queue::{
    ClaimRequest, CommitReport, CommitVerdict, DATABASE_FILE, Queue, Store, Timing, WorkerInfo,
};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use serde_json::json;
use sqlx::sqlite::SqliteConnectOptions;
use sqlx::{ConnectOptions, Connection, SqliteConnection};
use tracing::field::{Field, Visit};
use tracing_subscriber::layer::{Context, Layer, SubscriberExt};
use tracing_subscriber::util::SubscriberInitExt;

/// Tables of a few rows, by the names and aliases that statements give them: `c` campaigns, `t`
/// their tasks or tallies, `p` policies, `w` workers, `d` divergences, `s` stop
/// rules.
const SMALL_TABLES: [&str; 10] =
    ["c", "t", "p", "w", "d", "s", "campaign", "policy", "worker", "ending_tally"];
/// Indices that hold only jobs that are leased, backed off, run alone or avoid a machine.
const SMALL_INDICES: [&str; 5] =
    ["job_leased", "job_held", "job_backed_off", "job_alone", "job_failing"];
/// Indices that frequent statements must walk.
const REQUIRED_INDICES: [&str; 5] =
    ["job_queued", "job_leased", "job_failing", "job_siblings", "worker_seen"];

/// Evidence that a loop of the table in docs/dev/ARCHITECTURE.md does not walk all jobs of a
/// campaign, or the reason why it may.
enum Walks {
    /// Part of a statement that must be captured.
    Captured(&'static str),
    /// Walks the jobs of one campaign on purpose.
    OnPurpose(&'static str),
}
use Walks::{Captured, OnPurpose};

/// The loops of the table, in its order.
const LOOPS: [(&str, Walks); 10] = [
    ("claim", Captured("UPDATE job SET state = 'leased'")),
    ("commit", Captured("INSERT INTO result")),
    ("sweep", Captured("lease_expires_ms <=")),
    ("status, front page, metrics", Captured("ending_tally")),
    ("early stop", Captured("FROM stop s")),
    ("films", Captured("record = 'transitions'")),
    ("mixed fingerprints", OnPurpose("only for a campaign whose tally shows several fingerprints")),
    (
        "statistics of a page",
        OnPurpose("one computation at a time: an_abandoned_computation_is_not_started_again"),
    ),
    (
        "a large campaign is created, extended, imported or deleted",
        OnPurpose(
            "in transactions: a_large_campaign_is_inserted_and_deleted_in_hidden_batches and \
             a_large_import_takes_several_transactions_and_leaves_nothing_if_interrupted",
        ),
    ),
    ("report, export, archive", OnPurpose("on request of an operator, outside the writer")),
];

/// Returns the first column of the table of loops.
fn documented_loops() -> Vec<&'static str> {
    let page = include_str!("../../docs/dev/ARCHITECTURE.md");
    let table = page.split_once("| loop | when | rows | walks |").expect("the table").1;
    let rows = table.lines().skip(2).take_while(|line| line.starts_with('|'));
    rows.map(|row| row.split('|').nth(1).expect("a column").trim()).collect()
}

/// Collects the statements that sqlx executes.
#[derive(Clone, Default)]
struct CapturedStatements(Arc<Mutex<BTreeSet<String>>>);

/// Visitor that records the statement in the fields of an sqlx event.
struct StatementVisitor<'a>(&'a CapturedStatements);

impl CapturedStatements {
    fn lock(&self) -> MutexGuard<'_, BTreeSet<String>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl<S: tracing::Subscriber> Layer<S> for CapturedStatements {
    fn on_event(&self, event: &tracing::Event<'_>, _: Context<'_, S>) {
        if event.metadata().target() == "sqlx::query" {
            event.record(&mut StatementVisitor(self));
        }
    }
}

impl Visit for StatementVisitor<'_> {
    fn record_str(&mut self, field: &Field, value: &str) {
        // The summary of a short statement is the whole statement.
        let is_cut = field.name() == "summary" && value.ends_with('…');
        if ["summary", "db.statement"].contains(&field.name()) && !is_cut {
            self.0.lock().insert(value.trim().to_owned());
        }
    }

    fn record_debug(&mut self, _: &Field, _: &dyn Debug) {}
}

fn digest(digit: char) -> String {
    digit.to_string().repeat(64)
}

fn pin() -> Pin {
    Pin {
        asset_pack: "primitives".to_owned(),
        asset_pack_digest: digest('a'),
        mujoco_version: "3.3.7".to_owned(),
        renderer: "llvmpipe".to_owned(),
        look: benchmark::Look::default(),
    }
}

fn claim(number: u32, warm_task: Option<&str>) -> ClaimRequest {
    ClaimRequest {
        worker: WorkerId("a".to_owned()),
        claim: format!("{number:032x}"),
        warm_task: warm_task.map(str::to_owned),
        means: Default::default(),
    }
}

fn report(attempt: AttemptId) -> CommitReport {
    CommitReport {
        attempt,
        motion: Motion::default(),
        measurement: Measurement {
            result: RolloutResult {
                success: true,
                steps: 9,
                wall_secs: 1.0,
                policy_queries: 1,
                goal: GoalProgress { predicates: 1, at_end: 1, at_most: 1 },
                digests: Digests {
                    scene: digest('b'),
                    init_state: digest('c'),
                    first_frame: String::new(),
                },
                ..RolloutResult::default()
            },
            provenance: Provenance {
                host: "here".to_owned(),
                pin: pin(),
                fingerprint: digest('d'),
                realisation: "matched".to_owned(),
                policy_name: "expert".to_owned(),
                policy_privileged: true,
                program_version: "0.1.0".to_owned(),
                ..Provenance::default()
            },
        },
    }
}

/// Makes claims, heartbeats, commits and releases, successful and failing, and sweeps.
async fn call_everything(queue: &Queue, clock: &ManualClock) {
    let mut claims = 0;
    let mut lease = async |warm: Option<&str>| -> Option<AttemptId> {
        claims += 1;
        let request = claim(claims, warm);
        let claimed = queue.claim(&request, Duration::ZERO).await;
        let attempt = claimed.expect("an answer").job.map(|job| job.attempt);
        // The claim is repeated, as if its answer had been lost.
        let again = queue.claim(&request, Duration::ZERO).await;
        assert_eq!(again.expect("an answer").job.map(|job| job.attempt), attempt);
        attempt
    };
    let mut leases = Vec::new();
    for warm in [None, Some("libero_object/0"), None, Some("libero_object/1")] {
        leases.push(lease(warm).await.expect("a job waits"));
    }
    let worker = WorkerId("a".to_owned());
    let beat: Vec<_> = leases.iter().map(|attempt| (*attempt, 20)).collect();
    let lost = queue.heartbeat(&worker, &beat).await;
    assert!(lost.expect("an answer").is_empty());
    for attempt in [leases[0], leases[0], leases[1]] {
        queue.commit(&report(attempt)).await.expect("a verdict");
    }
    let mut divergent = report(leases[0]);
    divergent.measurement.result.success = false;
    let reply = queue.commit(&divergent).await.expect("a verdict");
    assert_eq!(reply.verdict, CommitVerdict::Divergent);
    for (attempt, reason) in
        [(leases[2], FailureReason::SlotCrashed), (leases[3], FailureReason::PolicyUnavailable)]
    {
        let released = queue.release(attempt, reason, "on purpose").await;
        released.expect("a verdict");
    }
    assert_eq!(lease(None).await, None, "the policy is down");
    for _ in 0..8 {
        clock.advance(Duration::from_secs(10));
        queue.sweep().await.expect("a sweep");
    }
    let probe = lease(None).await.expect("the probe");
    let beat = queue.heartbeat(&worker, &[(probe, 20)]).await;
    assert!(beat.expect("an answer").is_empty());
    for _ in 0..5 {
        clock.advance(Duration::from_secs(10));
        queue.sweep().await.expect("a sweep");
    }
}

/// Returns the statements that are executed when a rollout is settled while other campaigns are
/// finished or waiting: a campaign with a stop rule and a filmed campaign.
async fn frequent_statements(queue: &Queue, captured: &CapturedStatements) -> BTreeSet<String> {
    let name = |name: &str| CampaignName::parse(name).expect("a name");
    let create = async |name: &str, priority: i32, fields: &serde_json::Value| {
        let mut spec = json!({
            "name": name,
            "policy": {"name": "another", "endpoint": "http://127.0.0.1:1"},
        });
        let spec_fields = spec.as_object_mut().expect("an object");
        spec_fields.extend(fields.as_object().expect("an object").clone());
        let mut campaign = NewCampaign::from_json(&spec.to_string()).expect("a campaign");
        campaign.priority = priority;
        queue.create_campaign(&campaign).await.expect("created");
    };
    let design = json!({
        "tasks": ["libero_object/0"], "axes": ["camera", "sensor"], "levels": ["L1"],
        "configs": [0, 1], "nominal": "eval", "record": "transitions",
    });
    create("done", 10, &design).await;
    let mut early = design;
    early["stop"] = json!({"rule": "width(I) < 0.08", "seed": 7});
    create("early", -10, &early).await;
    let mut skipped = Vec::new();
    let mut has_result = false;
    let job_of_other_campaign = loop {
        let number = 100 + u32::try_from(skipped.len()).expect("few");
        let claimed = queue.claim(&claim(number, None), Duration::ZERO).await;
        let job = claimed.expect("an answer").job.expect("a job waits");
        let row: ManifestRow = serde_json::from_str(&job.manifest_row).expect("a row");
        let job_name = JobName { rollout_id: row.id.to_string(), replicate: 0 };
        if job.campaign != name("done") {
            break (job.campaign, job_name);
        }
        if !has_result && row.axes().is_empty() {
            has_result = true;
            let reply = queue.commit(&report(job.attempt)).await;
            assert_eq!(reply.expect("a verdict").verdict, CommitVerdict::Accepted);
        } else {
            skipped.push(job_name);
        }
    };
    assert!(has_result, "a result pins the campaign, so that it can be filmed");
    captured.lock().clear();
    let skip = queue.skip_jobs(&name("done"), &skipped).await;
    assert_eq!(skip.expect("skipped"), skipped.len() as u64);
    wait_for_early_stop(captured).await;
    assert_eq!(queue.next_film(&pin(), None).await.expect("an answer"), None);

    captured.lock().clear();
    let skip = queue.skip_jobs(&job_of_other_campaign.0, &[job_of_other_campaign.1]).await;
    assert_eq!(skip.expect("skipped"), 1);
    wait_for_early_stop(captured).await;
    assert_eq!(queue.next_film(&pin(), None).await.expect("an answer"), None);
    let mut view = queue.view().await.expect("a view");
    view.statuses().await.expect("statuses");
    view.workers().await.expect("workers");
    view.policies().await.expect("policies");
    view.endings().await.expect("endings");
    drop(view);
    captured.lock().clone()
}

/// Waits until stop rules have been evaluated.
async fn wait_for_early_stop(captured: &CapturedStatements) {
    while !captured.lock().iter().any(|statement| statement.contains("FROM stop s")) {
        tokio::time::sleep(Duration::from_millis(10)).await;
    }
    // An evaluation that reads outcomes takes a few milliseconds.
    tokio::time::sleep(Duration::from_millis(300)).await;
}

async fn plan(connection: &mut SqliteConnection, statement: &str) -> Vec<String> {
    let explain = format!("EXPLAIN QUERY PLAN {statement}");
    let lines: Vec<(i64, i64, i64, String)> = sqlx::query_as(sqlx::AssertSqlSafe(explain))
        .fetch_all(connection)
        .await
        .unwrap_or_else(|error| panic!("{statement}: {error}"));
    lines.into_iter().map(|(.., line)| line).collect()
}

/// Returns the faults of SQLite's plan of a statement, and the indices that it walks.
async fn inspect_plan(
    connection: &mut SqliteConnection,
    statement: &str,
) -> (Vec<String>, BTreeSet<String>) {
    let mut faults = Vec::new();
    let mut walked = BTreeSet::new();
    for line in plan(connection, statement).await {
        let words: Vec<&str> = line.split_whitespace().collect();
        let index = words.iter().position(|word| *word == "INDEX");
        let index = index.and_then(|position| words.get(position + 1)).copied();
        walked.extend(index.map(str::to_owned));
        let is_scan = words[0] == "SCAN" && words[1] != "CONSTANT";
        // `json_each` walks values that the statement itself contains.
        let is_small = SMALL_TABLES.contains(&words[1])
            || words[1].starts_with('(')
            || line.contains("VIRTUAL TABLE");
        if is_scan && !is_small && !index.is_some_and(|index| SMALL_INDICES.contains(&index)) {
            faults.push(line);
        }
    }
    (faults, walked)
}

/// Returns the lines of SQLite's plan that walk all jobs or all results of a campaign.
async fn campaign_walks(connection: &mut SqliteConnection, statement: &str) -> Vec<String> {
    let lines = plan(connection, statement).await;
    let walks = |line: &String| {
        let index = line.split_whitespace().find(|word| {
            ["job_", "result_", "sqlite_autoindex_job", "sqlite_autoindex_result"]
                .iter()
                .any(|prefix| word.starts_with(prefix))
        });
        index.is_some_and(|index| !SMALL_INDICES.contains(&index))
            && line.ends_with("(campaign_id=?)")
    };
    lines.into_iter().filter(walks).collect()
}

#[tokio::test]
async fn no_frequent_statement_walks_all_jobs() {
    let captured = CapturedStatements::default();
    let folder = tempfile::tempdir().expect("a temporary folder");
    let store = Store::open(folder.path()).await.expect("a store");
    let clock = Arc::new(ManualClock::at(UnixMillis(1_700_000_000_000)));
    let rng = ChaCha8Rng::seed_from_u64(5);
    let queue = Queue::start(store, clock.clone(), rng, Timing::default()).await;
    let queue = queue.expect("a queue");
    let spec = json!({
        "name": "plans",
        "policy": {"name": "expert", "endpoint": "http://127.0.0.1:1"},
        "tasks": ["libero_object/0", "libero_object/1"],
        "axes": ["language"],
        "levels": ["L1", "L2", "L3"],
        "configs": [0, 1, 2],
    });
    // Creates two campaigns, which share the workers.
    for name in ["plans", "more"] {
        let mut spec = spec.clone();
        spec["name"] = name.into();
        let campaign = NewCampaign::from_json(&spec.to_string()).expect("a campaign");
        queue.create_campaign(&campaign).await.expect("created");
    }
    let worker = WorkerInfo {
        id: WorkerId("a".to_owned()),
        host: "here".to_owned(),
        slots: 2,
        machine: None,
        cores: None,
        pin: pin(),
        program_version: "0.1.0".to_owned(),
    };
    queue.register(&worker).await.expect("registered");
    tracing_subscriber::registry().with(captured.clone()).init();
    call_everything(&queue, &clock).await;
    let statements = captured.lock().clone();
    let frequent = frequent_statements(&queue, &captured).await;
    queue.close().await.expect("closes");

    let file = folder.path().join(DATABASE_FILE);
    let options = SqliteConnectOptions::new().filename(file).read_only(true);
    let mut connection = options.connect().await.expect("a database");
    let verbs = ["SELECT", "INSERT", "UPDATE", "DELETE"];
    assert!(
        statements.iter().any(|statement| statement.contains("GROUP BY campaign_id")),
        "no statement compares the leases of campaigns"
    );
    // The plan of inserting a provenance lists a search of the results that refer to it, which
    // SQLite executes only if a reference is broken; and a provenance is inserted once per kind of
    // worker, not once per rollout.
    let is_inspected = |statement: &&String| {
        verbs.iter().any(|verb| statement.starts_with(verb))
            && !statement.starts_with("INSERT INTO provenance")
    };
    let inspected: Vec<&String> = statements.iter().filter(is_inspected).collect();
    assert!(inspected.len() >= 20, "{statements:#?}");
    let mut walked = BTreeSet::new();
    for statement in inspected {
        // The scan of a large table under a small table's alias would go unnoticed.
        for alias in SMALL_TABLES {
            let words: Vec<&str> = statement.split_whitespace().collect();
            let is_large = words
                .windows(2)
                .any(|pair| ["job", "result"].contains(&pair[0]) && pair[1] == alias);
            assert!(!is_large, "`{alias}` is a large table in\n{statement}");
        }
        let (faults, indices) = inspect_plan(&mut connection, statement).await;
        assert!(faults.is_empty(), "{faults:?} in\n{statement}");
        walked.extend(indices);
    }
    for index in REQUIRED_INDICES {
        assert!(walked.contains(index), "{index} is not walked: {walked:?}");
    }

    // Regression: every settled rollout caused finished campaigns to be counted and scanned again.
    assert!(frequent.len() >= 15, "{frequent:#?}");
    for part in ["FROM stop s", "ending_tally", "record = 'transitions'"] {
        assert!(
            frequent.iter().any(|statement| statement.contains(part)),
            "{part} in {frequent:#?}"
        );
    }
    for statement in frequent.iter().filter(is_inspected) {
        let reads_outcomes = statement.contains("LEFT JOIN result r");
        assert!(!reads_outcomes, "a finished campaign is read again by\n{statement}");
        let (mut faults, _) = inspect_plan(&mut connection, statement).await;
        faults.extend(campaign_walks(&mut connection, statement).await);
        assert!(faults.is_empty(), "{faults:?} in\n{statement}");
    }
    connection.close().await.expect("closes");
    for (name, walks) in &LOOPS {
        if let Captured(part) = walks {
            let is_captured =
                statements.iter().chain(&frequent).any(|statement| statement.contains(part));
            assert!(is_captured, "{name}: {part} in {statements:#?}");
        }
    }
}

#[test]
fn every_documented_loop_is_captured_or_has_a_reason() {
    let listed = LOOPS.map(|(name, walks)| match walks {
        OnPurpose("") => panic!("{name} has no reason"),
        Captured(_) | OnPurpose(_) => name,
    });
    assert_eq!(documented_loops(), listed, "list new loops in LOOPS");
}
