//! Properties of reports, including those of incomplete campaigns.

use std::collections::BTreeMap;

use benchmark::{Axis, Condition, Level, RolloutId, TaskRef};
use paired::{
    Bootstrap, Configuration, Count, DuplicateRecord, FindingKind, Flips, GateVerdict, Measures,
    NominalSource, Options, Outcome, Record, report, task_correlation,
};
use proptest::collection::vec;
use proptest::prelude::*;

use crate::{F, M, Q, S, task};

const AXES: [Axis; 3] = [Axis::Camera, Axis::Robot, Axis::Sensor];

fn quick() -> Bootstrap {
    Bootstrap { replicates: 60, seed: 1 }
}

/// Draws configurations over the first sixteen tasks, so that many cases have intervals and some
/// have too few tasks.
fn configurations() -> impl Strategy<Value = Vec<Configuration>> {
    vec((0..16_usize, any::<[bool; 4]>()), 1..80).prop_map(|drawn| {
        let configuration =
            |(index, [camera, robot, sensor, simultaneous]): (usize, [bool; 4])| Configuration {
                task: task(index),
                alone: BTreeMap::from_iter(AXES.into_iter().zip([camera, robot, sensor])),
                simultaneous,
            };
        drawn.into_iter().map(configuration).collect()
    })
}

proptest! {
    // A failing case prints its input and is not written to a file.
    #![proptest_config(ProptestConfig {
        failure_persistence: None,
        ..ProptestConfig::default()
    })]

    #[test]
    fn identities_of_the_measures_hold(configurations in configurations()) {
        let m = Measures::of(&configurations, &quick()).expect("not empty");
        let n = m.n as f64;
        prop_assert!((m.i - (m.r_c - m.r_e)).abs() < 1e-12);
        prop_assert!((m.d + m.i - (m.s_sim - m.s_indep)).abs() < 1e-12);
        prop_assert!((m.r_d - (m.b + m.c) as f64 / n).abs() < 1e-12);
        let lowest = m.s_axis.values().copied().fold(1.0, f64::min);
        prop_assert!(m.s_conj <= lowest + 1e-12, "a conjunction is at most its lowest rate");
        prop_assert!((0.0..=1.0).contains(&m.mcnemar_p));
        if let Some(share) = m.emergent_share {
            prop_assert!((0.0..=1.0).contains(&share));
        }
    }

    #[test]
    fn the_order_of_configurations_does_not_matter(
        mut configurations in configurations(),
        shift in 0..80_usize,
    ) {
        let before = Measures::of(&configurations, &quick());
        let shift = shift % configurations.len();
        configurations.rotate_left(shift);
        configurations.reverse();
        prop_assert_eq!(Measures::of(&configurations, &quick()), before);
    }

    #[test]
    fn renaming_the_tasks_changes_no_estimate(configurations in configurations()) {
        let renamed: Vec<Configuration> = configurations
            .iter()
            .map(|configuration| Configuration {
                // Sixteen other tasks, in reverse order.
                task: task(37 - TaskRef::all().position(|t| t == configuration.task).expect("one")),
                ..configuration.clone()
            })
            .collect();
        let before = Measures::of(&configurations, &quick()).expect("not empty");
        let after = Measures::of(&renamed, &quick()).expect("not empty");
        prop_assert_eq!((before.n, before.tasks, before.b, before.c),
            (after.n, after.tasks, after.b, after.c));
        prop_assert_eq!((before.s_indep, before.d, before.i), (after.s_indep, after.d, after.i));
        prop_assert_eq!(task_correlation(&configurations).is_some(),
            task_correlation(&renamed).is_some());
    }

    #[test]
    fn bounds_contain_every_possible_value(
        drawn in vec((0..4_usize, [0..3_u8, 0..3, 0..3]), 1..6),
        choices in any::<u32>(),
    ) {
        let outcome_of = |code: u8| [F, S, Q][usize::from(code)];
        let records = |outcome_of: &mut dyn FnMut(u8) -> Outcome| -> Vec<Record> {
            let rows = drawn.iter().enumerate();
            rows.flat_map(|(config, (task, codes))| {
                let conditions = [
                    Condition::Single(Axis::Camera),
                    Condition::Single(Axis::Robot),
                    Condition::Simultaneous,
                ];
                let outcomes = codes.map(&mut *outcome_of);
                let record = |(c, o)| perturbed(*task, c, config as u16, o);
                conditions.into_iter().zip(outcomes).map(record).collect::<Vec<_>>()
            })
            .collect()
        };
        let options = Options { bootstrap: quick(), ..Options::default() };
        let quarantined = records(&mut |code| outcome_of(code));
        let quarantined = report(&quarantined, &options).expect("no duplicates");
        let mut next = 0;
        // The quarantined rollouts get arbitrary outcomes, then all failures, then all successes.
        let mut choosers: Vec<Box<dyn FnMut() -> bool>> = vec![
            Box::new(move || { next += 1; choices >> (next % 32) & 1 == 1 }),
            Box::new(|| false),
            Box::new(|| true),
        ];
        for choose in &mut choosers {
            let mut settle = |code| match outcome_of(code) {
                Q => Outcome::from(choose()),
                outcome => outcome,
            };
            let settled = report(&records(&mut settle), &options).expect("no duplicates");
            let m = settled.cells[0].paired.as_ref().expect("complete");
            let Some(bounds) = &quarantined.cells[0].bounds else {
                prop_assert!(quarantined.quarantined.is_empty());
                break;
            };
            prop_assert_eq!(bounds.n, m.n);
            let values = [m.s_indep, m.s_conj, m.s_sim, m.d, m.i, m.r_e, m.r_c, m.r_d];
            let b = bounds;
            let ranges = [b.s_indep, b.s_conj, b.s_sim, b.d, b.i, b.r_e, b.r_c, b.r_d];
            for (value, [low, high]) in values.into_iter().zip(ranges) {
                prop_assert!(low - 1e-12 <= value && value <= high + 1e-12, "{value} {low} {high}");
            }
        }
    }

    #[test]
    fn exchanging_two_axes_exchanges_only_their_rates(configurations in configurations()) {
        let exchanged: Vec<Configuration> = configurations
            .iter()
            .map(|configuration| {
                let mut exchanged = configuration.clone();
                exchanged.alone.insert(Axis::Camera, configuration.alone[&Axis::Robot]);
                exchanged.alone.insert(Axis::Robot, configuration.alone[&Axis::Camera]);
                exchanged
            })
            .collect();
        let before = Measures::of(&configurations, &quick()).expect("not empty");
        let after = Measures::of(&exchanged, &quick()).expect("not empty");
        prop_assert_eq!(before.s_axis[&Axis::Camera], after.s_axis[&Axis::Robot]);
        prop_assert_eq!((before.b, before.c, before.i_ci95), (after.b, after.c, after.i_ci95));
        prop_assert!((before.s_indep - after.s_indep).abs() < 1e-12);
    }

    #[test]
    fn duplicated_configurations_have_the_same_rates(configurations in configurations()) {
        let once = Measures::of(&configurations, &quick()).expect("not empty");
        let twice = [configurations.as_slice(), &configurations].concat();
        let twice = Measures::of(&twice, &quick()).expect("not empty");
        prop_assert_eq!(once.i_ci95, twice.i_ci95, "tasks are drawn, not configurations");
        prop_assert_eq!(once.s_indep, twice.s_indep);
        prop_assert_eq!(twice.b, 2 * once.b);
    }
}

fn perturbed(task_index: usize, condition: Condition, config: u16, outcome: Outcome) -> Record {
    let task = task(task_index);
    Record {
        id: RolloutId::perturbed(task, condition, Level::L2, config).expect("an id"),
        init_id: task.eval_init_ids()[usize::from(config)],
        replicate: 0,
        outcome,
    }
}

fn nominal(task_index: usize, config: u16, outcome: Outcome) -> Record {
    let task = task(task_index);
    let init_id = task.eval_init_ids()[usize::from(config)];
    Record { id: RolloutId::nominal(task, init_id), init_id, replicate: 0, outcome }
}

/// Returns a campaign of two axes over three tasks with one configuration each. `outcomes` are
/// nominal, camera, sensor and simultaneous.
fn campaign(outcomes: [[Outcome; 4]; 3]) -> Vec<Record> {
    campaign_of_tasks(&outcomes, 1)
}

/// Returns such a campaign with `configs` configurations of each task.
fn campaign_of_tasks(outcomes: &[[Outcome; 4]], configs: usize) -> Vec<Record> {
    let rows = outcomes.iter().enumerate();
    rows.flat_map(|(index, &[clean, camera, sensor, simultaneous])| {
        let (task, config) = (index / configs, (index % configs) as u16);
        [
            nominal(task, config, clean),
            perturbed(task, Condition::Single(Axis::Camera), config, camera),
            perturbed(task, Condition::Single(Axis::Sensor), config, sensor),
            perturbed(task, Condition::Simultaneous, config, simultaneous),
        ]
    })
    .collect()
}

#[test]
fn measures_of_a_campaign_are_over_the_axes_that_it_perturbs() {
    let records = campaign([[S, S, S, F], [S, F, S, S], [F, S, S, S]]);
    let report = report(&records, &Options::default()).expect("no duplicates");
    assert_eq!(report.axes, [Axis::Camera, Axis::Sensor]);
    let cell = &report.cells[0];
    let measures = cell.paired.as_ref().expect("complete");
    assert_eq!((measures.n, measures.b, measures.c), (3, 1, 1));
    assert_eq!(measures.emergent_share, Some(1.0));
    let solvable = cell.solvable.as_ref().expect("two are solvable");
    assert_eq!((solvable.n, solvable.b, solvable.c), (2, 1, 1));
    let nominal = report.nominal.as_ref().expect("nominal rollouts");
    assert_eq!((nominal.count.successes, nominal.count.n), (2, 3));
    let loss = cell.alone[&Axis::Camera].nominal_relative_loss;
    assert!(loss.expect("known").abs() < 1e-12, "2/3 against 2/3 nominal is no loss");
}

#[test]
fn a_bound_of_chance_is_stated_only_if_nearly_identical_rollouts_end_differently() {
    let sentences = |language: Outcome| {
        let rows = (0..3).flat_map(|task| {
            [
                nominal(task, 0, S),
                perturbed(
                    task,
                    Condition::Single(Axis::Language),
                    0,
                    if task > 0 { language } else { S },
                ),
                perturbed(task, Condition::Single(Axis::Sensor), 0, S),
                perturbed(task, Condition::Simultaneous, 0, F),
            ]
        });
        let report = report(&rows.collect::<Vec<_>>(), &Options::default());
        let findings = report.expect("no duplicates").findings.into_iter();
        let sentences: Vec<String> = findings.map(|finding| finding.sentence).collect();
        sentences.join(" ")
    };
    for (language, is_bounded) in [(S, false), (F, true)] {
        let text = sentences(language);
        assert!(text.contains("unknown without a placebo"), "{text}");
        assert_eq!(text.contains("chance that changes so many"), is_bounded, "{text}");
    }
}

#[test]
fn an_incomplete_placebo_is_not_taken_for_an_absent_one() {
    let mut records = campaign([[S, S, S, F], [S, F, S, S], [F, S, S, S]]);
    let camera = Condition::Single(Axis::Camera);
    let placebo = Record {
        id: RolloutId::perturbed(task(0), camera, Level::L0, 0).expect("an id"),
        ..records[1]
    };
    records.push(placebo);
    let report = report(&records, &Options::default()).expect("no duplicates");
    let mut findings = report.findings.iter();
    let simultaneity = findings.find(|finding| finding.kind == FindingKind::Simultaneity);
    let sentence = &simultaneity.expect("a sentence").sentence;
    assert!(
        sentence.contains("the placebo level L0 has no complete configuration of these axes"),
        "{sentence}"
    );
    assert!(!sentence.contains("--levels"), "{sentence}");
}

#[test]
fn a_small_certain_loss_is_claimed_beside_a_greater_uncertain_one() {
    // The camera costs one of five rollouts in each of ten tasks, the robot all of two tasks.
    let rows = (0..10).flat_map(|task| {
        (0..5).flat_map(move |config| {
            let camera = if config == 0 { F } else { S };
            let robot = if task < 2 { F } else { S };
            // The eleventh failure makes the robot's loss the greater one.
            let robot = if (task, config) == (2, 0) { F } else { robot };
            [
                nominal(task, config, S),
                perturbed(task, Condition::Single(Axis::Camera), config, camera),
                perturbed(task, Condition::Single(Axis::Robot), config, robot),
                perturbed(task, Condition::Simultaneous, config, S),
            ]
        })
    });
    let report = report(&rows.collect::<Vec<_>>(), &Options::default()).expect("no duplicates");
    let mut findings = report.findings.iter();
    let cost = findings.find(|finding| finding.kind == FindingKind::Cost);
    let cost = cost.expect("nominal rollouts");
    let expected = "Success is shown to be lost at L2 under camera alone, but not under robot, \
                    where the loss is greatest: 22.0 points";
    assert!(cost.sentence.starts_with(expected), "{}", cost.sentence);
    let camera = Condition::Single(Axis::Camera);
    let losses = &report.cells[0].inference.as_ref().expect("ten tasks").losses;
    assert!(cost.claims && cost.holm_p == Some(losses[&camera].holm_p));
}

#[test]
fn an_incomplete_cell_counts_complete_configurations_and_lists_gaps() {
    let records = campaign([[S, S, S, F], [S, M, S, S], [M, S, Q, S]]);
    let report = report(&records, &Options::default()).expect("no duplicates");
    let cell = &report.cells[0];
    assert_eq!((cell.completeness.complete, cell.completeness.expected), (1, 3));
    assert_eq!(cell.paired.as_ref().expect("one is complete").b, 1);
    assert_eq!(cell.paired.as_ref().expect("one is complete").i_ci95, None);
    let sensor = &cell.alone[&Axis::Sensor].count;
    assert_eq!((sensor.successes, sensor.n), (2, 2), "a quarantined rollout is in no rate");
    assert_eq!(report.quarantined, ["spatial/t2/sensor/L2/c00"]);
}

#[test]
fn quarantined_rollouts_are_bounded_by_the_worst_and_the_best_case() {
    // Each of the two quarantined configurations may or may not be an emergent failure.
    let records = campaign([[S, S, S, F], [S, S, Q, F], [S, S, S, Q]]);
    let report = report(&records, &Options::default()).expect("no duplicates");
    let cell = &report.cells[0];
    assert_eq!(cell.paired.as_ref().expect("one is complete").n, 1);
    let bounds = cell.bounds.as_ref().expect("two are quarantined");
    assert_eq!((bounds.n, bounds.affected), (3, 2));
    assert_eq!(bounds.r_e, [1.0 / 3.0, 1.0]);
    assert_eq!(bounds.r_c, [0.0, 0.0]);
    assert_eq!(bounds.i, [-1.0, -1.0 / 3.0]);
    assert_eq!(bounds.s_axis[&Axis::Sensor], [2.0 / 3.0, 1.0]);
}

#[test]
fn reported_nominal_counts_are_used_if_no_nominal_rollout_is_recorded() {
    let mut records = campaign([[S, S, S, F], [S, F, S, S], [F, S, S, S]]);
    let options = Options {
        published_nominal: Some(0.971),
        reported_nominal: Some(Count { successes: 1934, n: 2000 }),
        ..Options::default()
    };
    let recorded = report(&records, &options).expect("no duplicates");
    assert_eq!(
        recorded.nominal.as_ref().expect("nominal rollouts").count,
        Count { successes: 2, n: 3 }
    );
    assert_eq!(recorded.gate.expect("a published figure").verdict, GateVerdict::Undecided);

    records.retain(|record| record.id.condition() != Condition::Nominal);
    let reported = report(&records, &options).expect("no duplicates");
    assert_eq!(reported.nominal.as_ref().expect("a count").source, NominalSource::Reported);
    assert_eq!(reported.gate.expect("a published figure").verdict, GateVerdict::Passed);
}

#[test]
fn one_axis_alone_has_rates_and_no_paired_measures() {
    let records = [nominal(0, 0, S), perturbed(0, Condition::Single(Axis::Camera), 0, F)];
    let report = report(&records, &Options::default()).expect("no duplicates");
    let cell = &report.cells[0];
    assert_eq!(cell.simultaneous, None);
    assert_eq!(cell.paired, None);
    assert_eq!(cell.alone[&Axis::Camera].nominal_relative_loss, Some(1.0));
}

/// Three seeds whose simultaneous rollouts succeed 14, 7 and 8 times in 20: the rate is that of all
/// 60, and the interval is no narrower for counting a task's seeds as one.
#[test]
fn every_rate_pools_the_replicates() {
    let campaign_of = |replicate: u32, successes: usize| {
        let rows = (0..20).map(|index| [S, S, S, if index < successes { S } else { F }]);
        let records = campaign_of_tasks(&rows.collect::<Vec<_>>(), 4);
        records.into_iter().map(move |record| Record { replicate, ..record })
    };
    let records: Vec<Record> =
        [14, 7, 8].into_iter().zip(0..).flat_map(|(n, k)| campaign_of(k, n)).collect();
    let report = report(&records, &Options::default()).expect("no duplicates");
    let [cell] = report.cells.as_slice() else { panic!("one cell per level: {report:?}") };
    assert_eq!(cell.simultaneous, Some(Count { successes: 29, n: 60 }));
    let by_seed: Vec<u64> = cell.by_replicate.values().map(|count| count.successes).collect();
    assert_eq!(by_seed, [14, 7, 8]);
    // The same outcomes in every replicate tell nothing more than once.
    let once: Vec<Record> = campaign_of(0, 7).collect();
    let twice: Vec<Record> = (0..2).flat_map(|k| campaign_of(k, 7)).collect();
    let [once, twice] = [once, twice].map(|records| {
        let report = paired::report(&records, &Options::default()).expect("no duplicates");
        report.cells[0].inference.clone().expect("complete configurations")
    });
    assert_eq!(once.paired, twice.paired);
    assert_eq!(
        once.losses[&Condition::Simultaneous].loss,
        twice.losses[&Condition::Simultaneous].loss
    );
    assert_eq!(once.directions, twice.directions);
}

/// Neither a policy that solves nothing nor three tasks say anything about axes.
#[test]
fn no_finding_compares_nothing_with_nothing_or_generalises_from_few_tasks() {
    for (outcomes, tasks) in [([F, F, F, F], 6), ([S, F, F, F], 3)] {
        let records = campaign_of_tasks(&vec![outcomes; 2 * tasks], 2);
        let report = report(&records, &Options::default()).expect("no duplicates");
        assert!(report.findings.is_empty(), "{:?}", report.findings);
    }
}

#[test]
fn rollouts_that_another_seed_changes_are_counted_by_condition() {
    let records = campaign([[S, S, S, F], [S, F, S, S], [F, S, S, S]]);
    let mut later: Vec<Record> =
        records.iter().map(|record| Record { replicate: 1, ..*record }).collect();
    later[3].outcome = S;
    later[4].outcome = M;
    let records = [records, later].concat();
    let report = report(&records, &Options::default()).expect("no duplicates");
    assert_eq!(report.flips[&Condition::Simultaneous], Flips { compared: 3, flipped: 1 });
    let compared: u64 = report.flips.values().map(|flips| flips.compared).sum();
    assert_eq!(compared, 11);
}

#[test]
fn a_rollout_recorded_twice_is_refused() {
    let record = nominal(0, 0, S);
    assert_eq!(
        report(&[record, record], &Options::default()),
        Err(DuplicateRecord { id: record.id, replicate: 0 })
    );
}

/// Latency is not one of the six axes: it has its own rate and changes no other figure.
#[test]
fn latency_has_a_success_rate_and_is_in_no_paired_measure() {
    let record = |condition: Condition, index: usize, outcome| Record {
        id: RolloutId::perturbed(task(index), condition, Level::L2, 0).expect("an id"),
        init_id: 0,
        replicate: 0,
        outcome,
    };
    let mut records = Vec::new();
    for index in 0..4 {
        for axis in [Axis::Camera, Axis::Robot] {
            records.push(record(Condition::Single(axis), index, Outcome::Success));
        }
        records.push(record(Condition::Simultaneous, index, Outcome::from(index > 0)));
    }
    let options = Options::default();
    let without = report(&records, &options).expect("no duplicates");
    let latency_outcome = |index: usize| match index {
        3 => Outcome::Missing,
        _ => Outcome::Failure,
    };
    let latency = Condition::Single(Axis::Latency);
    records.extend((0..4).map(|index| record(latency, index, latency_outcome(index))));
    let with = report(&records, &options).expect("no duplicates");
    assert_eq!((&with.axes, with.cells.len()), (&without.axes, 1));
    let (mut cell, before) = (with.cells[0].clone(), &without.cells[0]);
    let count = cell.alone.remove(&Axis::Latency).expect("a rate").count;
    assert_eq!(count, Count { successes: 0, n: 3 });
    assert_eq!(cell.completeness.gaps.remove(&latency).expect("a gap").missing, 1);
    assert_eq!(cell, *before);
}
