//! Runs the real programs as processes, for tests of whole campaigns.

use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Output, Stdio};
use std::time::{Duration, Instant};

/// Longest wait for commits.
const PATIENCE: Duration = Duration::from_secs(300);

/// Returns the path of the program `name`: in the folder that `ROLLOUT_PROGRAMS` names, else as
/// built with this package.
pub fn program(name: &str) -> PathBuf {
    let this_program = std::env::current_exe().expect("this program's path");
    let configured = std::env::var_os("ROLLOUT_PROGRAMS").map(PathBuf::from);
    // Programs are beside this one or, for a test in `deps`, in the parent folder.
    let folders = match &configured {
        Some(folder) => vec![folder.as_path()],
        None => this_program.ancestors().skip(1).take(2).collect(),
    };
    let mut paths = folders.iter().map(|folder| folder.join(name));
    paths.find(|path| path.is_file()).unwrap_or_else(|| {
        panic!(
            "no {name} in {}; `cargo xtask test` builds the programs, or run \
             `cargo build --workspace --bins`",
            folders[0].display()
        )
    })
}

/// A program that runs alongside the test; killed when dropped.
pub struct Process {
    child: Child,
    /// URL of the address that the program listens on, `http://…`; empty for workers.
    pub url: String,
}

impl Process {
    /// Starts a server and waits for its "listening on" line.
    pub fn serve(command: &mut Command) -> Self {
        let mut child = command.stdout(Stdio::piped()).spawn().expect("the program starts");
        let stdout = child.stdout.take().expect("a pipe");
        let mut line = String::new();
        BufReader::new(stdout).read_line(&mut line).expect("a line");
        let address = line.strip_prefix("listening on ").unwrap_or_else(|| panic!("{line:?}"));
        let address = address.split([',', ' ', '\n']).next().unwrap_or_default();
        let bare = address.strip_prefix("http://").unwrap_or(address);
        Self { child, url: format!("http://{bare}") }
    }

    /// Starts a worker.
    pub fn worker(coordinator: &str, slots: u32, assets: &str) -> Self {
        let mut command = Command::new(program("worker"));
        command.args(["--connect", coordinator, "--slots", &slots.to_string()]);
        Self::start(command.args(["--assets", assets]))
    }

    /// Starts a program and discards its standard output.
    pub fn start(command: &mut Command) -> Self {
        let child = command.stdout(Stdio::null()).spawn().expect("the program starts");
        Self { child, url: String::new() }
    }

    pub fn id(&self) -> u32 {
        self.child.id()
    }

    /// Waits until the process exits.
    pub fn wait(&mut self) {
        let status = self.end();
        assert!(status.success(), "the program ended with {status}");
    }

    /// Waits until the process exits and returns its status.
    pub fn end(&mut self) -> ExitStatus {
        self.child.wait().expect("an exit status")
    }

    /// Sends a signal, for example `-KILL`.
    pub fn signal(&self, name: &str) {
        let status = Command::new("kill").args([name, &self.child.id().to_string()]).status();
        assert!(status.expect("kill runs").success());
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// A coordinator and a gateway, with an operator's commands.
pub struct Campaigns {
    pub coordinator: Process,
    /// The gateway, with routes `expert`, `noop` and `student`. The last one leads to
    /// `builtin:student-boxes` unless [`Self::with_student`] names another back-end.
    pub gateway: Process,
}

impl Campaigns {
    pub fn start(data: &Path) -> Self {
        Self::with_student(data, "builtin:student-boxes")
    }

    /// Starts both programs like [`Self::start`], with `backend` as the policy `student`.
    pub fn with_student(data: &Path, backend: &str) -> Self {
        let mut gateway = Command::new(program("policy-gateway"));
        gateway.args(["--listen", "127.0.0.1:0"]);
        for route in ["expert=builtin:expert", "noop=builtin:noop"] {
            gateway.args(["--route", route]);
        }
        gateway.args(["--route", &format!("student={backend}")]);
        Self { coordinator: serve(data, "127.0.0.1:0"), gateway: Process::serve(&mut gateway) }
    }

    /// Kills the coordinator abruptly, like a power failure.
    pub fn kill_coordinator(&mut self) {
        self.coordinator.signal("-KILL");
        // Reaps the child, which would otherwise keep its process id as a zombie.
        let _ = self.coordinator.child.wait();
    }

    pub fn restart_coordinator(&mut self, data: &Path) {
        let address = self.coordinator.url.trim_start_matches("http://").to_owned();
        self.coordinator = serve(data, &address);
    }

    pub fn simulated_worker(&self, slots: u32, environment: &[(&str, &str)]) -> Process {
        let mut command = Command::new(program("worker"));
        command.args(["--connect", &self.coordinator.url, "--assets", "primitives"]);
        command.args(["--slots", &slots.to_string()]);
        command.arg("--slot-program").arg(program("simulated_slot"));
        Process::start(command.envs(environment.iter().copied()))
    }

    pub fn call(&self, arguments: &[&str]) -> Output {
        Command::new(program("coordinator"))
            .args(arguments)
            .args(["--connect", &self.coordinator.url])
            .output()
            .expect("the coordinator's command runs")
    }

    /// Calls the coordinator like [`call`](Self::call) and returns its output.
    pub fn succeed(&self, arguments: &[&str]) -> String {
        let output = self.call(arguments);
        let errors = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "{arguments:?}: {errors}");
        String::from_utf8(output.stdout).expect("UTF-8")
    }

    /// Creates a campaign of all metric axes (all but language) at level L3 with its nominal
    /// rollouts.
    pub fn create(&self, name: &str, policy: &str, tasks: &str, configs: &str) {
        let endpoint = &self.gateway.url;
        #[rustfmt::skip]
        self.succeed(&[
            "campaign", "create", "--name", name, "--policy", policy, "--endpoint", endpoint,
            "--tasks", tasks, "--axes", "metric", "--levels", "L3", "--configs", configs,
            "--nominal", "eval",
        ]);
    }

    /// Waits until a campaign has `count` committed rollouts or is finished; `None` waits for the
    /// end.
    pub fn wait_for_commits(&self, name: &str, count: Option<usize>) {
        let start = Instant::now();
        loop {
            let lines = self.succeed(&["export", name, "--format", "jsonl"]).lines().count();
            let status = self.succeed(&["campaign", "status", name]);
            let is_finished = status.contains("finished");
            if is_finished || count.is_some_and(|count| lines >= count) {
                return;
            }
            assert!(start.elapsed() < PATIENCE, "{name} is not done: {status}");
            std::thread::sleep(Duration::from_millis(200));
        }
    }

    /// Returns a campaign's results as the rows of `coordinator export`, sorted and without wall
    /// times.
    pub fn outcomes(&self, name: &str) -> Vec<String> {
        let export = self.succeed(&["export", name, "--format", "jsonl"]);
        let mut rows: Vec<String> = export
            .lines()
            .map(|line| {
                let mut row: serde_json::Value = serde_json::from_str(line).expect("JSON");
                row.as_object_mut().expect("an object").remove("wall_s");
                row.to_string()
            })
            .collect();
        rows.sort();
        rows
    }
}

fn serve(data: &Path, address: &str) -> Process {
    let mut coordinator = Command::new(program("coordinator"));
    coordinator.args(["serve", "--listen", address, "--lease-secs", "5", "--data"]);
    Process::serve(coordinator.arg(data))
}
