//! Dress rehearsal of a week of operation in compressed time: a campaign of every rollout of the
//! protocol, with two replicates, on slots that start and stop, with a policy outage, a restart of
//! the coordinator, a full disk, clock jumps and a restored backup. All processes are real, except
//! that slots are simulated. Report and results must equal those of the same campaign without
//! faults, byte for byte. Exits with 1 if they do not.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::process::ExitCode;
use std::thread::sleep;
use std::time::{Duration, Instant};

use clap::Parser;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};
use tests::chaos::{Fault, Fleet, Link, Plan, SlotKind};

/// Interval at which the progress of the campaign is polled.
const POLL_INTERVAL: Duration = Duration::from_millis(500);
/// Range of the interval between two random faults, milliseconds; the upper end is excluded.
const INTERVAL_MILLIS: (u64, u64) = (1_000, 4_000);

/// One-time events, each with the share of committed rollouts after which it happens. A clock jump
/// has the clock's new offset from the true time.
const EVENTS: [(f64, Event); 7] = [
    (0.10, Event::PolicyOutage),
    (0.25, Event::Restart),
    (0.40, Event::FullDisk),
    (0.50, Event::ClockJump("+1d")),
    (0.60, Event::ClockJump("-1d")),
    (0.65, Event::Backup),
    (0.80, Event::Restore),
];

/// Run a campaign twice, undisturbed and disturbed, and compare.
#[derive(Parser)]
struct Arguments {
    /// Tasks of the campaign.
    #[arg(long, default_value = "all")]
    tasks: String,
    /// Number of times that every rollout runs.
    #[arg(long, default_value_t = 2)]
    replicates: u32,
    /// Workers at a time.
    #[arg(long, default_value_t = 5)]
    workers: usize,
    /// Slots of each worker.
    #[arg(long, default_value_t = 10)]
    slots: u32,
    /// Seed of the random faults.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Duration of each outage of policy and disk, seconds.
    #[arg(long, default_value_t = 15)]
    outage_secs: u64,
}

#[derive(Clone, Copy, Debug)]
enum Event {
    PolicyOutage,
    Restart,
    FullDisk,
    ClockJump(&'static str),
    Backup,
    Restore,
}

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    let plan = plan(&arguments);
    let started = Instant::now();
    let mut fleet = Fleet::start_with(plan.clone());
    let total = fleet.status()["rollouts"]["total"].clone();
    println!(
        "{total} rollouts on {} simulated slots",
        arguments.workers * arguments.slots as usize
    );
    let expected = fleet.outcome();
    drop(fleet);
    println!("undisturbed: {:.0} s", started.elapsed().as_secs_f64());

    let started = Instant::now();
    let mut fleet = Fleet::start_with(plan);
    let mut rehearsal = Rehearsal {
        fleet: &mut fleet,
        occurrences: BTreeMap::new(),
        rng: ChaCha8Rng::seed_from_u64(arguments.seed),
        outage: Duration::from_secs(arguments.outage_secs),
        retried: 0,
    };
    rehearsal.run();
    let Rehearsal { occurrences, retried, .. } = rehearsal;
    let outcome = fleet.outcome();
    println!("disturbed: {:.0} s", started.elapsed().as_secs_f64());
    for (label, times) in occurrences {
        println!("  {label}: {times}");
    }
    println!("quarantined rollouts that the operator retried: {retried}");
    match outcome == expected {
        true => {
            println!("report and results: the same, {} bytes", outcome.len());
            ExitCode::SUCCESS
        }
        false => {
            let mut pairs = expected.lines().zip(outcome.lines());
            let differing = pairs.find(|(undisturbed, disturbed)| undisturbed != disturbed);
            let (undisturbed, disturbed) = differing.unwrap_or_default();
            println!(
                "report and results differ:\n  undisturbed {undisturbed}\n  disturbed   {disturbed}"
            );
            ExitCode::FAILURE
        }
    }
}

fn plan(arguments: &Arguments) -> Plan {
    let replicates = arguments.replicates.to_string();
    #[rustfmt::skip]
    let design = [
        "--tasks", &arguments.tasks, "--axes", "all", "--levels", "L1,L2,L3", "--configs", "0-9",
        "--nominal", "all", "--replicates", &replicates,
    ];
    Plan {
        workers: arguments.workers,
        slots_each: arguments.slots,
        design: design.map(str::to_owned).into(),
        patience: Duration::from_secs(3_600),
        ..Plan::small(SlotKind::Simulated)
    }
}

/// A campaign with faults.
struct Rehearsal<'a> {
    fleet: &'a mut Fleet,
    /// Number of events and faults so far, by label.
    occurrences: BTreeMap<String, u32>,
    rng: ChaCha8Rng,
    /// Duration of outages of policy and disk.
    outage: Duration,
    /// Number of rollouts retried from quarantine.
    retried: u64,
}

impl Rehearsal<'_> {
    /// Injects faults until the campaign is finished.
    fn run(&mut self) {
        let mut events = EVENTS.into_iter().peekable();
        let mut backup = None;
        let mut next_fault = Instant::now();
        loop {
            let status = self.fleet.status();
            let count = |name: &str| status["rollouts"][name].as_u64().unwrap_or_default();
            if status["is_finished"] == true {
                if count("quarantined") == 0 {
                    return;
                }
                // Like an operator who has read the errors.
                self.retried += count("quarantined");
                self.fleet.retry_quarantined();
            }
            let share = count("committed") as f64 / count("total").max(1) as f64;
            if let Some((_, event)) = events.next_if(|(at, _)| share >= *at) {
                self.trigger(event, &mut backup);
            } else if Instant::now() >= next_fault {
                let fault = self.random_fault();
                self.fleet.inject(fault);
                self.count(describe(fault));
                let (least, most) = INTERVAL_MILLIS;
                let interval = least + self.rng.next_u64() % (most - least);
                next_fault = Instant::now() + Duration::from_millis(interval);
            } else {
                sleep(POLL_INTERVAL);
            }
        }
    }

    fn trigger(&mut self, event: Event, backup: &mut Option<PathBuf>) {
        let label = match event {
            Event::PolicyOutage => {
                self.fleet.inject(Fault::KillPolicy(self.outage));
                "outage of the policy"
            }
            Event::Restart => {
                self.fleet.restart_coordinator();
                "restart of the coordinator"
            }
            Event::FullDisk => {
                self.fleet.inject(Fault::FullDisk(self.outage));
                "full disk of the coordinator"
            }
            Event::ClockJump(by) => match self.fleet.jump_clock(by) {
                true => "jump of the coordinator's clock to a day ahead or behind",
                false => "SKIPPED: the clock does not jump without libfaketime",
            },
            Event::Backup => {
                *backup = Some(self.fleet.back_up());
                "backup of the database"
            }
            Event::Restore => {
                self.fleet.restore(backup.as_ref().expect("an earlier backup"));
                "loss of the data folder, the backup restored"
            }
        };
        self.count(label);
    }

    fn count(&mut self, label: &str) {
        *self.occurrences.entry(label.to_owned()).or_default() += 1;
    }

    /// Draws a random fault, most often a fault of a worker.
    fn random_fault(&mut self) -> Fault {
        match self.rng.next_u64() % 10 {
            0..=2 => Fault::KillWorker,
            3..=5 => Fault::DrainWorker,
            6 => Fault::KillSlot,
            7 => Fault::KillCoordinator(POLL_INTERVAL),
            8 => Fault::KillGateway(POLL_INTERVAL),
            _ => Fault::Cut(Link::ToCoordinator),
        }
    }
}

fn describe(fault: Fault) -> &'static str {
    match fault {
        Fault::KillWorker => "worker killed, and another one started",
        Fault::DrainWorker => "worker drained, and another one started",
        Fault::KillSlot => "all slots of a worker killed",
        Fault::KillCoordinator(_) => "coordinator killed",
        Fault::KillGateway(_) => "gateway killed",
        Fault::Cut(_) => "every connection to the coordinator cut",
        _ => "other fault",
    }
}
