//! Tables of a comparison of two policies.

use std::collections::BTreeSet;

use benchmark::{Condition, Directions, Level, TaskRef};
use paired::{
    ComparedCell, Difference, FINDING_ALPHA, MeanDifference, Profile, ProgressDifference,
};

use crate::block::{Block, Cell, Rows, Table, cell, or_dash};
use crate::comparison::{Comparison, Unpairable};
use crate::page::findings::sentence;
use crate::tables::{about_directions, difference, ends, gap, with_intervals};
use crate::words::{p_value, percent, points, steps};

type Row<'a> = (&'a ComparedCell, &'a Difference);

/// Returns the tables of a pair, or the differences of several pairs, and the reasons why others are
/// not compared.
pub(crate) fn pairs(compared: &[Result<Comparison, Unpairable>]) -> Vec<Block<'_>> {
    let mut blocks = Vec::new();
    let pairs: Vec<&Comparison> = compared.iter().filter_map(|pair| pair.as_ref().ok()).collect();
    if let [only] = pairs.as_slice() {
        blocks.push(Block::Heading(only.title()));
        blocks.extend(only.warnings.iter().cloned().map(Block::Paragraph));
        blocks.extend(only.blocks());
    } else {
        blocks.push(Block::Table(differences(&pairs)));
        let warnings: BTreeSet<&String> = pairs.iter().flat_map(|pair| &pair.warnings).collect();
        blocks.extend(warnings.into_iter().map(|warning| Block::Paragraph(sentence(warning))));
    }
    let refused = compared.iter().filter_map(|pair| pair.as_ref().err());
    blocks.extend(refused.map(|pair| {
        let reasons = pair.reasons.join("; ");
        Block::Paragraph(format!("{} and {} are not compared: {reasons}.", pair.a, pair.b))
    }));
    blocks
}

/// Differences nominally and under all axes, a row per pair.
fn differences(pairs: &[&Comparison]) -> Table {
    let rows: Vec<Row<'_>> = pairs.iter().flat_map(|pair| pair.compared()).collect();
    let no_interval: Vec<_> = rows.iter().map(|(_, of)| of.no_interval).collect();
    let keys = rows.iter().map(|(at, _)| (at.level, at.condition, at.name()));
    let keys: BTreeSet<(Level, Condition, String)> =
        keys.filter(|(_, condition, _)| is_summarised(*condition)).collect();
    let resamplings = pairs.first().map_or(0, |pair| pair.bootstrap.replicates);
    let mut table = Rows::new("A − B of every pair, points", pairs)
        .key("A", |pair| cell(&pair.a.label))
        .key("B", |pair| cell(&pair.b.label));
    for (level, condition, name) in keys {
        table = table.column(name, "", "", |pair| {
            let mut compared = pair.compared();
            let of = compared.find(|(at, _)| (at.level, at.condition) == (level, condition));
            of.map_or_else(
                || cell("–"),
                |(_, of)| {
                    let mut value = difference(of.difference, of.difference_ci95, of.no_interval);
                    if of.holm_p < FINDING_ALPHA {
                        value.star();
                    }
                    value
                },
            )
        });
    }
    let meaning = format!(
        "p below {FINDING_ALPHA}: sign-flip test over tasks, corrected for the rows of the pair's \
         own table, which `coordinator compare A B` prints"
    );
    with_intervals(table.note("*", meaning), resamplings, no_interval).table()
}

/// True for the conditions in the tables of several pairs and of single tasks.
fn is_summarised(condition: Condition) -> bool {
    matches!(condition, Condition::Nominal | Condition::Simultaneous)
}

impl Comparison {
    /// Returns the blocks of one pair: what was left out, success, intervals, tasks, progress.
    pub(crate) fn blocks(&self) -> Vec<Block<'_>> {
        let left_out = self.statistics.left_out().into_iter().map(Block::Paragraph);
        let mut blocks: Vec<Block<'_>> = left_out.collect();
        let tasks = || self.tasks().folded();
        blocks.extend([self.success(), self.intervals(), self.by_task()].map(Block::Table));
        blocks.push(Block::Html(Box::new(tasks)));
        blocks.push(Block::Table(self.progress(
            "Partial progress: largest share of the goal's predicates held at once, %",
            |progress| progress.goal,
            percent,
        )));
        blocks.push(Block::Table(self.progress(
            "Partial progress: steps until success or the end of the rollout",
            |progress| progress.steps,
            steps,
        )));
        blocks
    }

    /// Iterates over the cells with a difference.
    fn compared(&self) -> impl Iterator<Item = Row<'_>> {
        let cells = self.statistics.cells.iter();
        cells.filter_map(|cell| Some((cell, cell.difference.as_ref()?)))
    }

    fn success(&self) -> Table {
        let cells = &self.statistics.cells;
        let if_compared = |at: &ComparedCell, value: fn(&Difference) -> Cell| {
            at.difference.as_ref().map_or_else(|| cell("–"), value)
        };
        let no_interval = self.compared().map(|(_, of)| of.no_interval).collect::<Vec<_>>();
        let rows = Rows::new(format!("Success: {}", self.title()), cells)
            .key("rollouts", |at| cell(at.name()))
            .column(
                "n",
                "",
                "rollouts with an outcome for both policies, of all seeds; all rates and \
                 differences are over these",
                |at| {
                    let n = at.difference.as_ref().map_or(0, |difference| difference.n);
                    gap(cell(n), at.missing, at.quarantined)
                },
            )
            .column("A", "%", "", |at| if_compared(at, |of| cell(percent(of.s_a))))
            .column("B", "%", "", |at| if_compared(at, |of| cell(percent(of.s_b))))
            .column(
                "A − B",
                "points",
                "difference of the success rates: above 0, A succeeds more often",
                |at| {
                    let seeds: Vec<String> =
                        at.by_replicate.values().map(|value| points(*value)).collect();
                    let seeds = match seeds.len() {
                        0 => String::new(),
                        count => format!("{count} seeds: {}", seeds.join(", ")),
                    };
                    if_compared(at, |of| cell(points(of.difference))).below(seeds)
                },
            )
            .column("95 %", "", "", |at| {
                if_compared(at, |of| match of.no_interval {
                    None => ends(points, of.difference_ci95),
                    Some(reason) => cell(reason),
                })
            })
            .column("A only", "", "rollouts that only A solves", |at| {
                if_compared(at, |of| cell(of.a_only))
            })
            .column("B only", "", "rollouts that only B solves", |at| {
                if_compared(at, |of| cell(of.b_only))
            })
            .column(
                "Holm p",
                "",
                "exact two-sided sign-flip test of A − B over tasks, corrected for the rows of the \
                 table",
                |at| if_compared(at, |of| cell(p_value(of.holm_p))),
            )
            .when(cells.iter().any(|cell| cell.bounds.is_some()), |rows| {
                rows.column(
                    "worst and best",
                    "points",
                    "range over every outcome that quarantined rollouts could have had",
                    |at| {
                        let range = at.bounds.as_ref().map(|bounds| bounds.difference.map(points));
                        or_dash(range.map(|[low, high]| format!("{low} to {high}")))
                    },
                )
            });
        with_intervals(rows, self.bootstrap.replicates, no_interval).table()
    }

    fn intervals(&self) -> Table {
        let nominal_row = match self.statistics.directions {
            Directions::Own => "; in the nominal row, about new initial states",
            Directions::Shared => " (in the nominal row, new initial states)",
        };
        let directions =
            format!("{}{nominal_row}", about_directions(Some(self.statistics.directions)));
        Rows::new("A − B for further targets, points", self.compared())
            .key("rollouts", |(at, _): &Row<'_>| cell(at.name()))
            .column("new directions", "", directions, |(_, of)| {
                ends(points, of.estimate.new_tasks_and_directions)
            })
            .column(
                "all rows",
                "",
                "intervals about new tasks that all hold simultaneously with a probability of 95 %",
                |(_, of)| ends(points, of.simultaneous_ci95),
            )
            .column(
                "5 pts p",
                "",
                "p-value of the hypothesis that A and B differ by more than 5 points: if it is \
                 small, A and B are equivalent",
                |(_, of)| or_dash(of.equivalence_p.map(p_value)),
            )
            .column(
                "tasks A:B",
                "",
                "number of tasks in which A succeeds more often, and in which B does",
                |(_, of)| cell(format!("{}:{}", of.profile.a_better, of.profile.b_better)),
            )
            .table()
    }

    fn by_task(&self) -> Table {
        let extreme = |(_, of): &Row<'_>, index: usize| {
            let extreme = of.profile.extremes().map(|extremes| extremes[index]);
            or_dash(extreme.map(|(task, change)| {
                format!("{}/t{} {}", task.suite().short_name(), task.index(), points(change))
            }))
        };
        Rows::new("A − B by task, points", self.compared())
            .key("rollouts", |(at, _)| cell(at.name()))
            .column(
                "A better",
                "%",
                "probability of improvement: that A succeeds more often in a task drawn at random, \
                 where ties count half; with the interval about new tasks",
                |(_, of)| cell(percent(of.profile.improvement.value)),
            )
            .column("95 %", "", "", |(_, of)| ends(percent, of.profile.improvement.new_tasks))
            .column("least", "", "the task with the least A − B", |row| extreme(row, 0))
            .column("most", "", "the task with the greatest A − B", |row| extreme(row, 1))
            .table()
    }

    /// Returns A − B of each task, nominally and under all axes.
    fn tasks(&self) -> Table {
        let columns = self.compared().filter(|(cell, _)| is_summarised(cell.condition));
        let columns: Vec<(String, &Profile)> =
            columns.map(|(cell, of)| (cell.name(), &of.profile)).collect();
        let tasks = columns.iter().flat_map(|(_, profile)| profile.tasks.keys());
        let tasks: BTreeSet<&TaskRef> = tasks.collect();
        let mut table =
            Rows::new("A − B of each task, points", tasks).key("task", |task| cell(task));
        for (name, profile) in columns {
            table = table.column(name, "", "", |task| {
                or_dash(profile.tasks.get(*task).copied().map(points))
            });
        }
        table.table()
    }

    /// Returns the table of a measure of partial progress; empty if no rollout has the measure.
    fn progress(
        &self,
        name: &str,
        measure: fn(&ProgressDifference) -> Option<MeanDifference>,
        number: fn(f64) -> String,
    ) -> Table {
        let signed = |value: f64| match value < 0.0 {
            true => number(value),
            false => format!("+{}", number(value)),
        };
        let rows = self.statistics.cells.iter().filter_map(|at| {
            let mean = measure(at.progress.as_ref()?)?;
            Some((at, mean))
        });
        Rows::new(name, rows)
            .key("rollouts", |(at, _)| cell(at.name()))
            .column("n", "", "", |(_, mean): &(_, MeanDifference)| cell(mean.n))
            .column("A", "", "", |(_, mean)| cell(number(mean.mean_a)))
            .column("B", "", "", |(_, mean)| cell(number(mean.mean_b)))
            .column("A − B", "", "", |(_, mean)| cell(signed(mean.difference.value)))
            .column("new tasks", "", "", |(_, mean)| ends(signed, mean.difference.new_tasks))
            .column("new directions", "", "", |(_, mean)| {
                ends(signed, mean.difference.new_tasks_and_directions)
            })
            .column("Holm p", "", "", |(_, mean)| or_dash(mean.holm_p.map(p_value)))
            .note(
                "progress",
                "secondary to success; a failure counts with all steps of its budget; Holm p is of \
                 a t test over tasks, corrected for the rows of the table",
            )
            .table()
    }
}
