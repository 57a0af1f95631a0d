//! Tests of early stops of campaigns, on published and on simulated outcomes.

use std::collections::BTreeSet;

use benchmark::{Axis, AxisSet, Condition, Level, Measure, RolloutId, Stop, Strata};
use paired::{
    CampaignLook, Outcome, Record, Records, SEQUENTIAL_ALPHA, SequentialMeasures, Unit, drawn_order,
};

fn published() -> Vec<Record> {
    crate::records(&crate::example("openvla_oft"))
}

fn stop(rule: &str, strata: Strata) -> Stop {
    Stop { rule: rule.parse().expect("a rule"), seed: 3, strata }
}

fn when_met(records: &[Record], stop: &Stop) -> Option<CampaignLook> {
    let records = Records::new(records).expect("no rollout twice");
    CampaignLook::when_met(&records, stop)
}

/// Returns the index in the drawn order of the configuration at which one level alone meets a rule.
fn met_at(records: &Records, level: Level, stop: &Stop) -> Option<usize> {
    let matched = records.configurations().iter();
    let level_configurations: Vec<_> =
        matched.filter(|configuration| configuration.level == level).collect();
    let order = drawn_order(
        stop,
        level_configurations.iter().map(|configuration| (configuration.task, configuration.config)),
    );
    let mut sequential = SequentialMeasures::new(&order, SEQUENTIAL_ALPHA);
    order.units().position(|unit| {
        let matched = level_configurations
            .iter()
            .find(|configuration| (configuration.task, configuration.config) == *unit);
        let possible = matched.and_then(|matched| matched.possible_transitions());
        sequential.complete(&possible.expect("published outcomes are known"));
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
        let last = levels.into_iter().flatten().max().expect("the rule is met");
        let look = CampaignLook::when_met(&records, &stop).expect("the rule is met");
        assert_eq!(look.used.len(), last + 1);
        assert_eq!(look.units, 400);
        assert!(look.levels.values().all(|look| look.used == last + 1));
    }
}

#[test]
fn a_look_ignores_later_outcomes_and_requires_all_earlier_ones() {
    let mut records = published();
    let stop = stop("width(S_sim) < 0.25", Strata::Suites);
    let look = when_met(&records, &stop).expect("the rule is met");
    let used: BTreeSet<Unit> = look.used.iter().copied().collect();
    for (index, record) in records.iter_mut().enumerate() {
        let unit = record.id.config().map(|config| (record.id.task(), config));
        if unit.is_none_or(|unit| !used.contains(&unit)) {
            record.outcome = match index % 3 {
                0 => Outcome::Missing,
                1 => Outcome::Quarantined,
                _ => record.outcome,
            };
        }
    }
    assert_eq!(when_met(&records, &stop), Some(look.clone()));

    // In the configuration at which the rule was met, one rollout is open at one level.
    let (task, config) = *look.used.last().expect("a configuration");
    let is_last =
        |record: &&mut Record| record.id.task() == task && record.id.config() == Some(config);
    let last_rollout = records.iter_mut().filter(is_last).last().expect("a rollout");
    last_rollout.outcome = Outcome::Missing;
    assert_eq!(when_met(&records, &stop), None);
    let records = Records::new(&records).expect("no rollout twice");
    let now = CampaignLook::now(&records, &stop).expect("configurations");
    assert_eq!(now.used, look.used[..look.used.len() - 1]);
}

#[test]
fn a_rule_first_met_at_the_last_configuration_ends_no_campaign_early() {
    let records = published();
    // The width of the interval is 0 only after all configurations.
    assert_eq!(when_met(&records, &stop("width(I) < 0.0001", Strata::Tasks)), None);
    let records = Records::new(&records).expect("no rollout twice");
    let now = CampaignLook::now(&records, &stop("I excludes 1", Strata::Tasks));
    assert!(now.is_some_and(|now| now.used.len() == now.units));
    assert_eq!(CampaignLook::now(&Records::default(), &stop("I excludes 1", Strata::Tasks)), None);
}

#[test]
fn a_configuration_counts_only_after_its_nominal_rollout_and_subsets_have_ended() {
    let published = published();
    let stop = stop("width(S_sim) < 0.25", Strata::Suites);
    let look = when_met(&published, &stop).expect("the rule is met");
    let last = *look.used.last().expect("a configuration");
    let belongs_to = |record: &Record, (task, config): Unit| {
        record.id.task() == task && record.id.config() == Some(config)
    };
    let last_record = published.iter().find(|record| belongs_to(record, last));
    let last_record = last_record.expect("a rollout");
    let pair = AxisSet::of(Axis::Camera).union(AxisSet::of(Axis::Robot));
    let further = [
        RolloutId::nominal(last.0, last_record.init_id),
        RolloutId::perturbed(last.0, Condition::Subset(pair), Level::L2, last.1).expect("a pair"),
    ];
    for id in further {
        let with_further = |outcome: Outcome| {
            let record = Record { id, outcome, ..*last_record };
            [&published[..], &[record]].concat()
        };
        for outcome in [Outcome::Success, Outcome::Quarantined] {
            assert_eq!(when_met(&with_further(outcome), &stop), Some(look.clone()), "{id}");
        }
        let met = when_met(&with_further(Outcome::Missing), &stop);
        assert_eq!(met, None, "{id}");

        let all = with_further(Outcome::Failure);
        let counted = CampaignLook::counted_when_met(&all, &stop).expect("the rule is met");
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

/// Returns suites of 100 and 30 configurations, of which 80 and 16 succeed: 73.8 %.
fn unequal_suites() -> Vec<Record> {
    let mut records = Vec::new();
    for task_index in 0..13 {
        let task = match task_index {
            0..10 => crate::simulated::task(2 * task_index, 2),
            _ => crate::simulated::task(2 * (task_index - 10) + 1, 2),
        };
        for config in 0..10 {
            let success = match task_index {
                0..10 => config < 8,
                _ => (task_index - 10) * 10 + usize::from(config) < 16,
            };
            for condition in crate::simulated::conditions() {
                let success = success || condition != Condition::Simultaneous;
                records.push(crate::simulated::record(task, condition, Level::L2, config, success));
            }
        }
    }
    records
}

#[test]
fn estimates_weight_suites_by_their_number_of_configurations() {
    let all = unequal_suites();
    let records = Records::new(&all).expect("no rollout twice");
    let (mut weighted, mut drawn, mut ends) = (0.0, 0.0, 0.0);
    for seed in 0..100 {
        let stop = Stop { seed, ..stop("width(S_sim) < 0.35", Strata::Suites) };
        let look = CampaignLook::when_met(&records, &stop).expect("the rule is met");
        weighted += look.estimates(&records, &stop)[&Level::L2][&Measure::SSim];
        let used: BTreeSet<Unit> = look.used.iter().copied().collect();
        let used_configurations = records.configurations().iter();
        let used_configurations =
            used_configurations.filter(|matched| used.contains(&(matched.task, matched.config)));
        let successes =
            used_configurations.filter(|matched| matched.simultaneous == Outcome::Success);
        drawn += successes.count() as f64 / used.len() as f64;
        ends += 1.0;
    }
    let [weighted, drawn] = [weighted, drawn].map(|sum| 100.0 * sum / ends);
    assert!((weighted - 73.8).abs() < 1.0, "{weighted}");
    assert!(
        weighted - drawn > 3.0,
        "{drawn}: the drawn configurations are in proportion, so that the test shows nothing"
    );
}
