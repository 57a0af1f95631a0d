//! A Slurm cluster of two nodes on this machine: munge, a controller and two node
//! daemons as processes of the test, in a temporary folder and on free ports.

use std::net::{TcpListener, ToSocketAddrs};
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

/// The cluster's nodes. The first one has a fake GPU.
pub const NODES: [&str; 2] = ["n1", "n2"];
/// Partitions; jobs in the second preempt jobs in the first.
pub const PARTITIONS: [&str; 2] = ["low", "high"];
const PROGRAMS: [&str; 8] =
    ["munged", "slurmctld", "slurmd", "sbatch", "scancel", "scontrol", "sinfo", "squeue"];
/// Debian's folder of daemons, which may be missing from `PATH`.
const DAEMON_FOLDER: &str = "/usr/sbin";
const PATIENCE: Duration = Duration::from_secs(300);
const JOB_END_TIMEOUT: Duration = Duration::from_secs(40);

/// A running cluster; its jobs and daemons are ended when it is dropped.
pub struct Cluster {
    folder: tempfile::TempDir,
    daemons: Vec<Child>,
}

/// State of a job or of a task of an array, as reported by Slurm.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Job {
    /// `RUNNING`, `PENDING`, …
    pub state: String,
    pub node: String,
    /// Number of times that the job was requeued.
    pub restarts: u32,
}

impl Cluster {
    /// Starts a cluster.
    pub fn start() -> Result<Self, String> {
        for program in PROGRAMS {
            if find(program).is_none() {
                return Err(format!("no {program} (Debian: slurm-wlm and munge)"));
            }
        }
        let host = host_name();
        let is_resolvable = (host.as_str(), 0).to_socket_addrs().is_ok();
        if !is_resolvable {
            return Err(format!("this machine's name, {host}, has no address"));
        }
        let mut cluster =
            Self { folder: tempfile::tempdir().expect("a folder"), daemons: Vec::new() };
        cluster.configure(&host);
        cluster.start_daemons();
        cluster.wait_for("both nodes are idle", |cluster| {
            cluster
                .command_output(
                    "sinfo",
                    &["--noheader", "--Node", "--format=%N %T", "--partition=low"],
                )
                .lines()
                .filter(|line| line.ends_with(" idle"))
                .count()
                == NODES.len()
        });
        Ok(cluster)
    }

    fn configure(&self, host: &str) {
        // munged requires a socket that all users reach and a key that only its own user reads.
        set_mode(self.folder.path(), 0o755);
        let key: Vec<u8> = (0..=255).cycle().take(1024).collect();
        self.write("munge.key", &key);
        set_mode(&self.path("munge.key"), 0o600);
        std::fs::create_dir(self.path("state")).expect("a folder");
        self.write("gres.conf", b"NodeName=n1 Name=gpu Count=1 File=/dev/null\n");
        let user = Command::new("id").arg("-un").output().expect("id runs");
        let user = String::from_utf8_lossy(&user.stdout).trim().to_owned();
        let folder = self.folder.path().display();
        let [controller, ports @ ..] = free_ports::<3>();
        let mut text = format!(
            "ClusterName=test\n\
             SlurmctldHost={host}(127.0.0.1)\n\
             SlurmctldPort={controller}\n\
             SlurmUser={user}\n\
             SlurmdUser={user}\n\
             AuthType=auth/munge\n\
             CryptoType=crypto/munge\n\
             AuthInfo=socket={folder}/munge.socket,cred_expire=5\n\
             StateSaveLocation={folder}/state\n\
             SlurmdSpoolDir={folder}/spool-%n\n\
             SlurmctldPidFile={folder}/slurmctld.pid\n\
             SlurmdPidFile={folder}/slurmd-%n.pid\n\
             SlurmctldLogFile={folder}/slurmctld.log\n\
             SlurmdLogFile={folder}/slurmd-%n.log\n\
             ProctrackType=proctrack/linuxproc\n\
             TaskPlugin=task/none\n\
             JobAcctGatherType=jobacct_gather/none\n\
             MpiDefault=none\n\
             SelectType=select/cons_tres\n\
             SelectTypeParameters=CR_Core\n\
             GresTypes=gpu\n\
             ReturnToService=2\n\
             SlurmdParameters=config_overrides\n\
             SchedulerParameters=bf_interval=1,sched_interval=2\n\
             PreemptType=preempt/partition_prio\n\
             PreemptMode=REQUEUE\n"
        );
        for (node, port) in NODES.iter().zip(ports) {
            std::fs::create_dir(self.path(&format!("spool-{node}"))).expect("a folder");
            // The first node has room for a gateway and a worker, the second for a worker.
            let resources = if *node == NODES[0] { "CPUs=2 Gres=gpu:1" } else { "CPUs=1" };
            text += &format!(
                "NodeName={node} NodeHostname={host} NodeAddr=127.0.0.1 Port={port} \
                 RealMemory=8000 {resources}\n"
            );
        }
        let nodes = NODES.join(",");
        for (partition, priority) in PARTITIONS.iter().zip([1, 10]) {
            text += &format!("PartitionName={partition} Nodes={nodes} PriorityTier={priority}\n");
        }
        self.write("slurm.conf", text.as_bytes());
    }

    fn start_daemons(&mut self) {
        let file = |name: &str| self.path(name).display().to_string();
        let munge = [
            format!("--socket={}", file("munge.socket")),
            format!("--key-file={}", file("munge.key")),
            format!("--pid-file={}", file("munged.pid")),
            format!("--seed-file={}", file("munged.seed")),
            format!("--log-file={}", file("munged.log")),
            "--foreground".to_owned(),
        ];
        let munge: Vec<&str> = munge.iter().map(String::as_str).collect();
        self.start_daemon("munged", &munge);
        let socket = self.path("munge.socket");
        self.wait_for("munged listens", |_| socket.exists());
        self.start_daemon("slurmctld", &["-D"]);
        for node in NODES {
            self.start_daemon("slurmd", &["-D", "-N", node]);
        }
    }

    fn start_daemon(&mut self, name: &str, arguments: &[&str]) {
        let mut daemon = self.command(name);
        daemon.args(arguments).stdin(Stdio::null());
        daemon.stdout(Stdio::null()).stderr(Stdio::null());
        let daemon = daemon.spawn().unwrap_or_else(|error| panic!("{name}: {error}"));
        self.daemons.push(daemon);
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn write(&self, name: &str, bytes: &[u8]) {
        std::fs::write(self.path(name), bytes).expect("a file");
    }

    /// Returns a command of Slurm or one of our programs, configured for this cluster.
    pub fn command(&self, program: &str) -> Command {
        let path = match PROGRAMS.contains(&program) {
            true => find(program).unwrap_or_else(|| program.into()),
            false => crate::programs::program(program),
        };
        let mut command = Command::new(path);
        command.env("SLURM_CONF", self.path("slurm.conf"));
        command
    }

    /// Runs a command and returns its output.
    pub fn command_output(&self, program: &str, arguments: &[&str]) -> String {
        succeeded(self.command(program).args(arguments).output().expect(program))
    }

    /// Submits a shell command with options of sbatch and returns the job's id.
    pub fn submit(&self, options: &[&str], command: &str) -> String {
        let log = format!("--output={}", self.path("jobs.log").display());
        let wrapped = format!("--wrap={command}");
        let more = ["--parsable", "--open-mode=append", &log, &wrapped];
        self.command_output("sbatch", &[options, &more].concat()).trim().to_owned()
    }

    /// Returns the state of a job, given by its id: `12` or `12_1`.
    pub fn job(&self, id: &str) -> Job {
        let output = self.command("scontrol").args(["show", "job", "-o", id]).output();
        let output = output.expect("scontrol runs");
        let text = String::from_utf8_lossy(&output.stdout).into_owned();
        let line = text.lines().next().unwrap_or_default();
        let field = |name: &str| {
            let mut words = line.split_whitespace();
            let value = words.find_map(|word| word.strip_prefix(name));
            value.unwrap_or_default().to_owned()
        };
        Job {
            state: field("JobState="),
            node: field("NodeList=").replace("(null)", ""),
            restarts: field("Restarts=").parse().unwrap_or_default(),
        }
    }

    /// Waits until a condition holds.
    pub fn wait_for(&self, goal: &str, condition: impl Fn(&Self) -> bool) {
        let start = Instant::now();
        while !condition(self) {
            assert!(
                start.elapsed() < PATIENCE,
                "timed out before: {goal}\n{}",
                self.queue_and_log()
            );
            sleep(Duration::from_millis(250));
        }
    }

    pub fn queue_and_log(&self) -> String {
        let queue = self.command("squeue").args(["--all", "--array"]).output();
        let queue = queue.map(|output| String::from_utf8_lossy(&output.stdout).into_owned());
        let log = std::fs::read_to_string(self.path("slurmctld.log")).unwrap_or_default();
        let lines: Vec<&str> = log.lines().collect();
        let end = lines[lines.len().saturating_sub(40)..].join("\n");
        format!("{}\n{end}", queue.unwrap_or_default())
    }

    /// Cancels all jobs; returns true if none is left.
    fn cancel_jobs(&self) -> bool {
        let succeeds_without_output = |program: &str, arguments: &[&str]| {
            let output = self.command(program).args(arguments).output();
            output.is_ok_and(|output| {
                output.status.success() && output.stdout.trim_ascii().is_empty()
            })
        };
        for state in ["PENDING", "RUNNING", "SUSPENDED"] {
            succeeds_without_output("scancel", &["--state", state, "--partition=low"]);
            succeeds_without_output("scancel", &["--state", state, "--partition=high"]);
        }
        succeeds_without_output("squeue", &["--noheader", "--all"])
    }
}

impl Drop for Cluster {
    fn drop(&mut self) {
        // Jobs outlive the daemons that started them.
        let start = Instant::now();
        while !self.cancel_jobs() && start.elapsed() < JOB_END_TIMEOUT {
            sleep(Duration::from_millis(500));
        }
        for daemon in self.daemons.iter_mut().rev() {
            let id = daemon.id().to_string();
            let _ = Command::new("kill").args(["-TERM", &id]).status();
            let start = Instant::now();
            while matches!(daemon.try_wait(), Ok(None)) && start.elapsed() < Duration::from_secs(5)
            {
                sleep(Duration::from_millis(50));
            }
            let _ = daemon.kill();
            let _ = daemon.wait();
        }
    }
}

/// Returns the standard output of a program.
pub fn succeeded(output: Output) -> String {
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{errors}");
    String::from_utf8(output.stdout).expect("UTF-8")
}

/// Returns this machine's short host name, as the launch scripts determine it.
pub fn host_name() -> String {
    let output = Command::new("hostname").arg("-s").output();
    let name = succeeded(output.expect("hostname runs"));
    name.trim().to_owned()
}

/// Returns free TCP ports.
pub fn free_ports<const N: usize>() -> [u16; N] {
    let listeners = [(); N].map(|()| TcpListener::bind("127.0.0.1:0").expect("a port"));
    listeners.map(|listener| listener.local_addr().expect("an address").port())
}

fn find(program: &str) -> Option<PathBuf> {
    let path = std::env::var_os("PATH").unwrap_or_default();
    let folders = std::env::split_paths(&path).chain([PathBuf::from(DAEMON_FOLDER)]);
    let mut paths = folders.map(|folder| folder.join(program));
    paths.find(|path| path.is_file())
}

fn set_mode(path: &Path, mode: u32) {
    let mode = std::fs::Permissions::from_mode(mode);
    std::fs::set_permissions(path, mode).expect("a writable file");
}
