//! Tables of the measures of LIBERO-CTRL, most with a row per policy and level.

use std::collections::{BTreeMap, BTreeSet};

use benchmark::{Axis, Condition, Directions, Level, Measure, Suite};
use paired::{
    Bounds, Cell as AtLevel, Count, Estimate, GATE_ROLLOUTS, GATE_ROLLOUTS_OF_A_SUITE,
    GATE_TOLERANCE, Gap, Gate, GateVerdict, Inference, Interval, MIN_TASKS, Measures, NoInterval,
    Report, SuiteRow,
};

use crate::analysis::Analysis;
use crate::block::{Cell, Rows, Table, cell, or_dash};
use crate::sequential::Sequential;
use crate::words::{p_value, percent, points, points_interval, rate_interval};

/// A row: an analysis, one of its levels, and what the table is about.
type Row<'a, T> = (&'a Analysis, &'a AtLevel, T);

fn levels(analyses: &[Analysis]) -> impl Iterator<Item = (&Analysis, &AtLevel)> {
    analyses.iter().flat_map(|of| of.report.cells.iter().map(move |at| (of, at)))
}

fn inferred(analyses: &[Analysis]) -> impl Iterator<Item = Row<'_, &Inference>> {
    levels(analyses).filter_map(|(of, at)| Some((of, at, at.inference.as_ref()?)))
}

/// Starts a table whose rows are named by policy, unless it is the only one, and by level.
fn of_levels<'a, T>(
    name: &str,
    analyses: &'a [Analysis],
    rows: impl IntoIterator<Item = Row<'a, T>>,
) -> Rows<Row<'a, T>> {
    Rows::new(name, rows)
        .when(analyses.len() > 1, |rows| rows.key("policy", |(of, ..)| cell(&of.label)))
        .key("level", |(_, at, _)| cell(at.level))
}

fn rate(value: f64, interval: Option<Interval>, reason: Option<NoInterval>) -> Cell {
    cell(percent(value)).below(rate_interval(interval, reason).trim_start())
}

pub(crate) fn difference(value: f64, ci: Option<Interval>, reason: Option<NoInterval>) -> Cell {
    cell(points(value)).below(points_interval(ci, reason).trim_start())
}

/// Formats an interval in a column of its own.
pub(crate) fn ends(number: impl Fn(f64) -> String, interval: Option<Interval>) -> Cell {
    or_dash(interval.map(|[low, high]| format!("[{}, {}]", number(low), number(high))))
}

/// Adds the meaning of intervals by resampling, and of the reasons why some are absent.
pub(crate) fn with_intervals<R>(
    rows: Rows<R>,
    resamplings: u32,
    no_interval: impl IntoIterator<Item = Option<NoInterval>>,
) -> Rows<R> {
    let absent: Vec<NoInterval> = no_interval.into_iter().flatten().collect();
    let [few, none] = [NoInterval::TooFewTasks, NoInterval::NoSpread];
    let meaning = "interval for the value on new tasks, from";
    rows.note("95 %", format!("{meaning} {resamplings} resamplings of whole tasks"))
        .when(absent.contains(&few), |rows| {
            let needed = "tasks for an interval by resampling, which needs";
            rows.note(few.name(), format!("too few {needed} {MIN_TASKS}"))
        })
        .when(absent.contains(&none), |rows| {
            rows.note(
                none.name(),
                "no interval: resampling the tasks does not change the value, so that it says \
                 nothing about the value's uncertainty",
            )
        })
}

/// The measures over all complete configurations.
pub(crate) fn complete(analyses: &[Analysis]) -> Table {
    let rows = levels(analyses).filter(|(_, at)| at.simultaneous.is_some());
    let rows: Vec<Row<'_, &Measures>> =
        rows.filter_map(|(analysis, at)| Some((analysis, at, at.paired.as_ref()?))).collect();
    let absent: Vec<_> = rows.iter().map(|(.., measures)| measures.no_interval).collect();
    let is_overstated = rows.iter().any(|(of, ..)| !of.report.overstated.is_empty());
    let replicates = analyses.first().map_or(0, |of| of.report.bootstrap.replicates);
    let star = |of: &Analysis, measure: Measure, mut cell: Cell| {
        if of.report.overstated.contains(&measure) {
            cell.star();
        }
        cell
    };
    let table = of_levels("Paired outcomes of complete configurations", analyses, rows)
        .column("n", "", "complete configurations, whose outcomes are all known", |(_, at, m)| {
            let completeness = &at.completeness;
            let is_all = m.n == completeness.expected;
            cell(m.n).below(if is_all { String::new() } else { format!("of {}", completeness.expected) })
        })
        .column(
            "S_indep",
            "%",
            "product of the axes' success rates, which counts nominal failures once per axis",
            |(.., m)| cell(percent(m.s_indep)),
        )
        .column(
            "S_conj",
            "%",
            "share of configurations that succeed under every axis alone",
            |(.., m)| cell(percent(m.s_conj)),
        )
        .column(
            "S_sim",
            "%",
            "share that succeeds under simultaneous perturbation, by all of these axes in one rollout",
            |(of, _, m)| star(of, Measure::SSim, cell(percent(m.s_sim))),
        )
        .column(
            "D",
            "points",
            "dependence of the axes' failures, S_conj − S_indep: above 0 if they coincide in the \
             same configurations",
            |(.., m)| difference(m.d, m.d_ci95, m.no_interval),
        )
        .column(
            "I",
            "points",
            "net effect of simultaneity, S_sim − S_conj; chance alone makes it positive",
            |(of, _, m)| star(of, Measure::I, difference(m.i, m.i_ci95, m.no_interval)),
        )
        .column(
            "b",
            "",
            "emergent: every axis alone succeeds, the simultaneous rollout fails",
            |(.., m)| cell(m.b),
        )
        .column(
            "c",
            "",
            "compensated: some axis alone fails, the simultaneous rollout succeeds",
            |(.., m)| cell(m.c),
        )
        .column("R_e", "%", "b / n", |(of, _, m)| {
            star(of, Measure::RE, rate(m.r_e, m.r_e_ci95, m.no_interval))
        })
        .column("R_c", "%", "c / n", |(of, _, m)| {
            star(of, Measure::RC, rate(m.r_c, m.r_c_ci95, m.no_interval))
        })
        .column("R_d", "%", "changed outcomes, R_e + R_c", |(of, _, m)| {
            star(of, Measure::RD, rate(m.r_d, m.r_d_ci95, m.no_interval))
        })
        .column("emergent share", "%", "share of b in all simultaneous failures", |(.., m)| {
            or_dash(m.emergent_share.map(percent))
        })
        .column("McNemar p", "", "exact two-sided test of b against c", |(.., m)| {
            cell(p_value(m.mcnemar_p))
        })
        .column(
            "detectable |I|",
            "points",
            "smallest |I| that a test at 5 % detects with a power of 80 %, given the number of \
             configurations and R_d",
            |(_, at, _)| or_dash(at.minimum_detectable_i.map(percent)),
        )
        .when(is_overstated, |rows| {
            rows.note(
                "*",
                "overstated: the campaign ended because this measure was large at its last look; \
                 the confidence sequence of the measure remains valid",
            )
        });
    with_intervals(table, replicates, absent).table()
}

/// Ranges of measures over all possible outcomes of quarantined rollouts.
pub(crate) fn bounds(analyses: &[Analysis]) -> Table {
    let range = |number: fn(f64) -> String, [low, high]: [f64; 2]| {
        cell(format!("{} to {}", number(low), number(high)))
    };
    let rows = levels(analyses).filter_map(|(of, at)| Some((of, at, at.bounds.as_ref()?)));
    of_levels(
        "Worst and best: every outcome that quarantined rollouts could have had",
        analyses,
        rows,
    )
    .column("n", "", "", |(.., b): &Row<'_, &Bounds>| cell(b.n))
    .column("affected", "", "configurations with a quarantined rollout", |(.., b)| cell(b.affected))
    .column("I", "points", "", |(.., b)| range(points, b.i))
    .column("R_e", "%", "", |(.., b)| range(percent, b.r_e))
    .column("R_c", "%", "", |(.., b)| range(percent, b.r_c))
    .column("S_conj", "%", "", |(.., b)| range(percent, b.s_conj))
    .column("S_sim", "%", "", |(.., b)| range(percent, b.s_sim))
    .table()
}

/// Describes the spread of the rates of single seeds: `± 19.0 of 3`, their standard deviation and
/// number; empty without replicates.
fn seeds(by_replicate: &BTreeMap<u32, Count>) -> String {
    let rates: Vec<f64> = by_replicate.values().filter_map(Count::rate).collect();
    let n = rates.len() as f64;
    let mean = rates.iter().sum::<f64>() / n;
    let squares = rates.iter().map(|rate| (rate - mean).powi(2)).sum::<f64>();
    match rates.len() {
        0 | 1 => String::new(),
        count => format!("± {} of {count}", percent((squares / (n - 1.0)).sqrt())),
    }
}

/// Adds the numbers of rollouts without an outcome.
pub(crate) fn gap(cell: Cell, missing: u64, quarantined: u64) -> Cell {
    let line = |count: u64, state: &str| match count {
        0 => String::new(),
        count => format!("{count} {state}"),
    };
    cell.below(line(missing, "missing")).below(line(quarantined, "quarantined"))
}

/// Success under the nominal condition, each axis alone and all of them, a row per level.
pub(crate) fn axes(analyses: &[Analysis], with_intervals: bool) -> Table {
    let run: BTreeSet<Axis> =
        levels(analyses).flat_map(|(_, at)| at.alone.keys().copied()).collect();
    let is_simultaneous = levels(analyses).any(|(_, at)| at.simultaneous.is_some());
    let conditions = [Condition::Nominal].into_iter().chain(run.into_iter().map(Condition::Single));
    let conditions = conditions.chain(is_simultaneous.then_some(Condition::Simultaneous));
    let successes: Vec<_> = analyses.iter().map(|of| of.report.suite_rows()).collect();
    let rows = analyses
        .iter()
        .zip(&successes)
        .flat_map(|(of, successes)| of.report.cells.iter().map(move |at| (of, at, successes)));
    let mut table = of_levels("Success by axis, %", analyses, rows);
    for condition in conditions {
        table = table.column(condition.name(), "", "", |(_, at, successes)| {
            let is_nominal = condition == Condition::Nominal;
            let of = successes
                .iter()
                .find(|row| row.condition == condition && (is_nominal || row.level == at.level));
            let value = or_dash(of.and_then(|row| row.all.rate()).map(percent));
            let interval = of.and_then(|row| row.ci95).filter(|_| with_intervals);
            value.below(rate_interval(interval, None).trim_start())
        });
    }
    table.table()
}

/// Success under subsets of two or more axes.
pub(crate) fn subsets(analyses: &[Analysis]) -> Table {
    let rows =
        levels(analyses).flat_map(|(of, at)| at.subsets.iter().map(move |row| (of, at, row)));
    of_levels("Success under several axes but not all", analyses, rows)
        .words("axes", |(.., (axes, _))| cell(axes))
        .column("success", "%", "", |(.., (_, count))| or_dash(count.rate().map(percent)))
        .column("counts", "", "", |(.., (_, count))| {
            cell(format!("{}/{}", count.successes, count.n))
        })
        .table()
}

/// Success by suite and in all, of the rows that `is_shown`; `is_full` adds losses and gaps.
pub(crate) fn suites(
    name: &str,
    analyses: &[Analysis],
    is_full: bool,
    is_shown: impl Fn(&SuiteRow) -> bool,
) -> Table {
    let suites: BTreeSet<Suite> = analyses.iter().flat_map(|of| of.report.suites()).collect();
    let rows = analyses.iter().flat_map(|of| {
        let rows = of.report.suite_rows().into_iter();
        rows.filter(|row| is_shown(row)).map(move |row| (of, row)).collect::<Vec<_>>()
    });
    let rows: Vec<(&Analysis, SuiteRow)> = rows.collect();
    let of_seeds = |(of, row): &(&Analysis, SuiteRow)| match row.condition {
        Condition::Nominal => of.report.nominal.as_ref().map(|of| seeds(&of.by_replicate)),
        Condition::Simultaneous => of.cell(row.level).map(|at| seeds(&at.by_replicate)),
        _ => None,
    };
    let of_seeds = |row: &_| of_seeds(row).filter(|seeds| !seeds.is_empty());
    let has_intervals = rows.iter().any(|(_, row)| row.ci95.is_some());
    let has_mean = |row: &SuiteRow| row.suites.len() < 2 || row.mean() == row.all.rate();
    let is_balanced = rows.iter().all(|(_, row)| has_mean(row));
    let all = if is_balanced && suites.len() > 1 { "average" } else { "all" };
    let has_seeds = rows.iter().any(|row| of_seeds(row).is_some());
    let mut table = Rows::new(name, rows)
        .when(analyses.len() > 1, |rows| rows.key("policy", |(of, _)| cell(&of.label)))
        .key("condition", |(_, row)| cell(row.name()));
    for suite in suites.iter().filter(|_| suites.len() > 1) {
        table = table.column(suite.short_name(), "", "", |(_, row)| {
            or_dash(row.suites.get(suite).and_then(Count::rate).map(percent))
        });
    }
    table
        .when(!is_balanced, |rows| {
            rows.column("average", "", "mean of the suites", |(_, row)| {
                or_dash(row.mean().map(percent))
            })
        })
        .column(all, "", "all rollouts together", |(_, row)| or_dash(row.all.rate().map(percent)))
        .when(has_intervals, |rows| {
            let note = "interval of the rate of all rollouts, about new tasks";
            rows.column("95 %", "", note, |(_, row)| ends(percent, row.ci95))
        })
        .column("n", "", "", |(of, row)| {
            let gap_of = match row.condition {
                Condition::Nominal => of.report.nominal.as_ref().map(|nominal| nominal.gap),
                condition => {
                    of.cell(row.level).and_then(|at| at.completeness.gaps.get(&condition).copied())
                }
            };
            let Gap { missing, quarantined } = gap_of.unwrap_or_default();
            let is_reported = row.suites.is_empty() && row.all.n > 0;
            let n = cell(row.all.n).below(if is_reported { "as reported" } else { "" });
            if is_full { gap(n, missing, quarantined) } else { n }
        })
        .when(has_seeds, |rows| {
            let note = "standard deviation of the policy seeds' rates, and their number";
            rows.column("seeds", "", note, |row| or_dash(of_seeds(row)))
        })
        .when(is_full, |rows| {
            let note = "1 − success / nominal success, %";
            rows.column("loss", "", note, |(of, row)| {
                let loss = match row.condition {
                    Condition::Single(axis) => {
                        of.cell(row.level).and_then(|at| at.alone.get(&axis)?.nominal_relative_loss)
                    }
                    _ => None,
                };
                or_dash(loss.map(percent))
            })
        })
        .table()
}

/// Success by task.
pub(crate) fn tasks(analysis: &Analysis) -> Table {
    Rows::new(format!("{}: success by task", analysis.label), &analysis.report.by_task)
        .key("task", |row| cell(analysis.subject.task_name(row.task)))
        .words("level", |row| cell(row.level))
        .words("condition", |row| cell(row.condition.name()))
        .column("success", "%", "", |row| or_dash(row.count.rate().map(percent)))
        .column("counts", "", "", |row| cell(format!("{}/{}", row.count.successes, row.count.n)))
        .table()
}

/// Describes the verdicts of the gates over all suites and for single suites.
pub(crate) fn gates(report: &Report) -> Vec<String> {
    let all = report.gate.as_ref().map(|gate| {
        let remedy = "if only one suite was run, give its published figure as `--published \
                      SUITE:POLICY=PERCENT`";
        describe_gate("", gate, GATE_ROLLOUTS, remedy)
    });
    let of_suites = report.suite_gates.iter().map(|of_suite| {
        let remedy = "create the campaign with `--nominal all`";
        let suffix = format!(" of {}", of_suite.suite);
        describe_gate(&suffix, &of_suite.gate, GATE_ROLLOUTS_OF_A_SUITE, remedy)
    });
    all.into_iter().chain(of_suites).collect()
}

fn describe_gate(suffix: &str, gate: &Gate, rollouts: u64, remedy: &str) -> String {
    let verdict = match gate.verdict {
        GateVerdict::Passed => "passed".to_owned(),
        GateVerdict::Failed => "failed: robustness is not to be interpreted".to_owned(),
        GateVerdict::Undecided => format!(
            "undecided: {} of {rollouts} nominal rollouts have a result; {remedy}",
            gate.nominal.n
        ),
    };
    let equivalence = match gate.equivalence_p {
        Some(p) if p < 0.05 => {
            format!("; the rate is significantly within the tolerance (p = {})", p_value(p))
        }
        Some(p) if gate.verdict == GateVerdict::Passed => format!(
            "; the rate is not significantly within the tolerance (p = {}): run more nominal \
             rollouts",
            p_value(p)
        ),
        _ => String::new(),
    };
    format!(
        "Reproduction gate{suffix}: {} points from the published {} %, tolerance {:.0}: \
         {verdict}{equivalence}.",
        gate.difference.map_or_else(|| "–".to_owned(), points),
        percent(gate.published),
        100.0 * GATE_TOLERANCE
    )
}

/// Describes the outcomes that another seed changes, and the components of variance.
pub(crate) fn replication(analysis: &Analysis) -> Vec<String> {
    let Report { flips, components, .. } = &analysis.report;
    let by_condition = flips.iter().map(|(condition, flips)| {
        let rate = flips.rate().map_or_else(|| "–".to_owned(), percent);
        format!("{} {rate} % ({}/{})", condition.name(), flips.flipped, flips.compared)
    });
    let by_condition: Vec<String> = by_condition.collect();
    let flips = (!by_condition.is_empty())
        .then(|| format!("Outcomes that another seed changes: {}.", by_condition.join(", ")));
    let components = components.iter().filter_map(|of| {
        let total = of.tasks + of.configurations + of.replicate;
        let share = |part: f64| format!("{:.0} %", 100.0 * part / total);
        let effect = of.design_effect.map(|effect| format!("; design effect {effect:.1}"));
        (total > 0.0).then(|| {
            format!(
                "Variance of S_sim at {}, {} replicates: {} between tasks, {} between \
                 configurations, {} chance{}; standard error {} points.",
                of.level,
                of.replicates,
                share(of.tasks),
                share(of.configurations),
                share(of.replicate),
                effect.unwrap_or_default(),
                percent(of.standard_error),
            )
        })
    });
    flips.into_iter().chain(components).collect()
}

/// Measures with an interval for each target.
pub(crate) fn targets(analyses: &[Analysis]) -> Table {
    let mut rows = Vec::new();
    for (of, at, inference) in inferred(analyses) {
        let mut add = |name, estimate: Option<&Estimate>, number: fn(f64) -> String| {
            rows.extend(estimate.map(|estimate| (of, at, (name, *estimate, number))));
        };
        add("S_sim", Some(&inference.paired.s_sim), percent);
        add("R_d", Some(&inference.paired.r_d), percent);
        add("I", Some(&inference.paired.i), points);
        add("b / S_conj", inference.eligible.emergent.as_ref(), percent);
        add("c / (1 − S_conj)", inference.eligible.compensated.as_ref(), percent);
        let relative = inference.relative.as_ref();
        add("nominal, matched", relative.map(|relative| &relative.nominal), percent);
        add("relative indep.", relative.map(|relative| &relative.prediction), percent);
        add("S_sim − relative", relative.map(|relative| &relative.difference), points);
    }
    let has_relative = inferred(analyses).any(|(.., inference)| inference.relative.is_some());
    let directions = Report::common_directions(analyses.iter().map(|of| &of.report));
    of_levels("95 % intervals for each target, % and points", analyses, rows)
        .words("measure", |(.., (name, ..))| cell(name))
        .column("value", "", "", |(.., (_, estimate, number))| cell(number(estimate.value)))
        .column(
            "these tasks",
            "",
            "about these tasks and directions, with other initial states and chance outcomes",
            |(.., (_, estimate, number))| ends(number, estimate.these_tasks),
        )
        .column(
            "new tasks",
            "",
            "about new tasks of these suites, under these directions",
            |(.., (_, estimate, number))| ends(number, estimate.new_tasks),
        )
        .column(
            "new directions",
            "",
            about_directions(directions),
            |(.., (_, estimate, number))| ends(number, estimate.new_tasks_and_directions),
        )
        .note(
            "b / S_conj",
            "share of emergent failures among configurations that succeed under every axis alone",
        )
        .note(
            "c / (1 − S_conj)",
            "share of compensated successes among configurations that fail under some axis alone",
        )
        .when(has_relative, |rows| {
            rows.note(
                "nominal, matched",
                "nominal success of the complete configurations that have a nominal outcome",
            )
            .note(
                "relative indep.",
                "nominal × product of (axis / nominal): the prediction for independent axes that \
                 counts nominal failures once",
            )
        })
        .table()
}

/// Describes intervals about new directions, by the assignment of directions; `None` if it differs.
pub(crate) fn about_directions(directions: Option<Directions>) -> &'static str {
    match directions {
        Some(Directions::Shared) => {
            "about new tasks and new directions; a configuration has one direction in all tasks"
        }
        Some(Directions::Own) => {
            "about new tasks and new directions; every task has directions of its own, so that the \
             interval about new tasks covers both"
        }
        None => "about new tasks and new directions",
    }
}

/// Tests of I and of the directions.
pub(crate) fn tests(analyses: &[Analysis]) -> Table {
    of_levels("Tests over tasks and directions", analyses, inferred(analyses))
        .column(
            "sign-flip p of I",
            "",
            "exact test over tasks; McNemar's test assumes independent rollouts",
            |(.., inference)| cell(p_value(inference.i_sign_flip_p)),
        )
        .column(
            "directions alike, p",
            "",
            "p of the hypothesis that simultaneous success is the same under every direction",
            |(.., inference)| or_dash(inference.directions.as_ref().map(|test| p_value(test.p))),
        )
        .table()
}

/// Measures, their noise floors and the differences between both.
pub(crate) fn floor(analyses: &[Analysis]) -> Table {
    let rows = inferred(analyses).filter_map(|(of, at, inference)| {
        let excess = inference.excess.as_ref()?;
        let (paired, floor, above) = (&inference.paired, &excess.floor, &excess.excess);
        let measures = [
            ("R_e", paired.r_e, floor.r_e, above.r_e),
            ("R_c", paired.r_c, floor.r_c, above.r_c),
            ("R_d", paired.r_d, floor.r_d, above.r_d),
            ("I", paired.i, floor.i, above.i),
        ];
        Some(measures.map(|measure| (of, at, (measure, excess.placebo))))
    });
    of_levels("Effects above the noise floor, % and points", analyses, rows.flatten())
        .words("measure", |(.., ((name, ..), _))| cell(name))
        .column("at the level", "", "", |(.., ((_, measure, ..), _))| cell(percent(measure.value)))
        .column(
            "noise floor",
            "",
            "the measure at the placebo level L0, where only chance changes outcomes, averaged over \
             the choice of the rollout that stands for the simultaneous one",
            |(.., ((.., floor, _), n))| cell(percent(floor.value)).below(format!("n = {n}")),
        )
        .column("above the floor", "", "", |(.., ((.., above), _))| cell(points(above.value)))
        .column("new tasks", "", "", |(.., ((.., above), _))| ends(points, above.new_tasks))
        .table()
}

/// Success lost under each condition.
pub(crate) fn losses(analyses: &[Analysis]) -> Table {
    let rows = inferred(analyses)
        .flat_map(|(of, at, inference)| inference.losses.iter().map(move |loss| (of, at, loss)));
    of_levels("Loss against nominal rollouts of the same initial states, %", analyses, rows)
        .words("condition", |(.., (condition, _))| cell(condition.name()))
        .column("n", "", "", |(.., (_, loss))| cell(loss.n))
        .column("nominal", "", "", |(.., (_, loss))| cell(percent(loss.nominal.value)))
        .column("success", "", "", |(.., (_, loss))| cell(percent(loss.success.value)))
        .column("loss", "", "", |(.., (_, loss))| cell(percent(loss.loss.value)))
        .column("new tasks", "", "", |(.., (_, loss))| ends(percent, loss.loss.new_tasks))
        .column(
            "Holm p",
            "",
            "sign-flip test of the loss, corrected for the conditions of the level",
            |(.., (_, loss))| cell(p_value(loss.holm_p)),
        )
        .column(
            "equiv. p",
            "",
            "equivalence: p-value of the hypothesis that the loss lies outside ±5 points; if it is \
             small, success is equivalent to nominal",
            |(.., (_, loss))| or_dash(loss.equivalence_p.map(p_value)),
        )
        .table()
}

/// Confidence sequences of campaigns that may end early.
pub(crate) fn sequences(analyses: &[Analysis]) -> Table {
    let rows = analyses.iter().filter_map(|of| Some((of, of.sequential.as_ref()?)));
    let rows = rows.flat_map(|(of, sequential)| {
        sequential.levels.keys().map(move |level| (of, sequential, *level))
    });
    let mut table = Rows::new("Confidence sequences, % and points", rows)
        .when(analyses.len() > 1, |rows| {
            rows.key("policy", |(of, ..): &(&Analysis, &Sequential, Level)| cell(&of.label))
        })
        .key("level", |(.., level)| cell(level))
        .words("configurations", |(_, sequential, _)| {
            cell(format!("{} of {}", sequential.used, sequential.configurations))
        });
    for measure in Measure::ALL {
        let number = if measure == Measure::I { points } else { percent };
        table = table.column(measure.name(), "", "", |(_, sequential, level)| {
            let estimates = sequential.estimates.get(level);
            let estimate = estimates.and_then(|estimates| estimates.get(&measure));
            let mut value = or_dash(estimate.map(|estimate| number(*estimate)));
            if estimate.is_some() && sequential.overstated.contains(&measure) {
                value.star();
            }
            let ends = sequential.levels[level].get(&measure);
            value.below(ends.map_or_else(String::new, |[low, high]| {
                format!("[{}, {}]", number(*low), number(*high))
            }))
        });
    }
    table.table()
}
