//! Tests of the search along one ray: it finds the threshold in as few rollouts as
//! halving needs, whatever the order of the outcomes.

use std::collections::BTreeMap;

use benchmark::{Axis, AxisSet, Condition, Level};
use paired::Outcome;
use paired::adaptive::radii::{Finding, Search, Threshold, next};
use paired::adaptive::{Decision, Outcomes};
use proptest::prelude::*;

use super::thresholds;

/// Amount by which a bracket may exceed the tolerance, since radii have six decimals.
const ROUNDING: f64 = 1e-5;

fn level(radius: f64) -> Level {
    Level::of_radius(radius).expect("a radius")
}

fn search(tolerance: f64, max_radius: f64) -> Search {
    let camera = Condition::Single(Axis::Camera);
    Search::of(&thresholds(tolerance, max_radius), camera, AxisSet::ALL)
}

/// Runs the requested rollouts until none is left.
fn run(search: &Search, outcome: impl Fn(Level) -> Outcome) -> Outcomes<Level> {
    let mut outcomes = Outcomes::from_nominal(Outcome::Success);
    while let Decision::Run(levels) = next(&outcomes, search) {
        assert!(!levels.is_empty());
        for level in levels {
            assert_eq!(outcomes.at(level), None, "{level} was requested twice");
            outcomes.record(level, outcome(level));
        }
    }
    assert_eq!(next(&outcomes, search), Decision::Done);
    outcomes
}

/// Returns a pseudorandom outcome of seed and radius, without a trend over the radius: of 16
/// outcomes, `failing` are failures and `quarantined` are in quarantine.
fn pseudorandom(seed: u64, level: Level, failing: u64, quarantined: u64) -> Outcome {
    let mut bits = seed ^ (level.radius() * 1e6) as u64;
    for _ in 0..3 {
        bits = (bits ^ (bits >> 29)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    }
    match (bits >> 32) % 16 {
        draw if draw < failing => Outcome::Failure,
        draw if draw < failing + quarantined => Outcome::Quarantined,
        _ => Outcome::Success,
    }
}

/// Returns the first failure and all successes beyond it, computed without the code under test.
fn expected_finding(outcomes: &Outcomes<Level>) -> (Option<Level>, Vec<Level>) {
    let fails = outcomes.perturbed().find(|(_, outcome)| *outcome == Outcome::Failure);
    let fails = fails.map(|(level, _)| level);
    let succeeds = outcomes.perturbed().filter(|(_, outcome)| *outcome == Outcome::Success);
    let beyond = succeeds.map(|(level, _)| level);
    let beyond = beyond.filter(|level| fails.is_some_and(|fails| *level > fails));
    (fails, beyond.collect())
}

proptest! {
    #[test]
    fn a_planted_threshold_is_found_within_the_tolerance(
        at in 0.001_f64..40.0, tolerance in 0.01_f64..3.0, max_radius in 2.0_f64..40.0,
    ) {
        let search = search(tolerance, max_radius);
        let outcomes = run(&search, |level| Outcome::from(level.radius() < at));
        let finding = Finding::new(&outcomes, &search);
        prop_assert!(finding.recovers_at.is_empty());
        let mut halvings = 0.0;
        match finding.threshold {
            Threshold::Beyond => prop_assert!(search.largest().expect("a grid").radius() < at),
            Threshold::Between { succeeds_at, fails_at } => {
                let [low, high] = [succeeds_at.radius(), fails_at.radius()];
                prop_assert!(low < at && at <= high);
                prop_assert!(high - low <= tolerance + ROUNDING);
                let grid = || search.grid.iter().map(|level| level.radius());
                let below = grid().filter(|radius| *radius < at).fold(0.0, f64::max);
                let above = grid().find(|radius| *radius >= at).expect("a failing radius");
                halvings = ((above - below) / (tolerance + ROUNDING)).log2().ceil().max(0.0);
            }
            other => prop_assert!(false, "{other:?}"),
        }
        let rollouts = search.grid.len() as u32 + halvings as u32;
        prop_assert_eq!(outcomes.requested(), rollouts);
        prop_assert!(rollouts <= search.most_rollouts(|_| false));
    }

    #[test]
    fn the_first_failure_and_every_recovery_are_found_for_any_outcomes(
        seed: u64, failing in 0_u64..16, quarantined in 0_u64..6, tolerance in 0.05_f64..3.0,
    ) {
        let search = search(tolerance, 16.0);
        let outcomes = run(&search, |level| pseudorandom(seed, level, failing, quarantined));
        prop_assert!(outcomes.requested() <= search.most_rollouts(|_| false));
        let (fails, beyond) = expected_finding(&outcomes);
        let finding = Finding::new(&outcomes, &search);
        prop_assert_eq!(finding.recovers_at, beyond);
        match finding.threshold {
            Threshold::Between { succeeds_at, fails_at } => {
                prop_assert_eq!(Some(fails_at), fails);
                let lower_end = outcomes.at(succeeds_at);
                prop_assert!(lower_end == Some(Outcome::Success) || succeeds_at == Level::L0);
                // The bracket is wider than the tolerance only if its middle is quarantined.
                let width = fails_at.radius() - succeeds_at.radius();
                let middle = level(succeeds_at.radius() + width / 2.0);
                prop_assert!(
                    width <= tolerance + ROUNDING || outcomes.at(middle) == Some(Outcome::Quarantined)
                );
            }
            Threshold::Beyond => prop_assert_eq!(fails, None),
            Threshold::Open { .. } => {
                prop_assert_eq!(fails, None);
                prop_assert_eq!(outcomes.at(level(16.0)), Some(Outcome::Quarantined));
            }
            other => prop_assert!(false, "{other:?}"),
        }
    }

    #[test]
    fn requests_depend_on_outcomes_and_not_on_their_order(
        seed: u64, failing in 0_u64..16, order: u64,
    ) {
        let search = search(0.25, 16.0);
        let outcome = |level| pseudorandom(seed, level, failing, 2);
        let together = run(&search, outcome);
        // Outcomes of all requested rollouts, at first missing; one is settled at a time, in a random
        // order, with a new decision after each.
        let mut requested: BTreeMap<Level, Outcome> = BTreeMap::new();
        let mut draw = order;
        loop {
            let mut outcomes = Outcomes::from_nominal(Outcome::Success);
            for (&level, &outcome) in &requested {
                outcomes.record(level, outcome);
            }
            if let Decision::Run(levels) = next(&outcomes, &search) {
                for level in levels {
                    prop_assert_eq!(requested.insert(level, Outcome::Missing), None);
                }
            }
            let waiting = requested.iter().filter(|(_, outcome)| **outcome == Outcome::Missing);
            let waiting: Vec<Level> = waiting.map(|(&level, _)| level).collect();
            if waiting.is_empty() {
                break;
            }
            draw = draw.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            let level = waiting[(draw >> 33) as usize % waiting.len()];
            requested.insert(level, outcome(level));
        }
        prop_assert!(together.perturbed().eq(requested.into_iter()));
    }

    #[test]
    fn supplied_outcomes_are_not_requested_again(at in 0.001_f64..20.0, tolerance in 0.05_f64..3.0) {
        let search = search(tolerance, 16.0);
        let outcome = |level: Level| Outcome::from(level.radius() < at);
        let without_supplied = run(&search, outcome);
        let mut outcomes = Outcomes::from_nominal(Outcome::Success);
        for level in Level::PERTURBED {
            outcomes.record_source(level, outcome(level));
        }
        while let Decision::Run(levels) = next(&outcomes, &search) {
            for level in levels {
                prop_assert!(!Level::PERTURBED.contains(&level));
                outcomes.record(level, outcome(level));
            }
        }
        prop_assert!(outcomes.perturbed().eq(without_supplied.perturbed()));
        prop_assert_eq!(outcomes.requested() + 3, without_supplied.requested());
        prop_assert!(outcomes.requested() <= search.most_rollouts(|level| level.is_named()));
    }
}

/// Delays are whole control steps, that is, radii of 2, 4, 6, …
#[test]
fn a_latency_threshold_is_found_to_the_control_step() {
    for (max_radius, grid) in
        [(16.0, "L1 L2 L3 r16"), (15.0, "L1 L2 L3 r14"), (14.0, "L1 L2 L3 r14"), (5.5, "L1 L2")]
    {
        let measured = thresholds(0.5, max_radius);
        let search = Search::of(&measured, Condition::Single(Axis::Latency), AxisSet::ALL);
        let radii: Vec<String> = search.grid.iter().map(Level::to_string).collect();
        assert_eq!(radii.join(" "), grid);
        for tolerated in 0..=7_u16 {
            let radius = 2.0 * f64::from(tolerated);
            let outcome = |level: Level| Outcome::from(level.radius() <= radius);
            let outcomes = run(&search, outcome);
            let steps = |level: Level| level.radius() / 2.0;
            assert!(outcomes.perturbed().all(|(level, _)| steps(level).fract() == 0.0));
            let largest = search.largest().expect("a radius");
            let expected = match radius >= largest.radius() {
                true => Threshold::Beyond,
                false => Threshold::Between {
                    succeeds_at: match tolerated {
                        0 => Level::L0,
                        _ => level(radius),
                    },
                    fails_at: level(radius + 2.0),
                },
            };
            assert_eq!(Finding::new(&outcomes, &search).threshold, expected, "{tolerated} steps");
        }
    }
}

#[test]
fn configurations_that_fail_nominally_are_not_perturbed_further() {
    let search = search(0.5, 16.0);
    let mut outcomes = Outcomes::from_nominal(Outcome::Failure);
    assert_eq!(next(&outcomes, &search), Decision::Done);
    assert_eq!(Finding::new(&outcomes, &search).threshold, Threshold::NominalFails);
    // A perturbed rollout may succeed nevertheless; `recovers_at` then contains its level.
    outcomes.record_source(Level::L2, Outcome::Success);
    let finding = Finding::new(&outcomes, &search);
    assert_eq!(finding.threshold, Threshold::NominalFails);
    assert_eq!(finding.recovers_at, [Level::L2]);
    let missing = Outcomes::from_nominal(Outcome::Missing);
    assert_eq!(next(&missing, &search), Decision::Wait);
    let quarantined = Outcomes::from_nominal(Outcome::Quarantined);
    assert_eq!(next(&quarantined, &search), Decision::Done);
    let unknown = Finding::new(&quarantined, &search).threshold;
    assert_eq!(unknown, Threshold::NominalUnknown);
}

#[test]
fn language_is_measured_only_at_the_levels_that_have_paraphrases() {
    let with_language = [Condition::Single(Axis::Language), Condition::Simultaneous];
    for condition in with_language {
        let search = Search::of(&thresholds(0.5, 16.0), condition, AxisSet::ALL);
        let outcomes = run(&search, |level| Outcome::from(level < Level::L3));
        let radii: Vec<Level> = outcomes.perturbed().map(|(level, _)| level).collect();
        assert_eq!(radii, Level::PERTURBED);
        let threshold = Finding::new(&outcomes, &search).threshold;
        let expected = Threshold::Between { succeeds_at: Level::L2, fails_at: Level::L3 };
        assert_eq!(threshold, expected);
    }
    let metric = AxisSet::from_iter(Axis::METRIC);
    let search = Search::of(&thresholds(0.5, 16.0), Condition::Simultaneous, metric);
    assert_eq!(search.tolerance, Some(0.5));
}
