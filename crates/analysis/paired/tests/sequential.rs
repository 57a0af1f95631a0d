//! Confidence sequences hold at all looks: for every order of small populations, exactly, and for
//! random orders of published outcomes.

use std::collections::BTreeMap;

use libero_ctrl::{Axis, Level, Measure, StopRule, TaskRef};
use paired::{
    Bootstrap, Configuration, Matched, Measures, Order, Outcome, RateInterval,
    SequentialDifference, SequentialMeasures, Transition,
};
use proptest::prelude::*;

mod replay;

use replay::{ALPHA, Design, Population, Unit, value};

/// Number of orders per level.
const ORDERS: u64 = 100;
/// Number of orders per level for the designs with shorter rounds, which take longer.
const FEW_ORDERS: u64 = 10;

/// Returns the number of orders, over all levels, for which `holds` returns false.
fn misses(orders: u64, design: Design, holds: impl Fn(&Population, &Order<Unit>) -> bool) -> usize {
    let populations = Level::PERTURBED.map(Population::published);
    let misses_of = |population: &Population| {
        let orders = (0..orders).map(|seed| population.order(seed, design));
        orders.filter(|order| !holds(population, order)).count()
    };
    populations.iter().map(misses_of).sum()
}

/// Returns the number of misses over all levels that is exceeded with a probability below
/// 10⁻⁷ if each order misses with a probability of [`ALPHA`], by the binomial
/// distribution.
fn most_misses(orders: u64) -> usize {
    let n = 3 * orders as usize;
    let mut probability = (1.0 - ALPHA).powi(n as i32);
    let mut beyond = 1.0 - probability;
    let mut k = 0;
    while beyond > 1e-7 {
        probability *= (n - k) as f64 / (k + 1) as f64 * ALPHA / (1.0 - ALPHA);
        beyond -= probability;
        k += 1;
    }
    k
}

#[test]
fn all_intervals_hold_at_all_looks_at_published_outcomes() {
    for (design, orders) in
        [(Design::Tasks, ORDERS), (Design::Suites, FEW_ORDERS), (Design::Simple, FEW_ORDERS)]
    {
        let missed = misses(orders, design, |population, order| population.replay(order, &[]).0);
        assert!(missed <= most_misses(orders), "{design:?}: {missed}");
    }
}

/// Returns true if the normal interval of a fixed sample size, with the correction
/// for finite populations, holds after every round from the second on.
fn fixed_size_interval_holds(
    population: &Population,
    order: &Order<Unit>,
    measure: Measure,
) -> bool {
    let units = population.units.len() as f64;
    let truth = population.total(measure) as f64 / units;
    let (mut n, mut sum, mut squares) = (0.0_f64, 0.0, 0.0);
    order.rounds().iter().enumerate().all(|(i, round)| {
        for drawn in round {
            let x = value(measure, population.transition(&drawn.unit)) as f64;
            n += 1.0;
            sum += x;
            squares += x * x;
        }
        let mean = sum / n;
        let variance = (squares / n - mean * mean) * (1.0 - n / units) / n;
        i == 0 || (mean - truth).abs() <= 1.96 * variance.max(0.0).sqrt() + 1e-9
    })
}

#[test]
fn intervals_for_a_fixed_sample_size_do_not_hold_at_all_looks() {
    let missed = misses(ORDERS, Design::Tasks, |population, order| {
        let mut measures = Measure::OF_ONE_POLICY.into_iter();
        measures.all(|measure| fixed_size_interval_holds(population, order, measure))
    });
    assert!(missed > most_misses(ORDERS), "{missed}");
}

#[test]
fn after_all_configurations_an_interval_is_the_exact_measure() {
    for level in Level::PERTURBED {
        let population = Population::published(level);
        let order = population.order(1, Design::Tasks);
        let mut sequential = SequentialMeasures::new(&order, ALPHA);
        let mut configurations = Vec::new();
        for (unit, transition) in &population.units {
            let result = sequential.complete(unit, &[*transition]);
            result.expect("a configuration of the order");
            configurations.push(configuration(unit.0, *transition));
        }
        let look = sequential.look();
        let measures = Measures::of(&configurations, &Bootstrap::default()).expect("not empty");
        let expected = [measures.s_sim, measures.r_e, measures.r_c, measures.r_d, measures.i];
        assert_eq!((look.used, look.waiting, look.units), (400, 0, 400));
        for (measure, expected) in Measure::OF_ONE_POLICY.iter().zip(expected) {
            let interval = look.intervals[measure];
            assert_eq!(interval.width(), 0.0, "{measure}");
            assert!((interval.low() - expected).abs() < 1e-12, "{measure}");
        }
    }
}

fn configuration(task: TaskRef, transition: Transition) -> Configuration {
    use Transition::{Compensated, Emergent, StillSucceeds};
    Configuration {
        task,
        alone: [(Axis::Camera, matches!(transition, StillSucceeds | Emergent))].into(),
        simultaneous: matches!(transition, StillSucceeds | Compensated),
    }
}

/// A unit of a small population: its stratum and number.
type SmallUnit = (usize, usize);

/// Draws an order of strata with three units each.
fn small_order(strata: usize) -> Order<SmallUnit> {
    let units = (0..strata).flat_map(|stratum| (0..3).map(move |number| (stratum, number)));
    Order::new(1, units, |&(stratum, _)| stratum)
}

const PERMUTATIONS: [[usize; 3]; 6] =
    [[0, 1, 2], [0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]];

/// Returns every multiset of three transitions, each as a sorted triple.
fn triples() -> Vec<[Transition; 3]> {
    let all = || Transition::ALL.into_iter();
    let pairs = || all().flat_map(|a| all().map(move |b| (a, b)));
    let triples = pairs().flat_map(|(a, b)| all().map(move |c| [a, b, c]));
    triples.filter(|triple| triple.is_sorted()).collect()
}

/// Returns true if all intervals hold at all looks, where `strata` are the transitions of the units
/// of each stratum.
fn all_hold(order: &Order<SmallUnit>, strata: &[[Transition; 3]], alpha: f64) -> bool {
    let mut sequential = SequentialMeasures::new(order, alpha);
    order.units().all(|unit| {
        let result = sequential.complete(unit, &[strata[unit.0][unit.1]]);
        result.expect("a unit of the order");
        let look = sequential.look();
        look.intervals.iter().all(|(&measure, interval)| {
            let total = strata.iter().flatten().map(|&transition| value(measure, transition)).sum();
            (interval.least..=interval.greatest).contains(&total)
        })
    })
}

/// Returns the share of all orders of both strata's units in which some interval excludes the true
/// total.
fn share_missed(order: &Order<SmallUnit>, strata: [[Transition; 3]; 2], alpha: f64) -> f64 {
    let orders = PERMUTATIONS.iter();
    let orders = orders.flat_map(|first| PERMUTATIONS.iter().map(move |second| [first, second]));
    let missed = orders.filter(|permutations| {
        let permuted = [0, 1].map(|k| permutations[k].map(|i| strata[k][i]));
        !all_hold(order, &permuted, alpha)
    });
    missed.count() as f64 / 36.0
}

#[test]
fn the_five_intervals_hold_together_over_all_orders_of_all_small_populations() {
    let order = small_order(2);
    for alpha in [0.3, 0.6, 0.95] {
        let mut worst: f64 = 0.0;
        for first in triples() {
            for second in triples() {
                worst = worst.max(share_missed(&order, [first, second], alpha));
            }
        }
        assert!(worst <= alpha, "missed {worst} at {alpha}");
    }
}

/// Returns all units of an order in the sequence in which they complete: by random keys.
fn by_completion(order: &Order<Unit>, keys: &[u64]) -> Vec<Unit> {
    let mut units: Vec<Unit> = order.units().copied().collect();
    let key: BTreeMap<Unit, u64> = units.iter().copied().zip(keys.iter().copied()).collect();
    units.sort_by_key(|unit| key[unit]);
    units
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(8))]

    #[test]
    fn intervals_use_the_drawn_order_up_to_its_first_incomplete_unit(
        seed: u64, keys in proptest::collection::vec(any::<u64>(), 400),
    ) {
        let population = Population::published(Level::L2);
        let order = population.order(seed, Design::Tasks);
        let mut in_order = SequentialMeasures::new(&order, ALPHA);
        let mut looks = vec![in_order.look().intervals];
        for unit in order.units() {
            in_order.complete(unit, &[population.transition(unit)]).expect("in the order");
            looks.push(in_order.look().intervals);
        }
        let mut sequential = SequentialMeasures::new(&order, ALPHA);
        let mut completed = std::collections::BTreeSet::new();
        for unit in by_completion(&order, &keys) {
            sequential.complete(&unit, &[population.transition(&unit)]).expect("in the order");
            completed.insert(unit);
            let look = sequential.look();
            let without_gap = order.units().take_while(|unit| completed.contains(unit)).count();
            prop_assert_eq!(look.used, without_gap);
            prop_assert_eq!(look.waiting, completed.len() - without_gap);
            prop_assert_eq!(&look.intervals, &looks[without_gap]);
        }
    }

    #[test]
    fn intervals_never_widen(seed: u64) {
        let population = Population::published(Level::L3);
        let order = population.order(seed, Design::Tasks);
        let mut sequential = SequentialMeasures::new(&order, ALPHA);
        let mut before = sequential.look().intervals;
        for unit in order.units() {
            sequential.complete(unit, &[population.transition(unit)]).expect("in the order");
            let now = sequential.look().intervals;
            for (measure, now) in &now {
                let before = before[measure];
                prop_assert!(before.least <= now.least && now.least <= now.greatest);
                prop_assert!(now.greatest <= before.greatest);
            }
            before = now;
        }
    }

    #[test]
    fn exchanging_the_policies_negates_the_difference(
        outcomes in proptest::collection::vec(0..16_u8, 30), strata in 1_usize..6,
    ) {
        let order = Order::new(3, 0..30_usize, |unit| unit % strata);
        let mut ab = SequentialDifference::new(&order, ALPHA);
        let mut ba = SequentialDifference::new(&order, ALPHA);
        for (unit, outcome) in outcomes.iter().enumerate() {
            let [a, b] = [outcome % 4, outcome / 4].map(|code| match code {
                0 => Outcome::Failure,
                1 => Outcome::Quarantined,
                _ => Outcome::Success,
            });
            ab.complete(&unit, a, b).expect("in the order");
            ba.complete(&unit, b, a).expect("in the order");
            let interval = |sequence: &SequentialDifference<usize>| {
                sequence.look().intervals[&Measure::Difference]
            };
            let [ab, ba] = [interval(&ab), interval(&ba)];
            prop_assert_eq!([ab.least, ab.greatest], [-ba.greatest, -ba.least]);
        }
    }
}

#[test]
fn the_five_measures_share_alpha_equally() {
    let population = Population::published(Level::L1);
    let order = population.order(2, Design::Tasks);
    let mut measures = SequentialMeasures::new(&order, 0.5);
    // A difference of +1 where simultaneity compensates, −1 where failures emerge.
    let mut net_change = SequentialDifference::new(&order, 0.5 / 5.0);
    for unit in order.units() {
        let transition = population.transition(unit);
        measures.complete(unit, &[transition]).expect("in the order");
        let a = Outcome::from(transition == Transition::Compensated);
        let b = Outcome::from(transition == Transition::Emergent);
        net_change.complete(unit, a, b).expect("in the order");
        assert_eq!(
            measures.look().intervals[&Measure::I],
            net_change.look().intervals[&Measure::Difference]
        );
    }
}

#[test]
fn later_rollouts_wait_for_a_rollout_without_outcomes_of_both_policies() {
    let order = small_order(1);
    let units: Vec<SmallUnit> = order.units().copied().collect();
    let mut sequential = SequentialDifference::new(&order, ALPHA);
    let (success, missing) = (Outcome::Success, Outcome::Missing);
    for (unit, b) in units.iter().zip([Outcome::Failure, missing, Outcome::Failure]) {
        sequential.complete(unit, success, b).expect("in the order");
    }
    let look = sequential.look();
    assert_eq!((look.used, look.waiting), (1, 1));
    sequential.complete(&units[1], success, Outcome::Failure).expect("in the order");
    let expected = RateInterval { least: 3, greatest: 3, units: 3 };
    let look = sequential.look();
    assert_eq!((look.used, look.waiting), (3, 0));
    assert_eq!(look.intervals, [(Measure::Difference, expected)].into());
}

#[test]
fn repeated_configurations_are_ignored_and_unknown_ones_are_errors() {
    let order = small_order(1);
    let unit = *order.units().next().expect("a unit");
    let mut sequential = SequentialMeasures::new(&order, ALPHA);
    for transition in [Transition::Emergent, Transition::Compensated] {
        sequential.complete(&unit, &[transition]).expect("in the order");
    }
    let look = sequential.look();
    assert_eq!(look.used, 1);
    assert_eq!(look.intervals[&Measure::RE].least, 1);
    assert_eq!(look.intervals[&Measure::RC].least, 0);
    let error = sequential.complete(&(7, 0), &[Transition::Emergent]);
    assert_eq!(
        error.expect_err("not in the order").to_string(),
        "outcome of (7, 0): the unit is not in the drawn order of 3 configurations"
    );
}

#[test]
fn quarantined_rollouts_leave_every_possible_value_in_the_interval() {
    let order = small_order(4);
    for quarantined in order.units() {
        let mut sequential = SequentialMeasures::new(&order, ALPHA);
        let mut known: Vec<Transition> = Vec::new();
        for unit in order.units() {
            let transition = [Transition::ALL[(unit.0 + unit.1) % 4]];
            let possible = match unit == quarantined {
                true => &Transition::ALL[..],
                false => &transition,
            };
            sequential.complete(unit, possible).expect("in the order");
            known.extend((unit != quarantined).then_some(transition[0]));
        }
        for (measure, interval) in sequential.look().intervals {
            let sum: i64 = known.iter().map(|&transition| value(measure, transition)).sum();
            let least = if measure == Measure::I { sum - 1 } else { sum };
            assert_eq!([interval.least, interval.greatest], [least, sum + 1]);
        }
    }
}

#[test]
fn possible_transitions_cover_every_outcome_of_quarantined_rollouts() {
    use Outcome::{Failure, Missing, Quarantined, Success};
    let all = [Success, Failure, Quarantined, Missing];
    for camera in all {
        for robot in all {
            for simultaneous in all {
                let matched = matched(camera, robot, simultaneous);
                let mut expected = Vec::new();
                for filled in fillings(&[camera, robot, simultaneous]) {
                    let transition = Transition::between(filled[0] && filled[1], filled[2]);
                    if !expected.contains(&transition) {
                        expected.push(transition);
                    }
                }
                expected.sort();
                let is_missing = [camera, robot, simultaneous].contains(&Missing);
                let possible = matched.possible_transitions();
                let possible = possible.map(|mut transitions| {
                    transitions.sort();
                    transitions
                });
                assert_eq!(possible, (!is_missing).then_some(expected), "{matched:?}");
            }
        }
    }
}

fn matched(camera: Outcome, robot: Outcome, simultaneous: Outcome) -> Matched {
    Matched {
        replicate: 0,
        level: Level::L1,
        task: TaskRef::all().next().expect("a task"),
        config: 0,
        init_id: 0,
        nominal: Outcome::Missing,
        alone: [(Axis::Camera, camera), (Axis::Robot, robot)].into(),
        latency: None,
        subsets: BTreeMap::new(),
        simultaneous,
    }
}

/// Returns every way to replace quarantined rollouts by outcomes.
fn fillings(outcomes: &[Outcome]) -> Vec<Vec<bool>> {
    let mut all = vec![Vec::new()];
    for outcome in outcomes {
        let choices = match outcome.success() {
            Some(success) => vec![success],
            None => vec![false, true],
        };
        all = all
            .iter()
            .flat_map(|filled| {
                choices.iter().map(|&choice| {
                    let mut filled = filled.clone();
                    filled.push(choice);
                    filled
                })
            })
            .collect();
    }
    all
}

#[test]
fn narrower_widths_are_met_after_more_configurations() {
    let population = Population::published(Level::L3);
    let order = population.order(5, Design::Tasks);
    let rules: Vec<StopRule> = ["width(I) < 2", "width(I) < 0.12", "width(I) < 0.001"]
        .map(|text| text.parse().expect("a rule"))
        .to_vec();
    let (_, met) = population.replay(&order, &rules);
    let met: Vec<usize> =
        met.into_iter().map(|met| met.expect("met by all configurations")).collect();
    assert!(met[0] < 40, "the first rounds narrow the interval: {met:?}");
    assert!(met[1] > met[0] && met[1] < 400, "{met:?}");
    assert!(met[2] > met[1], "{met:?}");
}
