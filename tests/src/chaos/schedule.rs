//! Schedules of faults, drawn from a seed so that a failure can be replayed.

use std::fmt;
use std::time::Duration;

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

const FAULTS: u64 = 3;
/// Largest number of charged faults in a schedule. A fault is charged to a rollout if it kills a
/// slot while its worker runs. A third charged attempt would correctly quarantine the rollout,
/// which is not the subject of these tests. Faults of the network, the disk, the coordinator and
/// whole workers are never charged and therefore not limited.
const MAX_CHARGED_FAULTS: usize = 2;
/// Latest start of the last fault, milliseconds; the campaign is still running then.
const LATEST_START_MS: u64 = 2_500;

/// A connection between two programs that can be broken.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Link {
    /// From the workers to the coordinator.
    ToCoordinator,
    /// From the slots to the gateway.
    ToGateway,
    /// From the gateway to the policy.
    ToPolicy,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    /// `kill -9` of the coordinator and a restart after the given time.
    KillCoordinator(Duration),
    /// `kill -9` of a worker's parent process; a new one is started on its machine.
    KillWorker,
    /// `kill -9` of a worker with its slots; a new one is started on its machine after the
    /// given time.
    RestartMachine(Duration),
    /// SIGTERM of a worker; a new one is started. Never drawn, because it breaks nothing.
    DrainWorker,
    /// `kill -9` of the processes of all slots of a worker, which starts them again.
    KillSlot,
    /// `kill -9` of the gateway and a restart after the given time.
    KillGateway(Duration),
    /// `kill -9` of the policy and a restart after the given time.
    KillPolicy(Duration),
    /// SIGSTOP of a worker's parent, then SIGCONT after the given time, longer than a lease.
    StopWorker(Duration),
    /// SIGSTOP of the coordinator, then SIGCONT after the given time.
    StopCoordinator(Duration),
    Cut(Link),
    /// A link refuses all connections for the given time.
    Block(Link, Duration),
    /// All data on a link is delayed by the given time, for one second.
    Delay(Link, Duration),
    /// All requests of workers to the coordinator arrive twice for the given time.
    Duplicate(Duration),
    /// All responses of the coordinator are lost for the given time.
    LoseAnswers(Duration),
    /// All writes of the coordinator fail for the given time.
    FullDisk(Duration),
    /// The coordinator is started on a read-only database, which is then made writable.
    ReadOnlyDatabase,
}

/// Number of kinds of faults that are drawn.
const KINDS: u64 = 15;

/// Faults, each with its start, measured from the campaign's start.
#[derive(Clone, Debug)]
pub struct Schedule {
    pub seed: u64,
    /// Faults in the order of time.
    pub faults: Vec<(Duration, Fault)>,
}

impl Schedule {
    /// Draws the schedule of a seed. One fault is of kind `seed % KINDS`, so that `KINDS`
    /// consecutive seeds cover every kind.
    pub fn new(seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut faults = vec![draw(&mut rng, seed % KINDS)];
        while (faults.len() as u64) < FAULTS {
            let kind = rng.next_u64() % KINDS;
            let fault = draw(&mut rng, kind);
            let charged = faults.iter().chain([&fault]).filter(|fault| fault.is_charged());
            if charged.count() <= MAX_CHARGED_FAULTS {
                faults.push(fault);
            }
        }
        let mut faults: Vec<_> = faults
            .into_iter()
            .map(|fault| (between(&mut rng, 0, LATEST_START_MS), fault))
            .collect();
        faults.sort_by_key(|(at, _)| *at);
        Self { seed, faults }
    }

    /// Returns the number of charged faults. Each costs at most one attempt, because workers
    /// have one slot here.
    pub fn charged_faults(&self) -> usize {
        let faults = self.faults.iter();
        faults.filter(|(_, fault)| fault.is_charged()).count()
    }
}

impl Fault {
    /// Returns true if the fault may cost a rollout one of its attempts, because the worker reports
    /// the failure of its slot.
    fn is_charged(self) -> bool {
        matches!(self, Fault::KillSlot)
    }
}

impl fmt::Display for Schedule {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "seed {}:", self.seed)?;
        for (at, fault) in &self.faults {
            write!(f, " at {:.2} s {fault:?};", at.as_secs_f64())?;
        }
        Ok(())
    }
}

fn draw(rng: &mut ChaCha8Rng, kind: u64) -> Fault {
    let down = between(rng, 0, 800);
    match kind {
        0 => Fault::KillCoordinator(down),
        1 => Fault::KillWorker,
        2 => Fault::KillSlot,
        3 => Fault::KillGateway(down),
        4 => Fault::KillPolicy(down),
        5 => Fault::StopWorker(super::LEASE + between(rng, 1_200, 2_000)),
        6 => Fault::StopCoordinator(between(rng, 300, 2_500)),
        7 => Fault::Cut(random_link(rng)),
        8 => Fault::Delay(random_link(rng), between(rng, 20, 400)),
        9 => Fault::Duplicate(between(rng, 300, 900)),
        10 => Fault::FullDisk(between(rng, 300, 2_500)),
        11 => Fault::LoseAnswers(between(rng, 300, 4_000)),
        12 => Fault::Block(random_link(rng), super::LEASE + between(rng, 200, 2_000)),
        13 => Fault::RestartMachine(between(rng, 0, 4_000)),
        _ => Fault::ReadOnlyDatabase,
    }
}

fn random_link(rng: &mut ChaCha8Rng) -> Link {
    let links = [Link::ToCoordinator, Link::ToGateway, Link::ToPolicy];
    links[(rng.next_u64() % 3) as usize]
}

fn between(rng: &mut ChaCha8Rng, least_ms: u64, most_ms: u64) -> Duration {
    Duration::from_millis(least_ms + rng.next_u64() % (most_ms - least_ms + 1))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_seed_always_gives_the_same_schedule() {
        for seed in 0..100 {
            let schedule = Schedule::new(seed);
            assert_eq!(schedule.faults, Schedule::new(seed).faults);
            assert_eq!(schedule.faults.len() as u64, FAULTS);
            assert!(schedule.charged_faults() <= MAX_CHARGED_FAULTS, "{schedule}");
        }
    }
}
