//! Whole campaigns under seeded schedules of faults on real processes. After each, the campaign
//! finishes, its database satisfies every invariant, its report and results equal those of the
//! undisturbed campaign byte for byte, and no more attempts are charged than slots were killed
//! under their workers: network failures and restarted machines cost no rollout an attempt.
//!
//! `ROLLOUT_CHAOS_SEEDS=17` replays one schedule, `ROLLOUT_CHAOS_SEEDS=1000-1999` plays a thousand
//! (docs/dev/RELIABILITY.md).

use std::collections::VecDeque;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Mutex;
use std::time::{Duration, Instant};

use sqlx::sqlite::{SqliteConnectOptions, SqlitePool};
use tests::chaos::{Fault, Fleet, LEASE, Link, Plan, Schedule, SlotKind};

/// Numbers of schedules with simulated slots and with MuJoCo.
const SIMULATED_SCHEDULES: u64 = 48;
const REAL_SCHEDULES: u64 = 4;
/// Number of concurrent systems for each core; a system waits most of the time.
const SYSTEMS_PER_CORE: usize = 3;

/// Query for the number of charged attempts.
const CHARGED: &str = "SELECT coalesce(sum(charged), 0) FROM failure";

#[test]
fn a_campaign_under_faults_ends_as_the_undisturbed_one() {
    play(SlotKind::Simulated, seeds(0..SIMULATED_SCHEDULES));
}

#[test]
fn a_campaign_with_mujoco_under_faults_ends_as_the_undisturbed_one() {
    play(SlotKind::Real, seeds(100..100 + REAL_SCHEDULES));
}

fn seeds(default: std::ops::Range<u64>) -> VecDeque<u64> {
    let Ok(text) = std::env::var("ROLLOUT_CHAOS_SEEDS") else {
        return default.collect();
    };
    let (first, last) = text.split_once('-').unwrap_or((&text, &text));
    let number = |text: &str| text.parse::<u64>().expect("ROLLOUT_CHAOS_SEEDS: N or N-M");
    (number(first)..=number(last)).collect()
}

/// Plays schedules, several at a time, and finally names those that failed.
fn play(slots: SlotKind, seeds: VecDeque<u64>) {
    let start = Instant::now();
    let expected = Fleet::start(slots).outcome();
    // The smaller campaign, with MuJoCo, has seven rollouts.
    let results = expected.matches("\"success\":").count();
    assert!(results >= 7, "the undisturbed campaign has {results} results");
    let count = seeds.len();
    let (seeds, failed) = (Mutex::new(seeds), Mutex::new(Vec::new()));
    std::thread::scope(|threads| {
        let cores = std::thread::available_parallelism().map_or(2, usize::from);
        for _ in 0..cores * SYSTEMS_PER_CORE {
            threads.spawn(|| {
                while let Some(seed) = { seeds.lock().unwrap().pop_front() } {
                    if !ends_as_expected(&Schedule::new(seed), slots, &expected) {
                        failed.lock().unwrap().push(seed);
                    }
                }
            });
        }
    });
    let secs = start.elapsed().as_secs();
    eprintln!("{count} schedules of {slots:?} slots in {secs} s");
    let failed = failed.into_inner().unwrap();
    assert!(
        failed.is_empty(),
        "schedules {failed:?} failed; replay one of them with ROLLOUT_CHAOS_SEEDS=SEED"
    );
}

/// Returns the number that a query of the coordinator's database yields.
fn count(fleet: &Fleet, sql: &'static str) -> i64 {
    let options = SqliteConnectOptions::new().filename(fleet.data().join("coordinator.sqlite"));
    tokio::runtime::Runtime::new().unwrap().block_on(async {
        let pool = SqlitePool::connect_with(options).await.unwrap();
        let count = sqlx::query_scalar(sql).fetch_one(&pool).await.unwrap();
        pool.close().await;
        count
    })
}

/// Plays one schedule, and returns true if the campaign's outcome is the expected one. Otherwise
/// prints the schedule, the difference and the end of the log.
fn ends_as_expected(schedule: &Schedule, slots: SlotKind, expected: &str) -> bool {
    let mut fleet = Fleet::start(slots);
    let played = catch_unwind(AssertUnwindSafe(|| {
        fleet.inject_all(schedule);
        let outcome = fleet.outcome();
        let charged = usize::try_from(count(&fleet, CHARGED)).expect("few");
        let most = schedule.charged_faults();
        assert!(charged <= most, "{charged} attempts are charged, {most} at most");
        outcome
    }));
    let is_same = played.as_deref().is_ok_and(|outcome| outcome == expected);
    if !is_same {
        let outcome = played.unwrap_or_else(|_| "none".to_owned());
        eprintln!(
            "FAILED {slots:?} {schedule}\n{}\n{}",
            difference(expected, &outcome),
            fleet.log_tail()
        );
    }
    is_same
}

fn difference(expected: &str, outcome: &str) -> String {
    let mut pairs = expected.lines().zip(outcome.lines());
    match pairs.find(|(expected, found)| expected != found) {
        Some((expected, found)) => format!("expected {expected}\ngot      {found}"),
        None => "one outcome is the beginning of the other".to_owned(),
    }
}

#[test]
fn workers_suspended_beyond_their_leases_lose_no_result() {
    // With several workers, a rollout might be leased to another worker before the suspended worker
    // wakes.
    let mut fleet = Fleet::start_with(Plan { workers: 1, ..Plan::small(SlotKind::Simulated) });
    fleet.wait_for_commits(3);
    for _ in 0..3 {
        fleet.stop_all_workers(LEASE + Duration::from_secs(2));
        std::thread::sleep(Duration::from_millis(300));
    }
    fleet.outcome();
    assert_eq!(count(&fleet, "SELECT count(*) FROM failure"), 0);
    assert_eq!(count(&fleet, "SELECT sum(stale_reports) FROM job"), 0);
}

/// Regression: three outages quarantined the running rollouts, and five stopped all workers.
#[test]
fn repeated_network_outages_charge_neither_rollouts_nor_workers() {
    let mut fleet = Fleet::start(SlotKind::Simulated);
    for _ in 0..6 {
        fleet.inject(Fault::Block(Link::ToCoordinator, LEASE + Duration::from_secs(1)));
        std::thread::sleep(Duration::from_millis(300));
    }
    fleet.outcome();
    assert_eq!(count(&fleet, CHARGED), 0);
    let charged_workers = "SELECT count(*) FROM worker WHERE charged_in_a_row > 0";
    assert_eq!(count(&fleet, charged_workers), 0);
}

/// Regression: a claim whose answer was lost left a lease that expired as a charged failure of the
/// rollout and of the worker.
#[test]
fn lost_answers_of_the_coordinator_charge_neither_rollouts_nor_workers() {
    let mut fleet = Fleet::start(SlotKind::Simulated);
    for _ in 0..3 {
        // Longer than the duration of a lease that is never acknowledged.
        fleet.inject(Fault::LoseAnswers(LEASE + Duration::from_secs(1)));
        std::thread::sleep(Duration::from_millis(300));
    }
    fleet.outcome();
    assert_eq!(count(&fleet, CHARGED), 0);
    let stopped_workers = "SELECT count(*) FROM worker WHERE stopped_reason IS NOT NULL";
    assert_eq!(count(&fleet, stopped_workers), 0);
}
