//! Partial progress of two policies, and the design's directions, in a comparison.

use benchmark::attempt::GoalProgress;
use benchmark::{Condition, Directions, Level, RolloutId, TaskRef};
use paired::{Bootstrap, Compared, Comparison, Outcome, Progress, Record};

use crate::simulated::{CONFIGURATIONS, Chance, Population};

/// Returns a simultaneous and a nominal rollout of each of ten tasks of a suite.
fn records(success: impl Fn(usize) -> bool) -> Vec<Record> {
    let tasks = TaskRef::all().take(10).enumerate();
    let records = tasks.flat_map(|(at, task)| {
        let id = RolloutId::perturbed(task, Condition::Simultaneous, Level::L2, 0).expect("an id");
        [id, RolloutId::nominal(task, 2)].map(|id| Record {
            id,
            init_id: 2,
            replicate: 0,
            outcome: Outcome::from(success(at)),
        })
    });
    records.collect()
}

/// Returns the progress of the simultaneous rollouts. `values` returns the steps of a task's
/// rollout, and the number of its three predicates that held.
fn progress(records: &[Record], values: impl Fn(usize) -> (u32, u32)) -> Vec<Progress> {
    let perturbed = records.iter().filter(|record| record.id.level() == Level::L2);
    let progress = perturbed.enumerate().map(|(at, record)| {
        let (steps, held) = values(at);
        Progress {
            id: record.id,
            replicate: 0,
            steps: Some(steps),
            goal: Some(GoalProgress { predicates: 3, at_end: held, at_most: held }),
        }
    });
    progress.collect()
}

fn compare(a: Compared<'_>, b: Compared<'_>) -> Comparison {
    Comparison::of(a, b, &Bootstrap::default(), |_| None)
}

fn compared<'a>(records: &'a [Record], progress: &'a [Progress]) -> Compared<'a> {
    Compared { progress, ..Compared::from(records) }
}

fn is_near(value: f64, expected: f64) -> bool {
    (value - expected).abs() < 1e-6 * expected.abs().max(1.0)
}

#[test]
fn differences_in_steps_and_predicates_equal_those_worked_out_by_hand() {
    let (a, b) = (records(|_| true), records(|_| false));
    // A takes 1, 2, …, 10 steps more than B, and has one predicate of three more.
    let progress_a = progress(&a, |at| (101 + at as u32, 3));
    let progress_b = progress(&b, |_| (100, 2));
    let comparison = compare(compared(&a, &progress_a), compared(&b, &progress_b));
    let nominal = &comparison.cells[0];
    assert_eq!((nominal.condition, nominal.progress), (Condition::Nominal, None));
    let progress = comparison.cells[1].progress.expect("progress");
    let (goal, steps) = (progress.goal.expect("goals"), progress.steps.expect("steps"));
    assert_eq!((steps.n, steps.tasks), (10, 10));
    assert_eq!((steps.mean_a, steps.mean_b), (105.5, 100.0));
    assert!(is_near(steps.difference.value, 5.5));
    // SciPy: stats.ttest_1samp(range(1, 11), 0) and its confidence interval.
    let [low, high] = steps.difference.new_tasks.expect("an interval");
    assert!(is_near(low, 3.334_149_7) && is_near(high, 7.665_850_3), "{low} {high}");
    assert!(is_near(steps.p.expect("a spread"), 0.000278196), "{:?}", steps.p);
    assert_eq!(steps.holm_p, steps.p, "only this row has a spread");
    assert!(is_near(goal.difference.value, 1.0 / 3.0));
    assert_eq!((goal.p, goal.holm_p), (None, None), "all tasks are alike");

    let reverse = compare(compared(&b, &progress_b), compared(&a, &progress_a));
    let reverse = reverse.cells[1].progress.and_then(|progress| progress.steps).expect("steps");
    assert_eq!(reverse.difference.value, -steps.difference.value);
    assert_eq!(reverse.p, steps.p);
}

#[test]
fn progress_known_for_one_policy_only_is_excluded() {
    let (a, mut b) = (records(|_| true), records(|at| at % 2 == 0));
    b[0].outcome = Outcome::Quarantined;
    let progress_a = progress(&a, |_| (100, 3));
    let mut progress_b = progress(&b, |_| (120, 3));
    progress_b[1].goal = None;
    progress_b.pop();
    let comparison = compare(compared(&a, &progress_a), compared(&b, &progress_b));
    let progress = comparison.cells[1].progress.expect("progress");
    assert_eq!(progress.steps.map(|mean| mean.n), Some(8));
    assert_eq!(progress.goal.map(|mean| mean.n), Some(7));
    let without_b = compare(compared(&a, &progress_a), Compared::from(b.as_slice()));
    assert!(without_b.cells.iter().all(|cell| cell.progress.is_none()));
}

#[test]
fn own_directions_are_assumed_only_if_both_campaigns_have_them() {
    let population = Population::standard();
    let mut chance = Chance::new(9);
    let effects = population.tasks(20, &mut chance);
    let directions = population.directions(CONFIGURATIONS, &mut chance);
    let [a, b] = [0, 1].map(|_| population.campaign(&effects, 4, &directions, &mut chance));
    let [own, shared] = [Directions::Own, Directions::Shared];
    let compare_with = |directions_a, directions_b| {
        let [a, b] = [(&a, directions_a), (&b, directions_b)].map(|(records, directions)| {
            Compared { directions, ..Compared::from(records.as_slice()) }
        });
        compare(a, b)
    };
    let both_own = compare_with(own, own);
    assert_eq!(both_own.directions, own);
    let (mut nominal, mut differ) = (0, false);
    for (cell, shared_cell) in both_own.cells.iter().zip(compare_with(shared, shared).cells) {
        let [own, shared] = [cell.difference.as_ref(), shared_cell.difference.as_ref()]
            .map(|difference| difference.expect("outcomes").estimate);
        assert_eq!(own.new_tasks, shared.new_tasks);
        if cell.condition == Condition::Nominal {
            assert_eq!(own, shared, "initial states are shared");
            nominal += 1;
        } else {
            assert_eq!(own.new_tasks_and_directions, own.new_tasks);
            differ |= shared.new_tasks_and_directions != shared.new_tasks;
        }
    }
    assert!(nominal == 1 && differ);
    assert_eq!(compare_with(own, shared).directions, shared);
}
