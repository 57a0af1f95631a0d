//! Sequential comparison of two campaigns that run their configurations in the same drawn
//! order, valid at any look.

use std::collections::BTreeSet;
use std::fmt::Write;

use libero_ctrl::{Condition, Level, Measure, RolloutId, Stop, StopRule, Strata};
use paired::{NotInOneOrder, compared_looks, push_wrapped};
use serde::Serialize;

use crate::analysis::Analysis;
use crate::sequential::{percent_text, strata_in_words};

/// The confidence sequences of A − B.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SequentialComparison {
    /// Seed of the drawn order of both campaigns.
    pub seed: u64,
    /// Strata of the order: each round has one configuration, or one whole task, of each stratum.
    pub strata: Strata,
    /// Rule to evaluate, if one was given.
    pub rule: Option<StopRule>,
    /// Difference under each perturbed condition at each level, the placebo level included;
    /// conditions with an unpaired rollout are left out.
    pub cells: Vec<SequentialCell>,
}

/// The difference under one condition at one level.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SequentialCell {
    pub level: Level,
    pub condition: Condition,
    /// Configurations of the campaigns: the population of the interval.
    pub configurations: usize,
    /// Number of configurations from which the interval is computed: the first in the drawn
    /// order, up to the first that is not complete in both campaigns.
    pub used: usize,
    /// Interval of the difference, fractions.
    pub difference: [f64; 2],
    /// Number of configurations after which the rule was first met; `None` if it was not met, or
    /// without a rule.
    pub met_after: Option<usize>,
}

/// Error: the subjects did not run their configurations in the same drawn order.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum NoCommonOrder {
    #[error(
        "compare {subject} sequentially: its configurations did not run in a drawn order; create \
         both campaigns with `--stop`"
    )]
    NotDrawn { subject: String },
    #[error(
        "compare {a} with {b} sequentially: {a} ran in the order of {order_a}, {b} in that of \
         {order_b}; create both campaigns with the same `--stop-seed` and `--stop-strata`"
    )]
    Differ { a: String, order_a: String, b: String, order_b: String },
    #[error(
        "compare {a} with {b} sequentially: they have different configurations; give both the \
         same tasks and configurations"
    )]
    Configurations { a: String, b: String },
}

impl SequentialComparison {
    /// Compares two campaigns, A − B, without the conditions that have an `unpaired` rollout.
    ///
    /// # Errors
    /// If the campaigns did not run in the same drawn order.
    pub fn of(
        [a, b]: [&Analysis; 2],
        unpaired: &BTreeSet<RolloutId>,
        rule: Option<&StopRule>,
    ) -> Result<Self, NoCommonOrder> {
        let (order_a, order_b) = (order(a)?, order(b)?);
        let [name_a, name_b] = [a, b].map(|analysis| analysis.label.clone());
        if (order_a.seed, order_a.strata) != (order_b.seed, order_b.strata) {
            return Err(NoCommonOrder::Differ {
                a: name_a,
                order_a: describe_order(order_a),
                b: name_b,
                order_b: describe_order(order_b),
            });
        }
        let outcomes = [a, b].map(Analysis::outcomes_of_all);
        let outcomes = outcomes.each_ref().map(Vec::as_slice);
        let looks = compared_looks(outcomes, unpaired, order_a, rule);
        let looks = looks
            .map_err(|NotInOneOrder| NoCommonOrder::Configurations { a: name_a, b: name_b })?;
        let cells = looks.into_iter().map(|cell| SequentialCell {
            level: cell.level,
            condition: cell.condition,
            configurations: cell.look.units,
            used: cell.look.used,
            difference: cell
                .look
                .intervals
                .get(&Measure::Difference)
                .map_or([-1.0, 1.0], |interval| [interval.low(), interval.high()]),
            met_after: cell.met_after,
        });
        Ok(Self {
            seed: order_a.seed,
            strata: order_a.strata,
            rule: rule.cloned(),
            cells: cells.collect(),
        })
    }

    /// Returns a definition of the intervals.
    pub(crate) fn explanation(&self) -> String {
        format!(
            "each interval holds at all looks with a probability of 95 %; it is about all \
             configurations, and is computed from the first configurations, complete in both \
             campaigns, in the order of seed {} (rounds of {})",
            self.seed,
            strata_in_words(self.strata)
        )
    }

    /// Writes the sequences for a terminal of 80 columns: points.
    pub(crate) fn text(&self) -> String {
        let mut text = format!("{:<30}{:>14}{:>20}\n", "", "configurations", "A - B");
        for cell in &self.cells {
            let name = cell.name();
            let used = format!("{} of {}", cell.used, cell.configurations);
            let interval = percent_text(Measure::Difference, cell.difference);
            let _ = write!(text, "{name:<30}{used:>14}{interval:>20}");
            match (&self.rule, cell.met_after) {
                (None, _) => {}
                (Some(_), Some(after)) => {
                    let _ = write!(text, "  met after {after}");
                }
                (Some(_), None) => text.push_str("  not met"),
            }
            text.push('\n');
        }
        if let Some(rule) = &self.rule {
            push_wrapped(&mut text, "rule: ", &rule.to_string());
        }
        push_wrapped(&mut text, "", &self.explanation());
        text
    }
}

impl SequentialCell {
    /// Returns the level and the condition, such as `L2 camera`.
    pub(crate) fn name(&self) -> String {
        format!("{} {}", self.level, self.condition.label())
    }
}

fn order(analysis: &Analysis) -> Result<&Stop, NoCommonOrder> {
    let early = analysis.subject.early_stop.as_ref();
    let order = early.map(|early| &early.stop);
    order.ok_or_else(|| NoCommonOrder::NotDrawn { subject: analysis.label.clone() })
}

fn describe_order(order: &Stop) -> String {
    let strata = strata_in_words(order.strata);
    format!("seed {} in rounds of {strata}", order.seed)
}
