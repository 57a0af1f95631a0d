//! Runs the scripts of `coordinator slurm` on a real cluster of two nodes, where jobs are
//! preempted, requeued and ended at their time limit.

use std::path::PathBuf;
use std::process::Command;
use std::thread::sleep;
use std::time::Duration;

use serde_json::Value;
use tests::programs::{Campaigns, Process, program};
use tests::slurm::{Cluster, NODES, free_ports, host_name, succeeded};

const NAME: &str = "a_campaign_on_a_real_cluster_loses_no_result_and_charges_no_attempt";
const CAMPAIGN: &str = "cluster";
/// Reasons for which attempts may end without an outcome here; none of them is charged.
const UNCHARGED: [&str; 4] =
    ["draining", "policy_unavailable", "policy_lost", "never_acknowledged"];

#[test]
fn a_campaign_on_a_real_cluster_loses_no_result_and_charges_no_attempt() {
    let cluster = match Cluster::start() {
        Ok(cluster) => cluster,
        Err(reason) => return println!("skipped {NAME}: {reason}"),
    };
    let campaign = ClusterCampaign::open(cluster);

    // The array spans two nodes, and the gateway is on the one with the GPU.
    let gateway = campaign.job_named("rollout-gateway");
    let array = campaign.job_named("rollout-workers");
    let tasks = [1, 2].map(|task| format!("{array}_{task}"));
    campaign.wait_until("both workers run", |campaign| campaign.live_workers() == 2);
    let node = |job: &str| campaign.cluster.job(job).node;
    assert_eq!(node(&gateway), NODES[0]);
    let [on_first, on_second] = match node(&tasks[0]) == NODES[0] {
        true => tasks,
        false => {
            let [one, two] = tasks;
            [two, one]
        }
    };
    assert_eq!([node(&on_first), node(&on_second)], NODES);
    campaign.wait_until("some rollouts are committed", |campaign| campaign.count("committed") >= 4);

    // A worker that is asked to stop while it waits for its next rollout returns no attempt.
    while campaign.returned_attempts() == 0 {
        assert!(!campaign.is_finished(), "no worker was asked to stop during a rollout");
        campaign.wait_until("both workers have rollouts", |campaign| {
            campaign.count("leased") == 2 || campaign.is_finished()
        });
        campaign.preempt(&on_second);
    }
    campaign.lose_node(&on_second);
    for job in [&on_first, &gateway] {
        campaign.wait_until("a job that reached its time limit runs again", |campaign| {
            campaign.is_back(job, 1)
        });
    }
    // Each restart started a new worker.
    for (task, times) in [(&on_first, 2), (&on_second, 3)] {
        let index = task.rsplit('_').next().unwrap_or_default();
        let log = campaign.scripts.join(format!("worker-{array}-{index}.log"));
        // A job runs a moment before its worker has registered.
        campaign.wait_until("a worker of the job has registered again", |_| {
            let log = std::fs::read_to_string(&log).expect("a log");
            log.matches("registered with the coordinator").count() >= times
        });
    }

    campaign.wait_until("the campaign is finished", ClusterCampaign::is_finished);
    campaign.assert_no_charges();
    // The rollouts of the gate's campaign are its own, so that nothing need be run.
    assert_eq!(campaign.state_after_a_gate("100"), "COMPLETED", "not worse");
    assert_eq!(campaign.state_after_a_gate("2"), "CANCELLED", "undecided");
    let report = campaign.report();
    let endpoint = campaign.endpoint.clone();
    campaign.close();
    assert_eq!(report, report_of_one_machine(&endpoint));
}

/// Returns the command that creates the campaign, on the cluster or on one machine.
fn create(endpoint: &str) -> Vec<&str> {
    #[rustfmt::skip]
    let create = vec![
        "campaign", "create", "--name", CAMPAIGN, "--policy", "expert", "--endpoint", endpoint,
        "--tasks", "libero_object/0-1", "--axes", "metric", "--levels", "L2",
        "--configs", "0-5", "--nominal", "eval",
    ];
    create
}

fn report_of_one_machine(endpoint: &str) -> String {
    let data = tempfile::tempdir().expect("a folder");
    let campaigns = Campaigns::start(data.path());
    campaigns.succeed(&create(endpoint));
    let mut worker = Command::new(program("worker"));
    worker.args(["--connect", &campaigns.coordinator.url, "--slots", "2"]);
    worker.args(["--assets", "primitives", "--policy-endpoint"]);
    let _worker = Process::start(worker.arg(&campaigns.gateway.url));
    campaigns.wait_for_commits(CAMPAIGN, None);
    let report = campaigns.succeed(&["report", CAMPAIGN, "--full"]);
    report + &campaigns.succeed(&["report", CAMPAIGN, "--json"])
}

struct ClusterCampaign {
    // Dropped first, since its jobs call the coordinator.
    cluster: Cluster,
    coordinator: Process,
    scripts: PathBuf,
    url: String,
    endpoint: String,
}

impl ClusterCampaign {
    /// Performs a user's steps: writes the scripts, starts the coordinator, submits the jobs, and
    /// creates a campaign.
    fn open(cluster: Cluster) -> Self {
        let scripts = cluster.path("a lab's \"scripts\"");
        let [port, gateway] = free_ports().map(|port| port.to_string());
        let url = format!("http://{}:{port}", host_name());
        let launch = |more: &[&str]| {
            let mut launch = cluster.command("coordinator");
            launch.args(["slurm", "--connect", &url, "--insecure"]);
            launch.arg("--into").arg(&scripts);
            launch.arg("--data").arg(cluster.path("campaigns"));
            #[rustfmt::skip]
            // With `--time 1`, Slurm ends jobs after 30 seconds, and starts them again 30 seconds
            // later: the gateway might only run while the workers do not.
            launch.args([
                "--assets", "primitives", "--partition", "low", "--time", "2", "--ahead-secs", "10",
                "--workers", "2", "--slots", "1", "--drain-secs", "0",
                "--policy", "expert=builtin:expert", "--gpus", "1", "--gateway-port", &gateway,
            ]);
            succeeded(launch.args(more).output().expect("the command runs"))
        };
        launch(&[]);
        let coordinator = Process::serve(Command::new("bash").arg(scripts.join("coordinator.sh")));
        launch(&["--submit"]);
        let url_file = scripts.join("gateway.url");
        cluster.wait_for("the gateway writes its URL", |_| url_file.exists());
        let endpoint = std::fs::read_to_string(url_file).expect("a line");
        let campaign =
            Self { cluster, coordinator, scripts, url, endpoint: endpoint.trim().to_owned() };
        campaign.command_output(&create(&campaign.endpoint));
        campaign
    }

    /// Lets a job of a partition with higher priority take a worker's node.
    fn preempt(&self, task: &str) {
        let restarts = self.cluster.job(task).restarts;
        let preemptions = || {
            let log = std::fs::read_to_string(self.cluster.path("slurmctld.log"));
            let message = format!("preempted JobId={task}(");
            log.unwrap_or_default().matches(&message).count()
        };
        let before = preemptions();
        // A task that reaches its time limit first is not preempted; the loop then tries again.
        while preemptions() == before {
            self.wait_until("the worker runs", |campaign| campaign.is_back(task, 0));
            let node = format!("--nodelist={}", self.cluster.job(task).node);
            let options = ["--partition=high", &node, "--exclusive"];
            let urgent = self.cluster.submit(&options, "sleep 3");
            self.wait_until("the urgent job has run", |campaign| {
                campaign.cluster.job(&urgent).state == "COMPLETED"
            });
        }
        self.wait_until("the preempted worker is back", |campaign| {
            campaign.is_back(task, restarts + 1)
        });
    }

    fn lose_node(&self, task: &str) {
        let before = self.cluster.job(task);
        let name = format!("NodeName={}", before.node);
        let scontrol = |arguments: &[&str]| self.cluster.command_output("scontrol", arguments);
        scontrol(&["update", &name, "State=DRAIN", "Reason=a test"]);
        scontrol(&["requeue", task]);
        self.wait_until("the worker has left the drained node", |campaign| {
            campaign.cluster.job(task).restarts > before.restarts
        });
        // Longer than a requeued job waits until it may start.
        sleep(Duration::from_secs(8));
        let current = self.cluster.job(task);
        assert!(current.state != "RUNNING" || current.node != before.node, "{current:?}");
        scontrol(&["update", &name, "State=RESUME"]);
        self.wait_until("the worker is back", |campaign| {
            campaign.is_back(task, before.restarts + 1)
        });
    }

    /// Returns the last state of a job that depends on a gate with a margin.
    fn state_after_a_gate(&self, margin: &str) -> String {
        let gate = format!(
            "{} gate --connect {} --policy expert --against {CAMPAIGN} --name {CAMPAIGN} --margin \
             {margin}",
            program("coordinator").display(),
            self.url
        );
        let gate = self.cluster.submit(&["--partition=high"], &gate);
        let dependency = format!("--dependency=afterok:{gate}");
        let options = ["--partition=high", &dependency, "--kill-on-invalid-dep=yes"];
        let dependent = self.cluster.submit(&options, "true");
        let state = || self.cluster.job(&dependent).state;
        self.wait_until("the dependent job has ended", |_| {
            !["PENDING", "RUNNING", "COMPLETING"].contains(&state().as_str())
        });
        state()
    }

    /// Returns true if a job is running and was requeued at least `restarts` times.
    fn is_back(&self, job: &str, restarts: u32) -> bool {
        let job = self.cluster.job(job);
        job.state == "RUNNING" && job.restarts >= restarts
    }

    /// Asserts that no attempt was charged, and that all attempts without an outcome ended for a
    /// reason in [`UNCHARGED`].
    fn assert_no_charges(&self) {
        let jobs = self.json(&["jobs", CAMPAIGN, "--limit", "10000"]);
        let jobs = jobs["jobs"].as_array().expect("a list");
        for job in jobs {
            assert_eq!(job["state"], "committed", "{job}");
            assert_eq!(job["charged_attempts"], 0, "{job}");
        }
        let endings = self.endings();
        let is_uncharged = |reason: &String| UNCHARGED.contains(&reason.as_str());
        assert!(endings.iter().all(is_uncharged), "{endings:?}");
    }

    /// Returns the number of attempts that workers returned while draining.
    fn returned_attempts(&self) -> usize {
        let endings = self.endings().into_iter();
        endings.filter(|reason| reason == "draining").count()
    }

    /// Returns the reasons for which attempts ended without an outcome.
    fn endings(&self) -> Vec<String> {
        let jobs = self.json(&["jobs", CAMPAIGN, "--limit", "10000"]);
        let jobs = jobs["jobs"].as_array().expect("a list");
        let mut endings = Vec::new();
        for job in jobs {
            if job["state"] == "committed" && job["attempts"] == 1 || job["attempts"] == 0 {
                continue;
            }
            let id = job["rollout_id"].as_str().expect("an id");
            let shown = self.json(&["jobs", CAMPAIGN, id]);
            let failures = shown["failures"].as_array().expect("a list");
            let reasons = failures.iter().map(|failure| failure["reason"].as_str());
            endings.extend(reasons.map(|reason| reason.unwrap_or_default().to_owned()));
        }
        endings
    }

    fn report(&self) -> String {
        self.command_output(&["report", CAMPAIGN, "--full"])
            + &self.command_output(&["report", CAMPAIGN, "--json"])
    }

    fn close(mut self) {
        let data = self.cluster.path("campaigns");
        self.coordinator.signal("-TERM");
        self.coordinator.wait();
        let mut check = Command::new(program("coordinator"));
        succeeded(check.arg("check").arg(data).output().expect("the command runs"));
    }

    fn job_named(&self, name: &str) -> String {
        let name = format!("--name={name}");
        let jobs = self.cluster.command_output("squeue", &["--noheader", "--format=%F", &name]);
        jobs.lines().next().expect("a job").trim().to_owned()
    }

    fn live_workers(&self) -> usize {
        self.json(&["workers"])["workers"].as_array().map_or(0, Vec::len)
    }

    fn is_finished(&self) -> bool {
        let status = self.command_output(&["campaign", "status", CAMPAIGN]);
        status.contains("finished")
    }

    fn count(&self, state: &str) -> u64 {
        let status = self.json(&["campaign", "status", CAMPAIGN]);
        let count = &status["campaigns"][0]["rollouts"][state];
        count.as_u64().expect("a number")
    }

    fn json(&self, arguments: &[&str]) -> Value {
        let report = self.command_output(&[arguments, &["--json"]].concat());
        serde_json::from_str(&report).expect("JSON")
    }

    fn command_output(&self, arguments: &[&str]) -> String {
        let mut command = Command::new(program("coordinator"));
        command.args(arguments).args(["--connect", &self.url]);
        succeeded(command.output().expect("the command runs"))
    }

    fn wait_until(&self, goal: &str, condition: impl Fn(&Self) -> bool) {
        self.cluster.wait_for(goal, |_| condition(self));
    }
}
