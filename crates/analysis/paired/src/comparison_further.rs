//! Text about a comparison of two policies beyond success rates: further targets and tests,
//! the profile of tasks, and partial progress.

use libero_ctrl::Directions;

use crate::bootstrap::Interval;
use crate::comparison::Comparison;
use crate::difference::Difference;
use crate::progress::{MeanDifference, ProgressDifference};
use crate::text::{ABSENT, p_value, push_columns, push_wrapped, separate};

/// Appends the intervals for further targets and the equivalence test, then the profile of
/// tasks.
pub(crate) fn push_further(text: &mut String, comparison: &Comparison) {
    let cells =
        || comparison.cells.iter().filter_map(|cell| Some((cell, cell.difference.as_ref()?)));
    let further = cells().map(|(cell, difference)| {
        let values = vec![
            interval_text(difference.estimate.new_tasks_and_directions, points),
            interval_text(difference.simultaneous_ci95, points),
            difference.equivalence_p.map_or_else(absent, p_value),
            format!("{}:{}", difference.profile.a_better, difference.profile.b_better),
        ];
        (cell.name(), values)
    });
    let heads = ["directions", "all rows", "5 pts p", "tasks A:B"];
    let title = "A - B for further targets";
    push_block(text, title, &heads, further.collect());
    let by_task = cells().map(|(cell, difference)| (cell.name(), profile_columns(difference)));
    let heads = ["A better %", "95 %", "least", "most"];
    push_block(text, "A - B by task", &heads, by_task.collect());
}

fn profile_columns(difference: &Difference) -> Vec<String> {
    let better = &difference.profile.improvement;
    let mut values = vec![
        format!("{:.0}", 100.0 * better.value),
        interval_text(better.new_tasks, |value| format!("{:.0}", 100.0 * value)),
    ];
    values.extend(match difference.profile.extremes() {
        Some(extremes) => extremes.map(|(task, change)| {
            let (suite, index) = (task.suite().short_name(), task.index());
            format!("{suite}/t{index} {:+.0}", 100.0 * change)
        }),
        None => [absent(), absent()],
    });
    values
}

/// Appends partial progress: a block for the goal's predicates, and a block for steps. A block
/// without known values is omitted.
pub(crate) fn push_progress(text: &mut String, comparison: &Comparison) {
    let heads = ["n", "A", "B", "A - B", "95 %", "Holm p"];
    let rows = |measure: fn(&ProgressDifference) -> Option<MeanDifference>, scale: f64| {
        let rows = comparison.cells.iter().filter_map(|cell| {
            let progress = measure(cell.progress.as_ref()?)?;
            Some((cell.name(), progress_columns(&progress, scale)))
        });
        rows.collect::<Vec<_>>()
    };
    let title = "partial progress: largest share of the goal's predicates held at once, %";
    let goal = rows(|progress| progress.goal, 100.0);
    push_block(text, title, &heads, goal);
    let title = "partial progress: steps until success or the end of the rollout";
    let steps = rows(|progress| progress.steps, 1.0);
    push_block(text, title, &heads, steps);
}

fn progress_columns(difference: &MeanDifference, scale: f64) -> Vec<String> {
    let signed = |value: f64| format!("{:+.1}", scale * value);
    vec![
        difference.n.to_string(),
        format!("{:.1}", scale * difference.mean_a),
        format!("{:.1}", scale * difference.mean_b),
        signed(difference.difference.value),
        interval_text(difference.difference.new_tasks, signed),
        difference.holm_p.map_or_else(absent, p_value),
    ]
}

/// Returns the meanings of the columns that this module writes.
pub(crate) fn further_meanings(comparison: &Comparison) -> Vec<(&'static str, String)> {
    let directions = match comparison.directions {
        Directions::Shared => {
            "95 % interval about new tasks and new directions (in the row nominal, new initial \
             states)"
        }
        Directions::Own => {
            "95 % interval about new tasks and new directions: every task has directions of its \
             own, so that the interval about new tasks covers both (in the row nominal, new \
             initial states)"
        }
    };
    let mut entries = vec![
        ("directions", directions),
        (
            "all rows",
            "intervals about new tasks that all hold simultaneously with a probability of 95 %",
        ),
        (
            "5 pts p",
            "p-value of the hypothesis that A and B differ by more than 5 points: if it is small, \
             A and B are equivalent",
        ),
        ("tasks A:B", "number of tasks in which A succeeds more often, and in which B does"),
        (
            "A better",
            "probability of improvement: that A succeeds more often in a task drawn at random, \
             where ties count half; with the interval about new tasks",
        ),
        ("least, most", "tasks with the least and the greatest A - B, in points"),
    ];
    if comparison.cells.iter().any(|cell| cell.progress.is_some()) {
        entries.push((
            "progress",
            "secondary to success; a failure counts with all steps of its budget; intervals are \
             about new tasks; Holm p is of a t test over tasks, corrected for the rows",
        ));
    }
    let entries = entries.into_iter();
    entries.map(|(symbol, meaning)| (symbol, meaning.to_owned())).collect()
}

fn push_block(text: &mut String, title: &str, heads: &[&str], rows: Vec<(String, Vec<String>)>) {
    if rows.is_empty() {
        return;
    }
    let heads = heads.iter().map(|head| (*head).to_owned()).collect();
    let mut all = vec![(String::new(), heads)];
    all.extend(rows);
    separate(text);
    push_wrapped(text, "", title);
    push_columns(text, &all);
}

fn points(value: f64) -> String {
    format!("{:+.1}", 100.0 * value)
}

fn absent() -> String {
    ABSENT.to_owned()
}

fn interval_text(interval: Option<Interval>, format: impl Fn(f64) -> String) -> String {
    let ends = interval.map(|ends| ends.map(format));
    ends.map_or_else(absent, |[low, high]| format!("[{low}, {high}]"))
}
