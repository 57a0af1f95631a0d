//! Tests of the curves of many rays: they recover planted thresholds, and budgets are respected.

use std::collections::BTreeSet;

use benchmark::{Axis, Condition, Level, RolloutId, TaskRef, Thresholds};
use paired::adaptive::Decision;
use paired::adaptive::radii::{Curve, Measurement};
use paired::{Bootstrap, NoInterval, Outcome, Record};

use super::{measure, record};

const CONFIGS: u16 = 10;

fn thresholds(budget: Option<u32>, seed: u64) -> Thresholds {
    Thresholds { budget, seed, ..super::thresholds(0.5, 16.0) }
}

/// Radius from which a configuration fails: evenly spaced from 0 to 12, and halved under both axes
/// together. The first configuration of each task fails nominally.
fn fails_at(id: RolloutId) -> f64 {
    let config = f64::from(id.number()) + f64::from(id.task().index()) / 10.0;
    let share = match id.condition() {
        Condition::Simultaneous => 0.5,
        _ => 1.0,
    };
    config * 1.2 * share
}

fn outcome(id: RolloutId) -> Outcome {
    Outcome::from(match id.condition() {
        Condition::Nominal => id.number() > 0,
        _ => id.number() > 0 && id.level().radius() < fails_at(id),
    })
}

/// Returns the records of a campaign that perturbs camera and robot at L2, in the first tasks.
fn campaign(tasks: usize) -> Vec<Record> {
    let mut records = Vec::new();
    for task in TaskRef::all().take(tasks) {
        for config in 0..CONFIGS {
            let axes = [Axis::Camera, Axis::Robot].map(Condition::Single);
            let perturbed = axes.into_iter().chain([Condition::Simultaneous]);
            let perturbed = perturbed.map(|condition| {
                RolloutId::perturbed(task, condition, Level::L2, config).expect("perturbed")
            });
            let ids = perturbed.chain([RolloutId::nominal(task, config)]);
            records.extend(ids.map(|id| record(id, outcome(id))));
        }
    }
    records
}

/// Returns the curves of a campaign, and asserts that they do not depend on the order of records.
fn curves(tasks: usize) -> Vec<Curve> {
    let source = campaign(tasks);
    let thresholds = thresholds(None, 0);
    let further = measure(&source, &thresholds, outcome);
    let measurement = Measurement::of(&source, &further, &thresholds);
    for (ray, outcomes) in measurement.rays() {
        assert_eq!(measurement.decision(ray, outcomes), Decision::Done);
    }
    let curves = measurement.curves(&Bootstrap::default());
    let [source, further] =
        [source, further].map(|records| records.into_iter().rev().collect::<Vec<_>>());
    let reversed = Measurement::of(&source, &further, &thresholds);
    assert_eq!(reversed.curves(&Bootstrap::default()), curves);
    curves
}

#[test]
fn a_curve_begins_at_the_nominal_rate_and_equals_the_planted_curve_at_the_grid() {
    let curves = curves(10);
    let conditions: Vec<&str> = curves.iter().map(|curve| curve.condition.name()).collect();
    assert_eq!(conditions, ["camera", "robot", "simultaneous"]);
    for curve in &curves {
        assert_eq!((curve.n, curve.tasks, curve.left_out), (100, 10, 0));
        assert_eq!((curve.nominal_fails, curve.not_monotone), (10, 0));
        assert_eq!(curve.at(0.0).map(|point| point.survival), Some(0.9));
        let tasks: Vec<TaskRef> = TaskRef::all().take(10).collect();
        for &radius in &curve.grid {
            let level = Level::of_radius(radius).expect("a radius");
            let survives = tasks.iter().flat_map(|&task| (0..CONFIGS).map(move |c| (task, c)));
            let survives = survives.filter(|&(task, config)| {
                let id = RolloutId::perturbed(task, curve.condition, level, config);
                outcome(id.expect("perturbed")) == Outcome::Success
            });
            let expected = survives.count() as f64 / 100.0;
            let point = curve.at(radius).expect("a point of the grid");
            assert!((point.survival - expected).abs() < 1e-12, "{radius}: {point:?}");
            let [low, high] = point.band;
            assert!((high - low).abs() < 1e-12, "{radius}: {point:?}");
        }
        for pair in curve.points.windows(2) {
            assert!(pair[0].radius < pair[1].radius);
            assert!(pair[0].survival >= pair[1].survival, "{pair:?}");
        }
        for point in &curve.points {
            let [low, high] = point.band;
            let slack = 1e-12;
            assert!(low - slack <= point.survival && point.survival <= high + slack);
        }
    }
}

#[test]
fn the_half_success_radius_is_found_within_the_tolerance() {
    for curve in curves(10) {
        let mut planted: Vec<f64> = TaskRef::all()
            .take(10)
            .flat_map(|task| (0..CONFIGS).map(move |config| (task, config)))
            .map(|(task, config)| {
                let id = RolloutId::perturbed(task, curve.condition, Level::L1, config);
                if config == 0 { 0.0 } else { fails_at(id.expect("perturbed")) }
            })
            .collect();
        planted.sort_by(f64::total_cmp);
        let median = f64::midpoint(planted[49], planted[50]);
        let half = &curve.half_success;
        let radius = half.radius.expect("half of the configurations fail");
        assert!((radius - median).abs() <= 0.5, "{radius} for {median}");
        let [low, high] = half.ci95.expect("ten tasks that differ");
        assert!(low <= radius && radius <= high, "{low} {radius} {high}");
    }
    for curve in curves(9) {
        let half = &curve.half_success;
        assert_eq!(half.ci95, None);
        assert_eq!(half.no_interval, Some(NoInterval::TooFewTasks));
    }
}

#[test]
fn configurations_with_missing_outcomes_are_left_out_and_counted() {
    let source = campaign(10);
    let thresholds = thresholds(None, 0);
    let before = Measurement::of(&source, &[], &thresholds).curves(&Bootstrap::default());
    // Without further radii, only the thresholds of nominal failures are known.
    assert!(before.iter().all(|curve| (curve.n, curve.left_out) == (10, 90)));
    let mut further = measure(&source, &thresholds, outcome);
    let largest = further.iter_mut().find(|record| record.id.level().radius() == 16.0);
    let largest = largest.expect("the grid was run");
    largest.outcome = Outcome::Quarantined;
    let after = Measurement::of(&source, &further, &thresholds).curves(&Bootstrap::default());
    let counts = |curve: &Curve| (curve.n, curve.left_out);
    // The quarantined outcome is at the largest radius of a ray that fails at a smaller one, so the
    // ray's bracket is known.
    assert!(after.iter().all(|curve| counts(curve) == (100, 0)));
}

#[test]
fn a_budget_measures_a_random_sample_and_is_not_exceeded() {
    let source = campaign(12);
    // L1, L3 and r16 of three conditions, and five halvings each.
    let unmeasured = Measurement::of(&source, &[], &thresholds(None, 0));
    let most = unmeasured.most_rollouts_per_configuration();
    assert_eq!(most, 3 * (3 + 5));
    let sample = |budget, seed| -> BTreeSet<(TaskRef, u16)> {
        let thresholds = thresholds(Some(budget), seed);
        let further = measure(&source, &thresholds, outcome);
        assert!(further.len() <= budget as usize);
        let measurement = Measurement::of(&source, &further, &thresholds);
        for (ray, outcomes) in measurement.rays() {
            assert_eq!(measurement.decision(ray, outcomes), Decision::Done);
        }
        measurement.rays().map(|(ray, _)| (ray.task, ray.config)).collect()
    };
    assert!(sample(most - 1, 1).is_empty());
    let twelve = sample(12 * most, 1);
    let tasks: BTreeSet<TaskRef> = twelve.iter().map(|(task, _)| *task).collect();
    assert_eq!((twelve.len(), tasks.len()), (12, 12));
    assert!(twelve.is_subset(&sample(20 * most + 3, 1)));
    assert_eq!(sample(20 * most, 1), sample(20 * most, 1));
    assert_ne!(sample(20 * most, 1), sample(20 * most, 2));
    assert_eq!(sample(120 * most, 1).len(), 120);
}
