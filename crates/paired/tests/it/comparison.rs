//! Comparison of two policies: cases that can be worked out by hand, and properties that always
//! hold.

use benchmark::{Axis, Condition, Level, RolloutId};
use paired::{
    Bootstrap, Compared, Comparison, Difference, DifferenceBounds, NoInterval, Obstacle, Outcome,
    Pair, Record,
};
use proptest::collection::vec;
use proptest::prelude::*;

use crate::{F, M, Q, S, task};

const CAMERA: Condition = Condition::Single(Axis::Camera);
const SENSOR: Condition = Condition::Single(Axis::Sensor);

fn pairs(outcomes: &[(Outcome, Outcome)]) -> Vec<Pair> {
    let rows = outcomes.iter().enumerate();
    rows.map(|(index, &(a, b))| Pair { task: task(index), number: 0, a, b }).collect()
}

fn difference(pairs: Vec<Pair>) -> Option<Difference> {
    let mut all = Difference::of_each(&[pairs], &Bootstrap::default());
    all.remove(0)
}

#[test]
fn the_difference_over_ten_rollouts_equals_that_worked_out_by_hand() {
    // Three pairs are solved only by A, one only by B, four by both, and two by neither.
    let result = difference(pairs(&[
        (S, F),
        (S, F),
        (S, F),
        (F, S),
        (S, S),
        (S, S),
        (S, S),
        (S, S),
        (F, F),
        (F, F),
    ]))
    .expect("ten");
    assert_eq!((result.n, result.tasks), (10, 10));
    assert_eq!((result.both, result.a_only, result.b_only, result.neither), (4, 3, 1, 2));
    assert!((result.s_a - 0.7).abs() < 1e-12 && (result.s_b - 0.5).abs() < 1e-12);
    assert!((result.difference - 0.2).abs() < 1e-12, "{result:?}");
    // 2 · (C(4,0) + C(4,1)) / 2⁴
    assert!((result.mcnemar_p - 0.625).abs() < 1e-12, "{result:?}");
}

#[test]
fn the_interval_of_ten_tasks_of_which_half_differ_is_that_of_ten_coin_tosses() {
    // A resampling counts the tasks that only A solves: Bin(10, ½), of which
    // P(≤ 1) = 1.1 %, P(≤ 2) = 5.5 %. So the 2.5th percentile is 2 of 10.
    let half = [(S, F), (F, F)].repeat(5);
    let result = difference(pairs(&half)).expect("ten");
    assert_eq!(result.difference_ci95, Some([0.2, 0.8]));
    assert_eq!(result.no_interval, None);
}

#[test]
fn nine_tasks_have_a_difference_and_no_interval() {
    let nine = [(S, F), (F, F), (S, S)].repeat(3);
    let result = difference(pairs(&nine)).expect("nine");
    assert!((result.difference - 1.0 / 3.0).abs() < 1e-12);
    assert_eq!(result.difference_ci95, None);
    assert_eq!(result.no_interval, Some(NoInterval::TooFewTasks));
}

#[test]
fn a_difference_that_all_tasks_share_has_no_width_and_therefore_no_interval() {
    let result = difference(pairs(&[(S, F); 10])).expect("ten");
    assert_eq!((result.difference, result.difference_ci95), (1.0, None));
    assert_eq!(result.no_interval, Some(NoInterval::NoSpread));
    assert!((result.mcnemar_p - 2.0 / 1024.0).abs() < 1e-12);
}

#[test]
fn rollouts_without_an_outcome_for_both_policies_are_in_no_rate() {
    let result = difference(pairs(&[(S, F), (S, M), (Q, F), (F, Q), (M, M)])).expect("one");
    assert_eq!((result.n, result.a_only), (1, 1));
    assert_eq!(difference(pairs(&[(S, M), (Q, F)])), None);
}

#[test]
fn quarantined_rollouts_are_bounded_by_the_worst_and_the_best_case() {
    // The difference of the second pair is 0 or +1, of the third −1 or 0, of the fourth −1 to +1.
    let pairs = pairs(&[(S, F), (S, Q), (Q, S), (Q, Q), (S, M)]);
    let bounds = DifferenceBounds::of(&pairs).expect("quarantined");
    assert_eq!((bounds.n, bounds.affected), (4, 3));
    assert_eq!(bounds.difference, [-0.25, 0.75]);
    assert_eq!(DifferenceBounds::of(&pairs[..1]), None);
}

fn record(condition: Condition, config: u16, init_id: u16, outcome: Outcome) -> Record {
    let id = match condition {
        Condition::Nominal => RolloutId::nominal(task(0), init_id),
        condition => RolloutId::perturbed(task(0), condition, Level::L2, config).expect("an id"),
    };
    Record { id, init_id, replicate: 0, outcome }
}

fn compare(a: &[Record], b: &[Record]) -> Comparison {
    Comparison::of(a, b, &Bootstrap::default(), |_| None)
}

#[test]
fn each_condition_is_compared_over_the_common_rollouts() {
    let a = [
        record(SENSOR, 0, 7, S),
        record(Condition::Simultaneous, 0, 7, S),
        record(CAMERA, 0, 7, S),
        record(CAMERA, 1, 8, S),
        record(Condition::Nominal, 0, 7, S),
    ];
    let mut b = a;
    b[0].outcome = F;
    b[1].outcome = Q;
    b[3] = record(CAMERA, 2, 9, F);
    let comparison = compare(&a, &b);
    let names: Vec<String> = comparison.cells.iter().map(|cell| cell.name()).collect();
    assert_eq!(names, ["nominal", "L2 camera", "L2 sensor", "L2 simultaneous"]);
    assert_eq!((comparison.only_in_a, comparison.only_in_b), (1, 1));
    assert_eq!((comparison.shared(), comparison.compared()), (4, 3));
    let sensor = comparison.cells[2].difference.as_ref().expect("one rollout");
    assert_eq!((sensor.difference, sensor.a_only), (1.0, 1));
    let simultaneous = &comparison.cells[3];
    assert_eq!((simultaneous.shared, simultaneous.quarantined), (1, 1));
    assert_eq!(simultaneous.difference, None);
    let bounds = simultaneous.bounds.expect("quarantined");
    assert_eq!(bounds.difference, [0.0, 1.0]);
}

#[test]
fn rollouts_with_the_same_id_and_another_setup_are_not_paired_but_listed() {
    let a = [
        record(CAMERA, 0, 7, S),
        record(CAMERA, 1, 8, S),
        record(CAMERA, 2, 9, S),
        record(Condition::Simultaneous, 0, 7, S),
    ];
    // B's first rollout has another initial state, and B's *simultaneous* also perturbs the sensor.
    let b = [record(CAMERA, 0, 9, S), a[1], a[2], record(SENSOR, 0, 7, S), a[3]];
    let obstacle = |record: &Record| {
        let is_third = record.id.config() == Some(2);
        is_third.then_some(Obstacle::Scene)
    };
    let comparison = Comparison::of(a.as_slice(), b.as_slice(), &Bootstrap::default(), obstacle);
    let unpaired: Vec<_> = comparison.unpaired.into_iter().collect();
    assert_eq!(
        unpaired,
        [
            (Obstacle::InitialState, vec![a[0].id]),
            (Obstacle::Scene, vec![a[2].id]),
            (Obstacle::Axes, vec![a[3].id]),
        ]
    );
    let compared: Vec<_> = comparison.cells.iter().map(|cell| (cell.name(), cell.shared)).collect();
    assert_eq!(compared, [("L2 camera".to_owned(), 1)]);
}

#[test]
fn simultaneous_rollouts_alone_are_paired_only_if_their_rows_are_known() {
    let a = [record(CAMERA, 0, 7, S), record(Condition::Simultaneous, 0, 7, S)];
    for has_rows in [false, true] {
        let [a, b] = [&a[..], &a[1..]].map(|of| Compared { has_rows, ..Compared::from(of) });
        let comparison = Comparison::of(a, b, &Bootstrap::default(), |_| None);
        assert_eq!(comparison.unpaired.contains_key(&Obstacle::Axes), !has_rows);
    }
}

#[test]
fn replicates_are_paired_by_number_and_pooled() {
    let mut a = vec![record(CAMERA, 0, 7, S)];
    a.push(Record { replicate: 1, outcome: F, ..a[0] });
    let mut b = a.clone();
    b[1].outcome = S;
    let comparison = compare(&a, &b);
    let [cell] = comparison.cells.as_slice() else { panic!("{comparison:?}") };
    let difference = cell.difference.as_ref().expect("two outcomes");
    assert_eq!((difference.n, difference.difference), (2, -0.5));
    assert_eq!(cell.by_replicate, [(0, 0.0), (1, -1.0)].into());
}

fn outcomes() -> impl Strategy<Value = Vec<Pair>> {
    let outcome_of = |code: u8| [S, F, Q, M][usize::from(code)];
    vec((0..14_usize, 0..4_u8, 0..4_u8), 1..80).prop_map(move |drawn| {
        let pairs = drawn.into_iter();
        pairs
            .map(|(index, a, b)| Pair {
                task: task(index),
                number: 0,
                a: outcome_of(a),
                b: outcome_of(b),
            })
            .collect()
    })
}

fn exchanged(pairs: &[Pair]) -> Vec<Pair> {
    let exchange = |pair: &Pair| Pair { a: pair.b, b: pair.a, ..*pair };
    pairs.iter().map(exchange).collect()
}

proptest! {
    #![proptest_config(ProptestConfig {
        failure_persistence: None,
        ..ProptestConfig::default()
    })]

    #[test]
    fn exchanging_the_policies_negates_the_difference(pairs in outcomes()) {
        let bootstrap = Bootstrap { replicates: 100, seed: 3 };
        let differences = Difference::of_each(&[pairs.clone(), exchanged(&pairs)], &bootstrap);
        let [Some(original), Some(reversed)] = differences.as_slice() else {
            prop_assert_eq!(differences, [None, None]);
            return Ok(());
        };
        prop_assert!((original.difference + reversed.difference).abs() < 1e-12);
        prop_assert_eq!((original.a_only, original.b_only), (reversed.b_only, reversed.a_only));
        prop_assert_eq!((original.both, original.neither), (reversed.both, reversed.neither));
        prop_assert!((original.mcnemar_p - reversed.mcnemar_p).abs() < 1e-12);
        prop_assert_eq!(original.no_interval, reversed.no_interval);
        let intervals = (original.difference_ci95, reversed.difference_ci95);
        if let (Some([low, high]), Some(reversed)) = intervals {
            prop_assert!((low + reversed[1]).abs() < 1e-12 && (high + reversed[0]).abs() < 1e-12);
        }
    }

    #[test]
    fn a_set_has_the_same_difference_alone_and_among_others(
        pairs in outcomes(),
        other_pairs in outcomes(),
    ) {
        let bootstrap = Bootstrap { replicates: 60, seed: 1 };
        let alone = Difference::of_each(std::slice::from_ref(&pairs), &bootstrap);
        let among = Difference::of_each(&[other_pairs, pairs], &bootstrap);
        // Corrections for multiple rows depend on the other rows.
        let without_corrections = |difference: &Option<Difference>| {
            difference.clone().map(|difference| Difference {
                holm_p: difference.sign_flip_p,
                simultaneous_ci95: None,
                ..difference
            })
        };
        prop_assert_eq!(without_corrections(&alone[0]), without_corrections(&among[1]));
    }

    #[test]
    fn bounds_are_sharp_and_contain_every_possible_difference(
        pairs in outcomes(), choices in any::<u64>(),
    ) {
        let Some(bounds) = DifferenceBounds::of(&pairs) else {
            let is_quarantined = |pair: &Pair| {
                let has = |outcome| pair.a == outcome || pair.b == outcome;
                has(Q) && !has(M)
            };
            prop_assert!(!pairs.iter().any(is_quarantined));
            return Ok(());
        };
        let settle = |outcomes: [&mut dyn FnMut() -> bool; 2]| {
            let [outcomes_a, outcomes_b] = outcomes;
            let mut settled = pairs.clone();
            for pair in &mut settled {
                let sources = [(&mut pair.a, &mut *outcomes_a), (&mut pair.b, &mut *outcomes_b)];
                for (outcome, next) in sources {
                    if *outcome == Q {
                        *outcome = Outcome::from(next());
                    }
                }
            }
            let bootstrap = Bootstrap { replicates: 1, seed: 1 };
            Difference::of_each(&[settled], &bootstrap).remove(0)
        };
        let (mut bit_a, mut bit_b) = (0, 32);
        let drawn = settle([
            &mut || { bit_a += 1; choices >> (bit_a % 32) & 1 == 1 },
            &mut || { bit_b += 1; choices >> (bit_b % 64) & 1 == 1 },
        ]);
        let low = settle([&mut || false, &mut || true]).expect("some pair");
        let high = settle([&mut || true, &mut || false]).expect("some pair");
        let drawn = drawn.expect("some pair");
        prop_assert_eq!(bounds.n, low.n);
        prop_assert!((bounds.difference[0] - low.difference).abs() < 1e-12);
        prop_assert!((bounds.difference[1] - high.difference).abs() < 1e-12);
        prop_assert!(low.difference <= drawn.difference && drawn.difference <= high.difference);
    }
}
