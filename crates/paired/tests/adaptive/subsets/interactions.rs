//! Interactions add up exactly and agree with their definitions.

use benchmark::{Axis, AxisSet, TaskRef};
use paired::adaptive::subsets::{CompleteLattice, Estimate, Interactions};
use paired::{Bootstrap, NoInterval};
use proptest::prelude::*;

use super::full;

const FEW: Bootstrap = Bootstrap { replicates: 50, seed: 7 };

fn lattice(task: usize, full: AxisSet, success: impl Fn(AxisSet) -> bool) -> CompleteLattice {
    let task = TaskRef::all().nth(task).expect("a task");
    CompleteLattice::new(task, full, |set| Some(success(set))).expect("all outcomes")
}

fn sum<'a>(estimates: impl IntoIterator<Item = &'a Estimate>) -> i64 {
    estimates.into_iter().map(|estimate| estimate.numerator).sum()
}

/// Configurations of 2 to 6 axes: the bits of a number are the outcomes.
fn any_configurations() -> impl Strategy<Value = (usize, Vec<CompleteLattice>)> {
    let configurations = prop::collection::vec((0..12_usize, any::<u64>()), 1..30);
    (2..=6_usize, configurations).prop_map(|(axes, configurations)| {
        let full = full(axes);
        let subsets = full.subsets();
        let configuration = |(task, bits): (usize, u64)| {
            lattice(task, full, |set| {
                let index = subsets.iter().position(|other| *other == set);
                bits >> index.expect("a subset") & 1 == 1
            })
        };
        (axes, configurations.into_iter().map(configuration).collect())
    })
}

fn factorial(n: usize) -> i64 {
    (1..=n as i64).product()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn interactions_add_up_exactly((axes, configurations) in any_configurations()) {
        let interactions = Interactions::of(&configurations, &FEW).expect("configurations");
        let full = &interactions.success[&full(axes)];
        let nominal = &interactions.success[&AxisSet::EMPTY];
        prop_assert_eq!(nominal.numerator + sum(interactions.moebius.values()), full.numerator);
        prop_assert_eq!(nominal.numerator + sum(interactions.sizes.values()), full.numerator);
        let shapley = sum(interactions.shapley.values());
        prop_assert_eq!(shapley, 60 * (full.numerator - nominal.numerator));
        let n = configurations.len() as i64;
        let mut over_n = interactions.success.values().chain(interactions.moebius.values());
        prop_assert!(over_n.all(|e| e.denominator == n));
        let mut over_60n = interactions.shapley.values().chain(interactions.pairs.values());
        prop_assert!(over_60n.all(|e| e.denominator == 60 * n));
        prop_assert_eq!(interactions.success.len(), 1 << axes);
        prop_assert_eq!(interactions.moebius.len(), (1 << axes) - 1);
        prop_assert_eq!(interactions.shapley.len(), axes);
        prop_assert_eq!(interactions.pairs.len(), axes * (axes - 1) / 2);
        // Every v(A) is v(∅) plus the sum of m over the non-empty subsets of A.
        for (set, success) in &interactions.success {
            let below = interactions.moebius.iter().filter(|(below, _)| below.is_subset(*set));
            prop_assert_eq!(nominal.numerator + sum(below.map(|(_, m)| m)), success.numerator);
        }
    }

    /// Definitions by marginal contributions, each weighted by the number of orders of the axes in
    /// which it occurs.
    #[test]
    fn shapley_values_and_pair_indices_are_averages_over_orders((axes, configurations) in any_configurations()) {
        let interactions = Interactions::of(&configurations, &FEW).expect("configurations");
        let v = |set: AxisSet| interactions.success[&set].numerator;
        for (&axis, shapley) in &interactions.shapley {
            let alone = AxisSet::of(axis);
            let subsets = full(axes).without(alone).subsets().into_iter();
            let marginal = subsets.map(|subset| {
                let orders = factorial(subset.len()) * factorial(axes - 1 - subset.len());
                orders * (v(subset.union(alone)) - v(subset))
            });
            prop_assert_eq!(60 * marginal.sum::<i64>(), shapley.numerator * factorial(axes));
        }
        for (&pair, index) in &interactions.pairs {
            let [i, j] = pair.axes().map(AxisSet::of).collect::<Vec<_>>()[..] else { panic!("a pair") };
            let subsets = full(axes).without(pair).subsets().into_iter();
            let change = subsets.map(|subset| {
                let orders = factorial(subset.len()) * factorial(axes - 2 - subset.len());
                let [v_i, v_j] = [i, j].map(|axis| v(subset.union(axis)));
                orders * (v(subset.union(pair)) - v_i - v_j + v(subset))
            });
            prop_assert_eq!(60 * change.sum::<i64>(), index.numerator * factorial(axes - 1));
        }
    }

    #[test]
    fn the_order_of_configurations_changes_nothing((_, configurations) in any_configurations()) {
        let forwards = Interactions::of(&configurations, &FEW);
        let reversed: Vec<_> = configurations.into_iter().rev().collect();
        prop_assert_eq!(forwards, Interactions::of(&reversed, &FEW));
    }
}

/// Returns one configuration per task. The pair of the first two axes fails in even tasks.
fn pair_fails_in_half(tasks: usize) -> Vec<CompleteLattice> {
    let pair = full(2);
    let configuration =
        |task| lattice(task, AxisSet::ALL, |set| task % 2 == 1 || !pair.is_subset(set));
    (0..tasks).map(configuration).collect()
}

#[test]
fn a_failing_pair_has_one_moebius_coefficient_which_its_axes_share_equally() {
    let interactions =
        Interactions::of(&pair_fails_in_half(10), &Bootstrap::default()).expect("configurations");
    for (set, m) in &interactions.moebius {
        let expected = if *set == full(2) { -0.5 } else { 0.0 };
        assert_eq!(m.value, expected, "{set}");
    }
    assert_eq!(interactions.shapley[&Axis::Camera].value, -0.25);
    assert_eq!(interactions.shapley[&Axis::Robot].value, 0.0);
    assert_eq!(interactions.pairs[&full(2)].value, -0.5);
}

#[test]
fn intervals_contain_their_values_and_need_spread_and_ten_tasks() {
    let ten =
        Interactions::of(&pair_fails_in_half(10), &Bootstrap::default()).expect("configurations");
    let m = ten.moebius[&full(2)];
    let [low, high] = m.ci95.expect("ten tasks");
    assert!(low < m.value && m.value < high, "{low} {high}");
    // The mean of ten values, −1 or 0 equally often, has the standard error √(0.25 / 10).
    assert!((high - low - 2.0 * 1.96 * 0.025_f64.sqrt()).abs() < 0.1, "{low} {high}");
    let constant = ten.shapley[&Axis::Robot];
    assert_eq!((constant.ci95, constant.no_interval), (None, Some(NoInterval::NoSpread)));
    let nine =
        Interactions::of(&pair_fails_in_half(9), &Bootstrap::default()).expect("configurations");
    let m = nine.moebius[&full(2)];
    assert_eq!((m.ci95, m.no_interval), (None, Some(NoInterval::TooFewTasks)));
}

#[test]
fn interactions_need_a_configuration_and_an_outcome_under_every_subset() {
    assert_eq!(Interactions::of(&[], &FEW), None);
    let task = TaskRef::all().next().expect("a task");
    let missing: AxisSet = "camera+robot".parse().expect("a set");
    let error = CompleteLattice::new(task, full(3), |set| (set != missing).then_some(true));
    let error = error.expect_err("a subset without an outcome").to_string();
    assert_eq!(error, "axes camera+lighting+robot: camera+robot has no outcome");
}
