//! Confidence sequences hold at all looks: for every order of small populations, exactly, and for
//! random orders of published outcomes.

use benchmark::{Axis, Level, Measure, StopRule, TaskRef};
use paired::{
    Bootstrap, Configuration, Matched, Measures, Order, Outcome, Records, SequentialMeasures,
    Transition,
};
use proptest::prelude::*;

/// Largest probability that any interval excludes the true value at any look.
const ALPHA: f64 = 0.05;

/// A configuration's task and number.
type Unit = (TaskRef, u16);

/// The configurations of one level, each with its transition under simultaneous perturbation.
struct Population {
    units: Vec<(Unit, Transition)>,
}

/// Design of a drawn order.
#[derive(Clone, Copy, Debug)]
enum Design {
    /// Rounds with one configuration of every task.
    Tasks,
    /// Rounds with one configuration of every suite.
    Suites,
    /// All configurations in one random order.
    Simple,
}

impl Population {
    /// Returns OpenVLA-OFT's published outcomes at a level.
    fn published(level: Level) -> Self {
        let records = crate::records(&crate::example("openvla_oft"));
        let records = Records::new(&records).expect("no duplicates");
        let matched = records.configurations().iter();
        let units = matched.filter(|configuration| configuration.level == level).map(|matched| {
            let transition = matched.transition().expect("published outcomes are known");
            ((matched.task, matched.config), transition)
        });
        Self { units: units.collect() }
    }

    fn order(&self, seed: u64, design: Design) -> Order<Unit> {
        let units = self.units.iter().map(|(unit, _)| *unit);
        match design {
            Design::Tasks => Order::new(seed, units, |&(task, _)| task),
            Design::Suites => Order::new(seed, units, |(task, _)| task.suite()),
            Design::Simple => Order::new(seed, units, |_| ()),
        }
    }

    fn transition(&self, unit: &Unit) -> Transition {
        let position = self.units.binary_search_by(|(other, _)| other.cmp(unit));
        self.units[position.expect("a configuration")].1
    }

    fn values(&self, measure: Measure) -> impl Iterator<Item = i64> {
        self.units.iter().map(move |(_, transition)| value(measure, *transition))
    }

    fn total(&self, measure: Measure) -> i64 {
        self.values(measure).sum()
    }

    /// Returns true if all intervals hold after every configuration of an order.
    fn holds(&self, order: &Order<Unit>) -> bool {
        let mut sequential = SequentialMeasures::new(order, ALPHA);
        order.units().all(|unit| {
            sequential.complete(&[self.transition(unit)]);
            let look = sequential.look();
            Measure::ALL.iter().all(|measure| {
                let interval = look.intervals[measure];
                (interval.least..=interval.greatest).contains(&self.total(*measure))
            })
        })
    }
}

fn value(measure: Measure, transition: Transition) -> i64 {
    use Transition::{Compensated, Emergent, StillFails, StillSucceeds};
    match (measure, transition) {
        (Measure::SSim, StillSucceeds | Compensated) => 1,
        (Measure::RE, Emergent) | (Measure::RC, Compensated) => 1,
        (Measure::RD, Emergent | Compensated) => 1,
        (Measure::I, Compensated) => 1,
        (Measure::I, Emergent) => -1,
        (_, StillSucceeds | StillFails | Emergent | Compensated) => 0,
    }
}

/// Number of orders per level.
const ORDERS: u64 = 100;
/// Number of orders per level for the designs with shorter rounds, which take longer.
const FEW_ORDERS: u64 = 10;

/// Returns the number of orders, over all levels, in which an interval is ever wrong.
fn misses(orders: u64, design: Design) -> usize {
    let misses_of = |population: Population| {
        let orders = (0..orders).map(|seed| population.order(seed, design));
        orders.filter(|order| !population.holds(order)).count()
    };
    Level::PERTURBED.map(Population::published).into_iter().map(misses_of).sum()
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
        let missed = misses(orders, design);
        assert!(missed <= most_misses(orders), "{design:?}: {missed}");
    }
}

#[test]
fn after_all_configurations_an_interval_is_the_exact_measure() {
    for level in Level::PERTURBED {
        let population = Population::published(level);
        let order = population.order(1, Design::Tasks);
        let mut sequential = SequentialMeasures::new(&order, ALPHA);
        let mut configurations = Vec::new();
        for unit in order.units() {
            let transition = population.transition(unit);
            sequential.complete(&[transition]);
            configurations.push(configuration(unit.0, transition));
        }
        let look = sequential.look();
        let measures = Measures::of(&configurations, &Bootstrap::default()).expect("not empty");
        let expected = [measures.s_sim, measures.r_e, measures.r_c, measures.r_d, measures.i];
        assert_eq!((look.used, look.units), (400, 400));
        for (measure, expected) in Measure::ALL.iter().zip(expected) {
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
        sequential.complete(&[strata[unit.0][unit.1]]);
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

proptest! {
    #![proptest_config(ProptestConfig::with_cases(8))]

    /// An interval that ruled out the true total, which it may with probability ALPHA, moves once it
    /// has become impossible.
    #[test]
    fn intervals_that_hold_the_truth_never_widen(seed: u64) {
        let population = Population::published(Level::L3);
        let order = population.order(seed, Design::Tasks);
        let mut sequential = SequentialMeasures::new(&order, ALPHA);
        let mut looks = vec![sequential.look().intervals];
        for unit in order.units() {
            sequential.complete(&[population.transition(unit)]);
            looks.push(sequential.look().intervals);
        }
        for (measure, truth) in &looks[looks.len() - 1] {
            let intervals: Vec<_> = looks.iter().map(|look| look[measure]).collect();
            let holds = |each: &&paired::RateInterval| {
                each.least <= truth.least && truth.greatest <= each.greatest
            };
            let holding = intervals.iter().take_while(holds).collect::<Vec<_>>();
            for pair in holding.windows(2) {
                prop_assert!(pair[0].least <= pair[1].least);
                prop_assert!(pair[1].greatest <= pair[0].greatest);
            }
        }
    }
}

#[test]
fn quarantined_rollouts_leave_every_possible_value_in_the_interval() {
    let order = small_order(4);
    for quarantined in order.units() {
        let mut sequential = SequentialMeasures::new(&order, ALPHA);
        let mut known: Vec<Transition> = Vec::new();
        for unit in order.units() {
            let transition = [Transition::ALL[(unit.0 + unit.1) % 4]];
            let possible = if unit == quarantined { &Transition::ALL[..] } else { &transition };
            sequential.complete(possible);
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
        subsets: std::collections::BTreeMap::new(),
        simultaneous,
    }
}

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
    let met = ["width(I) < 2", "width(I) < 0.12", "width(I) < 0.001"].map(|text| {
        let rule: StopRule = text.parse().expect("a rule");
        let mut sequential = SequentialMeasures::new(&order, ALPHA);
        let met = order.units().position(|unit| {
            sequential.complete(&[population.transition(unit)]);
            sequential.look().meets(&rule)
        });
        1 + met.expect("met by all configurations")
    });
    assert!(met[0] < 40, "the first rounds narrow the interval: {met:?}");
    assert!(met[1] > met[0] && met[1] < 400, "{met:?}");
    assert!(met[2] > met[1], "{met:?}");
}
