//! A whole system as processes: a policy behind a gateway, a coordinator, the workers
//! of a [`Plan`], and a breakable connection ([`Wire`]) for each link. Every process may
//! be killed and is restarted.

use std::fs::{File, OpenOptions};
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

use super::schedule::{Fault, Link, Schedule};
use super::system::{
    NOBODY, children, faketime, kill_all, limit_files, pause, set_modes, without_write_access,
};
use super::wire::Wire;
use crate::programs::{Process, program};

/// Duration of a lease without a heartbeat.
pub const LEASE: Duration = Duration::from_secs(3);
/// Timeout of a campaign after the last fault. After an outage or a charged attempt, the next try
/// waits for some seconds, and twice as long each time.
const PATIENCE: Duration = Duration::from_secs(120);
/// Number of lines of the log shown with a failure.
const LAST_LINES: usize = 60;
const CAMPAIGN: &str = "chaos";
/// Endpoint of the policy in the campaign, constant because reports contain it. Workers are
/// given the address of the wire to the gateway instead.
const ENDPOINT: &str = "http://gateway.invalid:7412";

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SlotKind {
    /// `simulated_slot`: fast, with meaningless results.
    Simulated,
    /// MuJoCo with the built-in assets.
    Real,
}

/// Programs of a system and the campaign that it runs.
#[derive(Clone, Debug)]
pub struct Plan {
    pub slots: SlotKind,
    pub workers: usize,
    pub slots_each: u32,
    /// The campaign's design: flags of `campaign create`.
    pub design: Vec<String>,
    /// Timeout of the campaign after the last fault.
    pub patience: Duration,
}

struct Worker {
    process: Process,
    machine: usize,
}

pub struct Fleet {
    folder: tempfile::TempDir,
    plan: Plan,
    to_coordinator: Wire,
    to_gateway: Wire,
    to_policy: Wire,
    coordinator: Option<Process>,
    gateway: Option<Process>,
    policy: Option<Process>,
    workers: Vec<Worker>,
    /// Process id of the last worker whose slots were all killed at once.
    slot_victim: Option<u32>,
    /// Library that fakes the coordinator's wall clock, and the clock's offset.
    clock: Option<(PathBuf, &'static str)>,
}

impl Plan {
    /// Returns a plan of two workers with a slot each, and a small campaign.
    pub fn small(slots: SlotKind) -> Self {
        let (tasks, configs) = match slots {
            SlotKind::Simulated => ("libero_object/0,libero_spatial/0", "0-1"),
            SlotKind::Real => ("libero_object/0", "0"),
        };
        #[rustfmt::skip]
        let design = [
            "--tasks", tasks, "--axes", "metric", "--levels", "L3", "--configs", configs,
            "--nominal", "eval",
        ];
        Self {
            slots,
            workers: 2,
            slots_each: 1,
            design: design.map(str::to_owned).into(),
            patience: PATIENCE,
        }
    }
}

impl Fleet {
    /// Starts all processes and creates a small campaign.
    pub fn start(slots: SlotKind) -> Self {
        Self::start_with(Plan::small(slots))
    }

    /// Starts all processes and creates the plan's campaign.
    pub fn start_with(plan: Plan) -> Self {
        let folder = tempfile::tempdir().expect("a temporary folder");
        // The coordinator on the read-only database may run as another user, who must be able to
        // read the folder.
        let mode = std::fs::Permissions::from_mode(0o755);
        std::fs::set_permissions(folder.path(), mode).expect("a writable folder");
        let mut fleet = Self {
            folder,
            plan,
            to_coordinator: Wire::new(),
            to_gateway: Wire::new(),
            to_policy: Wire::new(),
            coordinator: None,
            gateway: None,
            policy: None,
            workers: Vec::new(),
            slot_victim: None,
            clock: None,
        };
        fleet.start_policy();
        fleet.start_gateway();
        fleet.start_coordinator();
        #[rustfmt::skip]
        let campaign = [
            "campaign", "create", "--name", CAMPAIGN, "--policy", "chaos", "--endpoint", ENDPOINT,
        ];
        let design = fleet.plan.design.iter().map(String::as_str);
        fleet.command_output(&campaign.into_iter().chain(design).collect::<Vec<_>>());
        for machine in 0..fleet.plan.workers {
            fleet.start_worker(machine);
        }
        fleet
    }

    /// Injects all faults of a schedule and recovers from each.
    pub fn inject_all(&mut self, schedule: &Schedule) {
        let start = Instant::now();
        for (at, fault) in &schedule.faults {
            sleep(at.saturating_sub(start.elapsed()));
            self.inject(*fault);
        }
    }

    /// Waits until the campaign is finished, and returns its complete output: the report, as
    /// table and as JSON, and the results without their wall times.
    pub fn outcome(&mut self) -> String {
        let start = Instant::now();
        while !self.is_finished() {
            let status = self.command_output(&["campaign", "status", CAMPAIGN]);
            let waited = start.elapsed();
            assert!(waited < self.plan.patience, "campaign unfinished: {status}");
            sleep(Duration::from_millis(300));
        }
        let report = self.command_output(&["report", CAMPAIGN, "--full"]);
        let json = self.command_output(&["report", CAMPAIGN, "--json"]);
        let export = self.command_output(&["export", CAMPAIGN, "--format", "jsonl"]);
        let mut rows: Vec<String> = export.lines().map(without_wall_time).collect();
        rows.sort();
        self.stop();
        self.check_invariants();
        format!("{report}\n{json}\n{}", rows.join("\n"))
    }

    /// Returns true if the campaign is finished, so that no rollout runs unless an operator
    /// intervenes.
    pub fn is_finished(&self) -> bool {
        self.status()["is_finished"] == true
    }

    /// Returns the campaign's status from `campaign status --json`.
    pub fn status(&self) -> serde_json::Value {
        let status = self.command_output(&["campaign", "status", CAMPAIGN, "--json"]);
        let status: serde_json::Value = serde_json::from_str(&status).expect("JSON");
        status["campaigns"][0].clone()
    }

    /// Waits until at least `count` rollouts are committed.
    pub fn wait_for_commits(&self, count: usize) {
        let start = Instant::now();
        let results = ["export", CAMPAIGN, "--format", "jsonl"];
        while self.command_output(&results).lines().count() < count {
            assert!(start.elapsed() < PATIENCE, "too few rollouts are committed");
            sleep(Duration::from_millis(50));
        }
    }

    /// Suspends the parent processes of all workers for a time; their slots continue.
    pub fn stop_all_workers(&self, time: Duration) {
        for worker in &self.workers {
            worker.process.signal("-STOP");
        }
        sleep(time);
        for worker in &self.workers {
            worker.process.signal("-CONT");
        }
    }

    pub fn log_tail(&self) -> String {
        let log = std::fs::read_to_string(self.folder.path().join("log")).unwrap_or_default();
        let lines: Vec<&str> = log.lines().collect();
        lines[lines.len().saturating_sub(LAST_LINES)..].join("\n")
    }

    pub fn data(&self) -> PathBuf {
        self.folder.path().join("data")
    }

    /// Runs a command against the coordinator, bypassing the wires, and returns its output.
    pub fn command_output(&self, arguments: &[&str]) -> String {
        let coordinator = self.coordinator.as_ref().expect("a coordinator");
        let output = Command::new(program("coordinator"))
            .args(arguments)
            .args(["--connect", &coordinator.url])
            .output()
            .expect("the command runs");
        let errors = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "{arguments:?}: {errors}");
        String::from_utf8(output.stdout).expect("UTF-8")
    }

    /// Injects one fault and recovers from it.
    pub fn inject(&mut self, fault: Fault) {
        match fault {
            Fault::KillCoordinator(down) => {
                self.kill_coordinator();
                sleep(down);
                self.start_coordinator();
            }
            Fault::KillWorker => {
                let victim = self.workers.remove(0);
                victim.process.signal("-KILL");
                self.start_worker(victim.machine);
            }
            Fault::RestartMachine(down) => {
                let victim = self.workers.remove(0);
                let slots = children(victim.process.id());
                victim.process.signal("-KILL");
                kill_all(&slots);
                sleep(down);
                self.start_worker(victim.machine);
            }
            Fault::DrainWorker => {
                let Worker { process: mut victim, machine } = self.workers.remove(0);
                victim.signal("-TERM");
                self.start_worker(machine);
                match self.slot_victim == Some(victim.id()) {
                    // All its slots failed at once, so that it may have exited with an error.
                    true => drop(victim.end()),
                    false => victim.wait(),
                }
            }
            Fault::KillSlot => {
                let slot_victim = self.workers[0].process.id();
                self.slot_victim = Some(slot_victim);
                kill_all(&children(slot_victim));
            }
            Fault::KillGateway(down) => {
                self.to_gateway.set_target(None);
                self.gateway = None;
                sleep(down);
                self.start_gateway();
            }
            Fault::KillPolicy(down) => {
                self.to_policy.set_target(None);
                self.policy = None;
                sleep(down);
                self.start_policy();
            }
            Fault::StopWorker(time) => pause(&self.workers[0].process, time),
            Fault::StopCoordinator(time) => {
                pause(self.coordinator.as_ref().expect("a coordinator"), time);
            }
            Fault::Cut(link) => self.wire(link).cut(),
            Fault::Block(link, time) => {
                self.wire(link).block(true);
                sleep(time);
                self.wire(link).block(false);
            }
            Fault::Delay(link, by) => {
                self.wire(link).delay(by);
                sleep(Duration::from_secs(1));
                self.wire(link).delay(Duration::ZERO);
            }
            Fault::Duplicate(time) => {
                self.to_coordinator.duplicate(true);
                sleep(time);
                self.to_coordinator.duplicate(false);
            }
            Fault::LoseAnswers(time) => {
                self.to_coordinator.lose_answers(true);
                sleep(time);
                self.to_coordinator.lose_answers(false);
            }
            Fault::FullDisk(time) => {
                let coordinator = self.coordinator.as_ref().expect("a coordinator");
                limit_files(coordinator, "0:unlimited");
                sleep(time);
                limit_files(coordinator, "unlimited:unlimited");
            }
            Fault::ReadOnlyDatabase => {
                self.kill_coordinator();
                self.check_read_only_start();
                self.start_coordinator();
            }
        }
    }

    /// Shuts the coordinator down gracefully and starts it again.
    pub fn restart_coordinator(&mut self) {
        self.end_coordinator();
        self.start_coordinator();
    }

    /// Retries every quarantined rollout.
    pub fn retry_quarantined(&self) {
        self.command_output(&["jobs", CAMPAIGN, "--retry"]);
    }

    /// Backs up the database while the coordinator runs and returns the copy's path.
    pub fn back_up(&self) -> PathBuf {
        let copy = self.folder.path().join("backup.sqlite");
        self.command_output(&["backup", "--output", &copy.to_string_lossy()]);
        copy
    }

    /// Deletes the data folder and restarts the coordinator from a copy of the database.
    pub fn restore(&mut self, copy: &Path) {
        self.kill_coordinator();
        std::fs::remove_dir_all(self.data()).expect("a writable folder");
        std::fs::create_dir(self.data()).expect("a writable folder");
        std::fs::copy(copy, self.data().join("coordinator.sqlite")).expect("a writable file");
        self.start_coordinator();
    }

    /// Restarts the coordinator with its wall clock shifted by `by` in libfaketime's format,
    /// such as `+1d`. Returns false if libfaketime is not installed.
    pub fn jump_clock(&mut self, by: &'static str) -> bool {
        let Some(library) = faketime() else {
            return false;
        };
        self.end_coordinator();
        self.clock = Some((library, by));
        self.start_coordinator();
        true
    }

    fn wire(&self, link: Link) -> &Wire {
        match link {
            Link::ToCoordinator => &self.to_coordinator,
            Link::ToGateway => &self.to_gateway,
            Link::ToPolicy => &self.to_policy,
        }
    }

    fn start_coordinator(&mut self) {
        let mut command = self.coordinator_command();
        let coordinator = Process::serve(&mut command);
        self.to_coordinator.set_target(Some(&coordinator.url));
        self.coordinator = Some(coordinator);
    }

    /// Returns a command that starts the coordinator through a shell that ignores SIGXFSZ, so
    /// that a write beyond the file size limit fails, as on a full disk, and does not kill the
    /// coordinator.
    fn coordinator_command(&self) -> Command {
        let mut command = Command::new("sh");
        command.args(["-c", "trap '' XFSZ; exec \"$0\" \"$@\""]);
        if let Some((library, by)) = &self.clock {
            command.env("LD_PRELOAD", library).env("FAKETIME", by);
            command.env("DONT_FAKE_MONOTONIC", "1");
        }
        command
            .arg(program("coordinator"))
            .args(["serve", "--listen", "127.0.0.1:0", "--lease-secs"])
            .arg(LEASE.as_secs().to_string())
            .arg("--data")
            .arg(self.data())
            .stderr(self.log());
        command
    }

    fn kill_coordinator(&mut self) {
        self.to_coordinator.set_target(None);
        // Dropping a process kills it and waits for its exit.
        self.coordinator = None;
    }

    fn start_gateway(&mut self) {
        let policy = self.to_policy.url().replacen("http://", "grpc://", 1);
        let gateway = self.serve_policies(&format!("chaos={policy}/noop"));
        self.to_gateway.set_target(Some(&gateway.url));
        self.gateway = Some(gateway);
    }

    fn start_policy(&mut self) {
        let policy = self.serve_policies("noop=builtin:noop");
        self.to_policy.set_target(Some(&policy.url));
        self.policy = Some(policy);
    }

    fn serve_policies(&self, route: &str) -> Process {
        let mut command = Command::new(program("policy-gateway"));
        command.args(["--listen", "127.0.0.1:0", "--route", route]);
        Process::serve(command.stderr(self.log()))
    }

    fn start_worker(&mut self, machine: usize) {
        let mut command = Command::new(program("worker"));
        command.args(["--connect", &self.to_coordinator.url()]);
        command.args(["--policy-endpoint", &self.to_gateway.url()]);
        command.args(["--assets", "primitives", "--slots"]);
        command.arg(self.plan.slots_each.to_string());
        command.args(["--machine", &format!("machine-{machine}")]);
        if self.plan.slots == SlotKind::Simulated {
            command.arg("--slot-program").arg(program("simulated_slot"));
        }
        let process = Process::start(command.stderr(self.log()));
        self.workers.push(Worker { process, machine });
    }

    /// Kills workers, gateway and policy, and shuts the coordinator down gracefully.
    fn stop(&mut self) {
        self.workers.clear();
        self.gateway = None;
        self.policy = None;
        self.end_coordinator();
    }

    fn end_coordinator(&mut self) {
        self.to_coordinator.set_target(None);
        if let Some(mut coordinator) = self.coordinator.take() {
            coordinator.signal("-TERM");
            coordinator.wait();
        }
    }

    fn check_invariants(&self) {
        let output = Command::new(program("coordinator"))
            .arg("check")
            .arg(self.data())
            .output()
            .expect("the command runs");
        let findings = String::from_utf8_lossy(&output.stdout);
        let errors = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "{findings}{errors}");
    }

    /// Checks that a coordinator without write access to the database exits with an error.
    fn check_read_only_start(&self) {
        let Some(mut command) = without_write_access(&self.data()) else {
            return;
        };
        let output = command
            .arg(program("coordinator"))
            .args(["serve", "--listen", "127.0.0.1:0", "--data"])
            .arg(self.data())
            .output()
            .expect("the program runs");
        set_modes(&self.data(), 0o755, 0o644);
        let errors = String::from_utf8_lossy(&output.stderr);
        if output.status.code() == Some(127) || output.status.code() == Some(126) {
            eprintln!(
                "SKIPPED the read-only database: user {NOBODY} may not run the program: {errors}"
            );
            return;
        }
        assert_eq!(output.status.code(), Some(1), "{errors}");
        assert!(errors.contains("failed to open"), "{errors}");
    }

    fn log(&self) -> Stdio {
        let path = self.folder.path().join("log");
        let file: File = OpenOptions::new().create(true).append(true).open(path).expect("a log");
        file.into()
    }
}

fn without_wall_time(line: &str) -> String {
    let mut row: serde_json::Value = serde_json::from_str(line).expect("JSON");
    row.as_object_mut().expect("an object").remove("wall_s");
    row.to_string()
}
