//! Table of the inference of each level, as text for a terminal of 80 columns.

use std::fmt::Write;

use libero_ctrl::{Directions, Level};

use crate::inference::Inference;
use crate::inference::estimate::Estimate;
use crate::inference::floor::Excess;
use crate::report::Cell;
use crate::text::{ABSENT, p_value, points, push_columns, push_row, rate, separate};

/// Width of the column of labels.
const LABEL_WIDTH: usize = 20;
/// Width of the column of a level.
const COLUMN_WIDTH: usize = 19;
/// Largest number of levels side by side.
const MAX_CELLS: usize = 3;

/// One line: its label and the function that formats a level's value.
type Line = (&'static str, fn(&Inference) -> String);

const LINES: [Line; 21] = [
    ("S_sim, these tasks", |inference| rates(inference.paired.s_sim.these_tasks)),
    ("  new tasks", |inference| rates(inference.paired.s_sim.new_tasks)),
    ("  and directions", |inference| rates(inference.paired.s_sim.new_tasks_and_directions)),
    ("I, these tasks", |inference| changes(inference.paired.i.these_tasks)),
    ("  new tasks", |inference| changes(inference.paired.i.new_tasks)),
    ("  and directions", |inference| changes(inference.paired.i.new_tasks_and_directions)),
    ("R_d, these tasks", |inference| rates(inference.paired.r_d.these_tasks)),
    ("  new tasks", |inference| rates(inference.paired.r_d.new_tasks)),
    ("  and directions", |inference| rates(inference.paired.r_d.new_tasks_and_directions)),
    ("sign-flip p of I", |inference| p_value(inference.i_sign_flip_p)),
    ("directions alike, p", |inference| {
        inference.directions.as_ref().map_or_else(absent, |test| p_value(test.p))
    }),
    ("b / S_conj", |inference| share(inference.eligible.emergent.as_ref())),
    ("  new tasks", |inference| {
        inference.eligible.emergent.map_or_else(absent, |estimate| rates(estimate.new_tasks))
    }),
    ("c / (1 - S_conj)", |inference| share(inference.eligible.compensated.as_ref())),
    ("  new tasks", |inference| {
        inference.eligible.compensated.map_or_else(absent, |estimate| rates(estimate.new_tasks))
    }),
    ("relative indep.", |inference| {
        share(inference.relative.as_ref().map(|relative| &relative.prediction))
    }),
    ("  new tasks", |inference| {
        inference.relative.map_or_else(absent, |relative| rates(relative.prediction.new_tasks))
    }),
    ("S_sim - relative", |inference| {
        change(inference.relative.as_ref().map(|relative| &relative.difference))
    }),
    ("  new tasks", |inference| {
        inference.relative.map_or_else(absent, |relative| changes(relative.difference.new_tasks))
    }),
    ("nominal, matched", |inference| {
        share(inference.relative.as_ref().map(|relative| &relative.nominal))
    }),
    ("  new tasks", |inference| {
        inference.relative.map_or_else(absent, |relative| rates(relative.nominal.new_tasks))
    }),
];

/// One line about the noise floor and the excess over it.
type ExcessLine = (&'static str, fn(&Excess) -> String);

const EXCESS_LINES: [ExcessLine; 12] = [
    ("floor: n", |excess| excess.placebo.to_string()),
    ("  R_e, R_c", |excess| {
        format!("{}, {}", rate(excess.floor.r_e.value), rate(excess.floor.r_c.value))
    }),
    ("  R_d", |excess| rate(excess.floor.r_d.value)),
    ("  I", |excess| points(excess.floor.i.value)),
    ("R_e - floor", |excess| points(excess.excess.r_e.value)),
    ("  new tasks", |excess| changes(excess.excess.r_e.new_tasks)),
    ("R_c - floor", |excess| points(excess.excess.r_c.value)),
    ("  new tasks", |excess| changes(excess.excess.r_c.new_tasks)),
    ("R_d - floor", |excess| points(excess.excess.r_d.value)),
    ("  new tasks", |excess| changes(excess.excess.r_d.new_tasks)),
    ("I - floor", |excess| points(excess.excess.i.value)),
    ("  new tasks", |excess| changes(excess.excess.i.new_tasks)),
];

/// Appends the table: intervals for each target, rates among eligible configurations,
/// relative independence, and the excess over the noise floor.
pub(crate) fn push_inference(text: &mut String, cells: &[&Cell]) {
    for cells in cells.chunks(MAX_CELLS) {
        let inferred: Vec<(Level, &Inference)> =
            cells.iter().filter_map(|cell| Some((cell.level, cell.inference.as_ref()?))).collect();
        if inferred.is_empty() {
            continue;
        }
        separate(text);
        let _ = writeln!(text, "95 % intervals about these tasks, new tasks and new directions, %");
        let levels = inferred.iter().map(|(level, _)| level.to_string());
        push_row(text, LABEL_WIDTH, COLUMN_WIDTH, "", levels);
        for (label, value) in LINES {
            let values = inferred.iter().map(|(_, inference)| value(inference));
            push_row(text, LABEL_WIDTH, COLUMN_WIDTH, label, values);
        }
        if inferred.iter().all(|(_, inference)| inference.excess.is_none()) {
            continue;
        }
        for (label, value) in EXCESS_LINES {
            let values = inferred.iter();
            let values =
                values.map(|(_, inference)| inference.excess.as_ref().map_or_else(absent, value));
            push_row(text, LABEL_WIDTH, COLUMN_WIDTH, label, values);
        }
    }
    push_losses(text, cells);
}

/// Appends the table of success lost under each condition, against matched nominal
/// rollouts.
fn push_losses(text: &mut String, cells: &[&Cell]) {
    let heads = ["n", "nominal", "success", "loss", "95 %", "Holm p", "equiv. p"];
    let mut rows = vec![(String::new(), heads.map(str::to_owned).to_vec())];
    for cell in cells {
        let Some(inference) =
            cell.inference.as_ref().filter(|inference| !inference.losses.is_empty())
        else {
            continue;
        };
        rows.push((cell.level.to_string(), Vec::new()));
        for (condition, loss) in &inference.losses {
            let percent = |value: f64| format!("{:.1}", 100.0 * value);
            let interval = loss.loss.new_tasks;
            let interval = interval.map_or_else(absent, |[low, high]| {
                format!("[{}, {}]", percent(low), percent(high))
            });
            let values = vec![
                loss.n.to_string(),
                percent(loss.nominal.value),
                percent(loss.success.value),
                percent(loss.loss.value),
                interval,
                p_value(loss.holm_p),
                loss.equivalence_p.map_or_else(absent, p_value),
            ];
            rows.push((format!(" {}", condition.label()), values));
        }
    }
    if rows.len() > 1 {
        separate(text);
        let _ = writeln!(text, "loss against nominal rollouts of the same initial states, %");
        push_columns(text, &rows);
    }
}

/// Returns the legend entries of the table's lines. `directions` is the assignment of directions
/// in all reports, `None` if they differ.
pub(crate) fn meanings(
    cells: &[&Cell],
    directions: Option<Directions>,
) -> Vec<(&'static str, &'static str)> {
    let inferred: Vec<&Inference> =
        cells.iter().filter_map(|cell| cell.inference.as_ref()).collect();
    if inferred.is_empty() {
        return Vec::new();
    }
    let mut entries = vec![
        (
            "these tasks",
            "about these tasks and directions, with other initial states and chance outcomes",
        ),
        ("new tasks", "about new tasks of these suites, under these directions"),
        (
            "and directions",
            match directions {
                Some(Directions::Shared) => {
                    "about new tasks and new directions; a configuration has one direction in all \
                     tasks"
                }
                Some(Directions::Own) => {
                    "about new tasks and new directions; every task has directions of its own, so \
                     that the interval about new tasks covers both"
                }
                None => "about new tasks and new directions",
            },
        ),
        (
            "directions alike",
            "p of the hypothesis that simultaneous success is the same under every direction",
        ),
        ("sign-flip p", "exact test over tasks; McNemar's test assumes independent rollouts"),
        (
            "b / S_conj",
            "share of emergent failures among configurations that succeed under every axis alone",
        ),
        (
            "c / (1 - S_conj)",
            "share of compensated successes among configurations that fail under some axis alone",
        ),
    ];
    if inferred.iter().any(|inference| inference.relative.is_some()) {
        entries.push((
            "relative indep.",
            "nominal x product of (axis / nominal): the prediction for independent axes that \
             counts nominal failures once",
        ));
        entries.push((
            "nominal, matched",
            "nominal success of the complete configurations that have a nominal outcome",
        ));
    }
    if inferred.iter().any(|inference| !inference.losses.is_empty()) {
        entries.push((
            "Holm p",
            "sign-flip test of the loss, corrected for the conditions of the level",
        ));
        entries.push((
            "equiv. p",
            "equivalence: p-value of the hypothesis that the loss lies outside +-5 points; if it \
             is small, success is equivalent to nominal",
        ));
    }
    if inferred.iter().any(|inference| inference.excess.is_some()) {
        entries.push((
            "floor",
            "the measures of the placebo level, where only chance changes outcomes",
        ));
    }
    entries
}

fn absent() -> String {
    ABSENT.to_owned()
}

fn share(estimate: Option<&Estimate>) -> String {
    estimate.map_or_else(absent, |estimate| rate(estimate.value))
}

fn change(estimate: Option<&Estimate>) -> String {
    estimate.map_or_else(absent, |estimate| points(estimate.value))
}

fn rates(interval: Option<[f64; 2]>) -> String {
    interval.map_or_else(absent, |[low, high]| format!("[{}, {}]", rate(low), rate(high)))
}

fn changes(interval: Option<[f64; 2]>) -> String {
    interval.map_or_else(absent, |[low, high]| format!("[{}, {}]", points(low), points(high)))
}
