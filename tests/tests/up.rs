//! `coordinator up`: three programs in one terminal.

use std::io::{BufRead, BufReader, Read};
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};
use std::time::Duration;

use tests::programs::program;

/// A `coordinator up` process, which is sent SIGTERM when dropped.
struct Up {
    child: Child,
    lines: std::sync::mpsc::Receiver<String>,
    /// Every log line so far.
    log: Vec<String>,
    coordinator: String,
    gateway: String,
}

impl Up {
    fn start(data: &Path, arguments: &[&str]) -> Self {
        let mut child = Command::new(program("coordinator"))
            .args(["up", "--listen", "127.0.0.1:0", "--gateway-listen", "127.0.0.1:0"])
            .arg("--data")
            .arg(data)
            .args(arguments)
            .env_remove("RUST_LOG")
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .expect("a process");
        let log = BufReader::new(child.stderr.take().expect("a pipe"));
        let (sender, lines) = std::sync::mpsc::channel();
        std::thread::spawn(move || {
            for line in log.lines().map_while(Result::ok) {
                // The receiver may be gone if the test has ended.
                let _ = sender.send(line);
            }
        });
        Self { child, lines, log: Vec::new(), coordinator: String::new(), gateway: String::new() }
    }

    /// Reads the log up to a line that contains these words, and returns that line.
    fn wait_for(&mut self, words: &str) -> String {
        loop {
            let line = self.lines.recv();
            let line = line.unwrap_or_else(|_| panic!("no `{words}` in {:#?}", self.log));
            self.log.push(line.clone());
            if line.contains(words) {
                return line;
            }
        }
    }

    /// Waits until all three programs run.
    fn ready(mut self) -> Self {
        let url = |line: &str| {
            let (_, address) = line.split_once("listening on ").expect("an address");
            let address = address.split([',', ' ']).next().unwrap_or_default();
            format!("http://{address}")
        };
        self.coordinator = url(&self.wait_for("coordinator | listening on "));
        self.gateway = url(&self.wait_for("gateway     | listening on "));
        self.wait_for("worker      | worker ");
        self
    }

    fn call(&self, arguments: &[&str]) -> Output {
        let mut command = Command::new(program("coordinator"));
        command.args(arguments).args(["--connect", &self.coordinator]);
        command.output().expect("the command runs")
    }

    fn create(&self, name: &str, policy: &str) {
        #[rustfmt::skip]
        let created = self.call(&[
            "campaign", "create", "--name", name, "--policy", policy, "--endpoint", &self.gateway,
            "--tasks", "libero_object/0", "--axes", "none", "--configs", "0", "--nominal", "eval",
        ]);
        assert!(created.status.success(), "{created:?}");
        let followed = self.call(&["campaign", "status", name, "--watch"]);
        assert!(followed.status.success(), "{followed:?}");
    }

    fn signal(&self, name: &str, pid: u32) {
        let status = Command::new("kill").args([name, &pid.to_string()]).status();
        assert!(status.expect("kill runs").success());
    }

    fn children(&self) -> Vec<(String, u32)> {
        let pid = self.child.id();
        let tasks = std::fs::read_dir(format!("/proc/{pid}/task")).expect("tasks");
        let children = tasks.flat_map(|task| {
            let path = task.expect("a task").path().join("children");
            let children = std::fs::read_to_string(path).unwrap_or_default();
            let pids = children.split_whitespace().map(|id| id.parse().expect("a number"));
            pids.collect::<Vec<u32>>()
        });
        let name = |pid: u32| {
            let name = std::fs::read_to_string(format!("/proc/{pid}/comm"));
            (name.unwrap_or_default().trim().to_owned(), pid)
        };
        children.map(name).collect()
    }

    /// Waits for the process to exit; returns its exit code and everything that it printed.
    fn end(mut self) -> (Option<i32>, String) {
        let code = self.child.wait().expect("a child").code();
        let mut output = String::new();
        let out = self.child.stdout.as_mut().expect("a pipe");
        out.read_to_string(&mut output).expect("UTF-8");
        // The thread that reads the log may be behind the process, whose end closes the channel.
        while let Ok(line) = self.lines.recv_timeout(Duration::from_secs(10)) {
            self.log.push(line);
        }
        output.push_str(&self.log.join("\n"));
        (code, output)
    }
}

impl Drop for Up {
    fn drop(&mut self) {
        // After `end`, the process has exited already.
        if matches!(self.child.try_wait(), Ok(None)) {
            self.signal("-TERM", self.child.id());
            let _ = self.child.wait();
        }
    }
}

#[test]
fn one_command_runs_coordinator_gateway_and_worker_and_ctrl_c_stops_all() {
    let data = tempfile::tempdir().unwrap();
    let up = Up::start(&data.path().join("data"), &["--slots", "1"]).ready();
    up.create("first", "expert");
    let children = up.children();
    let names: Vec<&str> = children.iter().map(|(name, _)| name.as_str()).collect();
    assert_eq!(names, ["coordinator", "policy-gateway", "worker"]);

    up.signal("-INT", up.child.id());
    let (code, output) = up.end();
    assert_eq!(code, Some(0), "{output}");
    for words in [
        "coordinator campaign create --name first --policy student",
        "Ctrl-C stops all three",
        "coordinator | stopped",
        "up          | stopped",
    ] {
        assert!(output.contains(words), "{words}: {output}");
    }
    for (name, pid) in children {
        assert!(!Path::new(&format!("/proc/{pid}")).exists(), "{name} is still running");
    }
}

#[test]
fn no_program_outlives_a_killed_coordinator_up() {
    let data = tempfile::tempdir().unwrap();
    let up = Up::start(&data.path().join("data"), &["--slots", "1"]).ready();
    let children = up.children();
    assert_eq!(children.len(), 3);
    up.signal("-KILL", up.child.id());
    let (code, output) = up.end();
    assert_eq!(code, None, "{output}");
    for (name, pid) in children {
        let start = std::time::Instant::now();
        let alive = || {
            let state = std::fs::read_to_string(format!("/proc/{pid}/stat"));
            // A zombie has exited and only waits to be reaped.
            state.is_ok_and(|state| !state.contains(") Z "))
        };
        while alive() {
            assert!(start.elapsed() < Duration::from_secs(30), "{name} is still running");
            std::thread::sleep(Duration::from_millis(20));
        }
    }
}

#[test]
fn a_program_that_is_killed_is_started_again_at_its_address() {
    let data = tempfile::tempdir().unwrap();
    let mut up = Up::start(&data.path().join("data"), &["--slots", "1"]).ready();
    for name in ["policy-gateway", "worker", "coordinator"] {
        let children = up.children();
        let killed = children.iter().find(|(program, _)| program == name).expect("a child").1;
        up.signal("-KILL", killed);
        let notice = up.wait_for(&format!("`{name}` was killed"));
        assert!(notice.contains("starting it again in 1 s"), "{notice}");
    }
    up.wait_for(&format!("coordinator | listening on {}", &up.coordinator["http://".len()..]));
    up.create("after", "expert");
    drop(up);
    // A program that cannot start is reported, and no process is left running.
    let bad = Up::start(&data.path().join("data"), &["--assets", "/nowhere"]);
    let (code, output) = bad.end();
    assert_eq!(code, Some(1), "{output}");
    assert!(output.contains("failed to keep `worker` running"), "{output}");
}

#[test]
fn a_killed_evaluation_is_continued_by_the_same_command_and_ends_with_its_report() {
    let data = tempfile::tempdir().unwrap();
    #[rustfmt::skip]
    let arguments = [
        "--slots", "1", "--assets", "primitives", "--policy", "builtin:expert", "--small",
        "--tasks", "libero_object/1",
    ];
    let folder = data.path().join("data");
    let up = Up::start(&folder, &arguments).ready();
    let committed = || {
        let exported = up.call(&["export", "expert-small", "--format", "jsonl"]);
        String::from_utf8_lossy(&exported.stdout).lines().count()
    };
    while committed() == 0 {
        std::thread::sleep(Duration::from_millis(100));
    }
    up.signal("-KILL", up.child.id());
    let (code, output) = up.end();
    assert!(code.is_none() && output.contains("campaign expert-small begins: 25 "), "{output}");

    let (code, output) = Up::start(&folder, &arguments).end();
    assert_eq!(code, Some(0), "{output}");
    for words in ["campaign expert-small continues: 25 ", "simultaneous", "up          | stopped"] {
        assert!(output.contains(words), "{words}: {output}");
    }
}
