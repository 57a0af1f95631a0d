//! Films stored in another folder or in S3-compatible storage, which may be unavailable.

use std::net::{SocketAddr, TcpListener, TcpStream};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use proto::coordinator::commit_response::Verdict;
use tempfile::TempDir;

use crate::artifacts::put;
use crate::harness::{Worker, assert_sound, rollout_id, small_spec};
use crate::page::send;
use crate::process::{Serve, serve_command, succeed, text};

/// Variable with the path of the S3 server for tests: `moto_server` of the package `moto[server]`.
const SERVER: &str = "ROLLOUT_S3_SERVER";
/// Longest wait until a film is stored; while the storage fails, the coordinator pauses up to 60 s
/// between retries.
const PATIENCE: Duration = Duration::from_secs(90);

/// An S3 server that keeps objects in memory; killed when dropped.
struct Bucket {
    child: Child,
    address: SocketAddr,
}

impl Bucket {
    fn start(program: &str, address: SocketAddr) -> Bucket {
        let child = Command::new(program)
            .args(["-H", "127.0.0.1", "-p", &address.port().to_string()])
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .expect("starts");
        let bucket = Bucket { child, address };
        let began = Instant::now();
        while TcpStream::connect(address).is_err() {
            assert!(began.elapsed() < PATIENCE, "{program} does not listen");
            std::thread::sleep(Duration::from_millis(100));
        }
        assert_eq!(send(&format!("http://{address}"), "PUT /films").code, 200);
        bucket
    }

    fn keys(&self) -> Vec<String> {
        let list = send(&format!("http://{}", self.address), "GET /films?list-type=2");
        let body = list.text();
        let keys = body.split("<Key>").skip(1);
        keys.filter_map(|entry| Some(entry.split_once("</Key>")?.0.to_owned())).collect()
    }
}

impl Drop for Bucket {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn free_address() -> SocketAddr {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a free port");
    listener.local_addr().expect("an address")
}

fn variables(address: SocketAddr) -> Vec<(&'static str, String)> {
    vec![
        ("AWS_ENDPOINT_URL", format!("http://{address}")),
        ("AWS_ALLOW_HTTP", "true".to_owned()),
        ("AWS_REGION", "us-east-1".to_owned()),
        ("AWS_ACCESS_KEY_ID", "tested".to_owned()),
        ("AWS_SECRET_ACCESS_KEY", "tested".to_owned()),
    ]
}

fn serve(data: &Path, place: &str, variables: &[(&str, String)]) -> Serve {
    let variables = variables.iter().map(|(name, value)| (name, value));
    Serve::spawn(serve_command(data).env("ROLLOUT_ARTIFACTS", place).envs(variables))
}

fn run(serve: &Serve, arguments: &[&str]) -> String {
    succeed(serve.command(arguments))
}

/// Commits a rollout and uploads its film. Returns the rollout's id.
async fn film(worker: &mut Worker, bytes: &[u8]) -> String {
    let lease = worker.claim_one().await;
    assert_eq!(worker.commit(&lease, true).await, Verdict::Accepted);
    put(worker, &lease, "video.mp4", &[bytes.to_vec()]).await.expect("stored");
    rollout_id(&lease)
}

fn local_films(folder: &TempDir) -> usize {
    let films = std::fs::read_dir(folder.path().join("artifacts/filmed"));
    films.map_or(0, Iterator::count)
}

async fn wait_until(event: &str, has_happened: impl Fn() -> bool) {
    let began = Instant::now();
    while !has_happened() {
        assert!(began.elapsed() < PATIENCE, "timed out waiting until {event}");
        tokio::time::sleep(Duration::from_millis(200)).await;
    }
}

/// Asserts that a browser can load a whole film and ranges of it.
fn assert_served(serve: &Serve, rollout: &str, bytes: &[u8]) {
    let get = |headers: &str| {
        send(&serve.url, &format!("GET /campaigns/filmed/videos/{rollout}\n{headers}"))
    };
    let whole = get("");
    assert_eq!(whole.code, 200);
    assert!(whole.body == bytes, "the served film differs");
    for (range, expected) in [
        ("bytes=10-19", &bytes[10..20]),
        ("bytes=100-", &bytes[100..]),
        ("bytes=-7", &bytes[bytes.len() - 7..]),
    ] {
        let part = get(&format!("range: {range}"));
        assert_eq!(part.code, 206);
        assert!(part.body == expected, "{range}");
        let sent = part.header("content-range").expect("a range");
        assert!(
            sent.starts_with("bytes ") && sent.ends_with(&format!("/{}", bytes.len())),
            "{sent}"
        );
    }
    let beyond_end = get(&format!("range: bytes={}-", bytes.len()));
    assert_eq!(beyond_end.code, 416);
    let size = format!("bytes */{}", bytes.len());
    assert_eq!(beyond_end.header("content-range"), Some(size.as_str()));
}

fn some_film(seed: u8) -> Vec<u8> {
    (0..300_000_u32).map(|index| (index / 7) as u8 ^ seed).collect()
}

/// Stores, serves, archives, imports and deletes films at `place`; `stored` counts the films there.
async fn check_film_lifecycle(
    place: &str,
    variables: &[(&str, String)],
    stored: &dyn Fn() -> usize,
) {
    let folder = tempfile::tempdir().expect("a folder");
    let coordinator = serve(folder.path(), place, variables);
    coordinator.create(&small_spec("filmed"));
    let mut worker = coordinator.worker("a").await;
    let (first, second) = (some_film(1), some_film(2));
    let first_rollout = film(&mut worker, &first).await;
    assert_served(&coordinator, &first_rollout, &first);
    let second_rollout = film(&mut worker, &second).await;
    wait_until("both films are stored", || local_films(&folder) == 0 && stored() == 2).await;
    assert_served(&coordinator, &first_rollout, &first);
    assert_served(&coordinator, &second_rollout, &second);

    // A restarted coordinator serves the films, and so does another coordinator that imports an
    // archive.
    drop(coordinator);
    let coordinator = serve(folder.path(), place, variables);
    assert_served(&coordinator, &second_rollout, &second);
    let archive = folder.path().join("filmed.tar.gz").display().to_string();
    run(&coordinator, &["campaign", "archive", "filmed", "--output", &archive]);
    let other_folder = tempfile::tempdir().expect("a folder");
    let other_coordinator = Serve::start(other_folder.path());
    let message = run(&other_coordinator, &["campaign", "import", &archive]);
    assert!(message.contains("2 films"), "{message}");
    assert_served(&other_coordinator, &first_rollout, &first);
    assert_eq!(local_films(&other_folder), 2);

    let delete = ["campaign", "delete", "filmed", "--confirm", "filmed"];
    run(&coordinator, &delete);
    wait_until("no object is left", || stored() == 0).await;
    assert_sound(folder.path()).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn films_are_stored_in_another_folder() {
    let folder = tempfile::tempdir().expect("a folder");
    let storage_folder = folder.path().join("films");
    let stored = || {
        let campaign = std::fs::read_dir(storage_folder.join("artifacts/filmed"));
        campaign.map_or(0, Iterator::count)
    };
    check_film_lifecycle(&storage_folder.display().to_string(), &[], &stored).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn films_and_archives_are_stored_in_a_bucket() {
    let Ok(program) = std::env::var(SERVER) else {
        println!("skipped films_and_archives_are_stored_in_a_bucket: no {SERVER}");
        return;
    };
    let address = free_address();
    let bucket = Bucket::start(&program, address);
    let variables = variables(address);
    check_film_lifecycle("s3://films/lab/one", &variables, &|| bucket.keys().len()).await;

    let folder = tempfile::tempdir().expect("a folder");
    let coordinator = serve(folder.path(), "s3://films/lab/two", &variables);
    coordinator.create(&small_spec("filmed"));
    let run = |arguments: &[&str]| {
        let output = Command::new(env!("CARGO_BIN_EXE_coordinator"))
            .args(arguments)
            .args(["--connect", &coordinator.url])
            .envs(variables.iter().map(|(name, value)| (name, value)))
            .output()
            .expect("runs");
        (output.status.success(), text(&output.stderr).to_owned())
    };
    let address = "s3://films/archives/filmed.tar.gz";
    let done = run(&["campaign", "archive", "filmed", "--output", address]);
    assert!(done.0, "{}", done.1);
    assert_eq!(bucket.keys(), ["archives/filmed.tar.gz"]);
    let done = run(&["campaign", "import", address, "--as", "again"]);
    assert!(done.0, "{}", done.1);
    let (done, message) = run(&["campaign", "import", "s3://films/nowhere.tar.gz"]);
    assert!(!done && message.contains("there is no such object"), "{message}");
    let (done, message) = run(&["campaign", "import", "s3://films"]);
    assert!(!done && message.contains("s3://BUCKET/FOLDER"), "{message}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_storage_outage_loses_no_rollout_and_no_film() {
    let Ok(program) = std::env::var(SERVER) else {
        println!("skipped a_storage_outage_loses_no_rollout_and_no_film: no {SERVER}");
        return;
    };
    let address = free_address();
    let variables = variables(address);
    let folder = tempfile::tempdir().expect("a folder");
    let coordinator = serve(folder.path(), "s3://films", &variables);
    coordinator.create(&small_spec("filmed"));
    let mut worker = coordinator.worker("a").await;
    let bytes = some_film(3);
    let rollout = film(&mut worker, &bytes).await;
    film(&mut worker, &bytes).await;
    tokio::time::sleep(Duration::from_secs(5)).await;
    assert_eq!(local_films(&folder), 2);
    assert_served(&coordinator, &rollout, &bytes);
    let jobs = run(&coordinator, &["jobs", "filmed", "--json"]);
    let jobs: serde_json::Value = serde_json::from_str(&jobs).expect("JSON");
    let jobs = jobs.to_string();
    assert!(!jobs.contains("\"charged_attempts\":1"), "{jobs}");

    let bucket = Bucket::start(&program, address);
    wait_until("the films are stored", || local_films(&folder) == 0).await;
    assert_eq!(bucket.keys().len(), 2);
    assert_served(&coordinator, &rollout, &bytes);
    drop(bucket);
    // The campaign can be deleted while the storage is unavailable; its films are removed later.
    run(&coordinator, &["campaign", "cancel", "filmed"]);
    let delete = ["campaign", "delete", "filmed", "--confirm", "filmed"];
    run(&coordinator, &delete);
    assert_sound(folder.path()).await;
}
