//! What workers ask for costs the same in any campaign: every statement that it
//! executes is caught on its way, and SQLite's plan for it walks an index or a
//! table of a few rows, never the jobs or their results. A process of its own,
//! so that no other test's statements are caught.

use std::collections::BTreeSet;
use std::fmt::Debug;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use attempt::{AttemptId, Digests, Motion, Pin, Provenance, Realised, RolloutResult};
use queue::clock::{ManualClock, UnixMillis};
use queue::expand::NewCampaign;
use queue::ids::WorkerId;
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

/// Tables of a few rows, by the names that statements give them: campaigns,
/// their tasks, policies, workers, origins.
const SMALL: [&str; 7] = ["c", "t", "p", "w", "campaign", "policy", "worker"];
/// Indices that hold the leased, the backed-off, or the lone jobs only.
const OF_FEW_JOBS: [&str; 4] = ["job_leased", "job_held", "job_backed_off", "job_alone"];
/// What the hot statements must be seen to walk.
const WALKED: [&str; 4] = ["job_queued", "job_leased", "job_siblings", "worker_seen"];

/// Catches the statements that sqlx executes.
#[derive(Clone, Default)]
struct Caught(Arc<Mutex<BTreeSet<String>>>);

struct Text<'a>(&'a Caught);

impl<S: tracing::Subscriber> Layer<S> for Caught {
    fn on_event(&self, event: &tracing::Event<'_>, _: Context<'_, S>) {
        if event.metadata().target() == "sqlx::query" {
            event.record(&mut Text(self));
        }
    }
}

impl Visit for Text<'_> {
    fn record_str(&mut self, field: &Field, value: &str) {
        // A short statement is its own summary.
        let is_cut = field.name() == "summary" && value.ends_with('…');
        if ["summary", "db.statement"].contains(&field.name()) && !is_cut {
            let mut caught = self.0.0.lock().unwrap_or_else(PoisonError::into_inner);
            caught.insert(value.trim().to_owned());
        }
    }

    fn record_debug(&mut self, _: &Field, _: &dyn Debug) {}
}

fn digest(of: char) -> String {
    of.to_string().repeat(64)
}

fn pin() -> Pin {
    Pin {
        asset_pack: "primitives".to_owned(),
        asset_pack_digest: digest('a'),
        mujoco_version: "3.3.7".to_owned(),
        renderer: "llvmpipe".to_owned(),
    }
}

fn claim(number: u32, warm_task: Option<&str>) -> ClaimRequest {
    ClaimRequest {
        worker: WorkerId("a".to_owned()),
        claim: format!("{number:032x}"),
        warm_task: warm_task.map(str::to_owned),
        lacking_tasks: Default::default(),
    }
}

fn report(attempt: AttemptId) -> CommitReport {
    CommitReport {
        attempt,
        motion: Motion::default(),
        realised: Realised::default(),
        result: RolloutResult {
            success: true,
            steps: 9,
            wall_secs: 1.0,
            ik: None,
            clipped_actions: 0,
            policy_queries: 1,
            parts: None,
            goal: None,
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
        digests: Digests {
            scene: digest('b'),
            init_state: digest('c'),
            first_frame: String::new(),
        },
    }
}

/// Everything that workers ask for, and the sweeps, good and bad.
async fn everything(queue: &Queue, clock: &ManualClock) {
    let mut claims = 0;
    let mut lease = async |warm: Option<&str>| -> Option<AttemptId> {
        claims += 1;
        let request = claim(claims, warm);
        let claimed = queue.claim(&request, Duration::ZERO).await;
        let attempt = claimed.expect("an answer").job.map(|job| job.attempt);
        // The answer was lost: it is asked for again.
        let again = queue.claim(&request, Duration::ZERO).await;
        assert_eq!(
            again.expect("an answer").job.map(|job| job.attempt),
            attempt
        );
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
    divergent.result.success = false;
    let reply = queue.commit(&divergent).await.expect("a verdict");
    assert_eq!(reply.verdict, CommitVerdict::Divergent);
    for (attempt, reason) in [
        (leases[2], FailureReason::SlotCrashed),
        (leases[3], FailureReason::PolicyUnavailable),
    ] {
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

/// What is wrong with SQLite's plan of a statement, and the indices it walks.
async fn look_at(
    connection: &mut SqliteConnection,
    statement: &str,
) -> (Vec<String>, BTreeSet<String>) {
    let explain = format!("EXPLAIN QUERY PLAN {statement}");
    let lines: Vec<(i64, i64, i64, String)> = sqlx::query_as(sqlx::AssertSqlSafe(explain))
        .fetch_all(connection)
        .await
        .unwrap_or_else(|error| panic!("{statement}: {error}"));
    let mut faults = Vec::new();
    let mut walked = BTreeSet::new();
    for (.., line) in lines {
        let words: Vec<&str> = line.split_whitespace().collect();
        let index = words.iter().position(|word| *word == "INDEX");
        let index = index.and_then(|place| words.get(place + 1)).copied();
        walked.extend(index.map(str::to_owned));
        let is_scan = words[0] == "SCAN" && words[1] != "CONSTANT";
        // `json_each` walks what the statement brought along.
        let is_small = SMALL.contains(&words[1])
            || words[1].starts_with('(')
            || line.contains("VIRTUAL TABLE");
        if is_scan && !is_small && !index.is_some_and(|index| OF_FEW_JOBS.contains(&index)) {
            faults.push(line);
        }
    }
    (faults, walked)
}

#[tokio::test]
async fn no_statement_of_a_worker_or_a_sweep_walks_the_jobs() {
    let caught = Caught::default();
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
    // Two of them, which share the workers.
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
    tracing_subscriber::registry().with(caught.clone()).init();
    everything(&queue, &clock).await;
    let statements = caught
        .0
        .lock()
        .unwrap_or_else(PoisonError::into_inner)
        .clone();
    queue.close().await.expect("closes");

    let file = folder.path().join(DATABASE_FILE);
    let options = SqliteConnectOptions::new().filename(file).read_only(true);
    let mut connection = options.connect().await.expect("a database");
    let verbs = ["SELECT", "INSERT", "UPDATE", "DELETE"];
    assert!(
        statements
            .iter()
            .any(|it| it.contains("GROUP BY campaign_id")),
        "what campaigns hold is compared"
    );
    // A new origin comes once per kind of worker, not once per rollout, and
    // SQLite would look for its children only if references were broken.
    let is_hot = |statement: &&String| {
        verbs.iter().any(|verb| statement.starts_with(verb))
            && !statement.starts_with("INSERT INTO provenance")
    };
    let looked_at: Vec<&String> = statements.iter().filter(is_hot).collect();
    assert!(looked_at.len() >= 20, "{statements:#?}");
    let mut walked = BTreeSet::new();
    for statement in looked_at {
        let (faults, indices) = look_at(&mut connection, statement).await;
        assert!(faults.is_empty(), "{faults:?} in\n{statement}");
        walked.extend(indices);
    }
    for index in WALKED {
        assert!(walked.contains(index), "{index} is not walked: {walked:?}");
    }
    connection.close().await.expect("closes");
}
