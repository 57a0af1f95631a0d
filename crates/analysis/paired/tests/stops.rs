//! Tests of early stops of campaigns, on published outcomes.

use std::collections::BTreeSet;

use libero_ctrl::{Axis, AxisSet, Condition, Level, RolloutId, Stop, Strata};
use paired::{
    CampaignLook, Outcome, Record, Records, SEQUENTIAL_ALPHA, SequentialMeasures, Unit, drawn_order,
};
use serde::Deserialize;

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
    let of_level: Vec<_> = matched.filter(|it| it.level == level).collect();
    let order = drawn_order(stop, of_level.iter().map(|it| (it.task, it.config)));
    let mut sequential = SequentialMeasures::new(&order, SEQUENTIAL_ALPHA);
    order.units().position(|unit| {
        let matched = of_level.iter().find(|it| (it.task, it.config) == *unit);
        let possible = matched.and_then(|it| it.possible_transitions());
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
        assert!(look.levels.values().all(|it| it.used == last + 1));
    }
}

#[test]
fn what_lies_beyond_the_look_changes_nothing_and_what_lies_before_it_is_needed() {
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

    // Of the configuration in which it was met, one rollout is open at one level.
    let (task, config) = *look.used.last().expect("some");
    let is_last = |it: &&mut Record| it.id.task() == task && it.id.config() == Some(config);
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
    // Only once all are seen, the interval is a point.
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
        // Seven conditions at three levels, and the further one.
        assert_eq!(counted.len(), 21 * look.used.len() + 1, "{id}");
        let used: BTreeSet<Unit> = look.used.iter().copied().collect();
        let perturbed = counted.iter().filter(|record| record.id.config().is_some());
        for record in perturbed {
            let unit = (record.id.task(), record.id.config().unwrap_or_default());
            assert!(used.contains(&unit), "{}", record.id);
        }
    }
}
