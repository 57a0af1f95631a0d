//! The coordinator's background tasks: none blocks connections or signals, and a panic in one of
//! them ends the coordinator with an error, so that its supervisor restarts it.

use std::process::{Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use coordinator::{Coordinator, ServeError};
use proto::coordinator as wire;
use proto::coordinator::operator_service_client::OperatorServiceClient;
use proto::coordinator::worker_service_client::WorkerServiceClient;
use queue::PANIC_VARIABLE;
use queue::clock::{Clock, ManualClock, UnixMillis};
use sqlx::Connection;
use tokio::net::TcpListener;
use tokio::task::JoinSet;

use crate::harness::{config, registration};

/// A clock that panics once broken; the writer reads it in every transaction.
#[derive(Default)]
struct BreakableClock {
    clock: ManualClock,
    broken: AtomicBool,
}

impl Clock for BreakableClock {
    fn now(&self) -> UnixMillis {
        assert!(!self.broken.load(Ordering::SeqCst), "the clock is broken");
        self.clock.now()
    }
}

/// Regression: panics of spawned tasks were not noticed, and a coordinator whose writer
/// had panicked answered "shutting down" forever.
#[tokio::test(flavor = "multi_thread")]
async fn a_panic_of_the_writer_stops_the_coordinator_with_an_error() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let clock = Arc::new(BreakableClock::default());
    let mut config = config(folder.path(), clock.clone());
    // No disk has this much free space; once a claim's answer reports the shortage, the first sweep
    // is over.
    config.min_free_bytes = u64::MAX;
    let listener = TcpListener::bind("127.0.0.1:0").await.expect("a free port");
    let address = listener.local_addr().expect("an address");
    let coordinator = Coordinator::open(config).await.expect("a coordinator");
    let mut served = JoinSet::new();
    served.spawn(coordinator.serve(listener, std::future::pending()));
    let mut worker =
        WorkerServiceClient::connect(format!("http://{address}")).await.expect("a connection");
    let registered = worker.register(registration("a", "primitives")).await;
    registered.expect("registers");
    let mut claim =
        wire::ClaimRequest { worker_id: "a".to_owned(), ..wire::ClaimRequest::default() };
    for number in 1.. {
        claim.claim_id = format!("{number:032x}");
        let claimed = worker.claim(claim.clone()).await.expect("an answer");
        if claimed.into_inner().idle_reason.contains("MiB left") {
            break;
        }
        tokio::time::sleep(Duration::from_millis(10)).await;
    }

    clock.broken.store(true, Ordering::SeqCst);
    let heartbeat =
        wire::HeartbeatRequest { worker_id: "a".to_owned(), ..wire::HeartbeatRequest::default() };
    worker.heartbeat(heartbeat).await.expect_err("no writer");
    let ended = tokio::time::timeout(Duration::from_secs(20), served.join_next());
    let ended = ended.await.expect("an end of the coordinator").expect("a task");
    let error = ended.expect("no panic").expect_err("an error");
    assert!(matches!(error, ServeError::Panicked { .. }), "{error:?}");
}

/// Regression: the loop that accepts connections and signals also awaited the sweep.
#[tokio::test(flavor = "multi_thread")]
async fn connections_and_signals_are_served_while_the_database_is_locked() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let mut config = config(folder.path(), Arc::new(ManualClock::default()));
    config.timing.sweep = Duration::from_millis(20);
    let listener = TcpListener::bind("127.0.0.1:0").await.expect("a free port");
    let address = listener.local_addr().expect("an address");
    let coordinator = Coordinator::open(config).await.expect("a coordinator");
    let database = folder.path().join("coordinator.sqlite");
    let mut writer = sqlx::SqliteConnection::connect_with(
        &sqlx::sqlite::SqliteConnectOptions::new().filename(database),
    )
    .await
    .expect("the database");
    let locked = sqlx::query("BEGIN IMMEDIATE").execute(&mut writer).await;
    locked.expect("a lock");
    let (stop, stopped) = tokio::sync::oneshot::channel::<()>();
    let mut served = JoinSet::new();
    served.spawn(coordinator.serve(listener, async {
        let _ = stopped.await;
    }));
    // After this time, some sweeps wait for the locked database.
    tokio::time::sleep(Duration::from_millis(200)).await;
    let connected = tokio::time::timeout(
        Duration::from_secs(5),
        OperatorServiceClient::connect(format!("http://{address}")),
    );
    let mut operator = connected.await.expect("in time").expect("a connection");
    let listed = operator.list_campaigns(wire::ListCampaignsRequest::default());
    let listed = tokio::time::timeout(Duration::from_secs(5), listed).await;
    listed.expect("in time").expect("an answer");
    drop(operator);
    stop.send(()).expect("a running coordinator");
    let refuses = async {
        while tokio::net::TcpStream::connect(address).await.is_ok() {
            tokio::time::sleep(Duration::from_millis(10)).await;
        }
    };
    let refused = tokio::time::timeout(Duration::from_secs(5), refuses).await;
    refused.expect("a closed port");
    drop(writer);
    let ended = served.join_next().await.expect("a task");
    ended.expect("no panic").expect("no error");
}

fn tasks_of(source: &str) -> Vec<&str> {
    let calls = source.split("spawn(").skip(1);
    calls.filter_map(|call| Some(call.trim_start().strip_prefix('"')?.split_once('"')?.0)).collect()
}

#[test]
fn a_panic_of_a_background_task_stops_the_coordinator_and_names_the_task() {
    let mut names = tasks_of(include_str!("../../../crates/queue/src/queue.rs"));
    names.extend(tasks_of(include_str!("../../src/serve.rs")));
    assert!(names.len() >= 7, "{names:?}");
    for name in names {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let films = tempfile::tempdir().expect("a temporary folder");
        let child = Command::new(env!("CARGO_BIN_EXE_coordinator"))
            .args(["serve", "--listen", "127.0.0.1:0", "--data"])
            .arg(folder.path())
            .arg("--artifacts")
            .arg(films.path())
            .env(PANIC_VARIABLE, name)
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn();
        let mut child = child.expect("starts");
        let began = Instant::now();
        while child.try_wait().expect("a child").is_none() {
            if began.elapsed() > Duration::from_secs(30) {
                child.kill().expect("killed");
                panic!("{name} panicked, and the coordinator still runs");
            }
            std::thread::sleep(Duration::from_millis(20));
        }
        let output = child.wait_with_output().expect("finished");
        let error = String::from_utf8_lossy(&output.stderr);
        assert!(!output.status.success(), "{name}: {error}");
        assert!(error.contains(&format!("{name} panicked")), "{name}: {error}");
    }
}
