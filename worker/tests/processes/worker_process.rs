//! Starts the real program and observes it.

use std::fs;
use std::io::Read;
use std::process::{Child, Command, ExitStatus, Output, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

use benchmark::ManifestRow;
use proto::coordinator::Lease;

/// Longest wait for an expected reaction of a process.
const PATIENCE: Duration = Duration::from_secs(30);
/// Control steps of a test's rollouts.
pub(crate) const MAX_STEPS: u32 = 24;

/// Returns the id of the attempt at a job of the scripted coordinator.
pub(crate) fn attempt_id(job: i64) -> String {
    format!("{job:032x}")
}

/// Returns a job of the scripted coordinator: a short nominal rollout.
pub(crate) fn lease(job: i64, policy: &str, endpoint: &str) -> Lease {
    let id = "object/t0/nominal/i03".parse().expect("an id");
    let mut row = ManifestRow::new(id, 3, 3, benchmark::Perturbation::default());
    row.max_steps = MAX_STEPS;
    Lease {
        job_id: job,
        attempt_id: attempt_id(job),
        campaign: "test".to_owned(),
        replicate: 0,
        manifest_row: serde_json::to_string(&row).expect("JSON"),
        policy_seed: 7,
        policy: policy.to_owned(),
        policy_endpoint: endpoint.to_owned(),
        realisation: "matched".to_owned(),
        ..Lease::default()
    }
}

/// A running program, which is killed when this value is dropped.
pub(crate) struct WorkerProcess {
    child: Child,
}

impl WorkerProcess {
    pub(crate) fn start(coordinator: &str) -> Self {
        Self::start_with(coordinator, &[])
    }

    pub(crate) fn start_with(coordinator: &str, arguments: &[&str]) -> Self {
        let connect = ["--connect", coordinator, "--assets", "primitives"];
        Self::start_command(program().args(connect).args(arguments))
    }

    pub(crate) fn start_command(program: &mut Command) -> Self {
        let child = program.stderr(Stdio::piped()).stdout(Stdio::piped()).spawn().expect("starts");
        Self { child }
    }

    pub(crate) fn slots(&self) -> Vec<u32> {
        let pid = self.child.id();
        let children = fs::read_to_string(format!("/proc/{pid}/task/{pid}/children"));
        let children = children.unwrap_or_default();
        children.split_whitespace().filter_map(|pid| pid.parse().ok()).collect()
    }

    pub(crate) fn signal(&self, name: &str) {
        signal(self.child.id(), name);
    }

    pub(crate) fn terminated(self) -> String {
        self.signal("TERM");
        self.ended()
    }

    /// Waits until the process has succeeded and returns its output.
    pub(crate) fn ended(self) -> String {
        let (status, output) = self.wait();
        assert!(status.success(), "{output}");
        output
    }

    /// Waits until the process exits; also returns its output.
    pub(crate) fn wait(mut self) -> (ExitStatus, String) {
        let started = Instant::now();
        let status = loop {
            if let Some(status) = self.child.try_wait().expect("waits") {
                break status;
            }
            assert!(started.elapsed() < PATIENCE, "the worker does not end");
            sleep(Duration::from_millis(20));
        };
        let mut output = String::new();
        let (out, err) = (self.child.stdout.take(), self.child.stderr.take());
        out.expect("piped").read_to_string(&mut output).expect("UTF-8");
        err.expect("piped").read_to_string(&mut output).expect("UTF-8");
        (status, output)
    }
}

impl Drop for WorkerProcess {
    fn drop(&mut self) {
        // The process may have exited already.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Sends a signal to a process: `KILL`, `STOP`, `TERM`.
pub(crate) fn signal(pid: u32, name: &str) {
    let status = Command::new("kill").args([&format!("-{name}"), &pid.to_string()]).status();
    assert!(status.expect("kill runs").success(), "no process {pid}");
}

/// Waits until a process has exited.
pub(crate) fn wait_for_the_end_of(pid: u32) {
    let started = Instant::now();
    // A process that exited and was not reaped is a zombie, whose `exe` is empty.
    while fs::read_link(format!("/proc/{pid}/exe")).is_ok() {
        assert!(started.elapsed() < PATIENCE, "process {pid} is still running");
        sleep(Duration::from_millis(20));
    }
}

/// Returns a command of the program, with an environment that names no coordinator.
pub(crate) fn program() -> Command {
    let mut program = Command::new(env!("CARGO_BIN_EXE_worker"));
    program.env_remove("COORDINATOR_URL");
    program
}

/// Runs the program until it exits.
pub(crate) fn run(arguments: &[&str]) -> Output {
    program().args(arguments).output().expect("runs")
}
