//! Schedules of faults: drawn from a seed, so that a failure can be replayed.

use std::fmt;
use std::time::Duration;

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

/// Faults of one schedule.
const FAULTS: u64 = 3;
/// Faults of one schedule that are charged to a rollout, because a slot ends under its
/// worker. Three charged attempts would quarantine it, which is what should happen, but
/// not what is tested. Faults of the network, the disk, the coordinator and of whole
/// workers are never charged, and so not limited.
const MAX_CHARGED_FAULTS: usize = 2;
/// When the last fault begins, at the latest: while the campaign still runs.
const LAST_BEGINNING_MS: u64 = 2_500;

/// A wire that can be broken.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Way {
    /// Way from the workers to the coordinator.
    ToCoordinator,
    /// Way from the slots to the gateway.
    ToGateway,
    /// Way from the gateway to the policy.
    ToPolicy,
}

/// One thing that goes wrong.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    /// `kill -9`, and started again after so long.
    KillCoordinator(Duration),
    /// `kill -9` of a worker's parent process; another one is started on its machine.
    KillWorker,
    /// `kill -9` of a worker with its slots; after so long another one is started on its
    /// machine.
    RestartMachine(Duration),
    /// SIGTERM of a worker; another one is started. Not drawn: it breaks nothing.
    DrainWorker,
    /// `kill -9` of a slot's process.
    KillSlot,
    /// `kill -9`, and started again after so long.
    KillGateway(Duration),
    /// `kill -9`, and started again after so long.
    KillPolicy(Duration),
    /// SIGSTOP of a worker's parent for longer than its lease, then SIGCONT.
    StopWorker(Duration),
    /// SIGSTOP of the coordinator, then SIGCONT.
    StopCoordinator(Duration),
    /// All connections of a wire are cut at once.
    Cut(Way),
    /// No connection of a wire is let through for so long.
    Block(Way, Duration),
    /// Everything on a wire arrives late.
    Delay(Way, Duration),
    /// Everything that workers tell the coordinator for so long arrives twice.
    Duplicate(Duration),
    /// Everything that the coordinator answers for so long is lost.
    LoseAnswers(Duration),
    /// The coordinator can write nothing for so long.
    FullDisk(Duration),
    /// The coordinator is started on a database that it may not write; then it
    /// may again.
    ReadOnlyDatabase,
}

/// Kinds of faults.
const KINDS: u64 = 15;

/// Faults, each with the time at which it begins, from the campaign's start.
#[derive(Clone, Debug)]
pub struct Schedule {
    /// Seed of the schedule.
    pub seed: u64,
    /// Faults in the order of time.
    pub faults: Vec<(Duration, Fault)>,
}

impl Schedule {
    /// The schedule of a seed. Consecutive seeds begin with different kinds of
    /// faults, so that a dozen of them have every kind.
    pub fn new(seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut faults = vec![draw(&mut rng, seed % KINDS)];
        while (faults.len() as u64) < FAULTS {
            let kind = rng.next_u64() % KINDS;
            let fault = draw(&mut rng, kind);
            let broken = faults.iter().chain([&fault]).filter(|it| it.is_charged());
            if broken.count() <= MAX_CHARGED_FAULTS {
                faults.push(fault);
            }
        }
        let mut faults: Vec<_> = faults
            .into_iter()
            .map(|fault| (between(&mut rng, 0, LAST_BEGINNING_MS), fault))
            .collect();
        faults.sort_by_key(|(at, _)| *at);
        Self { seed, faults }
    }

    /// Number of its faults that are charged: each costs one attempt at most, as workers
    /// have one slot here.
    pub fn charged_faults(&self) -> usize {
        let faults = self.faults.iter();
        faults.filter(|(_, fault)| fault.is_charged()).count()
    }
}

impl Fault {
    /// Whether it may cost a rollout one of its attempts: its worker tells of it.
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
        7 => Fault::Cut(way(rng)),
        8 => Fault::Delay(way(rng), between(rng, 20, 400)),
        9 => Fault::Duplicate(between(rng, 300, 900)),
        10 => Fault::FullDisk(between(rng, 300, 2_500)),
        11 => Fault::LoseAnswers(between(rng, 300, 4_000)),
        12 => Fault::Block(way(rng), super::LEASE + between(rng, 200, 2_000)),
        13 => Fault::RestartMachine(between(rng, 0, 4_000)),
        _ => Fault::ReadOnlyDatabase,
    }
}

fn way(rng: &mut ChaCha8Rng) -> Way {
    let ways = [Way::ToCoordinator, Way::ToGateway, Way::ToPolicy];
    ways[(rng.next_u64() % 3) as usize]
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
            assert!(
                schedule.charged_faults() <= MAX_CHARGED_FAULTS,
                "{schedule}"
            );
        }
    }
}
