//! A week of operation in compressed time: a campaign on slots that start and stop, with an outage
//! of the policy, a restart of the coordinator, a full disk, clock jumps and a restored backup. All
//! processes are real, except that slots are simulated. Report and results equal those of the same
//! campaign without faults, byte for byte.

use std::thread::sleep;
use std::time::{Duration, Instant};

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};
use tests::chaos::{Fault, Fleet, Link, Plan, SlotKind};

const POLL_INTERVAL: Duration = Duration::from_millis(500);
/// Range of the interval between two random faults, milliseconds; the upper end is excluded.
const INTERVAL_MILLIS: (u64, u64) = (1_000, 4_000);
const OUTAGE: Duration = Duration::from_secs(1);

#[derive(Clone, Copy)]
enum Event {
    Fault(Fault),
    Restart,
    ClockJump(&'static str),
    Backup,
    Restore,
}

/// One-time events, each with the share of committed rollouts after which it happens. A clock jump
/// has the clock's new offset from the true time.
const EVENTS: [(f64, Event); 7] = [
    (0.10, Event::Fault(Fault::KillPolicy(OUTAGE))),
    (0.25, Event::Restart),
    (0.40, Event::Fault(Fault::FullDisk(OUTAGE))),
    (0.50, Event::ClockJump("+1d")),
    (0.60, Event::ClockJump("-1d")),
    (0.65, Event::Backup),
    (0.80, Event::Restore),
];

#[test]
fn a_disturbed_week_ends_as_an_undisturbed_one() {
    // 50 nominal rollouts, and ten configurations under seven conditions at three levels.
    #[rustfmt::skip]
    let design = [
        "--tasks", "libero_object/0", "--axes", "all", "--levels", "L1,L2,L3",
        "--configs", "0-9", "--nominal", "all",
    ];
    let plan = Plan {
        workers: 2,
        slots_each: 2,
        design: design.map(str::to_owned).into(),
        patience: Duration::from_hours(1),
        ..Plan::small(SlotKind::Simulated)
    };
    let mut undisturbed = Fleet::start_with(plan.clone());
    assert_eq!(undisturbed.status()["rollouts"]["total"], 260);
    let expected = undisturbed.outcome();
    drop(undisturbed);
    let mut fleet = Fleet::start_with(plan);
    disturb(&mut fleet);
    let outcome = fleet.outcome();
    let differing = expected.lines().zip(outcome.lines()).find(|(one, other)| one != other);
    assert!(outcome == expected, "first difference: {differing:?}");
}

/// Injects random faults and all events until the campaign is finished.
fn disturb(fleet: &mut Fleet) {
    let mut rng = ChaCha8Rng::seed_from_u64(0);
    let mut events = EVENTS.into_iter().peekable();
    let mut backup = None;
    let mut next_fault = Instant::now();
    loop {
        let status = fleet.status();
        let count = |name: &str| status["rollouts"][name].as_u64().unwrap_or_default();
        if status["is_finished"] == true {
            if count("quarantined") == 0 {
                assert!(events.next().is_none(), "the campaign ended before all events");
                return;
            }
            // Like an operator who has read the errors.
            fleet.retry_quarantined();
        }
        let share = count("committed") as f64 / count("total").max(1) as f64;
        if let Some((_, event)) = events.next_if(|(at, _)| share >= *at) {
            match event {
                Event::Fault(fault) => fleet.inject(fault),
                Event::Restart => fleet.restart_coordinator(),
                Event::ClockJump(by) => {
                    if !fleet.jump_clock(by) {
                        eprintln!("SKIPPED: the clock does not jump without libfaketime");
                    }
                }
                Event::Backup => backup = Some(fleet.back_up()),
                Event::Restore => fleet.restore(backup.as_ref().expect("an earlier backup")),
            }
        } else if Instant::now() >= next_fault {
            fleet.inject(match rng.next_u64() % 10 {
                0..=2 => Fault::KillWorker,
                3..=5 => Fault::DrainWorker,
                6 => Fault::KillSlot,
                7 => Fault::KillCoordinator(POLL_INTERVAL),
                8 => Fault::KillGateway(POLL_INTERVAL),
                _ => Fault::Cut(Link::ToCoordinator),
            });
            let (least, most) = INTERVAL_MILLIS;
            let interval = least + rng.next_u64() % (most - least);
            next_fault = Instant::now() + Duration::from_millis(interval);
        } else {
            sleep(POLL_INTERVAL);
        }
    }
}
