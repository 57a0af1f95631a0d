//! Tests of early stops of campaigns, on published outcomes.

use std::collections::BTreeSet;

use libero_ctrl::{Axis, AxisSet, Condition, Level, Measure, RolloutId, Stop, Strata};
use paired::{
    CampaignLook, Outcome, Record, Records, SEQUENTIAL_ALPHA, SequentialMeasures, Unit, drawn_order,
};
use serde::Deserialize;

// The example `coverage` uses the remaining functions.
#[allow(dead_code)]
mod simulated;

use simulated::{Chance, NetEffect};

const OUTCOMES: &str = include_str!("../../../../examples/openvla_oft/rollouts.jsonl");

#[derive(Deserialize)]
struct Row {
    rollout_id: RolloutId,
    init_id: u16,
    success: bool,
}

fn published() -> Vec<Record> {
    let record = |line: &str| {
        let row: Row = serde_json::from_str(line).expect("a row");
        Record {
            id: row.rollout_id,
            init_id: row.init_id,
            replicate: 0,
            outcome: Outcome::from(row.success),
        }
    };
    OUTCOMES.lines().map(record).collect()
}

fn stop(rule: &str, strata: Strata) -> Stop {
    Stop {
        rule: rule.parse().expect("a rule"),
        seed: 3,
        strata,
    }
}

fn when_met(records: &[Record], stop: &Stop) -> Option<CampaignLook> {
    let records = Records::new(records).expect("no rollout twice");
    CampaignLook::when_met(&records, stop)
}

/// Number of configurations after which a rule is met at one level alone.
fn met_at(records: &Records, level: Level, stop: &Stop) -> Option<usize> {
    let matched = records.configurations().iter();
    let of_level: Vec<_> = matched
        .filter(|configuration| configuration.level == level)
        .collect();
    let order = drawn_order(
        stop,
        of_level
            .iter()
            .map(|configuration| (configuration.task, configuration.config)),
    );
    let mut sequential = SequentialMeasures::new(&order, SEQUENTIAL_ALPHA);
    order.units().position(|unit| {
        let matched = of_level
            .iter()
            .find(|configuration| (configuration.task, configuration.config) == *unit);
        let possible = matched.and_then(|matched| matched.possible_transitions());
        let taken = sequential.complete(unit, &possible.expect("it is known"));
        taken.expect("a configuration of the order");
        sequential.look().meets(&stop.rule)
    })
}

#[test]
fn a_campaign_ends_when_its_rule_has_been_met_at_every_level() {
    let all = published();
    let records = Records::new(&all).expect("no rollout twice");
    for strata in [Strata::Suites, Strata::Tasks] {
        let stop = stop("width(I) < 0.2", strata);
        let levels = Level::PERTURBED.map(|level| met_at(&records, level, &stop));
        let last = levels.into_iter().flatten().max().expect("it is met");
        let look = CampaignLook::when_met(&records, &stop).expect("it is met");
        assert_eq!(look.used.len(), last + 1);
        assert_eq!(look.units, 400);
        assert!(look.levels.values().all(|look| look.used == last + 1));
    }
}

#[test]
fn outcomes_after_the_look_change_nothing_and_those_before_are_needed() {
    let mut records = published();
    let stop = stop("width(S_sim) < 0.25", Strata::Suites);
    let look = when_met(&records, &stop).expect("it is met");
    let used: BTreeSet<Unit> = look.used.iter().copied().collect();
    for (place, record) in records.iter_mut().enumerate() {
        let unit = record.id.config().map(|config| (record.id.task(), config));
        if unit.is_none_or(|unit| !used.contains(&unit)) {
            record.outcome = match place % 3 {
                0 => Outcome::Missing,
                1 => Outcome::Quarantined,
                _ => record.outcome,
            };
        }
    }
    assert_eq!(when_met(&records, &stop), Some(look.clone()));

    // In the configuration at which the rule was met, one rollout is open at one level.
    let (task, config) = *look.used.last().expect("some");
    let is_last =
        |record: &&mut Record| record.id.task() == task && record.id.config() == Some(config);
    let open = records
        .iter_mut()
        .filter(is_last)
        .last()
        .expect("a rollout");
    open.outcome = Outcome::Missing;
    assert_eq!(when_met(&records, &stop), None);
    let records = Records::new(&records).expect("no rollout twice");
    let now = CampaignLook::now(&records, &stop).expect("configurations");
    assert_eq!(now.used, look.used[..look.used.len() - 1]);
}

#[test]
fn a_rule_that_only_the_last_configuration_meets_ends_nothing_early() {
    let records = published();
    // The interval has no width only after all configurations.
    assert_eq!(
        when_met(&records, &stop("width(I) < 0.0001", Strata::Tasks)),
        None
    );
    let records = Records::new(&records).expect("no rollout twice");
    let now = CampaignLook::now(&records, &stop("I excludes 1", Strata::Tasks));
    assert!(now.is_some_and(|now| now.used.len() == now.units));
    assert_eq!(
        CampaignLook::now(&Records::default(), &stop("I excludes 1", Strata::Tasks)),
        None
    );
}

#[test]
fn a_configuration_counts_once_its_nominal_rollout_and_its_subsets_have_ended_too() {
    let published = published();
    let stop = stop("width(S_sim) < 0.25", Strata::Suites);
    let look = when_met(&published, &stop).expect("it is met");
    let last = *look.used.last().expect("some");
    let is_of = |record: &Record, (task, config): Unit| {
        record.id.task() == task && record.id.config() == Some(config)
    };
    let of_last = published.iter().find(|record| is_of(record, last));
    let of_last = of_last.expect("a rollout");
    let pair = AxisSet::of(Axis::Camera).union(AxisSet::of(Axis::Robot));
    let further = [
        RolloutId::clean(last.0, of_last.init_id),
        RolloutId::perturbed(last.0, Condition::Subset(pair), Level::L2, last.1).expect("a pair"),
    ];
    for id in further {
        let with = |outcome: Outcome| {
            let record = Record {
                id,
                outcome,
                ..*of_last
            };
            [&published[..], &[record]].concat()
        };
        for outcome in [Outcome::Success, Outcome::Quarantined] {
            assert_eq!(when_met(&with(outcome), &stop), Some(look.clone()), "{id}");
        }
        let met = when_met(&with(Outcome::Missing), &stop);
        assert_eq!(met, None, "{id}");

        let all = with(Outcome::Failure);
        let counted = CampaignLook::counted_when_met(&all, &stop).expect("it is met");
        // Seven conditions at three levels, and the added record.
        assert_eq!(counted.len(), 21 * look.used.len() + 1, "{id}");
        let used: BTreeSet<Unit> = look.used.iter().copied().collect();
        let perturbed = counted.iter().filter(|record| record.id.config().is_some());
        for record in perturbed {
            let unit = (record.id.task(), record.id.config().unwrap_or_default());
            assert!(used.contains(&unit), "{}", record.id);
        }
    }
}

/// Suites of 100 and 30 configurations, of which 80 and 16 succeed: 73.8 %.
fn unequal_suites() -> Vec<Record> {
    let mut records = Vec::new();
    for at in 0..13 {
        let task = match at {
            0..10 => simulated::task(2 * at, 2),
            _ => simulated::task(2 * (at - 10) + 1, 2),
        };
        for config in 0..10 {
            let success = match at {
                0..10 => config < 8,
                _ => (at - 10) * 10 + usize::from(config) < 16,
            };
            for condition in simulated::conditions() {
                let success = success || condition != Condition::Combination;
                records.push(simulated::record(
                    task,
                    condition,
                    Level::L2,
                    config,
                    success,
                ));
            }
        }
    }
    records
}

#[test]
fn estimates_weigh_suites_as_the_campaign_has_them_however_early_it_ends() {
    let all = unequal_suites();
    let records = Records::new(&all).expect("no rollout twice");
    let (mut weighed, mut drawn, mut ends) = (0.0, 0.0, 0.0);
    for seed in 0..100 {
        let stop = Stop {
            seed,
            ..stop("width(S_sim) < 0.35", Strata::Suites)
        };
        let look = CampaignLook::when_met(&records, &stop).expect("it is met");
        weighed += look.estimates(&records, &stop)[&Level::L2][&Measure::SSim];
        let used: BTreeSet<Unit> = look.used.iter().copied().collect();
        let of_used = records.configurations().iter();
        let of_used = of_used.filter(|matched| used.contains(&(matched.task, matched.config)));
        let successes = of_used.filter(|matched| matched.simultaneous == Outcome::Success);
        drawn += successes.count() as f64 / used.len() as f64;
        ends += 1.0;
    }
    let [weighed, drawn] = [weighed, drawn].map(|sum| 100.0 * sum / ends);
    assert!((weighed - 73.8).abs() < 1.0, "{weighed}");
    assert!(
        weighed - drawn > 3.0,
        "{drawn}: what was drawn is in proportion, nothing is tested"
    );
}

fn new_tasks(seed: u64) -> Stop {
    Stop {
        seed,
        ..stop("I excludes 0 for new tasks", Strata::WholeTasks)
    }
}

#[test]
fn a_rule_about_new_tasks_ends_nothing_without_an_effect_and_most_with_a_large_one() {
    let ends = |mean: f64| {
        let effect = NetEffect {
            mean,
            share: 0.5,
            spread: 0.1,
        };
        let mut chance = Chance::new(9);
        let mut met = 0;
        for seed in 0..100 {
            let records = effect.campaign(&mut chance);
            if let Some(look) = when_met(&records, &new_tasks(seed)) {
                // Only whole tasks count, equally many of each of four suites: multiples of 40.
                assert!(look.used.len().is_multiple_of(40), "{}", look.used.len());
                let interval = look.levels[&Level::L2].intervals[&Measure::I];
                assert!(interval.high() < 0.0);
                met += 1;
            }
        }
        met
    };
    // At an error rate of 5 %, more than 13 false stops in 100 have a probability of 0.0005.
    assert!(ends(0.0) <= 13);
    assert!(ends(-0.25) >= 90);
}

#[test]
fn a_rule_about_new_tasks_is_met_by_outcomes_up_to_the_end_of_a_round_only() {
    let effect = NetEffect {
        mean: -0.3,
        share: 0.0,
        spread: 0.0,
    };
    let mut records = effect.campaign(&mut Chance::new(4));
    let stop = new_tasks(1);
    let look = when_met(&records, &stop).expect("it is met");
    let used: BTreeSet<Unit> = look.used.iter().copied().collect();
    for record in &mut records {
        let unit = (record.id.task(), record.id.config().expect("perturbed"));
        if !used.contains(&unit) {
            record.outcome = Outcome::Missing;
        }
    }
    assert_eq!(when_met(&records, &stop), Some(look.clone()));
    let last = *look.used.last().expect("some");
    for record in &mut records {
        if (record.id.task(), record.id.config()) == (last.0, Some(last.1)) {
            record.outcome = Outcome::Missing;
        }
    }
    assert_eq!(when_met(&records, &stop), None);
}
