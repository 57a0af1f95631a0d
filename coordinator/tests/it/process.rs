//! The `coordinator` program: killed, stopped, and called with invalid arguments.

use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, ExitStatus, Output, Stdio};
use std::time::{Duration, Instant};

use proto::coordinator as wire;
use proto::coordinator::commit_response::Verdict;
use proto::coordinator::worker_service_client::WorkerServiceClient;
use serde_json::Value;
use tempfile::TempDir;
use tokio::task::JoinSet;
use tonic::Status;

use crate::assertions::assert_contains;
use crate::harness::{Worker, open_database, registration, small_spec};

/// A `coordinator serve` process; killed when dropped.
pub(crate) struct Serve {
    child: Child,
    /// Empty if the process exited before it listened.
    pub(crate) url: String,
}

impl Serve {
    /// Starts the program on a new folder, deleted when the first returned value is dropped.
    pub(crate) fn anew() -> (TempDir, Serve) {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let serve = Serve::start(folder.path());
        (folder, serve)
    }

    /// Like [`anew`](Self::anew), with the campaign of [`CREATE`].
    pub(crate) fn with_demo() -> (TempDir, Serve) {
        let (folder, serve) = Serve::anew();
        succeed(serve.command(&CREATE));
        (folder, serve)
    }

    pub(crate) fn start(data: &Path) -> Serve {
        Serve::start_with(data, &[], Stdio::null())
    }

    /// Starts the program with further arguments and a file for its log, through a shell that
    /// ignores SIGXFSZ: a write beyond the file size limit then fails, as on a full disk, instead
    /// of killing the process.
    pub(crate) fn start_with(data: &Path, arguments: &[&str], log: Stdio) -> Serve {
        Serve::spawn(
            Command::new("sh")
                .args(["-c", "trap '' XFSZ; exec \"$0\" \"$@\""])
                .arg(env!("CARGO_BIN_EXE_coordinator"))
                .args(["serve", "--listen", "127.0.0.1:0", "--data"])
                .arg(data)
                .args(arguments)
                .env_remove("RUST_LOG")
                .stdout(Stdio::piped())
                .stderr(log),
        )
    }

    /// Starts the program, which must listen.
    pub(crate) fn spawn(command: &mut Command) -> Serve {
        let serve = Serve::wait_until_listening(command.spawn().expect("starts"));
        assert!(serve.is_ready(), "the coordinator does not listen");
        serve
    }

    /// Waits until the process listens or exits.
    pub(crate) fn wait_until_listening(mut child: Child) -> Serve {
        let mut line = String::new();
        let stdout = child.stdout.take().expect("a pipe");
        BufReader::new(stdout).read_line(&mut line).expect("a line");
        let address = line.strip_prefix("listening on ").unwrap_or_default();
        let url = match address.split([',', ' ']).next() {
            Some("") | None => String::new(),
            Some(address) => format!("http://{address}"),
        };
        Serve { child, url }
    }

    /// Returns true if the process listens.
    pub(crate) fn is_ready(&self) -> bool {
        !self.url.is_empty()
    }

    /// Returns the exit status; `None` while the process runs.
    pub(crate) fn ended(&mut self) -> Option<ExitStatus> {
        self.child.try_wait().expect("a child")
    }

    /// Sets the process's file size limit, `soft:hard`.
    pub(crate) fn limit_files(&self, limit: &str) {
        let status = Command::new("prlimit")
            .args(["--pid", &self.child.id().to_string()])
            .arg(format!("--fsize={limit}"))
            .status();
        assert!(status.expect("prlimit runs").success());
    }

    pub(crate) fn peak_memory_bytes(&self) -> u64 {
        let status = format!("/proc/{}/status", self.child.id());
        let status = std::fs::read_to_string(status).expect("a running process");
        let peak = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
        let kib = peak.and_then(|peak| peak.trim().strip_suffix(" kB"));
        kib.and_then(|kib| kib.parse::<u64>().ok()).expect("a size") << 10
    }

    fn signal(&self, name: &str) {
        let pid = self.child.id().to_string();
        let status = Command::new("kill").args([name, &pid]).status();
        assert!(status.expect("kill runs").success());
    }

    pub(crate) async fn worker(&self, id: &str) -> Worker {
        self.try_worker(id).await.expect("registers")
    }

    pub(crate) async fn try_worker(&self, id: &str) -> Result<Worker, Status> {
        let service = WorkerServiceClient::connect(self.url.clone()).await;
        let mut worker = Worker {
            id: id.to_owned(),
            pack: "primitives".to_owned(),
            renderer: "llvmpipe".to_owned(),
            look: "mujoco-3.3.2".to_owned(),
            fingerprint: "bits".to_owned(),
            service: service.map_err(|error| Status::unavailable(error.to_string()))?,
        };
        let registration = registration(id, "primitives");
        worker.service.register(registration).await?;
        Ok(worker)
    }

    /// Runs a command, which must exit with `code` and print all `parts`.
    #[track_caller]
    pub(crate) fn run(&self, arguments: &[&str], code: i32, parts: &[&str]) {
        let output = self.command(arguments);
        let printed = format!("{}{}", text(&output.stdout), text(&output.stderr));
        assert_eq!(output.status.code(), Some(code), "{arguments:?}: {printed}");
        assert_contains(&printed, parts);
    }

    pub(crate) fn create(&self, spec: &Value) {
        let file = tempfile::NamedTempFile::new().expect("a file");
        std::fs::write(file.path(), spec.to_string()).expect("written");
        let path = file.path().to_str().expect("UTF-8");
        succeed(self.command(&["campaign", "create", "--spec", path]));
    }

    pub(crate) fn command(&self, arguments: &[&str]) -> Output {
        coordinator(&[arguments, &["--connect", &self.url]].concat())
    }
}

impl Drop for Serve {
    fn drop(&mut self) {
        // The process may have exited already.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Returns the command that serves a folder, without a log.
pub(crate) fn serve_command(data: &Path) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_coordinator"));
    command.args(["serve", "--listen", "127.0.0.1:0", "--data"]).arg(data);
    command.env_remove("RUST_LOG").stdout(Stdio::piped()).stderr(Stdio::null());
    command
}

pub(crate) fn coordinator(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_coordinator"))
        .args(arguments)
        .env_remove("COORDINATOR_URL")
        .env_remove("RUST_LOG")
        .output()
        .expect("runs")
}

pub(crate) fn succeed(output: Output) -> String {
    assert!(output.status.success(), "{}", text(&output.stderr));
    text(&output.stdout).to_owned()
}

pub(crate) fn succeed_in_json(output: Output) -> Value {
    serde_json::from_str(&succeed(output)).expect("JSON")
}

pub(crate) fn fail(output: Output, code: i32) -> String {
    let error = text(&output.stderr);
    assert_eq!(output.status.code(), Some(code), "{error}");
    error.to_owned()
}

pub(crate) fn fits_a_terminal(text: &str) {
    for line in text.lines() {
        assert!(line.chars().count() <= 80, "{line}");
    }
}

#[rustfmt::skip]
pub(crate) fn plus_spec(variants: &str) -> Value {
    succeed_in_json(coordinator(&[
        "campaign", "create", "--name", "plus", "--policy", "expert", "--endpoint",
        "http://127.0.0.1:50051", "--suite", "libero-plus", "--variant", variants, "--print-spec",
    ]))
}

pub(crate) fn text(bytes: &[u8]) -> &str {
    std::str::from_utf8(bytes).expect("UTF-8")
}

/// Command that creates the campaign `demo`, which has 14 rollouts.
#[rustfmt::skip]
pub(crate) const CREATE: [&str; 14] = [
    "campaign", "create", "--name", "demo", "--policy", "expert",
    "--endpoint", "http://127.0.0.1:50051", "--tasks", "libero_object/0-1",
    "--configs", "0", "--levels", "L1",
];
/// Position of the campaign's name in [`CREATE`].
pub(crate) const NAME: usize = 3;

#[tokio::test(flavor = "multi_thread")]
async fn a_killed_coordinator_continues_after_a_restart() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let first = Serve::start(folder.path());
    first.run(&CREATE, 0, &[]);
    let mut worker = first.worker("a").await;
    let committed = worker.claim(3).await;
    worker.commit_all(&committed, true).await;
    let held = worker.claim_one().await;
    first.signal("-KILL");
    drop(first);

    let second = Serve::start(folder.path());
    // The worker process survived the restart and still holds its lease.
    let mut worker = second.worker("a").await;
    assert!(worker.heartbeat(&[&held], 50).await.is_empty());
    assert_eq!(worker.commit(&held, true).await, Verdict::Accepted);
    // Results accepted before the kill are in the database.
    assert_eq!(worker.commit(&committed[0], true).await, Verdict::Duplicate);
    while let [lease] = worker.claim(1).await.as_slice() {
        assert_eq!(worker.commit(lease, true).await, Verdict::Accepted);
    }
    let status = &succeed(second.command(&["campaign", "status", "demo", "--watch"]));
    assert!(status.contains("14/14 100%  finished"), "{status}");
    fits_a_terminal(status);
}

/// Regression: sweeps a second apart were taken for a suspension, so that leases of two seconds or
/// less never expired.
#[tokio::test(flavor = "multi_thread")]
async fn leases_of_one_and_two_seconds_expire() {
    for secs in ["1", "2"] {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let serve = Serve::start_with(folder.path(), &["--lease-secs", secs], Stdio::null());
        serve.run(&CREATE, 0, &[]);
        let mut silent = serve.worker("silent").await;
        let held = silent.claim(14).await;
        assert_eq!(held.len(), 14);
        let mut other = serve.worker("other").await;
        let began = Instant::now();
        let new_lease = loop {
            if let Some(lease) = other.claim(1).await.pop() {
                break lease;
            }
            assert!(began.elapsed() < Duration::from_secs(20), "{secs} s");
            tokio::time::sleep(Duration::from_millis(50)).await;
        };
        let old_lease = held.iter().find(|lease| lease.job_id == new_lease.job_id);
        let late = silent.commit(old_lease.expect("a lost lease"), true).await;
        assert_eq!(late, Verdict::Stale);
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stopping_coordinator_answers_waiting_claims_and_leaves_one_database_file() {
    let (folder, mut serve) = Serve::anew();
    let mut worker = serve.worker("a").await;
    let mut waiting = JoinSet::new();
    waiting.spawn(async move { worker.try_claim(30.0, "").await });
    tokio::time::sleep(Duration::from_millis(300)).await;
    let signalled = Instant::now();
    serve.signal("-TERM");
    let answers = waiting.join_all().await;
    let refused = answers[0].as_ref().expect_err("nothing to lease");
    assert_eq!(refused.code(), tonic::Code::Unavailable);
    let status = serve.child.wait().expect("an exit status");
    assert!(status.success(), "{status}");
    assert!(signalled.elapsed() < Duration::from_secs(8), "{:?}", signalled.elapsed());
    assert!(!folder.path().join("coordinator.sqlite-wal").exists());
    open_database(folder.path()).await.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_specification_is_read_from_a_file_or_standard_input() {
    let (folder, serve) = Serve::anew();
    let path = folder.path().join("spec.json");
    std::fs::write(&path, small_spec("filed").to_string()).expect("written");
    let path = path.to_str().expect("UTF-8");
    let create = ["campaign", "create", "--spec", path];
    assert_eq!(succeed(serve.command(&create)), "campaign filed created: 4 rollouts\n");
    serve.run(&create, 0, &["exists already"]);
    let list = succeed(serve.command(&["campaign", "status"]));
    assert!(list.starts_with("filed ░"), "{list}");
    // A flag would be ignored.
    serve.run(&[&create[..], &["--levels", "L3"]].concat(), 2, &[]);
    std::fs::write(path, "{\"name\": \"x\", \"colour\": 1}").expect("written");
    serve.run(&create, 2, &["colour"]);
}

/// Regression: a policy's error text, relayed by its worker, could set the operator's clipboard.
#[tokio::test(flavor = "multi_thread")]
async fn control_sequences_from_workers_and_archives_never_reach_the_terminal() {
    /// Sets the clipboard, erases the line, and contains an 8-bit control character and a
    /// right-to-left override.
    const HOSTILE: &str = "\x1b]52;c;cm0gLXJm\x07\x1b[2K\rall is well \u{9b}31m\u{202e}";
    let (folder, serve) = Serve::anew();
    serve.create(&small_spec("hostile"));
    let mut worker = serve.worker("w").await;
    let lease = worker.claim_one().await;
    let request = wire::ReleaseRequest {
        attempt_id: lease.attempt_id.clone(),
        reason: wire::release_request::Reason::PolicyUnavailable.into(),
        error: HOSTILE.to_owned(),
        answered_queries: None,
    };
    worker.service.release(request).await.expect("released");
    let has_control_sequence = |text: &str| {
        let is_control = |c: char| (c.is_control() && c != '\n') || c == '\u{202e}';
        text.contains(is_control)
    };
    // Control sequences are not stored.
    let pool = open_database(folder.path()).await;
    let stored: String =
        sqlx::query_scalar("SELECT error FROM failure").fetch_one(&pool).await.expect("a failure");
    assert!(stored.contains("all is well") && !has_control_sequence(&stored), "{stored:?}");
    // Control sequences that another program stored are not printed.
    for update in ["UPDATE failure SET error = ?", "UPDATE policy SET pause_reason = ?"] {
        let update = sqlx::query(update).bind(HOSTILE).execute(&pool).await;
        update.expect("altered");
    }
    pool.close().await;
    let rollout = crate::harness::rollout_id(&lease);
    for command in [
        &["jobs", "hostile", &rollout][..],
        &["jobs", "hostile"],
        &["campaign", "status", "hostile"],
    ] {
        let output = &succeed(serve.command(command));
        assert!(!has_control_sequence(output), "{command:?}: {output:?}");
    }
    let output = serve.command(&["jobs", "hostile", &rollout]);
    assert!(text(&output.stdout).contains("all is well"));
}

#[test]
fn a_printed_specification_creates_the_same_campaign_as_its_flags() {
    let (folder, serve) = Serve::anew();
    #[rustfmt::skip]
    let flags = [
        "--subsets", "camera+sensor", "--replicates", "2", "--record", "transitions",
        "--execution", "hold:2",
    ];
    let create = [CREATE.as_slice(), &flags].concat();
    let printed = serve.command(&[create.as_slice(), &["--print-spec"]].concat());
    assert!(printed.status.success(), "{}", text(&printed.stderr));
    let listed = serve.command(&["campaign", "status"]);
    assert!(text(&listed.stdout).contains("no campaigns yet"));
    let spec = folder.path().join("spec.json");
    std::fs::write(&spec, &printed.stdout).expect("written");
    let spec = spec.to_str().expect("UTF-8");
    succeed(serve.command(&create));
    let output_of_spec = serve.command(&["campaign", "create", "--spec", spec]);
    let output = text(&output_of_spec.stdout);
    assert!(
        output.contains("exists already, with this specification"),
        "{output}{}",
        text(&output_of_spec.stderr)
    );
    // A specification that is read from this text is printed as the same text.
    let output_of_spec = serve.command(&["campaign", "create", "--spec", spec, "--print-spec"]);
    assert_eq!(text(&output_of_spec.stdout), text(&printed.stdout));
}
