//! Statistical inference: intervals for each target, effects against the noise floor, and
//! losses against matched nominal rollouts. A full stop at the end of a head marks a column of text
//! and is not shown.

use libero_ctrl::Directions;
use maud::{Markup, html};
use paired::{Cell, Estimate, Inference, Report};

use crate::document::Document;
use crate::page::tables::table;
use crate::words::{p_value, percent, points};

/// Renders the tables; empty if no configuration is complete.
pub(super) fn tables(document: &Document) -> Markup {
    let cells: Vec<(&str, &Cell, &Inference)> = document
        .analyses
        .iter()
        .flat_map(|analysis| {
            let cells = analysis.report.cells.iter();
            cells.filter_map(|cell| Some((analysis.label.as_str(), cell, cell.inference.as_ref()?)))
        })
        .collect();
    let directions =
        Report::common_directions(document.analyses.iter().map(|analysis| &analysis.report));
    html! {
        @if !cells.is_empty() {
            section {
                h2 { "Uncertainty by target" }
                (targets(&cells, directions))
                (floor(&cells))
                (losses(&cells))
            }
        }
    }
}

type Cells<'a> = [(&'a str, &'a Cell, &'a Inference)];

/// Renders the table of measures with an interval for each target. `directions` is the assignment
/// of directions of all policies, `None` if they differ.
fn targets(cells: &Cells<'_>, directions: Option<Directions>) -> Markup {
    let heads = [
        "policy",
        "level",
        "measure.",
        "value",
        "these tasks and directions",
        "new tasks",
        "new tasks and directions",
    ];
    let mut rows = Vec::new();
    for (policy, cell, inference) in cells {
        let mut add = |name: &str, estimate: Option<&Estimate>, is_share: bool| {
            if let Some(estimate) = estimate {
                let number = if is_share { percent } else { points };
                let ends = |interval: Option<[f64; 2]>| range(number, interval);
                rows.push(vec![
                    text(policy),
                    text(cell.level),
                    text(name),
                    text(number(estimate.value)),
                    ends(estimate.these_tasks),
                    ends(estimate.new_tasks),
                    ends(estimate.new_tasks_and_directions),
                ]);
            }
        };
        add("S_sim", Some(&inference.paired.s_sim), true);
        add("R_d", Some(&inference.paired.r_d), true);
        add("I", Some(&inference.paired.i), false);
        add("b / S_conj", inference.eligible.emergent.as_ref(), true);
        add("c / (1 − S_conj)", inference.eligible.compensated.as_ref(), true);
        let relative = inference.relative.as_ref();
        add("nominal, matched", relative.map(|relative| &relative.nominal), true);
        add("relative independence", relative.map(|relative| &relative.prediction), true);
        add("S_sim − relative", relative.map(|relative| &relative.difference), false);
    }
    html! {
        (table("Intervals for each target", &heads, rows))
        p.muted {
            "95 % intervals, each of which covers the variation of its target. These tasks and \
            directions: other initial states, and chance. New tasks: other tasks of the same \
            suites, under the same directions. New tasks and directions: other directions too"
            @match directions {
                Some(Directions::Shared) => "; a configuration has one direction in all tasks",
                Some(Directions::Own) => {
                    "; every task has directions of its own, so that the interval about new tasks \
                    covers both"
                },
                None => "",
            }
            ". b / S_conj: emergent failures among the configurations that succeed under every axis \
            alone. c / (1 − S_conj): compensated successes among the others. Nominal, matched: \
            nominal success of the complete configurations that have a nominal outcome. Relative \
            independence is nominal × Π (axis / nominal), which S_indep would be if it counted \
            nominal failures once."
        }
    }
}

/// Renders the table of the measures, their noise floors and the differences between both.
fn floor(cells: &Cells<'_>) -> Markup {
    let heads = [
        "policy",
        "level",
        "measure.",
        "at the level",
        "noise floor",
        "above the floor",
        "new tasks",
    ];
    let mut rows = Vec::new();
    for (policy, cell, inference) in cells {
        let Some(excess) = &inference.excess else {
            continue;
        };
        let (paired, floor, above) = (&inference.paired, &excess.floor, &excess.excess);
        for (name, measure, floor, above) in [
            ("R_e", &paired.r_e, &floor.r_e, &above.r_e),
            ("R_c", &paired.r_c, &floor.r_c, &above.r_c),
            ("R_d", &paired.r_d, &floor.r_d, &above.r_d),
            ("I", &paired.i, &floor.i, &above.i),
        ] {
            rows.push(vec![
                text(policy),
                text(cell.level),
                text(name),
                text(percent(measure.value)),
                text(percent(floor.value)),
                text(points(above.value)),
                range(points, above.new_tasks),
            ]);
        }
    }
    html! {
        @if !rows.is_empty() {
            (table("Effects above the noise floor", &heads, rows))
            p.muted {
                "The noise floor is the value of a measure at the placebo level L0, whose \
                perturbations are imperceptible, averaged over the choice of the rollout that \
                stands for the simultaneous one."
            }
        }
    }
}

/// Renders the table of the success lost under each condition.
fn losses(cells: &Cells<'_>) -> Markup {
    let heads = [
        "policy",
        "level",
        "condition.",
        "n",
        "nominal %",
        "success %",
        "loss points",
        "new tasks",
        "Holm p",
        "equivalence p",
    ];
    let mut rows = Vec::new();
    for (policy, cell, inference) in cells {
        for (condition, loss) in &inference.losses {
            rows.push(vec![
                text(policy),
                text(cell.level),
                text(condition.label()),
                text(loss.n),
                text(percent(loss.nominal.value)),
                text(percent(loss.success.value)),
                text(percent(loss.loss.value)),
                range(percent, loss.loss.new_tasks),
                text(p_value(loss.holm_p)),
                text(loss.equivalence_p.map_or_else(|| "–".to_owned(), p_value)),
            ]);
        }
    }
    html! {
        @if !rows.is_empty() {
            (table("Loss against matched nominal rollouts", &heads, rows))
            p.muted {
                "Loss: nominal success minus success under the condition, over the same initial \
                states. Holm p: exact sign-flip test over tasks, corrected for the conditions of \
                the level. Equivalence p: p-value of the hypothesis that success changes by more \
                than 5 points; if it is small, the condition changes success by less than 5 points."
            }
        }
    }
}

fn range(number: fn(f64) -> String, interval: Option<[f64; 2]>) -> Markup {
    text(interval.map_or_else(
        || "–".to_owned(),
        |[low, high]| format!("{} to {}", number(low), number(high)),
    ))
}

fn text(value: impl ToString) -> Markup {
    html! { (value.to_string()) }
}
